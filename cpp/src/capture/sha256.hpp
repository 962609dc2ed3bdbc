#pragma once

#include <cstddef>
#include <span>
#include <string>

namespace manip3d {

/// SHA-256 as 64 hexadecimal digits.
std::string sha256(std::span<const std::byte> bytes);

}  // namespace manip3d
