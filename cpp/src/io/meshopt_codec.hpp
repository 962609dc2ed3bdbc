#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

/// @file
/// Decoders of the streams that glTF's extensions EXT_meshopt_compression and
/// KHR_meshopt_compression define (appendices A and B of the latter).
namespace manip3d {

enum class MeshoptMode { kAttributes, kTriangles, kIndices };
enum class MeshoptFilter { kNone, kOctahedral, kQuaternion, kExponential, kColor };

/// Content of a stream, which the stream itself does not name.
struct MeshoptLayout {
  std::int64_t count = 0;   ///< Elements, >= 1; of triangles a multiple of three.
  std::int64_t stride = 0;  ///< Bytes of an element; 2 or 4 for indices.
  MeshoptMode mode = MeshoptMode::kAttributes;
  MeshoptFilter filter = MeshoptFilter::kNone;
};

/// The `count * stride` bytes of a stream; little endian.
/// @throws FormatError  the stream is damaged: at the byte of it, with the reason; or the layout is
///                      none that the extension allows.
std::vector<std::byte> decode_meshopt(std::span<const std::byte> stream,
                                      const MeshoptLayout& layout);

}  // namespace manip3d
