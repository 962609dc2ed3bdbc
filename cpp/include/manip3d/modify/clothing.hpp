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

/// Colours of the clothes on a person's trunk: shares of hues from red on, every 30 degrees, then
/// of black, grey and white. They add up to 1; all are 0 where too little of the trunk is seen.
struct ClothingColors {
  std::array<float, kNumHues + kNumShades> shares{};
  [[nodiscard]] bool is_known() const;
};

/// Hellinger distance of two histograms, 0 (the same) to 1 [Comaniciu, Ramesh & Meer,
/// "Kernel-based object tracking", 2003, eq. 16]; 0 if one of them is not known.
double difference(const ClothingColors& a, const ClothingColors& b);

/// One frame of people in colour; borrowed.
struct ColoredScene {
  DepthView depth;
  const std::uint8_t* body_index = nullptr;    ///< (rows, cols) or null.
  const Intrinsics* camera = nullptr;          ///< Depth camera.
  const PixelRays* rays = nullptr;             ///< Rays of the depth camera.
  const Registration* registration = nullptr;  ///< Null: the colour image has depth's pixels.
  ColorView color;                             ///< Without pixels: nothing is known.
};

/// Colours along the spine of a person, 0.11 m to either side of it, where the depth image shows
/// the front of the trunk. Neighbouring hues share a pixel between them, and hue and shade share
/// one of little saturation, so that light and noise change the shares a little only.
ClothingColors clothing_colors(const Skeleton& person, const ColoredScene& scene);

}  // namespace manip3d
