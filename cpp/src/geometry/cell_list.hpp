#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/geometry/random.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Points grouped by hashed cubic cells [Teschner et al., VMV 2003]. Buckets of cells that are
/// neighbours along x are adjacent, so that a block of cells is read in few runs. Different cells
/// may share a bucket: a visit yields all near points, and a few others.
class CellList {
 public:
  /// @param origin  Origin of the cells.
  CellList(const PointsView& view, double cell_size, const Eigen::Vector3d& origin, Ticker& ticker)
      : origin_(origin),
        cell_size_(cell_size),
        start_(std::bit_ceil(static_cast<std::size_t>(view.num_points()) / 2 + 1) + 1),
        place_(view.num_points()),
        points_(view.num_points(), 3) {
    const std::int64_t count = view.num_points();
    for (std::int64_t i = 0; i < count; ++i) {
      const Cell cell = cell_of(view.points.row(i).transpose().cast<double>());
      place_[i] = static_cast<std::int32_t>(bucket(cell));
      ++start_[place_[i] + 1];
      ticker.tick();
    }
    for (std::size_t b = 1; b < start_.size(); ++b) start_[b] += start_[b - 1];
    std::vector<std::int32_t> next(start_.begin(), start_.end() - 1);
    for (std::int64_t i = 0; i < count; ++i) {
      place_[i] = next[place_[i]]++;
      points_.row(place_[i]) = view.points.row(i);
      ticker.tick();
    }
  }

  [[nodiscard]] double cell_size() const { return cell_size_; }

  /// Place in the list of a row of the view.
  [[nodiscard]] std::int32_t place_of(std::int32_t row) const { return place_[row]; }

  [[nodiscard]] double squared_distance(std::int32_t a, std::int32_t b) const {
    const double x = static_cast<double>(points_(a, 0)) - points_(b, 0);
    const double y = static_cast<double>(points_(a, 1)) - points_(b, 1);
    const double z = static_cast<double>(points_(a, 2)) - points_(b, 2);
    return x * x + y * y + z * z;
  }

  /// Calls visit(place) for the points within `reach` cells of the cell of a point, including
  /// itself; for some points more than once.
  template <int reach, typename Visit>
  void visit(std::int32_t place, const Visit& visit_place) const {
    visit_rows<reach>(place, visit_place, [](double) { return true; });
  }

  /// The same, but skips rows of cells along x for which is_wanted(gap) is false when they are due,
  /// starting with the point's own row. The squared distance of each point of a row is at least
  /// `gap`.
  template <int reach, typename Visit, typename Wanted>
  void visit_rows(std::int32_t place, const Visit& visit_place, const Wanted& is_wanted) const {
    constexpr int kSide = 2 * reach + 1;
    constexpr int kOwn = kSide * kSide / 2;
    const Cell center = cell_of(points_.row(place).transpose().cast<double>());
    const std::size_t count = start_.size() - 1;
    std::array<std::size_t, kSide * kSide> first;
    // Looked up in advance to hide the latency of memory.
    std::array<std::int32_t, kSide * kSide> begin, end;
    for (int i = 0; i < kSide * kSide; ++i) {
      first[i] = bucket(center + Cell(-reach, i % kSide - reach, i / kSide - reach));
      begin[i] = start_[first[i]];
      end[i] = start_[std::min(first[i] + kSide, count)];
      __builtin_prefetch(points_.data() + 3 * static_cast<std::int64_t>(begin[i]));
    }
    for (int n = 0; n < kSide * kSide; ++n) {
      const int i = n == 0 ? kOwn : (n <= kOwn ? n - 1 : n);
      if (!is_wanted(squared_gap(i % kSide - reach, i / kSide - reach))) continue;
      for (std::int32_t k = begin[i]; k < end[i]; ++k) visit_place(k);
      if (first[i] + kSide <= count) continue;
      const std::size_t rest = std::min(first[i] + kSide - count, count);
      for (std::int32_t k = 0; k < start_[rest]; ++k) visit_place(k);
    }
  }

 private:
  using Cell = Eigen::Matrix<std::int64_t, 3, 1>;

  // Conversion to integers cuts towards 0, which rounds down only positive numbers.
  [[nodiscard]] Cell cell_of(const Eigen::Vector3d& p) const {
    constexpr double kAboveZero = 17179869184.0;  // 2^34 cells: more than any scan is wide
    return (((p - origin_) / cell_size_).array() + kAboveZero).cast<std::int64_t>();
  }

  // Lower bound of the squared distance between a point and rows this many cells away along y and
  // z; places are rounded.
  [[nodiscard]] double squared_gap(int y, int z) const {
    const auto metres = [&](int cells) { return (std::abs(cells) - 1.01) * cell_size_; };
    const double a = std::max(0.0, metres(y));
    const double b = std::max(0.0, metres(z));
    return a * a + b * b;
  }

  [[nodiscard]] std::size_t bucket(const Cell& cell) const {
    const auto bits = [](std::int64_t i) { return static_cast<std::uint64_t>(i); };
    const std::uint64_t row =
        mix(bits(cell.y()) * 0xC2B2AE3D27D4EB4FU + bits(cell.z()) * 0x165667B19E3779F9U);
    return (row + bits(cell.x())) & (start_.size() - 2);
  }

  Eigen::Vector3d origin_;
  double cell_size_;
  std::vector<std::int32_t> start_;  // of each bucket; the number of buckets is a power of two
  std::vector<std::int32_t> place_;
  Points points_;
};

}  // namespace manip3d
