#pragma once

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/depth_step.hpp"
#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/segmentation.hpp"

namespace manip3d {

struct RegionOptions {
  DepthStepOptions step;
  /// Metres from a bone's skin at which a pixel beyond a contour may still be of that bone.
  double reach = 0.1;
  /// `reach` for pixels on the bone's own surface; used only without a body index, which tells
  /// people apart better.
  double surface_reach = 0.1;
  bool line_seeds = true;  ///< Seeds along each bone; else at its middle alone (figure 5.4).
};

/// Each point gets the label of a bone by region growing (dissertation section 5.1.1).
///
/// Seeds are the pixels under each bone. From there labels spread to the four neighbours, first
/// within contours (DepthStep), then beyond them. The published method takes pixels as they come;
/// here the pixel that is nearest to the bone's skin comes first, as judged by segment_bones() with
/// BoneRule::kSkin, so that the result depends on no order. Of equal distances the lower pixel
/// comes first, and the lower bone wins. Points that no bone reaches get label 0 and an infinite
/// distance: they are not the person.
/// @param by_index  A body index told which pixels are the person's.
/// @throws InputError  an option is out of range.
void grow_bones(const Skeleton& skeleton, const Intrinsics& camera, bool by_index,
                const RegionOptions& options, PersonPoints& points);

}  // namespace manip3d
