#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

/// @file
/// Decoders of the streams of glTF's extensions EXT_meshopt_compression and KHR_meshopt_compression
/// (appendices A and B of the latter).
namespace manip3d {

enum class MeshoptMode { kAttributes, kTriangles, kIndices };
enum class MeshoptFilter { kNone, kOctahedral, kQuaternion, kExponential, kColor };

/// Layout of a stream's content, which the stream itself does not contain.
struct MeshoptLayout {
  std::int64_t count = 0;   ///< Elements, >= 1; for triangles a multiple of three.
  std::int64_t stride = 0;  ///< Bytes per element; 2 or 4 for indices.
  MeshoptMode mode = MeshoptMode::kAttributes;
  MeshoptFilter filter = MeshoptFilter::kNone;
};

/// Decodes a stream to `count * stride` bytes, little endian.
/// @throws FormatError  the stream is damaged (with the byte in it and the reason), or the
///                      extension does not allow the layout.
std::vector<std::byte> decode_meshopt(std::span<const std::byte> stream,
                                      const MeshoptLayout& layout);

}  // namespace manip3d
