#pragma once

#include <bit>
#include <cstdint>
#include <cstring>

/// @file
/// Reading and writing of little-endian numbers at any address.
namespace manip3d {

static_assert(std::endian::native == std::endian::little);

template <typename T>
void store(T value, std::uint8_t* place) {
  std::memcpy(place, &value, sizeof value);
}

template <typename T>
T load(const std::uint8_t* place) {
  T value;
  std::memcpy(&value, place, sizeof value);
  return value;
}

}  // namespace manip3d
