#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <random>
#include <set>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/simplify/grid_delaunay.hpp"

namespace manip3d {
namespace {

using Corners = std::array<Pixel, 3>;

std::set<Corners> faces_of(const GridDelaunay& delaunay) {
  std::set<Corners> faces;
  for (std::int32_t t = 0; t < delaunay.num_faces(); ++t) {
    Corners corners{};
    for (std::size_t i = 0; i < 3; ++i) {
      corners[i] = delaunay.pixels()[delaunay.triangle(t)[i]];
    }
    std::rotate(corners.begin(), std::min_element(corners.begin(), corners.end()), corners.end());
    faces.insert(corners);
  }
  return faces;
}

std::vector<Pixel> choose(std::mt19937& random, std::int32_t width, std::int32_t height,
                          std::uint32_t one_in) {
  std::vector<Pixel> pixels;
  for (std::int32_t v = 0; v < height; ++v) {
    for (std::int32_t u = 0; u < width; ++u) {
      if (random() % one_in == 0) pixels.push_back({u, v});
    }
  }
  return pixels;
}

TEST(GridDelaunay, ForgetsTheLastTriangulation) {
  std::mt19937 random(7);
  GridDelaunay reused;
  for (int round = 0; round < 20; ++round) {
    const std::vector<Pixel> pixels = choose(random, 25, 25, 1 + random() % 30);
    GridDelaunay fresh;
    fresh.triangulate(pixels);
    reused.triangulate(pixels);
    EXPECT_EQ(faces_of(reused), faces_of(fresh));
  }
}

TEST(GridDelaunay, RefusesUnorderedPixels) {
  GridDelaunay delaunay;
  EXPECT_THROW(delaunay.triangulate(std::vector<Pixel>{{1, 0}, {0, 0}}), InputError);
  EXPECT_THROW(delaunay.triangulate(std::vector<Pixel>{{0, 1}, {5, 0}}), InputError);
  EXPECT_THROW(delaunay.triangulate(std::vector<Pixel>{{0, 0}, {0, 0}}), InputError);
  EXPECT_THROW(delaunay.triangulate(std::vector<Pixel>{{0, 16384}}), InputError);
}

}  // namespace
}  // namespace manip3d
