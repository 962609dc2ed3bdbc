#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <vector>

#include "geometry/cell_cut.hpp"

namespace manip3d {
namespace {

using Face = std::array<int, 3>;

// The faces of a cell by brute force: of its valid corners in their order, or, with four valid
// ones, of two triangles along the chosen diagonal.
std::vector<Face> expected(unsigned valid, bool from_0_to_2) {
  std::vector<int> corners;
  for (int i = 0; i < 4; ++i) {
    if ((valid >> i & 1U) != 0) corners.push_back(i);
  }
  if (corners.size() < 3) return {};
  if (corners.size() == 3) return {{corners[0], corners[1], corners[2]}};
  if (from_0_to_2) return {{0, 1, 2}, {0, 2, 3}};
  return {{1, 2, 3}, {1, 3, 0}};
}

TEST(CellCut, AllCells) {
  for (unsigned valid = 0; valid < 16; ++valid) {
    // length of the diagonal from 0 to 2; the other diagonal has 2
    for (const int first : {1, 2, 3}) {
      int asked = 0;
      const CellCut cut = cut_cell(valid, [&](int i, int j) {
        ++asked;
        EXPECT_EQ(j - i, 2);
        return i == 0 ? first : 2;
      });
      EXPECT_EQ(asked, valid == 15 ? 2 : 0);
      std::vector<Face> faces;
      for (const auto& [a, b, c] : cell_triangles(cut)) faces.push_back({a, b, c});
      EXPECT_EQ(faces, expected(valid, first <= 2)) << valid << ' ' << first;
    }
  }
}

// A cell at column 1, row 2 of a grid of 5 columns, seen with rows up and with rows down.
TEST(CellCut, CornersGoRoundAsFrontFacesDo) {
  EXPECT_EQ(cell_corners(11, 5, true), (std::array<std::int64_t, 4>{11, 12, 17, 16}));
  EXPECT_EQ(cell_corners(11, 5, false), (std::array<std::int64_t, 4>{11, 16, 17, 12}));
}

}  // namespace
}  // namespace manip3d
