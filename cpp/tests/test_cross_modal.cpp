// Compares the cross-modal check with loops over all points and pixels of each cell, in double,
// from the formulas of its header. Points and pixels near the border of a cell are left out, and so
// are scenes with close comparisons, whose results may differ between float and double.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <numbers>
#include <set>
#include <vector>

#include "manip3d/authenticate/cross_modal.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/random.hpp"

namespace manip3d {
namespace {

constexpr double kDegrees = std::numbers::pi / 180.0;
constexpr double kBorder = 0.02;  // in cells: smallest distance of points from the borders of cells
constexpr double kClose = 1e-5;   // 1/m: smallest difference of inverse ranges in comparisons

struct Scene {
  PointCloud cloud;
  std::vector<float> disparity;
  std::vector<std::uint8_t> grey;
  std::int64_t height = 24, width = 48;
  StereoView camera;
  CrossModalOptions options;

  [[nodiscard]] DisparityView view() const {
    return {disparity.data(), height, width, grey.empty() ? nullptr : grey.data()};
  }
  [[nodiscard]] CrossModalResult run() const {
    return compare_cross_modal(cloud, view(), camera, options);
  }
};

struct Sight {
  std::int64_t row = -1, column = -1;
  double range = 0.0;
  bool is_near_border = false;
  [[nodiscard]] bool is_inside() const { return row >= 0; }
};

std::int64_t count_of(double extent, double step) {
  return static_cast<std::int64_t>(std::ceil(extent / step));
}

Sight sight_of(const Eigen::Vector3d& point, const CrossModalOptions& o) {
  const double azimuth = std::atan2(point.y(), point.x()) / kDegrees;
  const double elevation = std::atan2(point.z(), std::hypot(point.x(), point.y())) / kDegrees;
  const double column = (o.half_azimuth - azimuth) / o.azimuth_step;
  const double row = (o.highest - elevation) / o.elevation_step;
  Sight sight;
  sight.range = point.norm();
  sight.is_near_border =
      std::abs(column - std::round(column)) < kBorder || std::abs(row - std::round(row)) < kBorder;
  if (column >= 0.0 && row >= 0.0 &&
      column < double(count_of(2.0 * o.half_azimuth, o.azimuth_step)) &&
      row < double(count_of(o.highest - o.lowest, o.elevation_step))) {
    sight.row = static_cast<std::int64_t>(row);
    sight.column = static_cast<std::int64_t>(column);
  }
  return sight;
}

Eigen::Vector3d point_of_pixel(const Scene& scene, std::int64_t v, std::int64_t u, double d) {
  const StereoView& c = scene.camera;
  const double z = c.focal * c.baseline / d;
  const Eigen::Vector4d seen((double(u) - c.center_u) / c.focal * z,
                             (double(v) - c.center_v) / c.focal * z, z, 1.0);
  return (c.lidar_from_camera * seen).head<3>();
}

// A wall with objects in front of it; some are seen only by the scanner, some only by the cameras.
Scene random_scene(std::uint64_t seed) {
  std::uint64_t next = 0;
  const auto random = [&](double low, double high) {
    return low + (high - low) * uniform(seed, next++);
  };
  Scene scene;
  CrossModalOptions& o = scene.options;
  o.azimuth_step = random(2.5, 4.0);
  o.elevation_step = random(2.5, 4.0);
  o.half_azimuth = 40.0;
  o.lowest = -22.0;
  o.highest = 18.0;
  o.min_range = 4.0;
  o.max_range = random(15.0, 40.0);
  o.tolerance = random(0.5, 2.0);
  o.min_cells = 1 + static_cast<std::int64_t>(random(0.0, 3.0));
  o.min_added_area = random(0.0, 1.0);
  o.min_missing_area = random(0.0, 1.0);
  o.dark_level = random(0.0, 255.0);
  o.dark_weight = random(0.0, 1.0);
  scene.camera = {24.0, 23.5, 11.5, 0.5, Eigen::Matrix4d::Identity()};
  scene.camera.lidar_from_camera << 0, 0, 1, 0.27, -1, 0, 0, 0.06, 0, -1, 0, -0.08, 0, 0, 0, 1;
  struct Thing {
    double azimuth, elevation, radius, range;
    bool scanned, pictured, swallows;  // swallows: returns none of the scanner's light
  };
  std::vector<Thing> things;
  for (int k = 0; k < 5; ++k) {
    things.push_back({random(-35.0, 35.0), random(-18.0, 14.0), random(7.0, 16.0),
                      random(3.5, 14.0), random(0.0, 1.0) < 0.6, random(0.0, 1.0) < 0.6,
                      random(0.0, 1.0) < 0.3});
  }
  const double wall = random(14.0, 30.0);
  const auto distance = [&](double azimuth, double elevation, bool scanner) {
    double nearest = wall;
    for (const Thing& t : things) {
      if (!(scanner ? t.scanned : t.pictured)) continue;
      if (std::hypot(azimuth - t.azimuth, elevation - t.elevation) < t.radius) {
        nearest = std::min(nearest, t.range);
      }
    }
    return nearest * random(0.97, 1.03);
  };
  std::vector<Eigen::RowVector3f> points;
  for (double azimuth = -44.0; azimuth < 44.0; azimuth += 1.7) {
    for (double elevation = -24.0; elevation < 20.0; elevation += 1.9) {
      const bool is_swallowed = std::any_of(things.begin(), things.end(), [&](const Thing& t) {
        return t.swallows && std::hypot(azimuth - t.azimuth, elevation - t.elevation) < t.radius;
      });
      if (is_swallowed || random(0.0, 1.0) < 0.15) continue;
      const double r = distance(azimuth, elevation, true);
      const double a = azimuth * kDegrees, e = elevation * kDegrees;
      const Eigen::RowVector3f point =
          (r *
           Eigen::RowVector3d(std::cos(e) * std::cos(a), std::cos(e) * std::sin(a), std::sin(e)))
              .cast<float>();
      if (!sight_of(point.transpose().cast<double>(), o).is_near_border) points.push_back(point);
    }
  }
  scene.cloud.points.resize(static_cast<Eigen::Index>(points.size()), 3);
  for (std::size_t i = 0; i < points.size(); ++i) {
    scene.cloud.points.row(static_cast<Eigen::Index>(i)) = points[i];
  }
  for (std::int64_t v = 0; v < scene.height; ++v) {
    for (std::int64_t u = 0; u < scene.width; ++u) {
      const double azimuth = -std::atan((double(u) - 23.5) / 24.0) / kDegrees;
      const double elevation = -std::atan((double(v) - 11.5) / 24.0) / kDegrees;
      auto d = static_cast<float>(12.0 / distance(azimuth, elevation, false));
      if (random(0.0, 1.0) < 0.1) d = random(0.0, 1.0) < 0.5 ? -1.0F : 0.0F;
      if (d > 0.0F && sight_of(point_of_pixel(scene, v, u, d), o).is_near_border) d = 0.0F;
      scene.disparity.push_back(d);
      scene.grey.push_back(static_cast<std::uint8_t>(random(0.0, 256.0)));
    }
  }
  if (random(0.0, 1.0) < 0.2) scene.grey.clear();
  return scene;
}

struct Cell {
  std::vector<double> scanner, cameras, grey;  // inverse ranges, 1/m; grey levels
};

struct Expected {
  std::int64_t rows = 0, columns = 0;
  std::vector<int> mask, judged;
  std::vector<CrossModalComponent> components;  // in any order
  std::set<std::int32_t> suspected;
  std::int64_t judged_points = 0;
  bool is_close = false;
};

Expected by_brute_force(const Scene& scene) {
  const CrossModalOptions& o = scene.options;
  Expected told;
  told.rows = count_of(o.highest - o.lowest, o.elevation_step);
  told.columns = count_of(2.0 * o.half_azimuth, o.azimuth_step);
  std::vector<Cell> cells(told.rows * told.columns);
  std::vector<Sight> of_point;
  for (Eigen::Index i = 0; i < scene.cloud.points.rows(); ++i) {
    of_point.push_back(sight_of(scene.cloud.points.row(i).transpose().cast<double>(), o));
    const Sight& s = of_point.back();
    if (s.is_inside()) cells[s.row * told.columns + s.column].scanner.push_back(1.0 / s.range);
  }
  for (std::int64_t v = 0; v < scene.height; ++v) {
    for (std::int64_t u = 0; u < scene.width; ++u) {
      const double d = scene.disparity[v * scene.width + u];
      if (!(d > 0.0)) continue;
      const Sight s = sight_of(point_of_pixel(scene, v, u, d), o);
      if (!s.is_inside()) continue;
      Cell& cell = cells[s.row * told.columns + s.column];
      cell.cameras.push_back(1.0 / s.range);
      if (!scene.grey.empty()) cell.grey.push_back(scene.grey[v * scene.width + u]);
    }
  }
  const double pixels = scene.camera.focal * scene.camera.baseline;
  const double tolerance = o.tolerance / pixels;
  const auto is_less = [&](double a, double b) {
    told.is_close = told.is_close || std::abs(a - b) < kClose;
    return a < b;
  };
  const auto direction = [&](std::int64_t row, std::int64_t column) {
    const double a = (o.half_azimuth - (double(column) + 0.5) * o.azimuth_step) * kDegrees;
    const double e = (o.highest - (double(row) + 0.5) * o.elevation_step) * kDegrees;
    return Eigen::Vector3d(std::cos(e) * std::cos(a), std::cos(e) * std::sin(a), std::sin(e));
  };
  told.mask.assign(cells.size(), 0);
  told.judged.assign(cells.size(), 0);
  std::vector<double> limit(cells.size(), 0.0);
  for (std::int64_t row = 0; row < told.rows; ++row) {
    for (std::int64_t column = 0; column < told.columns; ++column) {
      std::vector<double> scanner, cameras;
      int measured = 0;
      for (std::int64_t r = row - 1; r <= row + 1; ++r) {
        for (std::int64_t c = column - 1; c <= column + 1; ++c) {
          if (r < 0 || c < 0 || r >= told.rows || c >= told.columns) continue;
          const Cell& cell = cells[r * told.columns + c];
          scanner.insert(scanner.end(), cell.scanner.begin(), cell.scanner.end());
          cameras.insert(cameras.end(), cell.cameras.begin(), cell.cameras.end());
          measured += cell.cameras.empty() ? 0 : 1;
        }
      }
      if (measured < 5) continue;
      const std::int64_t at = row * told.columns + column;
      const double seen_first = *std::max_element(cameras.begin(), cameras.end());
      const double seen_last = *std::min_element(cameras.begin(), cameras.end());
      const double behind =
          scanner.empty() ? 0.0 : *std::max_element(scanner.begin(), scanner.end());
      bool added = false, could_be_added = false;
      if (!cells[at].scanner.empty()) {
        const double front = *std::max_element(cells[at].scanner.begin(), cells[at].scanner.end());
        const Eigen::Vector3d place = direction(row, column) / front;
        // The camera looks along the LiDAR's x axis from x = 0.27 m.
        could_be_added = !is_less(front, 1.0 / o.max_range) && !is_less(1.0 / o.min_range, front) &&
                         !is_less(place.x() - 0.27, o.min_range);
        added = could_be_added && is_less(seen_first + tolerance, front);
        if (added) limit[at] = seen_first + tolerance;
      }
      const bool could_be_missing = !cells[at].cameras.empty() &&
                                    !is_less(seen_last, 1.0 / o.max_range) &&
                                    !is_less(1.0 / o.min_range, seen_first);
      const bool missing = could_be_missing && !added && is_less(behind + tolerance, seen_last);
      told.judged[at] = could_be_added || could_be_missing ? 1 : 0;
      told.mask[at] = added ? 1 : missing ? -1 : 0;
    }
  }
  // The smallest cell number spreads over its component.
  std::vector<int> label(cells.size());
  for (std::size_t k = 0; k < label.size(); ++k) label[k] = static_cast<int>(k);
  for (bool changed = true; changed;) {
    changed = false;
    for (std::int64_t at = 0; at < std::int64_t(cells.size()); ++at) {
      for (std::int64_t other = 0; other < std::int64_t(cells.size()); ++other) {
        if (told.mask[at] == 0 || told.mask[at] != told.mask[other]) continue;
        if (std::abs(at / told.columns - other / told.columns) > 1) continue;
        if (std::abs(at % told.columns - other % told.columns) > 1) continue;
        if (label[other] < label[at]) {
          label[at] = label[other];
          changed = true;
        }
      }
    }
  }
  std::map<int, CrossModalComponent> components;
  for (std::int64_t at = 0; at < std::int64_t(cells.size()); ++at) {
    if (told.mask[at] == 0) continue;
    CrossModalComponent& part = components[label[at]];
    const Cell& cell = cells[at];
    part.added = told.mask[at] > 0;
    double inverse = 0.0;
    if (part.added) {
      inverse = *std::max_element(cell.scanner.begin(), cell.scanner.end());
    } else {
      for (const double each : cell.cameras) inverse += each / double(cell.cameras.size());
    }
    double level = 0.0;
    for (const double each : cell.grey) level += each / double(cell.grey.size());
    const bool empty = cell.scanner.empty();
    if (empty && !cell.grey.empty()) is_less(level, o.dark_level);
    const bool dark = empty && !cell.grey.empty() && level < o.dark_level;
    const double elevation =
        (o.highest - (double(at / told.columns) + 0.5) * o.elevation_step) * kDegrees;
    const double angle =
        o.azimuth_step * kDegrees * o.elevation_step * kDegrees * std::cos(elevation);
    ++part.cells;
    part.empty += empty ? 1 : 0;
    part.dark += dark ? 1 : 0;
    if (!part.added && !empty) {
      const double scanner = *std::max_element(cell.scanner.begin(), cell.scanner.end());
      is_less(1.0 / scanner, 1.0 / inverse + kNearBehind);
      part.behind += 1.0 / scanner <= 1.0 / inverse + kNearBehind ? 1 : 0;
    }
    part.solid_angle += angle;
    part.area += angle / (inverse * inverse);
    part.evidence += angle / (inverse * inverse) * (dark ? o.dark_weight : 1.0);
  }
  for (const auto& [number, part] : components) {
    const double least = part.added ? o.min_added_area : o.min_missing_area;
    told.is_close = told.is_close || std::abs(part.evidence - least) < 1e-3 * (least + 1.0);
    if (part.cells >= o.min_cells && part.evidence >= least) {
      told.components.push_back(part);
      continue;
    }
    for (std::size_t at = 0; at < cells.size(); ++at) {
      if (told.mask[at] != 0 && label[at] == number) told.mask[at] = 0;
    }
  }
  for (std::size_t i = 0; i < of_point.size(); ++i) {
    if (!of_point[i].is_inside()) continue;
    const std::int64_t at = of_point[i].row * told.columns + of_point[i].column;
    told.judged_points += told.judged[at];
    if (told.mask[at] == 1 && is_less(limit[at], 1.0 / of_point[i].range)) {
      told.suspected.insert(static_cast<std::int32_t>(i));
    }
  }
  return told;
}

TEST(CrossModal, IsWhatLoopsOverAllPointsAndPixelsFind) {
  int compared = 0, added = 0, missing = 0, dark = 0, refused = 0;
  for (std::uint64_t seed = 0; seed < 400; ++seed) {
    const Scene scene = random_scene(seed);
    const Expected told = by_brute_force(scene);
    if (told.is_close) {
      ++refused;
      continue;
    }
    ++compared;
    const CrossModalResult found = scene.run();
    ASSERT_EQ(found.rows, told.rows);
    ASSERT_EQ(found.columns, told.columns);
    ASSERT_EQ(std::vector<int>(found.mask.begin(), found.mask.end()), told.mask) << seed;
    ASSERT_EQ(std::vector<int>(found.judged.begin(), found.judged.end()), told.judged) << seed;
    EXPECT_EQ(found.judged_points, told.judged_points);
    EXPECT_EQ(std::set<std::int32_t>(found.suspected.begin(), found.suspected.end()),
              told.suspected);
    ASSERT_EQ(found.components.size(), told.components.size()) << seed;
    std::vector<CrossModalComponent> sorted = told.components;
    std::sort(sorted.begin(), sorted.end(),
              [](const auto& a, const auto& b) { return a.area > b.area; });
    for (std::size_t k = 0; k < sorted.size(); ++k) {
      const CrossModalComponent &a = found.components[k], &b = sorted[k];
      EXPECT_EQ(a.added, b.added) << seed;
      EXPECT_EQ(a.cells, b.cells) << seed;
      EXPECT_EQ(a.empty, b.empty) << seed;
      EXPECT_EQ(a.dark, b.dark) << seed;
      EXPECT_EQ(a.behind, b.behind) << seed;
      EXPECT_NEAR(a.solid_angle, b.solid_angle, 1e-4 * b.solid_angle);
      EXPECT_NEAR(a.area, b.area, 1e-4 * b.area);
      EXPECT_NEAR(a.evidence, b.evidence, 1e-4 * b.evidence + 1e-9);
      EXPECT_TRUE((a.lower.array() <= a.upper.array()).all());
      (b.added ? added : missing) += 1;
      dark += b.dark > 0 ? 1 : 0;
    }
  }
  // The scenes contained both kinds of regions, with and without dark cells.
  EXPECT_GT(compared, 100) << refused;
  EXPECT_GT(added, 50);
  EXPECT_GT(missing, 50);
  EXPECT_GT(dark, 20);
}

// A wall 20 m ahead; the scanner has no return from a square in which the cameras see something.
Scene wall_with_a_hole(std::uint8_t level) {
  Scene scene;
  scene.height = 120;
  scene.width = 240;
  scene.camera = {120.0, 119.5, 59.5, 0.5, Eigen::Matrix4d::Identity()};
  scene.camera.lidar_from_camera << 0, 0, 1, 0, -1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 0, 1;
  scene.options.azimuth_step = scene.options.elevation_step = 1.0;
  scene.options.lowest = -20.0;
  scene.options.highest = 20.0;
  std::vector<Eigen::RowVector3f> points;
  for (double a = -44.75; a < 45.0; a += 0.5) {
    for (double e = -19.75; e < 20.0; e += 0.5) {
      if (std::abs(a) < 5.0 && std::abs(e) < 5.0) continue;
      points.emplace_back(20.0F, float(20.0 * std::tan(a * kDegrees)),
                          float(20.0 / std::cos(a * kDegrees) * std::tan(e * kDegrees)));
    }
  }
  scene.cloud.points.resize(static_cast<Eigen::Index>(points.size()), 3);
  for (std::size_t i = 0; i < points.size(); ++i) {
    scene.cloud.points.row(static_cast<Eigen::Index>(i)) = points[i];
  }
  scene.disparity.assign(120 * 240, 60.0F / 20.0F);
  for (int v = 50; v < 70; ++v) {
    for (int u = 110; u < 130; ++u) scene.disparity[v * 240 + u] = 60.0F / 8.0F;
  }
  scene.grey.assign(120 * 240, level);
  return scene;
}

TEST(CrossModal, ADarkSurfaceWithoutReturnsIsWeakEvidence) {
  Scene scene = wall_with_a_hole(200);
  const CrossModalResult bright = scene.run();
  ASSERT_EQ(bright.components.size(), 1U);
  EXPECT_FALSE(bright.components[0].added);
  EXPECT_EQ(bright.components[0].dark, 0);
  EXPECT_EQ(bright.components[0].evidence, bright.components[0].area);
  scene = wall_with_a_hole(20);
  scene.options.min_missing_area = 0.2 * bright.components[0].area;
  const CrossModalResult dark = scene.run();
  ASSERT_EQ(dark.components.size(), 1U);
  EXPECT_EQ(dark.components[0].dark, dark.components[0].cells);
  EXPECT_NEAR(dark.components[0].evidence, 0.25 * bright.components[0].area, 1e-9);
  scene.options.min_missing_area = 0.3 * bright.components[0].area;
  EXPECT_TRUE(scene.run().components.empty());
  scene.grey.clear();  // without a picture, no cell counts as dark
  EXPECT_EQ(scene.run().components.size(), 1U);
}

TEST(CrossModal, RefusesOptionsByName) {
  Scene scene = wall_with_a_hole(200);
  for (const double wrong : {-0.1, 1.1, std::numeric_limits<double>::quiet_NaN()}) {
    scene.options.dark_weight = wrong;
    EXPECT_THROW(static_cast<void>(scene.run()), InputError) << wrong;
  }
  scene.options.dark_weight = 0.5;
  scene.options.dark_level = std::numeric_limits<double>::infinity();
  EXPECT_THROW(static_cast<void>(scene.run()), InputError);
}

}  // namespace
}  // namespace manip3d
