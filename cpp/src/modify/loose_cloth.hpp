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

/// The limb whose cloth is looked for, and the body that it hangs at.
struct ClothSearch {
  Limb affected = Limb::kRightArm;
  Eigen::Vector3f root = Eigen::Vector3f::Zero();  ///< Shoulder or hip, metres.
  float length = 0.0F;                             ///< Length of the intact limb, metres.
  float focal = 0.0F;                              ///< Pixels.
  BodyFrame frame;
  Mirror mirror;
};

/// Takes out the empty sleeve or leg of trousers that segmentation gave to other bones.
///
/// The body is symmetric: the mirror image of a point of it lies on the body too, where the camera
/// sees it or something nearer. A point below the root is loose cloth if the camera sees through
/// the mirrored place, or sees the intact limb there. A strong test moves that place towards the
/// plane by 3 cm, which allows for errors of the plane and for bodies that are not symmetric; a
/// weak one does not. Connected points (5 cm of depth from pixel to pixel) that pass the strong
/// test go, and with them those that pass the weak one within 3 cm. Of a single piece at least 20
/// pixels pass the strong test. Points that were other bones' get the label 0. `stack` has
/// rows * cols numbers.
/// @returns number of points.
std::int64_t remove_loose_cloth(PersonPoints& points, const ClothSearch& search,
                                const DepthView& depth, const PixelProjector& projector,
                                const PhantomImage& image, std::vector<std::int32_t>& stack);

/// Measures what may be cloth though symmetry cannot tell, as the camera sees the intact limb
/// before the mirrored place: pixels of the body that are still drawn, over those of the intact
/// limb (250 at least). Of an arm they are the trunk's, 16 cm and more from the plane; of a leg
/// they are neither the trunk's nor the affected leg's.
double share_of_unseen_cloth(const PersonPoints& points, const ClothSearch& search,
                             const PixelProjector& projector, const PhantomImage& image);

}  // namespace manip3d
