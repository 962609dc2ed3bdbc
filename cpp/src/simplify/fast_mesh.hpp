#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "geometry/arena.hpp"
#include "geometry/bulk.hpp"
#include "geometry/lanes.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/geometry/parallel.hpp"
#include "manip3d/progress.hpp"
#include "manip3d/simplify/quality.hpp"
#include "simplify/quadric_vertex.hpp"
#include "simplify/spatial_order.hpp"
#include "simplify/wedges.hpp"

/// The mode `fast`: the mesh (fast_mesh, with loading in fast_load and output in fast_output), the
/// planes that each vertex represents (fast_quadrics), one collapse (fast_collapse) and its
/// attributes (fast_attributes), removal of whole pieces (fast_pieces), passes over all edges
/// (fast_pass), and the order of the passes (fast).
namespace manip3d::fast_detail {

using Vector3f = Eigen::Vector3f;
using Triple = std::array<std::int32_t, 3>;

/// Faces per task: a few hundred kilobytes, which fit into the cache of a core.
constexpr int kBlockBits = 14;
constexpr std::int64_t kBlock = std::int64_t{1} << kBlockBits;

/// A block of a level consists of this many blocks (as a power of two) of the level below. Edges
/// across blocks wait for the level at which they are inside one.
constexpr int kLevelBits = 3;

/// Squared sine below which a triangle has no area in single precision.
constexpr float kMinSquaredSine = 1e-9F;

/// The corners (0..2) after and before a corner. A table in a number avoids a branch, which a
/// processor mispredicts every third time.
constexpr std::uint32_t after(std::uint32_t c) { return (0b00'10'01U >> (2 * c)) & 3U; }
constexpr std::uint32_t before(std::uint32_t c) { return (0b01'00'10U >> (2 * c)) & 3U; }

inline bool is_degenerate(const Triple& f) { return f[0] == f[1] || f[1] == f[2] || f[2] == f[0]; }

inline Vector3f position_of(const QuadricVertex& v) { return {v.x, v.y, v.z}; }

/// Four vectors. Sums are in Eigen's order of adding three numbers, so that each of the four has
/// the same bits as on its own.
struct Vectors4 {
  Float4 x, y, z;

  [[nodiscard]] Vectors4 operator-(const Vectors4& v) const { return {x - v.x, y - v.y, z - v.z}; }
  [[nodiscard]] Float4 dot(const Vectors4& v) const { return x * v.x + (y * v.y + z * v.z); }
  [[nodiscard]] Float4 squared_norm() const { return dot(*this); }
  [[nodiscard]] Vectors4 cross(const Vectors4& v) const {
    return {y * v.z - z * v.y, z * v.x - x * v.z, x * v.y - y * v.x};
  }
};

inline Vectors4 four_of(const Vector3f& v) { return {all_of(v.x()), all_of(v.y()), all_of(v.z())}; }

/// Runs work in fixed chunks, as parallel_chunks() does, and reports the progress of the whole.
class Tasks {
 public:
  Tasks(int num_threads, const Progress& progress)
      : num_threads_(num_threads), progress_(progress) {}

  [[nodiscard]] int num_threads() const { return num_threads_; }
  [[nodiscard]] Progress part(double begin, double end) const {
    return part_of(progress_, begin, end);
  }
  void report(double fraction) {
    fraction_ = fraction;
    if (progress_) progress_(fraction);
  }
  template <typename Body>
  void over(std::int64_t count, std::int64_t chunk, const Body& body) const {
    parallel_chunks(count, chunk, num_threads_, body,
                    progress_ ? Progress([this](double) { progress_(fraction_); }) : Progress());
  }

 private:
  int num_threads_;
  const Progress& progress_;
  double fraction_ = 0.0;
};

/// A mesh in single precision, in units of its own size, for passes of collapses. Vertices and
/// faces are in a spatial order, whose blocks are processed in parallel.
///
/// Between begin_pass() and end_pass(), faces keep their vertices; `remap` says into which vertex
/// each one collapsed. end_pass() updates the faces.
struct FastMesh {
  FastMesh(const MeshView& mesh, const BoundingBox& box, const std::vector<bool>& locked,
           Tasks& in_tasks);

  [[nodiscard]] std::int64_t num_faces() const { return static_cast<std::int64_t>(faces.size()); }
  [[nodiscard]] std::int32_t num_vertices() const {
    return static_cast<std::int32_t>(vertices.size());
  }
  [[nodiscard]] bool has_wedges() const { return !wedges.empty(); }
  [[nodiscard]] bool is_locked(std::int32_t v) const {
    return !locked.empty() && locked[id[v]] != 0;
  }
  [[nodiscard]] std::int64_t num_blocks(int of_level = 0) const {
    const std::int64_t block = kBlock << (kLevelBits * of_level);
    return (num_faces() + block - 1) / block;
  }
  /// The level at which all faces are in one block.
  [[nodiscard]] int top_level() const {
    int top = 0;
    while (num_blocks(top) > 1) ++top;
    return top;
  }

  /// Corners (3 face + 0..2) of a vertex, in the order of the faces.
  [[nodiscard]] std::span<const std::uint32_t> corners(std::int32_t v) const {
    return std::span(corners_by_vertex)
        .subspan(first_corner[v], first_corner[v + 1] - first_corner[v]);
  }
  /// Calls body(face, corner, next, last): the other vertices of each face of v, counter-clockwise.
  template <typename Body>
  void for_each_face(std::int32_t v, const Body& body) const {
    for (const std::uint32_t corner : corners(v)) {
      const std::uint32_t f = corner / 3, c = corner - 3 * f;
      const Triple& face = faces[f];
      body(f, c, face[after(c)], face[before(c)]);
    }
  }
  /// The ends of the edge that starts at a corner, the lower one first.
  [[nodiscard]] std::array<std::int32_t, 2> edge_at(std::uint32_t corner) const {
    const Triple& face = faces[corner / 3];
    const std::uint32_t c = corner % 3;
    const std::int32_t a = face[c], b = face[after(c)];
    return {std::min(a, b), std::max(a, b)};
  }
  /// Positions of four vertices.
  [[nodiscard]] Vectors4 positions_of(const std::int32_t* v) const {
    const auto row = [&](std::int32_t i) { return load4(&vertices[i].x); };
    const auto [x, y, z, unused] =
        transpose(std::array{row(v[0]), row(v[1]), row(v[2]), row(v[3])});
    return {x, y, z};
  }

  template <typename Body>
  void over_vertices(const Body& body) const {
    tasks.over(num_vertices(), kBlock / 2, [&](std::int64_t begin, std::int64_t end) {
      for (auto v = static_cast<std::int32_t>(begin); v < end; ++v) body(v);
    });
  }
  /// Calls body(block, first face, end of its faces).
  template <typename Body>
  void over_blocks(const Body& body) const {
    tasks.over(num_faces(), kBlock, [&](std::int64_t begin, std::int64_t end) {
      body(begin >> kBlockBits, begin, end);
    });
  }
  /// Calls body(is_mine) in tasks, each of which visits all faces for its own range of vertices:
  /// the order for each vertex does not depend on the number of tasks.
  template <typename Body>
  void in_ranges(const Body& body) const {
    constexpr int kRangeTasks = 2;
    const int count = tasks.num_threads() == 1 ? 1 : kRangeTasks;
    tasks.over(count, 1, [&](std::int64_t task, std::int64_t) {
      const auto low = static_cast<std::int32_t>(num_vertices() * task / count);
      const auto high = static_cast<std::int32_t>(num_vertices() * (task + 1) / count);
      const auto width = static_cast<std::uint32_t>(high - low);
      body([=](std::int32_t v) { return static_cast<std::uint32_t>(v - low) < width; });
    });
  }

  void build_adjacency();
  /// Finds the vertices with complex edges; a collapse makes edges of its neighbours complex.
  void find_complex_edges();
  /// Keeps the faces for which keep(face) holds, in order.
  template <typename Keep>
  void keep_faces(const Keep& keep) {
    std::size_t row = 0;
    for (std::size_t f = 0; f < faces.size(); ++f) {
      if (keep(static_cast<std::int32_t>(f))) move_face(f, row++);
    }
    resize_faces(row);
  }

  void begin_pass();
  /// Removes collapsed vertices and faces without area, and renumbers the faces.
  void end_pass();
  /// After end_pass(): around the given vertices, removes all but the first of the faces on the
  /// same three vertices; of `twins`, which are faces back to back, all but the first on each side.
  /// Both use the vertex indices of the pass.
  void remove_double_faces(const std::vector<std::int32_t>& around, std::vector<Triple> twins);

  /// Writes the mesh and the maps of input vertices and faces.
  void write(QualityResult& result) const;

  const MeshView& input;
  Tasks& tasks;
  double scale;
  Eigen::Vector3d center;
  Arena arena;  // must be before the tables that it contains
  SpatialOrder order;

  Bulk<QuadricVertex> vertices{arena};
  Bulk<std::int32_t> id{arena};          // by vertex: its initial index
  std::vector<std::uint8_t> is_open;     // by vertex: not closed around, or with several wedges
  std::vector<std::uint8_t> is_complex;  // by vertex: with complex edges; empty: none
  Bulk<std::int32_t> into{arena};        // by initial vertex: the one it collapsed into, or -1
  std::vector<std::uint8_t> is_moved;    // by initial vertex
  std::vector<std::uint8_t> locked;      // by initial vertex; empty: none
  Bulk<Vector3f> colors{arena};          // by initial vertex; empty: none

  Bulk<Triple> faces{arena};
  Bulk<std::int32_t> face_ids{arena};  // by face: row of the input
  Bulk<Triple> wedges{arena};          // by face; empty if there is one wedge per vertex
  Bulk<Triple> normals{arena};         // by face; empty: none
  WedgeTable table;
  std::vector<std::int32_t> wedge_into;
  std::int64_t num_dropped = 0;  // input faces without area, and duplicates

  Bulk<std::uint32_t> first_corner{arena};  // by vertex
  Bulk<std::uint32_t> corners_by_vertex{arena};

  // In a pass, of a vertex:
  Bulk<std::int32_t> remap{arena};     // the vertex it collapsed into
  std::vector<std::uint8_t> is_taken;  // whether it has collapsed
  std::vector<std::uint8_t> level;     // the lowest level at which one block has all its faces

 private:
  void load_vertices(const std::vector<bool>& is_locked_in);
  void load_faces();
  void load_attributes();
  void remove_equal_faces();
  void find_levels();
  void close_up_vertices();
  void resize_faces(std::size_t count);
  void move_face(std::size_t from, std::size_t to) {
    faces[to] = faces[from];
    face_ids[to] = face_ids[from];
    if (has_wedges()) wedges[to] = wedges[from];
    if (!normals.empty()) normals[to] = normals[from];
  }
  void write_texcoords(TriangleMesh& out) const;
  void write_normals(TriangleMesh& out) const;

  // After a pass, of a remaining vertex: its index within its chunk.
  Bulk<std::int32_t> number_{arena};
  std::vector<std::int64_t> kept_of_chunk_;
};

/// Whether a vertex has a complex edge. `ends` are the other ends of its edges, once for each face,
/// sorted.
bool has_complex_edge(const std::vector<std::int32_t>& ends);

}  // namespace manip3d::fast_detail
