#include "manip3d/geometry/align_scans.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <bit>
#include <cmath>
#include <utility>
#include <vector>

#include "geometry/kd_tree.hpp"
#include "geometry/median.hpp"
#include "geometry/small_solvers.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr double kAlignNearest = 3.5;  // metres; nearer points belong to the scanner's own vehicle
constexpr double kAlignFarthest = 50.0;
constexpr double kAlignVoxel = 0.4;         // metres; one point per voxel is kept
constexpr std::size_t kAlignSource = 2000;  // points that are matched
constexpr std::size_t kPlanePoints = 8;     // points that a plane is fitted to
constexpr std::size_t kMinMatches = 100;
// Largest spread of a plane's points across it, relative to their smaller spread along it.
constexpr double kFlatness = 0.3;
constexpr int kAlignRounds = 25;
constexpr int kMinAlignRounds = 7;
constexpr double kAlignShrink = 0.8;  // factor on reach and kernel from round to round
constexpr double kFarReach = 1.5, kNearReach = 0.5;       // metres
constexpr double kWideKernel = 0.3, kTightKernel = 0.05;  // metres
constexpr double kAlignConverged = 1e-4;                  // metres and radians

// A hash set of keys other than 0, by open addressing.
class VoxelSet {
 public:
  explicit VoxelSet(std::size_t most) : keys_(std::bit_ceil(2 * most + 2), 0) {}

  // Inserts a key; returns whether it is new.
  bool insert(std::uint64_t key) {
    const std::size_t mask = keys_.size() - 1;
    std::size_t at = (key * 0x9E3779B97F4A7C15U >> 20U) & mask;
    while (keys_[at] != 0 && keys_[at] != key) at = (at + 1) & mask;
    const bool is_new = keys_[at] == 0;
    keys_[at] = key;
    return is_new;
  }

 private:
  std::vector<std::uint64_t> keys_;
};

// The first point of each voxel, in the order of the scan.
Points one_per_voxel(const PointsView& view, const Progress& progress) {
  Ticker ticker(progress, 1U << 16);
  VoxelSet seen(view.num_points());
  std::vector<Eigen::Index> kept;
  for (Eigen::Index i = 0; i < view.num_points(); ++i) {
    ticker.tick();
    const Eigen::RowVector3d p = view.points.row(i).cast<double>();
    const double square = p.x() * p.x() + p.y() * p.y();
    if (!(square > kAlignNearest * kAlignNearest && square < kAlignFarthest * kAlignFarthest))
      continue;
    if (!(std::abs(p.z()) < kAlignFarthest)) continue;
    std::uint64_t key = 0;
    for (int axis = 0; axis < 3; ++axis) {
      key = key << 16 | static_cast<std::uint64_t>(std::floor((p[axis] + 64.0) / kAlignVoxel));
    }
    if (seen.insert(key)) kept.push_back(i);
  }
  Points points(static_cast<Eigen::Index>(kept.size()), 3);
  for (std::size_t k = 0; k < kept.size(); ++k) {
    points.row(static_cast<Eigen::Index>(k)) = view.points.row(kept[k]);
  }
  return points;
}

// LocalPlanes around the points of a scan, fitted on first use.
class LocalPlanes {
 public:
  LocalPlanes(const Points& points, const Progress& progress)
      : points_(points),
        view_(PointsView::Map<Points>(points.data(), points.rows(), 3)),
        tree_(view_, progress),
        planes_(points.rows()) {}

  struct Plane {
    enum class State : std::uint8_t { kUnknown, kFlat, kNone } state = State::kUnknown;
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  };

  // Row of the nearest point within reach that lies in a plane; -1 if there is none. `last` is the
  // row found for the same point before it moved a little, or -1; searches are faster if something
  // near is known.
  std::int64_t nearest(const Eigen::Vector3d& point, double reach, std::int64_t& last) {
    KdTree::Nearest known{-1, reach * reach};
    if (last >= 0) {
      const double squared = tree_.squared_distance(point, last);
      if (squared < known.squared_distance) known = {last, squared};
    }
    const KdTree::Nearest found = tree_.nearest_to(point, known);
    if (found.row < 0) return -1;
    last = found.row;
    return plane(found.row).state == Plane::State::kFlat ? found.row : -1;
  }

  [[nodiscard]] Eigen::Vector3d point(std::int64_t row) const {
    return points_.row(row).transpose().cast<double>();
  }
  const Eigen::Vector3d& normal(std::int64_t row) { return planes_[row].normal; }

 private:
  const Plane& plane(std::int64_t row) {
    Plane& known = planes_[row];
    if (known.state == Plane::State::kUnknown) known = fitted(row);
    return known;
  }

  Plane fitted(std::int64_t row) {
    tree_.nearest(row, kPlanePoints, around_);
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (const std::uint32_t k : around_.rows) mean += point(k);
    mean /= static_cast<double>(around_.rows.size());
    Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
    for (const std::uint32_t k : around_.rows) {
      const Eigen::Vector3d off = point(k) - mean;
      spread += off * off.transpose();
    }
    const PrincipalAxes axes = principal_axes(spread);
    const bool flat = axes.spreads[0] < kFlatness * axes.spreads[1];
    return {flat ? Plane::State::kFlat : Plane::State::kNone, axes.directions.col(0)};
  }

  const Points& points_;
  PointsView view_;
  KdTree tree_;
  std::vector<Plane> planes_;
  KdTree::Neighbours around_;
};

// The rotation nearest to I + [w]x, computed from the quaternion (1, w / 2) with square roots only.
Eigen::Matrix3d turned_by(const Eigen::Vector3d& w) {
  return Eigen::Quaterniond(1.0, w.x() / 2.0, w.y() / 2.0, w.z() / 2.0)
      .normalized()
      .toRotationMatrix();
}

}  // namespace

struct ScanAligner::Target {
  explicit Target(Points thinned, const Progress& progress)
      : points(std::move(thinned)), planes(points, progress) {}
  Points points;
  LocalPlanes planes;
};

ScanAligner::ScanAligner(const PointsView& target, const Progress& progress) {
  check_points(target);
  target_ = std::make_unique<Target>(one_per_voxel(target, progress), progress);
}
ScanAligner::~ScanAligner() = default;
ScanAligner::ScanAligner(ScanAligner&&) noexcept = default;
ScanAligner& ScanAligner::operator=(ScanAligner&&) noexcept = default;

ScanMotion ScanAligner::align(const PointsView& source, const ScanMotion& start,
                              const Progress& progress) {
  check_points(source);
  const Points from = one_per_voxel(source, progress);
  LocalPlanes& planes = target_->planes;
  ScanMotion motion;
  motion.rotation = start.rotation;
  motion.translation = start.translation;
  const Eigen::Index fewest = std::min(from.rows(), target_->points.rows());
  if (static_cast<std::size_t>(fewest) < kMinMatches) return motion;
  if (progress) progress(0.2);
  const auto stride =
      std::max<Eigen::Index>(1, from.rows() / static_cast<Eigen::Index>(kAlignSource));
  double reach = kFarReach;
  double kernel = kWideKernel;
  std::vector<double> distances;
  std::vector<std::int64_t> last(from.rows(), -1);  // nearest rows of the previous round
  for (int round = 0; round < kAlignRounds; ++round) {
    if (progress) progress(0.2 + 0.8 * round / kAlignRounds);
    Eigen::Matrix<double, 6, 6> normal = Eigen::Matrix<double, 6, 6>::Identity() * 1e-6;
    Eigen::Matrix<double, 6, 1> right = Eigen::Matrix<double, 6, 1>::Zero();
    distances.clear();
    motion.tried = 0;
    for (Eigen::Index i = 0; i < from.rows(); i += stride) {
      ++motion.tried;
      const Eigen::Vector3d moved =
          motion.rotation * from.row(i).transpose().cast<double>() + motion.translation;
      const std::int64_t row = planes.nearest(moved, reach, last[i]);
      if (row < 0) continue;
      const Eigen::Vector3d& n = planes.normal(row);
      const double error = n.dot(planes.point(row) - moved);
      const double weight = kernel * kernel / (kernel * kernel + error * error);
      Eigen::Matrix<double, 6, 1> jacobian;
      jacobian << moved.cross(n), n;
      normal += weight * weight * jacobian * jacobian.transpose();
      right += weight * weight * error * jacobian;
      distances.push_back(std::abs(error));
    }
    motion.pairs = static_cast<std::int64_t>(distances.size());
    if (distances.size() < kMinMatches) return motion;
    motion.residual = median(std::span(distances));
    const Eigen::Matrix<double, 6, 1> step = solve_symmetric(normal, right);
    if (!step.allFinite()) return ScanMotion{};
    const Eigen::Matrix3d turn = turned_by(step.head<3>());
    motion.rotation = turn * motion.rotation;
    motion.translation = turn * motion.translation + step.tail<3>();
    if (round >= kMinAlignRounds && step.norm() < kAlignConverged) break;
    reach = std::max(kAlignShrink * reach, kNearReach);
    kernel = std::max(kAlignShrink * kernel, kTightKernel);
  }
  return motion;
}

}  // namespace manip3d
