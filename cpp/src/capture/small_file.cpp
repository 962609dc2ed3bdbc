#include "capture/small_file.hpp"

#include <algorithm>
#include <string>

#include "manip3d/error.hpp"
#include "manip3d/files/byte_source.hpp"

namespace manip3d {

std::vector<std::byte> read_small_file(const std::filesystem::path& path, std::uint64_t most) {
  const auto source = file_source(path);
  std::vector<std::byte> bytes;
  bytes.reserve(std::min(source->remaining().value_or(0), most) + 1);
  constexpr std::size_t kPiece = 1 << 16;
  while (true) {
    const std::size_t size = bytes.size();
    bytes.resize(size + std::max(kPiece, bytes.capacity() - size));
    const std::size_t got =
        source->read(reinterpret_cast<char*>(bytes.data() + size), bytes.size() - size);
    bytes.resize(size + got);
    if (bytes.size() > most) {
      throw FormatError("expected at most " + std::to_string(most) + " bytes", {})
          .in_file(path.string());
    }
    if (got == 0) return bytes;
  }
}

}  // namespace manip3d
