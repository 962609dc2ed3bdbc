#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Exact neighbours in any point cloud, by nanoflann; distances in double.
class KdTree {
 public:
  /// The view's points must outlive the tree.
  /// @param progress  May cancel the construction of the tree.
  explicit KdTree(const PointsView& view, const Progress& progress = {});
  KdTree(const KdTree&) = delete;
  KdTree& operator=(const KdTree&) = delete;
  ~KdTree();

  struct Neighbours {
    std::vector<std::uint32_t> rows;
    std::vector<double> squared_distances;
  };

  /// Finds the k nearest rows of a row, including itself.
  void nearest(std::int64_t row, std::size_t k, Neighbours& found) const;

  /// Finds the k nearest rows of any place.
  void nearest_to(const Eigen::Vector3d& place, std::size_t k, Neighbours& found) const;

  /// A row with its squared distance from a place.
  struct Nearest {
    std::int64_t row = -1;  ///< -1: no row is nearer than `squared_distance`.
    double squared_distance = std::numeric_limits<double>::infinity();
  };

  /// The row nearest to a place if it is nearer than `known`; else `known`.
  [[nodiscard]] Nearest nearest_to(const Eigen::Vector3d& place, const Nearest& known) const;

  [[nodiscard]] double squared_distance(const Eigen::Vector3d& place, std::int64_t row) const;

  /// Distance of a row from its nearest other row; infinite if there is none.
  [[nodiscard]] double nearest_distance(std::int64_t row) const;

 private:
  struct Index;  // nanoflann's templates take seconds to compile in each file that includes them
  std::unique_ptr<const Index> index_;
};

}  // namespace manip3d
