#include "manip3d/authenticate/cross_modal.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "geometry/constants.hpp"
#include "geometry/directions.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/angles.hpp"
#include "manip3d/geometry/connected_runs.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kMaxMapCells = 1 << 22;
constexpr std::int32_t kOutsideMap = -1;
constexpr float kMinDisparity = 1e-3F;  // pixels: as far as infinity
constexpr int kEnoughNeighbours = 5;    // of the nine cells around, that the cameras measured

void check_camera(const DisparityView& disparity, const StereoView& camera) {
  if (disparity.height < 1 || disparity.width < 1 ||
      disparity.height > std::numeric_limits<std::int32_t>::max() / disparity.width) {
    throw InputError("disparity: expected an image of 1 to 2147483647 pixels");
  }
  if (!(camera.focal > 0.0 && camera.baseline > 0.0 &&
        std::isfinite(camera.focal * camera.baseline))) {
    throw InputError("camera: expected a focal length and a baseline > 0");
  }
  if (!(std::isfinite(camera.center_u) && std::isfinite(camera.center_v) &&
        camera.lidar_from_camera.allFinite())) {
    throw InputError("camera: expected finite numbers");
  }
}

void check_cross_modal_options(const CrossModalOptions& options) {
  if (!(options.heading >= -360.0 && options.heading <= 360.0)) {
    throw InputError("heading: expected -360 to 360 degrees, got " + number_text(options.heading));
  }
  if (!(options.azimuth_step > 0.0 && std::isfinite(options.azimuth_step) &&
        options.elevation_step > 0.0 && std::isfinite(options.elevation_step))) {
    throw InputError("azimuth_step, elevation_step: expected finite numbers > 0");
  }
  if (!(options.half_azimuth > 0.0 && options.half_azimuth <= 90.0)) {
    throw InputError("half_azimuth: expected > 0 to 90 degrees, got " +
                     number_text(options.half_azimuth));
  }
  if (!(options.lowest >= -90.0 && options.lowest < options.highest && options.highest <= 90.0)) {
    throw InputError("lowest, highest: expected -90 <= lowest < highest <= 90 degrees");
  }
  if (!(options.min_range > 0.0 && options.min_range < options.max_range &&
        std::isfinite(options.max_range))) {
    throw InputError("min_range, max_range: expected 0 < min_range < max_range");
  }
  if (!(options.tolerance > 0.0 && std::isfinite(options.tolerance))) {
    throw InputError("tolerance: expected a number > 0, got " + number_text(options.tolerance));
  }
  if (!(std::isfinite(options.dark_level) && options.dark_weight >= 0.0 &&
        options.dark_weight <= 1.0)) {
    throw InputError("dark_level, dark_weight: expected a number and 0 to 1");
  }
  if (!(options.min_cells >= 1 && options.min_added_area >= 0.0 &&
        options.min_missing_area >= 0.0)) {
    throw InputError("min_cells, min_added_area, min_missing_area: expected >= 1, >= 0 and >= 0");
  }
}

// A rotation about the vertical that takes the heading to the x axis.
Eigen::Matrix3d turn_to_front(double heading_deg) {
  const auto [sine, cosine] = sin_cos(heading_deg * kDegree);
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();
  turn.topLeftCorner<2, 2>() << cosine, sine, -sine, cosine;
  return turn;
}

Points turned_points(const PointsView& view, const Eigen::Matrix3d& turn) {
  Points turned(view.num_points(), 3);
  for (std::int64_t i = 0; i < view.num_points(); ++i) {
    const Eigen::Vector3d point = view.points.row(i).transpose().cast<double>();
    turned.row(i) = (turn * point).transpose().cast<float>();
  }
  return turned;
}

// Equirectangular cells in front of the scanner; row 0 is the highest, column 0 the leftmost.
class FrontMap {
 public:
  explicit FrontMap(const CrossModalOptions& options)
      : left_(static_cast<float>(options.half_azimuth * kDegree)),
        top_(static_cast<float>(options.highest * kDegree)),
        azimuth_scale_(static_cast<float>(1.0 / (options.azimuth_step * kDegree))),
        elevation_scale_(static_cast<float>(1.0 / (options.elevation_step * kDegree))) {
    const double columns = std::ceil(2.0 * options.half_azimuth / options.azimuth_step);
    const double rows = std::ceil((options.highest - options.lowest) / options.elevation_step);
    if (!(columns * rows <= kMaxMapCells)) {
      throw InputError("azimuth_step, elevation_step: expected at most 2^22 cells");
    }
    columns_ = static_cast<std::int64_t>(columns);
    rows_ = static_cast<std::int64_t>(rows);
  }

  [[nodiscard]] std::int64_t rows() const { return rows_; }
  [[nodiscard]] std::int64_t columns() const { return columns_; }
  [[nodiscard]] std::int64_t cells() const { return rows_ * columns_; }

  [[nodiscard]] std::int32_t cell(float azimuth, float elevation) const {
    const float column = (left_ - azimuth) * azimuth_scale_;
    const float row = (top_ - elevation) * elevation_scale_;
    const bool inside = column >= 0.0F && row >= 0.0F && column < static_cast<float>(columns_) &&
                        row < static_cast<float>(rows_);
    if (!inside) return kOutsideMap;
    return static_cast<std::int32_t>(static_cast<std::int64_t>(row) * columns_ +
                                     static_cast<std::int64_t>(column));
  }

  // The unit vector towards the centre of a cell.
  [[nodiscard]] Eigen::Vector3d direction(std::int64_t cell) const {
    const auto [sin_a, cos_a] =
        sin_cos(left_ - (static_cast<double>(cell % columns_) + 0.5) / azimuth_scale_);
    const auto [sin_e, cos_e] = sin_cos(elevation(cell));
    return {cos_e * cos_a, cos_e * sin_a, sin_e};
  }

  [[nodiscard]] double solid_angle(std::int64_t cell) const {
    return sin_cos(elevation(cell)).cos / (double{azimuth_scale_} * elevation_scale_);
  }

 private:
  [[nodiscard]] double elevation(std::int64_t cell) const {
    return top_ - (static_cast<double>(cell / columns_) + 0.5) / elevation_scale_;
  }

  float left_, top_, azimuth_scale_, elevation_scale_;
  std::int64_t rows_ = 0, columns_ = 0;
};

// Inverse ranges of each cell, 1/m. Count 0: nothing was seen there.
struct InverseRanges {
  explicit InverseRanges(std::int64_t cells)
      : nearest(cells, 0.0F), farthest(cells, kInfinityF), sum(cells, 0.0), count(cells, 0) {}

  // Adds a pixel with its grey level. The brightness of a cell is the mean of its pixels' levels.
  void add(std::int32_t cell, float inverse, std::uint8_t level) {
    if (grey.empty()) grey.assign(count.size(), 0);
    grey[cell] += level;
    add(cell, inverse);
  }
  void add(std::int32_t cell, float inverse) {
    nearest[cell] = std::max(nearest[cell], inverse);
    farthest[cell] = std::min(farthest[cell], inverse);
    sum[cell] += inverse;
    ++count[cell];
  }
  [[nodiscard]] double mean(std::int64_t cell) const {
    return count[cell] > 0 ? sum[cell] / count[cell] : 0.0;
  }
  [[nodiscard]] bool is_dark(std::int64_t cell, double level) const {
    return !grey.empty() && count[cell] > 0 &&
           static_cast<double>(grey[cell]) < level * count[cell];
  }

  std::vector<float> nearest, farthest;
  std::vector<double> sum;
  std::vector<std::int32_t> count;
  std::vector<std::int64_t> grey;
};

struct CellOfPoint {
  std::int32_t cell;
  float inverse_range;
};

std::vector<CellOfPoint> project_points(const PointsView& view, const FrontMap& map,
                                        InverseRanges& seen, const Progress& progress) {
  Ticker ticker(progress);
  std::vector<CellOfPoint> places(view.num_points());
  const auto project = [&](std::int64_t i, const Direction& direction) {
    ticker.tick();
    CellOfPoint& place = places[i];
    place.cell =
        direction.range > 0.0F ? map.cell(direction.azimuth, direction.elevation) : kOutsideMap;
    place.inverse_range = 1.0F / direction.range;
    if (place.cell != kOutsideMap) seen.add(place.cell, place.inverse_range);
  };
  for_each_direction(view.points.data(), 3, 0, view.num_points(), Eigen::Vector3d::Zero(), project);
  return places;
}

// Enters the disparity image: depth z = f b / d along each pixel's ray, in the LiDAR's frame.
void project_disparity(const DisparityView& disparity, const StereoView& camera,
                       const FrontMap& map, InverseRanges& seen, const Progress& progress) {
  Ticker ticker(progress, 1U << 2);
  const Eigen::Matrix3d turn = camera.lidar_from_camera.topLeftCorner<3, 3>();
  const Eigen::Vector3d eye = camera.lidar_from_camera.topRightCorner<3, 1>();
  const double depth_of_pixel = camera.focal * camera.baseline;
  Directions directions;
  float xyz[3 * Directions::kBlock];
  std::uint8_t level[Directions::kBlock] = {};
  for (std::int64_t v = 0; v < disparity.height; ++v) {
    ticker.tick();
    const Eigen::Vector3d first =
        turn.col(1) * ((static_cast<double>(v) - camera.center_v) / camera.focal) + turn.col(2);
    const float* row = disparity.data + v * disparity.width;
    std::int64_t size = 0;
    const auto flush = [&] {
      directions.compute(xyz, 3, size, Eigen::Vector3d::Zero());
      for (std::int64_t k = 0; k < size; ++k) {
        if (!(directions.range[k] > 0.0F)) continue;
        const std::int32_t cell = map.cell(directions.azimuth[k], directions.elevation[k]);
        if (cell == kOutsideMap) continue;
        if (disparity.grey != nullptr) {
          seen.add(cell, 1.0F / directions.range[k], level[k]);
        } else {
          seen.add(cell, 1.0F / directions.range[k]);
        }
      }
      size = 0;
    };
    for (std::int64_t u = 0; u < disparity.width; ++u) {
      if (!(row[u] > kMinDisparity && row[u] < kInfinityF)) continue;
      const double z = depth_of_pixel / row[u];
      const double across = (static_cast<double>(u) - camera.center_u) / camera.focal;
      for (int axis = 0; axis < 3; ++axis) {
        xyz[3 * size + axis] =
            static_cast<float>(eye[axis] + z * (first[axis] + across * turn(axis, 0)));
      }
      if (disparity.grey != nullptr) level[size] = disparity.grey[v * disparity.width + u];
      if (++size == Directions::kBlock) flush();
    }
    flush();
  }
}

// Largest (`nearest`) and smallest (`farthest`) inverse range, 1/m, in the 3x3 cells around one,
// and the number of these cells that were seen.
struct Around {
  float nearest = 0.0F;
  float farthest = kInfinityF;
  int cells = 0;
};

Around around(const InverseRanges& seen, const FrontMap& map, std::int64_t row,
              std::int64_t column) {
  Around found;
  for (std::int64_t r = std::max<std::int64_t>(row - 1, 0); r <= std::min(row + 1, map.rows() - 1);
       ++r) {
    for (std::int64_t c = std::max<std::int64_t>(column - 1, 0);
         c <= std::min(column + 1, map.columns() - 1); ++c) {
      const std::int64_t cell = r * map.columns() + c;
      if (seen.count[cell] == 0) continue;
      found.nearest = std::max(found.nearest, seen.nearest[cell]);
      found.farthest = std::min(found.farthest, seen.farthest[cell]);
      ++found.cells;
    }
  }
  return found;
}

// Marks each cell. `limit` gets the inverse range above which the LiDAR points of an added cell
// count as added.
void mark_cells(const InverseRanges& lidar, const InverseRanges& stereo, const FrontMap& map,
                const StereoView& camera, const CrossModalOptions& options,
                CrossModalResult& result, std::vector<float>& limit) {
  const double pixels = camera.focal * camera.baseline;
  const Eigen::Vector3d ahead = camera.lidar_from_camera.col(2).head<3>();
  const double eye = ahead.dot(camera.lidar_from_camera.col(3).head<3>());
  const auto tolerance = static_cast<float>(options.tolerance / pixels);
  const auto nearest = static_cast<float>(1.0 / options.min_range);
  const auto farthest = static_cast<float>(1.0 / options.max_range);
  for (std::int64_t row = 0; row < map.rows(); ++row) {
    for (std::int64_t column = 0; column < map.columns(); ++column) {
      const std::int64_t cell = row * map.columns() + column;
      const Around cameras = around(stereo, map, row, column);
      if (cameras.cells < kEnoughNeighbours) continue;
      const Around scanner = around(lidar, map, row, column);
      const float front = lidar.nearest[cell];
      // Cameras match surfaces by depth along their axis, and find no match nearer than
      // `min_range`.
      const bool could_be_added = front >= farthest && front <= nearest &&
                                  ahead.dot(map.direction(cell)) / front - eye >= options.min_range;
      const bool could_be_missing =
          cameras.farthest >= farthest && cameras.nearest <= nearest && stereo.count[cell] > 0;
      if (!could_be_added && !could_be_missing) continue;
      result.judged[cell] = 1;
      result.difference[cell] = static_cast<float>((front - stereo.mean(cell)) * pixels);
      if (stereo.count[cell] == 0) {
        result.difference[cell] = static_cast<float>((front - cameras.nearest) * pixels);
      }
      if (could_be_added && front - cameras.nearest > tolerance) {
        result.mask[cell] = 1;
        limit[cell] = cameras.nearest + tolerance;
      } else if (could_be_missing && cameras.farthest - scanner.nearest > tolerance) {
        result.mask[cell] = -1;
      }
    }
  }
}

// A component and the bounding box of its points.
struct ComponentSums {
  CrossModalComponent component;
  Eigen::Vector3d lower = Eigen::Vector3d::Constant(kInfinity);
  Eigen::Vector3d upper = -lower;

  void extend(const Eigen::Vector3d& point) {
    lower = lower.cwiseMin(point);
    upper = upper.cwiseMax(point);
  }
};

// Appends the large components of one sign, and unmarks the cells of the small ones.
void find_components(const InverseRanges& lidar, const InverseRanges& stereo, const FrontMap& map,
                     const CrossModalOptions& options, bool added, CrossModalResult& result,
                     std::vector<std::int32_t>& component_of, std::vector<ComponentSums>& kept) {
  const std::int8_t sign = added ? 1 : -1;
  std::vector<std::uint8_t> marked(result.mask.size());
  std::transform(result.mask.begin(), result.mask.end(), marked.begin(),
                 [sign](std::int8_t mask) { return static_cast<std::uint8_t>(mask == sign); });
  ConnectedRuns finder;
  const std::vector<MarkedRun>& runs = finder.find(marked.data(), map.rows(), map.columns(), false);
  std::vector<ComponentSums> sums(finder.num_components());
  const auto visit = [&](const MarkedRun& run, const auto& use) {
    for (std::int64_t c = run.first; c <= run.last; ++c) use(run.row * map.columns() + c);
  };
  for (const MarkedRun& run : runs) {
    ComponentSums& each = sums[run.component];
    visit(run, [&](std::int64_t cell) {
      CrossModalComponent& part = each.component;
      const double inverse = added ? lidar.nearest[cell] : stereo.mean(cell);
      const double angle = map.solid_angle(cell);
      ++part.cells;
      part.empty += static_cast<std::int64_t>(lidar.count[cell] == 0);
      part.solid_angle += angle;
      part.area += angle / (inverse * inverse);
      const bool dark =
          !added && lidar.count[cell] == 0 && stereo.is_dark(cell, options.dark_level);
      part.dark += static_cast<std::int64_t>(dark);
      part.evidence += (dark ? options.dark_weight : 1.0) * angle / (inverse * inverse);
      part.behind +=
          static_cast<std::int64_t>(!added && lidar.count[cell] > 0 &&
                                    1.0 / lidar.nearest[cell] - 1.0 / inverse <= kNearBehind);
      part.difference += result.difference[cell];
      if (!added) each.extend(map.direction(cell) / inverse);
    });
  }
  const double least = added ? options.min_added_area : options.min_missing_area;
  std::vector<std::int32_t> number(sums.size(), kOutsideMap);
  for (std::size_t k = 0; k < sums.size(); ++k) {
    CrossModalComponent& part = sums[k].component;
    if (part.cells < options.min_cells || part.evidence < least) continue;
    part.added = added;
    part.difference /= static_cast<double>(part.cells);
    number[k] = static_cast<std::int32_t>(kept.size());
    kept.push_back(sums[k]);
  }
  for (const MarkedRun& run : runs) {
    visit(run, [&](std::int64_t cell) {
      component_of[cell] = number[run.component];
      if (number[run.component] == kOutsideMap) result.mask[cell] = 0;
    });
  }
}

std::vector<float> to_ranges(const InverseRanges& seen, bool nearest) {
  std::vector<float> ranges(seen.count.size(), 0.0F);
  for (std::size_t cell = 0; cell < ranges.size(); ++cell) {
    if (seen.count[cell] == 0) continue;
    const double inverse =
        nearest ? seen.nearest[cell] : seen.mean(static_cast<std::int64_t>(cell));
    ranges[cell] = static_cast<float>(1.0 / inverse);
  }
  return ranges;
}

// Compares the two maps in a frame whose x axis is the heading of the cameras.
CrossModalResult compare_ahead(const PointsView& view, const DisparityView& disparity,
                               const StereoView& camera, const CrossModalOptions& options,
                               const Progress& progress) {
  const FrontMap map(options);
  InverseRanges lidar(map.cells());
  InverseRanges stereo(map.cells());
  const std::vector<CellOfPoint> places =
      project_points(view, map, lidar, part_of(progress, 0.0, 0.4));
  project_disparity(disparity, camera, map, stereo, part_of(progress, 0.4, 0.9));

  CrossModalResult result;
  result.rows = map.rows();
  result.columns = map.columns();
  result.lidar = to_ranges(lidar, true);
  result.stereo = to_ranges(stereo, false);
  result.difference.assign(map.cells(), 0.0F);
  result.mask.assign(map.cells(), 0);
  result.judged.assign(map.cells(), 0);
  std::vector<float> limit(map.cells(), kInfinityF);
  mark_cells(lidar, stereo, map, camera, options, result, limit);

  std::vector<std::int32_t> component_of(map.cells(), kOutsideMap);
  std::vector<ComponentSums> kept;
  find_components(lidar, stereo, map, options, true, result, component_of, kept);
  find_components(lidar, stereo, map, options, false, result, component_of, kept);

  std::vector<std::int32_t> order(kept.size());
  for (std::size_t k = 0; k < order.size(); ++k) order[k] = static_cast<std::int32_t>(k);
  std::stable_sort(order.begin(), order.end(), [&](std::int32_t a, std::int32_t b) {
    return kept[a].component.area > kept[b].component.area;
  });
  std::vector<std::int32_t> place_of(kept.size());
  for (std::size_t k = 0; k < order.size(); ++k) {
    place_of[order[k]] = static_cast<std::int32_t>(k);
  }
  for (std::int64_t i = 0; i < view.num_points(); ++i) {
    const auto [cell, inverse] = places[i];
    if (cell == kOutsideMap) continue;
    result.judged_points += result.judged[cell];
    if (result.mask[cell] != 1 || !(inverse > limit[cell])) continue;
    ComponentSums& sums = kept[component_of[cell]];
    sums.extend(view.points.row(i).transpose().cast<double>());
    result.suspected.push_back(static_cast<std::int32_t>(i));
    result.suspected_component.push_back(place_of[component_of[cell]]);
  }
  for (const std::int32_t k : order) {
    CrossModalComponent part = kept[k].component;
    part.lower = kept[k].lower;
    part.upper = kept[k].upper;
    part.center = (part.lower + part.upper) / 2.0;
    result.components.push_back(part);
  }
  return result;
}

}  // namespace

CrossModalResult compare_cross_modal(const PointsView& view, const DisparityView& disparity,
                                     const StereoView& camera, const CrossModalOptions& options,
                                     const Progress& progress) {
  check_points(view);
  check_camera(disparity, camera);
  check_cross_modal_options(options);
  if (options.heading == 0.0) return compare_ahead(view, disparity, camera, options, progress);
  const Eigen::Matrix3d turn = turn_to_front(options.heading);
  const Points turned = turned_points(view, turn);
  StereoView ahead = camera;
  ahead.lidar_from_camera.topRows<3>() = turn * camera.lidar_from_camera.topRows<3>();
  CrossModalResult result = compare_ahead(PointsView({turned.data(), turned.rows(), 3}), disparity,
                                          ahead, options, progress);
  for (CrossModalComponent& part : result.components) {
    part.center = turn.transpose() * part.center;
  }
  return result;
}

}  // namespace manip3d
