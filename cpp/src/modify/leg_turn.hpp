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
/// The thighs of a seated person may be turned by ten degrees and more against shoulders and chest;
/// a leg mirrored at the trunk's plane then lies beside the affected one. Where the affected leg is
/// seen (mirror therapy after a stroke or for a leg that hurts, and volunteers), the two legs tell
/// their own plane: the one at which thigh and shin of each leg, mirrored, lie on the skin of the
/// other best. It may be turned about the spine, tilted (both feet to one side) and shifted, and
/// one knee may be bent more than the other. A frame in which they do not mirror each other tells
/// nothing, as one in which only one leg is stretched out.
///
/// The trunk may turn while the thighs stay on the seat, and person and seat may turn together. The
/// plane's direction is therefore averaged twice, against the camera and against the trunk, and
/// each mean counts the more, the better it foresaw the last frames. The means go over 3 seconds,
/// so that the plane does not follow one leg that moves aside. A person who stands has the trunk's
/// plane.
class LegTurn {
 public:
  explicit LegTurn(Limb affected) : affected_(affected) {}

  /// Take in a frame in which the affected leg is there.
  /// @param points  labelled.
  /// @param person  its joints lie in the flesh.
  /// @param trunk   the axes that the trunk tells.
  void learn(const PersonPoints& points, const Skeleton& person, const BodyFrame& trunk);
  /// Take in a frame in which it is not: within two seconds all is forgotten.
  void forget();
  /// The axes of the legs.
  [[nodiscard]] BodyFrame of(const BodyFrame& trunk) const;
  void reset() { *this = LegTurn(affected_); }

 private:
  [[nodiscard]] Eigen::Vector3d turned(const BodyFrame& trunk) const {
    return trunk.n + turn_ * trunk.z;
  }

  Limb affected_;
  double frames_ = 0.0;                               ///< Frames in the means.
  Eigen::Vector3d normal_ = Eigen::Vector3d::Zero();  ///< Mean, in the camera.
  double turn_ = 0.0;   ///< Mean, as a tangent from the trunk's n to its z.
  double roll_ = 0.0;   ///< Mean, as a tangent from the trunk's n to its y.
  double shift_ = 0.0;  ///< Mean distance of the plane from the trunk's origin along its n, metres.
  double seated_ = 0.0;  ///< Posture of the intact leg: 1 seated, 0 standing.
  double trust_ = 0.0;   ///< 1 while the affected leg is there.
  /// Running means of the squared sine by which each mean missed the next frame.
  double seat_error_ = 0.0, trunk_error_ = 0.0;
};

}  // namespace manip3d
