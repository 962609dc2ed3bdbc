#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

namespace manip3d {

/// A colour image (rows, cols, 3), R, G, B; null: no image.
struct StreamImage {
  const std::uint8_t* pixels = nullptr;
  std::int64_t rows = 0, cols = 0;
};

/// The contents of one frame for the web page: a mesh of body and phantom, each of which has the
/// colours of its own image.
struct StreamFrame {
  std::span<const float> vertices;         ///< (N, 3) metres.
  std::span<const float> texcoords;        ///< (N, 2), v up; NaN: no colour.
  std::span<const std::uint8_t> phantoms;  ///< (N) not 0: the vertex belongs to the phantom.
  std::span<const std::int32_t> faces;     ///< (F, 3).
  StreamImage color;                       ///< Image with the colours of the body.
  StreamImage phantom_color;  ///< Image with the colours of the phantom; may be the same.
  float opacity = 1.0F;       ///< Opacity of the phantom.
  std::uint32_t sequence = 0;
  std::int64_t time_ns = 0;      ///< Time by the sensor's clock.
  std::int64_t captured_ns = 0;  ///< Time of arrival, nanoseconds since 1970.
  std::string_view status;       ///< Further data, as JSON.
  int jpeg_quality = 80;
};

/// Version of the layout that encode_stream_frame writes.
inline constexpr std::uint16_t kStreamVersion = 1;

/// Encodes a frame as one message.
///
/// Little endian; a header of 88 bytes, then sections that each begin at a multiple of four bytes:
///
///     0  4s  "M3DL"          16  i64  time_ns              48  3f32  low
///     4  u16 version         24  i64  captured_ns          60  3f32  step
///     6  u16 header's size   32  u32  vertices N           72  u32   bytes of the body's JPEG
///     8  u32 sequence        36  u32  faces of the body B  76  u32   bytes of the phantom's JPEG
///    12  u32 flags           40  u32  of the phantom P     80  u32   bytes of the status
///                            44  f32  opacity              84  u32   0
///
///     positions  N x 3 u16   position = low + step * value; a step is below 1/65000 of the extent
///     texcoords  N x 2 u16   column and row over the image, 65534 its end; 65535: no colour
///     faces      (B + P) x 3 u16, or u32 with flag 1
///     body's JPEG, phantom's JPEG, status
///
/// The images are cropped to the regions that the texture coordinates use. With flag 2 the phantom
/// uses the body's image. Triangles with at least one vertex of the phantom belong to it; the order
/// of triangles is kept.
/// @throws InputError  sizes do not agree, an index is out of range, a vertex is not finite, the
///                     opacity is outside 0 to 1, or the quality is outside 1 to 100.
std::vector<std::byte> encode_stream_frame(const StreamFrame& frame);

}  // namespace manip3d
