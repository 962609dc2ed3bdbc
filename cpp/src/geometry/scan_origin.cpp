#include "manip3d/geometry/scan_origin.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <utility>
#include <vector>

#include "geometry/angular_grid.hpp"
#include "geometry/even_position.hpp"
#include "geometry/select_rows.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/random.hpp"

namespace manip3d {
namespace {

using Eigen::Vector3d;

constexpr std::int64_t kSampled = 400'000;    // points for the density of surfaces
constexpr std::int64_t kTilePoints = 40'000;  // points for the grid, in complete tiles
constexpr std::int64_t kCombPoints = 8'000;   // points among these that rule out most steps
constexpr std::int64_t kMinPoints = 1000;
// Random streams: 0 draws the points, 1 the patches of even_position.
constexpr std::uint64_t kTileDraw = 2, kCombDraw = 3;
constexpr std::size_t kMinPatches = 100;
constexpr PhaseWindow kWindows[] = {{8, 3}, {16, 2}, {32, 1}, {64, 0}, {128, -1}, {256, -2}};
constexpr PhaseWindow kJudged = {16, 0};
constexpr double kCoherent = 0.6;    // of one angle; two scanners with equal shares reach 0.25
constexpr double kNoticeable = 0.1;  // of the elevations, which alone determine the height
constexpr double kPlain = 0.3;       // of either angle, in the narrowest windows

// Distinct points with a direction; for a small scan, all of them.
Points sample_points(const PointsView& view) {
  const std::int64_t count = view.num_points();
  const double share =
      static_cast<double>(kSampled) / static_cast<double>(std::max(count, kSampled));
  std::vector<std::array<float, 3>> rows;
  for (std::int64_t i = 0; i < count; ++i) {
    if (share < 1.0 && !(uniform(0, i) < share)) continue;
    const auto p = view.points.row(i);
    if (p.isZero(0.0F)) continue;  // files mark missing returns like this
    rows.push_back({p[0], p[1], p[2]});
  }
  // Some scanners measure each direction twice; such twins agree on any grid.
  std::sort(rows.begin(), rows.end());
  rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
  Points points(static_cast<Eigen::Index>(rows.size()), 3);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    points.row(static_cast<Eigen::Index>(i)) << rows[i][0], rows[i][1], rows[i][2];
  }
  return points;
}

// Coordinates permuted so that `axis` is the third.
Vector3d turned(const Vector3d& p, int axis) {
  return {p[(axis + 1) % 3], p[(axis + 2) % 3], p[axis]};
}
Vector3d turned_back(const Vector3d& p, int axis) {
  Vector3d back;
  back[(axis + 1) % 3] = p[0], back[(axis + 2) % 3] = p[1], back[axis] = p[2];
  return back;
}

// Finds the combs of both angles; leaves out one that is faint, or much fainter than the other.
void find_combs(AngularGrid& grid) {
  AngularGrid few = grid;
  few.keep_tiles(kCombPoints, kCombDraw);
  const bool are_enough = few.num_points() >= kCombPoints / 2;
  for (const GridAngle angle : kGridAngles) {
    AngleComb& comb = grid.comb(angle);
    comb = grid.find_comb(angle, AngularGrid::kFinest, AngularGrid::kCoarsest,
                          are_enough ? &few : nullptr);
    if (!(comb.coherence >= kFaintCoherence)) comb = {};
  }
  const double plainer = std::max(grid.azimuth.coherence, grid.elevation.coherence);
  for (AngleComb* comb : {&grid.azimuth, &grid.elevation}) {
    if (plainer >= kPlain && comb->coherence < kPlain) *comb = {};  // it would mislead
  }
}

// Improves position and steps within one window until they converge. Returns false if the position
// moves so far that the first one must have been better.
bool converge(AngularGrid& grid, const Vector3d& first, const PhaseWindow& window, bool fixed,
              double range) {
  constexpr int kRounds = 30;
  constexpr int kFixedRounds = 3;      // rounds for the steps alone
  constexpr double kConverged = 1e-5;  // share of the median range
  constexpr double kFarthest = 0.2;    // share of the median range
  for (int round = 0; round < kRounds; ++round) {
    if (grid.improve(window, fixed) <= kConverged * range && !fixed) break;
    if (!((grid.position() - first).norm() <= kFarthest * range)) return false;
    if (fixed && round == kFixedRounds) break;
  }
  return true;
}

// Improves the grid in increasing windows while it stays coherent (encoders are not uniform over
// all columns). Returns false if there is no grid around this position.
bool improve_in_windows(AngularGrid& grid, bool fixed, double cell_area, double range) {
  // Share of the coherence that must remain from one window to the next.
  constexpr double kKept = 0.8;
  const Vector3d first = grid.position();
  double before = 0.0;
  for (const PhaseWindow& window : kWindows) {
    const Vector3d position = grid.position();
    const AngleComb azimuth = grid.azimuth;
    const AngleComb elevation = grid.elevation;
    if (!converge(grid, first, window, fixed, range)) return false;
    const double coherence = std::max(grid.judged(GridAngle::kAzimuth, window),
                                      grid.judged(GridAngle::kElevation, window));
    if (!(coherence >= kKept * before)) {
      grid.azimuth = azimuth, grid.elevation = elevation;
      grid.move_to(position);
      break;
    }
    if (before == 0.0 && coherence < kPlain) return false;
    if (before == 0.0 && grid.elevation.step == 0.0) grid.find_rows(cell_area, range);
    before = coherence;
  }
  return true;
}

// The source of a first position.
enum class Start : std::uint8_t {
  kKnown,   // it is evaluated, but not changed
  kStated,  // the origin of the coordinates; kept if it fits nearly as well as the best position
  kGuessed  // only an approximate position
};

// The grid around a first position, and the position that fits it best.
ScanOrigin fit_grid(const Points& sample, const Vector3d& start, Start kind, int axis,
                    double thinned, const Progress& progress) {
  // Share of the median range within which a stated position is kept.
  constexpr double kSame = 0.005;
  const bool fixed = kind == Start::kKnown;
  std::vector<Vector3d> points(sample.rows());
  for (Eigen::Index i = 0; i < sample.rows(); ++i) {
    points[i] = turned(sample.row(i).cast<double>().transpose(), axis);
  }
  AngularGrid grid(std::move(points), turned(start, axis), progress);
  ScanOrigin result;
  result.axis = axis;
  const double cell_area = grid.cell_area() * thinned;
  grid.keep_tiles(kTilePoints, kTileDraw);
  if (grid.num_points() < kMinPoints / 2) return result;
  const double range = grid.median_range();
  find_combs(grid);
  if (!improve_in_windows(grid, fixed, cell_area, range)) return result;
  result.azimuth_coherence = grid.judged(GridAngle::kAzimuth, kJudged);
  result.elevation_coherence = grid.judged(GridAngle::kElevation, kJudged);
  result.azimuth_step = grid.azimuth.step;
  result.elevation_step = grid.elevation.step;
  result.position = turned_back(grid.position(), axis);
  const bool is_azimuth_plainer = result.azimuth_coherence >= result.elevation_coherence;
  const bool is_coherent =
      std::max(result.azimuth_coherence, result.elevation_coherence) >= kCoherent &&
      (fixed || result.elevation_coherence >= kNoticeable);
  if (is_coherent) {
    result.explained =
        grid.explained(is_azimuth_plainer ? GridAngle::kAzimuth : GridAngle::kElevation, kJudged);
  }
  result.found = result.explained > 0.0;
  const bool is_near = (result.position - start).norm() <= kSame * range;
  if (result.found && kind != Start::kGuessed && is_near) result.position = start;
  return result;
}

}  // namespace

ScanOrigin estimate_scan_origin(const PointsView& view, const ScanOriginOptions& options,
                                const Progress& progress) {
  check_points_everywhere(view, options.num_threads, part_of(progress, 0.0, 0.0));
  const std::optional<Vector3d>& known = options.known;
  if (known && !known->allFinite()) throw InputError("origin: expected finite numbers");
  const Points sample = sample_points(view);
  if (sample.rows() < kMinPoints) return {};
  const double thinned =
      std::min(1.0, static_cast<double>(kSampled) / static_cast<double>(view.num_points()));
  constexpr int kAxes[] = {2, 1, 0};
  int tried = 0;  // number of the six positions and axes that were tried
  const auto next = [&] {
    const double done = tried++ / 6.0;
    return part_of(progress, done, done);
  };
  if (known || options.tries_zero) {
    const Vector3d start = known.value_or(Vector3d::Zero());
    for (const int axis : kAxes) {
      const Start kind = known ? Start::kKnown : Start::kStated;
      const ScanOrigin result = fit_grid(sample, start, kind, axis, thinned, next());
      if (result.found) return result;
    }
  }
  if (known) return {};
  tried = 3;
  const std::vector<SurfacePatch> patches = sample_patches(sample, part_of(progress, 0.5, 0.5));
  if (patches.size() < kMinPatches) return {};
  for (const int axis : kAxes) {
    const Progress part = next();
    const Vector3d start = even_position(patches, axis, part);
    const ScanOrigin result = fit_grid(sample, start, Start::kGuessed, axis, thinned, part);
    if (result.found) return result;
  }
  return {};
}

}  // namespace manip3d
