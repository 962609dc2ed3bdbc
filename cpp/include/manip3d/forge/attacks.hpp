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
/// Attacks on a scan: dissertation sections 6.4 and 7.4. Each takes a pass over the points to check
/// them or to find those it touches, and one to copy them.
namespace manip3d {

enum class Translation : std::uint8_t {
  kCentroid,  ///< t = P_object - R s o_object: the object's centroid lands on the position.
  kPaper,     ///< t = P_object - (o_scene - o_object), as printed; it lands elsewhere.
};

/// p' = R s p + t.
struct ObjectPlacement {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< P_object, in the scene's frame.
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  double scale = 1.0;
  Translation translation = Translation::kCentroid;
};

/// The transform of the object that a placement means.
/// @throws InputError  a number that is not finite, a scale not above 0, no rotation matrix, an
///                     empty object.
Eigen::Matrix4d placement_transform(const PointsView& scene, const PointsView& object,
                                    const ObjectPlacement& placement, int num_threads = 0,
                                    const Progress& progress = {});

/// The points, transformed in double and rounded once.
/// @throws InputError  a transformed coordinate is not a finite float.
Points transformed(const Eigen::Ref<const Points>& points, const Eigen::Matrix4d& transform);

/// Copy-Transform-Paste: the object's points, transformed and appended.
/// @throws InputError  what check_points and placement_transform refuse.
Forgery copy_transform_paste(const PointsView& scene, const PointsView& object,
                             const ObjectPlacement& placement, int num_threads = 0,
                             const Progress& progress = {});

enum class Resampling : std::uint8_t { kPoissonDisk, kUniform };

struct ResampleOptions {
  double spacing = 0.0;  ///< Mean distance to the nearest neighbour aimed at, after scaling; > 0.
  Resampling method = Resampling::kPoissonDisk;  ///< How points are left out.
  std::uint64_t seed = 0;
  int num_threads = 0;  ///< The result does not depend on it.
};

/// Points of an object whose mean nearest-neighbour distance is `spacing`, to about 3 % where the
/// object has enough of them. gamma = MID_object / spacing below 1 thins the points out; above 1
/// new ones are interpolated on the surface: on the faces where there are some, else between
/// neighbouring points.
/// @throws InputError  what check_points refuses; fewer than 2 points; spacing not above 0; more
///                     than 2^24 points wanted; all points the same.
Points resample(const PointsView& object, const Eigen::Ref<const Faces>& faces,
                const ResampleOptions& options, const Progress& progress = {});

/// Mean nearest-neighbour distance (MID) of the scene's points within `radius` of a position.
/// @throws InputError  what check_points refuses; fewer than 2 points there.
double local_spacing(const PointsView& scene, const Eigen::Vector3d& position, double radius,
                     int num_threads = 0, const Progress& progress = {});

/// Removes the points in a box.
/// @throws InputError  what check_points and check_box refuse.
Forgery subtract(const PointsView& scene, const OrientedBox& box, int num_threads = 0,
                 const Progress& progress = {});

/// Removes rows of the scene (of a segmented object, say), and appends points.
/// @throws InputError  what check_points refuses; a row out of range.
Forgery replace_rows(const PointsView& scene, std::vector<std::int32_t> rows,
                     const PointsView& added, int num_threads = 0, const Progress& progress = {});

enum class Displacement : std::uint8_t {
  kRandom,  ///< Uniform in a ball of the amplitude.
  kNormal,  ///< A dent: against the surface normal that faces the scanner, deepest in the middle.
};

struct DeformOptions {
  double amplitude = 0.0;  ///< Metres; the largest displacement. A negative one makes a bulge.
  Displacement direction = Displacement::kRandom;
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< The scanner's.
  std::uint64_t seed = 0;
};

/// Displaces the points of a box. The depth of a dent falls to 0 at the border of the box, as
/// (1 - d^2)^2 of the normalised distance d from its middle.
/// @throws InputError  what check_points and check_box refuse; a number that is not finite.
Forgery deform(const PointsView& scene, const OrientedBox& box, const DeformOptions& options,
               int num_threads = 0, const Progress& progress = {});

/// Moves the points of a box by a rigid transform.
/// @throws InputError  what check_points and check_box refuse; a transform that is not rigid.
Forgery move_box(const PointsView& scene, const OrientedBox& box, const Eigen::Matrix4d& transform,
                 int num_threads = 0, const Progress& progress = {});

}  // namespace manip3d
