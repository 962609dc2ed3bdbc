#include "manip3d/io/scene_file.hpp"

#include <algorithm>
#include <set>
#include <string>
#include <utility>

#include "io/formats.hpp"
#include "io/gltf_scene.hpp"
#include "io/gltf_shell.hpp"
#include "io/gltf_write_primitives.hpp"
#include "io/texture_files.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace fs = std::filesystem;
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kInstancing = "EXT_mesh_gpu_instancing";

bool is_instanced(const Json& node) {
  return node.contains("extensions") && node["extensions"].contains(kInstancing);
}

/// Removes an extension from a node.
void drop_extension(Json& node, const char* name) {
  if (!node.contains("extensions")) return;
  node["extensions"].erase(name);
  if (node["extensions"].empty()) node.erase("extensions");
}

std::optional<MeshFormat> gltf_format(const fs::path& path) {
  const auto format = format_of_suffix(without_compression_suffix(path).extension().string());
  const bool is_gltf = format == MeshFormat::kGltf || format == MeshFormat::kGlb;
  return is_gltf ? format : std::nullopt;
}

/// Inserts the triangles of all levels into the document of a scene.
class SceneAssembler {
 public:
  SceneAssembler(const std::string& document, const std::string& buffer, const SceneLevel& meshes,
                 const SceneWriteOptions& options)
      : options_(options) {
    scene_.json = Json::parse(document);
    scene_.buffer = buffer;
    levels_.push_back(&meshes);
    for (const SceneLevel& level : options.coarser) levels_.push_back(&level);
    num_materials_ = scene_.json.contains("materials") ? scene_.json["materials"].size() : 0;
    const std::size_t num_meshes =
        scene_.json.contains("meshes") ? scene_.json["meshes"].size() : 0;
    for (const SceneLevel* level : levels_) {
      if (level->size() == num_meshes) continue;
      throw InputError("meshes: expected one for each mesh of the scene (" +
                       std::to_string(num_meshes) + "), got " + std::to_string(level->size()));
    }
  }

  GltfScene assemble() {
    scene_.json["asset"]["generator"] = "manip3d " MANIP3D_VERSION;
    write_meshes();
    if (scene_.json.contains("nodes")) write_nodes();
    drop_empty_animations();
    for (const char* array : {"accessors", "bufferViews", "meshes"}) {
      if (scene_.json.contains(array) && scene_.json[array].empty()) scene_.json.erase(array);
    }
    return std::move(scene_);
  }

 private:
  /// Writes the meshes of all levels, and records their indices in `placed_`.
  void write_meshes() {
    find_frames();
    Json before = scene_.json.contains("meshes") ? scene_.json["meshes"] : Json::array();
    Json after = Json::array();
    for (const SceneLevel* level : levels_) {
      std::vector<std::int64_t> indices(before.size(), -1);
      for (std::size_t m = 0; m < before.size(); ++m) {
        Json mesh = before[m];
        if (const auto& given = (*level)[m]) {
          Json primitives =
              given->mesh.num_faces() > 0
                  ? write_primitives(scene_, *given,
                                     {frames_[m], options_.max_vertices, num_materials_})
                  : Json::array();
          give_variants(mesh, primitives);
          for (Json& kept : mesh["primitives"]) primitives.push_back(std::move(kept));
          mesh["primitives"] = std::move(primitives);
        } else if (!placed_.empty()) {
          indices[m] = placed_.front()[m];  // one mesh for all levels
          continue;
        }
        if (mesh["primitives"].empty()) continue;
        indices[m] = static_cast<std::int64_t>(after.size());
        after.push_back(std::move(mesh));
      }
      placed_.push_back(std::move(indices));
    }
    scene_.json["meshes"] = std::move(after);
  }

  /// Gives new primitives the variants of the old primitives with the same material.
  static void give_variants(Json& mesh, Json& primitives) {
    const auto given = mesh.find(kVariantsOfMaterials);
    if (given == mesh.end()) return;
    for (Json& primitive : primitives) {
      if (!primitive.contains("material")) continue;
      const auto own = given->find(std::to_string(primitive["material"].get<std::int64_t>()));
      if (own != given->end() && !own->is_null()) primitive["extensions"][kVariants] = *own;
    }
    mesh.erase(kVariantsOfMaterials);
  }

  /// Chooses one frame for all levels of a mesh, because they share a node. Meshes with instances
  /// are not quantised: instances transform the mesh itself, so that no child node could undo the
  /// quantisation.
  void find_frames() {
    frames_.resize(levels_.front()->size());
    std::set<std::size_t> instanced;
    for (const Json& node : scene_.json.value("nodes", Json::array())) {
      if (is_instanced(node) && node.contains("mesh")) {
        instanced.insert(node["mesh"].get<std::size_t>());
      }
    }
    for (std::size_t m = 0; options_.quantize && m < frames_.size(); ++m) {
      // Points and lines of the mesh stay in its own coordinates.
      if (instanced.contains(m) || !scene_.json["meshes"][m]["primitives"].empty()) continue;
      std::vector<const MeshView*> shown;
      bool is_deformed = false;
      for (const SceneLevel* level : levels_) {
        const auto& given = (*level)[m];
        if (!given || given->mesh.num_faces() == 0) continue;
        shown.push_back(&given->mesh);
        is_deformed = is_deformed || !given->deformation.empty();
      }
      if (!shown.empty() && !is_deformed) frames_[m] = quantized_frame(shown);
    }
    const auto is_quantized = [](const PositionFrame& frame) { return frame.is_quantized(); };
    if (std::ranges::any_of(frames_, is_quantized)) require_quantization(scene_.json);
  }

  void write_nodes() {
    find_animated();
    const std::size_t num_nodes = scene_.json["nodes"].size();
    for (std::size_t n = 0; n < num_nodes; ++n) {
      const Json& node = scene_.json["nodes"][n];
      if (!node.contains("mesh")) continue;
      const auto mesh = node["mesh"].get<std::size_t>();
      if (placed_.front().at(mesh) < 0) retarget_weights(n, {});
      const bool has_levels = levels_.size() > 1 && (*levels_.front())[mesh].has_value();
      show(n, placed_.front().at(mesh));
      const std::size_t shown = frames_.at(mesh).is_quantized() ? place(n, frames_[mesh]) : n;
      if (has_levels) write_levels(shown, mesh);
    }
  }

  /// Lets a node show a mesh; -1: none.
  void show(std::size_t node, std::int64_t mesh) {
    if (mesh < 0) {
      for (const char* member : {"mesh", "skin", "weights"}) {
        scene_.json["nodes"][node].erase(member);
      }
      drop_extension(scene_.json["nodes"][node], kInstancing);
    } else {
      scene_.json["nodes"][node]["mesh"] = mesh;
    }
  }

  /// Moves the mesh of a node into a child that undoes the quantisation; returns the child's index.
  std::size_t place(std::size_t n, const PositionFrame& frame) {
    const std::size_t child = add_child(n);
    Json& node = scene_.json["nodes"][child];
    node["translation"] = {frame.origin.x(), frame.origin.y(), frame.origin.z()};
    node["scale"] = {frame.scale, frame.scale, frame.scale};
    return child;
  }

  /// Adds a child of a node with its name, its mesh, and the skin and weights of the mesh.
  std::size_t add_child(std::size_t n) {
    Json& nodes = scene_.json["nodes"];
    const std::size_t child = nodes.size();
    nodes.push_back(Json::object());
    for (const char* member : {"name", "mesh", "skin", "weights"}) {
      if (nodes[n].contains(member)) nodes[child][member] = nodes[n][member];
    }
    if (is_instanced(nodes[n])) {
      nodes[child]["extensions"][kInstancing] = nodes[n]["extensions"][kInstancing];
      drop_extension(nodes[n], kInstancing);
    }
    nodes[n]["children"].push_back(child);
    for (const char* member : {"mesh", "skin", "weights"}) nodes[n].erase(member);
    return child;
  }

  /// Retargets animations of a node's morph targets to the nodes that show its mesh instead.
  void retarget_weights(std::size_t from, const std::vector<std::size_t>& to) {
    if (!scene_.json.contains("animations")) return;
    for (Json& animation : scene_.json["animations"]) {
      Json channels = Json::array();
      for (const Json& channel : animation["channels"]) {
        const Json& target = channel["target"];
        if (target.value("path", "") != "weights" || !target.contains("node") ||
            target["node"] != from) {
          channels.push_back(channel);
          continue;
        }
        for (const std::size_t node : to) {
          channels.push_back(channel);
          channels.back()["target"]["node"] = node;
        }
      }
      animation["channels"] = std::move(channels);
    }
  }

  void find_animated() {
    if (!scene_.json.contains("animations")) return;
    for (const Json& animation : scene_.json["animations"]) {
      for (const Json& channel : animation.at("channels")) {
        const Json& target = channel.at("target");
        if (target.contains("node")) animated_.insert(target["node"].get<std::size_t>());
      }
    }
  }

  void drop_empty_animations() {
    if (!scene_.json.contains("animations")) return;
    Json kept = Json::array();
    for (Json& animation : scene_.json["animations"]) {
      if (!animation["channels"].empty()) kept.push_back(std::move(animation));
    }
    scene_.json["animations"] = std::move(kept);
    if (scene_.json["animations"].empty()) scene_.json.erase("animations");
  }

  // A level of detail replaces its node with all its children and animations. The levels of a node
  // that is more than a mesh are therefore put into a child of its own.
  void write_levels(std::size_t n, std::size_t mesh) {
    Json& nodes = scene_.json["nodes"];
    const auto is_more = [&](const Json& node) {
      const bool has_text = node.contains("extras") && !node["extras"].is_object();
      return node.contains("children") || node.contains("camera") || node.contains("extensions") ||
             has_text || animated_.contains(n);
    };
    const std::size_t finest = is_more(nodes[n]) ? add_child(n) : n;
    Json base = nodes[finest];
    base.erase("extras");
    Json ids = Json::array();
    std::vector<std::size_t> shown{finest};
    for (std::size_t level = 1; level < levels_.size(); ++level) {
      ids.push_back(nodes.size());
      shown.push_back(nodes.size());
      nodes.push_back(base);
      show(nodes.size() - 1, placed_[level][mesh]);
    }
    retarget_weights(n, shown);
    nodes[finest]["extensions"]["MSFT_lod"] = {{"ids", ids}};
    nodes[finest]["extras"]["MSFT_screencoverage"] = options_.coverages;
    Json& used = scene_.json["extensionsUsed"];
    if (std::find(used.begin(), used.end(), "MSFT_lod") == used.end()) used.push_back("MSFT_lod");
  }

  const SceneWriteOptions& options_;
  std::vector<const SceneLevel*> levels_;
  std::size_t num_materials_ = 0;
  GltfScene scene_;
  /// New index of a mesh, by level and mesh; -1: no part of it is left.
  std::vector<std::vector<std::int64_t>> placed_;
  std::vector<PositionFrame> frames_;  ///< By mesh; float32 without quantisation.
  std::set<std::size_t> animated_;     ///< Nodes that have an animation.
};

GltfScene assemble(const std::string& document, const std::string& buffer, const SceneLevel& meshes,
                   const SceneWriteOptions& options) {
  try {
    return SceneAssembler(document, buffer, meshes, options).assemble();
  } catch (const Json::exception& error) {
    throw InputError(std::string("document: expected one of read_scene, got: ") + error.what());
  }
}

}  // namespace

void DeformationView::check(std::int64_t num_vertices) const {
  const auto expect = [](const char* name, std::size_t got, std::int64_t rows, std::int64_t width) {
    if (got == static_cast<std::size_t>(rows * width)) return;
    throw InputError(std::string(name) + ": expected " + std::to_string(rows) + " x " +
                     std::to_string(width) + " values, got " + std::to_string(got));
  };
  if (num_influences % 4 != 0) {
    throw InputError("joints: expected a multiple of 4 for each vertex, got " +
                     std::to_string(num_influences));
  }
  expect("joints", joints.size(), num_vertices, num_influences);
  expect("weights", weights.size(), num_vertices, num_influences);
  expect("targets", targets.size(), num_targets * num_vertices, 3);
  if (!target_normals.empty()) {
    expect("target_normals", target_normals.size(), num_targets * num_vertices, 3);
  }
}

void MoreTexcoordsView::check(std::int64_t num_vertices) const {
  if (values.size() == static_cast<std::size_t>(2 * num_sets * num_vertices)) return;
  throw InputError("more_texcoords: expected " + std::to_string(num_vertices) + " x " +
                   std::to_string(num_sets) + " x 2 values, got " + std::to_string(values.size()));
}

Scene read_scene(const fs::path& path, const ReadOptions& options, const Progress& progress) {
  ReadOptions here = options;
  here.folder = path.parent_path().empty() ? "." : path.parent_path();
  try {
    if (!gltf_format(path)) {
      throw FormatError("expected a scene in .gltf or .glb", {});
    }
    const auto bytes = decompressed(file_source(path), compression_of(path), options.max_bytes);
    return read_gltf_scene(*bytes, here, progress);
  } catch (const FormatError& error) {
    if (!error.file().empty()) throw;  // the error is in a file that the scene names
    throw error.in_file(path.string());
  }
}

std::vector<std::string> write_scene(const fs::path& path, const std::string& document,
                                     const std::string& buffer, const SceneLevel& meshes,
                                     const SceneWriteOptions& options, const Progress& progress) {
  const auto format = gltf_format(path);
  if (!format) {
    throw InputError("path: expected .glb or .gltf for a scene, got '" + path.string() + "'");
  }
  GltfScene scene = assemble(document, buffer, meshes, options);
  std::vector<std::string> warnings;
  const std::vector<Material> no_materials;
  WriteOptions only_names;
  only_names.hash_names = options.hash_names;
  write_with_companions(
      path, compression_of(path), progress, [&](Output& output, std::set<std::string>& taken) {
        if (*format == MeshFormat::kGlb) return write_glb(output, scene);
        const WriteJob job{MeshView(), no_materials, only_names, path, warnings, taken};
        CompanionFiles files(job);
        write_gltf(output, scene, path, files);
      });
  return warnings;
}

}  // namespace manip3d
