// Arbitrary streams of EXT_meshopt_compression and KHR_meshopt_compression: a FormatError, or the
// number of bytes of the layout. The first four bytes are the layout, the rest is the stream.
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "checks.hpp"
#include "io/meshopt_codec.hpp"
#include "manip3d/error.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace manip3d;
  constexpr std::size_t kLayout = 4;
  if (size < kLayout) return 0;
  const MeshoptLayout layout{1 + data[0] + 256 * (data[1] % 8), data[2],
                             static_cast<MeshoptMode>(data[3] % 3),
                             static_cast<MeshoptFilter>(data[3] / 3 % 5)};
  // A separate copy, so that a read past its end is detected.
  const std::span<const std::byte> bytes = std::as_bytes(std::span(data, size)).subspan(kLayout);
  const std::vector<std::byte> stream(bytes.begin(), bytes.end());
  try {
    const std::vector<std::byte> decoded = decode_meshopt(stream, layout);
    fuzzing::require(decoded.size() == static_cast<std::size_t>(layout.count * layout.stride));
  } catch (const FormatError&) {
  }
  return 0;
}
