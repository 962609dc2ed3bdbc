#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "manip3d/forge/attacks.hpp"
#include "manip3d/forge/lattice.hpp"

namespace manip3d {

struct InsertionOptions {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< Position of the scanner, metres.
  double range_noise = 0.0;  ///< Metres: standard deviation of the sensor's noise along the ray.
  std::uint64_t seed = 0;
  /// Lattice of the scanner. With rings, rays of the lattice without a return (sky) can hit the
  /// object too; without rings, only rays with a return can.
  ScanLattice lattice;
};

/// Inserts an object as the scanner would have seen it at its place. Each ray that meets the object
/// before its own point ends on the object. Therefore no points are left in the object's shadow,
/// and all points of the object lie on rays of the sensor.
///
/// The object is a surface (with faces) or a cloud, whose points then stand for discs with the
/// radius of their spacing. Points that move keep their row; new points of rays without a return
/// are appended.
/// @throws InputError  the points fail check_points; see placement_transform; the object surrounds
///                     the scanner, or reaches farther than 80 degrees from its middle direction.
Forgery insert_occluding(const PointsView& scene, const PointsView& object,
                         const Eigen::Ref<const Faces>& faces, const ObjectPlacement& placement,
                         const InsertionOptions& options = {}, int num_threads = 0,
                         const Progress& progress = {});

}  // namespace manip3d
