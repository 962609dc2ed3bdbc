#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "simplify/fast_mesh.hpp"

namespace manip3d::fast_detail {

// Attributes where t goes into v and the vertex comes to lie at p. Positions, and the faces of
// both, are still those from before.

using WedgePairs = std::vector<std::pair<std::int32_t, std::int32_t>>;

/// Buffers of merge_wedges().
struct MergedWedges {
  WedgePairs pairs;  // wedges of t, and those of v that they continue as
  std::vector<std::int32_t> wedges;
  std::vector<Eigen::Vector2d> texcoords;
};

/// Each wedge of t continues as that of v across a face on the edge; the others stay. Then all
/// get the texture coordinate that the faces around have at p.
void merge_wedges(FastMesh& mesh, std::int32_t v, std::int32_t t, const Vector3f& p,
                  MergedWedges& merged);
/// Corners of t get the normal of v that is nearest to theirs.
void merge_normals(FastMesh& mesh, std::int32_t v, std::int32_t t);

/// Colours of a collapse that are yet to be mixed: those of t have this share. A pass takes a
/// vertex once, so its colours wait for its end, when nothing else has to wait for the memory.
struct ColorMix {
  std::int32_t v, t;
  float share;
};

/// Between the colours of v and t, as p lies between them.
ColorMix mix_of(const FastMesh& mesh, std::int32_t v, std::int32_t t, const Vector3f& p);
void mix_colors(FastMesh& mesh, const std::vector<ColorMix>& mixes);

}  // namespace manip3d::fast_detail
