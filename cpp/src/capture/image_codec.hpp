#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

/// @file
/// Decoding and encoding of the images of recordings in memory: PNG, and colour as PNG or JPEG.
namespace manip3d {

/// Pixels row by row, with `channels` values each.
template <typename T>
struct DecodedImage {
  std::int64_t rows = 0, cols = 0;
  std::vector<T> pixels;
  bool has_8_bits = false;  ///< Set by decode_depth().
};

/// Decodes a grey PNG of 16 bits; values of 8 bits are not scaled, and a value that the file says
/// is transparent is one like others. Images of more than `max_pixels` pixels are refused before
/// memory is allocated for them.
/// @throws FormatError  a damaged image, another kind of image, or too many pixels.
DecodedImage<std::uint16_t> decode_depth(std::span<const std::byte> data, std::int64_t max_pixels);
/// Like decode_depth(), for a grey PNG of 8 bits.
DecodedImage<std::uint8_t> decode_grey(std::span<const std::byte> data, std::int64_t max_pixels);
/// Like decode_depth(), for R, G, B of a PNG (any kind with 8 or 16 bits; transparency is ignored)
/// or a JPEG.
DecodedImage<std::uint8_t> decode_rgb(std::span<const std::byte> data, std::int64_t max_pixels);

/// Encodes a PNG with zlib's level 1, because higher levels do not compress sensor noise better.
std::vector<std::byte> encode_png(std::span<const std::uint16_t> grey, std::int64_t cols);
std::vector<std::byte> encode_png(std::span<const std::uint8_t> pixels, std::int64_t cols,
                                  int channels);

}  // namespace manip3d
