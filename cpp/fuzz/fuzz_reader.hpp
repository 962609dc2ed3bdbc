#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>

#include "manip3d/error.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/io/mesh_file.hpp"

namespace manip3d {

/// Reads the bytes as a mesh of one format: a mesh that passes `check_mesh`, or a FormatError with
/// a reason. All else is a finding.
inline void fuzz_reader(const std::uint8_t* data, std::size_t size, MeshFormat format) {
  const std::span<const std::byte> bytes(reinterpret_cast<const std::byte*>(data), size);
  try {
    const ReadResult result = read_mesh(bytes, format);
    check_mesh(result.mesh);
    if (result.num_polygons > result.mesh.faces.rows()) std::abort();
    for (Eigen::Index f = 0; f < result.mesh.face_material.rows(); ++f) {
      const auto num_materials = static_cast<std::int64_t>(result.mesh.materials.size());
      if (result.mesh.face_material[f] >= num_materials) std::abort();
    }
  } catch (const FormatError& error) {
    if (error.reason().empty()) std::abort();
  }
}

}  // namespace manip3d
