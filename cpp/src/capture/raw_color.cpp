#include "capture/raw_color.hpp"

#include <algorithm>

#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr std::uint32_t letters(const char (&name)[5]) {
  std::uint32_t code = 0;
  for (int i = 3; i >= 0; --i) code = code << 8 | static_cast<std::uint8_t>(name[i]);
  return code;
}

std::uint8_t to_level(int scaled) {
  return static_cast<std::uint8_t>(std::clamp((scaled + 128) >> 8, 0, 255));
}

/// The coefficients of BT.601 times 256.
void store_rgb(std::byte luma, std::byte blue, std::byte red, std::uint8_t* rgb) {
  const int y = 298 * (std::to_integer<int>(luma) - 16);
  const int u = std::to_integer<int>(blue) - 128;
  const int v = std::to_integer<int>(red) - 128;
  rgb[0] = to_level(y + 409 * v);
  rgb[1] = to_level(y - 100 * u - 208 * v);
  rgb[2] = to_level(y + 516 * u);
}

void decode_nv12(const std::byte* image, ImageSize size, std::uint8_t* rgb) {
  const std::byte* chroma = image + size.rows * size.cols;
  for (std::int64_t row = 0; row < size.rows; ++row) {
    for (std::int64_t col = 0; col < size.cols; ++col) {
      const std::byte* pair = chroma + row / 2 * size.cols + col / 2 * 2;
      store_rgb(image[row * size.cols + col], pair[0], pair[1], rgb);
      rgb += 3;
    }
  }
}

void decode_yuy2(const std::byte* image, ImageSize size, std::uint8_t* rgb) {
  for (std::int64_t i = 0; i < size.rows * size.cols; ++i) {
    const std::byte* pair = image + i / 2 * 4;
    store_rgb(pair[i % 2 * 2], pair[1], pair[3], rgb + 3 * i);
  }
}

void decode_bgra(const std::byte* image, ImageSize size, std::uint8_t* rgb) {
  for (std::int64_t i = 0; i < size.rows * size.cols; ++i) {
    for (int channel = 0; channel < 3; ++channel) {
      rgb[3 * i + channel] = std::to_integer<std::uint8_t>(image[4 * i + 2 - channel]);
    }
  }
}

/// Number of bytes of each two pixels.
std::int64_t bytes_of_two(RawColor layout) {
  switch (layout) {
    case RawColor::kNv12:
      return 3;
    case RawColor::kYuy2:
      return 4;
    case RawColor::kBgra:
      break;
  }
  return 8;
}

}  // namespace

std::optional<RawColor> raw_color_of(std::uint32_t four_cc) {
  if (four_cc == letters("NV12")) return RawColor::kNv12;
  if (four_cc == letters("YUY2")) return RawColor::kYuy2;
  if (four_cc == letters("BGRA")) return RawColor::kBgra;
  return std::nullopt;
}

void decode_raw_color(RawColor layout, std::span<const std::byte> image, ImageSize size,
                      std::uint8_t* rgb) {
  const bool has_odd_side = size.cols % 2 != 0 || (layout == RawColor::kNv12 && size.rows % 2 != 0);
  if (layout != RawColor::kBgra && has_odd_side) {
    throw FormatError("expected an image with even sides", {});
  }
  if (2 * std::ssize(image) != bytes_of_two(layout) * size.rows * size.cols) {
    throw FormatError("an image of another length than its size requires", {});
  }
  switch (layout) {
    case RawColor::kNv12:
      return decode_nv12(image.data(), size, rgb);
    case RawColor::kYuy2:
      return decode_yuy2(image.data(), size, rgb);
    case RawColor::kBgra:
      return decode_bgra(image.data(), size, rgb);
  }
}

}  // namespace manip3d
