#include "manip3d/forge/segment.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <span>
#include <string>
#include <utility>

#include "geometry/median.hpp"
#include "geometry/union_find.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/angles.hpp"

namespace manip3d {
namespace {

using Eigen::Vector3d;

constexpr double kCell = 1.0;  // metres: side of a ground cell
constexpr float kNothing = std::numeric_limits<float>::infinity();

void check_options(const SegmentOptions& options) {
  const auto positive = [](double value, const char* name) {
    if (!(value > 0.0 && value <= 1e4)) {
      throw InputError(std::string(name) + ": expected > 0 and at most 10000, got " +
                       number_text(value));
    }
  };
  positive(options.max_range, "max_range");
  positive(options.ground_height, "ground_height");
  positive(options.ground_slope, "ground_slope");
  positive(options.max_size, "max_size");
  if (!(options.tolerance >= 0.01 && options.tolerance <= 100.0)) {
    throw InputError("tolerance: expected 0.01 to 100, got " + number_text(options.tolerance));
  }
  if (options.min_points < 1) throw InputError("min_points: expected >= 1");
  if (!options.origin.allFinite()) throw InputError("origin: expected finite numbers");
}

// Ground heights of square cells around the scanner.
class GroundGrid {
 public:
  GroundGrid(const PointsView& scene, const SegmentOptions& options, Ticker& ticker)
      : origin_(options.origin),
        half_(static_cast<std::int64_t>(options.max_range / kCell) + 1),
        side_(2 * half_ + 1),
        height_(side_ * side_, kNothing) {
    for (std::int64_t i = 0; i < scene.num_points(); ++i) {
      ticker.tick();
      const std::int64_t cell = cell_of(scene.points.row(i).transpose().cast<double>());
      if (cell >= 0) height_[cell] = std::min(height_[cell], scene.points(i, 2));
    }
    take_medians(ticker);
    lower_to_slope(static_cast<float>(options.ground_slope * kCell), ticker);
  }

  /// The cell of a point; -1: beyond the range.
  [[nodiscard]] std::int64_t cell_of(const Vector3d& p) const {
    const double x = std::floor((p.x() - origin_.x()) / kCell + 0.5);
    const double y = std::floor((p.y() - origin_.y()) / kCell + 0.5);
    const auto half = static_cast<double>(half_);
    if (!(std::abs(x) <= half && std::abs(y) <= half)) return -1;
    return (static_cast<std::int64_t>(x) + half_) * side_ + static_cast<std::int64_t>(y) + half_;
  }
  [[nodiscard]] float height(std::int64_t cell) const { return height_[cell]; }

 private:
  void take_medians(Ticker& ticker) {
    std::vector<float> medians(height_.size(), kNothing);
    std::vector<float> around;
    for (std::int64_t i = 1; i + 1 < side_; ++i) {
      for (std::int64_t j = 1; j + 1 < side_; ++j) {
        ticker.tick();
        if (height_[i * side_ + j] == kNothing) continue;
        around.clear();
        for (std::int64_t k = 0; k < 9; ++k) {
          const float h = height_[(i + k / 3 - 1) * side_ + j + k % 3 - 1];
          if (h < kNothing) around.push_back(h);
        }
        medians[i * side_ + j] = median(std::span(around), Middle::kLower);
      }
    }
    height_ = std::move(medians);
  }

  // Limits the height of each cell to that of its neighbours plus the rise: a distance transform in
  // two passes.
  void lower_to_slope(float rise, Ticker& ticker) {
    const auto lower = [&](std::int64_t i, std::int64_t j, std::int64_t di, std::int64_t dj) {
      if (i + di < 0 || i + di >= side_ || j + dj < 0 || j + dj >= side_) return;
      const float step = di != 0 && dj != 0 ? rise * std::numbers::sqrt2_v<float> : rise;
      float& h = height_[i * side_ + j];
      h = std::min(h, height_[(i + di) * side_ + j + dj] + step);
    };
    constexpr std::array<std::pair<int, int>, 4> kBefore = {{{-1, -1}, {-1, 0}, {-1, 1}, {0, -1}}};
    for (std::int64_t i = 0; i < side_; ++i) {
      for (std::int64_t j = 0; j < side_; ++j) {
        ticker.tick();
        for (const auto& [di, dj] : kBefore) lower(i, j, di, dj);
      }
    }
    for (std::int64_t i = side_ - 1; i >= 0; --i) {
      for (std::int64_t j = side_ - 1; j >= 0; --j) {
        ticker.tick();
        for (const auto& [di, dj] : kBefore) lower(i, j, -di, -dj);
      }
    }
  }

  Vector3d origin_;
  std::int64_t half_, side_;
  std::vector<float> height_;
};

struct Voxel {
  std::uint64_t key;
  std::int32_t row;
};

constexpr std::uint64_t kAxisBits = 21;

// The cube of a point as one number, in which the offset to a neighbour is a constant sum.
// Horizontally, coordinates are bounded by the range of the ground, vertically by 21 bits.
std::uint64_t voxel_key(const Vector3d& p, double size) {
  std::uint64_t key = 0;
  for (int axis = 0; axis < 3; ++axis) {
    constexpr double kHalf = 1 << (kAxisBits - 1);
    const double cell = std::clamp(std::floor(p[axis] / size), 2.0 - kHalf, kHalf - 2.0);
    key = key << kAxisBits | static_cast<std::uint64_t>(cell + kHalf);
  }
  return key;
}

std::vector<std::int64_t> neighbour_offsets() {  // the 13 of 26 neighbours with smaller keys
  std::vector<std::int64_t> offsets;
  for (std::int64_t k = 0; k < 13; ++k) {
    const std::int64_t dx = k / 9 - 1;
    const std::int64_t dy = k / 3 % 3 - 1;
    const std::int64_t dz = k % 3 - 1;
    offsets.push_back((dx << (2 * kAxisBits)) + dy * (std::int64_t{1} << kAxisBits) + dz);
  }
  return offsets;
}

// Sets of voxels that touch, directly or through others.
UnionFind connect(const std::vector<std::uint64_t>& keys, Ticker& ticker) {
  UnionFind clusters(std::ssize(keys));
  const std::vector<std::int64_t> offsets = neighbour_offsets();
  for (std::size_t i = 0; i < keys.size(); ++i) {
    ticker.tick();
    for (const std::int64_t offset : offsets) {
      const std::uint64_t wanted = keys[i] + static_cast<std::uint64_t>(offset);
      const auto found = std::lower_bound(keys.begin(), keys.end(), wanted);
      if (found == keys.end() || *found != wanted) continue;
      clusters.join(static_cast<std::int32_t>(i), static_cast<std::int32_t>(found - keys.begin()));
    }
  }
  return clusters;
}

// Rows of each cluster, ascending; clusters in the order of their first rows.
std::vector<std::vector<std::int32_t>> clusters_of(const std::vector<Voxel>& voxels,
                                                   Ticker& ticker) {
  std::vector<std::uint64_t> keys;
  std::vector<std::int32_t> number;  // number of each voxel's key
  for (const Voxel& voxel : voxels) {
    if (keys.empty() || keys.back() != voxel.key) keys.push_back(voxel.key);
    number.push_back(static_cast<std::int32_t>(keys.size()) - 1);
  }
  UnionFind touching = connect(keys, ticker);
  std::vector<std::vector<std::int32_t>> clusters(keys.size());
  for (std::size_t i = 0; i < voxels.size(); ++i) {
    ticker.tick();
    clusters[touching.root(number[i])].push_back(voxels[i].row);
  }
  std::erase_if(clusters, [](const auto& rows) { return rows.empty(); });
  for (auto& rows : clusters) std::sort(rows.begin(), rows.end());
  std::sort(clusters.begin(), clusters.end());
  return clusters;
}

OrientedBox smallest_box(const PointsView& scene, const std::vector<std::int32_t>& rows,
                         const Progress& progress) {
  OrientedBox best;
  double least = std::numeric_limits<double>::infinity();
  for (int degrees = 0; degrees < 90; degrees += 2) {
    if (progress) progress(0.5);
    const OrientedBox box = box_around(scene, rows, degrees * std::numbers::pi / 180.0);
    const double area = box.size.x() * box.size.y();
    if (area < least) {
      least = area;
      best = box;
    }
  }
  return best;
}

}  // namespace

Segmentation segment_objects(const PointsView& scene, const SegmentOptions& options,
                             const Progress& progress) {
  check_points(scene);
  check_options(options);
  Segmentation result;
  result.labels.assign(scene.num_points(), Segmentation::kOther);
  Ticker ticker(progress);
  const GroundGrid ground(scene, options, ticker);
  std::vector<Voxel> voxels;
  for (std::int64_t i = 0; i < scene.num_points(); ++i) {
    ticker.tick();
    const Vector3d p = scene.points.row(i).transpose().cast<double>();
    const std::int64_t cell = ground.cell_of(p);
    if (cell < 0) continue;
    if (!(p.z() > ground.height(cell) + options.ground_height)) {
      result.labels[i] = Segmentation::kGround;
    } else {
      voxels.push_back(
          {voxel_key(p - options.origin, options.tolerance), static_cast<std::int32_t>(i)});
    }
  }
  Ticker sorting(progress, 1U << 16);
  std::sort(voxels.begin(), voxels.end(), [&](const Voxel& a, const Voxel& b) {
    sorting.tick();
    return std::pair(a.key, a.row) < std::pair(b.key, b.row);
  });

  struct Object {
    OrientedBox box;
    std::vector<std::int32_t> rows;
    double distance;
  };
  std::vector<Object> objects;
  for (auto& rows : clusters_of(voxels, ticker)) {
    if (static_cast<std::int64_t>(rows.size()) < options.min_points) continue;
    const OrientedBox box = smallest_box(scene, rows, progress);
    if (box.size.maxCoeff() > options.max_size) continue;
    objects.push_back({box, std::move(rows), (box.center - options.origin).norm()});
  }
  std::stable_sort(objects.begin(), objects.end(),
                   [](const Object& a, const Object& b) { return a.distance < b.distance; });
  for (const Object& object : objects) {
    for (const std::int32_t row : object.rows) {
      result.labels[row] = static_cast<std::int32_t>(result.boxes.size());
    }
    result.boxes.push_back(object.box);
  }
  return result;
}

}  // namespace manip3d
