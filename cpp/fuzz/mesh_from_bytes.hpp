#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>

#include "manip3d/geometry/mesh.hpp"

/// @file
/// Meshes made from the fuzzer's bytes, for kernels that take indices.
namespace manip3d::fuzzing {

/// Takes values from the front of the fuzzer's bytes; zeros after their end.
class Bytes {
 public:
  Bytes(const std::uint8_t* data, std::size_t size) : rest_(data, size) {}

  template <typename T>
  T take() {
    std::array<std::uint8_t, sizeof(T)> bytes{};
    const std::size_t count = std::min(sizeof(T), rest_.size());
    if (count > 0) std::memcpy(bytes.data(), rest_.data(), count);
    rest_ = rest_.subspan(count);
    T value;
    std::memcpy(&value, bytes.data(), sizeof(T));
    return value;
  }
  [[nodiscard]] bool empty() const { return rest_.empty(); }

 private:
  std::span<const std::uint8_t> rest_;
};

/// A few vertices, on a small grid of any scale or of arbitrary bits, with faces, texture
/// coordinates and materials, whose indices are mostly in range.
inline TriangleMesh take_mesh(Bytes& bytes) {
  const auto kind = bytes.take<std::uint8_t>();
  const int num_vertices = bytes.take<std::uint8_t>() % 24;
  const int num_faces = bytes.take<std::uint8_t>() % 32;
  const double scale = std::ldexp(1.0, (kind & 1) != 0 ? 4 * bytes.take<std::int8_t>() : 0);
  const bool any_bits = (kind & 2) != 0;
  const auto coordinate = [&] {
    return any_bits ? bytes.take<double>() : scale * (bytes.take<std::int8_t>() / 16);
  };
  const auto index = [&](int lowest, int end) {  // one in 256 is out of range
    const int byte = bytes.take<std::uint8_t>();
    return byte == 255 || end <= lowest ? end : lowest + byte % (end - lowest);
  };

  TriangleMesh mesh;
  mesh.vertices.resize(num_vertices, 3);
  for (double& x : mesh.vertices.reshaped<Eigen::RowMajor>()) x = coordinate();
  mesh.faces.resize(num_faces, 3);
  for (std::int32_t& v : mesh.faces.reshaped<Eigen::RowMajor>()) v = index(0, num_vertices);
  if ((kind & 4) != 0) {
    const int num_texcoords = bytes.take<std::uint8_t>() % 16;
    mesh.texcoords.resize(num_texcoords, 2);
    for (double& x : mesh.texcoords.reshaped<Eigen::RowMajor>()) x = coordinate();
    mesh.face_texcoords.resize(num_faces, 3);
    for (std::int32_t& t : mesh.face_texcoords.reshaped<Eigen::RowMajor>()) {
      t = index(-1, num_texcoords);
    }
  }
  if ((kind & 8) != 0) {
    mesh.face_material.resize(num_faces);
    for (std::int32_t& m : mesh.face_material) m = bytes.take<std::int8_t>() % 4;
  }
  return mesh;
}

}  // namespace manip3d::fuzzing
