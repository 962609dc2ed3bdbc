#include "simplify/quality_original.hpp"

#include <array>
#include <cstddef>
#include <numeric>

#include "manip3d/geometry/patch_distance.hpp"
#include "simplify/collapse_rules.hpp"

namespace manip3d::quality_detail {
namespace {

/// Lower limit of the textured share of the area, by which the price of a texture is divided.
constexpr double kMinTextured = 0.01;

/// A border needs no additional plane if the existing ones hold it with at least this share of its
/// weight.
constexpr double kGuarded = 0.5;

/// A plane whose weight is below this share of the existing ones would be lost in rounding.
constexpr double kRounding = 1e-12;

/// Whether the planes of a border hold a vertex along a unit vector as strongly as a plane of this
/// weight would.
bool is_held(const Quadric& q, const Vector3d& n, double weight) {
  const double held = n.x() * (q.xx * n.x() + 2.0 * (q.xy * n.y() + q.xz * n.z())) +
                      n.y() * (q.yy * n.y() + 2.0 * q.yz * n.z()) + q.zz * n.z() * n.z();
  return held >= kGuarded * weight || weight <= kRounding * (q.xx + q.yy + q.zz);
}

std::int32_t third_vertex(const CollapseMesh& mesh, std::int32_t f, std::int32_t v,
                          std::int32_t t) {
  const auto& face = mesh.face(f);
  return *std::find_if(face.begin(), face.end(),
                       [&](std::int32_t corner) { return corner != v && corner != t; });
}

/// Whether the two faces of the edge v t form an angle of at least 90 degrees, as nearly all do.
bool opens_wide(const CollapseMesh& mesh, std::int32_t v, std::int32_t t) {
  std::array<std::int32_t, 2> third{t, t};
  std::size_t count = 0;
  mesh.for_each_face_between(v, t,
                             [&](std::int32_t f) { third[count++] = third_vertex(mesh, f, v, t); });
  const Vector3d along = mesh.position(t) - mesh.position(v);
  const Vector3d first = mesh.position(third[0]) - mesh.position(v),
                 second = mesh.position(third[1]) - mesh.position(v);
  return first.dot(second) * along.squaredNorm() <= first.dot(along) * second.dot(along);
}

/// Whether all faces of an edge of v lie on one side of it. This is so on a boundary, and on the
/// rim of a sheet whose front and back are separate faces; the surface ends there as well.
bool is_one_sided(const CollapseMesh& mesh, std::int32_t v, const RingEdge& edge) {
  if (edge.num_faces == 1) return true;
  if (edge.num_faces == 2 && opens_wide(mesh, v, edge.vertex)) return false;
  const Vector3d along = (mesh.position(edge.vertex) - mesh.position(v)).normalized();
  Vector3d sum = Vector3d::Zero();
  mesh.for_each_face_between(v, edge.vertex, [&](std::int32_t f) {
    const Vector3d to_third =
        mesh.position(third_vertex(mesh, f, v, edge.vertex)) - mesh.position(v);
    sum += (to_third - along.dot(to_third) * along).normalized();
  });
  return sum.norm() > kOneSided * edge.num_faces;
}

/// Difference between the texture coordinates of a face and of the other faces with the same
/// material at its edge v t: the mean of both ends, the maximum over the faces.
double texture_jump(const CollapseMesh& mesh, std::int32_t f, std::int32_t v, std::int32_t t) {
  const auto uv = [&](std::int32_t face, std::int32_t at) -> const Vector2d& {
    const auto& corners = mesh.face(face);
    const std::size_t c = corners[0] == at ? 0 : corners[1] == at ? 1 : 2;
    return mesh.uv(mesh.wedges(face)[c]);
  };
  if (!shows_texture(mesh, f)) return 0.0;
  double jump = 0.0;
  mesh.for_each_face_between(v, t, [&](std::int32_t g) {
    if (g == f || !shows_texture(mesh, g)) return;
    if (mesh.surface(mesh.wedges(g)[0]) != mesh.surface(mesh.wedges(f)[0])) return;
    jump = std::max(jump, 0.5 * (uv(f, v) - uv(g, v)).norm() + 0.5 * (uv(f, t) - uv(g, t)).norm());
  });
  return jump;
}

}  // namespace

Original::Original(const MeshView& input, const CollapseMesh& mesh, const QualityOptions& wanted,
                   const Progress& progress)
    : options(wanted),
      is_textured(input.has_texcoords() && wanted.texture_weight > 0.0),
      is_colored(input.colors.rows() > 0 && wanted.color_weight > 0.0),
      surface(mesh.num_vertices()),
      borders(mesh.num_vertices()),
      box(mesh.num_vertices()),
      area(mesh.num_vertices(), 0.0),
      border(mesh.num_vertices(), 0.0),
      attribute_price(mesh.num_vertices(), 0.0) {
  Ticker ticker(progress);
  if (is_textured) {
    measure_texture(mesh);
    texture.resize(mesh.num_wedges());
    jumps.resize(mesh.num_vertices());
    jump.resize(mesh.num_vertices(), 0.0);
    seam.resize(mesh.num_vertices(), 0.0);
  }
  for (std::int32_t f = 0; f < mesh.num_slots(); ++f) {
    ticker.tick();
    if (mesh.is_alive(f)) add_face(mesh, f);
  }
  if (is_colored) add_colors(input, mesh);
  Ring ring(mesh.num_vertices());
  for (std::int32_t v = 0; v < mesh.num_vertices(); ++v) {
    ticker.tick();
    add_borders(mesh, v, ring);
  }
  limit_jumps();
}

/// Computes the mean length on the surface of a unit of texture.
void Original::measure_texture(const CollapseMesh& mesh) {
  double on_surface = 0.0, in_texture = 0.0, whole = 0.0;
  for (std::int32_t f = 0; f < mesh.num_slots(); ++f) {
    if (!mesh.is_alive(f)) continue;
    whole += area_vector(mesh, f).norm();
    if (!shows_texture(mesh, f)) continue;
    const auto& w = mesh.wedges(f);
    on_surface += area_vector(mesh, f).norm();
    const Vector2d e1 = mesh.uv(w[1]) - mesh.uv(w[0]), e2 = mesh.uv(w[2]) - mesh.uv(w[0]);
    in_texture += std::abs(e1.x() * e2.y() - e1.y() * e2.x());
  }
  if (!(in_texture > 0.0)) return;
  texture_length = std::sqrt(on_surface / in_texture);
  texture_share = std::max(on_surface / whole, kMinTextured);
}

/// Adds a face to its vertices, each of which represents a third of it.
void Original::add_face(const CollapseMesh& mesh, std::int32_t f) {
  const auto& face = mesh.face(f);
  Eigen::AlignedBox3d around;
  for (const std::int32_t v : face) around.extend(mesh.position(v));
  for (const std::int32_t v : face) box[v].extend(around);
  const Vector3d normal = area_vector(mesh, f);
  const double length = normal.norm();
  if (!(length > 0.0)) return;
  const double third = length / 6.0;
  const Quadric plane = Quadric::plane(normal / length, mesh.position(face[0]), third);
  for (const std::int32_t v : face) {
    surface[v] += plane;
    area[v] += third;
  }
  whole_area += 3.0 * third;
  if (!is_textured || !shows_texture(mesh, f)) return;
  const auto& wedges = mesh.wedges(f);
  const AttributeQuadric shown = AttributeQuadric::triangle(
      {mesh.position(face[0]), mesh.position(face[1]), mesh.position(face[2])},
      {mesh.uv(wedges[0]), mesh.uv(wedges[1]), mesh.uv(wedges[2])}, third);
  for (const std::int32_t wedge : wedges) texture[wedge] += shown;
}

/// Adds the colours of each face to its vertices.
void Original::add_colors(const MeshView& input, const CollapseMesh& mesh) {
  color.resize(mesh.num_vertices());
  Eigen::AlignedBox3d around;
  for (const Eigen::AlignedBox3d& own : box) around.extend(own);
  const double diagonal = around.isEmpty() ? 0.0 : around.diagonal().norm();
  double squares = 0.0;
  for (std::int32_t f = 0; f < mesh.num_slots(); ++f) {
    const double third = mesh.is_alive(f) ? area_vector(mesh, f).norm() / 6.0 : 0.0;
    if (!(third > 0.0)) continue;
    const auto& face = mesh.face(f);
    Triangle3 corners, colors;
    for (std::size_t c = 0; c < 3; ++c) {
      corners[c] = mesh.position(face[c]);
      colors[c] = input.colors.row(face[c]).cast<double>().transpose() / 255.0;
    }
    const ColorQuadric shown = color_quadric(corners, colors, third, diagonal);
    squares += 3.0 * squared_gradient(shown);
    for (const std::int32_t v : face) color[v] += shown;
  }
  color_length_ = color_length(squares, whole_area, diagonal);
}

/// Adds planes through boundaries and seams, perpendicular to their faces; each end represents half
/// of an edge. At a corner of a border, two planes make any move expensive; on a straight border,
/// moves along it are cheap.
void Original::add_borders(const CollapseMesh& mesh, std::int32_t v, Ring& ring) {
  mesh.gather_ring(v, ring);
  mesh.for_each_face(v, [&](std::int32_t f, std::int32_t c) {
    for (const std::size_t other : {(c + 1) % 3, (c + 2) % 3}) {
      const std::int32_t t = mesh.face(f)[other];
      const RingEdge& edge = *ring.find(t);
      if (t < v) continue;
      const bool is_boundary = is_one_sided(mesh, v, edge);
      if (!is_boundary && !edge.is_seam) continue;
      const Vector3d along = mesh.position(t) - mesh.position(v);
      const Vector3d across = along.cross(area_vector(mesh, f));
      const double length = across.norm();
      if (!(length > 0.0)) continue;
      const double weight =
          is_boundary ? options.boundary_weight : options.seam_weight / edge.num_faces;
      const double held = is_boundary ? weight : weight * parted(mesh, f, v, t);
      const Quadric plane =
          Quadric::plane(across / length, mesh.position(v), 0.5 * held * along.norm());
      for (const std::int32_t end : {v, t}) {
        borders[end] += plane;
        border[end] += 0.5 * weight * along.norm();
      }
      if (!is_textured || !edge.is_seam) continue;
      const double half = 0.5 * along.norm() / edge.num_faces;
      const double seen = half * texture_factor() * texture_jump(mesh, f, v, t);
      const Quadric shown = Quadric::plane(across / length, mesh.position(v), seen);
      for (const std::int32_t end : {v, t}) {
        jumps[end] += shown;
        jump[end] += seen;
        seam[end] += half;
      }
    }
  });
}

/// Moving all seams together costs at most as much as moving the whole surface by the same
/// distance. Otherwise seams would decide alone on an atlas of many small charts: everything else
/// is then collapsed first, and neither the shape nor, in the end, the seams can be kept.
void Original::limit_jumps() {
  const double sum = std::accumulate(jump.begin(), jump.end(), 0.0);
  if (!(sum > whole_area)) return;
  const double share = whole_area / sum;
  for (Quadric& planes : jumps) planes *= share;
  for (double& weight : jump) weight *= share;
}

/// Separation of the texture of a face from that of the other faces at its edge v t, relative to
/// the length of the edge, 0 to 1. Around the tip of a cone each face has a texture coordinate of
/// its own, as if its edges were seams, but these separate it hardly at all from its neighbours.
/// Seams with different texture coordinates at both ends count fully (if a picture is shown), and
/// so do borders of materials in any case.
double Original::parted(const CollapseMesh& mesh, std::int32_t f, std::int32_t v,
                        std::int32_t t) const {
  if (!is_textured || !shows_texture(mesh, f) || !(texture_length > 0.0)) return 1.0;
  bool is_same = true, joins_v = true, joins_t = true;
  const auto wedge_at = [&](std::int32_t face, std::int32_t vertex) {
    const auto& corners = mesh.face(face);
    return mesh.wedges(face)[corners[0] == vertex ? 0 : corners[1] == vertex ? 1 : 2];
  };
  mesh.for_each_face_between(v, t, [&](std::int32_t g) {
    is_same = is_same && shows_texture(mesh, g) &&
              mesh.surface(mesh.wedges(g)[0]) == mesh.surface(mesh.wedges(f)[0]);
    joins_v = joins_v && wedge_at(g, v) == wedge_at(f, v);
    joins_t = joins_t && wedge_at(g, t) == wedge_at(f, t);
  });
  if (!is_same) return 1.0;
  if (!(joins_v || joins_t)) return seen();
  const double length = (mesh.position(t) - mesh.position(v)).norm();
  return seen() * std::min(1.0, texture_jump(mesh, f, v, t) * texture_length / length);
}

bool Original::add_missing_rims(const CollapseMesh& mesh, std::int32_t v, const Ring& ring) {
  bool is_new = false;
  for (const RingEdge& edge : ring.edges()) {
    if (edge.num_faces > 2 || !is_one_sided(mesh, v, edge)) continue;
    const std::int32_t t = edge.vertex;
    const Vector3d along = mesh.position(t) - mesh.position(v);
    const double weight = 0.5 * options.boundary_weight * along.norm();
    mesh.for_each_face_between(v, t, [&](std::int32_t f) {
      const Vector3d across = along.cross(area_vector(mesh, f));
      const double length = across.norm();
      if (!(length > 0.0)) return;
      const Vector3d normal = across / length;
      for (const std::int32_t end : {v, t}) {
        if (is_held(borders[end], normal, weight)) continue;
        borders[end] += Quadric::plane(normal, mesh.position(v), weight);
        border[end] += weight;
        is_new = true;
      }
    });
  }
  return is_new;
}

void Original::merge(std::int32_t v, std::int32_t t, double new_price) {
  box[t].extend(box[v]);
  surface[t] += surface[v];
  borders[t] += borders[v];
  if (is_textured) {
    jumps[t] += jumps[v];
    jump[t] += jump[v];
    seam[t] += seam[v];
  }
  if (is_colored) color[t] += color[v];
  area[t] += area[v];
  border[t] += border[v];
  attribute_price[t] = new_price;
}

double Original::error(std::int32_t v, std::int32_t t, const Vector3d& p) const {
  const auto mean = [](double squares, double weight) {
    return weight > 0.0 ? std::max(0.0, squares) / weight : 0.0;
  };
  return std::sqrt(std::max(mean(surface[v](p) + surface[t](p), area[v] + area[t]),
                            mean(borders[v](p) + borders[t](p), border[v] + border[t])));
}

double Original::strips(double squares, double length, double area_around) const {
  if (!(squares > 0.0) || !(length > 0.0)) return 0.0;
  const double most = std::max(options.boundary_weight, options.seam_weight);
  return kStripDistance * std::min(squares, most * area_around * std::sqrt(squares / length));
}

double Original::wrong_color(std::int32_t v, std::int32_t t, const Vector3d& p) const {
  const ColorQuadric joined = joined_colors(v, t);
  return color_factor() * std::min(integral(joined(p), joined.weight), joined.weight);
}

double Original::wrong_side(std::int32_t v, std::int32_t t, const Vector3d& p) const {
  const double shown = jump[v] + jump[t], length = seam[v] + seam[t];
  if (!(shown > 0.0) || !(length > 0.0)) return 0.0;
  const double most = (area[v] + area[t]) * shown / length;
  return std::min(most, integral(jumps[v](p) + jumps[t](p), shown));
}

}  // namespace manip3d::quality_detail
