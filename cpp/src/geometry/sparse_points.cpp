#include "manip3d/geometry/sparse_points.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>

#include "geometry/cell_list.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr int kMaxNeighbours = 8;
constexpr std::int64_t kBesideInFile = 6;  // rows before and after, which are tested first
constexpr int kReach = 3;                  // largest number of cells to each side in a search
constexpr std::int64_t kBlock = 1024;      // rows; their coordinates fit into the fastest cache
constexpr double kRounding = 1e-4;         // relative error of a distance in single precision
// Cells; places are rounded, so a search reaches this much less than whole cells with certainty.
constexpr double kRound = 0.01;
constexpr double kMaxReach = 1e3;  // metres
constexpr float kFarthest = 1e6F;  // metres; keeps cell indices far below 2^63

// The smallest few squared distances, ascending.
class Smallest {
 public:
  explicit Smallest(int count) : count_(count) {
    squared_.fill(kNone);
    items_.fill(-1);
  }

  // An item may be added several times, but counts once.
  void add(double squared, std::int32_t item) {
    if (!(squared < last())) return;
    const auto known = items_.begin() + count_;
    if (std::find(items_.begin(), known, item) != known) return;
    int k = count_ - 1;
    for (; k > 0 && squared_[k - 1] > squared; --k) {
      squared_[k] = squared_[k - 1];
      items_[k] = items_[k - 1];
    }
    squared_[k] = squared;
    items_[k] = item;
  }

  [[nodiscard]] double operator[](int k) const { return squared_[k]; }
  [[nodiscard]] double last() const { return squared_[count_ - 1]; }

 private:
  static constexpr double kNone = std::numeric_limits<double>::infinity();

  std::array<double, kMaxNeighbours> squared_;
  std::array<std::int32_t, kMaxNeighbours> items_;
  int count_;
};

class SparseSearch {
 public:
  SparseSearch(const PointsView& view, const SparseOptions& options, const Progress& progress)
      : view_(view), options_(options), ticker_(progress) {}

  [[nodiscard]] std::vector<std::vector<float>> run() {
    std::vector<std::vector<float>> distances(options_.neighbours);
    const std::vector<std::int32_t> rows = not_beside_in_file();
    if (rows.empty()) return distances;
    const CellList cells(view_, options_.farthest / (kReach - kRound), Eigen::Vector3d::Zero(),
                         ticker_);
    for (std::size_t k = 0; k < rows.size(); k += options_.every) {
      ticker_.tick();
      const double least = nearest_of(rows[k]);
      const Smallest near = within_cells(cells, rows[k], least);
      for (int n = 0; n < options_.neighbours; ++n) {
        const double distance = std::min(std::sqrt(near[n]), options_.farthest);
        if (distance >= least) distances[n].push_back(static_cast<float>(distance));
      }
    }
    return distances;
  }

 private:
  // Metres; a point with a neighbour nearer than this does not count.
  [[nodiscard]] double nearest_of(std::int64_t row) const {
    const Eigen::RowVector3d place = view_.points.row(row).cast<double>();
    const double range = std::sqrt(place[0] * place[0] + place[1] * place[1] + place[2] * place[2]);
    return std::max(options_.nearest, options_.angle * range);
  }

  // Rows that do not have enough near neighbours among the rows before and after them. Scans list
  // the measurements of a laser in order, so most points have near neighbours there.
  [[nodiscard]] std::vector<std::int32_t> not_beside_in_file() {
    const std::int64_t count = view_.num_points();
    std::vector<float> below(static_cast<std::size_t>(count));
    for (std::int64_t i = 0; i < count; ++i) {
      const double nearest = (1.0 - kRounding) * nearest_of(i);
      below[i] = static_cast<float>(nearest * nearest);
    }
    // Loops over arrays of one type with independent iterations, which are vectorized.
    const Eigen::Matrix<float, Eigen::Dynamic, 3> columns = view_.points;
    const float* const x = columns.data();
    const float* const y = x + count;
    const float* const z = y + count;
    std::vector<float> near(static_cast<std::size_t>(count), 0.0F);
    std::array<float, kBlock> squared;
    for (std::int64_t begin = 0; begin < count; begin += kBlock) {
      for (std::int64_t apart = 1; apart <= kBesideInFile; ++apart) {
        const std::int64_t size = std::min(kBlock, count - apart - begin);
        const std::int64_t other = begin + apart;
        for (std::int64_t k = 0; k < size; ++k) {
          const float a = x[begin + k] - x[other + k];
          const float b = y[begin + k] - y[other + k];
          const float c = z[begin + k] - z[other + k];
          squared[k] = a * a + b * b + c * c;
        }
        for (std::int64_t k = 0; k < size; ++k) {
          near[begin + k] += squared[k] < below[begin + k] ? 1.0F : 0.0F;
        }
        for (std::int64_t k = 0; k < size; ++k) {
          near[other + k] += squared[k] < below[other + k] ? 1.0F : 0.0F;
        }
      }
      ticker_.tick();
    }
    std::vector<std::int32_t> rows;
    for (std::int64_t i = 0; i < count; ++i) {
      if (near[i] < static_cast<float>(options_.neighbours))
        rows.push_back(static_cast<std::int32_t>(i));
    }
    return rows;
  }

  // The squared distances: exact between `least` and `farthest`, else only known to be below or
  // above. Nearly all points have their neighbours within one or two cells.
  [[nodiscard]] Smallest within_cells(const CellList& cells, std::int32_t row, double least) const {
    const double sure = 1.0 - kRound;
    const double cell = cells.cell_size();
    Smallest near(options_.neighbours);
    search<1>(cells, row, least, near);
    if (near.last() <= sure * sure * cell * cell || near.last() < least * least) return near;
    search<2>(cells, row, least, near);
    const double surely = (1.0 + sure) * cell;
    if (near.last() <= surely * surely || near.last() < least * least) return near;
    search<kReach>(cells, row, least, near);
    return near;
  }

  // Adds nearer points until the last is nearer than `least`; then none of them counts.
  template <int reach>
  static void search(const CellList& cells, std::int32_t row, double least, Smallest& near) {
    const std::int32_t place = cells.place_of(row);
    const auto add = [&](std::int32_t other) {
      if (other != place) near.add(cells.squared_distance(place, other), other);
    };
    cells.visit_rows<reach>(place, add, [&](double gap) {
      return gap <= near.last() && !(near.last() < least * least);
    });
  }

  const PointsView& view_;
  const SparseOptions& options_;
  Ticker ticker_;
};

void check_sparse(const SparseOptions& options) {
  if (!(options.neighbours >= 1 && options.neighbours <= kMaxNeighbours)) {
    throw InputError("neighbours: expected 1 to 8, got " + std::to_string(options.neighbours));
  }
  if (!(options.angle >= 0.0 && options.angle < 1.0)) {
    throw InputError("angle: expected radians in [0, 1), got " + number_text(options.angle));
  }
  if (!(options.every >= 1)) {
    throw InputError("every: expected at least 1, got " + std::to_string(options.every));
  }
  if (!(options.nearest >= 0.001 && options.farthest > options.nearest &&
        options.farthest < kMaxReach)) {
    throw InputError("nearest: expected 0.001 <= nearest < farthest < 1000 metres");
  }
}

}  // namespace

std::vector<std::vector<float>> sparse_distances(const PointsView& view,
                                                 const SparseOptions& options,
                                                 const Progress& progress) {
  check_points(view);
  check_sparse(options);
  if (view.num_points() > 0 && !(view.points.cwiseAbs().maxCoeff() < kFarthest)) {
    throw InputError("points: expected coordinates below 1e6 metres");
  }
  return SparseSearch(view, options, progress).run();
}

}  // namespace manip3d
