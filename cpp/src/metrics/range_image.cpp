#include "manip3d/metrics/range_image.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "geometry/small_solvers.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/parallel.hpp"
#include "metrics/common.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kBandRows = 8;
// Tolerance of a hit's barycentric coordinates. Points are 32-bit numbers, so a pixel on the border
// of the mesh is outside by up to about 1e-7 of a triangle.
constexpr double kOnBorder = -1e-6;
constexpr double kNoHit = std::numeric_limits<double>::infinity();

Eigen::Vector3d point_of(const PointGridView& grid, std::int64_t pixel) {
  return Eigen::Map<const Eigen::Vector3f>(grid.points + 3 * pixel).cast<double>();
}

std::vector<std::int64_t> valid_pixels(const PointGridView& grid) {
  std::vector<std::int64_t> pixels;
  for (std::int64_t i = 0; i < grid.rows * grid.cols; ++i) {
    if (grid.valid[i] != 0) pixels.push_back(i);
  }
  return pixels;
}

double apply(const Eigen::RowVector4d& affine, const Eigen::Vector3d& point) {
  return affine.head<3>().dot(point) + affine[3];
}

Eigen::Vector2d project(const RangeCamera& camera, const Eigen::Vector3d& point) {
  return {apply(camera.u_over, point) / apply(camera.u_under, point),
          apply(camera.v_over, point) / apply(camera.v_under, point)};
}

// --- Fitting -----------------------------------------------------------------------------------

/// A ratio of affine functions: t = (over X) / (under X).
struct Ratio {
  Eigen::RowVector4d over, under;
};

/// Rewrites an affine function of (point - center) / scale as one of the point.
Eigen::RowVector4d in_input_frame(const Eigen::RowVector4d& f, const Eigen::Vector3d& center,
                                  double scale) {
  Eigen::RowVector4d g = f / scale;
  g[3] = f[3] - g.head<3>().dot(center);
  return g;
}

/// Minimizes the sum of squares of (over X - t under X) / (under X), with the last coefficient of
/// `under` equal to 1. The denominator of each round is the weight of the next, so that the final
/// residual is in units of t.
Ratio fit_ratio(const Eigen::MatrixX3d& points, const Eigen::VectorXd& values) {
  constexpr int kRounds = 4;
  constexpr double kFloatPrecision = 1e-6;  // relative, of 32-bit coordinates
  const Eigen::Index n = points.rows();
  Eigen::VectorXd weight = Eigen::VectorXd::Ones(n);
  Eigen::Matrix<double, 7, 1> solution;
  for (int round = 0; round < kRounds; ++round) {
    Eigen::MatrixXd system(n, 7);
    system << points, Eigen::VectorXd::Ones(n),
        (points.array().colwise() * -values.array()).matrix();
    system.array().colwise() *= weight.array();
    const LeastSquaresFit fit = least_squares(system, values.cwiseProduct(weight), kFloatPrecision);
    if (fit.rank < 7) {
      throw InputError("points: expected a scan that fixes its lines of sight, got a plane");
    }
    solution = fit.solution;
    weight = ((points * solution.tail<3>()).array() + 1.0).inverse();
  }
  Ratio ratio;
  ratio.over = solution.head<4>().transpose();
  ratio.under << solution.tail<3>().transpose(), 1.0;
  return ratio;
}

/// The mean line of sight, pointing away from the sensor: pixels are wider there, so the
/// denominators increase along it.
Eigen::RowVector3d mean_axis(const RangeCamera& camera, const Eigen::MatrixX3d& points, double size,
                             bool rows_up) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    const Eigen::Vector3d x = points.row(i);
    const Eigen::Vector2d pixel = project(camera, x);
    const Eigen::Vector3d across_u = (camera.u_over - pixel[0] * camera.u_under).head<3>();
    const Eigen::Vector3d across_v = (camera.v_over - pixel[1] * camera.v_under).head<3>();
    sum += across_u.cross(across_v).normalized();
  }
  const Eigen::Vector3d right_handed = rows_up ? Eigen::Vector3d(-sum) : sum;
  const Eigen::Vector3d axis = right_handed.normalized();
  const Eigen::Vector3d center = points.colwise().mean();
  double growth = 0.0;  // increase of the width of a pixel over the size of the scan
  for (const Eigen::RowVector4d& under : {camera.u_under, camera.v_under}) {
    growth += size * under.head<3>().dot(axis) / apply(under, center);
  }
  // Parallel lines of sight have no growth; rounding must not decide which way they point.
  constexpr double kMinGrowth = 1e-3;
  return growth < -kMinGrowth ? Eigen::RowVector3d(-axis.transpose()) : axis.transpose();
}

double rms_residual(const RangeCamera& camera, const PointGridView& grid,
                    const std::vector<std::int64_t>& pixels) {
  double sum = 0.0;
  for (const std::int64_t i : pixels) {
    const Eigen::Vector2d place(static_cast<double>(i % grid.cols),
                                static_cast<double>(i / grid.cols));
    sum += (project(camera, point_of(grid, i)) - place).squaredNorm();
  }
  return std::sqrt(sum / static_cast<double>(pixels.size()));
}

// --- Rendering ---------------------------------------------------------------------------------

/// A triangle as seen by the camera: the four affine functions and the depth at its corners, and
/// the pixels whose lines of sight may hit it.
struct SeenTriangle {
  Eigen::Vector3d u_over, u_under, v_over, v_under, depth;
  std::int64_t first_col, last_col, first_row, last_row;
};

/// Pixel coordinates at which the points of the grid are seen, which may differ from the centres of
/// their pixels.
struct Places {
  std::vector<Eigen::Vector2d> pixel;
  double farthest = 0.0;  ///< Largest distance from the point's own column or row, over the grid.
};

/// Column and row of a pixel of the grid.
Eigen::Vector2d own_place(const PointGridView& grid, std::int64_t pixel) {
  return {static_cast<double>(pixel % grid.cols), static_cast<double>(pixel / grid.cols)};
}

Places places_of(const PointGridView& grid, const RangeCamera& camera, Ticker& ticker) {
  Places places;
  places.pixel.resize(grid.rows * grid.cols);
  for (std::int64_t i = 0; i < grid.rows * grid.cols; ++i) {
    ticker.tick();
    if (grid.valid[i] == 0) continue;
    places.pixel[i] = project(camera, point_of(grid, i));
    const Eigen::Vector2d shift = places.pixel[i] - own_place(grid, i);
    places.farthest = std::max(places.farthest, shift.cwiseAbs().maxCoeff());
  }
  return places;
}

/// Bounds of the shifts from pixels to their places, by cells of places. With a distorted lens
/// shifts reach a hundred pixels, but are alike in each neighbourhood.
class Shifts {
 public:
  Shifts(const PointGridView& grid, const Places& places, Ticker& ticker)
      : size_(static_cast<double>(grid.cols), static_cast<double>(grid.rows)),
        farthest_(places.farthest) {
    if (are_small()) return;
    cols_ = cell_of(2.0 * size_[0], size_[0]) + 1;
    cells_.resize(cols_ * (cell_of(2.0 * size_[1], size_[1]) + 1));
    for (std::int64_t i = 0; i < grid.rows * grid.cols; ++i) {
      ticker.tick();
      const Eigen::Vector2d& place = places.pixel[i];
      if (grid.valid[i] == 0 || !place.allFinite()) continue;
      cells_[cell_of(place[1], size_[1]) * cols_ + cell_of(place[0], size_[0])].extend(
          place - own_place(grid, i));
    }
  }

  /// Whether one bound holds for all: no point is seen a pixel from the centre of its own.
  [[nodiscard]] bool are_small() const { return farthest_ < 1.0; }

  /// The pixels whose places may lie in a box: a box of columns and rows.
  [[nodiscard]] Eigen::AlignedBox2d pixels(const Eigen::AlignedBox2d& box) const {
    if (are_small()) {
      const Eigen::Vector2d farthest(farthest_, farthest_);
      return {box.min() - farthest, box.max() + farthest};
    }
    Eigen::AlignedBox2d shifts;
    const std::int64_t last_row = cell_of(box.max()[1], size_[1]);
    const std::int64_t last_col = cell_of(box.max()[0], size_[0]);
    for (std::int64_t row = cell_of(box.min()[1], size_[1]); row <= last_row; ++row) {
      for (std::int64_t col = cell_of(box.min()[0], size_[0]); col <= last_col; ++col) {
        shifts.extend(cells_[row * cols_ + col]);
      }
    }
    if (shifts.isEmpty()) return shifts;  // no pixel sees the box
    return {box.min() - shifts.max(), box.max() - shifts.min()};
  }

 private:
  static constexpr double kCell = 4.0;  // pixels

  /// The cell of a coordinate of a place. Places farther beside the image than half of its side
  /// share the outermost cells.
  static std::int64_t cell_of(double place, double side) {
    const double margin = 0.5 * side;
    return static_cast<std::int64_t>((std::clamp(place, -margin, side + margin) + margin) / kCell);
  }

  Eigen::Vector2d size_;  ///< Columns and rows of the image.
  double farthest_;
  std::int64_t cols_ = 0;
  std::vector<Eigen::AlignedBox2d> cells_;
};

constexpr double kSlack = 1e-6;  // pixels; far above the rounding of a place

/// Largest distance beyond the places of its corners at which a triangle may be hit, for a
/// coordinate in which they extend over `extent` pixels. By kOnBorder the weights of two corners
/// may be negative, and a place is the mean of the corners' weighted by `under` as well.
double reach_beyond(const Eigen::Vector3d& under, double extent) {
  return kSlack - 4.0 * kOnBorder * extent * under.maxCoeff() / under.minCoeff();
}

/// Both coordinates are monotonic along any segment on which the denominators are positive, so the
/// corners bound the triangle. If a denominator is not positive, the triangle may be seen anywhere.
SeenTriangle see(const MeshView& mesh, std::int64_t face, const RangeCamera& camera,
                 const PointGridView& grid, const Shifts& shifts) {
  SeenTriangle seen;
  for (int k = 0; k < 3; ++k) {
    const Eigen::Vector3d corner = mesh.vertices.row(mesh.faces(face, k));
    seen.u_over[k] = apply(camera.u_over, corner);
    seen.u_under[k] = apply(camera.u_under, corner);
    seen.v_over[k] = apply(camera.v_over, corner);
    seen.v_under[k] = apply(camera.v_under, corner);
    seen.depth[k] = camera.axis.dot(corner);
  }
  const Eigen::Vector2d end(static_cast<double>(grid.cols - 1), static_cast<double>(grid.rows - 1));
  const Eigen::Vector2d all = Eigen::Vector2d::Constant(kNoHit);
  Eigen::AlignedBox2d box(-all, all);
  const auto narrow = [&](const Eigen::Vector3d& over, const Eigen::Vector3d& under, int axis) {
    if (!(under.minCoeff() > 0.0)) return;
    const Eigen::Array3d place = over.array() / under.array();
    const double low = place.minCoeff(), high = place.maxCoeff();
    const double reach = shifts.are_small() ? kSlack : reach_beyond(under, high - low);
    box.min()[axis] = low - reach;
    box.max()[axis] = high + reach;
  };
  narrow(seen.u_over, seen.u_under, 0);
  narrow(seen.v_over, seen.v_under, 1);
  const Eigen::AlignedBox2d pixels = shifts.pixels(box);
  const auto first = [&](int axis) {
    return static_cast<std::int64_t>(
        std::clamp(std::ceil(pixels.min()[axis]), 0.0, end[axis] + 1.0));
  };
  const auto last = [&](int axis) {
    return static_cast<std::int64_t>(std::clamp(std::floor(pixels.max()[axis]), -1.0, end[axis]));
  };
  seen.first_col = first(0), seen.last_col = last(0);
  seen.first_row = first(1), seen.last_row = last(1);
  return seen;
}

/// Depth at which the line of sight of `pixel` hits the triangle, or kNoHit. The line is the
/// intersection of two planes, whose equations have the values p and q at the triangle's corners;
/// the hit is the point at which both interpolated values are 0 [cf. Olano & Greer, Graphics
/// Hardware 1997].
double hit(const SeenTriangle& seen, const Eigen::Vector2d& pixel) {
  const Eigen::Vector3d p = seen.u_over - pixel[0] * seen.u_under;
  const Eigen::Vector3d q = seen.v_over - pixel[1] * seen.v_under;
  Eigen::Vector3d weights = p.cross(q);
  const double sum = weights.sum();
  if (!(std::abs(sum) > 0.0)) return kNoHit;  // seen edge-on
  weights /= sum;
  if (!(weights.minCoeff() >= kOnBorder)) return kNoHit;
  const bool in_front = weights.dot(seen.u_under) > 0.0 && weights.dot(seen.v_under) > 0.0;
  return in_front ? weights.dot(seen.depth) : kNoHit;
}

/// The end of the triangles that are rendered before the next report of progress, from `begin` on.
std::size_t end_of_turn(const std::vector<SeenTriangle>& seen_faces, std::size_t begin) {
  constexpr std::int64_t kPixels = 1 << 21;  // 30 ms with one thread
  std::int64_t pixels = 0;
  while (begin < seen_faces.size() && pixels < kPixels) {
    const SeenTriangle& seen = seen_faces[begin++];
    const std::int64_t rows = seen.last_row - seen.first_row + 1;
    pixels += 8 + std::max(rows, std::int64_t{0}) *
                      std::max(seen.last_col - seen.first_col + 1, std::int64_t{0});
  }
  return begin;
}

}  // namespace

RangeCamera pinhole_range_camera(const Intrinsics& camera) {
  check_intrinsics(camera);
  const double fx = camera.mirrored ? -camera.fx : camera.fx;
  RangeCamera result;
  result.u_over << fx, 0.0, camera.cx, 0.0;
  result.v_over << 0.0, camera.fy, camera.cy, 0.0;
  result.u_under = result.v_under = Eigen::RowVector4d(0.0, 0.0, 1.0, 0.0);
  return result;
}

RangeCamera fit_range_camera(const PointGridView& grid) {
  check_point_grid(grid);
  const std::vector<std::int64_t> pixels = valid_pixels(grid);
  const auto n = static_cast<Eigen::Index>(pixels.size());
  if (n < 16) {
    throw InputError("points: expected at least 16 valid points, got " + std::to_string(n));
  }
  Eigen::MatrixX3d points(n, 3);
  Eigen::VectorXd u(n), v(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    points.row(i) = point_of(grid, pixels[i]).transpose();
    u[i] = static_cast<double>(pixels[i] % grid.cols) / static_cast<double>(grid.cols);
    v[i] = static_cast<double>(pixels[i] / grid.cols) / static_cast<double>(grid.rows);
  }
  const Eigen::Vector3d center = points.colwise().mean();
  const Eigen::MatrixX3d centered = points.rowwise() - center.transpose();
  const double size = centered.cwiseAbs().maxCoeff();
  const Eigen::MatrixX3d normalized = centered / size;
  const auto coordinate = [&](const Eigen::VectorXd& values, double pixels_per_unit,
                              Eigen::RowVector4d& over, Eigen::RowVector4d& under) {
    const Ratio ratio = fit_ratio(normalized, values);
    over = pixels_per_unit * in_input_frame(ratio.over, center, size);
    under = in_input_frame(ratio.under, center, size);
  };
  RangeCamera camera;
  coordinate(u, static_cast<double>(grid.cols), camera.u_over, camera.u_under);
  coordinate(v, static_cast<double>(grid.rows), camera.v_over, camera.v_under);
  camera.residual = rms_residual(camera, grid, pixels);
  if (!(camera.residual <= 1.0)) {
    throw InputError("points: expected a scan along lines of sight, got points " +
                     number_text(camera.residual) + " pixels (RMS) off their pixels");
  }
  camera.axis = mean_axis(camera, points, size, grid.rows_up);
  return camera;
}

std::vector<double> render_depth(const MeshView& mesh, const PointGridView& grid,
                                 const RangeCamera& camera, const RenderOptions& options,
                                 const Progress& progress) {
  check_mesh(mesh);
  check_point_grid(grid);
  Ticker ticker(progress);
  const Places places = places_of(grid, camera, ticker);
  const Shifts shifts(grid, places, ticker);
  std::vector<SeenTriangle> seen_faces(mesh.num_faces());
  parallel_chunks(
      mesh.num_faces(), kSampleChunk, options.num_threads,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t f = begin; f < end; ++f) {
          seen_faces[f] = see(mesh, f, camera, grid, shifts);
        }
      },
      part_of(progress, 0.0, 0.0));
  std::vector<double> depth(places.pixel.size(), kNoHit);
  const auto render_band = [&](std::span<const SeenTriangle> some, std::int64_t first_row,
                               std::int64_t end_row) {
    for (const SeenTriangle& seen : some) {
      const std::int64_t end = std::min(end_row, seen.last_row + 1);
      for (std::int64_t row = std::max(first_row, seen.first_row); row < end; ++row) {
        for (std::int64_t col = seen.first_col; col <= seen.last_col; ++col) {
          const std::int64_t i = row * grid.cols + col;
          if (grid.valid[i] != 0) depth[i] = std::min(depth[i], hit(seen, places.pixel[i]));
        }
      }
    }
  };
  // Triangles are rendered in short turns, because each may cover the whole image.
  for (std::size_t begin = 0; begin < seen_faces.size();) {
    const std::size_t end = end_of_turn(seen_faces, begin);
    const std::span turn = std::span(seen_faces).subspan(begin, end - begin);
    const auto fraction = [&](std::size_t done) {
      return static_cast<double>(done) / static_cast<double>(seen_faces.size());
    };
    parallel_chunks(
        grid.rows, kBandRows, options.num_threads,
        [&](std::int64_t first, std::int64_t last) { render_band(turn, first, last); },
        part_of(progress, fraction(begin), fraction(end)));
    begin = end;
  }
  std::replace(depth.begin(), depth.end(), kNoHit, std::numeric_limits<double>::quiet_NaN());
  return depth;
}

RangeImageError range_image_error(const MeshView& mesh, const PointGridView& grid,
                                  const RangeCamera& camera, const RenderOptions& options,
                                  const Progress& progress) {
  const std::vector<double> depth = render_depth(mesh, grid, camera, options, progress);
  const std::vector<std::int64_t> pixels = valid_pixels(grid);
  if (pixels.empty()) throw InputError("valid: expected at least one valid pixel, got none");
  Eigen::AlignedBox3d box;
  for (const std::int64_t i : pixels) box.extend(point_of(grid, i));
  const auto differences = [&](std::int64_t begin, std::int64_t end) {
    Moments moments;
    for (std::int64_t k = begin; k < end; ++k) {
      const double rendered = depth[pixels[k]];
      if (std::isnan(rendered)) continue;
      moments.add(std::abs(rendered - camera.axis.dot(point_of(grid, pixels[k]))));
    }
    return moments;
  };
  const auto moments = accumulate_in_order<Moments>(static_cast<std::int64_t>(pixels.size()),
                                                    options.num_threads, {}, differences);
  RangeImageError error;
  error.mean_square = moments.mean_square();
  error.mean_absolute = moments.mean();
  error.max = moments.count > 0 ? moments.max : std::numeric_limits<double>::quiet_NaN();
  error.diagonal = box.diagonal().norm();
  error.compared = moments.count;
  error.valid = static_cast<std::int64_t>(pixels.size());
  return error;
}

}  // namespace manip3d
