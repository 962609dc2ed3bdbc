#pragma once

#include <Eigen/Core>
#include <optional>

#include "manip3d/geometry/skeleton.hpp"

namespace manip3d {

struct PlacementOptions {
  double share = 0.9;      ///< Distance of the targets as a share of the reach.
  double spread = 0.35;    ///< Sine of the angle between straight ahead and each target.
  int stable_frames = 60;  ///< Number of stable frames after which the placement no longer changes.
  /// Metres by which knee height and hip centre may differ from their means in a stable frame.
  double tolerance = 0.02;
};

struct Placement {
  double knee_height = 0.0;  ///< Metres from ankle to knee.
  double reach = 0.0;  ///< Metres from the hip centre to the farthest point that a foot reaches.
  Eigen::Vector3f left = Eigen::Vector3f::Zero(), right = Eigen::Vector3f::Zero();  ///< Targets.
  int stable_frames = 0;
  bool frozen = false;
};

/// Ratio of leg length to knee height: 0.491 of the body's height against 0.246 from knee to ankle
/// [Drillis & Contini, "Body segment parameters", 1966].
inline constexpr double kReachPerKneeHeight = 0.491 / 0.246;

/// Estimate how far a seated person's foot reaches (dissertation section 4.7.1). Only the knee
/// height is measured, because the length of a thigh that points at the camera is not visible. Two
/// targets are placed in front of the hip centre, symmetrically to its left and right. All values
/// are means over the frames since the person last moved; after `stable_frames` of them they no
/// longer change.
class PlacementEstimator {
 public:
  /// @throws InputError  an option out of range.
  explicit PlacementEstimator(const PlacementOptions& options = {});
  /// No value until knee, ankle and torso were tracked once. A frame without them changes nothing.
  const std::optional<Placement>& update(const Skeleton& skeleton, bool left_is_intact);
  [[nodiscard]] const std::optional<Placement>& placement() const { return placement_; }
  void reset();

 private:
  PlacementOptions options_;
  double knee_height_ = 0.0;  ///< A sum over the stable frames, like the next three members.
  Eigen::Vector3d hip_centre_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d to_left_ = Eigen::Vector3d::Zero(), ahead_ = Eigen::Vector3d::Zero();
  std::optional<Placement> placement_;
};

}  // namespace manip3d
