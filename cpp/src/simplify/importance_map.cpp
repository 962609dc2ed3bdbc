#include "simplify/importance_map.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "manip3d/geometry/parallel.hpp"

namespace manip3d {
namespace {

using Stencil = Cs3Reading::Stencil;
using BesideInvalid = Cs3Reading::BesideInvalid;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr std::int64_t kPad = 2;  // the widest stencil reads two pixels to each side
constexpr std::int64_t kPointRows = 4, kAreaRows = 5;

struct PointRow {
  float *x, *y, *z;
};

// A(u) of one row (eq. 3.1, 3.2). Differences go forward; where the pixel they need is not valid,
// backward. NaN, the mark of an invalid pixel, spreads to all that depends on it.
template <BesideInvalid beside>
void area_row(const PointRow& above, const PointRow& row, const PointRow& below, std::int64_t width,
              float* area) {
  for (std::int64_t u = 0; u < width; ++u) {
    float ax = row.x[u + 1] - row.x[u], ay = row.y[u + 1] - row.y[u], az = row.z[u + 1] - row.z[u];
    float bx = below.x[u] - row.x[u], by = below.y[u] - row.y[u], bz = below.z[u] - row.z[u];
    if constexpr (beside == BesideInvalid::kBackward) {
      const bool no_right = az != az, no_below = bz != bz;
      ax = no_right ? row.x[u] - row.x[u - 1] : ax;
      ay = no_right ? row.y[u] - row.y[u - 1] : ay;
      az = no_right ? row.z[u] - row.z[u - 1] : az;
      bx = no_below ? row.x[u] - above.x[u] : bx;
      by = no_below ? row.y[u] - above.y[u] : by;
      bz = no_below ? row.z[u] - above.z[u] : bz;
    }
    const float nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
    const float length_n = std::sqrt(nx * nx + ny * ny + nz * nz);
    const float a = length_n / ((ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz));
    area[u] = a < kInfinity ? a : (beside == BesideInvalid::kUnknown ? kNan : 0.0F);
  }
}

struct Hessian {
  float uu, vv, uv;
};

// Second differences of A around column u of the middle one of five rows.
template <Stencil stencil>
Hessian hessian(const std::array<const float*, kAreaRows>& rows, std::int64_t u) {
  const auto a = [&](std::int64_t du, int dv) {
    return rows[static_cast<std::size_t>(2 + dv)][u + du];
  };
  const float cross = a(1, 1) - a(-1, 1) - a(1, -1) + a(-1, -1);
  if constexpr (stencil == Stencil::kGradientOfGradient) {
    const float middle = 2.0F * a(0, 0);
    return {a(2, 0) - middle + a(-2, 0), a(0, 2) - middle + a(0, -2), cross};  // all times 4
  } else if constexpr (stencil == Stencil::kCompact) {
    const float middle = 2.0F * a(0, 0);
    return {a(1, 0) - middle + a(-1, 0), a(0, 1) - middle + a(0, -1), 0.25F * cross};
  } else if constexpr (stencil == Stencil::kForward) {
    return {a(2, 0) - 2.0F * a(1, 0) + a(0, 0), a(0, 2) - 2.0F * a(0, 1) + a(0, 0),
            a(1, 1) - a(1, 0) - a(0, 1) + a(0, 0)};
  } else {
    const float corners = a(1, 1) + a(-1, 1) + a(1, -1) + a(-1, -1);
    const float sides_u = a(1, 0) + a(-1, 0), sides_v = a(0, 1) + a(0, -1);
    const float middle = 4.0F * a(0, 0);
    return {corners + 2.0F * (sides_u - sides_v) - middle,
            corners + 2.0F * (sides_v - sides_u) - middle, cross};
  }
}

// Omega(u); what cannot be known counts as flat.
template <Cs3Importance importance>
float importance_of(const Hessian& m) {
  float omega = m.uu + m.vv;
  if constexpr (importance == Cs3Importance::kMinCurvature) {
    const float mean = 0.5F * (m.uu + m.vv), half = 0.5F * (m.uu - m.vv);
    omega = std::abs(mean - std::sqrt(half * half + m.uv * m.uv));
  }
  return std::abs(omega) < kInfinity ? omega + 0.0F : 0.0F;  // + 0: no negative zero
}

template <Stencil stencil, Cs3Importance importance>
void importance_row(const std::array<const float*, kAreaRows>& areas, const float* z,
                    std::int64_t width, ImportanceKey* keys) {
  for (std::int64_t u = 0; u < width; ++u) {
    const ImportanceKey key = to_key(importance_of<importance>(hessian<stencil>(areas, u)));
    keys[u] = z[u] == z[u] ? key : kNoKey;
  }
}

template <Stencil stencil>
void hessian_row(const std::array<const float*, kAreaRows>& areas, std::int64_t width,
                 std::int64_t slot, ImportanceMap& map) {
  for (std::int64_t u = 0; u < width; ++u) {
    const Hessian m = hessian<stencil>(areas, u);
    const auto i = static_cast<std::size_t>(slot + u);
    map.hessian_uu[i] = m.uu;
    map.hessian_vv[i] = m.vv;
    map.hessian_uv[i] = m.uv;
  }
}

// A power of two that brings coordinates of any unit to a size where the squares of A neither
// overflow nor vanish; the significant bits of all results stay as they are.
float unit_scale(const RangeImage& image, const PixelBox& box, std::vector<float>& scratch) {
  if (image.has_depth() || box.empty()) return 1.0F;
  scratch.resize(static_cast<std::size_t>(3 * box.width));
  float *x = scratch.data(), *y = x + box.width, *z = y + box.width;
  std::array<float, 3> low, high;
  low.fill(kInfinity);
  high.fill(-kInfinity);
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
  if (!(extent > 0.0F && extent < kInfinity)) return 1.0F;
  const float spacing = extent / static_cast<float>(std::max(box.width, box.height));
  return std::ldexp(1.0F, std::clamp(-std::ilogb(spacing), -120, 120));
}

/// The rows that one chunk of the image needs at a time.
class RowPipeline {
 public:
  RowPipeline(const RangeImage& image, const Cs3Options& options, float scale,
              std::vector<float>& scratch, ImportanceMap& map)
      : image_(image), options_(options), scale_(scale), map_(map) {
    const std::int64_t length = map.box.width + 2 * kPad;
    const bool unknown = options.reading.beside_invalid == BesideInvalid::kUnknown;
    scratch.resize(static_cast<std::size_t>((3 * kPointRows + kAreaRows) * length));
    float* next = scratch.data() + kPad;
    std::fill_n(scratch.data(), 3 * kPointRows * length, kNan);
    std::fill_n(scratch.data() + 3 * kPointRows * length, kAreaRows * length,
                unknown ? kNan : 0.0F);
    for (PointRow& row : points_) {
      row = {next, next + length, next + 2 * length};
      next += 3 * length;
    }
    for (float*& row : areas_) {
      row = next;
      next += length;
    }
  }

  /// Makes the map's rows from `begin` to before `end`; returns the largest depth in them.
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
  PointRow& points(std::int64_t v) {
    return points_[static_cast<std::size_t>((v + kPointRows) % kPointRows)];
  }
  float*& area(std::int64_t v) {
    return areas_[static_cast<std::size_t>((v + kAreaRows) % kAreaRows)];
  }
  [[nodiscard]] bool is_inside(std::int64_t v) const { return v >= 0 && v < map_.box.height; }

  void load(std::int64_t v) {
    const std::int64_t width = map_.box.width;
    PointRow& row = points(v);
    if (!is_inside(v)) {
      for (float* values : {row.x, row.y, row.z}) std::fill_n(values, width, kNan);
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
    switch (options_.reading.beside_invalid) {
      case BesideInvalid::kBackward:
        return make<BesideInvalid::kBackward>(v);
      case BesideInvalid::kZero:
        return make<BesideInvalid::kZero>(v);
      case BesideInvalid::kUnknown:
        return make<BesideInvalid::kUnknown>(v);
    }
  }

  template <BesideInvalid beside>
  void make(std::int64_t v) {
    area_row<beside>(points(v - 1), points(v), points(v + 1), map_.box.width, area(v));
  }

  void make_importance(std::int64_t v) {
    switch (options_.reading.stencil) {
      case Stencil::kGradientOfGradient:
        return make<Stencil::kGradientOfGradient>(v);
      case Stencil::kCompact:
        return make<Stencil::kCompact>(v);
      case Stencil::kForward:
        return make<Stencil::kForward>(v);
      case Stencil::kSobel:
        return make<Stencil::kSobel>(v);
    }
  }

  template <Stencil stencil>
  void make(std::int64_t v) {
    const std::array<const float*, kAreaRows> rows = {area(v - 2), area(v - 1), area(v),
                                                      area(v + 1), area(v + 2)};
    const std::int64_t width = map_.box.width;
    ImportanceKey* keys = map_.keys.data() + v * map_.stride;
    const float* z = points(v).z;
    if (options_.importance == Cs3Importance::kMinCurvature) {
      importance_row<stencil, Cs3Importance::kMinCurvature>(rows, z, width, keys);
    } else {
      importance_row<stencil, Cs3Importance::kLaplacian>(rows, z, width, keys);
    }
    if (!map_.hessian_uu.empty()) hessian_row<stencil>(rows, width, v * map_.stride, map_);
  }

  const RangeImage& image_;
  const Cs3Options& options_;
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
  const auto num_slots = static_cast<std::size_t>(map.stride * map.box.height);
  // Room for the whole image, so that a box that grows from frame to frame allocates nothing.
  const auto most_slots = static_cast<std::size_t>((image.cols() + 63) / 64 * 64 * image.rows());
  map.keys.reserve(most_slots);
  map.keys.resize(num_slots);
  const bool with_hessian = options.sampling == Cs3Sampling::kNonMaximum;
  for (auto* values : {&map.hessian_uu, &map.hessian_vv, &map.hessian_uv}) {
    if (with_hessian) values->reserve(most_slots);
    values->resize(with_hessian ? num_slots : 0);
  }
  for (std::int64_t v = 0; v < map.box.height; ++v) {  // between the box and the stride
    std::fill(map.keys.begin() + v * map.stride + map.box.width,
              map.keys.begin() + (v + 1) * map.stride, kNoKey);
  }
  // One thread takes all rows at once; more take chunks, at the price of four rows made twice.
  constexpr std::int64_t kRowsPerChunk = 48;
  const std::int64_t chunk =
      options.num_threads == 1 ? std::max<std::int64_t>(1, map.box.height) : kRowsPerChunk;
  const auto num_chunks = static_cast<std::size_t>((map.box.height + chunk - 1) / chunk);
  if (scratch_.size() < num_chunks) scratch_.resize(num_chunks);
  const std::int64_t most_floats = (3 * kPointRows + kAreaRows) * (image.cols() + 2 * kPad);
  for (auto& scratch : scratch_) scratch.reserve(static_cast<std::size_t>(most_floats));
  max_depths_.assign(num_chunks, 0.0F);
  map.max_depth = 0.0F;
  if (num_chunks == 0) return;
  const float scale = unit_scale(image, map.box, scratch_[0]);
  const auto body = [&](std::int64_t begin, std::int64_t end) {
    const auto i = static_cast<std::size_t>(begin / chunk);
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
