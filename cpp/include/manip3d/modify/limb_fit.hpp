#pragma once

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/segmentation.hpp"

namespace manip3d {

/// Moves the joints of arms and legs to where the flesh around their bones is.
///
/// A tracker's knee may lie a hand's breadth beside the leg, and one between two thighs takes both
/// for one. Each bone of a limb is a capsule that tapers (body_bones); a sample of the person's
/// points is given to the bones whose skins are nearest, and the joints beyond the roots are moved
/// so that the points lie on the skins: articulated iterative closest points, Gauss-Newton steps
/// with Geman-McClure weights whose scale falls from step to step, and a prior at the tracker's
/// joints, which decides along the bones and where nothing is seen. Roots stay; fingers and thumbs
/// go with their hands. No joint goes farther than 12 cm. Without lengths to tell the person's size
/// from, the skeleton is returned as it is. `trunk` as for body_bones. O(points + samples x bones),
/// no allocation.
Skeleton fit_limbs(const Skeleton& skeleton, const PersonPoints& points, float trunk = 1.0F);

}  // namespace manip3d
