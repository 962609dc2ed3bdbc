#pragma once

#include <bit>
#include <cmath>
#include <cstdint>

#include "manip3d/geometry/angles.hpp"
#include "manip3d/geometry/oriented_box.hpp"
#include "manip3d/geometry/point_cloud.hpp"
#include "mesh_from_bytes.hpp"

/// @file
/// Scans made from the fuzzer's bytes.
namespace manip3d::fuzzing {

/// A few points: on a small grid of any scale, of arbitrary bits, or on an angular grid with ranges
/// and gaps from the fuzzer.
inline PointCloud take_scan(Bytes& bytes, int most = 400) {
  const auto kind = bytes.take<std::uint8_t>();
  const int count = bytes.take<std::uint16_t>() % (most + 1);
  PointCloud cloud;
  cloud.points.resize(count, 3);
  if ((kind & 3) == 0) {
    for (float& x : cloud.points.reshaped<Eigen::RowMajor>()) x = bytes.take<float>();
  } else if ((kind & 3) == 1) {
    const float scale = std::ldexp(1.0F, bytes.take<std::int8_t>() / 4);
    for (float& x : cloud.points.reshaped<Eigen::RowMajor>()) {
      x = scale * static_cast<float>(bytes.take<std::int8_t>() / 8);
    }
  } else {
    const double step = 0.002 + bytes.take<std::uint8_t>() * 2e-4;
    const int columns = 1 + bytes.take<std::uint8_t>();
    for (int i = 0; i < count; ++i) {
      const double range = 0.05 * bytes.take<std::uint8_t>();
      const auto [sine, cosine] = sin_cos(i % columns * step);
      const auto [up, level] = sin_cos(i / columns * step - 0.4);
      cloud.points.row(i) << static_cast<float>(range * level * cosine),
          static_cast<float>(range * level * sine), static_cast<float>(range * up);
    }
  }
  if ((kind & 4) != 0) {
    cloud.intensity.resize(count);
    for (float& x : cloud.intensity) x = bytes.take<std::uint8_t>() / 256.0F;
  }
  return cloud;
}

/// Mostly a small number, sometimes arbitrary bits.
inline double take_number(Bytes& bytes) {
  const auto kind = bytes.take<std::uint8_t>();
  return kind == 255 ? bytes.take<double>() : 0.125 * bytes.take<std::int8_t>();
}

inline Eigen::Vector3d take_place(Bytes& bytes) {
  const double x = take_number(bytes), y = take_number(bytes), z = take_number(bytes);
  return {x, y, z};
}

inline OrientedBox take_box(Bytes& bytes) {
  OrientedBox box;
  box.center = take_place(bytes);
  box.size = take_place(bytes);
  box.yaw = take_number(bytes);
  return box;
}

}  // namespace manip3d::fuzzing
