#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "simplify/collapse_rules.hpp"

namespace manip3d {

/// An edge from a vertex to one of its neighbours.
struct RingEdge {
  std::int32_t vertex;     // the neighbour
  std::int32_t num_faces;  // number of faces of the edge; 1 on a boundary
  bool is_seam;            // two of its faces have different wedges
  // In the first face: wedge at the centre, wedge at the neighbour.
  std::array<std::int32_t, 2> wedges;
};

/// The neighbours of a vertex, with constant-time look-up.
class Ring {
 public:
  explicit Ring(std::size_t num_vertices) : slots_(num_vertices) {}

  [[nodiscard]] const std::vector<RingEdge>& edges() const { return edges_; }

  /// The edge to `vertex`, or nullptr if it is not a neighbour.
  [[nodiscard]] const RingEdge* find(std::int32_t vertex) const {
    const Slot& slot = slots_[vertex];
    return slot.stamp == stamp_ ? &edges_[slot.index] : nullptr;
  }

 private:
  friend class CollapseMesh;
  struct Slot {
    std::uint32_t stamp = 0;
    std::uint32_t index = 0;
  };

  void clear() {
    edges_.clear();
    ++stamp_;  // wraps after 4 billion calls
    if (stamp_ == 0) {
      slots_.assign(slots_.size(), {});
      stamp_ = 1;
    }
  }

  void add(std::int32_t vertex, std::int32_t own_wedge, std::int32_t wedge) {
    Slot& slot = slots_[vertex];
    if (slot.stamp != stamp_) {
      slot = {stamp_, static_cast<std::uint32_t>(edges_.size())};
      edges_.push_back({vertex, 1, false, {own_wedge, wedge}});
      return;
    }
    RingEdge& edge = edges_[slot.index];
    ++edge.num_faces;
    edge.is_seam |= edge.wedges[0] != own_wedge || edge.wedges[1] != wedge;
  }

  std::vector<RingEdge> edges_;
  std::vector<Slot> slots_;
  std::uint32_t stamp_ = 0;
};

/// For each wedge of a collapsing vertex, the wedge of the target that replaces it.
struct WedgeMap {
  struct Pair {
    std::int32_t from;
    std::int32_t to;
  };
  std::vector<Pair> pairs;
  bool is_complete = true;  // every corner has a replacement on its own surface

  [[nodiscard]] std::int32_t at(std::int32_t from) const {
    for (const Pair& pair : pairs) {
      if (pair.from == from) return pair.to;
    }
    return -1;
  }
};

/// Triangle soup under edge collapse, with lists of corners by vertex instead of half-edges, so
/// that an edge may have any number of faces.
///
/// A *wedge* stands for the attributes of a vertex in some of its faces: faces around a vertex with
/// the same material and the same texture coordinate, or none, share a wedge [Hoppe 1998].
class CollapseMesh {
 public:
  explicit CollapseMesh(const MeshView& mesh);

  [[nodiscard]] std::int32_t num_vertices() const {
    return static_cast<std::int32_t>(first_corner_.size());
  }
  [[nodiscard]] std::int64_t num_faces() const { return num_faces_; }
  /// Number of input faces; is_alive() tells which of them remain.
  [[nodiscard]] std::int32_t num_slots() const { return static_cast<std::int32_t>(faces_.size()); }
  [[nodiscard]] std::int64_t num_dropped() const { return num_dropped_; }
  [[nodiscard]] std::int32_t num_wedges() const {
    return static_cast<std::int32_t>(surface_.size());
  }

  using Triple = std::array<std::int32_t, 3>;
  /// Vertices (or wedges) of a face; the first is -1 once the face is removed.
  [[nodiscard]] const Triple& face(std::int32_t f) const { return faces_[f]; }
  [[nodiscard]] const Triple& wedges(std::int32_t f) const { return wedges_[f]; }
  [[nodiscard]] bool is_alive(std::int32_t f) const { return faces_[f][0] >= 0; }

  /// Positions, centred and scaled to a unit diagonal.
  [[nodiscard]] const Eigen::Vector3d& position(std::int32_t v) const { return positions_[v]; }
  [[nodiscard]] double scale() const { return scale_; }  ///< Input units per unit here.
  /// A point in the input's coordinates.
  [[nodiscard]] Eigen::Vector3d to_input(const Eigen::Vector3d& p) const {
    return center_ + scale_ * p;
  }
  [[nodiscard]] Eigen::Vector3d from_input(const Eigen::Vector3d& p) const {
    return (p - center_) / scale_;
  }

  [[nodiscard]] bool has_texture(std::int32_t wedge) const { return (surface_[wedge] & 1) != 0; }
  /// Equal for wedges with the same material that both have texture coordinates, or both have none.
  [[nodiscard]] std::int64_t surface(std::int32_t wedge) const { return surface_[wedge]; }
  [[nodiscard]] const Eigen::Vector2d& uv(std::int32_t wedge) const { return texcoords_[wedge]; }

  /// Calls body(face, corner) for each face of a vertex, `corner` in 0..2.
  template <typename Body>
  void for_each_face(std::int32_t v, Body&& body) const {
    for (std::int32_t c = first_corner_[v]; c >= 0; c = next_corner_[c]) {
      const std::int32_t f = c / 3;
      body(f, c - 3 * f);
    }
  }

  /// Calls body(face) for each face with the vertices v and t, in the order of v's faces, or, if v
  /// is a hub, in the order of t's.
  template <typename Body>
  void for_each_face_between(std::int32_t v, std::int32_t t, Body&& body) const {
    const bool swaps = is_hub(v) && degree_[t] < degree_[v];
    const std::int32_t other = swaps ? v : t;
    for_each_face(swaps ? t : v, [&](std::int32_t f, std::int32_t) {
      const Triple& face = faces_[f];
      if (face[0] == other || face[1] == other || face[2] == other) body(f);
    });
  }

  [[nodiscard]] bool is_isolated(std::int32_t v) const { return first_corner_[v] < 0; }
  /// Number of faces of a vertex.
  [[nodiscard]] std::int32_t degree(std::int32_t v) const { return degree_[v]; }
  /// Whether a vertex has so many faces that steps around it do not visit all of them.
  [[nodiscard]] bool is_hub(std::int32_t v) const { return degree_[v] > kHub; }
  /// A face of a vertex that is not isolated.
  [[nodiscard]] std::int32_t first_face(std::int32_t v) const { return first_corner_[v] / 3; }

  void gather_ring(std::int32_t v, Ring& ring) const;

  /// Maps the wedges of v to wedges of t: across the faces on the edge if possible, else to the
  /// wedge of t on the same surface with the nearest texture coordinate (section 2.4.4). Wedges
  /// without such a wedge stay, and the map is not complete.
  void map_wedges(std::int32_t v, std::int32_t t, WedgeMap& map) const;

  /// Moves v onto t: faces on the edge are removed, the others get the mapped wedges.
  void collapse(std::int32_t v, std::int32_t t, const WedgeMap& map);

  /// Removes a face.
  void remove_face(std::int32_t f);

  /// Sets the position of a vertex (in the coordinates of position()).
  void move(std::int32_t v, const Eigen::Vector3d& position) {
    positions_[v] = position;
    moved_[v] = true;
    any_moved_ = true;
  }
  [[nodiscard]] bool any_moved() const { return any_moved_; }
  void set_uv(std::int32_t wedge, const Eigen::Vector2d& uv) { texcoords_[wedge] = uv; }

  /// Extracts the current mesh, compact, with vertices and faces in input order; fills the maps.
  TriangleMesh extract(const MeshView& input, std::vector<std::int32_t>& kept,
                       std::vector<std::int32_t>& output_vertex,
                       std::vector<std::int32_t>& face_map) const;

 private:
  void make_wedges(const MeshView& mesh);
  void extract_texcoords(TriangleMesh& out) const;
  void unlink(std::int32_t vertex, std::int32_t corner);
  [[nodiscard]] std::int32_t nearest_normal(std::int32_t normal, std::int32_t t) const;
  [[nodiscard]] std::int32_t nearest_wedge(std::int32_t wedge, std::int32_t t) const;

  std::vector<Eigen::Vector3d> positions_;
  Eigen::Vector3d center_ = Eigen::Vector3d::Zero();
  double scale_ = 1.0;
  std::vector<bool> moved_;  // vertices that are not at their input position
  bool any_moved_ = false;
  std::vector<Triple> faces_;
  std::vector<Triple> wedges_;
  std::vector<Triple> normal_indices_;  // by face; empty if the mesh has no normals
  Vertices normals_;
  std::vector<std::int32_t> first_corner_;  // by vertex; corner = 3 face + 0..2; -1: none
  std::vector<std::int32_t> next_corner_;   // by corner, in the list of its vertex
  // By corner: the previous one in that list; -1: none.
  std::vector<std::int32_t> previous_corner_;
  std::vector<std::int32_t> degree_;   // by vertex
  std::vector<std::int64_t> surface_;  // by wedge: 2 material + (1 if it has texture coordinates)
  std::vector<Eigen::Vector2d> texcoords_;  // by wedge
  std::vector<std::int32_t> texcoord_;      // by wedge: row of the input's table, or -1
  std::int64_t num_faces_ = 0;
  std::int64_t num_dropped_ = 0;
};

}  // namespace manip3d
