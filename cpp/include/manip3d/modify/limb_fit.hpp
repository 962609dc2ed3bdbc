#pragma once

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/segmentation.hpp"

namespace manip3d {

/// Move the joints of arms and legs so that the person's points lie on the skins of their bones.
///
/// A tracker's knee may lie 10 cm beside the leg, and a knee between two thighs would assign the
/// points of both to one bone. Each bone of a limb is a tapered capsule (body_bones). Each of a
/// sample of the person's points is assigned to the bones with the nearest skins, and the joints
/// beyond the roots are moved so that the points lie on the skins: articulated iterative closest
/// points, solved by Gauss-Newton steps with Geman-McClure weights whose scale decreases from step
/// to step. A prior at the tracker's joints determines the position along the bones and of bones
/// without points. Roots do not move; fingers and thumbs move with their hands. No joint moves more
/// than 12 cm. The skeleton is returned unchanged if it has no usable lengths from which the
/// person's size follows. `trunk` as for body_bones. O(points + samples x bones), no allocation.
Skeleton fit_limbs(const Skeleton& skeleton, const PersonPoints& points, float trunk = 1.0F);

}  // namespace manip3d
