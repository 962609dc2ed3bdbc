#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <numbers>

/// @file
/// Angles computed only by additions, multiplications, divisions and square roots, which give the
/// same bits on every CPU; functions of libm differ with and without FMA.
namespace manip3d {

/// Largest error, in radians, of angles computed in float with these functions.
constexpr double kAngleError = 1e-6;

/// atan(t) for t in [0, 1]: Abramowitz & Stegun, 4.4.49 (error 2e-8 before rounding).
template <typename Real>
Real arc_tangent_of_unit(Real t) {
  const Real s = t * t;
  Real p = Real(0.0028662257);
  p = p * s - Real(0.0161657367);
  p = p * s + Real(0.0429096138);
  p = p * s - Real(0.0752896400);
  p = p * s + Real(0.1065626393);
  p = p * s - Real(0.1420889944);
  p = p * s + Real(0.1999355085);
  p = p * s - Real(0.3333314528);
  return t * (p * s + Real(1));
}

/// atan2(y, x) in [-pi, pi], 0 for (0, 0).
template <typename Real>
Real arc_tangent(Real y, Real x) {
  const Real ax = std::abs(x);
  const Real ay = std::abs(y);
  const Real longer = std::max(ax, ay);
  Real angle = arc_tangent_of_unit(std::min(ax, ay) / (longer > 0 ? longer : Real{1}));
  if (ay > ax) angle = std::numbers::pi_v<Real> / 2 - angle;
  if (x < 0) angle = std::numbers::pi_v<Real> - angle;
  return y < 0 ? -angle : angle;
}

struct SinCos {
  double sin, cos;
};

/// Sine and cosine, to about 1e-15, of angles up to 1e6 radians.
inline SinCos sin_cos(double angle) {
  const double quarter_turns = std::nearbyint(angle * (2.0 / std::numbers::pi));
  // pi/2 in two parts, so that the difference keeps its significant digits.
  const double r =
      (angle - quarter_turns * 1.5707963267341256) - quarter_turns * 6.077100506506192e-11;
  const double s = r * r;
  double sine = 1.0;
  double cosine = 1.0;
  for (int k = 18; k >= 2; k -= 2) {  // Taylor series, from their last terms on
    sine = 1.0 - sine * s / ((k + 1.0) * k);
    cosine = 1.0 - cosine * s / (k * (k - 1.0));
  }
  sine *= r;
  const auto quadrant = static_cast<long long>(quarter_turns) & 3;
  if (quadrant == 0) return {sine, cosine};
  if (quadrant == 1) return {cosine, -sine};
  if (quadrant == 2) return {-sine, -cosine};
  return {-cosine, sine};
}

/// Rotation by `yaw` radians about the vertical, counter-clockwise seen from above.
inline Eigen::Matrix3d rotation_about_z(double yaw) {
  const auto [sin, cos] = sin_cos(yaw);
  Eigen::Matrix3d rotation;
  rotation << cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0;
  return rotation;
}

}  // namespace manip3d
