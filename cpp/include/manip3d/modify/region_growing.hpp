#pragma once

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/depth_step.hpp"
#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/segmentation.hpp"

namespace manip3d {

struct RegionOptions {
  DepthStepOptions step;
  /// Largest distance of a pixel beyond a contour from the bone's skin, metres.
  double reach = 0.1;
  /// Largest distance of a pixel within the contour, metres; used only without a body index, which
  /// separates people more reliably.
  double surface_reach = 0.1;
  bool line_seeds = true;  ///< Seeds along each bone; if false, only at its middle (figure 5.4).
};

/// Label each point with a bone by region growing (dissertation section 5.1.1).
///
/// Seeds are the pixels under each bone. From there labels spread to the four neighbours, first
/// within contours (DepthStep), then beyond them. The published method visits pixels in the order
/// in which they are found. Here the pixel that is nearest to the bone's skin, by the measure of
/// segment_bones() with BoneRule::kSkin, comes first, so that the result does not depend on an
/// order. Of equal distances the lower pixel comes first, and the lower bone wins. Points that no
/// bone reaches get label 0 and an infinite distance: they do not belong to the person.
/// @param by_index  Whether the person's pixels were found by a body index.
/// @throws InputError  an option is out of range.
void grow_bones(const Skeleton& skeleton, const Intrinsics& camera, bool by_index,
                const RegionOptions& options, PersonPoints& points);

}  // namespace manip3d
