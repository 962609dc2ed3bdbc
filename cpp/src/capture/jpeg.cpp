#include "capture/jpeg.hpp"

#include <turbojpeg.h>

#include <new>
#include <string>
#include <utility>

#include "manip3d/error.hpp"
#include "manip3d/geometry/camera.hpp"

namespace manip3d {
namespace {

// LIMITSCANS, because progressive images may have any number of scans over all pixels, each with a
// few bytes.
constexpr int kSafely = TJFLAG_STOPONWARNING | TJFLAG_LIMITSCANS;

const unsigned char* bytes(std::span<const std::byte> packet) {
  return reinterpret_cast<const unsigned char*>(packet.data());
}

void* or_no_memory(void* handle) {
  if (handle == nullptr) throw std::bad_alloc();
  return handle;
}

// Converts inverted cyan, magenta, yellow and black: 255 is no ink.
void to_rgb(std::span<const std::uint8_t> inks, std::uint8_t* color) {
  for (std::size_t i = 0; i < inks.size(); i += 4) {
    for (std::size_t c = 0; c < 3; ++c) {
      *color++ = static_cast<std::uint8_t>((inks[i + c] * inks[i + 3] + 127) / 255);
    }
  }
}

}  // namespace

JpegEncoder::JpegEncoder(int quality) : handle_(or_no_memory(tjInitCompress())), quality_(quality) {
  if (quality < 1 || quality > 100) {
    tjDestroy(handle_);
    throw InputError("jpeg_quality: expected 1 to 100, got " + std::to_string(quality));
  }
}

JpegEncoder::~JpegEncoder() { tjDestroy(handle_); }

std::span<const std::byte> JpegEncoder::encode(const std::uint8_t* color, ImageSize size) {
  const int cols = static_cast<int>(size.cols), rows = static_cast<int>(size.rows);
  packet_.resize(tjBufSize(cols, rows, TJSAMP_420));
  unsigned char* packet = packet_.data();
  unsigned long length = packet_.size();
  // NOREALLOC: the buffer has the largest size that an image of this size can need.
  if (tjCompress2(handle_, color, cols, 0, rows, TJPF_RGB, &packet, &length, TJSAMP_420, quality_,
                  TJFLAG_NOREALLOC | TJFLAG_ACCURATEDCT) != 0) {
    throw InputError(std::string("colour: cannot be made a JPEG image: ") +
                     tjGetErrorStr2(handle_));
  }
  return std::as_bytes(std::span(packet, length));
}

JpegDecoder::JpegDecoder() : handle_(or_no_memory(tjInitDecompress())) {}

JpegDecoder::~JpegDecoder() {
  if (handle_ != nullptr) tjDestroy(handle_);
}

struct JpegDecoder::Header {
  ImageSize size;
  bool is_cmyk;
};

JpegDecoder::Header JpegDecoder::header(std::span<const std::byte> packet) {
  int cols = 0, rows = 0, sampling = 0, colors = 0;
  if (tjDecompressHeader3(handle_, bytes(packet), packet.size(), &cols, &rows, &sampling,
                          &colors) != 0) {
    refuse("no JPEG image");
  }
  if (cols > kMaxImageSide || rows > kMaxImageSide) {
    throw FormatError("JPEG image of " + std::to_string(cols) + " x " + std::to_string(rows) +
                          " pixels: expected at most 16384 a side",
                      {});
  }
  return {{rows, cols}, colors == TJCS_CMYK || colors == TJCS_YCCK};
}

ImageSize JpegDecoder::size(std::span<const std::byte> packet) { return header(packet).size; }

void JpegDecoder::decode(std::span<const std::byte> packet, ImageSize expected,
                         std::uint8_t* color) {
  const auto [found, is_cmyk] = header(packet);
  if (found.rows != expected.rows || found.cols != expected.cols) {
    throw FormatError("JPEG image: expected " + std::to_string(expected.cols) + " x " +
                          std::to_string(expected.rows) + " pixels, got " +
                          std::to_string(found.cols) + " x " + std::to_string(found.rows),
                      {});
  }
  if (!is_cmyk) return decompress(packet, found, TJPF_RGB, color);
  std::vector<std::uint8_t> inks(static_cast<std::size_t>(4 * found.rows * found.cols));
  decompress(packet, found, TJPF_CMYK, inks.data());
  to_rgb(inks, color);
}

void JpegDecoder::decompress(std::span<const std::byte> packet, ImageSize size, int pixels,
                             std::uint8_t* to) {
  if (tjDecompress2(handle_, bytes(packet), packet.size(), to, static_cast<int>(size.cols), 0,
                    static_cast<int>(size.rows), pixels, kSafely | TJFLAG_ACCURATEDCT) != 0) {
    refuse("damaged JPEG image");
  }
}

void JpegDecoder::refuse(const char* action) {
  const FormatError error(std::string(action) + ": " + tjGetErrorStr2(handle_), {});
  // Libjpeg-turbo 2.1.5 would parse the next image from the place of an error in a header.
  tjDestroy(std::exchange(handle_, nullptr));
  handle_ = or_no_memory(tjInitDecompress());
  throw error;
}

}  // namespace manip3d
