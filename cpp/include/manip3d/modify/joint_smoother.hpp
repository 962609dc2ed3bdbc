#pragma once

#include <Eigen/Core>
#include <array>

#include "manip3d/geometry/skeleton.hpp"

namespace manip3d {

struct JointSmootherOptions {
  double smoothing = 0.25;      ///< s in [0, 1): weight of the previous estimate.
  double correction = 0.25;     ///< c in [0, 1]: weight of the newest trend.
  double prediction = 0.25;     ///< p >= 0: frames to look ahead.
  double jitter_radius = 0.03;  ///< J >= 0, metres: smaller steps are damped.
  /// D >= 0, metres: largest distance of the output from the raw joint.
  double max_deviation = 0.05;

  /// Options for seated people, whose legs a body tracker measures less accurately.
  static JointSmootherOptions seated() { return {0.5, 0.1, 0.5, 0.1, 0.1}; }
};

/// Whether a joint can be used: it is tracked or inferred, finite, within 100 m, and not at the
/// origin (the value by which sensors say that there is no joint).
bool is_usable(const Skeleton& skeleton, Joint joint);

/// Double exponential smoothing of one person's joints [Azimi, "Skeletal joint smoothing", 2012].
///
/// With raw X, filtered F, trend B, and primes for the previous frame:
///  first frame:   F = X, B = 0
///  second frame:  F = (X + X') / 2
///  then:          F = (1 - s) X* + s (F' + B'), where d = |X - F'| and
///                 X* = X if d > J, else F' + (d / J) (X - F')
///  from the second frame on:  B = c (F - F') + (1 - c) B'
/// The output is F + p B, moved to within D of X. J and D are doubled for inferred joints. A joint
/// that is not usable is returned as not tracked, at the origin, and starts again at its first
/// frame once it is usable.
class JointSmoother {
 public:
  /// @throws InputError  an option out of range.
  explicit JointSmoother(const JointSmootherOptions& options = {});
  Skeleton add(const Skeleton& raw);
  void reset() { joints_ = {}; }

 private:
  struct State {
    int frames = 0;  ///< Frames since its start; counted up to 2.
    Eigen::Vector3d raw = Eigen::Vector3d::Zero();
    Eigen::Vector3d filtered = Eigen::Vector3d::Zero();
    Eigen::Vector3d trend = Eigen::Vector3d::Zero();
  };
  Eigen::Vector3d smooth(const Eigen::Vector3d& raw, double tolerance, State& state) const;

  JointSmootherOptions options_;
  std::array<State, kNumJoints> joints_{};
};

}  // namespace manip3d
