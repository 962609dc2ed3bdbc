#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "manip3d/geometry/mesh.hpp"

/// @file
/// Conversion between colours of faces in files, 0xRRGGBB in sRGB, and materials, whose colours are
/// linear.
namespace manip3d {

/// Channel k (red, green or blue) of a colour.
constexpr std::int32_t channel(std::int32_t rgb, int k) { return rgb >> (16 - 8 * k) & 0xFF; }

/// @param values  Three values in sRGB, 0 to 1; others are clamped.
inline std::int32_t packed_color(const double* values) {
  std::int32_t rgb = 0;
  for (int k = 0; k < 3; ++k) {
    rgb =
        rgb << 8 | static_cast<std::int32_t>(std::lround(255.0 * std::clamp(values[k], 0.0, 1.0)));
  }
  return rgb;
}

/// Converts a byte of sRGB to linear light (IEC 61966-2-1), in steps of 1 / 65535. These are fine
/// enough to convert back to the same byte, and coarse enough to be the same number with every
/// libm.
inline double linear_from_srgb(std::int32_t byte) {
  const double y = byte / 255.0;
  const double x = y <= 0.04045 ? y / 12.92 : std::pow((y + 0.055) / 1.055, 2.4);
  return static_cast<double>(std::lround(65535.0 * x)) / 65535.0;
}
inline double srgb_from_linear(double x) {
  return x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055;
}

inline void set_color(Material& material, std::int32_t rgb) {
  for (int k = 0; k < 3; ++k) material.base_color[k] = linear_from_srgb(channel(rgb, k));
}

/// A material of one colour, with the colour as its name.
inline Material material_of(std::int32_t rgb) {
  constexpr std::string_view kDigits = "0123456789ABCDEF";
  Material material;
  material.name = "color_";
  for (int shift = 20; shift >= 0; shift -= 4) material.name += kDigits[rgb >> shift & 0xF];
  set_color(material, rgb);
  return material;
}

/// The colour of a material without its texture.
inline std::int32_t color_of(const Material& material) {
  std::array<double, 3> srgb;
  std::ranges::transform(material.base_color, material.base_color + 3, srgb.begin(),
                         srgb_from_linear);
  return packed_color(srgb.data());
}

/// The colours of materials, 0xRRGGBB; empty: all are white.
inline std::vector<std::int32_t> colors_of(const std::vector<Material>& materials) {
  constexpr std::int32_t kWhite = 0xFFFFFF;
  std::vector<std::int32_t> colors(materials.size());
  std::ranges::transform(materials, colors.begin(), color_of);
  if (std::ranges::all_of(colors, [](std::int32_t rgb) { return rgb == kWhite; })) colors.clear();
  return colors;
}

/// The colour of a face, given the colours of the materials; -1: none.
inline std::int32_t color_of_face(const MeshView& mesh, const std::vector<std::int32_t>& colors,
                                  Eigen::Index face) {
  const std::size_t material = mesh.has_materials() ? mesh.face_material[face] : -1;
  return material < colors.size() ? colors[material] : -1;
}

}  // namespace manip3d
