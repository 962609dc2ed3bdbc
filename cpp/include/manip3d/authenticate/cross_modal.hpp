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
  const float* data = nullptr;  ///< (height, width), pixels; not above 0: not measured.
  std::int64_t height = 0, width = 0;
  const std::uint8_t* grey =
      nullptr;  ///< The left picture, (height, width); null: nothing is dark.
};

struct CrossModalOptions {
  double heading = 0.0;           ///< Degrees counter-clockwise from x: the middle of the maps.
  double azimuth_step = 0.3;      ///< Degrees.
  double elevation_step = 0.45;   ///< Degrees.
  double half_azimuth = 45.0;     ///< Degrees to each side of the heading.
  double lowest = -24.0;          ///< Degrees: the scanner's own field of view, without its edges.
  double highest = 1.5;           ///< Degrees.
  double min_range = 4.5;         ///< Metres: nearer than that neither is trusted, also by depth.
  double max_range = 30.0;        ///< Metres: farther away a pixel of disparity is too much depth.
  double tolerance = 2.0;         ///< Pixels of disparity that the two may differ by.
  double dark_level = 50.0;       ///< Grey level below which a surface may well return nothing.
  double dark_weight = 0.25;      ///< Weight of a dark, empty cell as evidence; 0 to 1.
  std::int64_t min_cells = 25;    ///< Components of fewer cells are not reported.
  double min_added_area = 0.25;   ///< Square metres of evidence, at the component's own range.
  double min_missing_area = 0.2;  ///< Square metres of evidence.
};

/// Metres by which an object that is still there may have been moved away (section 7.4).
inline constexpr double kNearBehind = 5.0;

/// Neighbouring cells in which LiDAR and cameras contradict each other in the same way.
struct CrossModalComponent {
  bool added = false;  ///< The LiDAR sees something in front; else something is missing.
  std::int64_t cells = 0;
  std::int64_t empty = 0;  ///< Cells in which the LiDAR sees nothing at all.
  std::int64_t dark = 0;   ///< Missing: those of them that are dark in the picture.
  /// Missing: cells with a point of the LiDAR at most kNearBehind behind what the cameras see.
  std::int64_t behind = 0;
  double solid_angle = 0.0;  ///< Steradians.
  double area = 0.0;         ///< Square metres, each cell at its own range.
  double evidence = 0.0;     ///< `area` with dark empty cells at their weight.
  double difference = 0.0;   ///< Pixels of disparity, mean of the cells.
  /// Box around what was added or is missing, in axes turned by the heading.
  Eigen::Vector3d lower = Eigen::Vector3d::Zero();
  Eigen::Vector3d upper = Eigen::Vector3d::Zero();
  Eigen::Vector3d center = Eigen::Vector3d::Zero();  ///< Middle of the box, in the LiDAR's axes.
};

struct CrossModalResult {
  std::int64_t rows = 0, columns = 0;  ///< Shape of the maps: row 0 is the highest, column 0 left.
  std::vector<float> lidar;            ///< Range of the nearest point, metres; 0: none.
  std::vector<float> stereo;           ///< Mean of the pixels' ranges (harmonic), metres; 0: none.
  std::vector<float> difference;       ///< LiDAR minus stereo, pixels of disparity; 0: not judged.
  std::vector<std::int8_t> mask;       ///< 1 added, -1 missing, 0 neither; components only.
  std::vector<std::uint8_t> judged;    ///< 1: both could have been contradicted here.
  std::vector<CrossModalComponent> components;  ///< The largest area first.
  std::vector<std::int32_t> suspected;          ///< Rows of added points; ascending.
  std::vector<std::int32_t> suspected_component;
  std::int64_t judged_points = 0;  ///< Points of the scan in judged cells.
};

/// Compares a LiDAR scan with a stereo depth map (dissertation, section 7.3.2).
///
/// Both become equirectangular maps of inverse range around the scanner, in which the error of
/// stereo is the same near and far; the maps look where the cameras do, by the heading. A cell is
/// marked "added" where the nearest LiDAR point is nearer than all that the cameras see in the 3x3
/// cells around, and "missing" where all that the cameras see there is nearer than every LiDAR
/// point. What is nearer to the cameras than they can match is never added. That a dark surface
/// returns nothing is weak evidence: such cells count `dark_weight`. Components of 8 neighbours
/// above the thresholds are reported. The same bytes on every machine.
/// @throws InputError  what check_points refuses, a camera or an option out of range.
CrossModalResult compare_cross_modal(const PointsView& view, const DisparityView& disparity,
                                     const StereoView& camera,
                                     const CrossModalOptions& options = {},
                                     const Progress& progress = {});

}  // namespace manip3d
