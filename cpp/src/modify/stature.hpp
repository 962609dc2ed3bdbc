#pragma once

#include <optional>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/body_bones.hpp"
#include "manip3d/modify/limb.hpp"
#include "manip3d/modify/segmentation.hpp"

namespace manip3d {

/// How tall a person's pixels are against its joints, over the frames.
///
/// A focal length that is off by a factor makes all that the depth image shows narrower and lower
/// by it, but not the joints of a tracker that knows its camera. The height from the crown to a
/// sole is the longest that both tell, whatever the girth. It is measured across the viewing
/// direction, along the line from head to ankle in the image, so that a camera may be rolled; a leg
/// that is held towards the camera tells nothing. A person is not taller than the soles say (hats
/// and hair do not make the focal length wrong), nor than the crown says (nor do high soles).
class Stature {
 public:
  /// Learns from a frame that was segmented by these bones. Frames without head and foot, or with
  /// one of them at the border of the image or behind something, tell nothing.
  void learn(const Skeleton& person, const BoneSegments& bones, const PersonPoints& points,
             const DepthView& depth);

  /// The mean ratio of the two heights; 1 while it is not known.
  [[nodiscard]] double ratio() const { return frames_ > 0.0 ? ratio_ : 1.0; }
  /// By what factor the focal length must be off, at least, for this ratio: 1 or more.
  [[nodiscard]] double misfit() const;
  /// The misfit from which the calibration is doubted: nearer to 1 the more frames tell.
  [[nodiscard]] double limit() const;

  void reset() { *this = {}; }

 private:
  double frames_ = 0.0, ratio_ = 1.0;
};

}  // namespace manip3d
