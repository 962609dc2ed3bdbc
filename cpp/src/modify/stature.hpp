#pragma once

#include <optional>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/body_bones.hpp"
#include "manip3d/modify/limb.hpp"
#include "manip3d/modify/segmentation.hpp"
#include "modify/phantom_image.hpp"

namespace manip3d {

/// Ratio of the height of a person's pixels to the height of its joints, over the frames.
///
/// A focal length that is wrong by a factor scales everything in the depth image by this factor
/// across the viewing direction, but not the joints of a tracker that knows its camera. The height
/// from the crown to a sole is the longest distance that both show, and independent of girth. It is
/// measured across the viewing direction, along the line from head to ankle in the image, so that
/// the camera may be rolled; a leg that points at the camera is not used. Crown and soles are
/// compared separately as well, and the smaller ratio counts, because hats and hair raise only the
/// crown, and high soles only lower the soles.
class Stature {
 public:
  /// Updates the mean with a frame that was segmented by these bones. Frames without head, ankle
  /// and foot, or with one of them outside the image, at its border or hidden, are not used.
  void learn(const Skeleton& person, const BoneSegments& bones, const PersonPoints& points,
             const DepthView& depth, const PixelProjector& projector);

  /// The mean ratio of the two heights; 1 while it is unknown.
  [[nodiscard]] double ratio() const { return frames_ > 0.0 ? ratio_ : 1.0; }
  /// The smallest factor by which the focal length must be wrong to give this ratio; at least 1.
  [[nodiscard]] double misfit() const;
  /// The misfit above which the calibration is doubted; it approaches 1.06 with the number of
  /// frames.
  [[nodiscard]] double limit() const;

  void reset() { *this = {}; }

 private:
  double frames_ = 0.0, ratio_ = 1.0;
};

}  // namespace manip3d
