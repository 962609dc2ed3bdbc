#pragma once

#include <cstddef>
#include <span>
#include <string>

#include "manip3d/capture/mkv_codec.hpp"

namespace manip3d {

/// Returns the codec library.
/// @throws DeviceError  find_mkv_codec() finds no library.
const MkvCodec& mkv_codec();

/// The codec library's text for an error code.
std::string mkv_error(int code);

inline MkvBytes to_mkv(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()};
}
inline std::span<const std::byte> from_mkv(MkvBytes bytes) {
  return std::as_bytes(std::span(bytes.data, bytes.size));
}

}  // namespace manip3d
