#pragma once

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Duplicates that are removed among faces on the same three positions. The first one always stays.
enum class Duplicates : std::uint8_t {
  kKeep,  ///< None: duplicates are kept.
  kSame,  ///< Exact copies: same orientation, material, UVs, normals and colours.
  kAny,   ///< All, whatever their orientation and attributes.
};

struct CleanOptions {
  bool weld = true;  ///< Merge vertices at bit-identical positions (-0.0 equals 0.0).
  Duplicates duplicates = Duplicates::kSame;
};

struct CleanResult {
  /// Without `materials`, which are those of the input. No table has unused rows.
  TriangleMesh mesh;
  Indices vertex_map;                ///< (V,) input vertex -> output vertex, or -1 if removed.
  Indices face_map;                  ///< (F,) input face -> output face, or -1 if removed.
  std::int64_t merged_vertices = 0;  ///< Merged into another vertex at the same position.
  std::int64_t unreferenced_vertices = 0;  ///< Removed because no remaining face uses them.
  std::int64_t degenerate_faces = 0;       ///< Removed because of a repeated index (after welding).
  std::int64_t duplicate_faces = 0;        ///< Removed because an earlier face is equal.
  /// Faces removed although their material, UVs or colours differ from the kept one (kAny).
  std::int64_t changed_faces = 0;
  /// Vertices merged although their colour differs from the kept one.
  std::int64_t changed_vertices = 0;
};

/// Clean a mesh before simplification (dissertation section 2.3.1).
///
/// Merges vertices at the same position; then removes faces with a repeated index, then duplicate
/// faces, then vertices, texture coordinates and normals that no face uses. Texture coordinates and
/// normals belong to corners, so merging does not change them; of several colours at a position,
/// that of the lowest used vertex stays. The order of the remaining rows does not change.
/// Duplicates are compared by position, with or without welding. kSame never changes the rendering
/// of an opaque mesh. O(V log V + F log F) time, O(V + F) memory.
/// @throws InputError  as check_mesh.
CleanResult clean(const MeshView& mesh, const CleanOptions& options = {},
                  const Progress& progress = {});

}  // namespace manip3d
