#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "geometry/lanes.hpp"
#include "manip3d/progress.hpp"
#include "simplify/relief/few.hpp"
#include "simplify/relief/triangulation.hpp"

namespace manip3d::relief_detail {

/// Sum of weighted squared distances to planes, as a function of the offset from a vertex. Single
/// precision is accurate enough, because the offsets are short.
struct LocalQuadric {
  float xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;  // A
  float bx = 0, by = 0, bz = 0;
  float c = 0;
  float weight = 0;  ///< Sum of the weights.

  void add_plane_through_origin(const Vec3& n, float w) {
    const Vec3 wn = w * n;
    xx += wn.x() * n.x(), xy += wn.x() * n.y(), xz += wn.x() * n.z();
    yy += wn.y() * n.y(), yz += wn.y() * n.z(), zz += wn.z() * n.z();
    weight += w;
  }
  /// Adds a quadric of another vertex whose offset from this one is `offset`.
  void add(const LocalQuadric& q, const Vec3& offset);
  [[nodiscard]] float operator()(const Vec3& p) const {
    const float x = p.x(), y = p.y(), z = p.z();
    return x * (xx * x + 2.0F * (xy * y + xz * z + bx)) + y * (yy * y + 2.0F * (yz * z + by)) +
           z * (zz * z + 2.0F * bz) + c;
  }
};

/// The treatment of triangles that lie a step off the surface.
enum class OffFaces : std::uint8_t {
  kTake,   ///< They are made like others, except as the last triangle if there is another.
  kAvoid,  ///< Among few vertices, they are made only where nothing else is left.
  kNever   ///< They are never made, and if few_faces() of a mesh with more vertices, on the way
           ///< to the target, have more pixels than the mesh in the end, these are the result.
};

/// Parts of the surface that Collapser::run() left out.
struct LeftOutPixels {
  std::int64_t number = 0;
  bool in_faces = false;  ///< They are those of all but few_faces(), not only of small pieces.
};

/// Removes vertices from a triangulation; each step is the one that adds least to the sum of
/// distances between the surface and the mesh.
///
/// - An edge collapses onto one of its ends. The quadric of a vertex [Garland & Heckbert 1997]
///   holds the planes of the surface near it, of total weight w (their area). The mean distance is
///   a sum of distances, not of squares, so the price of a collapse is the growth of sqrt(w Q), an
///   estimate of area times distance. For boundary edges, the surface that is lost beside them is
///   added, at a higher rate.
/// - A hole of three vertices is closed; they become interior ones. Its price is the area of the
///   triangle times the mean distance of its points from its sides, where the surface is.
/// - A piece of one triangle is left out, at the price of its area times the distance to the
///   nearest vertex of another piece; this removes three vertices. The largest piece always stays.
///
/// Losing a boundary vertex or a piece costs more (price_of_pixels()) if it covers more pixels per
/// vertex than the mesh will on average.
class Collapser {
 public:
  /// @param keep  By pixel, may be empty: vertices there cost `keep_factor` times as much, or stay.
  /// @param missing_factor  Price of missing surface, relative to surface that is off by the same
  ///                        area times distance.
  /// @param false_factor    Price of false surface, relative to missing surface.
  void assign(const Surface& surface, const Triangulation& mesh, std::span<const Keep> keep,
              float keep_factor, float missing_factor, float false_factor);
  /// Many collapses in little time, before run(): passes over the vertices merge each one if its
  /// price is below a limit, which is the quantile `sweep_share` of sampled prices (times the share
  /// of vertices to remove). Passes are repeated until they remove only a small part of the
  /// surplus. A vertex whose price was above the limit when it was last computed is skipped
  /// afterwards, here and in run(), unless another one has merged into it since. Leaves no slots of
  /// removed vertices.
  /// @param speck_pixels  Pieces of fewer pixels than this are left out below the limit, as run()
  ///                      does; 0: none is.
  void sweep(const Surface& surface, Triangulation& mesh, std::int64_t target, float sweep_share,
             std::int64_t speck_pixels, const Progress& progress);
  /// Stops at `target` vertices, or with more if vertices that must stay prevent it. Each round
  /// makes the best moves first, and removes at most the share `round_share` of the vertices. If no
  /// collapse leads to `target`, the result is few_faces() of the mesh at that point.
  LeftOutPixels run(const Surface& surface, Triangulation& mesh, std::int64_t target,
                    float round_share, OffFaces off, const Progress& progress);
  /// The share of the area in pieces of fewer pixels than this, which may be left out; 0 if there
  /// are none. If no piece has more pixels, the largest one does not count.
  [[nodiscard]] double area_of_specks(std::int64_t least_pixels) const;
  /// The number of these pieces.
  [[nodiscard]] std::int64_t num_specks(std::int64_t least_pixels) const;
  /// Merges the vertices within the surface at pixels without confidence (Surface::is_unsure())
  /// into others, before run(); stops at `target` vertices.
  void leave_unsure(const Surface& surface, Triangulation& mesh, std::int64_t target,
                    const Progress& progress);
  /// Leaves out these pieces, before run().
  void leave_out_specks(Triangulation& mesh, std::int64_t least_pixels);

 private:
  static constexpr std::int32_t kCloseHole = -1, kLeaveOut = -2;
  struct Move {
    float price;  ///< Per vertex that it removes.
    std::int32_t vertex, to;
  };
  struct Piece {
    std::int64_t doubled_pixels = 0;  ///< Twice the area in pixels.
    double believed = 0.0;            ///< The same, times the confidence by which it is priced.
    double area = 0.0;
    bool fixed = false;  ///< Some vertex stays.
  };
  /// The data of an end of an edge that its price needs, in one cache line. four_prices() reads the
  /// four numbers from surface.c on.
  struct alignas(64) Node {
    LocalQuadric surface;
    float spent = 0.0F;         ///< sqrt(w Q) at the vertex itself.
    float factor = 1.0F;        ///< Factor on the price of removing the vertex; infinite: it stays.
    std::int32_t touched = -1;  ///< The round in which it last changed.
    std::int32_t piece = -1;
    float area = 0.0F;  ///< Area of the surface at the vertex, times the price of its loss.
  };
  [[nodiscard]] bool is_fixed(std::int32_t v) const;
  void find_pieces(const Surface& surface, const Triangulation& mesh);
  void find_share(std::int64_t target);
  /// @param believed  Twice the number of pixels that are lost per vertex removed, times their
  ///                  confidence.
  [[nodiscard]] float price_of_pixels(double believed) const;
  /// Price of the collapse of v onto `to`.
  /// @param cut  lower bound of the surface that is lost beside the boundary.
  [[nodiscard]] float price(const Triangulation& mesh, std::int32_t v, std::int32_t to,
                            float cut) const;
  [[nodiscard]] float price_of_piece(const Surface& surface, const Triangulation& mesh,
                                     std::int32_t t) const;
  /// Index in `fan` of the neighbour into which v merges at the lowest price, among neighbours that
  /// were not touched in this round; -1 if there is none.
  /// @param legal  Consider only legal collapses.
  int cheapest(const Surface& surface, const Triangulation& mesh, std::int32_t v,
               const Triangulation::Fan& fan, bool legal, std::int32_t round, float& lowest) const;
  [[nodiscard]] int nearest(const Surface& surface, const Triangulation& mesh, std::int32_t v,
                            const Triangulation::Fan& fan, bool to_unsure) const;
  /// cheapest() for a vertex off the boundary, including illegal collapses and touched neighbours.
  int cheapest_inside(const Triangulation& mesh, std::int32_t v, const Triangulation::Fan& fan,
                      float& lowest) const;
  /// price() of four neighbours of a vertex off the boundary.
  [[nodiscard]] Float4 four_prices(const Triangulation& mesh, std::int32_t v,
                                   const std::array<std::int32_t, 4>& to) const;
  /// Whether the collapse is legal and, while `refuses_off_`, makes no triangle off the surface.
  /// The growth of the error of the pixels around v when it merges into its neighbour number i.
  /// Quadrics do not tell it where triangles lie over pixels without confidence, because the planes
  /// of such triangles count little or nothing.
  [[nodiscard]] float price_at_rim(const Surface& surface, const Triangulation& mesh,
                                   std::int32_t v, const Triangulation::Fan& fan, int i) const;
  [[nodiscard]] bool may_collapse(const Surface& surface, const Triangulation& mesh, std::int32_t v,
                                  const Triangulation::Fan& fan, int i) const;
  /// @param most  Vertices with a known price above this are skipped.
  void find_moves(const Surface& surface, const Triangulation& mesh, float most, Ticker& ticker);
  void keep_cheapest(std::size_t count);
  std::size_t sort_more(std::size_t sorted, std::size_t count);
  bool make(const Surface& surface, Triangulation& mesh, const Move& move, std::int32_t round,
            std::int64_t target);
  bool collapse(const Surface& surface, Triangulation& mesh, const Move& move, std::int32_t round);
  /// Merges the fan's centre v into its neighbour number i.
  void merge(Triangulation& mesh, std::int32_t v, const Triangulation::Fan& fan, int i);
  [[nodiscard]] bool may_sweep(const Triangulation& mesh, std::int32_t v,
                               Triangulation::Fan& fan) const;
  bool leave_out_swept(const Surface& surface, Triangulation& mesh, std::int32_t v,
                       std::int64_t target, float limit);
  float sampled_price(const Surface& surface, const Triangulation& mesh, float share);
  void sweep_below(const Surface& surface, Triangulation& mesh, std::int64_t target, float limit,
                   Ticker& ticker);
  [[nodiscard]] float known_price(const Triangulation& mesh, std::int64_t count);
  void compact(Triangulation& mesh);
  [[nodiscard]] bool is_speck(std::int32_t piece, std::int32_t largest,
                              std::int64_t least_pixels) const;
  [[nodiscard]] std::int32_t largest_piece(std::int64_t least_pixels) const;
  bool leave_out_least(Triangulation& mesh);
  [[nodiscard]] static bool refuses_now(const Surface& surface, std::int64_t num_vertices,
                                        OffFaces off, bool forced);
  /// Finds few_faces() if the mesh has few enough vertices; keeps those with the most pixels so
  /// far.
  /// @return  Whether these are kept now.
  bool remember_few(const Surface& surface, const Triangulation& mesh, std::int64_t target);
  void leave_out(Triangulation& mesh, std::int32_t piece, std::span<const std::int32_t> faces);

  std::vector<Node> nodes_;             ///< By vertex.
  std::vector<LocalQuadric> boundary_;  ///< By vertex.
  std::vector<Piece> pieces_;
  std::int32_t largest_ = 0;
  double believed_sum_ = 1.0;      ///< Sum of the pieces' `believed`.
  double believed_share_ = 0.0;    ///< The same per vertex of the target.
  std::int64_t left_out_ = 0;      ///< Twice the pixels of the pieces left out.
  std::int64_t swept_specks_ = 0;  ///< Argument of sweep().
  bool has_fixed_ = false;
  bool refuses_off_ = false;  ///< Moves must not make a triangle that lies a step off the surface.
  float boundary_weight_ = 0.0F, cover_factor_ = 0.0F;
  float least_loss_ = 0.0F;  ///< Smallest confidence by which lost surface is priced.
  FewFaces few_;             ///< The few faces that cover most pixels so far.
  /// Twice the pixels that were left out when `few_` was found, plus those of the whole mesh then.
  std::int64_t few_total_ = 0;
  std::int64_t few_below_ = 0;  ///< Number of vertices at which few_faces() is called next.
  std::vector<Move> moves_;
  std::vector<float> prices_;
  std::vector<std::int32_t> stack_;
  std::vector<std::int32_t> piece_of_;  ///< By face.
  /// By vertex: its lowest price when it was last computed; 0: unknown. Empty without sweep().
  std::vector<float> known_;
};

/// Price of missing surface, relative to surface that is off by the same area times distance. Of 1,
/// 4, 12, 16 and 40, tried on two Stanford scans, a person and a desk, 12 covers the most without a
/// larger mean error: 0.95 instead of 0.94 of the surface at 1 % of the points, and 0.99 instead of
/// 0.98 at 5 %.
inline constexpr float kMissingFactor = 12.0F;
/// Price of false surface, relative to missing surface. With 10, half as much false surface is left
/// as with 2.5 at 1 % of the points.
inline constexpr float kFalseFactor = 10.0F;

/// At most this many vertices are "few": each of them counts, and triangles across steps are a
/// large part of the mesh.
constexpr std::int64_t kFew = 64;

/// few_faces() are searched from this many vertices per vertex of the target on.
constexpr std::int64_t kFewFrom = 8;

}  // namespace manip3d::relief_detail
