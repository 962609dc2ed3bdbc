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

ImageSize JpegDecoder::size(std::span<const std::byte> packet) {
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
  return {rows, cols};
}

void JpegDecoder::decode(std::span<const std::byte> packet, ImageSize expected,
                         std::uint8_t* color) {
  const ImageSize found = size(packet);
  if (found.rows != expected.rows || found.cols != expected.cols) {
    throw FormatError("JPEG image: expected " + std::to_string(expected.cols) + " x " +
                          std::to_string(expected.rows) + " pixels, got " +
                          std::to_string(found.cols) + " x " + std::to_string(found.rows),
                      {});
  }
  if (tjDecompress2(handle_, bytes(packet), packet.size(), color, static_cast<int>(found.cols), 0,
                    static_cast<int>(found.rows), TJPF_RGB, kSafely | TJFLAG_ACCURATEDCT) != 0) {
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
