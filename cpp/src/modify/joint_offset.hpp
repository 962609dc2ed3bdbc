#pragma once

#include <Eigen/Core>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"
#include "manip3d/modify/segmentation.hpp"

namespace manip3d {

/// How far a person's flesh lies from its bones, over the frames.
///
/// Flesh lies around a bone: across the viewing direction its points are as far on one side as on
/// the other, and along it they are nearer than the bone by most of its thickness. A principal
/// point that is off, a depth in another unit and joints of another time or person move all of them
/// to one side. Trunks, which are not round, heads with hats, and the affected limb tell nothing.
class JointOffset {
 public:
  /// Learns from a frame that was segmented.
  /// @param person  with the joints as they are told, not as they were fitted to the points.
  void learn(const Skeleton& person, Limb affected, const PersonPoints& points);
  /// Metres that the flesh lies beside its bones, behind them, or too far before them; 0: unknown.
  [[nodiscard]] double metres() const;
  /// The offset from which the calibration is doubted: lower the more frames tell.
  [[nodiscard]] double limit() const;
  void reset() { *this = {}; }

 private:
  double frames_ = 0.0;
  Eigen::Vector3d across_ = Eigen::Vector3d::Zero();  ///< To the viewing direction, metres.
  double behind_ = 0.0;                               ///< Along it, metres.
};

}  // namespace manip3d
