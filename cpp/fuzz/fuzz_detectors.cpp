// Detectors on arbitrary scans: an InputError, or consistent results that are the same for one
// thread and two; nearest neighbours equal those from all pairs.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <numeric>
#include <optional>
#include <vector>

#include "checks.hpp"
#include "manip3d/authenticate/density.hpp"
#include "manip3d/authenticate/generic.hpp"
#include "manip3d/authenticate/occlusion.hpp"
#include "manip3d/authenticate/reflectance.hpp"
#include "manip3d/authenticate/reflectance_contrast.hpp"
#include "manip3d/authenticate/turns.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/nearest_neighbours.hpp"
#include "manip3d/geometry/scan_grid.hpp"
#include "manip3d/geometry/scan_origin.hpp"
#include "manip3d/geometry/sparse_points.hpp"
#include "scan_from_bytes.hpp"

namespace {

using namespace manip3d;
using fuzzing::require;
using fuzzing::run;

bool ascending_rows(const std::vector<std::int32_t>& rows, std::int64_t end) {
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (!(rows[i] >= 0 && rows[i] < end) || (i > 0 && rows[i] <= rows[i - 1])) return false;
  }
  return true;
}

std::vector<double> check_nearest(const PointCloud& scan, const Eigen::Vector3d& origin,
                                  double resolution) {
  const LargeArray<double> found = nearest_distances(scan, {origin, resolution, 1});
  std::vector<double> distances;
  for (Eigen::Index i = 0; i < scan.points.rows(); ++i) {
    double best = std::numeric_limits<double>::infinity();
    for (Eigen::Index k = 0; k < scan.points.rows(); ++k) {
      if (k == i) continue;
      const Eigen::RowVector3d offset =
          scan.points.row(i).cast<double>() - scan.points.row(k).cast<double>();
      const double squared = offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2];
      best = std::min(best, squared);
    }
    require(found[i] == std::sqrt(best));
    distances.push_back(found[i]);
  }
  return distances;
}

// Compares with the distances of all pairs, up to the rounding of single precision.
void check_sparse(const PointCloud& scan, int neighbours) {
  const SparseOptions options{neighbours, 0.3, 0.05, 5.0, 1};
  const std::vector<float> found = sparse_distances(scan, options).back();
  std::vector<double> expected;
  for (Eigen::Index i = 0; i < scan.points.rows(); ++i) {
    std::vector<double> distances;
    for (Eigen::Index k = 0; k < scan.points.rows(); ++k) {
      if (k == i) continue;
      const Eigen::RowVector3d offset =
          scan.points.row(i).cast<double>() - scan.points.row(k).cast<double>();
      distances.push_back(
          std::sqrt(offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]));
    }
    std::sort(distances.begin(), distances.end());
    const auto wanted = static_cast<std::size_t>(neighbours);
    const Eigen::RowVector3d place = scan.points.row(i).cast<double>();
    const double last = distances.size() < wanted ? options.farthest : distances[wanted - 1];
    const double counted = std::min(last, options.farthest);
    const double range = std::sqrt(place[0] * place[0] + place[1] * place[1] + place[2] * place[2]);
    if (counted >= std::max(options.nearest, options.angle * range)) expected.push_back(counted);
  }
  require(found.size() == expected.size());
  for (std::size_t i = 0; i < found.size(); ++i) {
    require(std::abs(found[i] - expected[i]) <= 1e-5 * expected[i]);
  }
}

void check_density(const PointCloud& scan, const std::vector<double>& distances,
                   const DensityOptions& options) {
  const DensityLevels levels = density_levels(scan, distances, options);
  const std::int64_t total =
      std::accumulate(levels.counts.begin(), levels.counts.end(), std::int64_t{0});
  require(total <= scan.points.rows());
  for (const double mean : levels.means) require(mean >= 0.0 && std::isfinite(mean));
  const std::vector<std::uint8_t> all(levels.counts.size(), 1);
  const auto rows = points_of_levels(scan, all, options);
  require(static_cast<std::int64_t>(rows.size()) == total);
  require(ascending_rows(rows, scan.points.rows()));
}

void check_occlusion(const PointCloud& scan, OcclusionOptions options) {
  const OcclusionResult one = occlusion_consistency(scan, options);
  require(ascending_rows(one.suspected, scan.points.rows()));
  require(one.suspected.size() == one.suspected_component.size());
  for (const std::int32_t component : one.suspected_component) {
    require(component >= 0 && component < static_cast<int>(one.components.size()));
  }
  require(static_cast<std::int64_t>(one.mask.size()) == one.rows * one.columns);
  options.num_threads = 2;
  const OcclusionResult two = occlusion_consistency(scan, options);
  require(two.mask == one.mask && two.suspected == one.suspected);
}

ScanLattice take_lattice(fuzzing::Bytes& bytes) {
  ScanLattice lattice;
  lattice.rings.resize(bytes.take<std::uint8_t>() % 9);
  using Ring = ScanLattice::Ring;
  for (double Ring::* const column : {&Ring::slope, &Ring::offset, &Ring::lateral, &Ring::azimuth,
                                      &Ring::range_phase, &Ring::center, &Ring::slope_error}) {
    for (Ring& ring : lattice.rings) ring.*column = fuzzing::take_number(bytes);
  }
  std::sort(lattice.rings.begin(), lattice.rings.end(),
            [](const Ring& a, const Ring& b) { return a.slope > b.slope; });
  lattice.steps = bytes.take<std::int16_t>();
  if (lattice.steps > 0) lattice.azimuth_step = 2.0 * std::numbers::pi / lattice.steps;
  lattice.range_step = fuzzing::take_number(bytes);
  lattice.coordinate_step = fuzzing::take_number(bytes);
  return lattice;
}

void check_generic(const PointCloud& scan, const PointCloud& previous, const ScanLattice& lattice) {
  const GenericResult one = generic_consistency(scan, lattice, {.num_threads = 1}, previous);
  const auto count = static_cast<std::size_t>(scan.points.rows());
  require(one.flags.size() == count && one.region_of_point.size() == count);
  for (const std::int32_t region : one.region_of_point) {
    require(region >= -1 && region < static_cast<int>(one.regions.size()));
  }
  const GenericResult two = generic_consistency(scan, lattice, {.num_threads = 2}, previous);
  require(two.flags == one.flags && two.cells == one.cells);
}

void check_turns(const PointCloud& scan, const PointCloud& beside, const ScanLattice& lattice) {
  const TurnResult found = compare_turns(scan, beside, beside, lattice, {.num_threads = 1});
  for (const TurnRegion& region : found.regions) {
    require(region.cells > 0 && region.agreed + region.ground <= region.cells);
    require(ascending_rows(region.rows, scan.points.rows()));
  }
}

void check_reflectances(PointCloud scan, const ScanLattice& lattice) {
  scan.intensity.resize(scan.points.rows());
  for (Eigen::Index i = 0; i < scan.points.rows(); ++i) {
    scan.intensity(i) = static_cast<float>(i * 37 % 101) / 100.0F;
  }
  const PointsView view(scan);
  const ReflectanceTurn turn{view, {}};
  for (const ReflectanceRegion& region :
       compare_reflectance(view, lattice, &turn, &turn, {.num_threads = 1})) {
    require(std::isfinite(region.strength) && region.strength > 0.0);
    require(ascending_rows(region.rows, scan.points.rows()));
  }
  const LatticeReading reading = read_lattice(view, lattice, 1);
  const auto count = static_cast<std::size_t>(scan.points.rows());
  const std::array<std::int64_t, 3> slips = {0, -3, 1000};
  const ReflectanceContrast found = reflectance_contrast(view, {reading.ring.data(), count},
                                                         {reading.azimuth.data(), count}, slips);
  for (const double contrast : found.contrast) require(contrast >= 0.0);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  fuzzing::Bytes bytes(data, std::min<std::size_t>(size, 16384));
  const Eigen::Vector3d origin = fuzzing::take_place(bytes);
  const PointCloud scan = fuzzing::take_scan(bytes);
  const double resolution = fuzzing::take_number(bytes);
  run([&] {
    const std::vector<double> distances = check_nearest(scan, origin, resolution);
    DensityOptions options;
    options.origin = origin;
    options.sector = bytes.take<std::uint8_t>();
    options.level_width = 1.0 + std::abs(fuzzing::take_number(bytes));
    options.level_growth = fuzzing::take_number(bytes);
    options.max_range = 20.0;
    options.level_out = bytes.take<std::uint8_t>() % 2 == 1;
    options.num_threads = 1;
    check_density(scan, distances, options);
  });
  run([&] { check_sparse(scan, 1 + static_cast<int>(scan.points.rows() % 8)); });
  run([&] {
    OcclusionOptions options;
    options.origin = origin;
    options.min_gap = fuzzing::take_number(bytes);
    options.min_cells = bytes.take<std::int8_t>();
    options.min_area = fuzzing::take_number(bytes);
    options.grid = {0.02 + 0.001 * bytes.take<std::uint8_t>(),
                    0.02 + 0.001 * bytes.take<std::uint8_t>(), fuzzing::take_number(bytes),
                    fuzzing::take_number(bytes)};
    options.num_threads = 1;
    check_occlusion(scan, options);
  });
  run([&] {
    const ScanLattice lattice = take_lattice(bytes);
    const PointCloud previous = fuzzing::take_scan(bytes);
    check_generic(scan, previous, lattice);
    check_turns(scan, previous, lattice);
    check_reflectances(scan, lattice);
  });
  if (bytes.take<std::uint8_t>() % 64 != 7) return 0;  // the rest takes a tenth of a second
  run([&] {
    const ScanGrid grid = estimate_scan_grid(scan, origin, 1);
    require(grid.azimuth_step > 0.0 && grid.elevation_step > 0.0);
  });
  run([&] {
    // An estimate needs many points: copies of the scan, each slightly larger.
    PointCloud many;
    const Eigen::Index rows = scan.points.rows();
    const Eigen::Index copies = rows > 0 ? std::min<Eigen::Index>(1 + 1200 / rows, 40) : 0;
    many.points.resize(copies * rows, 3);
    for (Eigen::Index k = 0; k < copies; ++k) {
      many.points.middleRows(k * rows, rows) = scan.points * (1.0F + 0.03F * static_cast<float>(k));
    }
    const auto kind = bytes.take<std::uint8_t>();
    ScanOriginOptions options{.tries_zero = kind % 4 < 2, .num_threads = 1};
    if (kind % 2 == 1) options.known = origin;
    const ScanOrigin found = estimate_scan_origin(many, options);
    require(found.position.allFinite());
    require(found.explained >= 0.0 && found.explained <= 1.0 + 1e-9);
    require(!found.found || found.azimuth_step > 0.0 || found.elevation_step > 0.0);
  });
  return 0;
}
