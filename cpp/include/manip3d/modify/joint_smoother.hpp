#pragma once

#include <Eigen/Core>
#include <array>

#include "manip3d/geometry/skeleton.hpp"

namespace manip3d {

struct JointSmootherOptions {
  double smoothing = 0.25;      ///< s in [0, 1): weight of the past.
  double correction = 0.25;     ///< c in [0, 1]: weight of the newest trend.
  double prediction = 0.25;     ///< p >= 0: frames to look ahead.
  double jitter_radius = 0.03;  ///< J >= 0, metres: smaller steps are damped.
  double max_deviation = 0.05;  ///< D >= 0, metres: from the raw joint.

  /// For people who sit, whose legs a body tracker sees less well.
  static JointSmootherOptions seated() { return {0.5, 0.1, 0.5, 0.1, 0.1}; }
};

/// Can a joint be used? It is tracked or inferred, finite, not at the origin (how sensors say that
/// there is none) and within 100 m.
bool is_usable(const Skeleton& skeleton, Joint joint);

/// Double exponential smoothing of one person's joints [Azimi, "Skeletal joint smoothing", 2012].
///
/// With raw X, filtered F, trend B and primes for the frame before: F = X and B = 0 at first, F =
/// (X
/// + X') / 2 in the second frame, then F = (1 - s) X* + s (F' + B') where X* = X for d = |X - F'| >
/// J, else F' + (d / J) (X - F'). B = c (F - F') + (1 - c) B'. The output F + p B is pulled to
/// within D of X. J and D are doubled for inferred joints. A joint that is not usable starts anew
/// when it is back; until then it is not tracked, at the origin.
class JointSmoother {
 public:
  /// @throws InputError  an option out of range.
  explicit JointSmoother(const JointSmootherOptions& options = {});
  Skeleton add(const Skeleton& raw);
  void reset() { joints_ = {}; }

 private:
  struct State {
    int frames = 0;  ///< Since its start, up to 2.
    Eigen::Vector3d raw = Eigen::Vector3d::Zero();
    Eigen::Vector3d filtered = Eigen::Vector3d::Zero();
    Eigen::Vector3d trend = Eigen::Vector3d::Zero();
  };
  Eigen::Vector3d smooth(const Eigen::Vector3d& raw, double tolerance, State& state) const;

  JointSmootherOptions options_;
  std::array<State, kNumJoints> joints_{};
};

}  // namespace manip3d
