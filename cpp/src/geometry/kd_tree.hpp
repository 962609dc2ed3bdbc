#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <nanoflann.hpp>
#include <vector>

#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Exact neighbours in any cloud of points, by nanoflann; distances in double.
class KdTree {
 public:
  /// The view's points must outlive the tree.
  /// @param progress  may cancel the building of the tree.
  explicit KdTree(const PointsView& view, const Progress& progress = {})
      : ticker_(progress, 1U << 16),
        cloud_{view.points.data(), static_cast<std::size_t>(view.num_points()),
               progress && view.num_points() > kQuick ? &ticker_ : nullptr},
        tree_(3, cloud_, nanoflann::KDTreeSingleIndexAdaptorParams(10)) {
    cloud_.building = nullptr;
  }
  KdTree(const KdTree&) = delete;
  KdTree& operator=(const KdTree&) = delete;
  ~KdTree() = default;

  struct Neighbours {
    std::vector<std::uint32_t> rows;
    std::vector<double> squared_distances;
  };

  /// The k nearest of a row, itself among them.
  void nearest(std::int64_t row, std::size_t k, Neighbours& found) const {
    found.rows.resize(k);
    found.squared_distances.resize(k);
    const std::size_t count =
        tree_.knnSearch(query_of(row).data(), k, found.rows.data(), found.squared_distances.data());
    found.rows.resize(count);
    found.squared_distances.resize(count);
  }

  /// The k nearest of any place.
  void nearest_to(const Eigen::Vector3d& place, std::size_t k, Neighbours& found) const {
    found.rows.resize(k);
    found.squared_distances.resize(k);
    const std::size_t count =
        tree_.knnSearch(place.data(), k, found.rows.data(), found.squared_distances.data());
    found.rows.resize(count);
    found.squared_distances.resize(count);
  }

  /// A row, and its squared distance from a place.
  struct Nearest {
    std::int64_t row = -1;  ///< -1: no row is nearer than `squared_distance`.
    double squared_distance = std::numeric_limits<double>::infinity();
  };

  /// The row nearest to any place, if one is nearer than what is known; else that.
  [[nodiscard]] Nearest nearest_to(const Eigen::Vector3d& place, const Nearest& known) const {
    NearestRow nearest(known);
    if (cloud_.size > 0) tree_.findNeighbors(nearest, place.data(), {});
    return nearest.best();
  }

  [[nodiscard]] double squared_distance(const Eigen::Vector3d& place, std::int64_t row) const {
    double squared = 0.0;
    for (int axis = 0; axis < 3; ++axis) {
      const double apart = place[axis] - cloud_.kdtree_get_pt(static_cast<std::size_t>(row), axis);
      squared += apart * apart;
    }
    return squared;
  }

  /// Distance of a row from its nearest other row; infinite where there is no other.
  [[nodiscard]] double nearest_distance(std::int64_t row) const {
    std::array<std::uint32_t, 2> rows;
    std::array<double, 2> squared_distances;
    const std::size_t count =
        tree_.knnSearch(query_of(row).data(), 2, rows.data(), squared_distances.data());
    return count == 2 ? std::sqrt(squared_distances[1]) : std::numeric_limits<double>::infinity();
  }

 private:
  // A tree of so many points is built within 0.1 s; ticking takes a tenth longer.
  static constexpr std::int64_t kQuick = 1 << 18;

  struct Cloud {
    const float* xyz;
    std::size_t size;
    Ticker* building;  // null once the tree is built
    [[nodiscard]] std::size_t kdtree_get_point_count() const { return size; }
    [[nodiscard]] double kdtree_get_pt(std::size_t row, std::size_t axis) const {
      if (building != nullptr) [[unlikely]]
        building->tick();
      return xyz[3 * row + axis];
    }
    template <typename Box>
    bool kdtree_get_bbox(Box&) const {
      return false;
    }
  };
  // The result of a search so far, as nanoflann asks for it.
  class NearestRow {
   public:
    explicit NearestRow(const Nearest& known) : best_(known) {}
    [[nodiscard]] const Nearest& best() const { return best_; }
    [[nodiscard]] double worstDist() const { return best_.squared_distance; }
    [[nodiscard]] std::size_t size() const { return full() ? 1 : 0; }
    [[nodiscard]] bool empty() const { return !full(); }
    [[nodiscard]] bool full() const { return best_.row >= 0; }
    void sort() {}
    bool addPoint(double squared_distance, std::uint32_t row) {
      if (squared_distance < best_.squared_distance) best_ = {row, squared_distance};
      return true;
    }

   private:
    Nearest best_;
  };

  using Tree =
      nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<double, Cloud>, Cloud, 3>;

  [[nodiscard]] std::array<double, 3> query_of(std::int64_t row) const {
    return {cloud_.kdtree_get_pt(row, 0), cloud_.kdtree_get_pt(row, 1),
            cloud_.kdtree_get_pt(row, 2)};
  }

  Ticker ticker_;
  Cloud cloud_;
  Tree tree_;
};

}  // namespace manip3d
