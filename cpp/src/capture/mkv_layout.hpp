#pragma once

#include <cstddef>

/// @file
/// Names in the files of manip3d/capture/mkv.hpp.
namespace manip3d::mkv {

inline constexpr const char* kDepth = "depth";
inline constexpr const char* kBodyIndex = "body index";
inline constexpr const char* kColour = "colour";
inline constexpr const char* kFrames = "frames";
inline constexpr const char* kCalibration = "calibration.json";
inline constexpr std::size_t kHashDigits = 64;

}  // namespace manip3d::mkv
