#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/simplify/grid_delaunay.hpp"

/// @file
/// Methods to choose pixels with which CS3 is compared (dissertation, section 3.6). Each returns at
/// most `target_points` valid pixels of the grid, in row-major order, the same on every run.
namespace manip3d {

/// Choose a square lattice over the image whose spacing makes the number of valid pixels on it as
/// near to the target as the search finds, but at least 1. An image narrower than the spacing has
/// one line of the lattice; if only few pixels are measured and no lattice fits them, they are
/// chosen evenly in row-major order instead.
/// @throws InputError  as check_point_grid; target_points < 1.
std::vector<Pixel> sample_uniform(const PointGridView& grid, std::int64_t target_points);

struct PoissonDiskSample {
  std::vector<Pixel> pixels;
  double radius = 0.0;  ///< Smallest distance between two points, in units of the points.
};

/// Take points in random order and keep each one that is not within a radius of a point kept before
/// [dart throwing, Cook, ACM ToG 1986; on measured points as Hou et al. 2015]. Distances are those
/// in space. The radius is searched for which the number of points is within 1 % of the target.
/// If more points than the target are all at one place, one is kept and the radius is 0.
/// @throws InputError  as check_point_grid; target_points < 1.
PoissonDiskSample sample_poisson_disk(const PointGridView& grid, std::int64_t target_points,
                                      std::uint64_t seed);

struct ScaleSpaceSample {
  std::vector<Pixel> pixels;
  double sigma = 0.0;  ///< Width of the Gaussian, pixels.
};

/// Choose zero crossings of the Laplacian of Gaussian along scan lines [Cheng & Boulanger,
/// "Single-pass surface simplification by scale-space analysis", 2006]. The filtered signal is the
/// distance from the object's medial axis, which is assumed to be upright (along y) and, in each
/// row, in the middle of the extent of the points. A wider Gaussian gives fewer points; if even the
/// widest gives too many, points are dropped evenly over the image. For single objects only,
/// because a scene has no such axis. Points without crossings, such as points that are all at one
/// place, give no pixels.
/// @throws InputError  as check_point_grid; target_points < 1.
ScaleSpaceSample sample_scale_space(const PointGridView& grid, std::int64_t target_points);

}  // namespace manip3d
