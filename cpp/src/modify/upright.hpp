#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"

namespace manip3d {

/// Tells which way is down from how a person holds itself, where a camera sees no floor.
///
/// Most cameras are level, and people lean; but who leans aside keeps the legs upright, and whose
/// spine and intact leg tilt alike is seen by a camera that is rolled. The rolls and pitches that a
/// camera may have are each given a probability: a prior, most of which is on a level camera, times
/// those of the angles of spine and leg to that vertical. The latter have heavy tails and are
/// averaged over the last seconds, as a pose that lasts tells no more than one frame of it.
class Upright {
 public:
  static constexpr std::size_t kRolls = 31, kPitches = 17;  // that are told apart

  /// Learns from one frame.
  /// @param person  its joints in the camera's frame, metres.
  /// @param affected  a limb that tells nothing.
  void learn(const Skeleton& person, Limb affected, double time_s);

  /// The mean of the directions that may be down, as a unit vector in the frame of the camera:
  /// along the image's columns as long as that is hardly tilted.
  [[nodiscard]] const Eigen::Vector3d& down() const { return down_; }

  /// The covariance of those directions, square radians.
  [[nodiscard]] const Eigen::Matrix3d& covariance() const { return covariance_; }

  void reset() { *this = {}; }

 private:
  using Grid = std::array<double, kRolls * kPitches>;

  void weigh();

  Grid told_{};           ///< Mean logarithm of the likelihood of each roll and pitch.
  double seconds_ = 0.0;  ///< Time that `told_` is the mean of; 0: nothing was seen.
  double time_s_ = 0.0;   ///< Time of the last frame that was taken in.
  Eigen::Vector3d down_ = Eigen::Vector3d::UnitY();
  Eigen::Matrix3d covariance_ = Eigen::Matrix3d::Zero();
};

}  // namespace manip3d
