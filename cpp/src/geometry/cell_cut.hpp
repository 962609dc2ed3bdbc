#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <utility>

namespace manip3d {

/// Triangles of a 2x2 cell of pixels: two if all four corners are valid, one if three are. Corners
/// are numbered around the cell from the pixel with the lowest u and v.
enum class CellCut : std::uint8_t {
  kNone,
  kWithout0,
  kWithout1,
  kWithout2,
  kWithout3,
  kFrom0To2,
  kFrom1To3
};

/// The pixels around the cell below and right of `pixel`, in the order in which triangles are front
/// faces of a grid with rows in this direction.
inline std::array<std::int64_t, 4> cell_corners(std::int64_t pixel, std::int64_t cols,
                                                bool rows_up) {
  std::array<std::int64_t, 4> corners = {pixel, pixel + 1, pixel + cols + 1, pixel + cols};
  if (!rows_up) std::swap(corners[1], corners[3]);
  return corners;
}

/// Four valid pixels are cut along the shorter diagonal; if both are equally long, from corner 0.
/// @param valid             Bit i: corner i is valid.
/// @param squared_distance  Function of two corners.
template <typename SquaredDistance>
CellCut cut_cell(unsigned valid, const SquaredDistance& squared_distance) {
  using enum CellCut;
  if (valid == 15) {
    return squared_distance(0, 2) <= squared_distance(1, 3) ? kFrom0To2 : kFrom1To3;
  }
  constexpr std::array<CellCut, 15> kCuts = {kNone, kNone,     kNone,     kNone,     kNone,
                                             kNone, kNone,     kWithout3, kNone,     kNone,
                                             kNone, kWithout2, kNone,     kWithout1, kWithout0};
  return kCuts[valid];
}

/// The corners of the triangles of a cell.
inline std::span<const std::array<std::uint8_t, 3>> cell_triangles(CellCut cut) {
  static constexpr std::array<std::array<std::uint8_t, 3>, 8> kCellTriangles = {
      {{1, 2, 3}, {0, 2, 3}, {0, 1, 3}, {0, 1, 2}, {0, 1, 2}, {0, 2, 3}, {1, 2, 3}, {1, 3, 0}}};
  static constexpr std::array<std::uint8_t, 8> kFirstTriangle = {0, 0, 1, 2, 3, 4, 6, 8};
  const auto i = static_cast<std::size_t>(cut);
  return std::span(kCellTriangles)
      .subspan(kFirstTriangle[i], kFirstTriangle[i + 1] - kFirstTriangle[i]);
}

}  // namespace manip3d
