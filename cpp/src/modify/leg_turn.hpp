#pragma once

#include <Eigen/Core>
#include <optional>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"
#include "manip3d/modify/mirror.hpp"
#include "manip3d/modify/segmentation.hpp"

namespace manip3d {

/// The plane of symmetry of the legs of a seated person who has both.
///
/// The thighs of a seated person may be turned by ten degrees or more relative to shoulders and
/// chest; a leg mirrored at the trunk's plane is then beside the affected one. If the affected leg
/// is visible (mirror therapy after a stroke or for a painful leg, and volunteers), the two legs
/// define a plane of their own: the one at which thigh and shin of each leg, when mirrored, best
/// lie on the skin of the other. It may be turned about the spine, tilted (both feet to one side)
/// and shifted, and one knee may be bent more than the other. Frames in which the legs are not
/// mirror images, as when only one is stretched out, are not used.
///
/// The trunk may turn while the thighs stay on the seat, and person and seat may turn together. The
/// direction of the plane is therefore averaged twice, relative to the camera and relative to the
/// trunk, and each mean has the more weight the better it predicted the last frames. The means
/// cover 3 seconds, so that the plane does not follow one leg that moves aside. For a standing
/// person the trunk's plane is used.
class LegTurn {
 public:
  explicit LegTurn(Limb affected) : affected_(affected) {}

  /// Updates the plane with a frame in which the affected leg is present.
  /// @param points  Labelled points of the person.
  /// @param person  Joints fitted to these points.
  /// @param trunk   Axes of the trunk.
  void learn(const PersonPoints& points, const Skeleton& person, const BodyFrame& trunk);
  /// Updates the trust with a frame without the affected leg. It fades from frame to frame; after
  /// 44 of them, a second and a half, everything is forgotten.
  void lose_trust();
  /// Return the axes of the legs.
  [[nodiscard]] BodyFrame of(const BodyFrame& trunk) const;
  void reset() { *this = LegTurn(affected_); }

 private:
  [[nodiscard]] Eigen::Vector3d turned(const BodyFrame& trunk) const {
    return trunk.n + turn_ * trunk.z;
  }

  Limb affected_;
  double frames_ = 0.0;                               ///< Frames in the means.
  Eigen::Vector3d normal_ = Eigen::Vector3d::Zero();  ///< Mean, camera frame.
  double turn_ = 0.0;   ///< Mean, as a tangent from the trunk's n to its z.
  double roll_ = 0.0;   ///< Mean, as a tangent from the trunk's n to its y.
  double shift_ = 0.0;  ///< Mean distance of the plane from the trunk's origin along n, metres.
  /// Posture of the intact leg: squared sine of its angle to the trunk; 1 seated, 0 standing.
  double seated_ = 0.0;
  double trust_ = 0.0;  ///< 1 while the affected leg is present; decreases to 0 otherwise.
  /// Running means of the squared sine of the angle between each mean and the next frame.
  double seat_error_ = 0.0, trunk_error_ = 0.0;
};

}  // namespace manip3d
