#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "manip3d/progress.hpp"
#include "simplify/relief/triangulation.hpp"

namespace manip3d::relief_detail {

/// The sum over the pixels in a triangle of their weight times their distance from its plane.
/// @param corners  Pixels.
[[nodiscard]] float triangle_error(const Surface& surface, const Triangle& corners);

/// The edges of the previous frame.
class EdgeMemory {
 public:
  void clear() { edges_.clear(); }
  void assign(const Surface& surface, const Triangulation& mesh);
  [[nodiscard]] bool has(const Surface& surface, const Triangulation& mesh, std::int32_t a,
                         std::int32_t b) const;

 private:
  std::vector<std::uint64_t> edges_;  ///< Places of both ends, the lower first; sorted.
};

/// Improves a triangulation in the measure of the mean distance: the sum over the pixels of the
/// surface of their weight times their distance from the plane of the triangle over them.
class Refiner {
 public:
  void assign(const Triangulation& mesh);
  /// Flips edges while that lowers the error, in at most `sweeps` passes.
  /// @param floor   Pairs of triangles whose error is below this many mean errors are skipped.
  /// @param before  Edges that stay or return unless another one is far better.
  int flip_edges(const Surface& surface, Triangulation& mesh, int sweeps, float floor,
                 const EdgeMemory& before, const Progress& progress);
  /// flip_edges() beside triangles that hold pixels without confidence and others, until nothing
  /// changes. Vertices have left the former, so that a few passes do not suffice.
  void flip_unsure(const Surface& surface, Triangulation& mesh, const EdgeMemory& before,
                   const Progress& progress);
  /// flip_edges() in a fifth of the time, from twelve pixels of each pair instead of all.
  /// @param floor  A pair is skipped if the two ways to cut it differ by less than this many mean
  ///               volumes.
  void flip_sampled(const Surface& surface, Triangulation& mesh, int sweeps, float floor,
                    const EdgeMemory& before, const Progress& progress);
  /// Moves interior vertices to linked pixels nearby, where that lowers the error.
  /// @param keep  By pixel, may be empty: vertices there stay, or move only to a far better pixel.
  int move_vertices(const Surface& surface, Triangulation& mesh, int radius,
                    std::span<const Keep> keep, const Progress& progress);
  /// Removes the vertices from some pixels. An interior vertex moves to the linked pixel, among the
  /// 24 around it, with the least error. If there is none, or the vertex is on the boundary, it
  /// merges into a neighbour if that is legal; if not, a boundary vertex moves to the nearest used
  /// pixel within its triangles, or edges are flipped away from the vertex until it can merge.
  void leave_pixels(const Surface& surface, Triangulation& mesh, std::span<const Keep> keep,
                    const std::function<bool(std::int32_t)>& is_left);
  /// The nearest used pixel within a fan's triangles to which its centre may move; -1 if there is
  /// none.
  static std::int32_t nearest_in(const Surface& surface, const Triangulation& mesh,
                                 const Triangulation::Fan& fan, std::int32_t pixel,
                                 const std::function<bool(std::int32_t)>& is_left);
  /// Slides each vertex in its direction by the amount that minimizes the sum of squared distances
  /// (weighted by area) between the pixels and the triangles, by half of it, or not at all,
  /// whichever leaves the least error around the vertex.
  void fit(const Surface& surface, Triangulation& mesh, const std::vector<Vec3>& directions);
  [[nodiscard]] float offset(std::int32_t v) const { return offsets_[v]; }

  /// The error around a vertex if it were at another pixel, by triangle; `most` or more if it must
  /// not be there.
  static float error_at(const Surface& surface, const Triangulation& mesh,
                        const Triangulation::Fan& fan, std::int32_t pixel, float most,
                        std::array<float, Triangulation::kMaxFan>& errors);

 private:
  struct Block {
    float aa, bb, cc, ab, bc, ca, ra, rb, rc;
  };
  void solve(const Surface& surface, const Triangulation& mesh,
             const std::vector<Vec3>& directions);
  void accept(const Surface& surface, Triangulation& mesh, const std::vector<Vec3>& directions);
  static Block normal_equations(const Surface& surface, const Triangulation& mesh,
                                const std::vector<Vec3>& directions, std::int32_t t);
  /// Merges a vertex into the first neighbour that is legal; returns false if there is none.
  static bool merge(const Surface& surface, Triangulation& mesh, std::int32_t v,
                    const Triangulation::Fan& fan);
  /// Flips edges away from a vertex that cannot merge until it can; returns false if it never can.
  static bool merge_with_fewer_edges(const Surface& surface, Triangulation& mesh, std::int32_t v,
                                     Triangulation::Fan& fan);
  /// Replaces an edge from a vertex to a neighbour by the other diagonal of the two triangles;
  /// returns false if none may be.
  static bool flip_away(Triangulation& mesh, std::int32_t v, const Triangulation::Fan& fan);
  static std::int32_t best_beside(const Surface& surface, const Triangulation& mesh,
                                  const Triangulation::Fan& fan, std::int32_t pixel,
                                  const std::function<bool(std::int32_t)>& is_left);
  float mean_error(const Surface& surface, const Triangulation& mesh);
  float error_of(const Surface& surface, const Triangulation& mesh, std::int32_t t);

  std::vector<float> errors_;  ///< By triangle; negative: unknown.
  std::vector<std::uint8_t> dirty_, next_dirty_;
  std::vector<float> offsets_;
  std::vector<Block> blocks_;
};

}  // namespace manip3d::relief_detail
