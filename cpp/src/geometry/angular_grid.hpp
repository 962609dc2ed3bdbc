#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "geometry/constants.hpp"
#include "manip3d/geometry/angles.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

enum class GridAngle : std::uint8_t { kAzimuth, kElevation };
constexpr std::array kGridAngles = {GridAngle::kAzimuth, GridAngle::kElevation};

/// A window within which phases of points are compared. The phases of the grid agree within it even
/// if the position is slightly wrong. It spans `columns` steps of one angle, two degrees of the
/// other one, and 1 / 2^parts of an octave of range; with negative `parts` it spans several
/// octaves.
struct PhaseWindow {
  std::int64_t columns = 8;
  int parts = 3;
};

/// The grid of one of the two angles.
struct AngleComb {
  double step = 0.0;  ///< Radians; 0: none.
  double coherence = 0.0;
};

/// Smallest coherence that is worth a trial; it increases as the position improves.
constexpr double kFaintCoherence = 0.03;

/// Polar coordinates of points about a position; the polar axis is the third coordinate.
struct PolarPoints {
  std::vector<Eigen::Vector3d> rays;       ///< Vectors from the position, metres.
  std::vector<double> azimuth, elevation;  ///< Radians.
  std::vector<double> range, rho;  ///< Distances from the position and from the axis, metres.

  void see(const std::vector<Eigen::Vector3d>& points, const Eigen::Vector3d& position);
};

/// The phases of points (angle divided by step, in turns) and their sums by window.
class WindowedPhases {
 public:
  /// Sum over the points of a window.
  struct Sum {
    double cosine = 0.0, sine = 0.0, count = 0.0;

    /// Sum of the cosines of the differences over all ordered pairs, and number of these pairs;
    /// both are divided by the number of points, so that a full window does not outweigh all
    /// others.
    [[nodiscard]] double agreement() const {
      return count > 1.0 ? (cosine * cosine + sine * sine - count) / count : 0.0;
    }
    [[nodiscard]] double pairs() const { return count > 1.0 ? count - 1.0 : 0.0; }
  };

  void gather(const PolarPoints& points, GridAngle angle, double step, const PhaseWindow& window);

  /// Mean cosine of the differences in phase between points of the same window.
  [[nodiscard]] double coherence() const;

  [[nodiscard]] std::size_t num_windows() const { return sums_.size(); }
  [[nodiscard]] const Sum& sum(std::size_t window) const { return sums_[window]; }
  [[nodiscard]] std::int32_t window_of(std::size_t point) const { return windows_[point]; }
  [[nodiscard]] const SinCos& wave_of(std::size_t point) const { return waves_[point]; }

 private:
  std::int32_t number_windows(const PolarPoints& points, GridAngle angle, double width, int parts);

  std::vector<std::int32_t> windows_;  ///< By point.
  std::vector<SinCos> waves_;          ///< By point.
  std::vector<Sum> sums_;              ///< By window.
  std::vector<std::uint64_t> keys_;    ///< Hash table of the windows.
  std::vector<std::int32_t> numbers_;  ///< By slot of the table: number of the window.
};

/// Points, a position from which they may lie on a grid of azimuth and elevation, and that grid.
class AngularGrid {
 public:
  /// @param points    Metres; the third axis is the polar one.
  /// @param progress  May cancel any of the work.
  AngularGrid(std::vector<Eigen::Vector3d> points, const Eigen::Vector3d& position,
              const Progress& progress);

  AngleComb azimuth, elevation;

  static constexpr double kFinest = 0.02 * kDegree;
  static constexpr double kCoarsest = 2.0 * kDegree;

  [[nodiscard]] const Eigen::Vector3d& position() const { return position_; }
  void move_to(const Eigen::Vector3d& position);
  AngleComb& comb(GridAngle angle) { return angle == GridAngle::kAzimuth ? azimuth : elevation; }
  [[nodiscard]] std::int64_t num_points() const {
    return static_cast<std::int64_t>(points_.size());
  }
  [[nodiscard]] double median_range() const;

  /// Keeps about this many points: all points in some of the tiles around the position. `draw` is
  /// the random stream that chooses the tiles.
  void keep_tiles(std::int64_t most, std::uint64_t draw);

  /// Solid angle per point, from the cells of one degree that contain points.
  [[nodiscard]] double cell_area() const;

  /// Finds the largest step in [shortest, longest] at which phases agree nearly as well as at the
  /// best step, then returns the most coherent of it and the next three finer ones. A grid `few` of
  /// few of the points may rule out most steps beforehand.
  AngleComb find_comb(GridAngle angle, double shortest, double longest, AngularGrid* few = nullptr);

  /// Finds faint rows if columns are clear, and moves to the height at which rows are the most
  /// coherent. Their step is searched around the value at which a cell contains one point, with the
  /// known step of the columns, and at nine heights, because a wrong height blurs rows.
  /// @param range  Median range of the points.
  void find_rows(double cell_area, double range);

  /// Coherence at the step that was found; 0 if none was found.
  double judged(GridAngle angle, const PhaseWindow& window);

  /// One Gauss-Newton step on the differences of phases from the means of their windows, for the
  /// position (unless it is fixed) and the logarithms of both steps. Returns the distance moved,
  /// metres.
  double improve(const PhaseWindow& window, bool fixed);

  /// Mean over the tiles of the share of their points that are on the grid. Only pairs of such
  /// points agree, so the agreement is proportional to the square of the share; hence the root. It
  /// is relative to the tile at the 80th percentile, because noise keeps even clean tiles below 1.
  double explained(GridAngle angle, const PhaseWindow& window);

 private:
  using Matrix5 = Eigen::Matrix<double, 5, 5>;
  using Vector5 = Eigen::Matrix<double, 5, 1>;  ///< x, y, z, and the logarithms of both steps.

  void rule_out(GridAngle angle, std::vector<AngleComb>& steps);
  const WindowedPhases& phases(GridAngle angle, double step, const PhaseWindow& window);
  [[nodiscard]] std::int64_t tile_of(std::size_t point) const;
  [[nodiscard]] Vector5 slope_of(std::size_t point, GridAngle angle, double step) const;
  void add_differences(const WindowedPhases& phases, GridAngle angle, double step, double weight,
                       Matrix5& normal, Vector5& gradient) const;

  std::vector<Eigen::Vector3d> points_;
  Eigen::Vector3d position_;
  Ticker ticker_;
  PolarPoints polar_;
  WindowedPhases phases_;  ///< Result of the last call of phases(); its memory is reused.
};

}  // namespace manip3d
