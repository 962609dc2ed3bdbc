#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>

#include "manip3d/error.hpp"
#include "manip3d/io/point_file.hpp"

namespace manip3d {

/// Reads the bytes as points of one format: a table of the stated size, or a FormatError with a
/// reason. All else is a finding.
inline void fuzz_points(const std::uint8_t* data, std::size_t size, PointFormat format) {
  const std::span<const std::byte> bytes(reinterpret_cast<const std::byte*>(data), size);
  try {
    const PointTable table = read_points(bytes, format);
    const std::int64_t expected = table.num_points * row_bytes(table.fields);
    if (static_cast<std::int64_t>(table.rows.size()) != expected) std::abort();
  } catch (const FormatError& error) {
    if (error.reason().empty()) std::abort();
  }
}

}  // namespace manip3d
