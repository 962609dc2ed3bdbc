#include "manip3d/modify/segmentation.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>
#include <string>
#include <utility>

#include "geometry/constants.hpp"
#include "manip3d/error.hpp"
#include "manip3d/modify/joint_smoother.hpp"
#include "modify/bone_table.hpp"
#include "modify/pixel_bounds.hpp"
#include "modify/ray_at.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kTile = 8;  // pixels; a row of a tile's mask is one 64-bit word
constexpr std::size_t kTilePoints = 64;

/// Number of pixels from one row of the mask to the next: the columns, rounded up to whole tiles.
std::int64_t stride_of(std::int64_t cols) { return (cols + kTile - 1) / kTile * kTile; }

struct DepthBounds {
  float near = 0.0F, far = 0.0F;
};

DepthBounds depth_bounds(const Skeleton& skeleton, bool by_index, const PersonMaskOptions& o) {
  check_options(o);
  const DepthBounds bounds{static_cast<float>(o.near), static_cast<float>(o.far)};
  if (by_index) return bounds;
  float nearest = kInfinityF, farthest = -kInfinityF;
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    if (!is_usable(skeleton, static_cast<Joint>(joint))) continue;
    nearest = std::min(nearest, skeleton.positions[joint].z());
    farthest = std::max(farthest, skeleton.positions[joint].z());
  }
  const auto margin = static_cast<float>(o.margin);
  // Empty (near > far) if the joints lie outside the bounds.
  const float near = std::max(bounds.near, nearest - margin);
  const float far = std::min(bounds.far, farthest + margin);
  return near <= far ? DepthBounds{near, far} : DepthBounds{bounds.far, bounds.near};
}

/// One image row of the person's mask, 0 or 1.
class MaskRow {
 public:
  MaskRow(const DepthView& depth, const std::uint8_t* body_index, std::uint8_t body,
          const DepthBounds& bounds)
      : depth_(depth), body_index_(body_index), body_(body), bounds_(bounds) {
    // A missing measurement is 0, which is below any bound.
    near_mm_ = static_cast<std::uint16_t>(std::max(1.0F, std::ceil(1000.0F * bounds.near)));
    far_mm_ = static_cast<std::uint16_t>(std::max(0.0F, std::floor(1000.0F * bounds.far)));
  }

  void fill(std::int64_t v, std::uint8_t* mask) const {
    const std::int64_t first = v * depth_.cols;
    if (depth_.millimetres != nullptr) {
      const std::uint16_t* z = depth_.millimetres + first;
      const std::uint16_t near = near_mm_, far = far_mm_;
      for (std::int64_t u = 0; u < depth_.cols; ++u) {
        mask[u] = static_cast<std::uint8_t>((z[u] >= near) & (z[u] <= far));
      }
    } else {
      const float* z = depth_.metres + first;
      const DepthBounds b = bounds_;
      for (std::int64_t u = 0; u < depth_.cols; ++u) {
        mask[u] = static_cast<std::uint8_t>((z[u] >= b.near) & (z[u] <= b.far) & (z[u] > 0.0F));
      }
    }
    if (body_index_ == nullptr) return;
    const std::uint8_t* index = body_index_ + first;
    const std::uint8_t body = body_;
    if (body == kNoBody) {
      for (std::int64_t u = 0; u < depth_.cols; ++u) {
        mask[u] &= static_cast<std::uint8_t>(index[u] != kNoBody);
      }
    } else {
      for (std::int64_t u = 0; u < depth_.cols; ++u) {
        mask[u] &= static_cast<std::uint8_t>(index[u] == body);
      }
    }
  }

 private:
  DepthView depth_;
  const std::uint8_t* body_index_;
  std::uint8_t body_;
  DepthBounds bounds_;
  std::uint16_t near_mm_ = 0, far_mm_ = 0;
};

std::uint64_t load_word(const std::uint8_t* bytes) {
  std::uint64_t word;
  std::memcpy(&word, bytes, sizeof word);
  return word;
}

/// Appends pixels to the points and keeps track of their box.
class Collector {
 public:
  Collector(const DepthView& depth, const PixelRays& rays, PersonPoints& points)
      : depth_(depth), rays_(rays), points_(points) {
    points_.count = 0;
    points_.tile_start.clear();
  }

  void start_tile() { points_.tile_start.push_back(static_cast<std::int32_t>(points_.count)); }
  void end_tile() {
    if (points_.tile_start.back() == points_.count) points_.tile_start.pop_back();
  }

  void add(std::int64_t u, std::int64_t v) {
    const std::int64_t pixel = v * depth_.cols + u;
    const float z = depth_.at(pixel);
    if (!has_ray(rays_, u, v)) return;
    const Eigen::Vector3f p = lift(rays_, u, v, z);
    const std::size_t i = points_.count++;
    points_.x[i] = p.x();
    points_.y[i] = p.y();
    points_.z[i] = z;
    points_.pixel[i] = static_cast<std::int32_t>(pixel);
    bounds_.add(u, v);
  }

  void finish() {
    points_.tile_start.push_back(static_cast<std::int32_t>(points_.count));
    points_.box = bounds_.box();
  }

 private:
  const DepthView& depth_;
  const PixelRays& rays_;
  PersonPoints& points_;
  PixelBounds bounds_;
};

/// The points of one tile with their nearest bones so far, padded to whole words.
struct Tile {
  std::size_t count = 0;  ///< Padded to a multiple of 8.
  alignas(32) std::array<float, kTilePoints> x, y, z;
  /// Measure of the nearest bone (BoneTable::judged()).
  alignas(32) std::array<float, kTilePoints> nearest;
  alignas(32) std::array<float, kTilePoints> squared;  ///< Squared distance to its line.
  alignas(32) std::array<float, kTilePoints> skin;     ///< Distance to its skin.
  alignas(32) std::array<std::int32_t, kTilePoints> label;

  void load(const PersonPoints& points, std::size_t begin, std::size_t end) {
    const std::size_t used = end - begin;
    count = (used + 7) / 8 * 8;
    std::copy_n(&points.x[begin], used, x.begin());
    std::copy_n(&points.y[begin], used, y.begin());
    std::copy_n(&points.z[begin], used, z.begin());
    for (std::size_t i = used; i < count; ++i) {
      x[i] = x[used - 1], y[i] = y[used - 1], z[i] = z[used - 1];
    }
    for (std::size_t i = 0; i < count; ++i) {
      nearest[i] = squared[i] = skin[i] = kInfinityF;
      label[i] = 0;
    }
  }

  /// Without radii, squared distances are compared, because different squares may have the same
  /// square root.
  template <bool kHasRadii>
  void measure(const BoneTable& bones, std::size_t bone) {
    const std::int32_t number = bones.label[bone];
    for (std::size_t i = 0; i < count; ++i) {
      float along;
      const float d = bones.squared_distance(bone, x[i], y[i], z[i], along);
      const float distance = std::sqrt(d);
      const float judged = kHasRadii ? bones.judged(bone, distance, along) : d;
      const bool nearer = judged < nearest[i];
      nearest[i] = nearer ? judged : nearest[i];
      squared[i] = nearer ? d : squared[i];
      const float thick = bones.radius[bone] + along * bones.taper[bone];
      skin[i] = nearer ? distance - thick : skin[i];
      label[i] = nearer ? number : label[i];
    }
  }

  void store(PersonPoints& points, std::size_t begin, std::size_t end) const {
    for (std::size_t i = begin; i < end; ++i) {
      points.squared_distance[i] = squared[i - begin];
      points.skin_distance[i] = skin[i - begin];
      points.label[i] = static_cast<std::uint8_t>(label[i - begin]);
    }
  }
};

/// Finds the bones that may be nearest to some point of a tile, whose points lie within r of c: a
/// bone is a candidate if the lower bound of its measure at some point is not above the upper bound
/// of another bone's measure at all points. Certainties change along a bone; the end that favours
/// the bone bounds the minimum, the other end the maximum.
class Candidates {
 public:
  explicit Candidates(const BoneTable& bones) : bones_(bones) {}

  template <typename Use>
  void for_each(const Tile& tile, const Use& use) {
    const auto [x0, x1] = std::minmax_element(tile.x.begin(), tile.x.begin() + tile.count);
    const auto [y0, y1] = std::minmax_element(tile.y.begin(), tile.y.begin() + tile.count);
    const auto [z0, z1] = std::minmax_element(tile.z.begin(), tile.z.begin() + tile.count);
    const float wx = *x1 - *x0, wy = *y1 - *y0, wz = *z1 - *z0;
    const float cx = 0.5F * (*x0 + *x1), cy = 0.5F * (*y0 + *y1), cz = 0.5F * (*z0 + *z1);
    const float r = 0.5F * std::sqrt(wx * wx + wy * wy + wz * wz);
    float most = kInfinityF;
    constexpr float kRounding = 1e-4F;  // metres; far above the rounding errors of these floats
    for (std::size_t i = 0; i < bones_.count; ++i) {
      float along;
      const float bone = std::sqrt(bones_.squared_distance(i, cx, cy, cz, along));
      const float skin = bone - (bones_.radius[i] + along * bones_.taper[i]);
      const float reach = bones_.slope[i] * r + kRounding;
      const auto [low, high] =
          std::minmax({bones_.certainty[i], bones_.certainty[i] + bones_.firmer[i]});
      const auto [gain_low, gain_high] = outlier_gains(i);
      const float near = skin - reach, far = skin + reach;
      least_[i] = std::max(near * (near > 0.0F ? low : high), near - gain_high);
      most = std::min(most, std::max(far * (far > 0.0F ? high : low), far - gain_low));
    }
    for (std::size_t i = 0; i < bones_.count; ++i) {
      if (!(least_[i] > most)) use(i);
    }
  }

 private:
  /// The smallest and the largest amount by which the outer radius exceeds the radius.
  [[nodiscard]] std::pair<float, float> outlier_gains(std::size_t i) const {
    const float start = bones_.outer[i] - bones_.radius[i];
    return std::minmax({start, start + bones_.widens[i] - bones_.taper[i]});
  }

  const BoneTable& bones_;
  BoneTable::Column least_{};
};

}  // namespace

void check_options(const PersonMaskOptions& o) {
  if (o.near >= 0.0 && o.near < o.far && o.far <= 65.0 && o.margin >= 0.0) return;
  throw InputError("near, far, margin: expected 0 <= near < far <= 65 and margin >= 0, got " +
                   number_text(o.near) + ", " + number_text(o.far) + " and " +
                   number_text(o.margin));
}

void PersonPoints::resize(std::int64_t num_rows, std::int64_t num_cols) {
  set_shape(num_rows, num_cols);
  make_room(rows * cols);
}

void PersonPoints::set_shape(std::int64_t num_rows, std::int64_t num_cols) {
  rows = num_rows;
  cols = num_cols;
  mask.assign(rows * stride_of(cols), 0);
  tile_start.reserve((rows / kTile + 1) * (cols / kTile + 1) + 1);
  count = 0;
  box = {};
}

void PersonPoints::make_room(std::int64_t num_points) {
  const std::size_t size = num_points;
  if (size <= x.size()) return;
  for (std::vector<float>* column : {&x, &y, &z, &squared_distance, &skin_distance})
    column->resize(size);
  pixel.resize(size);
  label.resize(size);
}

void find_person(const DepthView& depth, const std::uint8_t* body_index, const Skeleton& skeleton,
                 const PixelRays& rays, const PersonMaskOptions& options, PersonPoints& points) {
  if (depth.rows != rays.height() || depth.cols != rays.width()) {
    throw InputError("depth: expected shape (" + std::to_string(rays.height()) + ", " +
                     std::to_string(rays.width()) + ") as the intrinsics say, got (" +
                     std::to_string(depth.rows) + ", " + std::to_string(depth.cols) + ")");
  }
  if (points.rows != depth.rows || points.cols != depth.cols) {
    points.set_shape(depth.rows, depth.cols);
  }
  const bool by_index = body_index != nullptr && skeleton.body != kNoBody;
  const MaskRow row(depth, body_index, skeleton.body, depth_bounds(skeleton, by_index, options));
  const std::int64_t stride = stride_of(depth.cols);
  for (std::int64_t v = 0; v < depth.rows; ++v) row.fill(v, points.mask.data() + v * stride);
  points.make_room(std::reduce(points.mask.begin(), points.mask.end(), std::int64_t{0}));
  Collector collector(depth, rays, points);
  for (std::int64_t v0 = 0; v0 < depth.rows; v0 += kTile) {
    const std::int64_t height = std::min(kTile, depth.rows - v0);
    for (std::int64_t u0 = 0; u0 < depth.cols; u0 += kTile) {
      collector.start_tile();
      for (std::int64_t v = 0; v < height; ++v) {
        const std::uint8_t* mask = points.mask.data() + (v0 + v) * stride + u0;
        if (load_word(mask) == 0) continue;
        for (std::int64_t u = 0; u < kTile; ++u) {
          if (mask[u] != 0) collector.add(u0 + u, v0 + v);
        }
      }
      collector.end_tile();
    }
  }
  collector.finish();
}

void segment_bones(const BoneSegments& bones, PersonPoints& points) {
  const BoneTable table(bones);
  Candidates candidates(table);
  Tile tile;
  for (std::size_t i = 0; i + 1 < points.tile_start.size(); ++i) {
    const std::size_t begin = points.tile_start[i];
    const std::size_t end = points.tile_start[i + 1];
    tile.load(points, begin, end);
    candidates.for_each(tile, [&](std::size_t bone) {
      table.has_radii ? tile.measure<true>(table, bone) : tile.measure<false>(table, bone);
    });
    tile.store(points, begin, end);
  }
}

LabelImage label_image(const PersonPoints& points) {
  const auto size = static_cast<std::size_t>(points.rows * points.cols);
  LabelImage image{std::vector<std::uint8_t>(size), std::vector<float>(size, kInfinityF)};
  for (std::int64_t i = 0; i < points.count; ++i) {
    const std::size_t pixel = points.pixel[i];
    image.labels[pixel] = points.label[i];
    image.distances[pixel] = std::sqrt(points.squared_distance[i]);
  }
  return image;
}

}  // namespace manip3d
