#include <array>
#include <cstdlib>
#include <span>

#include "manip3d/error.hpp"
#include "manip3d/files/byte_source.hpp"

// Decompresses all bytes but the first, which chooses the limit and the size of reads.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace manip3d;
  if (size == 0) return 0;
  const std::uint64_t max_bytes = (data[0] & 1U) != 0 ? 1000 : 0;
  const std::size_t block = (data[0] & 2U) != 0 ? 7 : 4096;
  const std::span<const std::byte> bytes(reinterpret_cast<const std::byte*>(data + 1), size - 1);
  std::uint64_t total = 0;
  try {
    const auto source = decompressed(memory_source(bytes), Compression::kNone, max_bytes);
    std::array<char, 4096> buffer;
    while (const std::size_t got = source->read(buffer.data(), block)) {
      total += got;
      if (source->stored_bytes() > source->stored_size()) std::abort();
    }
    if (max_bytes > 0 && total > max_bytes) std::abort();
  } catch (const FormatError& error) {
    if (!error.position().byte_offset) std::abort();
  }
  if (total > kFreeExpansion + kMaxExpansion * size + block) std::abort();
  return 0;
}
