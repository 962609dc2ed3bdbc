#include "modify/surroundings.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "manip3d/modify/limb.hpp"
#include "modify/phantom_image.hpp"
#include "modify/pixel_bounds.hpp"

namespace manip3d {
namespace {

// Lengths in metres.
constexpr float kAtSkin = 0.05F;         // errors of girths and joints, and thin clothes
constexpr float kMaxBesideSkin = 0.15F;  // loose clothes, hair, and joints that jumped

enum Mark : std::uint8_t { kNothing, kPerhaps, kPerson };

/// The person's mask, whose rows are padded to whole tiles, indexed by pixels of the image.
class Marks {
 public:
  explicit Marks(PersonPoints& points)
      : mask_(points.mask.data()), cols_(points.cols), stride_((points.cols + 7) / 8 * 8) {}
  std::uint8_t& operator[](std::int32_t pixel) {
    return mask_[pixel / cols_ * stride_ + pixel % cols_];
  }

 private:
  std::uint8_t* mask_;
  std::int64_t cols_, stride_;
};

/// Height above a floor up to which points belong to the floor.
float top_of(const FloorPlane& floor) {
  // Standard deviations; metres.
  constexpr float kSure = 3.0F, kThinnest = 0.015F, kThickest = 0.05F;
  return std::clamp(kSure * floor.noise, kThinnest, kThickest);
}

/// Keeps the points of marked pixels, tile by tile.
void keep_marked(Marks& marks, PersonPoints& points) {
  std::int64_t kept = 0;
  std::size_t tiles = 0;
  PixelBounds bounds;
  for (std::size_t tile = 0; tile + 1 < points.tile_start.size(); ++tile) {
    const std::int32_t begin = points.tile_start[tile], end = points.tile_start[tile + 1];
    const auto first = static_cast<std::int32_t>(kept);
    for (std::int32_t i = begin; i < end; ++i) {
      if (marks[points.pixel[i]] != kPerson) continue;
      points.x[kept] = points.x[i], points.y[kept] = points.y[i], points.z[kept] = points.z[i];
      points.pixel[kept] = points.pixel[i];
      points.label[kept] = points.label[i];
      points.squared_distance[kept] = points.squared_distance[i];
      points.skin_distance[kept] = points.skin_distance[i];
      ++kept;
      bounds.add(points.pixel[i] % points.cols, points.pixel[i] / points.cols);
    }
    if (kept > first) points.tile_start[tiles++] = first;
  }
  points.tile_start.resize(tiles);
  points.tile_start.push_back(static_cast<std::int32_t>(kept));
  points.count = kept;
  points.box = bounds.box();
}

}  // namespace

void drop_surroundings(const DepthView& depth, const BoneSegments& bones, Limb affected,
                       float clothes, const std::optional<FloorPlane>& floor, PersonPoints& points,
                       std::vector<std::int32_t>& stack) {
  const auto radii = bones.radii.begin();
  if (std::none_of(radii, radii + static_cast<std::ptrdiff_t>(bones.count),
                   [](const BoneRadii& r) { return r.end > 0.0F; })) {
    return;
  }
  segment_bones(bones, points);
  Marks marks(points);
  const float top = floor ? floor->height - top_of(*floor) : 0.0F;
  std::size_t count = 0;
  const auto add = [&](std::int32_t pixel) {
    marks[pixel] = kPerson;
    stack[count++] = pixel;
  };
  for (std::int64_t i = 0; i < points.count; ++i) {
    const std::int32_t pixel = points.pixel[i];
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    const float skin = points.skin_distance[i];
    const bool is_floor = floor && floor->normal.dot(p) > top;
    const float reach = points.label[i] == limb_label(affected) ? clothes : kMaxBesideSkin;
    marks[pixel] = !is_floor && skin < reach ? kPerhaps : kNothing;
    if (marks[pixel] == kPerhaps && skin < kAtSkin) add(pixel);
  }
  const auto cols = static_cast<std::int32_t>(points.cols);
  const auto size = static_cast<std::int32_t>(points.cols * points.rows);
  while (count > 0) {
    const std::int32_t pixel = stack[--count];
    const std::int32_t u = pixel % cols;
    const float z = depth.at(pixel);
    const auto grow = [&](bool is_inside, std::int32_t beside) {
      if (!is_inside || marks[beside] != kPerhaps) return;
      if (std::abs(depth.at(beside) - z) < kSameSurface) add(beside);
    };
    grow(u > 0, pixel - 1);
    grow(u + 1 < cols, pixel + 1);
    grow(pixel >= cols, pixel - cols);
    grow(pixel + cols < size, pixel + cols);
  }
  keep_marked(marks, points);
}

}  // namespace manip3d
