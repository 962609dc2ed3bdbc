// glTF and GLB from arbitrary bytes: a FormatError, or a valid mesh or scene. A valid mesh is
// written and read again with the same faces.
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "io/gltf.hpp"
#include "io/gltf_scene.hpp"
#include "manip3d/error.hpp"
#include "manip3d/io/scene_file.hpp"

namespace {

using manip3d::TriangleMesh;

std::span<const std::byte> as_bytes(const std::string& text) {
  return std::as_bytes(std::span(text.data(), text.size()));
}

/// Each external file consists of these 64 bytes.
std::vector<std::byte> resource(const std::string& uri, std::int64_t size) {
  std::vector<std::byte> bytes(std::min<std::int64_t>(size, 64));
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    bytes[i] = static_cast<std::byte>(i % 4 == 3 ? 0x3F : uri.size() + i);
  }
  return bytes;
}

std::string texture_file(const manip3d::Texture& texture) {
  return std::string(reinterpret_cast<const char*>(texture.data.data()), texture.data.size());
}

void check_round_trip(const TriangleMesh& mesh) {
  std::string glb;
  std::vector<std::string> warnings;
  try {
    manip3d::GltfScene scene = manip3d::build_gltf(mesh, mesh.materials, texture_file, warnings);
    glb = manip3d::finish_glb(scene);
    glb += scene.buffer;
  } catch (const manip3d::InputError&) {  // no faces, or values beyond float32
    return;
  }
  const TriangleMesh again =
      manip3d::parse_gltf(as_bytes(glb), resource, manip3d::GltfBudget(1 << 20)).mesh;
  if (again.faces.rows() != mesh.faces.rows()) std::abort();
  if (again.materials.size() != mesh.materials.size()) std::abort();
}

/// Makes a Draco mesh from arbitrary bytes; the first ones are the numbers of components and
/// vertices.
manip3d::DracoMesh decode_draco(std::span<const std::byte> stream) {
  if (stream.size() < 3) throw manip3d::FormatError("damaged Draco stream", {});
  const auto number = [&](std::size_t i) { return std::to_integer<int>(stream[i]); };
  manip3d::DracoMesh mesh;
  mesh.corners = {1, true, {}};
  manip3d::DracoMesh::Attribute attribute{number(0) % 6, number(1) % 2 == 1, {}};
  attribute.values.resize(static_cast<std::size_t>(attribute.num_components * number(2)));
  for (std::size_t i = 3; i < stream.size(); ++i) {
    mesh.corners.values.push_back(number(i));
    if (i - 3 < attribute.values.size()) attribute.values[i - 3] = number(i);
  }
  mesh.attributes.emplace(0, std::move(attribute));
  return mesh;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    const manip3d::ReadResult content =
        manip3d::parse_gltf(std::as_bytes(std::span(data, size)), resource,
                            manip3d::GltfBudget(static_cast<std::int64_t>(size)), {}, decode_draco);
    manip3d::check_mesh(content.mesh);
    for (const std::int32_t material : content.mesh.face_material) {
      if (material >= static_cast<std::int64_t>(content.mesh.materials.size())) std::abort();
    }
    if (content.mesh.faces.rows() < 4096) check_round_trip(content.mesh);
  } catch (const manip3d::FormatError&) {
  }
  try {
    const manip3d::Scene scene = manip3d::parse_gltf_scene(
        std::as_bytes(std::span(data, size)), resource,
        manip3d::GltfBudget(static_cast<std::int64_t>(size)), {}, decode_draco);
    for (const manip3d::SceneMesh& mesh : scene.meshes) manip3d::check_mesh(mesh.mesh);
  } catch (const manip3d::FormatError&) {
  }
  return 0;
}
