#include "manip3d/simplify/fast.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <functional>
#include <optional>
#include <queue>
#include <span>
#include <string>
#include <utility>

#include "geometry/bulk.hpp"
#include "geometry/lanes.hpp"
#include "geometry/shared_union_find.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/parallel.hpp"
#include "manip3d/geometry/topology.hpp"
#include "simplify/collapse_rules.hpp"
#include "simplify/pieces.hpp"
#include "simplify/quadric_vertex.hpp"
#include "simplify/spatial_order.hpp"
#include "simplify/usual_unit.hpp"
#include "simplify/wedges.hpp"

namespace manip3d {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Vector3f = Eigen::Vector3f;
using Triple = std::array<std::int32_t, 3>;

/// Faces that one task works on: a few hundred kilobytes, which stay in a core's own cache.
constexpr int kBlockBits = 14;
constexpr std::int64_t kBlock = std::int64_t{1} << kBlockBits;

/// A block of a level is so many blocks (as a power of two) of the level below. What crosses blocks
/// waits for the level at which it does not.
constexpr int kLevelBits = 3;

/// The part of the vertices that may go in a pass. More is faster, and then cheap regions are
/// finished later than dear ones.
constexpr double kShareOfPass = 0.5;

/// Below so many faces passes cost next to nothing, and the order matters more.
constexpr double kShareOfSmallPass = 0.1;
constexpr double kSmallCandidates = 1.0;
constexpr std::int64_t kSmall = 5000;
static_assert(kSmall <= kBlock);

/// In a small pass nothing is done that costs so many times as much as a collapse that has to wait
/// for the next pass, because a neighbour went in this one.
constexpr float kOvertakes = 8.0F;

/// In a large pass a vertex that may not lie where it is best goes to an end of its edge, at most
/// for so many times the price of the dearest candidate.
constexpr float kLeap = 100.0F;

/// Candidates for each collapse that a pass wants: neighbours exclude each other.
constexpr double kCandidates = 3.0;

/// cos^2 78 deg: at 90 a face can turn over in two steps.
constexpr float kLeastSquaredCosine = 0.04F;

/// Sine squared of the angle that counts as no area in single precision.
constexpr float kLeastSquaredSine = 1e-9F;

/// A new vertex is at most this many lengths of its edge (squared) away from the middle.
constexpr float kFarthest = 4.0F;

/// The link rule is waived, as in the mode `quality`, if a legal collapse costs this many times
/// more than one that it refused (squared, like all prices) and its error can be seen, as a mean
/// distance over the size of the mesh.
constexpr float kFarCheaperSquared = 900.0F;
constexpr double kVisibleDistance = 1e-3;

/// Hubs: so many corners times so many refusals in one pass, then a vertex is left alone.
constexpr std::int64_t kHubPatience = 1 << 14;

/// A piece farther than this from the rest, over the size of the mesh, is missed at once: holes
/// close before it goes.
constexpr double kMissedDistance = 0.01;

/// A piece that vanishes is missed more than its distance says; this is squared, like all prices.
constexpr double kFastPieceFactor = 4.0;

constexpr std::int64_t kFacesOfTetrahedron = 4;

/// Tasks that share the vertices where things are sorted by vertex.
constexpr int kRangeTasks = 2;

constexpr std::uint32_t kNoEdge = 0xFFFFFFFFU;
constexpr std::uint32_t kTooDear = 0xFFFFFFFEU;  // above max_error
constexpr std::uint32_t kDearest = 0x7F800000U;  // infinity, as an order of prices

/// The corners (0..2) after and before one: from a table in a number, because a processor guesses
/// wrong every third time which one of three it is.
constexpr std::uint32_t after(std::uint32_t c) { return (0b00'10'01U >> (2 * c)) & 3U; }
constexpr std::uint32_t before(std::uint32_t c) { return (0b01'00'10U >> (2 * c)) & 3U; }

Int4 bits_of(std::uint32_t bits) {
  const auto number = static_cast<std::int32_t>(bits);
  return Int4{number, number, number, number};
}

/// Prices are not negative, so their bits have their order.
std::uint32_t key_of(float price) {
  return price > 0.0F ? std::min(std::bit_cast<std::uint32_t>(price), kDearest)
                      : (price <= 0.0F ? 0U : kDearest);
}

/// The same of four prices.
Int4 keys_of(Float4 prices) {
  const Int4 positive = prices > 0.0F, others = ~(prices <= 0.0F) & bits_of(kDearest);
  return (positive & std::bit_cast<Int4>(prices)) | (~positive & others);
}

/// An edge of a face, with its price: sorted by price, then by place.
struct PricedEdge {
  std::uint32_t key;
  std::uint32_t slot;  // 3 face + corner
};

/// An edge of a face with its ends.
struct SlotWithEnds {
  std::uint32_t slot;
  std::int32_t v, t;
};

/// An edge with its price and its ends.
struct EdgeInReach {
  std::uint32_t key;
  std::int32_t v, t;
};

/// Stable radix sort by 16 bits of what the keys differ in.
void sort_candidates(Bulk<PricedEdge>& items, Bulk<PricedEdge>& other) {
  if (items.size() < 2) return;
  std::uint32_t least = kNoEdge, most = 0;
  for (const PricedEdge& item : items) {
    least = std::min(least, item.key);
    most = std::max(most, item.key);
  }
  const int shift = std::max(0, static_cast<int>(std::bit_width(most - least)) - 16);
  other.resize(items.size());
  for (int pass = 0; pass < 2; ++pass) {
    std::array<std::uint32_t, 256> start{};
    const auto digit = [&](const PricedEdge& item) {
      return (((item.key - least) >> shift) >> (8 * pass)) & 255U;
    };
    for (const PricedEdge& item : items) ++start[digit(item)];
    std::uint32_t sum = 0;
    for (std::uint32_t& count : start) sum += std::exchange(count, sum);
    for (const PricedEdge& item : items) other[start[digit(item)]++] = item;
    items.swap(other);
  }
}

/// The faces around a vertex, in the order of a pass that has not ended.
struct Fan {
  Bulk<Side> rest;            // the other two corners
  Bulk<std::int32_t> across;  // third corners of the faces on the edge

  void clear() {
    rest.clear();
    across.clear();
  }

  /// Other ends of the edges of `rest`, sorted: each as often as the edge has faces.
  void append_ends(std::vector<std::int32_t>& ends) const {
    for (const auto& [a, b] : rest) ends.push_back(a), ends.push_back(b);
    std::sort(ends.begin(), ends.end());
  }

  /// The edges opposite the vertex, of `rest`, the lower end first; sorted.
  void append_sides(std::vector<Side>& sides) const {
    for (const auto& [a, b] : rest) sides.push_back({std::min(a, b), std::max(a, b)});
    std::sort(sides.begin(), sides.end());
  }
};

/// Whether a vertex has a complex edge: `ends` are those of its edges, once for each face, sorted.
bool has_complex_edge(const std::vector<std::int32_t>& ends) {
  for (std::size_t i = 2; i < ends.size(); ++i) {
    if (ends[i] == ends[i - 2]) return true;
  }
  return false;
}

/// Buffers and counters of one task.
struct Worker {
  int level = 0;
  Bulk<PricedEdge> candidates;  // at first all edges of this block
  Bulk<PricedEdge> sorted;
  std::vector<EdgeInReach> in_reach;
  Bulk<PricedEdge> waiting;  // edges of this block that touch others, for the next level
  Fan first, second;
  std::vector<std::int32_t> ends;
  std::vector<Side> sides, twins;
  std::vector<std::int32_t> doubling;  // vertices whose faces may lie on others'
  std::vector<Triple> twin_faces;      // around them: vertices of faces back to back
  std::vector<std::pair<std::int32_t, std::int32_t>> wedge_pairs;
  std::vector<std::int32_t> merged_wedges;
  std::vector<Vector2d> merged_uvs;
  std::array<std::int64_t, kNumRejections> rejected{};
  std::int64_t removed = 0, collapses = 0, quota = 0;
  std::uint32_t most = kDearest;    // price of what may be done now
  bool leaves_dear = false;         // left the rest of its candidates to the next pass
  std::uint32_t forbids = kNoEdge;  // price above which what the link rule refused is far cheaper
  bool meets_forbidden = false;     // left the rest of its candidates for that reason
  float squared_error = 0.0F;
};

Vector3f position_of(const QuadricVertex& v) { return {v.x, v.y, v.z}; }

/// Four vectors. Sums are in the order in which Eigen adds up three numbers, so that each of the
/// four has the bits that it would have alone.
struct Vectors4 {
  Float4 x, y, z;

  [[nodiscard]] Vectors4 operator-(const Vectors4& v) const { return {x - v.x, y - v.y, z - v.z}; }
  [[nodiscard]] Float4 dot(const Vectors4& v) const { return x * v.x + (y * v.y + z * v.z); }
  [[nodiscard]] Float4 squared_norm() const { return dot(*this); }
  [[nodiscard]] Vectors4 cross(const Vectors4& v) const {
    return {y * v.z - z * v.y, z * v.x - x * v.z, x * v.y - y * v.x};
  }
};

Vectors4 four_of(const Vector3f& v) { return {all_of(v.x()), all_of(v.y()), all_of(v.z())}; }

class FastSimplifier {
 public:
  FastSimplifier(const MeshView& input, const BoundingBox& box, const FastOptions& options,
                 const Progress& progress)
      : input_(input),
        options_(options),
        progress_(progress),
        box_(box),
        scale_(box_.diagonal() > 0.0 ? box_.diagonal() : 1.0),
        center_(box_.center()),
        order_(spatial_order(input, box_, options.num_threads, part_of(progress, 0.0, 0.05))) {
    load_vertices();
    load_faces();
    build_adjacency();
    load_attributes();
    sum_quadrics();
    find_pieces();
    const double limit = options.max_error / scale_;
    squared_limit_ =
        limit < 1e18 ? static_cast<float>(limit * limit) : std::numeric_limits<float>::infinity();
  }

  QualityResult run() {
    const auto start = static_cast<double>(num_faces());
    const auto target = static_cast<double>(options_.target_faces);
    bool is_fresh = true;
    while (num_faces() > options_.target_faces) {
      const double gone = start - static_cast<double>(num_faces());
      report(0.2 + 0.7 * gone / std::max(1.0, start - target));
      if (!std::exchange(is_fresh, false)) {
        build_adjacency();
        if (!is_complex_.empty() || rules_ != Rules::kAll) find_complex_edges();
      }
      if (!pass()) break;
    }
    report(0.9);
    return finish();
  }

 private:
  void report(double fraction) {
    fraction_ = fraction;
    if (progress_) progress_(fraction);
  }
  [[nodiscard]] std::int64_t num_faces() const { return static_cast<std::int64_t>(faces_.size()); }
  [[nodiscard]] std::int32_t num_vertices() const {
    return static_cast<std::int32_t>(vertices_.size());
  }
  [[nodiscard]] bool is_small() const {
    return num_faces() < kBlock && num_faces() - num_spent_ < kSmall;
  }
  [[nodiscard]] bool has_wedges() const { return !wedges_.empty(); }

  template <typename Body>
  void over(std::int64_t count, std::int64_t chunk, const Body& body) const {
    parallel_chunks(count, chunk, options_.num_threads, body,
                    progress_ ? Progress([this](double) { progress_(fraction_); }) : Progress());
  }
  template <typename Body>
  void over_vertices(const Body& body) const {
    over(num_vertices(), kBlock / 2, [&](std::int64_t begin, std::int64_t end) {
      for (auto v = static_cast<std::int32_t>(begin); v < end; ++v) body(v);
    });
  }
  /// Calls body(is_mine) in tasks, each of which looks through all faces for a range of vertices of
  /// its own: what is in order for each vertex does not depend on the number of tasks.
  template <typename Body>
  void in_ranges(const Body& body) const {
    const int tasks = options_.num_threads == 1 ? 1 : kRangeTasks;
    over(tasks, 1, [&](std::int64_t task, std::int64_t) {
      const auto low = static_cast<std::int32_t>(num_vertices() * task / tasks);
      const auto high = static_cast<std::int32_t>(num_vertices() * (task + 1) / tasks);
      const auto width = static_cast<std::uint32_t>(high - low);
      body([=](std::int32_t v) { return static_cast<std::uint32_t>(v - low) < width; });
    });
  }
  [[nodiscard]] std::int64_t num_blocks(int level = 0) const {
    const std::int64_t block = kBlock << (kLevelBits * level);
    return (num_faces() + block - 1) / block;
  }
  /// The level at which all faces are in one block.
  [[nodiscard]] int top_level() const {
    int level = 0;
    while (num_blocks(level) > 1) ++level;
    return level;
  }
  template <typename Body>
  void for_each_worker(const Body& body) {
    for (std::vector<Worker>& level : workers_) {
      for (Worker& worker : level) body(worker);
    }
  }
  template <typename Body>
  void over_blocks(const Body& body) const {
    over(num_faces(), kBlock,
         [&](std::int64_t begin, std::int64_t end) { body(begin >> kBlockBits, begin, end); });
  }

  // --- Loading -------------------------------------------------------------------------------

  void load_vertices() {
    vertices_.resize(order_.source.size());
    into_.assign(vertices_.size(), -1);
    id_.resize(vertices_.size());
    is_moved_.assign(vertices_.size(), 0);
    over_vertices([&](std::int32_t v) {
      const Vector3d p = (input_.vertices.row(order_.source[v]).transpose() - center_) / scale_;
      QuadricVertex& vertex = vertices_[v];
      vertex = {};
      vertex.x = static_cast<float>(p.x());
      vertex.y = static_cast<float>(p.y());
      vertex.z = static_cast<float>(p.z());
      id_[v] = v;
    });
    if (!options_.locked.empty()) {
      is_locked_.assign(vertices_.size(), 0);
      for (std::size_t v = 0; v < options_.locked.size(); ++v) {
        if (options_.locked[v] && order_.rank[v] >= 0) is_locked_[order_.rank[v]] = 1;
      }
    }
    for (Eigen::Index v = 0; input_.colors.rows() > 0 && v < num_vertices(); ++v) {
      colors_.emplace_back(input_.colors.row(order_.source[v]).cast<float>().transpose());
    }
  }

  [[nodiscard]] static bool is_degenerate(const Triple& f) {
    return f[0] == f[1] || f[1] == f[2] || f[2] == f[0];
  }
  [[nodiscard]] static std::int32_t lowest(const Triple& f) { return std::min({f[0], f[1], f[2]}); }

  /// Faces in the order of their lowest vertices.
  void load_faces() {
    const auto count = static_cast<std::int64_t>(input_.num_faces());
    Bulk<Triple> ranks(count);
    over(count, kBlock, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t f = begin; f < end; ++f) {
        const std::int32_t* face = input_.faces.data() + 3 * f;
        ranks[f] = {order_.rank[face[0]], order_.rank[face[1]], order_.rank[face[2]]};
      }
    });
    report(0.06);
    std::vector<std::int32_t> start(vertices_.size() + 1, 0);
    in_ranges([&](const auto& is_mine) {
      for (const Triple& face : ranks) {
        if (is_mine(lowest(face)) && !is_degenerate(face)) ++start[lowest(face) + 1];
      }
    });
    for (std::size_t v = 1; v < start.size(); ++v) start[v] += start[v - 1];
    faces_.resize(start.back());
    face_ids_.resize(start.back());
    result_.dropped_faces += count - start.back();
    in_ranges([&](const auto& is_mine) {
      for (std::int64_t f = 0; f < count; ++f) {
        const Triple& face = ranks[f];
        if (!is_mine(lowest(face)) || is_degenerate(face)) continue;
        const std::int32_t row = start[lowest(face)]++;
        faces_[row] = face;
        face_ids_[row] = static_cast<std::int32_t>(f);
      }
    });
    report(0.08);
  }

  [[nodiscard]] bool is_textured(Eigen::Index f) const { return input_.face_has_texcoords(f); }

  void load_attributes() {
    if (input_.has_texcoords() || input_.has_materials()) {
      wedges_.resize(faces_.size());
      table_ = make_wedges(
          input_, num_vertices(),
          [&](std::int32_t v, const auto& body) {
            for (const std::uint32_t corner : corners(v)) {
              const std::uint32_t f = corner / 3;
              body(face_ids_[f], static_cast<std::int32_t>(corner - 3 * f), corner);
            }
          },
          [&](std::int64_t corner, std::int32_t wedge) {
            wedges_[corner / 3][corner % 3] = wedge;
          });
      wedge_into_.resize(table_.size());
      for (std::int32_t w = 0; w < table_.size(); ++w) wedge_into_[w] = w;
    }
    if (input_.face_normals.rows() > 0) {
      normals_.resize(faces_.size());
      for (std::size_t f = 0; f < faces_.size(); ++f) {
        const auto n = input_.face_normals.row(face_ids_[f]);
        normals_[f] = {n(0), n(1), n(2)};
      }
    }
    remove_equal_faces();
    report(0.12);
  }

  /// The first of the faces with the same corners and wedges in the same orientation stays.
  void remove_equal_faces() {
    const auto key = [&](std::int32_t f) {
      const Triple& face = faces_[f];
      const auto k =
          static_cast<std::uint32_t>(std::min_element(face.begin(), face.end()) - face.begin());
      std::array<std::int32_t, 6> result{face[k], face[after(k)], face[before(k)], 0, 0, 0};
      if (has_wedges()) {
        const Triple& w = wedges_[f];
        result[3] = w[k], result[4] = w[after(k)], result[5] = w[before(k)];
      }
      return result;
    };
    const auto count = static_cast<std::int32_t>(faces_.size());
    std::vector<std::vector<std::int32_t>> copies(num_blocks());
    over_blocks([&](std::int64_t block, std::int64_t begin, std::int64_t end) {
      std::vector<std::int32_t> here;
      auto f = static_cast<std::int32_t>(begin);
      // Faces with the same lowest vertex belong to the block that they begin in.
      while (f > 0 && f < end && lowest(faces_[f]) == lowest(faces_[f - 1])) ++f;
      for (std::int32_t next = f; f < end; f = next) {
        here.clear();
        const std::int32_t v = lowest(faces_[f]);
        for (; next < count && lowest(faces_[next]) == v; ++next) here.push_back(next);
        append_copies(here, key, copies[block]);
      }
    });
    std::vector<std::uint8_t> is_copy;
    for (const std::vector<std::int32_t>& of_block : copies) {
      if (!of_block.empty()) is_copy.resize(faces_.size(), 0);
      for (const std::int32_t f : of_block) is_copy[f] = 1;
    }
    if (is_copy.empty()) return;
    result_.dropped_faces += std::count(is_copy.begin(), is_copy.end(), 1);
    keep_faces([&](std::int32_t f) { return is_copy[f] == 0; });
    build_adjacency();
  }

  /// Appends the faces of `here` (in order) whose key an earlier one has.
  template <typename Key>
  static void append_copies(std::vector<std::int32_t>& here, const Key& key,
                            std::vector<std::int32_t>& copies) {
    if (here.size() <= 8) {
      for (std::size_t i = 1; i < here.size(); ++i) {
        const auto own = key(here[i]);
        if (std::any_of(here.begin(), here.begin() + static_cast<std::ptrdiff_t>(i),
                        [&](std::int32_t f) { return key(f) == own; })) {
          copies.push_back(here[i]);
        }
      }
      return;
    }
    std::sort(here.begin(), here.end(), [&](std::int32_t f, std::int32_t g) {
      const auto a = key(f), b = key(g);
      return a != b ? a < b : f < g;
    });
    for (std::size_t i = 1; i < here.size(); ++i) {
      if (key(here[i]) == key(here[i - 1])) copies.push_back(here[i]);
    }
  }

  /// Keeps the faces for which keep(face) holds, in order.
  template <typename Keep>
  void keep_faces(const Keep& keep) {
    std::size_t row = 0;
    for (std::size_t f = 0; f < faces_.size(); ++f) {
      if (!keep(static_cast<std::int32_t>(f))) continue;
      faces_[row] = faces_[f];
      face_ids_[row] = face_ids_[f];
      if (has_wedges()) wedges_[row] = wedges_[f];
      if (!normals_.empty()) normals_[row] = normals_[f];
      ++row;
    }
    resize_faces(row);
  }

  void resize_faces(std::size_t count) {
    if (has_wedges()) wedges_.resize(count);
    if (!normals_.empty()) normals_.resize(count);
    faces_.resize(count);
    face_ids_.resize(count);
  }

  // --- Neighbourhoods ------------------------------------------------------------------------

  /// Lists of corners (3 face + 0..2) by vertex, in the order of the faces.
  void build_adjacency() {
    first_.assign(vertices_.size() + 1, 0);
    corners_.resize(3 * faces_.size());
    in_ranges([&](const auto& is_mine) {
      for (const Triple& face : faces_) {
        for (const std::int32_t v : face) {
          if (is_mine(v)) ++first_[v];
        }
      }
    });
    std::uint32_t sum = 0;
    for (std::uint32_t& count : first_) count = sum += count;
    // From the last corner to the first: what ends the list of a vertex becomes where it starts.
    in_ranges([&](const auto& is_mine) {
      const std::int32_t* vertex = faces_.empty() ? nullptr : faces_.front().data();
      for (std::size_t i = corners_.size(); i-- > 0;) {
        if (is_mine(vertex[i])) corners_[--first_[vertex[i]]] = static_cast<std::uint32_t>(i);
      }
    });
  }

  [[nodiscard]] std::span<const std::uint32_t> corners(std::int32_t v) const {
    return std::span(corners_).subspan(first_[v], first_[v + 1] - first_[v]);
  }

  /// Finds for each vertex the lowest level at which one block has all its faces.
  void find_levels() {
    level_.resize(vertices_.size());
    over_vertices([&](std::int32_t v) {
      level_[v] = 0;
      if (first_[v] == first_[v + 1]) return;
      std::uint32_t low = (corners_[first_[v]] / 3) >> kBlockBits;
      std::uint32_t high = (corners_[first_[v + 1] - 1] / 3) >> kBlockBits;
      for (; low != high; low >>= kLevelBits, high >>= kLevelBits) ++level_[v];
    });
  }
  [[nodiscard]] int level_of(const PricedEdge& edge) const {
    const auto [v, t] = edge_at(edge.slot);
    return std::max(level_[v], level_[t]);
  }

  /// Calls body(face, next, last): the other corners of each face of v, counter-clockwise.
  template <typename Body>
  void for_each_face(std::int32_t v, const Body& body) const {
    for (const std::uint32_t corner : corners(v)) {
      const std::uint32_t f = corner / 3, c = corner - 3 * f;
      const Triple& face = faces_[f];
      body(f, c, face[after(c)], face[before(c)]);
    }
  }

  // --- Quadrics ------------------------------------------------------------------------------

  /// Positions of four vertices.
  [[nodiscard]] Vectors4 positions_of(const std::int32_t* v) const {
    const auto row = [&](std::int32_t i) { return load4(&vertices_[i].x); };
    const auto [x, y, z, unused] =
        transpose(std::array{row(v[0]), row(v[1]), row(v[2]), row(v[3])});
    return {x, y, z};
  }

  static void add_plane(QuadricVertex& v, const Vector3f& n, float weight) {
    const Vector3f wn = weight * n;
    v.xx += wn.x() * n.x(), v.xy += wn.x() * n.y(), v.xz += wn.x() * n.z();
    v.yy += wn.y() * n.y(), v.yz += wn.y() * n.z(), v.zz += wn.z() * n.z();
    v.weight += weight;
  }

  /// Each plane goes through the vertex it is added to, so b and c are zero at first.
  void sum_quadrics() {
    is_open_.assign(vertices_.size(), 0);
    is_complex_.assign(vertices_.size(), 0);
    over_vertices([&](std::int32_t v) {
      if (!add_faces(v)) {
        is_open_[v] = 1;
        add_borders(v);
      }
    });
    if (std::find(is_complex_.begin(), is_complex_.end(), 1) == is_complex_.end()) {
      is_complex_.clear();
    }
    report(0.16);
  }

  /// Corners of the faces around a vertex, filled up to a multiple of four.
  struct Ring {
    static constexpr std::size_t kMost = 32;
    alignas(16) std::array<std::int32_t, kMost> next, last;  // counter-clockwise
    std::size_t size = 0;
  };

  /// Adds the planes of the faces of v. Returns whether v is inside of the surface and on no seam:
  /// each of its edges has two faces, which run along it in opposite directions, and all faces have
  /// the same wedge at v.
  bool add_faces(std::int32_t v) {
    const auto around = corners(v);
    Ring ring;  // NOLINT: filled below
    for (std::size_t begin = 0; begin < around.size(); begin += Ring::kMost) {
      const auto some = around.subspan(begin, std::min(Ring::kMost, around.size() - begin));
      ring.size = 0;
      for (const std::uint32_t corner : some) {
        const std::uint32_t f = corner / 3, c = corner - 3 * f;
        ring.next[ring.size] = faces_[f][after(c)];
        ring.last[ring.size++] = faces_[f][before(c)];
      }
      // The lanes that fill up have no area, and no edge from v.
      for (std::size_t i = ring.size; i % 4 != 0; ++i) ring.next[i] = ring.last[i] = v;
      add_planes(vertices_[v], ring);
    }
    return around.size() <= Ring::kMost && is_closed(ring) && has_one_wedge(v);
  }

  void add_planes(QuadricVertex& vertex, const Ring& ring) const {
    const Vectors4 p = four_of(position_of(vertex));
    Float4 high = load4(&vertex.xx), low = load4(&vertex.yz);
    for (std::size_t i = 0; i < ring.size; i += 4) {
      const Vectors4 n = (positions_of(&ring.next[i]) - p).cross(positions_of(&ring.last[i]) - p);
      const Float4 length = sqrt4(n.squared_norm());
      const Float4 divisor = length > 0.0F ? length : all_of(1.0F);
      const Vectors4 unit{n.x / divisor, n.y / divisor, n.z / divisor};
      const Float4 weight = length > 0.0F ? length / 6.0F : all_of(0.0F);
      const Vectors4 weighted{weight * unit.x, weight * unit.y, weight * unit.z};
      const auto upper = transpose(
          {weighted.x * unit.x, weighted.x * unit.y, weighted.x * unit.z, weighted.y * unit.y});
      const auto lower =
          transpose({weighted.y * unit.z, weighted.z * unit.z, all_of(0.0F), weight});
      for (std::size_t k = 0; k < 4; ++k) {
        high += upper[k];
        low += Float4{lower[k][0], lower[k][1], 0.0F, 0.0F};
        vertex.weight += lower[k][3];
      }
    }
    store4(&vertex.xx, high);
    store4(&vertex.yz, low);
  }

  [[nodiscard]] static bool is_closed(const Ring& ring) {
    std::uint32_t matched = 0;  // faces that end where another one begins
    bool is_open = false;
    for (std::size_t i = 0; i < ring.size; ++i) {
      const std::int32_t next = ring.next[i];
      std::uint32_t matches = 0;
      for (std::size_t j = 0; j < ring.size; j += 4) {
        matches |= true_lanes(load4(&ring.last[j]) == Int4{next, next, next, next}) << j;
      }
      is_open |= matches == 0 || (matches & (matches - 1)) != 0;
      matched |= matches;
    }
    const std::uint32_t all = ring.size > 0 ? 0xFFFFFFFFU >> (Ring::kMost - ring.size) : 0U;
    return !is_open && matched == all;
  }

  [[nodiscard]] bool has_one_wedge(std::int32_t v) const {
    if (!has_wedges()) return true;
    const auto around = corners(v);
    const auto wedge = [&](std::uint32_t corner) { return wedges_[corner / 3][corner % 3]; };
    return std::all_of(around.begin(), around.end(), [&](std::uint32_t corner) {
      return wedge(corner) == wedge(around.front());
    });
  }

  /// Planes through boundaries and seams, perpendicular to their faces.
  void add_borders(std::int32_t v) {
    struct Spoke {
      std::int32_t end;
      std::uint32_t face, corner, end_corner;
    };
    std::vector<Spoke> spokes;
    for_each_face(v, [&](std::uint32_t f, std::uint32_t c, std::int32_t a, std::int32_t b) {
      spokes.push_back({a, f, c, after(c)});
      spokes.push_back({b, f, c, before(c)});
    });
    std::sort(spokes.begin(), spokes.end(), [](const Spoke& a, const Spoke& b) {
      return a.end != b.end ? a.end < b.end : a.face < b.face;
    });
    for (std::size_t begin = 0, end = 0; begin < spokes.size(); begin = end) {
      bool is_seam = false;
      for (end = begin; end < spokes.size() && spokes[end].end == spokes[begin].end; ++end) {
        if (!has_wedges()) continue;
        const Triple &w = wedges_[spokes[end].face], &w0 = wedges_[spokes[begin].face];
        is_seam |= w[spokes[end].corner] != w0[spokes[begin].corner] ||
                   w[spokes[end].end_corner] != w0[spokes[begin].end_corner];
      }
      if (is_complex_edge(static_cast<std::int64_t>(end - begin))) is_complex_[v] = 1;
      const bool is_boundary = end - begin == 1;
      if (!is_boundary && !is_seam) continue;
      const double weight = is_boundary ? options_.boundary_weight
                                        : options_.seam_weight / static_cast<double>(end - begin);
      for (std::size_t i = begin; i < end; ++i)
        add_border(v, spokes[i].end, spokes[i].face, weight);
    }
  }

  /// Which vertices have complex edges now: a collapse makes some of its neighbours' so.
  void find_complex_edges() {
    is_complex_.resize(vertices_.size());
    over(num_vertices(), kBlock / 2, [&](std::int64_t begin, std::int64_t end) {
      std::vector<std::int32_t> ends;
      for (auto v = static_cast<std::int32_t>(begin); v < end; ++v) {
        ends.clear();
        for_each_face(v, [&](std::uint32_t, std::uint32_t, std::int32_t a, std::int32_t b) {
          ends.push_back(a), ends.push_back(b);
        });
        std::sort(ends.begin(), ends.end());
        is_complex_[v] = has_complex_edge(ends) ? 1 : 0;
        is_open_[v] |= is_complex_[v];
      }
    });
  }

  void add_border(std::int32_t v, std::int32_t t, std::uint32_t f, double weight) {
    const Triple& face = faces_[f];
    const Vector3f p = position_of(vertices_[face[0]]);
    const Vector3f normal =
        (position_of(vertices_[face[1]]) - p).cross(position_of(vertices_[face[2]]) - p);
    const Vector3f along = position_of(vertices_[t]) - position_of(vertices_[v]);
    const Vector3f across = along.cross(normal);
    const float length = across.norm();
    if (!(length > 0.0F)) return;
    add_plane(vertices_[v], across / length,
              static_cast<float>(0.5 * weight) * along.squaredNorm());
  }

  // --- Pieces --------------------------------------------------------------------------------

  /// Pieces (faces joined by vertices), if there are several: each may vanish as a whole.
  void find_pieces() {
    if (is_connected()) return;
    welded_.faces.resize(num_faces(), 3);
    for (std::size_t f = 0; f < faces_.size(); ++f) {
      welded_.faces.row(static_cast<Eigen::Index>(f)) << faces_[f][0], faces_[f][1], faces_[f][2];
    }
    if (find_components(welded_.faces, num_vertices()).count < 2) {
      welded_ = {};
      return;
    }
    welded_.vertices.resize(num_vertices(), 3);
    for (std::int32_t v = 0; v < num_vertices(); ++v) {
      welded_.vertices.row(v) = input_.vertices.row(order_.source[v]);
    }
    view_.emplace(welded_);
    pieces_.emplace(*view_, scale_, part_of(progress_, 0.16, 0.2));
    count_faces();
    piece_weight_.assign(pieces_->size(), 0.0);
    for (std::int32_t v = 0; v < num_vertices(); ++v) {
      const std::int32_t piece = pieces_->of_vertex(v);
      if (piece >= 0) piece_weight_[piece] += vertices_[v].weight;
    }
    is_kept_.assign(pieces_->size(), 0);
    for (std::size_t v = 0; v < is_locked_.size(); ++v) {
      const std::int32_t piece = pieces_->of_vertex(static_cast<std::int32_t>(v));
      if (is_locked_[v] != 0 && piece >= 0) is_kept_[piece] = 1;
    }
  }

  /// Whether all vertices hang together: quicker than find_components(), but one without a face,
  /// or whose faces have no area, counts as a part of its own.
  [[nodiscard]] bool is_connected() const {
    SharedUnionFind sets(num_vertices());
    over(num_faces(), kBlock, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t f = begin; f < end; ++f) {
        sets.join(faces_[f][0], faces_[f][1]);
        sets.join(faces_[f][1], faces_[f][2]);
      }
    });
    return sets.num_sets() < 2;
  }

  /// Counts the faces of the pieces, and those of which nothing but the whole piece can go.
  void count_faces() {
    std::vector<std::int64_t>& count = faces_of_piece_;
    count.assign(pieces_->size(), 0);
    for (const Triple& face : faces_) ++count[piece_of(face)];
    num_spent_ = 0;
    for (std::int32_t i = 0; i < pieces_->size(); ++i) {
      pieces_->remove_faces(i, pieces_->num_faces(i) - count[i]);
      if (count[i] == 1 || count[i] == kFacesOfTetrahedron) num_spent_ += count[i];
    }
  }

  /// Whether no edge of the piece of a face can collapse: it is a triangle or a tetrahedron. Their
  /// edges are as cheap as they are short, and thousands of them would be all candidates of a pass.
  [[nodiscard]] bool is_spent(const Triple& face) const {
    const std::int64_t count = faces_of_piece_[piece_of(face)];
    return count == 1 || (count == kFacesOfTetrahedron && is_open_[face[0]] == 0);
  }

  [[nodiscard]] std::int32_t piece_of(const Triple& face) const {
    return pieces_->of_vertex(id_[face[0]]);
  }

  /// In the unit of the collapses' prices: squared distance times the weight of planes (area, and
  /// that of boundaries and seams), per two faces.
  [[nodiscard]] double piece_price(std::int32_t i) const {
    const double distance = pieces_->mean_distance(i);
    const double price = (kFastPieceFactor - 1.0) * pieces_->cost(i) * distance +
                         piece_weight_[i] * distance * distance;
    return price * 2.0 / static_cast<double>(pieces_->num_faces(i));
  }

  /// Which pieces remove_pieces() takes.
  enum class Choice : std::uint8_t {
    kCheap,     // those below the limit that do not go beyond the target
    kNear,      // the cheapest that are not missed at once and do not go beyond the target
    kCheapest,  // the cheapest, whatever they cost, that do not go beyond the target
    kAny,       // one, even if less is left than the target asks for
  };

  /// Takes away the pieces that cost least; how many faces that were.
  std::int64_t remove_pieces(double limit, Choice choice) {
    if (!pieces_) return 0;
    const bool is_forced = choice != Choice::kCheap;
    count_faces();
    std::vector<std::int64_t>& count = faces_of_piece_;
    using Priced = std::pair<double, std::int32_t>;
    std::priority_queue<Priced, std::vector<Priced>, std::greater<>> queue;
    for (std::int32_t i = 0; i < pieces_->size(); ++i) {
      if (!pieces_->is_there(i) || is_kept_[i] != 0) continue;
      const double price = piece_price(i);
      if (std::isfinite(price) && (price <= limit || is_forced)) queue.emplace(price, i);
    }
    std::int64_t gone = 0;
    std::vector<std::uint8_t> is_gone(pieces_->size(), 0);
    while (!queue.empty()) {
      const std::int32_t i = queue.top().second;
      queue.pop();
      const std::int64_t needed = num_faces() - gone - options_.target_faces;
      if (needed <= 0) break;
      if (count[i] > needed && choice != Choice::kAny) continue;
      pieces_->refresh(i);
      const double now = piece_price(i);
      if (!std::isfinite(now)) continue;
      if (now > limit) {
        if (!is_forced || (choice == Choice::kAny && gone > 0)) continue;
        if (!queue.empty() && now > queue.top().first) {  // what lay beside it is gone
          queue.emplace(now, i);
          continue;
        }
      }
      if (choice == Choice::kNear && pieces_->mean_distance(i) > kMissedDistance) continue;
      const double error = scale_ * pieces_->mean_distance(i);
      if (error > options_.max_error) {
        ++result_.rejected[static_cast<std::size_t>(Rejection::kErrorLimit)];
        continue;
      }
      piece_error_ = std::max(piece_error_, error);
      gone += count[i];
      pieces_->remove_faces(i, count[i]);
      if (count[i] == 1 || count[i] == kFacesOfTetrahedron) num_spent_ -= count[i];
      is_gone[i] = 1;
      ++result_.removed_pieces;
    }
    if (gone == 0) return 0;
    keep_faces([&](std::int32_t f) { return is_gone[piece_of(faces_[f])] == 0; });
    return gone;
  }

  // --- A pass --------------------------------------------------------------------------------

  /// Makes the cheapest collapses; false when nothing is left that may be done.
  bool pass() {
    const std::int64_t needed = num_faces() - options_.target_faces;
    prepare_workers();
    price_edges();
    std::int64_t num_too_dear = 0;
    const std::uint32_t limit = find_limit(needed, num_too_dear);
    limit_ = is_everything_ ? kDearest : limit;
    visible_ = visible_price();
    remap_.resize(vertices_.size());
    is_taken_.assign(vertices_.size(), 0);
    if (is_small()) is_beside_.assign(vertices_.size(), 0);
    refusals_.assign(vertices_.size(), 0);
    over_vertices([&](std::int32_t v) { remap_[v] = v; });
    find_levels();
    gather_candidates(limit);
    // With flips allowed some faces double others and go too: the target is neared by halves.
    const std::int64_t quota =
        rules_ == Rules::kFlips ? (needed + 1) / 2 : std::min(needed, 2 * wanted_);
    const std::int64_t made = collapse_candidates(quota);
    if (rules_ != Rules::kAll) result_.relaxed_collapses += made;
    const bool meets_forbidden = any_meets_forbidden();
    if (made > 0) compact();
    const double price_limit = std::bit_cast<float>(std::min(limit, kDearest));
    const std::int64_t vanished = remove_pieces(is_everything_ ? 0.0 : price_limit, Choice::kCheap);
    if (meets_forbidden) {
      rules_ = Rules::kAnyEdges;
      return true;
    }
    if (made > 0 && workers_.front().front().leaves_dear) return true;  // a small pass: one block
    if (vanished > 0 || 4 * made >= wanted_) {
      if (4 * made >= 3 * wanted_) patience_ = std::max(1.0, 0.5 * patience_);
      return true;
    }
    // Too few of the candidates were legal: more of them next time, then other rules.
    if (!is_everything_) {
      patience_ *= 4.0;
      return true;
    }
    if (made > needed / 1000) return true;  // fewer: what is left is not worth a pass each
    if (num_too_dear > 0) count(Rejection::kErrorLimit) += num_too_dear;
    if (options_.target_faces > 0 && count(Rejection::kErrorLimit) == 0) {
      const Choice choice = rules_ == Rules::kFlips ? Choice::kCheapest : Choice::kNear;
      if (remove_pieces(0.0, choice) > 0) return true;
      if (rules_ != Rules::kFlips) {
        rules_ = rules_ == Rules::kAll ? Rules::kAnyEdges : Rules::kFlips;
        return true;
      }
      if (made == 0 && remove_pieces(0.0, Choice::kAny) > 0) return true;
    }
    return made > 0;
  }

  /// Whether a block left what is legal because something that the link rule refuses costs far
  /// less: a part with many holes keeps them at the price of its shape otherwise.
  [[nodiscard]] bool any_meets_forbidden() const {
    return std::any_of(workers_.begin(), workers_.end(), [](const auto& level) {
      return std::any_of(level.begin(), level.end(),
                         [](const Worker& worker) { return worker.meets_forbidden; });
    });
  }

  /// The price of an error that can be seen, if the link rule may be waived at all.
  [[nodiscard]] std::uint32_t visible_price() {
    if (rules_ != Rules::kAll || options_.target_faces == 0) return kNoEdge;
    if (squared_limit_ < std::numeric_limits<float>::infinity()) return kNoEdge;
    if (!(whole_weight_ > 0.0)) {  // collapses add up the weights of their ends
      for (const QuadricVertex& v : vertices_) whole_weight_ += v.weight;
    }
    const double price =
        kVisibleDistance * kVisibleDistance * whole_weight_ / static_cast<double>(num_faces());
    return key_of(static_cast<float>(price));
  }

  [[nodiscard]] std::int64_t& count(Rejection reason) {
    return result_.rejected[static_cast<std::size_t>(reason)];
  }

  /// Each edge once: in a closed surface from the lower vertex to the higher one.
  [[nodiscard]] bool is_priced_here(std::int32_t from, std::int32_t to) const {
    return (from < to) | ((is_open_[from] & is_open_[to]) != 0);
  }

  /// Makes all edges the candidates of their blocks.
  void price_edges() {
    constexpr std::int64_t kFaces = 256;  // so many that their edges stay in the nearest cache
    over_blocks([&](std::int64_t block, std::int64_t begin, std::int64_t end) {
      Bulk<PricedEdge>& edges = workers_[0][block].candidates;
      edges.clear();
      edges.reserve(2 * (end - begin));               // three for two faces, more where it is open
      std::array<SlotWithEnds, 3 * kFaces + 3> here;  // NOLINT: filled below
      for (std::int64_t f = begin; f < end;) {
        std::size_t count = 0;
        for (const std::int64_t stop = std::min(end, f + kFaces); f < stop; ++f) {
          if (num_spent_ > 0 && is_spent(faces_[f])) continue;
          for (std::uint32_t c = 0; c < 3; ++c) {
            const std::int32_t a = faces_[f][c], b = faces_[f][after(c)];
            here[count] = {static_cast<std::uint32_t>(3 * f) + c, std::min(a, b), std::max(a, b)};
            count += static_cast<std::size_t>(is_priced_here(a, b));
          }
        }
        if (count == 0) continue;
        for (std::size_t i = count; i % 4 != 0; ++i) here[i] = here[count - 1];
        const std::size_t first = edges.size();
        edges.resize(first + count + 3);
        for (std::size_t i = 0; i < count; i += 4) price_four(&here[i], &edges[first + i]);
        edges.resize(first + count);
      }
    });
  }

  /// Prices four edges.
  void price_four(const SlotWithEnds* from, PricedEdge* to) const {
    const auto four = [&](std::int32_t SlotWithEnds::* end) {
      const auto of = [&](std::size_t i) -> const QuadricVertex* {
        return &vertices_[from[i].*end];
      };
      return transpose(std::array{of(0), of(1), of(2), of(3)});
    };
    const EdgeQuadric<Float4> edge(four(&SlotWithEnds::v), four(&SlotWithEnds::t));
    const Float4 value = edge.value(edge.ux, edge.uy, edge.uz);
    const Int4 too_dear = value > squared_limit_ * edge.weight;
    const Int4 keys = (too_dear & bits_of(kTooDear)) | (~too_dear & keys_of(edge.price(value)));
    for (std::size_t i = 0; i < 4; ++i) {
      to[i] = {static_cast<std::uint32_t>(keys[i]), from[i].slot};
    }
  }

  /// The price up to which edges are candidates of this pass, from a histogram of all.
  std::uint32_t find_limit(std::int64_t needed, std::int64_t& num_too_dear) {
    constexpr int kShift = 18;  // five bits of the mantissa
    constexpr std::size_t kBins = std::size_t{1} << (32 - kShift);
    // Each slice has a histogram of its own, which is as much work as 16 thousand edges.
    const std::int64_t num_slices = std::clamp<std::int64_t>(num_blocks() / 4, 1, 8);
    const std::int64_t slice =
        std::max<std::int64_t>(1, (num_blocks() + num_slices - 1) / num_slices);
    histogram_.assign(num_slices * kBins, 0);
    over(num_blocks(), slice, [&](std::int64_t begin, std::int64_t end) {
      std::uint32_t* bins = histogram_.data() + begin / slice * static_cast<std::int64_t>(kBins);
      for (std::int64_t block = begin; block < end; ++block) {
        for (const PricedEdge& edge : workers_[0][block].candidates) ++bins[edge.key >> kShift];
      }
    });
    for (std::size_t i = kBins; i < histogram_.size(); ++i) {
      histogram_[i % kBins] += histogram_[i];
    }
    num_too_dear = 0;
    if (squared_limit_ < std::numeric_limits<float>::infinity()) {
      for (const Worker& worker : workers_[0]) {
        num_too_dear += std::count_if(worker.candidates.begin(), worker.candidates.end(),
                                      [](const PricedEdge& edge) { return edge.key == kTooDear; });
      }
    }
    const double share = (is_small() ? kShareOfSmallPass : kShareOfPass) *
                         static_cast<double>(num_faces() - num_spent_) / 2.0;
    wanted_ = std::max<std::int64_t>(
        1, static_cast<std::int64_t>(std::min(0.5 * static_cast<double>(needed), share)));
    const double most =
        patience_ * (is_small() ? kSmallCandidates : kCandidates) * static_cast<double>(wanted_);
    double sum = 0.0;
    is_everything_ = true;
    std::uint32_t limit = kDearest;
    for (std::size_t bin = 0; bin <= (kDearest >> kShift); ++bin) {
      sum += histogram_[bin];
      if (sum < most || bin == (kDearest >> kShift)) continue;
      is_everything_ = false;
      limit = static_cast<std::uint32_t>(((bin + 1) << kShift) - 1);
      break;
    }
    return limit;
  }

  [[nodiscard]] std::array<std::int32_t, 2> edge_at(std::uint32_t slot) const {
    const Triple& face = faces_[slot / 3];
    const std::uint32_t c = slot % 3;
    const std::int32_t a = face[c], b = face[after(c)];
    return {std::min(a, b), std::max(a, b)};
  }

  /// Sorts the edges below the limit in each block of faces: those inside it, and those that wait.
  void gather_candidates(std::uint32_t limit) {
    const bool is_one = num_blocks() == 1;
    over_blocks([&](std::int64_t block, std::int64_t, std::int64_t) {
      Worker& worker = workers_[0][block];
      Bulk<PricedEdge>& candidates = worker.candidates;
      std::size_t count = 0;
      for (const PricedEdge edge : candidates) {
        candidates[count] = edge;
        count += static_cast<std::size_t>(edge.key <= limit);
      }
      candidates.resize(count);
      if (!is_one) {
        std::erase_if(candidates, [&](const PricedEdge& edge) {
          const bool waits = level_of(edge) > 0;
          if (waits) worker.waiting.push_back(edge);
          return waits;
        });
      }
      sort_candidates(candidates, worker.sorted);
    });
  }

  /// The same of a block of a higher level, from what waits in its blocks of the level below.
  void gather_waiting(int level) {
    const auto below = static_cast<std::int64_t>(workers_[level - 1].size());
    over(num_blocks(level), 1, [&](std::int64_t block, std::int64_t) {
      Worker& worker = workers_[level][block];
      const std::int64_t begin = block << kLevelBits, end = (block + 1) << kLevelBits;
      for (std::int64_t b = begin; b < std::min(end, below); ++b) {
        for (const PricedEdge& edge : workers_[level - 1][b].waiting) put(edge, worker);
      }
      sort_candidates(worker.candidates, worker.sorted);
    });
  }

  void put(const PricedEdge& edge, Worker& worker) const {
    (level_of(edge) <= worker.level ? worker.candidates : worker.waiting).push_back(edge);
  }

  /// A worker for each block of each level, without candidates.
  void prepare_workers() {
    const int top = top_level();
    if (workers_.size() <= static_cast<std::size_t>(top)) workers_.resize(top + 1);
    for (int level = 0; level < static_cast<int>(workers_.size()); ++level) {
      if (workers_[level].size() < static_cast<std::size_t>(num_blocks(level))) {
        workers_[level].resize(num_blocks(level));
      }
      for (Worker& worker : workers_[level]) {
        worker.level = level;
        worker.candidates.clear();
        worker.waiting.clear();
        worker.removed = worker.collapses = 0;
        worker.leaves_dear = false;
        worker.forbids = kNoEdge;
        worker.meets_forbidden = false;
      }
    }
  }

  /// Level after level; returns how many collapses were made. A block of a level works by itself:
  /// an edge inside it touches only faces and vertices of its own.
  std::int64_t collapse_candidates(std::int64_t quota) {
    std::int64_t removed = 0, collapses = 0;
    const int top = top_level();
    for (int level = 0; level <= top; ++level) {
      if (level > 0) gather_waiting(level);
      share_out(quota - removed, level, level == top);
      over(num_blocks(level), 1, [&](std::int64_t block, std::int64_t) {
        Worker& worker = workers_[level][block];
        if (worker.quota > 0) {
          collapse_in_order(worker.candidates, worker, worker.quota, level == top);
        }
      });
      for (const Worker& worker : workers_[level]) {
        removed += worker.removed;
        collapses += worker.collapses;
      }
    }
    return collapses;
  }

  /// Says how many faces each block of a level may remove: its share, by its candidates. More would
  /// leave nothing for the edges between blocks.
  void share_out(std::int64_t needed, int level, bool is_top) {
    std::int64_t all = 0;
    for (const Worker& worker : workers_[level]) {
      all += static_cast<std::int64_t>(worker.candidates.size() + worker.waiting.size());
    }
    const bool few = needed < 64 * num_blocks(level);
    for (Worker& worker : workers_[level]) {
      if (is_top) {
        worker.quota = needed;
      } else if (few || all == 0) {
        worker.quota = 0;
        worker.waiting.insert(worker.waiting.end(), worker.candidates.begin(),
                              worker.candidates.end());
      } else {
        worker.quota = static_cast<std::int64_t>(static_cast<double>(needed) *
                                                 static_cast<double>(worker.candidates.size()) /
                                                 static_cast<double>(all));
      }
    }
  }

  void collapse_in_order(const Bulk<PricedEdge>& candidates, Worker& worker, std::int64_t quota,
                         bool may_exceed) {
    const float slack = is_small() ? 1.0F : kLeap;
    worker.most = std::max(limit_, key_of(slack * std::bit_cast<float>(limit_)));
    bool has_waiting = !is_small();
    const auto wait = [&](const EdgeInReach& candidate) {
      if (std::exchange(has_waiting, true)) return;
      worker.most = std::min(limit_, key_of(kOvertakes * std::bit_cast<float>(candidate.key)));
    };
    std::vector<EdgeInReach>& near = worker.in_reach;
    near.clear();
    std::size_t next = 0, i = 0;
    while (worker.removed < quota) {
      if (i == near.size()) {
        if (next == candidates.size()) break;
        next = find_in_reach(candidates, next, near);
        i = 0;
        continue;
      }
      prefetch(near, i);
      const EdgeInReach candidate = near[i++];
      const auto [key, v, t] = candidate;
      if (is_taken_[v] != 0 || is_taken_[t] != 0) {
        wait(candidate);
        continue;
      }
      if (is_hub(v) || is_hub(t)) continue;
      if (is_small() && key > worker.most && worker.collapses > 0) {
        worker.leaves_dear = true;
        break;
      }
      if (key > worker.forbids) {
        worker.meets_forbidden = true;
        break;
      }
      const std::int64_t left =
          may_exceed ? std::numeric_limits<std::int64_t>::max() : quota - worker.removed;
      if (const auto reason = collapse(v, t, worker, left)) {
        ++worker.rejected[static_cast<std::size_t>(*reason)];
        if (*reason == Rejection::kLink) {
          const float price = kFarCheaperSquared * std::bit_cast<float>(key);
          worker.forbids = std::min(worker.forbids, std::max(visible_, key_of(price)));
        }
        if (refusals_[v] < 0xFFFFU) ++refusals_[v];
        if (refusals_[t] < 0xFFFFU) ++refusals_[t];
        if (is_small() && (is_beside_[v] != 0 || is_beside_[t] != 0)) wait(candidate);
      } else if (is_small() && is_taken_[v] != 0) {
        for (const Fan* fan : {&worker.first, &worker.second}) {
          for (const auto& [a, b] : fan->rest) is_beside_[a] = is_beside_[b] = 1;
        }
      }
    }
  }

  /// The next candidates, in order; of a large pass only those whose ends have not collapsed yet,
  /// which are found without a jump for each. Returns where the rest begins.
  std::size_t find_in_reach(const Bulk<PricedEdge>& candidates, std::size_t begin,
                            std::vector<EdgeInReach>& near) const {
    constexpr std::size_t kAtOnce = 64;
    const std::size_t end = std::min(candidates.size(), begin + kAtOnce);
    for (std::size_t i = end; i < std::min(candidates.size(), end + kAtOnce); ++i) {
      __builtin_prefetch(&faces_[candidates[i].slot / 3]);
    }
    const bool is_any = is_small();
    near.resize(end - begin);
    std::size_t count = 0;
    for (std::size_t i = begin; i < end; ++i) {
      const auto [v, t] = edge_at(candidates[i].slot);
      near[count] = {candidates[i].key, v, t};
      count += static_cast<std::size_t>(is_any | ((is_taken_[v] | is_taken_[t]) == 0));
    }
    near.resize(count);
    return end;
  }

  /// Asks the memory for what the next candidates will touch: they lie anywhere in the block.
  void prefetch(const std::vector<EdgeInReach>& candidates, std::size_t i) const {
    constexpr std::size_t kSoon = 2, kLater = 4;
    if (i + kLater < candidates.size()) {
      for (const std::int32_t v : {candidates[i + kLater].v, candidates[i + kLater].t}) {
        __builtin_prefetch(&vertices_[v]);
        __builtin_prefetch(&corners_[first_[v]]);
      }
    }
    if (i + kSoon < candidates.size()) {
      for (const std::int32_t v : {candidates[i + kSoon].v, candidates[i + kSoon].t}) {
        const auto around = corners(v);
        for (const std::uint32_t corner : around.first(std::min<std::size_t>(around.size(), 8))) {
          __builtin_prefetch(&faces_[corner / 3]);
        }
      }
    }
  }

  [[nodiscard]] bool is_hub(std::int32_t v) const {
    return static_cast<std::int64_t>(corners(v).size()) * refusals_[v] > kHubPatience;
  }

  // --- A collapse ----------------------------------------------------------------------------

  /// The faces of v as they are now: of those that collapsed before in this pass, what is left.
  void gather(std::int32_t v, std::int32_t other, Fan& fan) const {
    fan.rest.resize(corners(v).size());
    fan.across.resize(corners(v).size());
    // Each face is written to both lists, and one goes on, or none: nothing to guess for the
    // processor.
    std::size_t num_rest = 0, num_across = 0;
    for_each_face(v, [&](std::uint32_t, std::uint32_t, std::int32_t a, std::int32_t b) {
      const std::int32_t x = remap_[a], y = remap_[b];
      const bool is_across = x == other || y == other, is_there = x != y;
      fan.across[num_across] = x == other ? y : x;
      fan.rest[num_rest] = {x, y};
      num_across += static_cast<std::size_t>(is_there && is_across);
      num_rest += static_cast<std::size_t>(is_there && !is_across);
    });
    fan.rest.resize(num_rest);
    fan.across.resize(num_across);
  }

  std::optional<Rejection> collapse(std::int32_t v, std::int32_t t, Worker& worker,
                                    std::int64_t quota) {
    Fan &first = worker.first, &second = worker.second;
    gather(v, t, first);
    gather(t, v, second);
    if (first.across.empty()) return std::nullopt;
    const bool is_doubling = may_double_faces(rules_, has_complex_edge_at(v, t, worker));
    const auto num_gone =
        static_cast<std::int64_t>(first.across.size()) + (is_doubling ? count_doubles(worker) : 0);
    if (num_gone > quota) return std::nullopt;  // another one may fit
    if (first.rest.empty() && second.rest.empty()) return Rejection::kDegenerate;
    if (takes_last_face_of_locked(v, t, first, worker)) return Rejection::kDegenerate;
    if (!is_doubling) {
      if (const auto reason = check_links(v, t, first, second)) return reason;
    }
    const EdgeQuadric<float> edge(vertices_[v], vertices_[t]);
    Vector3f offset(edge.ux, edge.uy, edge.uz);
    const bool is_first_fixed = is_locked(v), is_second_fixed = is_locked(t);
    if (is_first_fixed && is_second_fixed) return Rejection::kComplexVertex;
    const Vector3f to_second(edge.dx, edge.dy, edge.dz);
    if (is_first_fixed) offset.setZero();
    if (is_second_fixed) offset = to_second;
    auto reason = check_place(v, t, offset, edge, first, second);
    // Far from its edge a vertex has the planes there behind it, and the quadric does not say so.
    if ((offset - 0.5F * to_second).squaredNorm() > kFarthest * to_second.squaredNorm()) {
      reason = Rejection::kFlip;
    }
    if (reason && !is_first_fixed && !is_second_fixed) {
      Vector3f other = to_second, third = Vector3f::Zero();
      if (edge.value(0.0F, 0.0F, 0.0F) < edge.value(edge.dx, edge.dy, edge.dz)) {
        std::swap(other, third);
      }
      for (const Vector3f& place : {other, third}) {
        if (!reason ||
            key_of(edge.price(edge.value(place.x(), place.y(), place.z()))) > worker.most ||
            check_place(v, t, place, edge, first, second)) {
          continue;
        }
        offset = place;
        reason.reset();
      }
    }
    if (reason) return reason;
    apply(v, t, offset, edge, worker);
    if (is_doubling) {
      worker.doubling.push_back(v);
      for (const auto& [a, b] : worker.twins) worker.twin_faces.push_back({v, a, b});
    }
    worker.removed += num_gone;
    ++worker.collapses;
    return std::nullopt;
  }

  [[nodiscard]] bool is_locked(std::int32_t v) const {
    return !is_locked_.empty() && is_locked_[id_[v]] != 0;
  }

  /// Whether a locked vertex may have no faces but those on the edge, which go. While blocks work
  /// at the same time, nobody knows what becomes of its faces in other blocks.
  [[nodiscard]] bool takes_last_face_of_locked(std::int32_t v, std::int32_t t, const Fan& first,
                                               const Worker& worker) const {
    if (is_locked_.empty()) return false;
    return std::any_of(first.across.begin(), first.across.end(), [&](std::int32_t w) {
      if (!is_locked(w)) return false;
      if (level_[w] > worker.level) return true;
      bool stays = false;
      for_each_face(w, [&](std::uint32_t, std::uint32_t, std::int32_t a, std::int32_t b) {
        const std::int32_t x = remap_[a], y = remap_[b];
        const bool is_on_edge = (x == v && y == t) || (x == t && y == v);
        stays = stays || (x != y && x != w && y != w && !is_on_edge);
      });
      return !stays;
    });
  }

  /// Whether v or t, whose fans were gathered, has an edge of three faces or more.
  [[nodiscard]] bool has_complex_edge_at(std::int32_t v, std::int32_t t, Worker& worker) const {
    if (is_complex_.empty() || (is_complex_[v] == 0 && is_complex_[t] == 0)) return false;
    const Fan &first = worker.first, &second = worker.second;
    if (is_complex_edge(static_cast<std::int64_t>(first.across.size()))) return true;
    for (const Fan* fan : {&first, &second}) {
      worker.ends.assign(fan->across.begin(), fan->across.end());
      fan->append_ends(worker.ends);
      if (has_complex_edge(worker.ends)) return true;
    }
    return false;
  }

  /// How many faces around v and t lie on the vertices of others when v and t are one. Finds the
  /// twins among them.
  [[nodiscard]] static std::int64_t count_doubles(Worker& worker) {
    std::vector<Side>&sides = worker.sides, &twins = worker.twins;
    twins.clear();
    for (const Fan* fan : {&worker.first, &worker.second}) {
      sides.assign(fan->rest.begin(), fan->rest.end());
      append_twins(sides, twins);
    }
    std::sort(twins.begin(), twins.end());
    sides.clear();
    for (const Fan* fan : {&worker.first, &worker.second}) {
      for (const Side& side : fan->rest) sides.push_back(double_key(side, twins));
    }
    std::sort(sides.begin(), sides.end());
    return sides.end() - std::unique(sides.begin(), sides.end());
  }

  /// The first rule of collapse_rules.hpp about edges and faces around v and t that is broken.
  [[nodiscard]] std::optional<Rejection> check_links(std::int32_t v, std::int32_t t,
                                                     const Fan& first, const Fan& second) const {
    const auto is_across = [&](std::int32_t w) {
      return std::find(first.across.begin(), first.across.end(), w) != first.across.end();
    };
    const bool is_simple = is_open_[v] == 0 && is_open_[t] == 0;
    const bool is_long = first.rest.size() * second.rest.size() > 4096;
    if (is_long) return check_long_links(first, second);
    if (is_simple && rules_ == Rules::kAll && keeps_closed_links(first, second)) {
      return std::nullopt;
    }
    for (const auto& [a, b] : first.rest) {
      const bool across_a = is_across(a);
      for (const auto& [x, y] : second.rest) {
        if ((x == a && y == b) || (x == b && y == a)) return Rejection::kDuplicate;
        if (rules_ != Rules::kAll) continue;
        if (is_simple) {
          if (a == x && !across_a) return Rejection::kLink;
        } else if (((a == x || a == y) && makes_complex_edge_at(a, first, second)) ||
                   ((b == x || b == y) && makes_complex_edge_at(b, first, second))) {
          return Rejection::kLink;
        }
      }
    }
    return std::nullopt;
  }

  /// Whether check_links() finds nothing around two vertices inside of a closed surface: two sides
  /// at a time, and without a jump, for it mostly finds nothing.
  [[nodiscard]] static bool keeps_closed_links(const Fan& first, const Fan& second) {
    const std::size_t size = second.rest.size();
    unsigned broken = 0;
    for (const auto& [a, b] : first.rest) {
      bool is_across = false;
      for (const std::int32_t w : first.across) is_across |= w == a;
      const unsigned links = is_across ? 0U : ~0U;
      const Int4 along{a, b, a, b}, against{b, a, b, a};
      for (std::size_t i = 0; i < size; i += 2) {
        const Side &one = second.rest[i], &two = second.rest[std::min(i + 1, size - 1)];
        const Int4 sides{one[0], one[1], two[0], two[1]};
        const unsigned same = true_lanes(sides == along), turned = true_lanes(sides == against);
        broken |= (same & (same >> 1)) | (turned & (turned >> 1)) | (same & links);
      }
    }
    return (broken & 0b0101U) == 0;
  }

  [[nodiscard]] static std::int64_t count_faces(std::int32_t w, const Fan& fan) {
    std::int64_t faces = 0;
    for (const auto& [a, b] : fan.rest) faces += a == w || b == w ? 1 : 0;
    return faces;
  }

  /// The faces v t w go; the other ones on v w and on t w meet on one edge.
  [[nodiscard]] static bool makes_complex_edge_at(std::int32_t w, const Fan& first,
                                                  const Fan& second) {
    const std::int64_t across = std::count(first.across.begin(), first.across.end(), w);
    const std::int64_t one = count_faces(w, first), two = count_faces(w, second);
    return makes_complex_edge(one + across, two + across, across);
  }

  /// The same for vertices with very many faces, by sorting.
  [[nodiscard]] std::optional<Rejection> check_long_links(const Fan& first,
                                                          const Fan& second) const {
    std::vector<Side> s1, s2;
    first.append_sides(s1);
    second.append_sides(s2);
    for (const auto& side : s1) {
      if (std::binary_search(s2.begin(), s2.end(), side)) return Rejection::kDuplicate;
    }
    if (rules_ != Rules::kAll) return std::nullopt;
    std::vector<std::int32_t> e1, e2;
    first.append_ends(e1);
    second.append_ends(e2);
    std::vector<std::int32_t> across(first.across.begin(), first.across.end());
    std::sort(across.begin(), across.end());
    const auto count_in = [](const std::vector<std::int32_t>& sorted, std::int32_t w) {
      const auto [low, high] = std::equal_range(sorted.begin(), sorted.end(), w);
      return static_cast<std::int64_t>(high - low);
    };
    for (auto w = e1.begin(); w != e1.end(); w = std::upper_bound(w, e1.end(), *w)) {
      const std::int64_t one = count_in(e1, *w), two = count_in(e2, *w),
                         gone = count_in(across, *w);
      if (makes_complex_edge(one + gone, two + gone, gone)) return Rejection::kLink;
    }
    return std::nullopt;
  }

  /// Whether the new vertex may lie at `offset` from v:
  ///   a face would lose its area                                kDegenerate
  ///   a face would turn by more than 78 degrees                 kFlip
  ///   the error would be above max_error                        kErrorLimit
  [[nodiscard]] std::optional<Rejection> check_place(std::int32_t v, std::int32_t t,
                                                     const Vector3f& offset,
                                                     const EdgeQuadric<float>& edge,
                                                     const Fan& first, const Fan& second) const {
    const float value = edge.value(offset.x(), offset.y(), offset.z());
    if (!(value <= squared_limit_ * edge.weight) && value > 0.0F) return Rejection::kErrorLimit;
    if (!offset.allFinite()) return Rejection::kDegenerate;
    const Vectors4 p = four_of(position_of(vertices_[v]) + offset);
    if (const auto reason = check_faces(first, four_of(position_of(vertices_[v])), p))
      return reason;
    return check_faces(second, four_of(position_of(vertices_[t])), p);
  }

  /// The same of the faces of a fan whose vertex goes from `old` to `p`, four at a time.
  [[nodiscard]] std::optional<Rejection> check_faces(const Fan& fan, const Vectors4& old,
                                                     const Vectors4& p) const {
    const bool may_turn = may_turn_faces(rules_);
    for (std::size_t i = 0; i < fan.rest.size(); i += 4) {
      // The last face stands in for what is left out of the four.
      std::array<std::int32_t, 4> a{}, b{};
      for (std::size_t lane = 0; lane < 4; ++lane) {
        const Side& side = fan.rest[std::min(i + lane, fan.rest.size() - 1)];
        a[lane] = side[0];
        b[lane] = side[1];
      }
      const Vectors4 pa = positions_of(a.data()), pb = positions_of(b.data());
      const Vectors4 ea = pa - p, eb = pb - p;
      const Vectors4 after = ea.cross(eb), before = (pa - old).cross(pb - old);
      const Float4 area = after.squared_norm(), area_before = before.squared_norm();
      const Float4 la = ea.squared_norm(), lb = eb.squared_norm(), lc = (pb - pa).squared_norm();
      const Float4 longer = la < lb ? lb : la, longest = longer < lc ? lc : longer;
      const Float4 cosine = before.dot(after);
      const unsigned degenerate = ~true_lanes(area > kLeastSquaredSine * longest * longest) & 15U;
      const unsigned flips =
          may_turn ? 0U
                   : true_lanes(area_before > 0.0F) &
                         ~(true_lanes(cosine > 0.0F) &
                           true_lanes(cosine * cosine > kLeastSquaredCosine * area * area_before));
      if ((degenerate | flips) == 0) continue;
      const auto lane = std::countr_zero(degenerate | flips);
      return ((degenerate >> lane) & 1U) != 0 ? Rejection::kDegenerate : Rejection::kFlip;
    }
    return std::nullopt;
  }

  /// t goes into v, which has the lower index and moves.
  void apply(std::int32_t v, std::int32_t t, const Vector3f& offset, const EdgeQuadric<float>& edge,
             Worker& worker) {
    QuadricVertex& vertex = vertices_[v];
    const Vector3f old = position_of(vertex);
    const Vector3f p = old + offset;
    if (has_wedges()) merge_wedges(v, t, p, worker);
    if (!normals_.empty()) merge_normals(v, t);
    if (!colors_.empty()) merge_colors(v, t, p);
    const Vector3f u = p - old;  // what single precision made of it
    vertex.x = p.x(), vertex.y = p.y(), vertex.z = p.z();
    vertex.xx = edge.xx, vertex.xy = edge.xy, vertex.xz = edge.xz;
    vertex.yy = edge.yy, vertex.yz = edge.yz, vertex.zz = edge.zz;
    vertex.bx = edge.bx + edge.xx * u.x() + edge.xy * u.y() + edge.xz * u.z();
    vertex.by = edge.by + edge.xy * u.x() + edge.yy * u.y() + edge.yz * u.z();
    vertex.bz = edge.bz + edge.xz * u.x() + edge.yz * u.y() + edge.zz * u.z();
    vertex.c = std::max(0.0F, edge.value(u.x(), u.y(), u.z()));
    vertex.weight = edge.weight;
    if (edge.weight > 0.0F) {
      worker.squared_error = std::max(worker.squared_error, vertex.c / edge.weight);
    }
    if (is_locked(t)) {
      lock(v, t);
    } else if (!is_locked(v)) {
      is_moved_[id_[v]] = 1;
    }
    is_open_[v] |= is_open_[t];
    remap_[t] = v;
    is_taken_[v] = is_taken_[t] = 1;
    into_[id_[t]] = id_[v];
  }

  /// A locked vertex goes into one with a lower index, which takes its place.
  void lock(std::int32_t v, std::int32_t t) {
    is_locked_[id_[v]] = 1;
    is_moved_[id_[v]] = 0;
    order_.source[id_[v]] = order_.source[id_[t]];
  }

  // --- Attributes ----------------------------------------------------------------------------

  [[nodiscard]] bool has_texture(std::int32_t wedge) const { return table_.has_texture(wedge); }

  /// Each wedge of t continues as that of v across a face on the edge; the others stay. Then all
  /// get the texture coordinate that the faces around have at p.
  void merge_wedges(std::int32_t v, std::int32_t t, const Vector3f& p, Worker& worker) {
    auto& pairs = worker.wedge_pairs;
    pairs.clear();
    const auto find = [&](std::int32_t from) {
      return std::find_if(pairs.begin(), pairs.end(),
                          [&](const auto& pair) { return pair.first == from; });
    };
    for_each_face(t, [&](std::uint32_t f, std::uint32_t c, std::int32_t a, std::int32_t b) {
      const std::int32_t from = wedges_[f][c];
      if ((a != v && b != v) || remap_[a] == remap_[b] || find(from) != pairs.end()) return;
      pairs.emplace_back(from, wedges_[f][a == v ? after(c) : before(c)]);
    });
    worker.merged_wedges.clear();
    for (const std::int32_t from : {v, t}) {
      for_each_face(from, [&](std::uint32_t f, std::uint32_t c, std::int32_t, std::int32_t) {
        const std::int32_t wedge = continued(wedges_[f][c], pairs);
        auto& known = worker.merged_wedges;
        if (!has_texture(wedge) || std::find(known.begin(), known.end(), wedge) != known.end()) {
          return;
        }
        known.push_back(wedge);
      });
    }
    worker.merged_uvs.clear();
    for (const std::int32_t wedge : worker.merged_wedges) {
      worker.merged_uvs.push_back(texture_at(wedge, v, t, p, pairs));
    }
    for (std::size_t i = 0; i < worker.merged_wedges.size(); ++i) {
      table_.texcoords[worker.merged_wedges[i]] = worker.merged_uvs[i];
    }
    for (const auto& [from, to] : pairs) wedge_into_[from] = to;
  }

  using WedgePairs = std::vector<std::pair<std::int32_t, std::int32_t>>;

  [[nodiscard]] static std::int32_t continued(std::int32_t wedge, const WedgePairs& pairs) {
    for (const auto& [from, to] : pairs) {
      if (from == wedge) return to;
    }
    return wedge;
  }

  /// The texture at p of the face of this wedge that p lies over, or nearest to so; not beyond the
  /// coordinates around, for a narrow face continues to anywhere. Faces are as they were before v
  /// and t collapse.
  [[nodiscard]] Vector2d texture_at(std::int32_t wedge, std::int32_t v, std::int32_t t,
                                    const Vector3f& p, const WedgePairs& pairs) const {
    Vector2d best = table_.texcoords[wedge];
    Vector2d low = best, high = best;
    double most_inside = -std::numeric_limits<double>::infinity();
    std::optional<Vector2d> own;  // of a locked vertex: rounding would part it from its neighbours
    for (const std::int32_t from : {v, t}) {
      const Vector3d origin = position_of(vertices_[from]).cast<double>();
      for_each_face(from, [&](std::uint32_t f, std::uint32_t c, std::int32_t a, std::int32_t b) {
        const Triple& w = wedges_[f];
        if (continued(w[c], pairs) != wedge || remap_[a] == remap_[b]) return;
        const Vector2d uv = table_.texcoords[w[c]];
        if (is_locked(from)) own = uv;
        const Vector2d ua = table_.texcoords[wedge_into_[w[after(c)]]];
        const Vector2d ub = table_.texcoords[wedge_into_[w[before(c)]]];
        for (const Vector2d& s : {uv, ua, ub}) {
          low = low.cwiseMin(s);
          high = high.cwiseMax(s);
        }
        const Vector3d ea = position_of(vertices_[remap_[a]]).cast<double>() - origin;
        const Vector3d eb = position_of(vertices_[remap_[b]]).cast<double>() - origin;
        const Vector3d normal = ea.cross(eb), d = p.cast<double>() - origin;
        const double squared = normal.squaredNorm();
        if (!(squared > 0.0)) return;
        const double share_a = d.cross(eb).dot(normal) / squared;
        const double share_b = ea.cross(d).dot(normal) / squared;
        const double inside = std::min({1.0 - share_a - share_b, share_a, share_b});
        if (!(inside > most_inside)) return;
        most_inside = inside;
        best = uv + share_a * (ua - uv) + share_b * (ub - uv);
      });
    }
    return own ? *own : best.cwiseMax(low).cwiseMin(high);
  }

  /// Corners of t get the normal of v that is nearest to theirs.
  void merge_normals(std::int32_t v, std::int32_t t) {
    for_each_face(t, [&](std::uint32_t f, std::uint32_t c, std::int32_t, std::int32_t) {
      std::int32_t& normal = normals_[f][c];
      if (normal < 0) return;
      const auto own = input_.normals.row(normal);
      std::int32_t nearest = normal;
      double most = -std::numeric_limits<double>::infinity();
      for_each_face(v, [&](std::uint32_t g, std::uint32_t k, std::int32_t, std::int32_t) {
        const std::int32_t other = normals_[g][k];
        if (other < 0) return;
        const double cosine = input_.normals.row(other).dot(own);
        if (cosine > most || (cosine == most && other < nearest)) {
          most = cosine;
          nearest = other;
        }
      });
      normal = nearest;
    });
  }

  /// Between the colours of v and t, as p lies between them.
  void merge_colors(std::int32_t v, std::int32_t t, const Vector3f& p) {
    const Vector3f origin = position_of(vertices_[v]), edge = position_of(vertices_[t]) - origin;
    const float squared = edge.squaredNorm();
    const float share =
        squared > 0.0F ? std::clamp((p - origin).dot(edge) / squared, 0.0F, 1.0F) : 1.0F;
    Vector3f& color = colors_[id_[v]];
    color += share * (colors_[id_[t]] - color);
  }

  // --- Between passes ------------------------------------------------------------------------

  /// Puts the pass into effect: vertices that went are closed up, faces renumbered, those without
  /// area left out.
  void compact() {
    close_up_vertices();
    std::vector<std::int64_t>& kept = kept_of_block_;
    kept.assign(num_blocks(), 0);
    over_blocks([&](std::int64_t block, std::int64_t begin, std::int64_t end) {
      std::int64_t to = begin;
      for (std::int64_t f = begin; f < end; ++f) {
        Triple face = faces_[f];
        for (std::int32_t& v : face) v = remap_[v];
        if (is_degenerate(face)) continue;
        faces_[to] = face;
        face_ids_[to] = face_ids_[f];
        if (has_wedges()) {
          Triple wedges = wedges_[f];
          for (std::int32_t& w : wedges) w = wedge_into_[w];
          wedges_[to] = wedges;
        }
        if (!normals_.empty()) normals_[to] = normals_[f];
        ++to;
      }
      kept[block] = to - begin;
    });
    const std::int64_t count = close_up(kept, kBlock, faces_, face_ids_, wedges_, normals_);
    resize_faces(count);
    remove_double_faces();
  }

  /// Puts together what chunks kept of their rows, each at its beginning; tables without rows stay
  /// so. Changes `kept` to where each chunk begins then, and returns how many rows there are.
  template <typename... Tables>
  static std::int64_t close_up(std::vector<std::int64_t>& kept, std::int64_t chunk,
                               Tables&... tables) {
    std::int64_t from = 0, to = 0;
    for (std::int64_t& length : kept) {
      const auto close_up_table = [&](auto& rows) {
        if (!rows.empty() && from != to) {
          std::copy_n(rows.begin() + from, length, rows.begin() + to);
        }
      };
      (close_up_table(tables), ...);
      from += chunk;
      to += std::exchange(length, to);
    }
    return to;
  }

  /// The vertices that stay; remap_ says where all are then.
  void close_up_vertices() {
    constexpr std::int64_t kChunk = kBlock / 2;
    std::vector<std::int64_t>& start = kept_of_block_;
    start.assign((num_vertices() + kChunk - 1) / kChunk, 0);
    number_.resize(num_vertices());  // in its chunk
    over(num_vertices(), kChunk, [&](std::int64_t begin, std::int64_t end) {
      std::int64_t to = begin;
      for (std::int64_t v = begin; v < end; ++v) {
        if (remap_[v] != v) continue;
        number_[v] = static_cast<std::int32_t>(to - begin);
        vertices_[to] = vertices_[v];
        id_[to] = id_[v];
        is_open_[to++] = is_open_[v];
      }
      start[begin / kChunk] = to - begin;
    });
    const std::int64_t count = close_up(start, kChunk, vertices_, id_, is_open_);
    over_vertices([&](std::int32_t v) {
      const std::int32_t kept = remap_[v];
      remap_[v] = static_cast<std::int32_t>(start[kept / kChunk]) + number_[kept];
    });
    vertices_.resize(count);
    id_.resize(count);
    is_open_.resize(count);
  }

  /// Removes all but the first of the faces on the same three vertices, and of faces back to back
  /// all but the first on each side: around the vertices of this pass where faces may lie on
  /// others.
  void remove_double_faces() {
    is_doubling_.assign(vertices_.size(), 0);
    std::vector<Triple> twins;
    bool is_needed = false;
    for_each_worker([&](Worker& worker) {
      is_needed = is_needed || !worker.doubling.empty();
      for (const std::int32_t v : worker.doubling) is_doubling_[remap_[v]] = 1;
      for (Triple face : worker.twin_faces) {
        for (std::int32_t& v : face) v = remap_[v];
        std::sort(face.begin(), face.end());
        twins.push_back(face);
      }
      worker.doubling.clear();
      worker.twin_faces.clear();
    });
    if (!is_needed) return;
    std::sort(twins.begin(), twins.end());
    std::vector<std::pair<Triple, std::int32_t>> keys;
    for (std::size_t f = 0; f < faces_.size(); ++f) {
      const Triple& face = faces_[f];
      if (std::none_of(face.begin(), face.end(),
                       [&](std::int32_t v) { return is_doubling_[v] != 0; })) {
        continue;
      }
      Triple key = face;
      std::sort(key.begin(), key.end());
      if (std::binary_search(twins.begin(), twins.end(), key)) {
        std::rotate_copy(face.begin(), std::min_element(face.begin(), face.end()), face.end(),
                         key.begin());
      }
      keys.emplace_back(key, static_cast<std::int32_t>(f));
    }
    std::sort(keys.begin(), keys.end());
    std::vector<bool> is_double(faces_.size(), false);
    for (std::size_t i = 1; i < keys.size(); ++i) {
      if (keys[i].first != keys[i - 1].first) continue;
      is_double[keys[i].second] = true;
      for (const std::int32_t v : keys[i].first) is_open_[v] = 1;
    }
    keep_faces([&](std::int32_t f) { return !is_double[f]; });
  }

  // --- The result ----------------------------------------------------------------------------

  QualityResult finish() {
    double squared_error = 0.0;
    for_each_worker([&](const Worker& worker) {
      squared_error = std::max(squared_error, static_cast<double>(worker.squared_error));
      for (std::size_t i = 0; i < worker.rejected.size(); ++i) {
        result_.rejected[i] += worker.rejected[i];
      }
    });
    result_.max_error = std::max(piece_error_, scale_ * std::sqrt(squared_error));
    if (num_faces() <= options_.target_faces) {
      result_.stop = CollapseStop::kTargetReached;
    } else if (count(Rejection::kErrorLimit) > 0) {
      result_.stop = CollapseStop::kErrorLimit;
    } else {
      result_.stop = CollapseStop::kNoLegalCollapse;
    }
    extract();
    return std::move(result_);
  }

  void extract() {
    TriangleMesh& out = result_.mesh;
    // Vertices that some face uses, in order.
    std::vector<std::int32_t> row_of(vertices_.size(), -1);
    for (const Triple& face : faces_) {
      for (const std::int32_t v : face) row_of[v] = 0;
    }
    std::int32_t num_rows = 0;
    for (std::int32_t& row : row_of) row = row < 0 ? -1 : num_rows++;
    out.vertices.resize(num_rows, 3);
    if (!colors_.empty()) out.colors.resize(num_rows, 3);
    std::vector<std::int32_t> output(into_.size(), -1);  // of the vertices at the beginning
    for (std::int32_t v = 0; v < num_vertices(); ++v) {
      const std::int32_t row = row_of[v];
      if (row < 0) continue;
      const std::int32_t id = id_[v];
      output[id] = row;
      if (is_moved_[id] != 0) {
        out.vertices.row(row) =
            (center_ + scale_ * position_of(vertices_[v]).cast<double>()).transpose();
      } else {
        out.vertices.row(row) = input_.vertices.row(order_.source[id]);
      }
      if (!colors_.empty()) {
        out.colors.row(row) = (colors_[id].array() + 0.5F).floor().cast<std::uint8_t>().transpose();
      }
    }
    // A vertex goes into a lower one, whose end is known.
    for (std::size_t id = 0; id < into_.size(); ++id) {
      if (into_[id] >= 0) output[id] = output[into_[id]];
    }
    result_.vertex_map.resize(input_.num_vertices());
    over(input_.num_vertices(), kBlock, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t v = begin; v < end; ++v) {
        result_.vertex_map[v] = order_.rank[v] < 0 ? -1 : output[order_.rank[v]];
      }
    });
    const auto count = static_cast<Eigen::Index>(faces_.size());
    result_.face_map.assign(input_.num_faces(), -1);
    out.faces.resize(count, 3);
    if (input_.has_materials()) out.face_material.resize(count);
    for (Eigen::Index f = 0; f < count; ++f) {
      const Triple& face = faces_[f];
      out.faces.row(f) << row_of[face[0]], row_of[face[1]], row_of[face[2]];
      const std::int32_t id = face_ids_[f];
      result_.face_map[id] = static_cast<std::int32_t>(f);
      if (input_.has_materials()) out.face_material(f) = input_.face_material(id);
    }
    if (input_.has_texcoords()) extract_texcoords(out);
    if (!normals_.empty()) extract_normals(out);
  }

  /// A row for each wedge that is in use, in the order of the faces.
  void extract_texcoords(TriangleMesh& out) const {
    std::vector<std::int32_t> row_of(table_.size(), -1);
    std::vector<std::int32_t> used;
    out.face_texcoords.resize(out.faces.rows(), 3);
    for (std::size_t f = 0; f < faces_.size(); ++f) {
      for (int c = 0; c < 3; ++c) {
        const std::int32_t wedge = wedges_[f][c];
        std::int32_t& row = row_of[wedge];
        if (row < 0 && has_texture(wedge)) {
          row = static_cast<std::int32_t>(used.size());
          used.push_back(wedge);
        }
        out.face_texcoords(static_cast<Eigen::Index>(f), c) = row;
      }
    }
    if (used.empty()) out.face_texcoords.resize(0, 3);
    out.texcoords.resize(static_cast<Eigen::Index>(used.size()), 2);
    for (std::size_t i = 0; i < used.size(); ++i) {
      out.texcoords.row(static_cast<Eigen::Index>(i)) = table_.texcoords[used[i]];
    }
  }

  void extract_normals(TriangleMesh& out) const {
    std::vector<std::int32_t> row_of(input_.normals.rows(), -1);
    std::vector<std::int32_t> used;
    out.face_normals.resize(out.faces.rows(), 3);
    for (std::size_t f = 0; f < faces_.size(); ++f) {
      for (int c = 0; c < 3; ++c) {
        const std::int32_t normal = normals_[f][c];
        if (normal >= 0 && row_of[normal] < 0) {
          row_of[normal] = static_cast<std::int32_t>(used.size());
          used.push_back(normal);
        }
        out.face_normals(static_cast<Eigen::Index>(f), c) = normal < 0 ? -1 : row_of[normal];
      }
    }
    out.normals = input_.normals(used, Eigen::all);
  }

  const MeshView& input_;
  const FastOptions& options_;
  const Progress& progress_;
  BoundingBox box_;
  double scale_;
  Vector3d center_;
  SpatialOrder order_;

  Bulk<QuadricVertex> vertices_;
  std::vector<std::int32_t> id_;          // of a vertex: its number at the beginning
  std::vector<std::uint8_t> is_open_;     // of a vertex: not closed around, or with several wedges
  std::vector<std::uint8_t> is_complex_;  // of a vertex: with complex edges; empty: none
  std::vector<std::int32_t> into_;        // of a vertex at the beginning: what took it in, or -1
  std::vector<std::uint8_t> is_moved_;    // of a vertex at the beginning
  std::vector<std::uint8_t> is_locked_;   // of a vertex at the beginning; empty: none
  std::vector<Vector3f> colors_;          // of a vertex at the beginning; empty: none

  Bulk<Triple> faces_;
  Bulk<std::int32_t> face_ids_;  // of a face: row of the input
  std::vector<Triple> wedges_;   // of a face; empty: nothing to tell apart
  std::vector<Triple> normals_;  // of a face; empty: none
  WedgeTable table_;
  std::vector<std::int32_t> wedge_into_;

  std::vector<std::uint32_t> first_;  // of a vertex: where its corners begin
  Bulk<std::uint32_t> corners_;       // by vertex: 3 face + 0..2
  std::vector<std::uint32_t> histogram_;
  Bulk<std::int32_t> remap_;               // in a pass, of a vertex: what it went into
  Bulk<std::int32_t> number_;              // after a pass, of a vertex that stays: in its chunk
  std::vector<std::uint8_t> is_doubling_;  // in a pass, of a vertex left: faces may be double
  std::vector<std::uint8_t> is_taken_;     // in a pass, of a vertex: has collapsed
  std::vector<std::uint8_t> is_beside_;    // in a small pass, of a vertex: lost or got a face
  std::vector<std::uint16_t> refusals_;    // in a pass, of a vertex
  std::vector<std::int64_t> kept_of_block_;
  std::vector<std::uint8_t> level_;  // in a pass, of a vertex: where one block has all its faces
  std::vector<std::vector<Worker>> workers_;  // of a level, of a block

  TriangleMesh welded_;
  std::optional<MeshView> view_;
  std::optional<Pieces> pieces_;
  std::vector<std::int64_t> faces_of_piece_;
  std::int64_t num_spent_ = 0;         // faces of pieces that only go as a whole, at most
  std::vector<double> piece_weight_;   // of all planes of a piece, as read
  std::vector<std::uint8_t> is_kept_;  // pieces with locked vertices

  float squared_limit_ = std::numeric_limits<float>::infinity();
  double patience_ = 1.0;           // candidates for each collapse that is wanted
  std::int64_t wanted_ = 1;         // collapses of this pass
  std::uint32_t limit_ = kDearest;  // price of the candidates of this pass
  bool is_everything_ = false;      // all edges were candidates
  Rules rules_ = Rules::kAll;
  double whole_weight_ = 0.0;        // of the quadrics of all vertices
  std::uint32_t visible_ = kNoEdge;  // price of an error that can be seen
  double piece_error_ = 0.0;
  double fraction_ = 0.0;
  QualityResult result_;
};

void check_options(const MeshView& mesh, const FastOptions& options) {
  const auto check = [](const char* name, double value, bool may_be_infinite) {
    if (value >= 0.0 && (may_be_infinite || std::isfinite(value))) return;
    throw InputError(std::string(name) + ": expected a number >= 0, got " + std::to_string(value));
  };
  check("target_faces", static_cast<double>(options.target_faces), false);
  check("max_error", options.max_error, true);
  check("boundary_weight", options.boundary_weight, false);
  check("seam_weight", options.seam_weight, false);
  if (options.num_threads < 0) {
    throw InputError("num_threads: expected a number >= 0, got " +
                     std::to_string(options.num_threads));
  }
  const auto num_locked = static_cast<std::int64_t>(options.locked.size());
  if (num_locked != 0 && num_locked != mesh.num_vertices()) {
    throw InputError("locked: expected one for each vertex (" +
                     std::to_string(mesh.num_vertices()) + "), got " + std::to_string(num_locked));
  }
}

}  // namespace

QualityResult simplify_fast(const MeshView& mesh, const FastOptions& options,
                            const Progress& progress) {
  check_mesh(mesh);
  check_options(mesh, options);
  const UsualUnit usual(mesh);
  FastOptions in_unit = options;
  in_unit.max_error = usual.from_file(options.max_error);
  QualityResult result = FastSimplifier(usual.mesh(), usual.box(), in_unit, progress).run();
  usual.to_file(result.mesh.vertices);
  result.max_error = usual.to_file(result.max_error);
  return result;
}

}  // namespace manip3d
