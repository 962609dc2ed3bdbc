#include <cstdint>
#include <cstdlib>
#include <span>

#include "capture/image_codec.hpp"
#include "manip3d/error.hpp"

namespace {

// Decodes the bytes as an image of at most 2^16 pixels: a complete image, or a FormatError with a
// reason.
template <typename Decode>
void try_decoder(const Decode& decode, std::span<const std::byte> data, std::int64_t channels) {
  constexpr std::int64_t kMaxPixels = 1 << 16;
  try {
    const auto image = decode(data, kMaxPixels);
    const std::int64_t pixels = image.rows * image.cols;
    if (image.rows < 1 || image.cols < 1 || pixels > kMaxPixels) std::abort();
    if (std::ssize(image.pixels) != channels * pixels) std::abort();
    std::uint64_t sum = 0;
    for (const auto value : image.pixels) sum += value;
    if (sum > 65535ULL * image.pixels.size()) std::abort();
  } catch (const manip3d::FormatError& error) {
    if (error.reason().empty()) std::abort();
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto bytes = std::as_bytes(std::span(data, size));
  try_decoder(manip3d::decode_depth, bytes, 1);
  try_decoder(manip3d::decode_grey, bytes, 1);
  try_decoder(manip3d::decode_rgb, bytes, 3);
  return 0;
}
