#pragma once

#include <Eigen/Core>
#include <optional>

#include "manip3d/geometry/skeleton.hpp"

namespace manip3d {

struct PlacementOptions {
  double share = 0.9;       ///< Share of the reach at which targets stand.
  double spread = 0.35;     ///< Sine of the angle between straight ahead and each target.
  int stable_frames = 60;   ///< After which the placement stays as it is.
  double tolerance = 0.02;  ///< Metres by which a stable knee height and hip centre may move.
};

struct Placement {
  double knee_height = 0.0;  ///< Metres from ankle to knee.
  double reach = 0.0;        ///< Metres from the hip centre that a foot gets to.
  Eigen::Vector3f left = Eigen::Vector3f::Zero(), right = Eigen::Vector3f::Zero();  ///< Targets.
  int stable_frames = 0;
  bool frozen = false;
};

/// Legs reach so many knee heights from the hip: 0.491 of the body's height against 0.246 from knee
/// to ankle [Drillis & Contini, "Body segment parameters", 1966].
inline constexpr double kReachPerKneeHeight = 0.491 / 0.246;

/// Where a seated person's foot gets to (dissertation section 4.7.1): knee height alone is
/// measured, since a thigh that points at the camera is not. Two targets stand before the hip
/// centre, as far to the left as to the right. All is a mean over the frames since the person last
/// moved, and does not change any more once these are `stable_frames`.
class PlacementEstimator {
 public:
  /// @throws InputError  an option out of range.
  explicit PlacementEstimator(const PlacementOptions& options = {});
  /// None until knee, ankle and torso were tracked once. A frame without them changes nothing.
  const std::optional<Placement>& update(const Skeleton& skeleton, bool left_is_intact);
  [[nodiscard]] const std::optional<Placement>& placement() const { return placement_; }
  void reset();

 private:
  PlacementOptions options_;
  double knee_height_ = 0.0;  ///< A sum over the stable frames, as are the next three members.
  Eigen::Vector3d hip_centre_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d to_left_ = Eigen::Vector3d::Zero(), ahead_ = Eigen::Vector3d::Zero();
  std::optional<Placement> placement_;
};

}  // namespace manip3d
