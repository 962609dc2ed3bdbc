#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/geometry/depth_image.hpp"

/// @file
/// Noise and silhouettes of depth images (dissertation section 5.2.1 and beyond).
namespace manip3d {

struct DepthNoiseOptions {
  int region = 32;  ///< Side of the square regions, pixels; the last ones may be smaller.
  /// Standard deviation of the 5 x 5 Gaussian, pixels; the default is OpenCV's for this size.
  double sigma = 1.1;
};

/// Returns the mean of |I - G I| in each region, millimetres, row by row. Their mean is IFN_t. I is
/// the depth image, G a Gaussian of 5 x 5 pixels with the image mirrored at its border. Pixels
/// without a measurement count as depth 0, as in the published measure, so that most of it comes
/// from pixels that appear and disappear.
/// @throws InputError  no pixels, depth is not in millimetres, region not in [2, 16384], sigma not
///                     in [0.1, 100].
std::vector<double> depth_noise(const DepthView& depth, const DepthNoiseOptions& options = {});

/// A run of pixels in an image row that is nearer than its surroundings on both sides.
struct SilhouetteSpan {
  std::int32_t row = 0, begin = 0, end = 0;  ///< Columns [begin, end).
  /// Number of the object: spans of neighbouring rows that overlap have the same one.
  std::int32_t object = 0;
  std::int32_t left_gap = 0, right_gap = 0;  ///< Pixels without a measurement next to the span.
  /// True if the depth jumps from one pixel to the next, with three pixels of one surface on each
  /// side.
  bool left_sharp = false, right_sharp = false;
};

/// Finds all spans of a depth image, row by row. In measured images, silhouettes have a band of
/// pixels without a measurement or with mixed depths of both surfaces; in composed images they do
/// not.
/// @param focal       Focal length, pixels.
/// @param min_relief  Least difference to the nearer side, as a share of the span's depth.
/// @throws InputError  min_relief not in [0, 1], the depth is not in millimetres.
std::vector<SilhouetteSpan> silhouette_spans(const DepthView& depth, double focal,
                                             double min_relief);

}  // namespace manip3d
