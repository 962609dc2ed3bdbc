#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/color_image.hpp"
#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/geometry/skeleton.hpp"

namespace manip3d {

inline constexpr std::size_t kNumHues = 12, kNumShades = 3;

/// Histogram of the colours of the clothes on a person's trunk: shares of twelve hues, from red on
/// in steps of 30 degrees, then of black, grey and white. The shares add up to 1. All are 0 if too
/// little of the trunk is visible.
struct ClothingColors {
  std::array<float, kNumHues + kNumShades> shares{};
  [[nodiscard]] bool is_known() const;
};

/// Hellinger distance of two histograms, 0 (equal) to 1 [Comaniciu, Ramesh & Meer, "Kernel-based
/// object tracking", 2003, eq. 16]; 0 if one of them is unknown.
double difference(const ClothingColors& a, const ClothingColors& b);

/// One frame with its people and its colour image; borrowed.
struct ColoredScene {
  DepthView depth;
  const std::uint8_t* body_index = nullptr;  ///< (rows, cols) or null.
  const Intrinsics* camera = nullptr;        ///< Depth camera.
  const PixelRays* rays = nullptr;           ///< Rays of the depth camera.
  /// Null: the colour image has the pixels of the depth image.
  const Registration* registration = nullptr;
  ColorView color;  ///< If it has no pixels, all colours are unknown.
};

/// Return the histogram of the colours within 0.11 m to either side of the spine, of pixels where
/// the depth image shows the front of the trunk. A pixel between two hues counts in part for each,
/// and a pixel of low saturation in part for its hue and its shade, so that light and noise change
/// the shares only a little.
ClothingColors clothing_colors(const Skeleton& person, const ColoredScene& scene);

}  // namespace manip3d
