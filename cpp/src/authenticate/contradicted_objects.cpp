#include "authenticate/contradicted_objects.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "geometry/voxel_clusters.hpp"

namespace manip3d {
namespace {

constexpr double kCube = 0.5;            // metres: points in touching cubes are close together
constexpr double kLeastWidth = 0.35;     // metres: poles are thinner than what stereo resolves
constexpr double kLeastHeight = 0.3;     // metres: kerbs are lower, and seen at a grazing angle
constexpr double kHidingAngle = 0.0055;  // radians: a third of the distance of two scan lines
constexpr double kHidingPixels = 0.75;   // at half KITTI's resolution; by how much what hides is
constexpr double kHidingShare = 0.06;    // nearer, at least; as a share of the disparity

struct Asked {
  std::int32_t row;
  std::uint64_t cube;
  Eigen::Vector3d place;  // in the camera's frame
  double u, v;
  double disparity;   // by the point
  double seen;        // by the pixel
  double difference;  // the least of the pixels around, LiDAR minus cameras
  bool is_contradicted;
};

// A pixel grid of the nearest point, coarse enough that the scan's lines leave no gaps in it.
class NearestInPicture {
 public:
  NearestInPicture(const DisparityView& picture, double focal)
      : side_(std::max(std::round(focal * kHidingAngle), 1.0)),
        rows_(static_cast<std::int64_t>(static_cast<double>(picture.height) / side_) + 1),
        columns_(static_cast<std::int64_t>(static_cast<double>(picture.width) / side_) + 1),
        nearest_(rows_ * columns_, 0.0) {}

  void add(double u, double v, double disparity) {
    double& nearest = nearest_[row_of(v) * columns_ + column_of(u)];
    nearest = std::max(nearest, disparity);
  }

  /// Whether something that is clearly nearer stands in the cells around.
  [[nodiscard]] bool hides(double u, double v, double disparity) const {
    const std::int64_t row = row_of(v), column = column_of(u);
    double nearest = 0.0;
    for (std::int64_t r = std::max<std::int64_t>(row - 1, 0); r <= std::min(row + 1, rows_ - 1);
         ++r) {
      for (std::int64_t c = std::max<std::int64_t>(column - 1, 0);
           c <= std::min(column + 1, columns_ - 1); ++c) {
        nearest = std::max(nearest, nearest_[r * columns_ + c]);
      }
    }
    return disparity < nearest - std::max(kHidingPixels, kHidingShare * disparity);
  }

 private:
  [[nodiscard]] std::int64_t row_of(double v) const {
    return std::clamp<std::int64_t>(static_cast<std::int64_t>(v / side_), 0, rows_ - 1);
  }
  [[nodiscard]] std::int64_t column_of(double u) const {
    return std::clamp<std::int64_t>(static_cast<std::int64_t>(u / side_), 0, columns_ - 1);
  }

  double side_;
  std::int64_t rows_, columns_;
  std::vector<double> nearest_;
};

// Points within range that lie in the picture, a pixel from its edges.
std::vector<Asked> points_in_picture(const PointsView& view, const DisparityView& picture,
                                     const StereoView& camera, const CrossModalOptions& options,
                                     Ticker& ticker) {
  const Eigen::Matrix3d turn = camera.lidar_from_camera.topLeftCorner<3, 3>().inverse();
  const Eigen::Vector3d eye = camera.lidar_from_camera.topRightCorner<3, 1>();
  const auto last_u = static_cast<double>(picture.width - 2);
  const auto last_v = static_cast<double>(picture.height - 2);
  std::vector<Asked> found;
  for (std::int64_t i = 0; i < view.num_points(); ++i) {
    ticker.tick();
    const Eigen::Vector3d point = view.points.row(i).transpose().cast<double>();
    const Eigen::Vector3d place = turn * (point - eye);
    if (!(place.z() >= options.min_range && point.norm() <= options.max_range)) continue;
    const double u = camera.focal * place.x() / place.z() + camera.center_u;
    const double v = camera.focal * place.y() / place.z() + camera.center_v;
    if (!(u >= 1.0 && v >= 1.0 && u <= last_u && v <= last_v)) continue;
    found.push_back({static_cast<std::int32_t>(i), voxel_key(point, kCube), place, u, v,
                     camera.focal * camera.baseline / place.z(), 0.0, 0.0, false});
  }
  return found;
}

// Compares a point with the disparities around its pixel; false: the pixel is not measured.
bool ask(Asked& point, const DisparityView& picture, const StereoView& camera,
         const CrossModalOptions& options) {
  const double pixels = camera.focal * camera.baseline;
  const auto u = static_cast<std::int64_t>(point.u + 0.5);
  const auto v = static_cast<std::int64_t>(point.v + 0.5);
  const double seen = picture.data[v * picture.width + u];
  if (!(seen > 0.0 && seen <= pixels / options.min_range)) return false;
  double least = std::numeric_limits<double>::infinity();
  for (std::int64_t dv = -1; dv <= 1; ++dv) {
    for (std::int64_t du = -1; du <= 1; ++du) {
      const double other = picture.data[(v + dv) * picture.width + u + du];
      if (!(other > 0.0)) continue;
      const double difference = point.disparity - other;
      if (std::abs(difference) < std::abs(least)) least = difference;
    }
  }
  const double of_depth =
      options.point_depth_tolerance * point.disparity * point.disparity / pixels;
  point.seen = seen;
  point.difference = least;
  point.is_contradicted = std::abs(least) > options.point_tolerance + of_depth;
  return true;
}

// The extent of the middle nine tenths of some values; reorders them.
double extent(std::vector<double>& values) {
  const std::size_t cut = values.size() / 20;
  const auto low = values.begin() + static_cast<std::ptrdiff_t>(cut);
  const auto high = values.end() - 1 - static_cast<std::ptrdiff_t>(cut);
  std::nth_element(values.begin(), low, values.end());
  const double lowest = *low;
  std::nth_element(values.begin(), high, values.end());
  return *high - lowest;
}

struct Cluster {
  std::vector<std::int32_t> contradicted;  // indices of points
  std::int64_t agreeing = 0;
};

bool is_large(const std::vector<Asked>& points, const Cluster& cluster) {
  std::vector<double> across, along;
  for (const std::int32_t k : cluster.contradicted) {
    across.push_back(points[k].place.x());
    along.push_back(points[k].place.y());
  }
  return extent(across) >= kLeastWidth && extent(along) >= kLeastHeight;
}

ContradictedObject to_object(const std::vector<Asked>& points, const Cluster& cluster,
                             const StereoView& camera) {
  ContradictedObject object;
  std::int64_t before = 0;
  for (const std::int32_t k : cluster.contradicted) {
    const Asked& point = points[k];
    const Eigen::Vector3d place = point.place * (point.disparity / point.seen);
    object.points.push_back({point.row,
                             camera.lidar_from_camera.topLeftCorner<3, 3>() * place +
                                 camera.lidar_from_camera.topRightCorner<3, 1>(),
                             point.difference});
    before += point.difference > 0.0 ? 1 : 0;
  }
  object.added = 2 * before > std::ssize(object.points);
  return object;
}

}  // namespace

std::vector<ContradictedObject> find_contradicted_objects(const PointsView& view,
                                                          const DisparityView& disparity,
                                                          const StereoView& camera,
                                                          const CrossModalOptions& options,
                                                          const Progress& progress) {
  Ticker ticker(progress);
  const std::vector<Asked> pictured = points_in_picture(view, disparity, camera, options, ticker);
  NearestInPicture nearest(disparity, camera.focal);
  for (const Asked& point : pictured) nearest.add(point.u, point.v, point.disparity);
  std::vector<Asked> points;
  for (Asked point : pictured) {
    ticker.tick();
    if (nearest.hides(point.u, point.v, point.disparity)) continue;
    if (ask(point, disparity, camera, options)) points.push_back(point);
  }
  std::vector<std::uint64_t> cubes;
  for (const Asked& point : points) {
    if (point.is_contradicted) cubes.push_back(point.cube);
  }
  const std::int64_t all = std::ssize(cubes);
  std::sort(cubes.begin(), cubes.end());
  cubes.erase(std::unique(cubes.begin(), cubes.end()), cubes.end());
  const VoxelClusters touching(std::move(cubes), ticker);
  std::vector<Cluster> clusters(touching.size());
  for (std::size_t k = 0; k < points.size(); ++k) {
    const std::int32_t number = touching.cluster_of(points[k].cube);
    if (number < 0) continue;
    if (points[k].is_contradicted) {
      clusters[number].contradicted.push_back(static_cast<std::int32_t>(k));
    } else {
      ++clusters[number].agreeing;
    }
  }
  std::vector<ContradictedObject> objects;
  for (const Cluster& cluster : clusters) {
    const std::int64_t count = std::ssize(cluster.contradicted);
    const auto asked = static_cast<double>(count + cluster.agreeing);
    if (count < options.min_points || static_cast<double>(count) < options.min_share * asked) {
      continue;
    }
    if (static_cast<double>(count) < options.min_of_others * static_cast<double>(all - count)) {
      continue;
    }
    if (is_large(points, cluster)) objects.push_back(to_object(points, cluster, camera));
  }
  return objects;
}

}  // namespace manip3d
