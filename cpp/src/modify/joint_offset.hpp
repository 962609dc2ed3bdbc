#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"
#include "manip3d/modify/segmentation.hpp"

namespace manip3d {

/// Offset of a person's points from the bones, over the frames.
///
/// The body surrounds a bone: across the viewing direction its points are equally far on both
/// sides, and along the viewing direction they are nearer to the camera than the bone by most of
/// the radius. A wrong principal point, depths in another unit, and joints of another time or
/// person shift all points to one side. Trunks, which are not round, heads with hats, and the
/// affected limb are not used.
class JointOffset {
 public:
  /// Updates the means with a segmented frame.
  /// @param person  Joints as measured, not as fitted to the points.
  void learn(const Skeleton& person, Limb affected, const PersonPoints& points);
  /// Metres by which the points are beside the bones, behind them, or too far in front of them; 0:
  /// unknown.
  [[nodiscard]] double metres() const;
  /// The offset above which the calibration is doubted; it decreases with the number of frames.
  [[nodiscard]] double limit() const;
  /// Vector from the bones to the middle of their points, across the viewing direction, metres, as
  /// far as arms and legs agree on it, because joints of the legs alone may lie in the other leg.
  [[nodiscard]] Eigen::Vector3d shared() const;
  void reset() { *this = {}; }

 private:
  /// Mean offset of the points of some limbs over the frames.
  struct Mean {
    double frames = 0.0;
    Eigen::Vector3d across = Eigen::Vector3d::Zero();  ///< Across the viewing direction, metres.
    double behind = 0.0;  ///< Along the viewing direction, metres; positive: behind the bone.
  };
  /// The same for one frame, as sums over its points.
  struct Sum {
    Eigen::Vector3d across = Eigen::Vector3d::Zero();
    double behind = 0.0;
    std::int64_t count = 0;
    void add(const Sum& other);
  };
  static void learn(const Sum& sum, Mean& mean);

  Mean all_, arms_, legs_;
};

}  // namespace manip3d
