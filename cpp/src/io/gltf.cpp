#include "io/gltf.hpp"

#include <algorithm>
#include <limits>
#include <utility>

#include "io/formats.hpp"
#include "io/gltf_asset.hpp"
#include "io/gltf_materials.hpp"
#include "io/gltf_nodes.hpp"
#include "io/gltf_triangles.hpp"
#include "io/warnings.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

// Default limit of the memory of a mesh: the larger of kFreeBytes and kFreeRatio times the stored
// bytes of the file, where compressed streams count five times.
constexpr std::int64_t kFreeBytes = std::int64_t{64} << 20;
constexpr std::int64_t kFreeRatio = 100;

/// Reads the rest of a source, at most `most` bytes.
/// @param budget  Is charged block by block, so that a source that is too long is not read to its
///                end; may be null.
Bytes read_all(ByteSource& source, std::size_t most, GltfBudget* budget) {
  constexpr std::size_t kBlock = std::size_t{1} << 16;
  Bytes bytes;
  bytes.reserve(std::min<std::size_t>(source.remaining().value_or(0), most));
  while (bytes.size() < most) {
    const std::size_t size = bytes.size();
    bytes.resize(size + std::min(kBlock, most - size));
    const std::size_t got =
        source.read(reinterpret_cast<char*>(bytes.data()) + size, bytes.size() - size);
    bytes.resize(size + got);
    if (budget != nullptr) budget->charge(static_cast<std::int64_t>(got), "file");
    if (got == 0) break;
  }
  return bytes;
}

Bytes read_beside(const ReadOptions& options, const std::string& uri, std::int64_t size) {
  if (options.folder.empty()) {
    throw InputError("'" + uri + "' cannot be read: no folder to find it in");
  }
  const auto place_of = [&](const std::string& name) {
    return options.allow_outside ? options.folder / name : resolve_inside(options.folder, name);
  };
  std::filesystem::path path = place_of(uri);
  if (!std::filesystem::exists(path) && uri.find('\\') != std::string::npos) {
    std::string slashed = uri;  // programs for Windows write backslashes
    std::replace(slashed.begin(), slashed.end(), '\\', '/');
    path = place_of(slashed);
  }
  if (std::filesystem::exists(path) && !std::filesystem::is_regular_file(path)) {
    throw InputError("'" + uri + "' is not a regular file");
  }
  return read_all(*file_source(path), static_cast<std::size_t>(size), nullptr);
}

GltfResource resource_beside(const ReadOptions& options) {
  return [&options](const std::string& uri, std::int64_t size) {
    return read_beside(options, uri, size);
  };
}

}  // namespace

GltfBudget::GltfBudget(std::int64_t stored_bytes, std::uint64_t max_bytes)
    : stored_bytes_(stored_bytes),
      max_bytes_(static_cast<std::int64_t>(
          std::min<std::uint64_t>(max_bytes, std::numeric_limits<std::int64_t>::max()))) {}

void GltfBudget::charge(std::int64_t bytes, const std::string& who) {
  const std::int64_t limit =
      max_bytes_ > 0 ? max_bytes_
                     : std::max(kFreeBytes, kFreeRatio * (stored_bytes_ + 4 * compressed_));
  if (bytes <= limit - spent_) {  // the sum could exceed 64 bits
    spent_ += bytes;
    return;
  }
  throw FormatError::at_byte(0, who + ": the mesh takes more than " + std::to_string(limit) +
                                    " bytes, much for a file of " + std::to_string(stored_bytes_) +
                                    "; max_bytes allows it");
}

ReadResult parse_gltf(std::span<const std::byte> data, const GltfResource& resource,
                      GltfBudget budget, const Progress& progress, const DracoDecoder& draco) {
  GltfDocument document(data, resource, budget);
  ReadResult result;
  check_gltf_asset(document, {}, result.warnings);
  if (document.count("animations") > 0) warn(result.warnings, "animations are left out");
  if (document.count("skins") > 0) {
    warn(result.warnings, "skins are left out: meshes have the pose of their joints");
  }
  GltfNodes nodes(document, budget);
  const std::vector<GltfInstance> instances = nodes.drawn_instances();
  std::vector<bool> is_shown(document.count("meshes"), false);
  for (const GltfInstance& instance : instances) is_shown[instance.mesh] = true;
  // streams that are not shown stay undecoded, so that damage in them is harmless
  document.expand_draco(draco, is_shown);
  GltfTriangles triangles = read_triangles(document, instances, GltfTexcoords::kPlaced, budget,
                                           result.warnings, progress);
  result.mesh = std::move(triangles.mesh);
  for (std::string& text : triangles.losses) warn(result.warnings, std::move(text));
  GltfMeshMaterials materials = read_mesh_materials(document, budget, result.warnings);
  result.mesh.materials = std::move(materials.materials);
  for (std::int32_t& material : result.mesh.face_material) {
    if (material >= 0) material = materials.rows[material];
  }
  result.num_polygons = result.mesh.faces.rows();
  return result;
}

ReadResult read_gltf(ByteSource& source, const ReadOptions& options, const Progress& progress) {
  GltfBudget budget(static_cast<std::int64_t>(source.stored_size()), options.max_bytes);
  const Bytes file = read_all(source, std::numeric_limits<std::size_t>::max(), &budget);
  return parse_gltf(file, resource_beside(options), budget, progress, options.draco);
}

Scene read_gltf_scene(ByteSource& source, const ReadOptions& options, const Progress& progress) {
  GltfBudget budget(static_cast<std::int64_t>(source.stored_size()), options.max_bytes);
  const Bytes file = read_all(source, std::numeric_limits<std::size_t>::max(), &budget);
  return parse_gltf_scene(file, resource_beside(options), budget, progress, options.draco);
}

}  // namespace manip3d
