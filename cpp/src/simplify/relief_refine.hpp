#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "manip3d/progress.hpp"
#include "simplify/relief_triangulation.hpp"

namespace manip3d::relief_detail {

/// The edges of the frame before.
class EdgeMemory {
 public:
  void clear() { edges_.clear(); }
  void assign(const Surface& surface, const Triangulation& mesh);
  [[nodiscard]] bool has(const Surface& surface, const Triangulation& mesh, std::int32_t a,
                         std::int32_t b) const;

 private:
  std::vector<std::uint64_t> edges_;  ///< Places of both ends, the lesser first; sorted.
};

/// Improves a triangulation by what the mean distance measures: the sum over the surface's pixels
/// of their weight times their distance from the plane of the triangle that they appear in.
class Refiner {
 public:
  void assign(const Triangulation& mesh);
  /// Flips edges while that lowers the error, in at most `sweeps` passes.
  /// @param floor   pairs of triangles whose error is below so many means are not looked at.
  /// @param before  edges that stay, or come back, unless another one is far better.
  int flip_edges(const Surface& surface, Triangulation& mesh, int sweeps, float floor,
                 const EdgeMemory& before, const Progress& progress);
  /// flip_edges() in a fifth of the time, from twelve pixels of each pair instead of all.
  /// @param floor  pairs are not looked at where the two ways to cut them differ by less than so
  ///               many mean volumes.
  void flip_sampled(const Surface& surface, Triangulation& mesh, int sweeps, float floor,
                    const EdgeMemory& before, const Progress& progress);
  /// Moves interior vertices to a pixel nearby, over linked ones, where that lowers the error.
  /// @param keep  by pixel, may be empty: vertices there stay, or need a far better pixel to move.
  int move_vertices(const Surface& surface, Triangulation& mesh, int radius,
                    std::span<const Keep> keep, const Progress& progress);
  /// Empties some pixels: an interior vertex there moves to the used pixel among the 24 around it
  /// that leaves the least error; one that has none, or is on the boundary, merges into a neighbour
  /// where that is legal. Else one on the boundary moves to the nearest such pixel that lies in its
  /// triangles.
  void leave_pixels(const Surface& surface, Triangulation& mesh, std::span<const Keep> keep,
                    const std::function<bool(std::int32_t)>& is_left);
  /// Slides each vertex in its direction: by what gives the least sum of squared distances
  /// (weighted by area) between the pixels and the triangles, by half of it or not at all,
  /// whichever of these leaves the least error around the vertex.
  void fit(const Surface& surface, Triangulation& mesh, const std::vector<Vec3>& directions);
  [[nodiscard]] float offset(std::int32_t v) const { return offsets_[v]; }

  /// The error around a vertex if it were at another pixel, by triangle; `most` or more where it
  /// may not be there.
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
  /// Merges a vertex into the first neighbour that it may merge into; false: there is none.
  static bool merge(const Surface& surface, Triangulation& mesh, std::int32_t v,
                    const Triangulation::Fan& fan);
  static std::int32_t best_beside(const Surface& surface, const Triangulation& mesh,
                                  const Triangulation::Fan& fan, std::int32_t pixel,
                                  const std::function<bool(std::int32_t)>& is_left);
  /// The nearest used pixel in a fan's triangles that its centre may move to; -1: there is none.
  static std::int32_t nearest_in(const Surface& surface, const Triangulation& mesh,
                                 const Triangulation::Fan& fan, std::int32_t pixel,
                                 const std::function<bool(std::int32_t)>& is_left);
  float mean_error(const Surface& surface, const Triangulation& mesh);
  float error_of(const Surface& surface, const Triangulation& mesh, std::int32_t t);

  std::vector<float> errors_;  ///< By triangle; negative: not known.
  std::vector<std::uint8_t> dirty_, next_dirty_;
  std::vector<float> offsets_;
  std::vector<Block> blocks_;
};

}  // namespace manip3d::relief_detail
