#include "manip3d/geometry/bvh.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <numeric>

#include "geometry/constants.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/parallel.hpp"

namespace manip3d {
namespace {

using Eigen::Array3d;
using Eigen::Array3f;
using Eigen::Array4f;
using Eigen::Vector3d;

constexpr int kWidth = 4;  // children per node: one SSE register of floats
constexpr int kBins = 16;
// Deeper nodes are split in the middle, which keeps the depth below 56.
constexpr int kMaxSahDepth = 40;
constexpr int kProgressStep = 10000;  // triangles between two progress reports: a few milliseconds
constexpr int kStackSize = 256;       // a level adds at most kWidth - 1 entries

// Boxes are stored in float and must never seem farther away than their triangles:
// - triangles' distances carry rounding errors near 1e-15 (the tree's unit is the mesh's size);
// - distances to boxes, in float, are off by less than 5 * 2^-24 relative.
constexpr double kBoxMargin = 1e-13;
constexpr double kBoundSlack = 1.0 + 1e-6;
constexpr float kRaySlack = 1.0F + 1e-6F;
constexpr double kSteepest = 1e18;  // of a ray; times a coordinate it stays finite in float
// Clamping a query moves it nearer to every box, and its squares stay below the largest float.
constexpr double kLargestCoordinate = 1e18;

const Vector3d kNowhere = Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
const SurfacePoint kNoSurface{-1, kInfinity, kNowhere, kNowhere};

float round_down(double value) {
  const auto nearest = static_cast<float>(value);
  return nearest <= value ? nearest : std::nextafter(nearest, -kInfinityF);
}
float round_up(double value) { return -round_down(-value); }

// Smallest float squared distance that excludes a box with certainty.
float bound(double squared_limit) {
  constexpr double kLargest = std::numeric_limits<float>::max();
  constexpr double kSmallest = std::numeric_limits<float>::min();  // squares may underflow
  return round_up(std::min(kLargest, squared_limit * kBoundSlack + kSmallest));
}

struct Box {
  Array3f min = Array3f::Constant(kInfinityF);
  Array3f max = Array3f::Constant(-kInfinityF);

  void extend(const Box& other) {
    min = min.min(other.min);
    max = max.max(other.max);
  }
  [[nodiscard]] float half_area() const {
    const Array3f size = max - min;
    return size[0] * size[1] + size[1] * size[2] + size[2] * size[0];
  }
};

}  // namespace

struct TriangleBvh::Primitive {
  Box box;
  std::int32_t face;
  [[nodiscard]] float center(int axis) const { return box.min[axis] + box.max[axis]; }  // doubled
};

namespace {

using Size = std::int64_t;

// The first corner of the longest edge; of equally long edges, the first one.
int base_corner(const Vector3d corners[3]) {
  double squared_length[3];
  for (int k = 0; k < 3; ++k) {
    squared_length[k] = (corners[(k + 1) % 3] - corners[k]).squaredNorm();
  }
  return static_cast<int>(std::max_element(squared_length, squared_length + 3) - squared_length);
}

std::vector<std::int32_t> all_faces(const MeshView& mesh) {
  std::vector<std::int32_t> faces(static_cast<std::size_t>(mesh.num_faces()));
  std::iota(faces.begin(), faces.end(), 0);
  return faces;
}

template <typename Primitives>
Size split_by_surface_area(Primitives& primitives, Size begin, Size end, int axis, float low,
                           float high) {
  const float bins_per_unit = kBins / (high - low);
  const auto bin_of = [&](const auto& primitive) {
    const float position = (primitive.center(axis) - low) * bins_per_unit;
    return std::clamp(static_cast<int>(position), 0, kBins - 1);
  };
  std::array<Box, kBins> boxes;
  std::array<Size, kBins> counts{};
  for (Size i = begin; i < end; ++i) {
    const int bin = bin_of(primitives[i]);
    boxes[bin].extend(primitives[i].box);
    ++counts[bin];
  }
  std::array<float, kBins> right_cost{};  // of bins b and above
  Box box;
  Size count = 0;
  for (int b = kBins - 1; b > 0; --b) {
    box.extend(boxes[b]);
    count += counts[b];
    right_cost[b] = count > 0 ? box.half_area() * static_cast<float>(count) : 0.0F;
  }
  box = Box{};
  count = 0;
  int best_bin = 1;
  float best_cost = kInfinityF;
  for (int b = 1; b < kBins; ++b) {
    box.extend(boxes[b - 1]);
    count += counts[b - 1];
    if (count == 0 || count == end - begin) continue;
    const float cost = box.half_area() * static_cast<float>(count) + right_cost[b];
    if (cost < best_cost) {
      best_cost = cost;
      best_bin = b;
    }
  }
  const auto first = primitives.begin();
  return std::partition(first + begin, first + end,
                        [&](const auto& primitive) { return bin_of(primitive) < best_bin; }) -
         first;
}

template <typename Primitives>
Size split(Primitives& primitives, Size begin, Size end, int depth) {
  Array3f low = Array3f::Constant(kInfinityF);
  Array3f high = Array3f::Constant(-kInfinityF);
  for (Size i = begin; i < end; ++i) {
    const Array3f center = primitives[i].box.min + primitives[i].box.max;
    low = low.min(center);
    high = high.max(center);
  }
  int axis = 0;
  (high - low).maxCoeff(&axis);
  const Size middle = begin + (end - begin) / 2;
  if (!(high[axis] > low[axis])) return middle;
  if (depth < kMaxSahDepth && end - begin > kWidth) {
    const Size cut = split_by_surface_area(primitives, begin, end, axis, low[axis], high[axis]);
    if (cut > begin && cut < end) return cut;
  }
  const auto first = primitives.begin();
  std::nth_element(first + begin, first + middle, first + end,
                   [&](const auto& a, const auto& b) { return a.center(axis) < b.center(axis); });
  return middle;
}

}  // namespace

TriangleBvh::TriangleBvh(const MeshView& mesh, const Progress& progress)
    : TriangleBvh(mesh, all_faces(mesh), progress) {}

TriangleBvh::TriangleBvh(const MeshView& mesh, std::span<const std::int32_t> faces,
                         const Progress& progress) {
  check_mesh(mesh);
  if (faces.empty()) throw InputError("mesh: expected at least one face, got none");

  const BoundingBox bounds = bounding_box(mesh);
  center_ = bounds.center();
  const double half_size = (bounds.max - center_).maxCoeff();
  if (half_size > 0.0) scale_ = std::ldexp(1.0, -std::clamp(std::ilogb(half_size), -1000, 1000));
  vertices_ = (mesh.vertices.rowwise() - center_.transpose()) * scale_;
  faces_ = mesh.faces;

  std::vector<Primitive> primitives(faces.size());
  for (std::size_t i = 0; i < faces.size(); ++i) {
    const std::int32_t f = faces[i];
    const Array3d a = vertices_.row(faces_(f, 0));
    const Array3d b = vertices_.row(faces_(f, 1));
    const Array3d c = vertices_.row(faces_(f, 2));
    Primitive& primitive = primitives[i];
    primitive.face = f;
    primitive.box.min = (a.min(b).min(c) - kBoxMargin).unaryExpr(&round_down);
    primitive.box.max = (a.max(b).max(c) + kBoxMargin).unaryExpr(&round_up);
  }
  nodes_.reserve(primitives.size() / 2 + 1);
  build_node(primitives, 0, static_cast<Size>(primitives.size()), 0, progress);

  triangles_.reserve(primitives.size());
  face_of_slot_.reserve(primitives.size());
  slot_of_face_.assign(static_cast<std::size_t>(mesh.num_faces()), -1);
  for (const Primitive& primitive : primitives) {
    const std::int32_t f = primitive.face;
    slot_of_face_[f] = static_cast<std::int32_t>(triangles_.size());
    face_of_slot_.push_back(f);
    triangles_.push_back(make_triangle(corners_of(f).data()));
  }
}

std::array<Vector3d, 3> TriangleBvh::corners_of(std::int32_t face) const {
  return {vertices_.row(faces_(face, 0)), vertices_.row(faces_(face, 1)),
          vertices_.row(faces_(face, 2))};
}

TriangleBvh::Triangle TriangleBvh::make_triangle(const Vector3d corners[3]) {
  // The longest edge is the base, so that the frame is well conditioned for both needles and caps.
  const int base = base_corner(corners);
  Triangle t{corners[base], Vector3d::Zero(), Vector3d::Zero(), 0.0, 0.0, 0.0};
  const Vector3d ab = corners[(base + 1) % 3] - t.a;
  const Vector3d ac = corners[(base + 2) % 3] - t.a;
  t.length = ab.norm();
  if (!(t.length > 0.0)) return t;
  t.u = ab / t.length;
  t.foot = std::clamp(t.u.dot(ac), 0.0, t.length);
  // Gram-Schmidt twice, so that v is perpendicular to u even where the height is rounding noise.
  Vector3d perpendicular = ac - t.u.dot(ac) * t.u;
  perpendicular -= t.u.dot(perpendicular) * t.u;
  const double height = perpendicular.norm();
  if (!(height > 1e-15 * t.length)) return t;  // a segment to within rounding
  t.v = perpendicular / height;
  t.height = height;
  return t;
}

std::int32_t TriangleBvh::build_node(std::vector<Primitive>& primitives, Size begin, Size end,
                                     int depth, const Progress& progress) {
  if (progress && end - begin > kProgressStep) {  // nodes are built in the order of their triangles
    progress(static_cast<double>(begin) / static_cast<double>(primitives.size()));
  }
  struct Range {
    Size begin, end;
    [[nodiscard]] Size size() const { return end - begin; }
  };
  std::array<Range, kWidth> ranges{{{begin, end}}};
  int count = 1;
  while (count < kWidth) {
    Range& largest = *std::max_element(ranges.begin(), ranges.begin() + count,
                                       [](auto& a, auto& b) { return a.size() < b.size(); });
    if (largest.size() < 2) break;
    const Size cut = split(primitives, largest.begin, largest.end, depth);
    ranges[count++] = {cut, largest.end};
    largest.end = cut;
  }

  const auto index = static_cast<std::int32_t>(nodes_.size());
  nodes_.emplace_back();
  for (int axis = 0; axis < 3; ++axis) {
    nodes_[index].min[axis].setConstant(kInfinityF);
    nodes_[index].max[axis].setConstant(-kInfinityF);
  }
  for (int lane = 0; lane < count; ++lane) {
    const Range& range = ranges[lane];
    Box box;
    for (Size i = range.begin; i < range.end; ++i) box.extend(primitives[i].box);
    for (int axis = 0; axis < 3; ++axis) {
      nodes_[index].min[axis][lane] = box.min[axis];
      nodes_[index].max[axis][lane] = box.max[axis];
    }
    const std::int32_t child =
        range.size() == 1 ? ~static_cast<std::int32_t>(range.begin)
                          : build_node(primitives, range.begin, range.end, depth + 1, progress);
    nodes_[index].child[lane] = child;
  }
  return index;
}

TriangleBvh::Query TriangleBvh::make_query(const Vector3d& query) const {
  Query q{(query - center_) * scale_, {}, {}};
  if (!q.p.allFinite()) {
    throw InputError("points: expected finite coordinates within reach of the mesh");
  }
  for (int axis = 0; axis < 3; ++axis) {
    const double p = std::clamp(q.p[axis], -kLargestCoordinate, kLargestCoordinate);
    q.low[axis].setConstant(round_down(p));
    q.high[axis].setConstant(round_up(p));
  }
  return q;
}

TriangleBvh::Candidate TriangleBvh::closest_in(std::int32_t slot, const Vector3d& p) const {
  const Triangle& t = triangles_[slot];
  const Vector3d ap = p - t.a;
  const double x = t.u.dot(ap);
  const double y = t.v.dot(ap);
  const double s = t.foot;
  const double h = t.height;
  const double rest = t.length - s;
  double foot_x = x;
  double foot_y = y;
  if (!(y > 0.0)) {
    foot_x = std::clamp(x, 0.0, t.length);
    foot_y = 0.0;
  } else {
    const bool beyond_ac = s * y > h * x;
    const bool beyond_bc = rest * y > h * (t.length - x);
    // Position along AC, 0 at A: in [0, 1) the foot on AC, below 0 the corner A, above 1 a point of
    // BC or the corner C.
    const double along_ac = s * x + h * y;
    const double squared_ac = s * s + h * h;
    if (beyond_ac && (along_ac < squared_ac || !beyond_bc)) {
      const double w = std::clamp(along_ac / squared_ac, 0.0, 1.0);
      foot_x = w * s;
      foot_y = w * h;
    } else if (beyond_bc) {
      const double along_bc = rest * (t.length - x) + h * y;
      const double w = std::clamp(along_bc / (rest * rest + h * h), 0.0, 1.0);
      foot_x = t.length - w * rest;
      foot_y = w * h;
    }
  }
  const Vector3d normal_part = ap - x * t.u - y * t.v;
  Candidate candidate{
      normal_part.squaredNorm() + (x - foot_x) * (x - foot_x) + (y - foot_y) * (y - foot_y), foot_x,
      foot_y, face_of_slot_[slot], slot};
  // Detects queries that equal a corner despite rounding: distances up to 1e-14, ten times their
  // rounding errors, are checked.
  if (candidate.squared_distance < 1e-28) {
    for (const Vector3d& corner : corners_of(candidate.face)) {
      if (corner == p) candidate.squared_distance = 0.0;
    }
  }
  return candidate;
}

SurfacePoint TriangleBvh::to_surface_point(const Candidate& candidate,
                                           const Vector3d& query) const {
  const Triangle& t = triangles_[candidate.slot];
  const std::array<Vector3d, 3> corners = corners_of(candidate.face);
  SurfacePoint result;
  result.face = candidate.face;
  result.distance = std::sqrt(candidate.squared_distance) / scale_;
  if (!std::isfinite(result.distance)) {
    throw InputError("points: too far from the mesh for a distance in double precision");
  }
  const Vector3d local_query = (query - center_) * scale_;
  for (int k = 0; k < 3 && result.distance == 0.0; ++k) {
    if (corners[k] != local_query) continue;
    result.barycentric = Vector3d::Unit(k);
    result.point = query;
    return result;
  }
  result.point = center_ + (t.a + candidate.x * t.u + candidate.y * t.v) / scale_;
  const double c = t.height > 0.0 ? std::min(candidate.y / t.height, 1.0) : 0.0;
  const double b =
      t.length > 0.0 ? std::clamp((candidate.x - c * t.foot) / t.length, 0.0, 1.0 - c) : 0.0;
  const int base = base_corner(corners.data());
  result.barycentric[base] = std::max(0.0, 1.0 - b - c);
  result.barycentric[(base + 1) % 3] = b;
  result.barycentric[(base + 2) % 3] = c;
  return result;
}

template <typename Visit>
void TriangleBvh::traverse(const Query& query, double& squared_limit, const Visit& visit) const {
  struct Entry {
    float squared_distance;
    std::int32_t child;
  };
  std::array<Entry, kStackSize> stack;  // NOLINT: written before it is read
  stack[0] = {0.0F, 0};
  int size = 1;
  float limit = bound(squared_limit);
  while (size > 0) {
    const Entry top = stack[--size];
    if (top.squared_distance > limit) continue;
    if (top.child < 0) {
      if (visit(closest_in(~top.child, query.p))) limit = bound(squared_limit);
      continue;
    }
    const Node& node = nodes_[top.child];
    Array4f squared = Array4f::Zero();
    for (int axis = 0; axis < 3; ++axis) {
      squared += (node.min[axis] - query.high[axis])
                     .max(query.low[axis] - node.max[axis])
                     .max(Array4f::Zero())
                     .square();
    }
    const int base = size;
    for (int lane = 0; lane < kWidth; ++lane) {
      if (!(squared[lane] <= limit)) continue;
      int place = size++;  // the nearest child is on top
      for (; place > base && stack[place - 1].squared_distance < squared[lane]; --place) {
        stack[place] = stack[place - 1];
      }
      stack[place] = {squared[lane], node.child[lane]};
    }
  }
}

SurfacePoint TriangleBvh::closest_point(const Vector3d& query, std::int32_t near_face,
                                        double max_distance) const {
  const Query q = make_query(query);
  const double limit = max_distance * scale_;
  Candidate best{limit * limit, 0.0, 0.0, std::numeric_limits<std::int32_t>::max(), -1};
  const auto take = [&](const Candidate& candidate) {
    if (!candidate.before(best)) return false;
    best = candidate;
    return true;
  };
  if (near_face >= 0) take(closest_in(slot_of_face_[near_face], q.p));
  traverse(q, best.squared_distance, take);
  return best.slot < 0 ? kNoSurface : to_surface_point(best, query);
}

SurfacePoint TriangleBvh::closest_point_where(
    const Vector3d& query, const std::function<bool(std::int32_t face)>& accept) const {
  Candidate best{kInfinity, 0.0, 0.0, -1, -1};
  traverse(make_query(query), best.squared_distance, [&](const Candidate& candidate) {
    if (!candidate.before(best) || !accept(candidate.face)) return false;
    best = candidate;
    return true;
  });
  if (best.face < 0) return kNoSurface;
  return to_surface_point(best, query);
}

/// Whether a ray crosses a triangle [Moeller & Trumbore 1997]; a face without area is never hit.
bool TriangleBvh::is_hit(std::int32_t slot, const Vector3d& origin,
                         const Vector3d& direction) const {
  const Triangle& t = triangles_[slot];
  if (!(t.height > 0.0)) return false;
  const Vector3d ab = t.length * t.u, ac = t.foot * t.u + t.height * t.v;
  const Vector3d across = direction.cross(ac);
  const double volume = ab.dot(across);
  if (volume == 0.0) return false;  // parallel
  const Vector3d from = origin - t.a;
  const double b = from.dot(across) / volume;
  if (!(b >= 0.0 && b <= 1.0)) return false;
  const Vector3d up = from.cross(ab);
  const double c = direction.dot(up) / volume;
  return c >= 0.0 && b + c <= 1.0 && ac.dot(up) / volume >= 0.0;
}

bool TriangleBvh::is_hit_where(const Vector3d& origin, const Vector3d& direction,
                               const std::function<bool(std::int32_t face)>& accept) const {
  const Vector3d from = (origin - center_) * scale_;
  if (!from.allFinite() || !direction.allFinite() || (direction.array() == 0.0).any()) {
    throw InputError("ray: expected finite coordinates, and a direction without a 0");
  }
  const Vector3d unit = direction / direction.cwiseAbs().maxCoeff();
  std::array<float, 3> start, inverse;  // NOLINT: filled below
  for (int axis = 0; axis < 3; ++axis) {
    start[axis] = static_cast<float>(from[axis]);
    inverse[axis] = static_cast<float>(std::clamp(1.0 / unit[axis], -kSteepest, kSteepest));
  }
  std::array<std::int32_t, kStackSize> stack;  // NOLINT: written before it is read
  stack[0] = 0;
  int size = 1;
  while (size > 0) {
    const std::int32_t top = stack[--size];
    if (top < 0) {
      if (is_hit(~top, from, unit) && accept(face_of_slot_[~top])) return true;
      continue;
    }
    const Node& node = nodes_[top];
    Array4f enter = Array4f::Zero(), leave = Array4f::Constant(kInfinityF);
    for (int axis = 0; axis < 3; ++axis) {
      const Array4f low = (node.min[axis] - start[axis]) * inverse[axis];
      const Array4f high = (node.max[axis] - start[axis]) * inverse[axis];
      enter = enter.max(low.min(high));
      leave = leave.min(low.max(high));
    }
    for (int lane = 0; lane < kWidth; ++lane) {
      const bool is_used = node.min[0][lane] <= node.max[0][lane];
      if (is_used && enter[lane] <= leave[lane] * kRaySlack) stack[size++] = node.child[lane];
    }
  }
  return false;
}

void TriangleBvh::faces_within(const Vector3d& query, double distance,
                               std::vector<SurfacePoint>& found) const {
  found.clear();
  double squared_limit = (distance * scale_) * (distance * scale_);
  traverse(make_query(query), squared_limit, [&](const Candidate& candidate) {
    if (candidate.squared_distance <= squared_limit) {
      found.push_back(to_surface_point(candidate, query));
    }
    return false;
  });
  std::sort(found.begin(), found.end(),
            [](const SurfacePoint& a, const SurfacePoint& b) { return a.face < b.face; });
}

namespace {

// A set of cubes of space: those that contain a point or are next to one that does. Different cubes
// sometimes share a mark.
class MarkedCubes {
 public:
  MarkedCubes(const Eigen::Ref<const Vertices>& points, double side) : side_(side) {
    marks_.resize(std::bit_ceil(static_cast<std::size_t>(points.rows()) * 27 * 8));
    for (Size i = 0; i < points.rows(); ++i) {
      const Array3d cube = (points.row(i).transpose().array() / side_).floor();
      visit(cube - 1.0, cube + 1.0, [&](std::size_t at) {
        marks_[at] = true;
        return false;
      });
    }
  }

  // Whether a box may touch a marked cube; always true for a box across many cubes.
  [[nodiscard]] bool may_touch(const Array3d& min, const Array3d& max) const {
    constexpr double kManyCubes = 64.0;
    const Array3d first = (min / side_).floor();
    const Array3d last = (max / side_).floor();
    if (!((last - first + 1.0).prod() <= kManyCubes)) return true;
    return visit(first, last, [&](std::size_t at) { return bool{marks_[at]}; });
  }

 private:
  // Visits the marks of the cubes until `stop` returns true.
  template <typename Stop>
  bool visit(const Array3d& first, const Array3d& last, const Stop& stop) const {
    for (double x = first[0]; x <= last[0]; x += 1.0) {
      for (double y = first[1]; y <= last[1]; y += 1.0) {
        for (double z = first[2]; z <= last[2]; z += 1.0) {
          if (stop(mark_of(x, y, z))) return true;
        }
      }
    }
    return false;
  }

  [[nodiscard]] std::size_t mark_of(double x, double y, double z) const {
    const auto whole = [](double value) { return static_cast<std::uint64_t>(std::llrint(value)); };
    std::uint64_t key = whole(x) * 0x9E3779B97F4A7C15U + whole(y) * 0xC2B2AE3D27D4EB4FU +
                        whole(z) * 0x165667B19E3779F9U;
    key ^= key >> 29;
    return (key * 0xBF58476D1CE4E5B9U >> 20) & (marks_.size() - 1);
  }

  double side_;
  std::vector<bool> marks_;
};

// Faces that may be within `distance` of a point, ascending. All faces, if there are so few that a
// search does not pay, or if the distance is so small relative to the coordinates that cube indices
// would not be exact.
std::vector<std::int32_t> faces_near(const MeshView& mesh, const Eigen::Ref<const Vertices>& points,
                                     double distance) {
  // With more faces, building a tree takes longer than its queries.
  constexpr Size kFacesPerPoint = 8;
  constexpr double kMinPart = 1e-12;
  if (points.rows() == 0 || mesh.num_faces() <= kFacesPerPoint * points.rows()) {
    return all_faces(mesh);
  }
  const double size = std::max(mesh.vertices.cwiseAbs().maxCoeff(), points.cwiseAbs().maxCoeff());
  const bool has_cubes = distance > kMinPart * size && distance < kInfinity;
  if (!has_cubes || !points.allFinite()) return all_faces(mesh);
  // The margin includes faces at exactly this distance despite rounding.
  const MarkedCubes cubes(points, distance * (1.0 + 1e-6) + kMinPart * size);
  std::vector<std::int32_t> near;
  for (Size f = 0; f < mesh.faces.rows(); ++f) {
    const auto corner = [&](int k) {
      return mesh.vertices.row(mesh.faces(f, k)).transpose().array();
    };
    const Array3d min = corner(0).min(corner(1)).min(corner(2));
    const Array3d max = corner(0).max(corner(1)).max(corner(2));
    if (cubes.may_touch(min, max)) near.push_back(static_cast<std::int32_t>(f));
  }
  return near;
}

}  // namespace

ClosestPoints::ClosestPoints(std::int64_t count)
    : distances(count, kInfinity),
      faces(count, -1),
      points(Vertices::Constant(count, 3, kNowhere[0])) {}

ClosestPoints closest_points(const MeshView& mesh, const Eigen::Ref<const Vertices>& points,
                             double max_distance, int num_threads, const Progress& progress) {
  constexpr Size kChunk = 1024;
  if (!(max_distance >= 0.0)) throw InputError("max_distance: expected a number of at least 0");
  check_mesh(mesh);
  ClosestPoints result(points.rows());
  const std::vector<std::int32_t> faces = faces_near(mesh, points, max_distance);
  if (faces.empty() && mesh.num_faces() > 0) {
    if (progress) progress(1.0);
    return result;
  }
  const TriangleBvh bvh(mesh, faces, part_of(progress, 0.0, 0.3));
  parallel_chunks(
      points.rows(), kChunk, num_threads,
      [&](Size begin, Size end) {
        std::int32_t near_face = -1;
        for (Size i = begin; i < end; ++i) {
          const SurfacePoint nearest = bvh.closest_point(points.row(i), near_face, max_distance);
          result.distances[i] = nearest.distance;
          result.faces[i] = nearest.face;
          result.points.row(i) = nearest.point;
          if (nearest.face >= 0) near_face = nearest.face;
        }
      },
      part_of(progress, 0.3, 1.0));
  return result;
}

}  // namespace manip3d
