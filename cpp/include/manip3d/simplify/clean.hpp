#pragma once

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Which of several faces on the same three positions are removed; the first one always stays.
enum class Duplicates : std::uint8_t {
  kKeep,  ///< None.
  kSame,  ///< Exact copies: same orientation, material, UVs, normals and colours.
  kAny,   ///< All, whatever their orientation and look.
};

struct CleanOptions {
  bool weld = true;  ///< Merge vertices at bit-identical positions (-0.0 equals 0.0).
  Duplicates duplicates = Duplicates::kSame;
};

struct CleanResult {
  TriangleMesh mesh;   ///< Without `materials`, which are the input's. No table has unused rows.
  Indices vertex_map;  ///< (V,) input vertex -> output vertex, or -1 if gone.
  Indices face_map;    ///< (F,) input face -> output face, or -1 if gone.
  std::int64_t merged_vertices = 0;        ///< Gone into another vertex at the same position.
  std::int64_t unreferenced_vertices = 0;  ///< Gone because no remaining face uses them.
  std::int64_t degenerate_faces = 0;       ///< Gone because of a repeated index (after welding).
  std::int64_t duplicate_faces = 0;        ///< Gone because an earlier face is their duplicate.
  std::int64_t changed_faces = 0;          ///< Faces with another material, UV or colour (kAny).
  std::int64_t changed_vertices = 0;       ///< Merged ones of another colour than the kept one.
};

/// Removes what no simplification can use: the pre-cleaning of dissertation section 2.3.1.
///
/// Merges vertices at the same position, then removes faces with a repeated index, then duplicate
/// faces, then vertices, texture coordinates and normals that no face uses. Texture coordinates
/// and normals belong to corners, so merging leaves them alone; of several colours at a position
/// that of the lowest vertex in use stays. What remains keeps its order. Duplicates are told by
/// their positions, with or without welding. kSame never changes the picture of an opaque mesh.
/// O(V log V + F log F) time, O(V + F) memory.
/// @throws InputError  as check_mesh.
CleanResult clean(const MeshView& mesh, const CleanOptions& options = {},
                  const Progress& progress = {});

}  // namespace manip3d
