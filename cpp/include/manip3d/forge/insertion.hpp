#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "manip3d/forge/attacks.hpp"
#include "manip3d/forge/lattice.hpp"

namespace manip3d {

struct InsertionOptions {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< The scanner's.
  double range_noise = 0.0;  ///< Metres: standard deviation along the ray, the sensor's own.
  std::uint64_t seed = 0;
  /// Without rings: only rays that hit something before hit the object now. With them, rays of the
  /// lattice that had no return (sky) hit it as well.
  ScanLattice lattice;
};

/// Inserts an object as the scanner would have seen it there: every ray that meets the object
/// before its own point ends on it, so there is no point in its shadow, and each of its points lies
/// on a ray of the sensor.
///
/// The object is a surface (faces), or a cloud: then each point stands for a disc of its spacing.
/// Rays that are moved keep their row; those that had no return are appended.
/// @throws InputError  what check_points and placement_transform refuse; an object that surrounds
///                     the scanner or stands within 80 degrees of both sides of it.
Forgery insert_occluding(const PointsView& scene, const PointsView& object,
                         const Eigen::Ref<const Faces>& faces, const ObjectPlacement& placement,
                         const InsertionOptions& options = {}, int num_threads = 0,
                         const Progress& progress = {});

}  // namespace manip3d
