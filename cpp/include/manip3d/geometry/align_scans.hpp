#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>

#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// The rigid motion between two scans of one place: target = rotation * source + translation.
struct ScanMotion {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();  ///< Metres.
  // Quality of the match, set by align(). It is not used in a motion to start from.
  double residual = 0.0;   ///< Metres: median distance of the paired points from their planes.
  std::int64_t pairs = 0;  ///< Points of the source with a plane of the target near them.
  std::int64_t tried = 0;  ///< Points of the source that were tested: one per voxel.

  /// Whether the motion is reliable: two thirds of the points have a plane near them, and half of
  /// those are within 8 cm of it. For consecutive scans of KITTI and of simulated streets, the
  /// values are 75 % and 1 to 3 cm.
  [[nodiscard]] bool is_found() const {
    return tried > 0 && 3 * pairs >= 2 * tried && residual < 0.08;
  }
};

/// Aligns scans of one place with a target scan by point-to-plane ICP [Chen & Medioni, 1992] with
/// one point per voxel and Geman-McClure weights. The result is the same on every run and every
/// machine.
class ScanAligner {
 public:
  /// @throws InputError  as check_points.
  explicit ScanAligner(const PointsView& target, const Progress& progress = {});
  ~ScanAligner();
  ScanAligner(ScanAligner&&) noexcept;
  ScanAligner& operator=(ScanAligner&&) noexcept;

  /// Estimate the motion from another scan to the coordinates of the target.
  /// @param start  A motion within a metre of the correct one.
  /// @throws InputError  as check_points.
  ScanMotion align(const PointsView& source, const ScanMotion& start = {},
                   const Progress& progress = {});

 private:
  struct Target;
  std::unique_ptr<Target> target_;
};

}  // namespace manip3d
