#include "simplify/fast_quadrics.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "manip3d/geometry/patch_distance.hpp"
#include "simplify/attribute_quadric.hpp"
#include "simplify/collapse_rules.hpp"
#include "simplify/rounding_weld.hpp"

namespace manip3d::fast_detail {
namespace {

/// Length of edges, in the unit of FastMesh, below which RoundingWeld decides. Its limit is in
/// double precision, so this one is larger by several roundings.
constexpr float kShortEdge = 1.5F * static_cast<float>(RoundingWeld::kFarthestOfDiagonal);

/// Two faces on one side of their edge have nearly opposite normals. One of these then forms an
/// angle of more than 80 degrees with the mean normal around the vertex; this is its cosine.
constexpr float kFarFromMean = 0.17F;

/// Corners of the faces around a vertex, padded to a multiple of four.
struct Ring {
  static constexpr std::size_t kMost = 32;
  alignas(16) std::array<std::int32_t, kMost> next, last;  // counter-clockwise
  std::size_t size = 0;
};

/// Whether the faces close around the vertex and none has a twin. (The two sides of a sheet also
/// close around a vertex on its rim.)
bool is_closed(const Ring& ring) {
  std::uint32_t matched = 0;  // faces that end where another one starts
  bool is_open = false;
  for (std::size_t i = 0; i < ring.size; ++i) {
    const std::int32_t next = ring.next[i];
    std::uint32_t matches = 0;
    for (std::size_t j = 0; j < ring.size; j += 4) {
      matches |= true_lanes(load4(&ring.last[j]) == Int4{next, next, next, next}) << j;
    }
    is_open |= matches == 0 || (matches & (matches - 1)) != 0 ||
               ring.next[std::countr_zero(matches)] == ring.last[i];
    matched |= matches;
  }
  const std::uint32_t all = ring.size > 0 ? 0xFFFFFFFFU >> (Ring::kMost - ring.size) : 0U;
  return !is_open && matched == all;
}

void add_plane(QuadricVertex& v, const Vector3f& n, float weight) {
  const Vector3f wn = weight * n;
  v.xx += wn.x() * n.x(), v.xy += wn.x() * n.y(), v.xz += wn.x() * n.z();
  v.yy += wn.y() * n.y(), v.yz += wn.y() * n.z(), v.zz += wn.z() * n.z();
  v.weight += weight;
}

/// Unit normals of the faces around a vertex, zero for faces without area.
struct Normals {
  std::array<Vectors4, Ring::kMost / 4> of_face;
  Vectors4 sum{};

  void add(std::size_t four, const Vectors4& n) {
    of_face[four] = n;
    sum = {sum.x + n.x, sum.y + n.y, sum.z + n.z};
  }

  /// Whether two faces may lie on one side of their edge. Rules out nearly all vertices.
  [[nodiscard]] bool may_fold(std::size_t count) const {
    const auto total = [](const Float4& lanes) {
      return lanes[0] + lanes[1] + lanes[2] + lanes[3];
    };
    const Vector3f mean = Vector3f(total(sum.x), total(sum.y), total(sum.z)).normalized();
    const Vectors4 mean4 = four_of(mean);
    Int4 is_far{};
    for (std::size_t i = 0; i < count; i += 4) {
      const Vectors4& n = of_face[i / 4];
      is_far |= (n.dot(mean4) < all_of(kFarFromMean)) & (n.squared_norm() > 0.0F);
    }
    return true_lanes(is_far) != 0;
  }
};

/// Findings of add_planes() that later steps need.
struct Noticed {
  bool has_short_edge;  // an edge of a face that starts here may be so short due to rounding
  bool may_fold;        // see Normals
};

Noticed add_planes(FastMesh& mesh, std::int32_t v, const Ring& ring) {
  QuadricVertex& vertex = mesh.vertices[v];
  const Vectors4 p = four_of(position_of(vertex));
  const Int4 self{v, v, v, v};  // padding has no edge
  Float4 high = load4(&vertex.xx), low = load4(&vertex.yz);
  Int4 is_short{};
  Normals normals;  // NOLINT: filled below
  for (std::size_t i = 0; i < ring.size; i += 4) {
    const Vectors4 edge = mesh.positions_of(&ring.next[i]) - p;
    is_short |=
        (edge.squared_norm() < all_of(kShortEdge * kShortEdge)) & (load4(&ring.next[i]) != self);
    const Vectors4 n = edge.cross(mesh.positions_of(&ring.last[i]) - p);
    const Float4 length = sqrt4(n.squared_norm());
    const Float4 divisor = length > 0.0F ? length : all_of(1.0F);
    const Vectors4 unit{n.x / divisor, n.y / divisor, n.z / divisor};
    normals.add(i / 4, unit);
    const Float4 weight = length > 0.0F ? length / 6.0F : all_of(0.0F);
    const Vectors4 weighted{weight * unit.x, weight * unit.y, weight * unit.z};
    const auto upper = transpose(
        {weighted.x * unit.x, weighted.x * unit.y, weighted.x * unit.z, weighted.y * unit.y});
    const auto lower = transpose({weighted.y * unit.z, weighted.z * unit.z, all_of(0.0F), weight});
    for (std::size_t k = 0; k < 4; ++k) {
      high += upper[k];
      low += Float4{lower[k][0], lower[k][1], 0.0F, 0.0F};
      vertex.weight += lower[k][3];
    }
  }
  store4(&vertex.xx, high);
  store4(&vertex.yz, low);
  return {true_lanes(is_short) != 0, normals.may_fold(ring.size)};
}

bool has_one_wedge(const FastMesh& mesh, std::int32_t v) {
  if (!mesh.has_wedges()) return true;
  const auto around = mesh.corners(v);
  const auto wedge = [&](std::uint32_t corner) { return mesh.wedges[corner / 3][corner % 3]; };
  return std::all_of(around.begin(), around.end(),
                     [&](std::uint32_t corner) { return wedge(corner) == wedge(around.front()); });
}

struct Surroundings {
  /// Whether a vertex is inside the surface and on no seam: each of its edges has two faces, which
  /// run along it in opposite directions and are not the two sides of one triangle, and all faces
  /// have the same wedge at the vertex.
  bool is_inside;
  bool has_short_edge;
  bool may_fold;  // known only inside the surface
};

/// Adds the planes of the faces of v.
Surroundings add_faces(FastMesh& mesh, std::int32_t v) {
  const auto around = mesh.corners(v);
  Ring ring;  // NOLINT: filled below
  bool has_short_edge = false, may_fold = false;
  for (std::size_t begin = 0; begin < around.size(); begin += Ring::kMost) {
    const auto some = around.subspan(begin, std::min(Ring::kMost, around.size() - begin));
    ring.size = 0;
    for (const std::uint32_t corner : some) {
      const std::uint32_t f = corner / 3, c = corner - 3 * f;
      ring.next[ring.size] = mesh.faces[f][after(c)];
      ring.last[ring.size++] = mesh.faces[f][before(c)];
    }
    // Padding with v: triangles without area and without an edge from v.
    for (std::size_t i = ring.size; i % 4 != 0; ++i) ring.next[i] = ring.last[i] = v;
    const Noticed noticed = add_planes(mesh, v, ring);
    has_short_edge |= noticed.has_short_edge;
    may_fold |= noticed.may_fold;
  }
  return {around.size() <= Ring::kMost && is_closed(ring) && has_one_wedge(mesh, v), has_short_edge,
          may_fold};
}

/// Another face at the edge v t than f; f itself if there is none.
std::uint32_t face_beyond(const FastMesh& mesh, std::uint32_t f, std::int32_t v, std::int32_t t) {
  std::uint32_t beyond = f;
  mesh.for_each_face(v, [&](std::uint32_t g, std::uint32_t, std::int32_t a, std::int32_t b) {
    if (g != f && (a == t || b == t)) beyond = g;
  });
  return beyond;
}

/// The area vector (twice) of the surface at a face: its own or, if it has no area, that of the
/// face beyond its longest edge. Exporters close T-junctions with such faces, whose other edges are
/// the boundary then.
Vector3f area_vector_at(const FastMesh& mesh, std::uint32_t f) {
  constexpr int kLongestChain = 8;  // of faces without area, one beyond the other
  for (int step = 0;; ++step) {
    const Triple& face = mesh.faces[f];
    std::array<Vector3f, 3> p;
    for (std::size_t c = 0; c < 3; ++c) p[c] = position_of(mesh.vertices[face[c]]);
    const Vector3f area = (p[1] - p[0]).cross(p[2] - p[0]);
    std::size_t longest = 0;
    float square = -1.0F;
    for (std::size_t c = 0; c < 3; ++c) {
      const float length = (p[after(c)] - p[c]).squaredNorm();
      if (length > square) longest = c, square = length;
    }
    if (area.squaredNorm() > kMinSquaredSine * square * square) return area;
    const std::uint32_t beyond = face_beyond(mesh, f, face[longest], face[after(longest)]);
    if (beyond == f || step == kLongestChain) return area;
    f = beyond;
  }
}

/// @param least  Length of an edge below which its plane weighs as much as one of this length.
void add_border(FastMesh& mesh, std::int32_t v, std::int32_t t, std::uint32_t f, double weight,
                float least) {
  const Vector3f normal = area_vector_at(mesh, f);
  const Vector3f along = position_of(mesh.vertices[t]) - position_of(mesh.vertices[v]);
  const Vector3f across = along.cross(normal);
  const float length = across.norm();
  if (!(length > 0.0F)) return;
  add_plane(mesh.vertices[v], across / length,
            static_cast<float>(0.5 * weight) * std::max(along.squaredNorm(), least * least));
}

/// An edge from a vertex, in one of its faces.
struct Spoke {
  std::int32_t end;
  std::uint32_t face, corner, end_corner;
};

/// Separation of the texture at an edge of several faces, 0 to 1, if it is closed at one end of the
/// edge: the distance at the other end, relative to the edge. Around a tip each face may have a
/// texture coordinate of its own, as if its edges were seams, but they separate it hardly at all
/// from its neighbours. 1 for other seams.
double parted(const FastMesh& mesh, std::span<const Spoke> spokes) {
  const auto wedge = [&](const Spoke& s, bool at_end) {
    return mesh.wedges[s.face][at_end ? s.end_corner : s.corner];
  };
  const auto place = [&](std::int32_t w) { return mesh.table.texcoords[w]; };
  std::array<double, 2> gaps{};  // at the vertex, at the end
  double length = 0.0;
  for (const Spoke& spoke : spokes) {
    for (const bool at_end : {false, true}) {
      const std::int32_t w = wedge(spoke, at_end), first = wedge(spokes.front(), at_end);
      if (mesh.table.surface[w] != mesh.table.surface[first]) return 1.0;
      gaps[at_end ? 1 : 0] = std::max(gaps[at_end ? 1 : 0], (place(w) - place(first)).norm());
    }
    length = std::max(length, (place(wedge(spoke, true)) - place(wedge(spoke, false))).norm());
  }
  const auto [least, most] = std::minmax(gaps[0], gaps[1]);
  return least > 0.0 || !(most < length) ? 1.0 : most / length;
}

/// The edges from a vertex, one after the other, each with all of its faces.
std::vector<Spoke> spokes_of(const FastMesh& mesh, std::int32_t v) {
  std::vector<Spoke> spokes;
  mesh.for_each_face(v, [&](std::uint32_t f, std::uint32_t c, std::int32_t a, std::int32_t b) {
    spokes.push_back({a, f, c, after(c)});
    spokes.push_back({b, f, c, before(c)});
  });
  std::sort(spokes.begin(), spokes.end(), [](const Spoke& a, const Spoke& b) {
    return a.end != b.end ? a.end < b.end : a.face < b.face;
  });
  return spokes;
}

template <typename Body>
void for_each_edge(std::span<const Spoke> spokes, const Body& body) {
  for (std::size_t begin = 0, end = 0; begin < spokes.size(); begin = end) {
    while (end < spokes.size() && spokes[end].end == spokes[begin].end) ++end;
    body(spokes.subspan(begin, end - begin));
  }
}

/// Whether one face or the two sides of one triangle are at an edge.
bool is_boundary(const FastMesh& mesh, std::span<const Spoke> edge) {
  const auto third_vertex = [&](const Spoke& spoke) {
    return mesh.faces[spoke.face][3 - spoke.corner - spoke.end_corner];
  };
  return edge.size() == 1 || (edge.size() == 2 && third_vertex(edge[0]) == third_vertex(edge[1]));
}

/// Whether all faces of an edge of v lie on one side of it, like front and back at the rim of a
/// thin shell. The surface ends there, and moving the edge inwards would cost nothing.
bool is_one_sided(const FastMesh& mesh, std::int32_t v, std::span<const Spoke> edge) {
  const Vector3f start = position_of(mesh.vertices[v]);
  const Vector3f along = (position_of(mesh.vertices[edge.front().end]) - start).normalized();
  Vector3f sum = Vector3f::Zero();
  for (const Spoke& spoke : edge) {
    const std::int32_t third = mesh.faces[spoke.face][3 - spoke.corner - spoke.end_corner];
    const Vector3f to_third = position_of(mesh.vertices[third]) - start;
    sum += (to_third - along.dot(to_third) * along).normalized();
  }
  return sum.norm() > static_cast<float>(kOneSided) * static_cast<float>(edge.size());
}

/// Whether the faces at an edge have different wedges.
bool is_seam(const FastMesh& mesh, std::span<const Spoke> edge) {
  if (!mesh.has_wedges()) return false;
  const Triple& first = mesh.wedges[edge.front().face];
  return std::any_of(edge.begin(), edge.end(), [&](const Spoke& spoke) {
    const Triple& own = mesh.wedges[spoke.face];
    return own[spoke.corner] != first[edge.front().corner] ||
           own[spoke.end_corner] != first[edge.front().end_corner];
  });
}

/// Whether an edge is a seam between two faces whose normals differ by at most 60 degrees. At a
/// sharper edge the seam may hold the shape.
bool is_smooth_seam(const FastMesh& mesh, std::span<const Spoke> edge) {
  constexpr float kLeastCosine = 0.5F;
  if (edge.size() != 2 || !is_seam(mesh, edge)) return false;
  std::array<Vector3f, 2> areas;
  for (std::size_t i = 0; i < 2; ++i) {
    const Triple& face = mesh.faces[edge[i].face];
    const Vector3f p = position_of(mesh.vertices[face[0]]);
    areas[i] =
        (position_of(mesh.vertices[face[1]]) - p).cross(position_of(mesh.vertices[face[2]]) - p);
  }
  return !(areas[0].dot(areas[1]) < kLeastCosine * areas[0].norm() * areas[1].norm());
}

/// Whether more than half of the edges around a vertex are smooth seams, boundaries aside.
bool is_shattered(const FastMesh& mesh, std::int32_t v) {
  std::int64_t seams = 0, others = 0;
  const std::vector<Spoke> spokes = spokes_of(mesh, v);
  for_each_edge(spokes, [&](std::span<const Spoke> edge) {
    if (!is_boundary(mesh, edge)) ++(is_smooth_seam(mesh, edge) ? seams : others);
  });
  return seams > others;
}

/// The vertices with is_shattered(), if these are more than half of all; empty otherwise. In such a
/// mesh most faces are charts of their own, and planes through nearly all edges would outweigh the
/// surface and shrink it. Other meshes have single vertices of this kind where charts meet.
std::vector<std::uint8_t> shattered_vertices(const FastMesh& mesh) {
  std::vector<std::uint8_t> chosen(mesh.vertices.size(), 0);
  const auto is_most = [&] {
    return 2 * std::count(chosen.begin(), chosen.end(), 1) > mesh.num_vertices();
  };
  mesh.over_vertices(
      [&](std::int32_t v) { chosen[v] = mesh.is_open[v] != 0 && !has_one_wedge(mesh, v) ? 1 : 0; });
  if (!is_most()) return {};
  mesh.over_vertices([&](std::int32_t v) {
    if (chosen[v] != 0 && !is_shattered(mesh, v)) chosen[v] = 0;
  });
  return is_most() ? chosen : std::vector<std::uint8_t>();
}

/// Adds planes through boundaries and seams, perpendicular to their faces. The rim of a two-sided
/// sheet or of a thin shell counts as a boundary; its faces all lie in one plane, so nothing else
/// would keep it in place. A boundary edge weighs at least a thousandth of the longest edge:
/// nothing else keeps a tiny hole in a cone or another developable surface from growing, as at a
/// tip of equal points but for rounding.
/// @param shattered  By vertex, see shattered_vertices(). Smooth seams between two of them add no
///                   planes.
void add_borders(FastMesh& mesh, const BorderWeights& weights,
                 std::span<const std::uint8_t> shattered, std::int32_t v) {
  constexpr float kLeastShare = 1e-3F;  // so small that meshes without tiny holes keep their bits
  const std::vector<Spoke> spokes = spokes_of(mesh, v);
  float longest = 0.0F;  // squared
  for (const Spoke& spoke : spokes) {
    const Vector3f edge = position_of(mesh.vertices[spoke.end]) - position_of(mesh.vertices[v]);
    longest = std::max(longest, edge.squaredNorm());
  }
  const float least = kLeastShare * std::sqrt(longest);
  for_each_edge(spokes, [&](std::span<const Spoke> edge) {
    if (is_complex_edge(static_cast<std::int64_t>(edge.size()))) mesh.is_complex[v] = 1;
    const bool is_open = is_boundary(mesh, edge) || is_one_sided(mesh, v, edge);
    if (!is_open && !is_seam(mesh, edge)) return;
    const bool is_between =
        !shattered.empty() && shattered[v] != 0 && shattered[edge.front().end] != 0;
    if (is_between && !is_open && is_smooth_seam(mesh, edge)) return;
    double weight = is_open ? weights.boundary : weights.seam / static_cast<double>(edge.size());
    if (!is_open && weights.parts_tips) weight *= parted(mesh, edge);
    for (const Spoke& spoke : edge) {
      add_border(mesh, v, spoke.end, spoke.face, weight, is_open ? least : 0.0F);
    }
  });
}

/// Adds the planes of add_borders() to a vertex inside the surface, where only the rims of thin
/// shells have some.
void add_rims(FastMesh& mesh, double weight, std::int32_t v) {
  const std::vector<Spoke> spokes = spokes_of(mesh, v);
  for_each_edge(spokes, [&](std::span<const Spoke> edge) {
    if (!is_one_sided(mesh, v, edge)) return;
    for (const Spoke& spoke : edge) add_border(mesh, v, spoke.end, spoke.face, weight, 0.0F);
  });
}

/// The colours of a face, with a third of its area as weight.
ColorQuadric colors_shown(const FastMesh& mesh, const Triple& face, const Eigen::Vector3d& origin) {
  constexpr double kDiagonal = 1.0;  // in the unit of FastMesh
  Triangle3 corners, colors;
  for (std::size_t c = 0; c < 3; ++c) {
    corners[c] = position_of(mesh.vertices[face[c]]).cast<double>() - origin;
    colors[c] = mesh.colors[face[c]].cast<double>() / 255.0;
  }
  const double third = (corners[1] - corners[0]).cross(corners[2] - corners[0]).norm() / 6.0;
  return color_quadric(corners, colors, third, kDiagonal);
}

double color_length_of(const FastMesh& mesh) {
  double squares = 0.0, area = 0.0;
  for (const Triple& face : mesh.faces) {
    const ColorQuadric shown = colors_shown(mesh, face, Eigen::Vector3d::Zero());
    squares += squared_gradient(shown);
    area += shown.weight;
  }
  return color_length(squares, area, 1.0);
}

/// Adds planes through v along its lines of equal colour, which hold it where the colours around
/// do not change linearly, as at the border of two regions. They add nothing to the weight, by
/// which the error of a step is divided.
void add_color_lines(FastMesh& mesh, std::int32_t v, double factor) {
  ColorQuadric around;
  const Eigen::Vector3d origin = position_of(mesh.vertices[v]).cast<double>();
  mesh.for_each_face(v, [&](std::uint32_t f, std::uint32_t, std::int32_t, std::int32_t) {
    around += colors_shown(mesh, mesh.faces[f], origin);
  });
  if (!(around.weight > 0.0)) return;
  const Eigen::Matrix3d linear = around.g.transpose() * around.g / around.weight;
  QuadricVertex& vertex = mesh.vertices[v];
  const auto held = [&](double square, int i, int j) {
    return static_cast<float>(factor * (square - linear(i, j)));
  };
  vertex.xx += held(around.q.xx, 0, 0), vertex.xy += held(around.q.xy, 0, 1);
  vertex.xz += held(around.q.xz, 0, 2), vertex.yy += held(around.q.yy, 1, 1);
  vertex.yz += held(around.q.yz, 1, 2), vertex.zz += held(around.q.zz, 2, 2);
}

}  // namespace

bool sum_quadrics(FastMesh& mesh, const BorderWeights& weights) {
  const bool is_colored = !mesh.colors.empty() && weights.color > 0.0;
  const double length = is_colored ? weights.color * color_length_of(mesh) : 0.0;
  mesh.is_open.assign(mesh.vertices.size(), 0);
  mesh.is_complex.assign(mesh.vertices.size(), 0);
  std::atomic<bool> has_short_edges = false;
  mesh.over_vertices([&](std::int32_t v) {
    const Surroundings around = add_faces(mesh, v);
    if (around.has_short_edge) has_short_edges.store(true, std::memory_order_relaxed);
    if (!around.is_inside) mesh.is_open[v] = 1;
    if (around.is_inside && around.may_fold) add_rims(mesh, weights.boundary, v);
  });
  const std::vector<std::uint8_t> shattered =
      mesh.has_wedges() ? shattered_vertices(mesh) : std::vector<std::uint8_t>();
  mesh.over_vertices([&](std::int32_t v) {
    if (mesh.is_open[v] != 0) add_borders(mesh, weights, shattered, v);
    if (is_colored) add_color_lines(mesh, v, length * length);
  });
  if (std::find(mesh.is_complex.begin(), mesh.is_complex.end(), 1) == mesh.is_complex.end()) {
    mesh.is_complex.clear();
  }
  return has_short_edges.load();
}

}  // namespace manip3d::fast_detail
