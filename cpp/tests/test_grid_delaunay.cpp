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

void expect_consistent(const GridDelaunay& delaunay) {
  for (std::int32_t t = 0; t < delaunay.num_faces(); ++t) {
    for (int i = 0; i < 3; ++i) {
      const std::int32_t other = delaunay.neighbor(t, i);
      if (other < 0) continue;
      const std::array<int, 3> sides = {0, 1, 2};
      EXPECT_TRUE(std::any_of(sides.begin(), sides.end(),
                              [&](int side) { return delaunay.neighbor(other, side) == t; }));
    }
  }
}

// The triangulation is unique, so that pixels inserted one by one must lead to the same one.
TEST(GridDelaunay, InsertingGivesWhatTheSweepGives) {
  std::mt19937 random(5);
  for (int round = 0; round < 60; ++round) {
    const auto width = static_cast<std::int32_t>(2 + random() % 20);
    const auto height = static_cast<std::int32_t>(2 + random() % 20);
    std::vector<Pixel> all = choose(random, width, height, 1 + random() % 5);
    const std::vector<Pixel> corners = {
        {0, 0}, {width - 1, 0}, {0, height - 1}, {width - 1, height - 1}};
    GridDelaunay inserted;
    inserted.triangulate(corners);
    all.insert(all.end(), corners.begin(), corners.end());
    std::shuffle(all.begin(), all.end(), random);
    for (const Pixel& pixel : all) {
      const std::set<Corners> before = faces_of(inserted);
      const auto known = static_cast<std::int32_t>(inserted.pixels().size());
      const std::int32_t vertex = inserted.insert(pixel);
      ASSERT_GE(vertex, 0);
      EXPECT_EQ(inserted.pixels()[vertex], pixel);
      EXPECT_EQ(vertex == known, !inserted.changed().empty());
      std::set<std::int32_t> star;
      for (std::int32_t t = 0; t < inserted.num_faces(); ++t) {
        const auto triangle = inserted.triangle(t);
        if (std::count(triangle.begin(), triangle.end(), vertex) > 0) star.insert(t);
      }
      const auto changed = inserted.changed();
      if (vertex == known) {
        EXPECT_EQ(std::set<std::int32_t>(changed.begin(), changed.end()), star);
        EXPECT_EQ(changed.size(), star.size());
      } else {
        EXPECT_EQ(faces_of(inserted), before);
      }
    }
    std::sort(all.begin(), all.end());
    all.erase(std::unique(all.begin(), all.end()), all.end());
    GridDelaunay swept;
    swept.triangulate(all);
    EXPECT_EQ(faces_of(inserted), faces_of(swept));
    expect_consistent(inserted);
    expect_consistent(swept);
  }
}

TEST(GridDelaunay, InsertRefusesWhatLiesOutside) {
  GridDelaunay delaunay;
  EXPECT_EQ(delaunay.insert({3, 3}), -1);
  delaunay.triangulate(std::vector<Pixel>{{2, 2}, {9, 2}, {2, 9}});
  EXPECT_EQ(delaunay.insert({9, 9}), -1);
  EXPECT_EQ(delaunay.insert({1, 5}), -1);
  EXPECT_EQ(delaunay.num_faces(), 1);
  EXPECT_EQ(delaunay.insert({9, 2}), 1);
  EXPECT_EQ(delaunay.insert({2, 5}), 3);  // on the hull
  EXPECT_EQ(delaunay.num_faces(), 2);
  EXPECT_EQ(delaunay.changed().size(), 2U);
  EXPECT_THROW(delaunay.insert({-1, 0}), InputError);
}

TEST(GridDelaunay, LocatesPixels) {
  std::mt19937 random(6);
  GridDelaunay delaunay;
  delaunay.triangulate(choose(random, 30, 20, 6));
  for (std::int32_t t = 0; t < delaunay.num_faces(); ++t) {
    const auto corners = delaunay.triangle(t);
    Pixel sum{0, 0};
    for (const std::int32_t i : corners) {
      sum.u += delaunay.pixels()[i].u;
      sum.v += delaunay.pixels()[i].v;
    }
    if (sum.u % 3 != 0 || sum.v % 3 != 0) continue;  // the centroid is a pixel, and inside
    for (std::int32_t start = 0; start < delaunay.num_faces(); start += 7) {
      EXPECT_EQ(delaunay.locate({sum.u / 3, sum.v / 3}, start), t);
    }
  }
  EXPECT_EQ(delaunay.locate({16383, 0}, 0), -1);
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
