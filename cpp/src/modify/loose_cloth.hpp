#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/modify/mirror.hpp"
#include "manip3d/modify/phantom_pipeline.hpp"
#include "modify/phantom_image.hpp"

/// @file
/// An empty sleeve or leg of trousers beside the removed limb.
namespace manip3d {

/// The limb whose cloth is searched for, and the axes of the body.
struct ClothSearch {
  Limb affected = Limb::kRightArm;
  Eigen::Vector3f root = Eigen::Vector3f::Zero();  ///< Shoulder or hip, metres.
  float length = 0.0F;                             ///< Length of the intact limb, metres.
  float focal = 0.0F;                              ///< Pixels.
  BodyFrame frame;
  Mirror mirror;
};

/// Remove the empty sleeve or leg of trousers that segmentation assigned to other bones.
///
/// The body is symmetric: the mirror image of a point of the body is on the body as well, so at its
/// place the camera sees the body or something nearer. A point below the root is loose cloth if the
/// camera sees through the mirrored place, or sees the intact limb there. A strong test moves that
/// place towards the plane by 3 cm, to allow for errors of the plane and for bodies that are not
/// symmetric; a weak test does not. Connected points (at most 5 cm of depth from pixel to pixel)
/// that pass the strong test are removed, and with them those that pass the weak one within 3 cm.
/// Pieces with fewer than 20 pixels that pass the strong test are kept. Removed points of other
/// bones get the label 0. `stack` must have room for rows * cols numbers.
/// @returns number of removed points.
std::int64_t remove_loose_cloth(PersonPoints& points, const ClothSearch& search,
                                const DepthView& depth, const PixelProjector& projector,
                                const PhantomImage& image, std::vector<std::int32_t>& stack);

/// Measure the pixels that may be cloth but cannot be tested by symmetry, because the intact limb
/// hides the mirrored place: such pixels of the body that are still drawn, divided by the number of
/// pixels of the intact limb (at least 250). For an arm they are pixels of the trunk that are at
/// least 16 cm from the plane; for a leg, pixels of neither the trunk nor the affected leg.
double share_of_unseen_cloth(const PersonPoints& points, const ClothSearch& search,
                             const PixelProjector& projector, const PhantomImage& image);

}  // namespace manip3d
