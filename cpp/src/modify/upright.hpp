#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"

namespace manip3d {

/// Estimates the vertical from a person's posture, where the camera sees no floor.
///
/// Most cameras are level, and people lean. But a person who leans sideways keeps the legs upright;
/// if spine and intact leg are tilted alike, the camera is rolled. Each possible roll and pitch of
/// the camera gets a probability: a prior, which is highest for a level camera, times the
/// likelihood of the angles of spine and leg to that vertical. The likelihoods have heavy tails.
/// They are averaged over the last seconds, because a pose that lasts is no more evidence than one
/// frame of it.
class Upright {
 public:
  static constexpr std::size_t kRolls = 31, kPitches = 17;  // numbers of angles in the grid

  /// Updates the estimate with one frame.
  /// @param person    Joints in the camera frame, metres.
  /// @param affected  A limb that is not used.
  void learn(const Skeleton& person, Limb affected, double time_s);

  /// Mean of the possible verticals, as a unit vector in the camera frame; along the image's
  /// columns while the tilt is small.
  [[nodiscard]] const Eigen::Vector3d& down() const { return down_; }

  /// Covariance of the possible verticals, square radians.
  [[nodiscard]] const Eigen::Matrix3d& covariance() const { return covariance_; }

  /// Whether a frame has shown the person's spine.
  [[nodiscard]] bool is_known() const { return seconds_ > 0.0; }

  void reset() { *this = {}; }

 private:
  using Grid = std::array<double, kRolls * kPitches>;

  void weigh();

  Grid log_likelihood_{};  ///< Mean logarithm of the likelihood of each roll and pitch.
  double seconds_ = 0.0;   ///< Time over which `log_likelihood_` is averaged; 0: no frame yet.
  double time_s_ = 0.0;    ///< Time of the last frame that was used.
  Eigen::Vector3d down_ = Eigen::Vector3d::UnitY();
  Eigen::Matrix3d covariance_ = Eigen::Matrix3d::Zero();
};

}  // namespace manip3d
