#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Lines of sight of a range sensor, one for each (u, v) of its pixel grid.
///
/// Each of a pixel's two coordinates is a ratio of two affine functions of the point, u = (u_over
/// X) / (u_under X) with X = (x, y, z, 1); the line of sight of a pixel is the intersection of two
/// such planes. Equal denominators give a pinhole camera, denominators of 1 a parallel projection,
/// and one of each a linear pushbroom camera [Gupta & Hartley, PAMI 1997], such as a laser stripe
/// scanner on a linear stage.
struct RangeCamera {
  Eigen::RowVector4d u_over = Eigen::RowVector4d::Zero();
  Eigen::RowVector4d u_under = Eigen::RowVector4d::Zero();
  Eigen::RowVector4d v_over = Eigen::RowVector4d::Zero();
  Eigen::RowVector4d v_under = Eigen::RowVector4d::Zero();
  /// Depth is axis . X, increasing away from the sensor.
  Eigen::RowVector3d axis = Eigen::RowVector3d::UnitZ();
  /// RMS distance between the pixel of a point and its fitted position, pixels.
  double residual = 0.0;
};

/// Return the lines of sight of a pinhole camera, without its lens distortion.
/// @throws InputError  as check_intrinsics.
RangeCamera pinhole_range_camera(const Intrinsics& camera);

/// Fit the lines of sight of a range scan to its points, because a file of points with a pixel grid
/// contains no other data about its sensor. The axis is the mean line of sight; it points to where
/// pixels are wider or, if all are equally wide, in the direction given by the view's `rows_up`.
/// @throws InputError  as check_point_grid; fewer than 16 points, or all in a plane; points that do
///                     not fit such a sensor to within a pixel (RMS).
RangeCamera fit_range_camera(const PointGridView& grid);

struct RenderOptions {
  int num_threads = 0;  ///< 0: all cores.
};

/// Compute the depth of the mesh along the line of sight through each valid point of the grid, row
/// by row: that of the first surface hit, NaN if there is none (or the point is not valid). Lines
/// through the border of a triangle hit it. The result has the same bits for any number of threads.
/// @throws InputError  as check_mesh, check_point_grid.
std::vector<double> render_depth(const MeshView& mesh, const PointGridView& grid,
                                 const RangeCamera& camera, const RenderOptions& options = {},
                                 const Progress& progress = {});

/// Differences of depth between a range image and a mesh, over the pixels for which both have a
/// depth.
struct RangeImageError {
  double mean_square = 0.0;    ///< Squared units of the points; NaN where nothing was compared.
  double mean_absolute = 0.0;  ///< Units of the points; NaN where nothing was compared.
  double max = 0.0;            ///< Largest absolute difference; NaN where nothing was compared.
  double diagonal = 0.0;       ///< Diagonal of the valid points' bounding box.
  std::int64_t compared = 0;   ///< Pixels valid in both.
  std::int64_t valid = 0;      ///< Pixels valid in the range image.
};

/// Measure the distance of a mesh from the range image it was made of, as seen by the sensor: the
/// depth of render_depth() compared with that of the grid's own points.
/// @throws InputError  as render_depth; a grid without a valid point.
RangeImageError range_image_error(const MeshView& mesh, const PointGridView& grid,
                                  const RangeCamera& camera, const RenderOptions& options = {},
                                  const Progress& progress = {});

}  // namespace manip3d
