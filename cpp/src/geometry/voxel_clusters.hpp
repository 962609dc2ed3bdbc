#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "geometry/union_find.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Number of the cube of side `size` that holds a point; that of a neighbour is a sum away. Cubes
/// more than 2^20 from the origin count as the outermost.
inline std::uint64_t voxel_key(const Eigen::Vector3d& p, double size) {
  constexpr int kAxisBits = 21;
  constexpr double kHalf = 1 << (kAxisBits - 1);
  std::uint64_t key = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const double cell = std::clamp(std::floor(p[axis] / size), 2.0 - kHalf, kHalf - 2.0);
    key = key << kAxisBits | static_cast<std::uint64_t>(cell + kHalf);
  }
  return key;
}

/// Clusters of cubes that touch, directly or not, also at an edge or corner.
class VoxelClusters {
 public:
  /// @param keys  Cubes that are not empty, ascending, each once (`voxel_key`).
  VoxelClusters(std::vector<std::uint64_t> keys, Ticker& ticker) : keys_(std::move(keys)) {
    UnionFind touching(std::ssize(keys_));
    for (std::size_t i = 0; i < keys_.size(); ++i) {
      ticker.tick();
      for (std::int64_t k = 0; k < 13; ++k) {  // the neighbours that come before
        const std::int64_t dx = k / 9 - 1, dy = k / 3 % 3 - 1, dz = k % 3 - 1;
        const std::int64_t offset =
            dx * (std::int64_t{1} << 42) + dy * (std::int64_t{1} << 21) + dz;
        const std::int32_t at = find(keys_[i] + static_cast<std::uint64_t>(offset));
        if (at >= 0) touching.join(static_cast<std::int32_t>(i), at);
      }
    }
    cluster_.resize(keys_.size());
    for (std::size_t i = 0; i < keys_.size(); ++i) {
      cluster_[i] = touching.root(static_cast<std::int32_t>(i));
    }
  }

  /// Cluster of a cube: a number below `size()`; -1: the cube is empty.
  [[nodiscard]] std::int32_t cluster_of(std::uint64_t key) const {
    const std::int32_t at = find(key);
    return at < 0 ? -1 : cluster_[at];
  }
  [[nodiscard]] std::int64_t size() const { return std::ssize(keys_); }

 private:
  [[nodiscard]] std::int32_t find(std::uint64_t key) const {
    const auto found = std::lower_bound(keys_.begin(), keys_.end(), key);
    if (found == keys_.end() || *found != key) return -1;
    return static_cast<std::int32_t>(found - keys_.begin());
  }

  std::vector<std::uint64_t> keys_;
  std::vector<std::int32_t> cluster_;
};

}  // namespace manip3d
