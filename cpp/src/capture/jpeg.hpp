#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

namespace manip3d {

struct ImageSize {
  std::int64_t rows = 0, cols = 0;
};

/// Encodes colour images as JPEG (baseline, 4:2:0) with libjpeg-turbo; the bytes are the same on
/// every CPU.
class JpegEncoder {
 public:
  /// @param quality  1 to 100.
  explicit JpegEncoder(int quality);
  JpegEncoder(const JpegEncoder&) = delete;
  JpegEncoder& operator=(const JpegEncoder&) = delete;
  ~JpegEncoder();

  /// @param colour  (rows, cols, 3) R, G, B.
  /// @return  Valid until the next call.
  std::span<const std::byte> encode(const std::uint8_t* color, ImageSize size);

 private:
  void* handle_;
  int quality_;
  std::vector<unsigned char> packet_;
};

/// Decodes JPEG images of JpegEncoder and of cameras. Safe for any bytes: sizes are checked before
/// memory is allocated, and a damaged image is an error, not an image that is grey from some place
/// on.
class JpegDecoder {
 public:
  JpegDecoder();
  JpegDecoder(const JpegDecoder&) = delete;
  JpegDecoder& operator=(const JpegDecoder&) = delete;
  ~JpegDecoder();

  /// @throws FormatError  no JPEG image, or a side longer than kMaxImageSide.
  ImageSize size(std::span<const std::byte> packet);
  /// @param colour  (rows, cols, 3) R, G, B. Those of a CMYK image are computed without a colour
  ///                profile, from inks that are stored inverted, as Adobe's programs do.
  /// @throws FormatError  no JPEG image, a damaged one, or one of another size than `size`.
  void decode(std::span<const std::byte> packet, ImageSize size, std::uint8_t* color);

 private:
  struct Header;
  Header header(std::span<const std::byte> packet);
  void decompress(std::span<const std::byte> packet, ImageSize size, int pixels, std::uint8_t* to);
  [[noreturn]] void refuse(const char* action);

  void* handle_;
};

}  // namespace manip3d
