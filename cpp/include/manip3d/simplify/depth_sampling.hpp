#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/simplify/grid_delaunay.hpp"

/// @file
/// Choices of pixels that CS3 is compared with (dissertation, section 3.6). Each returns at most
/// `target_points` pixels of the grid's valid ones, in row-major order, the same on every run.
namespace manip3d {

/// A square lattice over the image, its spacing chosen so that the number of valid pixels on it
/// comes nearest to the target.
/// @throws InputError  as check_point_grid; target_points < 1.
std::vector<Pixel> sample_uniform(const PointGridView& grid, std::int64_t target_points);

struct PoissonDiskSample {
  std::vector<Pixel> pixels;
  double radius = 0.0;  ///< No two points are nearer, in units of the points.
};

/// Points in random order, each kept unless it is within a radius of one kept before [dart
/// throwing, Cook, ACM ToG 1986; on measured points as Hou et al. 2015]. Distances are those
/// in space; the radius is sought for which the number is within 1 % of the target.
/// @throws InputError  as check_point_grid; target_points < 1.
PoissonDiskSample sample_poisson_disk(const PointGridView& grid, std::int64_t target_points,
                                      std::uint64_t seed);

struct ScaleSpaceSample {
  std::vector<Pixel> pixels;
  double sigma = 0.0;  ///< Width of the Gaussian, pixels.
};

/// Zero crossings of the Laplacian of Gaussian along scan lines [Cheng & Boulanger, "Single-pass
/// surface simplification by scale-space analysis", 2006]: of the distance from the object's
/// medial axis, which is taken as upright (along y) and, in each row, as the middle of the extent
/// of its points. A wider Gaussian leaves fewer; where
/// even the widest leaves too many, some are taken out all over the image. For single objects: a
/// scene has no such axis.
/// @throws InputError  as check_point_grid; target_points < 1.
ScaleSpaceSample sample_scale_space(const PointGridView& grid, std::int64_t target_points);

}  // namespace manip3d
