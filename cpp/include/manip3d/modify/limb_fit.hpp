#pragma once

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/segmentation.hpp"

namespace manip3d {

/// Moves the joints of arms and legs to where the flesh around their bones is.
///
/// A tracked knee may lie a hand's breadth beside the leg, or between the two thighs. Each bone of
/// a limb is a tapered capsule (body_bones), whose surface is called its skin. The method is an
/// articulated iterative closest point: a sample of the person's points is assigned to the nearest
/// skins, and a Gauss-Newton step moves the joints so that the points lie on the skins. Points are
/// weighted by the Geman-McClure function, whose scale decreases from step to step; a prior keeps
/// the joints near the tracked ones and decides where points say nothing, such as along the bones.
/// The roots of the limbs stay, and fingers and thumbs move with their hands. No joint moves by
/// more than 12 cm. If the skeleton has too few bones to estimate the person's size, it is returned
/// unchanged.
/// O(points + samples x bones) time, no allocation.
/// @param trunk  girth of the trunk, as for body_bones.
Skeleton fit_limbs(const Skeleton& skeleton, const PersonPoints& points, float trunk = 1.0F);

}  // namespace manip3d
