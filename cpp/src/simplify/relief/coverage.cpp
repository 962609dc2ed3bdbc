#include "simplify/relief/coverage.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <string>
#include <tuple>
#include <utility>

#include "manip3d/error.hpp"
#include "simplify/relief/bridges.hpp"
#include "simplify/relief/raster.hpp"

namespace manip3d {
namespace relief_detail {
namespace {

/// A triangle spans a step if more than this share of the pixels with surface over it is a step off
/// it. Must equal _MAX_OFF in _depth_steps.py.
constexpr double kMaxOff = 0.25;

/// Bits of a pixel: covered by a face on the surface, covered by a face off it.
constexpr std::uint8_t kByOthers = 1, kByOff = 2;

bool holds(const Corners& t, const Corner& p) {
  return doubled_area(t[0], t[1], p) >= 0 && doubled_area(t[1], t[2], p) >= 0 &&
         doubled_area(t[2], t[0], p) >= 0;
}

/// The number of missing ones of the two dense triangles of the cell above and right of a pixel,
/// for a triangle over the pixel. If the cell is not completely inside the triangle, only the pixel
/// itself counts. This estimate, which ignores slivers along contours, is what bridges are priced
/// by; bridged_cells() is exact.
int missing_halves(const Surface& surface, const Corners& t, std::int32_t pixel) {
  const int missing = num_missing(surface.cell(pixel));
  if (missing == 0) return 0;
  const int u = surface.u(pixel), v = surface.v(pixel);
  const bool holds_cell = u + 1 < surface.cols() && v + 1 < surface.rows() &&
                          holds(t, {u + 1, v}) && holds(t, {u, v + 1}) && holds(t, {u + 1, v + 1});
  if (holds_cell) return missing;
  return surface.is_used(pixel) ? 0 : 2;
}

/// Marks the filled pixels, which are given as pixels of the input. Leaves `marks` empty if there
/// are none.
void mark_filled(const Surface& surface, const Eigen::Ref<const Rows<std::int32_t, 2>>& filled,
                 std::vector<std::uint8_t>& marks) {
  marks.clear();
  if (filled.rows() == 0) return;
  marks.resize(surface.num_pixels());
  for (Eigen::Index i = 0; i < filled.rows(); ++i) {
    const std::int32_t pixel = surface.pixel_at(filled(i, 0), filled(i, 1));
    if (pixel >= 0) marks[pixel] = 1;
  }
}

/// The depth of a triangle by pixel: 1/z is affine in the pixel coordinates of a plane.
class InverseDepth {
 public:
  InverseDepth() = default;
  InverseDepth(const Surface& surface, const Corners& t) {
    const auto at = [&](int i) {
      return 1.0 / double{surface.depth(t[i][1] * surface.cols() + t[i][0])};
    };
    const double area = static_cast<double>(doubled_area(t[0], t[1], t[2]));
    const double b = at(1) - at(0), c = at(2) - at(0);
    along_u_ = (b * (t[2][1] - t[0][1]) - c * (t[1][1] - t[0][1])) / area;
    along_v_ = (c * (t[1][0] - t[0][0]) - b * (t[2][0] - t[0][0])) / area;
    start_ = at(0) - along_u_ * t[0][0] - along_v_ * t[0][1];
  }
  [[nodiscard]] float at(int u, int v) const {
    return static_cast<float>(start_ + along_u_ * u + along_v_ * v);
  }

 private:
  double start_ = 0.0, along_u_ = 0.0, along_v_ = 0.0;
};

/// Whether a triangle is a step in front of or behind a pixel. `most` is the largest depth that is
/// not a step behind the pixel.
bool is_off(float depth, float most, float inverse_depth) {
  // Both conditions are evaluated without a division and without a branch.
  return !((depth * depth * inverse_depth <= most) & (depth <= most * depth * inverse_depth));
}

bool is_off(const Surface& surface, std::int32_t pixel, float inverse_depth) {
  const float depth = surface.depth(pixel);
  return is_off(depth, depth + surface.steps().limit(depth), inverse_depth);
}

/// Computes the depths that is_off() compares, once for each pixel, because several triangles meet
/// at a pixel.
void find_depths(const Surface& surface, CoverageScratch& scratch) {
  const auto num_pixels = static_cast<std::ptrdiff_t>(surface.num_pixels());
  scratch.depths.resize(surface.num_pixels());
  scratch.most.resize(surface.num_pixels());
  surface.depths(scratch.depths);
  const float* const depths = scratch.depths.data();
  float* const most = scratch.most.data();
  const StepRule steps = surface.steps();
  std::ptrdiff_t p = 0;
  for (; p + 4 <= num_pixels; p += 4) {
    const Float4 depth = load4(depths + p);
    store4(most + p, depth + steps.limit(depth));
  }
  for (; p < num_pixels; ++p) most[p] = depths[p] + steps.limit(depths[p]);
}

/// Marks the pixels of a row from which a triangle is not a step away.
/// @param mark  Bit of the kind of face.
void cover_row(const Surface& surface, const InverseDepth& plane, std::int32_t first,
               std::int32_t last, std::uint8_t mark, CoverageScratch& scratch) {
  const int v = first / surface.cols(), u = first - v * surface.cols(), size = last - first + 1;
  const float *depths = scratch.depths.data() + first, *most = scratch.most.data() + first;
  std::uint8_t* const covered = scratch.covered.data() + first;
  const InverseDepth own = plane;  // a local copy, because writes of bytes may alias the plane
  for (int i = 0; i < size; ++i) {
    const bool off = is_off(depths[i], most[i], own.at(u + i, v));
    covered[i] = static_cast<std::uint8_t>(covered[i] | (off ? 0 : mark));
  }
}

float area_of(const Surface& surface, const Corners& t) {
  const auto point = [&](const Corner& p) {
    return surface.sample(p[1] * surface.cols() + p[0]).point();
  };
  return 0.5F * (point(t[1]) - point(t[0])).cross(point(t[2]) - point(t[0])).norm();
}

/// The pixels over a triangle, without its corners.
struct Over {
  std::int64_t seen = 0, unseen = 0;
  std::int64_t off = 0;  ///< Pixels with surface that are a step off the triangle.
};

Over pixels_over(const Surface& surface, const Corners& t) {
  Over over;
  const InverseDepth plane(surface, t);
  visit_pixels(surface.cols(), t[0], t[1], t[2], SidePixels::kClosed, [&](std::int32_t p) {
    const Corner at = {surface.u(p), surface.v(p)};
    const auto is_at = [&](const Corner& c) { return at[0] == c[0] && at[1] == c[1]; };
    if (is_at(t[0]) || is_at(t[1]) || is_at(t[2])) return;
    if (!surface.is_used(p)) {
      ++over.unseen;
      return;
    }
    ++over.seen;
    over.off += is_off(surface, p, plane.at(at[0], at[1])) ? 1 : 0;
  });
  return over;
}

/// Whether the ends of a line of pixels differ by a step, and steps on the line make up most of the
/// difference. The rule is that of StepFinder in edge_steps.cpp with `passing`; both triangles at
/// an edge use the same line.
bool crosses_step(const Surface& surface, const Corner& one, const Corner& other) {
  const bool in_order = std::tie(one[1], one[0]) <= std::tie(other[1], other[0]);
  const Corner& from = in_order ? one : other;
  const Corner& to = in_order ? other : one;
  const auto is_step = [&](float z, float next) {
    return surface.steps().is_step(std::min(z, next), std::max(z, next));
  };
  const float begin = surface.depth(from[1] * surface.cols() + from[0]);
  const float end = surface.depth(to[1] * surface.cols() + to[0]);
  if (!is_step(begin, end)) return false;
  const int du = to[0] - from[0], dv = to[1] - from[1];
  const int length = std::max(std::abs(du), std::abs(dv));
  const auto along = [length](int way, int delta) {
    const int doubled = 2 * way * delta + length, step = 2 * length;
    return doubled / step - (doubled % step < 0 ? 1 : 0);
  };
  float before = begin, climbed = 0.0F;
  for (int way = 1; way <= length; ++way) {
    const std::int32_t pixel =
        (from[1] + along(way, dv)) * surface.cols() + from[0] + along(way, du);
    if (!surface.is_valid(pixel)) continue;
    const float depth = surface.depth(pixel);
    if (is_step(before, depth)) climbed += depth - before;
    before = depth;
  }
  return std::abs(climbed) > 0.5F * std::abs(end - begin);
}

bool lies_off(const Surface& surface, const Corners& t) {
  const auto depth = [&](int i) { return surface.depth(t[i][1] * surface.cols() + t[i][0]); };
  const auto [least, most] = std::minmax({depth(0), depth(1), depth(2)});
  // The limit increases with the depth, so no two corners differ by a step.
  if (least > 0.0F && !surface.steps().is_step(least, most)) return false;
  if (!crosses_step(surface, t[0], t[1]) && !crosses_step(surface, t[1], t[2]) &&
      !crosses_step(surface, t[2], t[0])) {
    return false;
  }
  const Over over = pixels_over(surface, t);
  return over.seen <= over.unseen ||
         static_cast<double>(over.off) > kMaxOff * static_cast<double>(over.seen);
}

Corners corners_at(const Surface& surface, const std::array<std::int32_t, 3>& pixels) {
  Corners t{};
  for (int i = 0; i < 3; ++i) t[i] = {surface.u(pixels[i]), surface.v(pixels[i])};
  return t;
}

/// Corners counter-clockwise with v up, as pixels of the surface.
Corners corners_of(const Surface& surface, const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                   const Eigen::Ref<const Rows<std::int32_t, 3>>& faces, Eigen::Index face) {
  Corners t{};
  for (int i = 0; i < 3; ++i) {
    const std::int32_t vertex = faces(face, i);
    t[i] = {pixels(vertex, 0) - surface.input_u(0), pixels(vertex, 1) - surface.input_v(0)};
  }
  if (doubled_area(t[0], t[1], t[2]) < 0) std::swap(t[1], t[2]);
  return t;
}

/// Sums of pixels and areas over the faces of a mesh.
struct Covered {
  double area = 0.0;
  double bridges = 0.0;
  double filled = 0.0;  ///< The part of `bridges` over filled pixels.
  std::int64_t pixels = 0;

  /// @param cells       The number of cells that the face is as large as.
  /// @param over_cells  The part of them without a dense triangle.
  void add(double face_area, double cells, const BridgedCells& over_cells) {
    area += face_area;
    bridges += face_area * over_cells.all / cells;
    filled += face_area * over_cells.filled / cells;
  }
  [[nodiscard]] DepthCoverage of(const Surface& surface) const {
    DepthCoverage result;
    result.coverage = static_cast<double>(pixels) / static_cast<double>(surface.num_used());
    result.bridges = area > 0.0 ? bridges / area : 0.0;
    result.filled = area > 0.0 ? filled / area : 0.0;
    result.outside = share_outside(surface);
    return result;
  }
  static double share_outside(const Surface& surface) {
    if (surface.num_valid() == 0) return 0.0;
    return 1.0 - static_cast<double>(surface.num_used()) / static_cast<double>(surface.num_valid());
  }
};

/// Counts the covered pixels of surface row by row, so that small counters are enough.
void count_pixels(const Surface& surface, std::span<const std::uint8_t> covered, Covered& whole,
                  Covered& without_off) {
  const auto cols = static_cast<std::size_t>(surface.cols());
  for (std::size_t begin = 0; begin < covered.size(); begin += cols) {
    const std::uint8_t *by = covered.data() + begin, *used = surface.used().data() + begin;
    std::uint16_t any = 0, others = 0;
    for (std::size_t u = 0; u < cols; ++u) {
      const auto marks = static_cast<std::uint8_t>(used[u] != 0 ? by[u] : 0);
      any = static_cast<std::uint16_t>(any + (marks != 0 ? 1 : 0));
      others = static_cast<std::uint16_t>(others + (marks & kByOthers));
    }
    whole.pixels += any;
    without_off.pixels += others;
  }
}

/// Marks the pixels that a face covers.
void cover_face(const Surface& surface, const Corners& t, std::uint8_t mark,
                CoverageScratch& scratch) {
  const bool has_steps = surface.steps().has_steps();
  const InverseDepth plane = has_steps ? InverseDepth(surface, t) : InverseDepth();
  visit_spans(surface.cols(), t[0], t[1], t[2], SidePixels::kClosed,
              [&](std::int32_t first, std::int32_t last) {
                if (has_steps) {
                  cover_row(surface, plane, first, last, mark, scratch);
                } else {
                  const auto begin = scratch.covered.begin();
                  std::fill(begin + first, begin + last + 1, mark);
                }
              });
}

/// Calls visit(pixel) for the pixels of the surface that a face covers.
template <typename Visit>
void visit_covered(const Surface& surface, const Corners& t, Visit&& visit) {
  const bool has_steps = surface.steps().has_steps();
  const InverseDepth plane = has_steps ? InverseDepth(surface, t) : InverseDepth();
  visit_pixels(surface.cols(), t[0], t[1], t[2], SidePixels::kClosed, [&](std::int32_t p) {
    if (!surface.is_used(p)) return;
    if (has_steps && is_off(surface, p, plane.at(surface.u(p), surface.v(p)))) return;
    visit(p);
  });
}

/// Estimates the part of a face's area over pixels without surface; see missing_halves().
double bridge_of(const Surface& surface, const Corners& t, std::span<const std::int32_t> flaws) {
  std::int64_t inside = 0, missing = 0;
  visit_spans(surface.cols(), t[0], t[1], t[2], SidePixels::kClosed,
              [&](std::int32_t first, std::int32_t last) {
                inside += last - first + 1;
                if (flaws[first] == flaws[last + 1]) return;
                for (std::int32_t p = first; p <= last; ++p) {
                  missing += missing_halves(surface, t, p);
                }
              });
  return double{area_of(surface, t)} * static_cast<double>(missing) /
         static_cast<double>(2 * inside);
}

/// Finds the bridges in the mesh of `scratch.corners`, the largest first.
/// @return  Total area of the faces.
double find_bridges(const Surface& surface, CoverageScratch& scratch) {
  count_flaws(surface, scratch.flaws);
  scratch.bridges.clear();
  double whole = 0.0;
  for (std::size_t f = 0; f < scratch.corners.size(); ++f) {
    const Corners& t = scratch.corners[f];
    if (doubled_area(t[0], t[1], t[2]) == 0) continue;
    whole += double{area_of(surface, t)};
    const double area = bridge_of(surface, t, scratch.flaws);
    if (area > 0.0) scratch.bridges.push_back({area, static_cast<Eigen::Index>(f)});
  }
  std::ranges::sort(scratch.bridges, [](const Bridge& a, const Bridge& b) {
    return std::tie(b.area, a.face) < std::tie(a.area, b.face);
  });
  return whole;
}

bool has_area(const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
              const Eigen::Ref<const Rows<std::int32_t, 3>>& faces, Eigen::Index f) {
  const auto step = [&](int corner, int axis) -> std::int64_t {
    return std::int64_t{pixels(faces(f, corner), axis)} - pixels(faces(f, 0), axis);
  };
  return step(1, 0) * step(2, 1) != step(1, 1) * step(2, 0);
}

}  // namespace

void count_flaws(const Surface& surface, std::vector<std::int32_t>& flaws) {
  const auto num_pixels = static_cast<std::int32_t>(surface.num_pixels());
  flaws.resize(surface.num_pixels() + 1);
  std::int32_t count = 0;
  const std::uint8_t *cells = surface.cells().data(), *used = surface.used().data();
  std::int32_t* const before = flaws.data();
  for (std::int32_t p = 0; p < num_pixels; ++p) {
    before[p] = count;
    count += ((cells[p] & kFull) != kFull ? 1 : 0) | (used[p] == 0 ? 1 : 0);
  }
  flaws[num_pixels] = count;
}

CutCoverage coverage_of(const Surface& surface,
                        const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                        const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
                        std::span<const std::uint8_t> off,
                        const Eigen::Ref<const Rows<std::int32_t, 2>>& filled,
                        CoverageScratch& scratch) {
  CutCoverage result;
  result.whole.outside = result.without_off.outside = Covered::share_outside(surface);
  if (surface.num_used() == 0) {  // the whole area is a bridge
    for (Eigen::Index f = 0; f < faces.rows(); ++f) {
      if (!has_area(pixels, faces, f)) continue;
      result.whole.bridges = 1.0;
      if (off.empty() || off[f] == 0) result.without_off.bridges = 1.0;
    }
    return result;
  }
  scratch.covered.assign(surface.num_pixels(), 0);
  count_flaws(surface, scratch.flaws);
  mark_filled(surface, filled, scratch.filled);
  if (surface.steps().has_steps()) find_depths(surface, scratch);
  Covered whole, without_off;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    const Corners t = corners_of(surface, pixels, faces, f);
    // A corner may be a distant pixel that the surface does not contain; its face covers nothing.
    if (doubled_area(t[0], t[1], t[2]) == 0 || !surface.holds_all(t)) continue;
    const bool is_off = !off.empty() && off[f] != 0;
    cover_face(surface, t, is_off ? kByOff : kByOthers, scratch);
    const BridgedCells bridged = bridged_cells(surface, scratch.flaws, scratch.filled, t);
    const double area = area_of(surface, t);
    const double cells = 0.5 * static_cast<double>(doubled_area(t[0], t[1], t[2]));
    whole.add(area, cells, bridged);
    if (!is_off) without_off.add(area, cells, bridged);
  }
  count_pixels(surface, scratch.covered, whole, without_off);
  result.whole = whole.of(surface);
  result.without_off = without_off.of(surface);
  return result;
}

void remove_bridges(const Surface& surface, const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                    Rows<std::int32_t, 3>& faces, CoverageScratch& scratch) {
  if (surface.num_used() == 0) return;
  std::vector<Corners>& corners = scratch.corners;
  std::vector<std::int32_t>& faces_at = scratch.faces_at;
  corners.clear();
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    corners.push_back(corners_of(surface, pixels, faces, f));
    if (!surface.holds_all(corners.back())) corners.back() = {};
  }
  const double whole = find_bridges(surface, scratch);
  if (scratch.bridges.empty()) return;
  scratch.times.assign(surface.num_pixels(), 0);
  faces_at.assign(pixels.rows(), 0);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int i = 0; i < 3; ++i) ++faces_at[faces(f, i)];
    if (doubled_area(corners[f][0], corners[f][1], corners[f][2]) == 0) continue;
    visit_covered(surface, corners[f], [&](std::int32_t p) { ++scratch.times[p]; });
  }
  const double pixel_area = whole / static_cast<double>(surface.num_used());
  for (const auto& [area, f] : scratch.bridges) {
    std::int64_t alone = 0;
    visit_covered(surface, corners[f],
                  [&](std::int32_t p) { alone += scratch.times[p] == 1 ? 1 : 0; });
    if (area <= pixel_area * static_cast<double>(alone)) continue;
    std::int32_t fewest = faces_at[faces(f, 0)];
    for (int i = 1; i < 3; ++i) fewest = std::min(fewest, faces_at[faces(f, i)]);
    if (fewest == 1) continue;
    visit_covered(surface, corners[f], [&](std::int32_t p) { --scratch.times[p]; });
    for (int i = 0; i < 3; ++i) --faces_at[faces(f, i)];
    faces(f, 0) = -1;
  }
  Eigen::Index kept = 0;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    if (faces(f, 0) >= 0) faces.row(kept++) = faces.row(f);
  }
  faces.conservativeResize(kept, 3);
}

std::vector<float> off_surface(const Surface& surface,
                               const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                               const Eigen::Ref<const Rows<std::int32_t, 3>>& faces) {
  std::vector<float> shares(faces.rows(), -1.0F);
  if (surface.empty()) return shares;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    const Corners t = corners_of(surface, pixels, faces, f);
    if (doubled_area(t[0], t[1], t[2]) == 0 || !surface.holds_all(t)) continue;
    const auto [seen, unseen, off] = pixels_over(surface, t);
    if (seen > unseen) shares[f] = static_cast<float>(off) / static_cast<float>(seen);
  }
  return shares;
}

bool lies_off(const Surface& surface, const std::array<std::int32_t, 3>& pixels) {
  const Corners t = corners_at(surface, pixels);
  return surface.steps().has_steps() && doubled_area(t[0], t[1], t[2]) > 0 && lies_off(surface, t);
}

std::int64_t covered_pixels(const Surface& surface, const std::array<std::int32_t, 3>& pixels) {
  const Over over = pixels_over(surface, corners_at(surface, pixels));
  return over.seen - (surface.steps().has_steps() ? over.off : 0);
}

std::int64_t bridged_halves(const Surface& surface, std::span<const std::int32_t> flaws,
                            const std::array<std::int32_t, 3>& pixels) {
  const Corners t = corners_at(surface, pixels);
  std::int64_t sum = 0;
  visit_spans(surface.cols(), t[0], t[1], t[2], SidePixels::kClosed,
              [&](std::int32_t first, std::int32_t last) {
                if (flaws[first] == flaws[last + 1]) return;
                for (std::int32_t p = first; p <= last; ++p) {
                  sum += missing_halves(surface, t, p);
                }
              });
  return sum;
}

void find_off(const Surface& surface, const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
              const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
              std::vector<std::uint8_t>& off) {
  off.clear();
  if (!surface.steps().has_steps()) return;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    const Corners t = corners_of(surface, pixels, faces, f);
    const bool has_area = doubled_area(t[0], t[1], t[2]) != 0 && surface.holds_all(t);
    off.push_back(has_area && lies_off(surface, t) ? 1 : 0);
  }
}

}  // namespace relief_detail

void DenseRule::check() const {
  if (!(max_edge > 0.0)) {
    throw InputError("max_edge: expected > 0, got " + number_text(max_edge));
  }
  if (!(max_step > 0.0)) {
    throw InputError("depth_step: expected > 0, got " + number_text(max_step));
  }
  if (!(focal >= 0.0)) {
    throw InputError("focal: expected >= 0, got " + number_text(focal));
  }
}

namespace {

void check_pixel_mesh(const PointGridView& grid,
                      const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                      const Eigen::Ref<const Rows<std::int32_t, 3>>& faces, const DenseRule& rule) {
  check_point_grid(grid);
  rule.check();
  for (const std::int32_t i : faces.reshaped<Eigen::RowMajor>()) {
    if (i < 0 || i >= pixels.rows()) {
      throw InputError("faces: index out of range: " + std::to_string(i));
    }
    const std::int32_t u = pixels(i, 0), v = pixels(i, 1);
    if (u < 0 || v < 0 || u >= grid.cols || v >= grid.rows || grid.valid[v * grid.cols + u] == 0) {
      throw InputError("pixels: expected valid pixels of the grid, got (" + std::to_string(u) +
                       ", " + std::to_string(v) + ")");
    }
  }
}

}  // namespace

DepthCoverage depth_coverage(const PointGridView& grid,
                             const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                             const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
                             const DenseRule& rule,
                             const Eigen::Ref<const Rows<std::int32_t, 2>>& filled) {
  check_pixel_mesh(grid, pixels, faces, rule);
  for (Eigen::Index i = 0; i < filled.rows(); ++i) {
    const std::int32_t u = filled(i, 0), v = filled(i, 1);
    if (u < 0 || v < 0 || u >= grid.cols || v >= grid.rows) {
      throw InputError("filled: expected pixels of the grid, got (" + std::to_string(u) + ", " +
                       std::to_string(v) + ")");
    }
  }
  relief_detail::Surface surface;
  surface.assign(grid, rule, {}, 1);
  relief_detail::CoverageScratch scratch;
  return relief_detail::coverage_of(surface, pixels, faces, {}, filled, scratch).whole;
}

std::vector<float> faces_off_surface(const PointGridView& grid,
                                     const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                                     const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
                                     const DenseRule& rule) {
  check_pixel_mesh(grid, pixels, faces, rule);
  relief_detail::Surface surface;
  surface.assign(grid, rule, {}, 1);
  return relief_detail::off_surface(surface, pixels, faces);
}

}  // namespace manip3d
