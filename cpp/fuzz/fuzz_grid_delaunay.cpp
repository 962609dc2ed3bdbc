// Triangulation of any pixels: an InputError, or a Delaunay triangulation of their hull; the same
// whether swept at once or inserted one by one.
#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <set>
#include <vector>

#include "checks.hpp"
#include "manip3d/error.hpp"
#include "manip3d/simplify/grid_delaunay.hpp"
#include "mesh_from_bytes.hpp"

namespace {

using namespace manip3d;
using fuzzing::require;

using Corners = std::array<Pixel, 3>;

std::set<Corners> faces_of(const GridDelaunay& delaunay) {
  std::set<Corners> faces;
  for (std::int32_t t = 0; t < delaunay.num_faces(); ++t) {
    Corners c{};
    for (std::size_t i = 0; i < 3; ++i) {
      c[i] = delaunay.pixels()[delaunay.triangle(t)[i]];
    }
    require((c[1].u - c[0].u) * std::int64_t{c[2].v - c[0].v} >
            (c[1].v - c[0].v) * std::int64_t{c[2].u - c[0].u});
    std::rotate(c.begin(), std::min_element(c.begin(), c.end()), c.end());
    faces.insert(c);
  }
  return faces;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  fuzzing::Bytes bytes(data, std::min<std::size_t>(size, 1024));
  // Small sides make cocircular and collinear pixels the rule.
  const std::int32_t side = std::int32_t{1} << (bytes.take<std::uint8_t>() % 15);
  std::vector<Pixel> pixels = {{0, 0}, {side - 1, 0}, {0, side - 1}, {side - 1, side - 1}};
  if (bytes.take<std::uint8_t>() % 2 == 0) pixels.clear();
  const std::size_t corners = pixels.size();
  while (!bytes.empty()) {
    const auto u = bytes.take<std::uint16_t>(), v = bytes.take<std::uint16_t>();
    pixels.push_back({u % side, v % side});
  }
  GridDelaunay swept;
  try {
    swept.triangulate(pixels);
  } catch (const InputError&) {
  }
  GridDelaunay inserted;
  if (corners > 0 && side > 1) {
    inserted.triangulate(std::span(pixels).first(corners));
    for (const Pixel& pixel : pixels) require(inserted.insert(pixel) >= 0);
  }
  std::sort(pixels.begin(), pixels.end());
  pixels.erase(std::unique(pixels.begin(), pixels.end()), pixels.end());
  swept.triangulate(pixels);
  require(swept.num_faces() <= 2 * static_cast<std::int32_t>(pixels.size()));
  const std::set<Corners> faces = faces_of(swept);
  if (corners > 0 && side > 1) require(faces == faces_of(inserted));
  return 0;
}
