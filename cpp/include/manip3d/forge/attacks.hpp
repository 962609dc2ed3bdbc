#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "manip3d/forge/forgery.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/geometry/oriented_box.hpp"
#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

/// @file
/// Attacks on a scan (dissertation sections 6.4 and 7.4). Each makes one pass over the points to
/// check them or to find those that it changes, and one to copy them.
namespace manip3d {

enum class Translation : std::uint8_t {
  /// t = P_object - R s o_object: the object's centroid o_object moves to the position P_object.
  kCentroid,
  /// t = P_object - (o_scene - o_object) with the centroids o, as printed; it does not move the
  /// object to P_object.
  kPaper,
};

/// A point p of the object moves to p' = R s p + t, with rotation R, scale s and translation t.
struct ObjectPlacement {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< P_object, in the scene's frame.
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  double scale = 1.0;
  Translation translation = Translation::kCentroid;
};

/// Returns the transform of the object by a placement.
/// @throws InputError  a number is not finite, the scale is not above 0, the matrix is no rotation,
///                     or the object is empty.
Eigen::Matrix4d placement_transform(const PointsView& scene, const PointsView& object,
                                    const ObjectPlacement& placement, int num_threads = 0,
                                    const Progress& progress = {});

/// Returns the transformed points. They are computed in double and rounded once.
/// @throws InputError  a transformed coordinate is not a finite float.
/// @param rows  the rows of a scan that the points are, which an error names; empty: their own.
Points transformed(const Eigen::Ref<const Points>& points, const Eigen::Matrix4d& transform,
                   const std::vector<std::int32_t>& rows = {});

/// Copy-Transform-Paste: the object's points, transformed and appended.
/// @throws InputError  the points fail check_points; see placement_transform.
Forgery copy_transform_paste(const PointsView& scene, const PointsView& object,
                             const ObjectPlacement& placement, int num_threads = 0,
                             const Progress& progress = {});

enum class Resampling : std::uint8_t { kPoissonDisk, kUniform };

struct ResampleOptions {
  /// Target of the mean distance to the nearest neighbour, after scaling; > 0.
  double spacing = 0.0;
  Resampling method = Resampling::kPoissonDisk;  ///< Sampling method that thins the points out.
  std::uint64_t seed = 0;
  int num_threads = 0;  ///< The result does not depend on it. 0: all cores.
};

/// Resamples an object to a mean nearest-neighbour distance of `spacing`, to about 3 % if it has
/// enough points. If gamma = MID_object / spacing (mean nearest-neighbour distance of the object
/// over the target) is below 1, points are left out. If it is above 1, points are interpolated: on
/// the faces if there are any, else between neighbouring points. Points at one place count once.
/// @return  At most one point if the faces have less area than two fifths of spacing^2, none if
///          they have no area.
/// @throws InputError  the points fail check_points; fewer than 2 points; spacing not above 0; more
///                     than 2^24 points needed to choose from; all points are equal.
Points resample(const PointsView& object, const Eigen::Ref<const Faces>& faces,
                const ResampleOptions& options, const Progress& progress = {});

/// Returns the mean nearest-neighbour distance (MID) of the scene's points within `radius` of a
/// position. Points at one place count once; rows at exactly (0, 0, 0) have no return and are left
/// out.
/// @throws InputError  the points fail check_points; fewer than 2 places with points within
///                     `radius`.
double local_spacing(const PointsView& scene, const Eigen::Vector3d& position, double radius,
                     int num_threads = 0, const Progress& progress = {});

/// Removes the points in a box; see points_in_box.
/// @throws InputError  the points or the box fail check_points or check_box.
Forgery subtract(const PointsView& scene, const OrientedBox& box, int num_threads = 0,
                 const Progress& progress = {});

/// Removes rows of the scene, for example those of a segmented object, and appends points.
/// @throws InputError  the points fail check_points; a row out of range.
Forgery replace_rows(const PointsView& scene, std::vector<std::int32_t> rows,
                     const PointsView& added, int num_threads = 0, const Progress& progress = {});

enum class Displacement : std::uint8_t {
  kRandom,  ///< Uniformly distributed in a ball with the radius `amplitude`.
  /// A dent: against the surface normal that faces the scanner, deepest in the middle of the box.
  kNormal,
};

struct DeformOptions {
  double amplitude = 0.0;  ///< Metres: the largest displacement; negative: a bulge.
  Displacement direction = Displacement::kRandom;
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< Position of the scanner, metres.
  std::uint64_t seed = 0;
};

/// Displaces the points in a box; see points_in_box. The depth of a dent is amplitude * (1 - d^2)^2
/// with the normalised distance d from the middle of the box, which is 1 at its border.
/// @throws InputError  the points or the box fail check_points or check_box; a number is not
///                     finite.
Forgery deform(const PointsView& scene, const OrientedBox& box, const DeformOptions& options,
               int num_threads = 0, const Progress& progress = {});

/// Moves the points in a box by a rigid transform; see points_in_box.
/// @throws InputError  the points or the box fail check_points or check_box; the transform is not
///                     rigid.
Forgery move_box(const PointsView& scene, const OrientedBox& box, const Eigen::Matrix4d& transform,
                 int num_threads = 0, const Progress& progress = {});

}  // namespace manip3d
