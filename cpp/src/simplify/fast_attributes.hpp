#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "simplify/fast_mesh.hpp"

namespace manip3d::fast_detail {

// Attributes when t collapses onto v, which moves to p. The functions expect the positions and
// faces from before the collapse.

using WedgePairs = std::vector<std::pair<std::int32_t, std::int32_t>>;

/// Buffers of merge_wedges().
struct MergedWedges {
  WedgePairs pairs;  // wedges of t, with the wedges of v that replace them
  std::vector<std::int32_t> wedges;
  std::vector<Eigen::Vector2d> texcoords;
};

/// Whether a locked one of v and t would get a texture coordinate that only the other one has.
bool changes_locked(const FastMesh& mesh, std::int32_t v, std::int32_t t, MergedWedges& merged);
/// Replaces each wedge of t by that of v across a face on the edge; other wedges of t stay. Then
/// all get the texture coordinate that the faces around have at p.
void merge_wedges(FastMesh& mesh, std::int32_t v, std::int32_t t, const Vector3f& p,
                  MergedWedges& merged);
/// Gives corners of t the most similar normal of v.
void merge_normals(FastMesh& mesh, std::int32_t v, std::int32_t t);

/// Colours that still have to be mixed after a collapse, with the share of t's colour. A pass moves
/// a vertex at most once, so colours can be mixed at its end, when the memory is not busy
/// otherwise.
struct ColorMix {
  std::int32_t v, t;
  float share;
};

/// Interpolates between the colours of v and t by the position of p along the edge.
ColorMix mix_of(const FastMesh& mesh, std::int32_t v, std::int32_t t, const Vector3f& p);
void mix_colors(FastMesh& mesh, const std::vector<ColorMix>& mixes);

}  // namespace manip3d::fast_detail
