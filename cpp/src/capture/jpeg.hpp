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

/// Colour images as JPEG (baseline, 4:2:0) by libjpeg-turbo, the same bytes on every CPU.
class JpegEncoder {
 public:
  /// @param quality  1 to 100.
  explicit JpegEncoder(int quality);
  JpegEncoder(const JpegEncoder&) = delete;
  JpegEncoder& operator=(const JpegEncoder&) = delete;
  ~JpegEncoder();

  /// @param colour  (rows, cols, 3) R, G, B.
  /// @return  valid until the next call.
  std::span<const std::byte> encode(const std::uint8_t* color, ImageSize size);

 private:
  void* handle_;
  int quality_;
  std::vector<unsigned char> packet_;
};

/// Reads what JpegEncoder and cameras write. Safe on any bytes: sizes are known before anything is
/// allocated, and a damaged image is an error, not one that is grey from somewhere on.
class JpegDecoder {
 public:
  JpegDecoder();
  JpegDecoder(const JpegDecoder&) = delete;
  JpegDecoder& operator=(const JpegDecoder&) = delete;
  ~JpegDecoder();

  /// @throws FormatError  no JPEG image, or longer than kMaxImageSide.
  ImageSize size(std::span<const std::byte> packet);
  /// @param colour  (rows, cols, 3) R, G, B.
  /// @throws FormatError  no JPEG image, damaged, or not of `size`.
  void decode(std::span<const std::byte> packet, ImageSize size, std::uint8_t* color);

 private:
  [[noreturn]] void refuse(const char* action);

  void* handle_;
};

}  // namespace manip3d
