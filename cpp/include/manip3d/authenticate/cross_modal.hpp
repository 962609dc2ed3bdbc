#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Left camera of a rectified stereo pair; pixel centres lie at integer (u, v).
struct StereoView {
  double focal = 0.0;     ///< Pixels.
  double center_u = 0.0;  ///< Principal point, pixels.
  double center_v = 0.0;
  double baseline = 0.0;  ///< Metres between the cameras.
  /// Camera (x right, y down, z forward) to LiDAR (x forward, y left, z up), metres.
  Eigen::Matrix4d lidar_from_camera = Eigen::Matrix4d::Identity();
};

struct DisparityView {
  const float* data = nullptr;  ///< (height, width), pixels; up to 0.001: not measured.
  std::int64_t height = 0, width = 0;
  /// Grey levels of the left picture, (height, width); null: no cell is dark.
  const std::uint8_t* grey = nullptr;
};

struct CrossModalOptions {
  double heading = 0.0;  ///< Degrees counter-clockwise from x: direction of the middle of the maps.
  double azimuth_step = 0.3;     ///< Degrees: width of a cell.
  double elevation_step = 0.45;  ///< Degrees: height of a cell.
  double half_azimuth = 45.0;    ///< Degrees to each side of the heading.
  double lowest = -24.0;  ///< Degrees: lower limit of the maps, inside the scanner's field of view.
  double highest = 1.5;   ///< Degrees: upper limit of the maps.
  /// Metres: nothing nearer is judged, neither by range nor by depth along the camera's axis.
  double min_range = 4.5;
  /// Metres: nothing farther is judged, since a pixel of disparity is too much depth there.
  double max_range = 30.0;
  double tolerance = 2.0;  ///< Pixels: a larger difference of disparities is a contradiction.
  /// Grey level below which a surface may be too dark to return anything.
  double dark_level = 50.0;
  double dark_weight = 0.25;      ///< Weight of a dark, empty cell as evidence; 0 to 1.
  std::int64_t min_cells = 25;    ///< Components of fewer cells are not reported.
  double min_added_area = 0.25;   ///< Square metres: least `evidence` of a reported component.
  double min_missing_area = 0.2;  ///< Square metres: as min_added_area, for missing components.
};

/// Metres: largest move away from the scanner after which an object still counts as moved, not
/// removed (dissertation, section 7.4).
inline constexpr double kNearBehind = 5.0;

/// Neighbouring cells in which LiDAR and cameras contradict each other in the same way.
struct CrossModalComponent {
  /// True: the LiDAR sees something in front of what the cameras see; false: it misses something.
  bool added = false;
  std::int64_t cells = 0;
  std::int64_t empty = 0;  ///< Cells in which the LiDAR sees nothing.
  std::int64_t dark = 0;   ///< Missing components: empty cells that are dark in the picture.
  /// Missing components: cells with a LiDAR point at most kNearBehind behind what the cameras see.
  std::int64_t behind = 0;
  double solid_angle = 0.0;  ///< Steradians.
  double area = 0.0;         ///< Square metres: sum over the cells, each at its own range.
  double evidence = 0.0;     ///< Like `area`, but dark empty cells count `dark_weight`.
  /// Pixels of disparity: mean over the cells of CrossModalResult::difference.
  double difference = 0.0;
  /// Metres: box around the added or missing object, in axes turned by the heading.
  Eigen::Vector3d lower = Eigen::Vector3d::Zero();
  Eigen::Vector3d upper = Eigen::Vector3d::Zero();
  Eigen::Vector3d center = Eigen::Vector3d::Zero();  ///< Middle of the box in the LiDAR's axes.
};

struct CrossModalResult {
  std::int64_t rows = 0, columns = 0;  ///< Shape of the maps: row 0 is the highest, column 0 left.
  std::vector<float> lidar;            ///< Range of the nearest point, metres; 0: none.
  std::vector<float> stereo;           ///< Harmonic mean of the pixels' ranges, metres; 0: none.
  std::vector<float> difference;       ///< LiDAR minus stereo, pixels of disparity; 0: not judged.
  /// 1 added, -1 missing, 0 neither; only cells of reported components.
  std::vector<std::int8_t> mask;
  std::vector<std::uint8_t> judged;  ///< 1: the cell could have been marked as added or missing.
  std::vector<CrossModalComponent> components;  ///< Components in order of decreasing area.
  std::vector<std::int32_t> suspected;          ///< Row numbers of the added points, ascending.
  std::vector<std::int32_t> suspected_component;
  std::int64_t judged_points = 0;  ///< Points of the scan in judged cells.
};

/// Compares a LiDAR scan with a stereo depth map (dissertation, section 7.3.2).
///
/// Both become equirectangular maps of inverse range around the scanner, centred on the heading of
/// the cameras. In inverse range, the error of stereo is the same at all distances. A cell is
/// marked "added" if its nearest LiDAR point is nearer than everything that the cameras see in the
/// 3x3 cells around it, and "missing" if everything that the cameras see there is nearer than every
/// LiDAR point there. LiDAR points nearer than `min_range` are never marked as added, because the
/// cameras cannot match so near. An empty cell on a dark surface is weak evidence, because dark
/// surfaces may return nothing: it counts `dark_weight`. Connected components (8 neighbours) above
/// the thresholds are reported. The result has the same bytes on every machine.
/// @throws InputError  the points fail check_points; a camera or an option out of range.
CrossModalResult compare_cross_modal(const PointsView& view, const DisparityView& disparity,
                                     const StereoView& camera,
                                     const CrossModalOptions& options = {},
                                     const Progress& progress = {});

}  // namespace manip3d
