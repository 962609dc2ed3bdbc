#pragma once

#include <limits>
#include <numbers>

/// @file
/// Constants used by many kernels, in double and (suffix F) in float.
namespace manip3d {

constexpr double kPi = std::numbers::pi;
constexpr double kFullTurn = 2.0 * kPi;  ///< 360 degrees, in radians
constexpr double kDegree = kPi / 180.0;  ///< in radians
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

constexpr float kFullTurnF = 2.0F * std::numbers::pi_v<float>;
constexpr float kInfinityF = std::numeric_limits<float>::infinity();
constexpr float kNanF = std::numeric_limits<float>::quiet_NaN();

}  // namespace manip3d
