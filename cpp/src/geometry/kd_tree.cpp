#include "geometry/kd_tree.hpp"

#include <array>
#include <cmath>
#include <nanoflann.hpp>

namespace manip3d {
namespace {

// A tree of this many points is built within 0.1 s; ticking would take a tenth longer.
constexpr std::int64_t kQuickTree = 1 << 18;

struct IndexedCloud {
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

// The result of a search, with the interface that nanoflann requires.
class NearestRow {
 public:
  explicit NearestRow(const KdTree::Nearest& known) : best_(known) {}
  [[nodiscard]] const KdTree::Nearest& best() const { return best_; }
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
  KdTree::Nearest best_;
};

}  // namespace

struct KdTree::Index {
  Index(const PointsView& view, const Progress& progress)
      : ticker(progress, 1U << 16),
        cloud{view.points.data(), static_cast<std::size_t>(view.num_points()),
              progress && view.num_points() > kQuickTree ? &ticker : nullptr},
        tree(3, cloud, nanoflann::KDTreeSingleIndexAdaptorParams(10)) {
    cloud.building = nullptr;
  }

  [[nodiscard]] std::array<double, 3> query_of(std::int64_t row) const {
    return {cloud.kdtree_get_pt(row, 0), cloud.kdtree_get_pt(row, 1), cloud.kdtree_get_pt(row, 2)};
  }

  void search(const double* place, std::size_t k, Neighbours& found) const {
    found.rows.resize(k);
    found.squared_distances.resize(k);
    const std::size_t count =
        tree.knnSearch(place, k, found.rows.data(), found.squared_distances.data());
    found.rows.resize(count);
    found.squared_distances.resize(count);
  }

  Ticker ticker;
  IndexedCloud cloud;
  nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<double, IndexedCloud>,
                                      IndexedCloud, 3>
      tree;
};

KdTree::KdTree(const PointsView& view, const Progress& progress)
    : index_(std::make_unique<Index>(view, progress)) {}
KdTree::~KdTree() = default;

void KdTree::nearest(std::int64_t row, std::size_t k, Neighbours& found) const {
  index_->search(index_->query_of(row).data(), k, found);
}

void KdTree::nearest_to(const Eigen::Vector3d& place, std::size_t k, Neighbours& found) const {
  index_->search(place.data(), k, found);
}

KdTree::Nearest KdTree::nearest_to(const Eigen::Vector3d& place, const Nearest& known) const {
  NearestRow nearest(known);
  if (index_->cloud.size > 0) index_->tree.findNeighbors(nearest, place.data(), {});
  return nearest.best();
}

double KdTree::squared_distance(const Eigen::Vector3d& place, std::int64_t row) const {
  double squared = 0.0;
  for (int axis = 0; axis < 3; ++axis) {
    const double apart =
        place[axis] - index_->cloud.kdtree_get_pt(static_cast<std::size_t>(row), axis);
    squared += apart * apart;
  }
  return squared;
}

double KdTree::nearest_distance(std::int64_t row) const {
  std::array<std::uint32_t, 2> rows;
  std::array<double, 2> squared_distances;
  const std::size_t count = index_->tree.knnSearch(index_->query_of(row).data(), 2, rows.data(),
                                                   squared_distances.data());
  return count == 2 ? std::sqrt(squared_distances[1]) : std::numeric_limits<double>::infinity();
}

}  // namespace manip3d
