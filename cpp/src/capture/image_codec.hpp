#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

/// @file
/// Images of recordings, in memory: PNG, and whatever colour comes as.
namespace manip3d {

/// Row by row; `channels` values a pixel.
template <typename T>
struct DecodedImage {
  std::int64_t rows = 0, cols = 0;
  std::vector<T> pixels;
};

/// Images of more pixels than `max_pixels` are refused before anything is allocated for them.
/// @throws FormatError  damaged, another kind of image, or too large.
///
/// A grey PNG of 16 bits (8 bits: the values as they are).
DecodedImage<std::uint16_t> decode_depth(std::span<const std::byte> data, std::int64_t max_pixels);
/// A grey PNG of 8 bits.
DecodedImage<std::uint8_t> decode_grey(std::span<const std::byte> data, std::int64_t max_pixels);
/// R, G, B of a PNG (of any kind of 8 or 16 bits; transparency is left out) or of a JPEG.
DecodedImage<std::uint8_t> decode_rgb(std::span<const std::byte> data, std::int64_t max_pixels);

/// PNG at zlib's level 1: sensor noise does not get smaller at higher ones.
std::vector<std::byte> encode_png(std::span<const std::uint16_t> grey, std::int64_t cols);
std::vector<std::byte> encode_png(std::span<const std::uint8_t> pixels, std::int64_t cols,
                                  int channels);

}  // namespace manip3d
