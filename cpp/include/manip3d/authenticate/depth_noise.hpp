#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/geometry/depth_step.hpp"

/// @file
/// Noise and silhouettes of depth images (dissertation section 5.2.1 and beyond).
namespace manip3d {

struct DepthNoiseOptions {
  int region = 32;  ///< Side of the square regions, pixels; the last ones may be smaller.
  /// Standard deviation of the 5 x 5 Gaussian, pixels: OpenCV's for that size.
  double sigma = 1.1;
};

/// Mean of |I - G I| in each region, millimetres, row by row: IFN_t is their mean. G is a Gaussian
/// of 5 x 5 pixels, mirrored at the border. Pixels without a measurement are depth 0, as in the
/// published measure: pixels that come and go are most of it.
/// @throws InputError  no pixels, depth is not in millimetres, region not in [2, 16384], sigma not
///                     in [0.1, 100].
std::vector<double> depth_noise(const DepthView& depth, const DepthNoiseOptions& options = {});

/// A piece of an image row that stands before what is on both its sides.
struct SilhouetteSpan {
  std::int32_t row = 0, begin = 0, end = 0;  ///< Columns [begin, end).
  std::int32_t object = 0;                   ///< Spans that lie one above the other share it.
  std::int32_t left_gap = 0, right_gap = 0;  ///< Pixels without a measurement beside it.
  /// Does depth change from one pixel to the next, with three pixels of one surface on each side?
  bool left_sharp = false, right_sharp = false;
};

struct SilhouetteOptions {
  DepthStepOptions step;
  int min_width = 8;         ///< Pixels; narrower spans are left out.
  double min_relief = 0.08;  ///< Share of the depth by which a span is nearer than what is beside.
};

/// All spans of a depth image, by rows. Cameras that measure show silhouettes with a band of pixels
/// without a measurement or with the light of both surfaces; images that are put together do not.
/// @throws InputError  an option is out of range, the depth is not in millimetres.
std::vector<SilhouetteSpan> silhouette_spans(const DepthView& depth, double focal,
                                             const SilhouetteOptions& options = {});

}  // namespace manip3d
