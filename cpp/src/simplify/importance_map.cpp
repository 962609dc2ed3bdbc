#include "simplify/importance_map.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "geometry/constants.hpp"
#include "manip3d/geometry/parallel.hpp"
#include "simplify/importance_rows.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kPad = 2;  // the widest stencil reads two pixels to each side
constexpr std::int64_t kPointRows = 4, kAreaRows = 5;

// The difference to the next point or, if that is not valid, from the previous one. NaN marks
// invalid points and propagates to everything that depends on them. All values are loaded before
// one is selected, so that the compiler can vectorize the loop.
MANIP3D_INLINE float difference(float before, float here, float after, float z_here,
                                float z_after) {
  const float forward = after - here, backward = here - before;
  const float z_difference = z_after - z_here;
  return choose(z_difference == z_difference, forward, backward);
}

// A(u) of one row (eq. 3.1, 3.2).
void area_row(const PointRow& above_row, const PointRow& row, const PointRow& below_row,
              std::int64_t width, float* __restrict area) {
  const float* __restrict x = row.x, * __restrict y = row.y, * __restrict z = row.z;
  const PointRow above = above_row, below = below_row;
  for (std::int64_t u = 0; u < width; ++u) {
    const float z_right = z[u + 1], z_below = below.z[u];
    const float ax = difference(x[u - 1], x[u], x[u + 1], z[u], z_right);
    const float ay = difference(y[u - 1], y[u], y[u + 1], z[u], z_right);
    const float az = difference(z[u - 1], z[u], z_right, z[u], z_right);
    const float bx = difference(above.x[u], x[u], below.x[u], z[u], z_below);
    const float by = difference(above.y[u], y[u], below.y[u], z[u], z_below);
    const float bz = difference(above.z[u], z[u], z_below, z[u], z_below);
    const float a = area_of(ax, ay, az, bx, by, bz);
    area[u] = choose(a < kInfinityF, a, 0.0F);
  }
}

// Second differences of A at column u by the gradient of the gradient, times 4.
MANIP3D_INLINE Hessian hessian(const AreaRows& a, std::int64_t u) {
  const float middle = 2.0F * a.row[u];
  const float cross = a.down[u + 1] - a.down[u - 1] - a.up[u + 1] + a.up[u - 1];
  return {a.row[u + 2] - middle + a.row[u - 2], a.down2[u] - middle + a.up2[u], cross};
}

template <Cs3Importance importance>
void importance_row(const AreaRows& areas, const float* __restrict z, std::int64_t width,
                    ImportanceKey* __restrict keys) {
  const AreaRows a = areas;
  for (std::int64_t u = 0; u < width; ++u) keys[u] = key_of<importance>(hessian(a, u), z[u]);
}

// A power of two by which coordinates of any unit are scaled so that the squares of A neither
// overflow nor underflow; the significant bits of all results do not change.
float unit_scale(const RangeImage& image, const PixelBox& box, std::vector<float>& scratch) {
  if (image.has_depth() || box.empty()) return 1.0F;
  scratch.resize(3 * box.width);
  float *x = scratch.data(), *y = x + box.width, *z = y + box.width;
  std::array<float, 3> low, high;
  low.fill(kInfinityF);
  high.fill(-kInfinityF);
  const std::int64_t step = std::max<std::int64_t>(1, box.height / 8);
  for (std::int64_t v = 0; v < box.height; v += step) {
    image.load_row(box.v0 + v, box.u0, box.width, x, y, z);
    for (std::size_t c = 0; c < 3; ++c) {
      for (std::int64_t u = 0; u < box.width; ++u) {
        const float value =
            scratch[c * static_cast<std::size_t>(box.width) + static_cast<std::size_t>(u)];
        low[c] = value < low[c] ? value : low[c];
        high[c] = value > high[c] ? value : high[c];
      }
    }
  }
  const float extent = std::max({high[0] - low[0], high[1] - low[1], high[2] - low[2]});
  if (!(extent > 0.0F && extent < kInfinityF)) return 1.0F;
  const float spacing = extent / static_cast<float>(std::max(box.width, box.height));
  return std::ldexp(1.0F, std::clamp(-std::ilogb(spacing), -120, 120));
}

/// The rows that a chunk of the image needs at a time.
class RowPipeline {
 public:
  RowPipeline(const RangeImage& image, const Cs3Options& options, float scale,
              std::vector<float>& scratch, ImportanceMap& map)
      : image_(image),
        options_(options),
        is_kept_(options.reading == Cs3Reading{}),
        scale_(scale),
        map_(map) {
    const std::int64_t length = map.box.width + 2 * kPad;
    const bool unknown = options.reading.beside_invalid == Cs3Reading::BesideInvalid::kUnknown;
    scratch.resize((3 * kPointRows + kAreaRows) * length);
    float* next = scratch.data() + kPad;
    std::fill_n(scratch.data(), 3 * kPointRows * length, kNanF);
    std::fill_n(scratch.data() + 3 * kPointRows * length, kAreaRows * length,
                unknown ? kNanF : 0.0F);
    for (PointRow& row : points_) {
      row = {next, next + length, next + 2 * length};
      next += 3 * length;
    }
    for (float*& row : areas_) {
      row = next;
      next += length;
    }
  }

  /// Computes the map's rows from `begin` to before `end`; returns the largest depth in them.
  float run(std::int64_t begin, std::int64_t end) {
    load(begin - 3);
    load(begin - 2);
    for (std::int64_t v = begin - 2; v < end + 2; ++v) {
      load(v + 1);
      make_area(v);
      if (v - 2 >= begin) make_importance(v - 2);
    }
    return max_depth_;
  }

 private:
  PointRow& points(std::int64_t v) { return points_[(v + kPointRows) % kPointRows]; }
  float*& area(std::int64_t v) { return areas_[(v + kAreaRows) % kAreaRows]; }
  [[nodiscard]] bool is_inside(std::int64_t v) const { return v >= 0 && v < map_.box.height; }

  void load(std::int64_t v) {
    const std::int64_t width = map_.box.width;
    PointRow& row = points(v);
    if (!is_inside(v)) {
      for (float* values : {row.x, row.y, row.z}) std::fill_n(values, width, kNanF);
      return;
    }
    image_.load_row(map_.box.v0 + v, map_.box.u0, width, row.x, row.y, row.z);
    if (options_.distance_dependent) {
      for (std::int64_t u = 0; u < width; ++u) {
        max_depth_ = row.z[u] > max_depth_ ? row.z[u] : max_depth_;
      }
    }
    if (scale_ == 1.0F) return;
    for (float* values : {row.x, row.y, row.z}) {
      for (std::int64_t u = 0; u < width; ++u) values[u] *= scale_;
    }
  }

  void make_area(std::int64_t v) {
    const std::int64_t width = map_.box.width;
    if (is_kept_) {
      area_row(points(v - 1), points(v), points(v + 1), width, area(v));
    } else {
      area_row_by(options_.reading, points(v - 1), points(v), points(v + 1), width, area(v));
    }
  }

  void make_importance(std::int64_t v) {
    const AreaRows rows{area(v - 2), area(v - 1), area(v), area(v + 1), area(v + 2)};
    const std::int64_t width = map_.box.width;
    ImportanceKey* keys = map_.keys.data() + v * map_.stride;
    const float* z = points(v).z;
    if (!is_kept_) {
      importance_row_by(options_, rows, z, width, keys);
    } else if (options_.importance == Cs3Importance::kMinCurvature) {
      importance_row<Cs3Importance::kMinCurvature>(rows, z, width, keys);
    } else {
      importance_row<Cs3Importance::kLaplacian>(rows, z, width, keys);
    }
    for (std::int64_t u = 0; u < width && !map_.hessian_uu.empty(); ++u) {
      const Hessian m = is_kept_ ? hessian(rows, u) : hessian_by(options_.reading, rows, u);
      const std::int64_t slot = v * map_.stride + u;
      map_.hessian_uu[slot] = m.uu;
      map_.hessian_vv[slot] = m.vv;
      map_.hessian_uv[slot] = m.uv;
    }
  }

  const RangeImage& image_;
  const Cs3Options& options_;
  bool is_kept_;  ///< Whether the reading is the default one.
  float scale_;
  ImportanceMap& map_;
  float max_depth_ = 0.0F;
  std::array<PointRow, kPointRows> points_{};
  std::array<float*, kAreaRows> areas_{};
};

}  // namespace

void ImportanceMapper::compute(const RangeImage& image, const Cs3Options& options,
                               ImportanceMap& map) {
  map.box = image.bounds();
  map.stride = (map.box.width + 63) / 64 * 64;
  const std::size_t num_slots = map.stride * map.box.height;
  // Reserves memory for the whole image, so that a box that grows from frame to frame allocates
  // nothing.
  const std::size_t most_slots = (image.cols() + 63) / 64 * 64 * image.rows();
  map.keys.reserve(most_slots);
  map.keys.resize(num_slots);
  const bool with_hessian = options.sampling == Cs3Sampling::kNonMaximum;
  for (auto* values : {&map.hessian_uu, &map.hessian_vv, &map.hessian_uv}) {
    if (with_hessian) values->reserve(most_slots);
    values->resize(with_hessian ? num_slots : 0);
  }
  for (std::int64_t v = 0; v < map.box.height; ++v) {  // slots between the box and the stride
    std::fill(map.keys.begin() + v * map.stride + map.box.width,
              map.keys.begin() + (v + 1) * map.stride, kNoKey);
  }
  // One thread processes all rows at once; several threads process chunks, which compute four rows
  // twice.
  constexpr std::int64_t kRowsPerChunk = 48;
  const std::int64_t chunk =
      options.num_threads == 1 ? std::max<std::int64_t>(1, map.box.height) : kRowsPerChunk;
  const std::size_t num_chunks = (map.box.height + chunk - 1) / chunk;
  if (scratch_.size() < num_chunks) scratch_.resize(num_chunks);
  const std::int64_t most_floats = (3 * kPointRows + kAreaRows) * (image.cols() + 2 * kPad);
  for (auto& scratch : scratch_) scratch.reserve(most_floats);
  max_depths_.assign(num_chunks, 0.0F);
  map.max_depth = 0.0F;
  if (num_chunks == 0) return;
  const float scale = unit_scale(image, map.box, scratch_[0]);
  const auto body = [&](std::int64_t begin, std::int64_t end) {
    const std::size_t i = begin / chunk;
    max_depths_[i] = RowPipeline(image, options, scale, scratch_[i], map).run(begin, end);
  };
  if (num_chunks == 1) {
    body(0, map.box.height);
  } else {
    parallel_chunks(map.box.height, chunk, options.num_threads, body);
  }
  map.max_depth = *std::max_element(max_depths_.begin(), max_depths_.end());
}

}  // namespace manip3d
