#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string_view>
#include <vector>

namespace manip3d {

/// Reads all bytes of a file.
/// @throws FormatError  (with the name) the file is larger than `most` bytes.
/// @throws std::filesystem::filesystem_error
std::vector<std::byte> read_small_file(const std::filesystem::path& path, std::uint64_t most);

inline std::string_view as_text(const std::vector<std::byte>& bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

}  // namespace manip3d
