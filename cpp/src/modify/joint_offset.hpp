#pragma once

#include <Eigen/Core>
#include <cstdint>

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
  /// From the bones to the middle of their flesh, across the viewing direction, metres, as far as
  /// arms and legs both tell it: joints of the legs alone may lie in the other leg.
  [[nodiscard]] Eigen::Vector3d shared() const;
  void reset() { *this = {}; }

 private:
  /// Place of the flesh of some limbs, as the mean over the frames.
  struct Mean {
    double frames = 0.0;
    Eigen::Vector3d across = Eigen::Vector3d::Zero();  ///< To the viewing direction, metres.
    double behind = 0.0;                               ///< Along it, metres.
  };
  /// The same of one frame, as sums over its points.
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
