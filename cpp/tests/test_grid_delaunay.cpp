#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <map>
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

std::int64_t turn(const Pixel& a, const Pixel& b, const Pixel& c) {
  return std::int64_t{b.u - a.u} * (c.v - a.v) - std::int64_t{b.v - a.v} * (c.u - a.u);
}

bool is_between(const Pixel& a, const Pixel& b, const Pixel& p) {
  return turn(a, b, p) == 0 && !(p == a) && !(p == b) &&
         std::int64_t{p.u - a.u} * (p.u - b.u) + std::int64_t{p.v - a.v} * (p.v - b.v) < 0;
}

bool cross(const Pixel& a, const Pixel& b, const Pixel& c, const Pixel& d) {
  const auto differ = [](std::int64_t x, std::int64_t y) {
    return (x < 0 && y > 0) || (x > 0 && y < 0);
  };
  return differ(turn(a, b, c), turn(a, b, d)) && differ(turn(c, d, a), turn(c, d, b));
}

using Ends = std::array<std::int32_t, 2>;

/// The third vertex of the triangle on the left of each edge.
std::map<Ends, std::int32_t> left_of_edges(const GridDelaunay& delaunay) {
  std::map<Ends, std::int32_t> left;
  for (std::int32_t t = 0; t < delaunay.num_faces(); ++t) {
    const auto [a, b, c] = delaunay.triangle(t);
    for (const auto& [from, to, beside] :
         {std::array{a, b, c}, std::array{b, c, a}, std::array{c, a, b}}) {
      EXPECT_TRUE(left.emplace(Ends{from, to}, beside).second);
    }
  }
  return left;
}

std::int64_t doubled_area(const GridDelaunay& delaunay) {
  std::int64_t sum = 0;
  for (std::int32_t t = 0; t < delaunay.num_faces(); ++t) {
    const auto [a, b, c] = delaunay.triangle(t);
    const std::int64_t area =
        turn(delaunay.pixels()[a], delaunay.pixels()[b], delaunay.pixels()[c]);
    EXPECT_GT(area, 0);
    sum += area;
  }
  return sum;
}

/// > 0 if d lies inside the circle through a, b, c.
std::int64_t in_circle(const Pixel& a, const Pixel& b, const Pixel& c, const Pixel& d) {
  const auto lifted = [&](const Pixel& p) {
    return (p.u - d.u) * std::int64_t{p.u - d.u} + (p.v - d.v) * std::int64_t{p.v - d.v};
  };
  return lifted(a) * turn(d, b, c) + lifted(b) * turn(d, c, a) + lifted(c) * turn(d, a, b);
}

TEST(GridDelaunay, HasTheEdgesThatItMustHave) {
  std::mt19937 random(11);
  int num_flipped = 0;
  for (int round = 0; round < 300; ++round) {
    const auto side = static_cast<std::int32_t>(4 + random() % 40);
    const std::vector<Pixel> pixels = choose(random, side, side, 1 + random() % 30);
    GridDelaunay delaunay;
    delaunay.triangulate(pixels);
    const auto before = faces_of(delaunay);
    const std::int64_t area = doubled_area(delaunay);
    if (delaunay.num_faces() == 0) continue;
    std::vector<Ends> wanted, edges;
    for (int i = 0; i < 1 + round % 25; ++i) {
      const auto n = static_cast<std::uint32_t>(pixels.size());
      const Ends ends = {static_cast<std::int32_t>(random() % n),
                         static_cast<std::int32_t>(random() % n)};
      edges.push_back(ends);
      const bool is_free = std::none_of(edges.begin(), edges.end(), [&](const Ends& other) {
        return cross(pixels[ends[0]], pixels[ends[1]], pixels[other[0]], pixels[other[1]]);
      });
      if (is_free) wanted.push_back(ends);
    }
    delaunay.constrain(edges);
    num_flipped += faces_of(delaunay) != before ? 1 : 0;
    EXPECT_EQ(doubled_area(delaunay), area);
    const auto left = left_of_edges(delaunay);
    for (const auto& [a, b] : wanted) {  // its parts between the pixels that lie on it
      std::vector<std::int32_t> on_edge = {a, b};
      for (std::int32_t p = 0; p < static_cast<std::int32_t>(pixels.size()); ++p) {
        if (is_between(pixels[a], pixels[b], pixels[p])) on_edge.push_back(p);
      }
      std::sort(on_edge.begin(), on_edge.end());  // in row-major order, as along any line
      for (std::size_t i = 1; i < on_edge.size(); ++i) {
        const std::int32_t p = on_edge[i - 1], q = on_edge[i];
        EXPECT_TRUE(p == q || left.contains({p, q}) || left.contains({q, p}));
      }
    }
    for (const auto& [ends, beside] : left) {  // other edges are Delaunay
      const auto other = left.find({ends[1], ends[0]});
      if (other == left.end()) continue;
      const Pixel &a = pixels[ends[0]], &b = pixels[ends[1]];
      if (in_circle(a, b, pixels[beside], pixels[other->second]) <= 0) continue;
      EXPECT_TRUE(std::any_of(edges.begin(), edges.end(), [&](const Ends& given) {
        const Pixel &c = pixels[given[0]], &d = pixels[given[1]];
        const auto is_on = [&](const Pixel& p) { return p == c || p == d || is_between(c, d, p); };
        return is_on(a) && is_on(b);
      }));
    }
  }
  EXPECT_GT(num_flipped, 100);
}

TEST(GridDelaunay, RefusesEdgesOfVerticesThatDoNotExist) {
  GridDelaunay delaunay;
  delaunay.triangulate(std::vector<Pixel>{{0, 0}, {1, 0}, {0, 1}});
  EXPECT_THROW(delaunay.constrain(std::vector<Ends>{{0, 3}}), InputError);
  EXPECT_THROW(delaunay.constrain(std::vector<Ends>{{-1, 2}}), InputError);
}

}  // namespace
}  // namespace manip3d
