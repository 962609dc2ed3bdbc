#include "io/gltf_shell.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string_view>
#include <utility>

#include "io/gltf_asset.hpp"
#include "io/warnings.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::int64_t kLargestImage = std::int64_t{1} << 31;
constexpr std::int64_t kLargestOffset = std::int64_t{1} << 53;

/// Bytes of an accessor's element; columns of matrices start at multiples of four bytes.
std::int64_t element_bytes(const JsonPlace& accessor) {
  const std::int64_t code = accessor.member("componentType").integer(5120, 5126);
  const std::int64_t component = code <= 5121 ? 1 : code <= 5123 ? 2 : 4;
  struct Shape {
    const char* name;
    std::int64_t rows, columns;
  };
  constexpr std::array<Shape, 7> kShapes = {{{"SCALAR", 1, 1},
                                             {"VEC2", 2, 1},
                                             {"VEC3", 3, 1},
                                             {"VEC4", 4, 1},
                                             {"MAT2", 2, 2},
                                             {"MAT3", 3, 3},
                                             {"MAT4", 4, 4}}};
  const JsonPlace type = accessor.member("type");
  for (const Shape& shape : kShapes) {
    if (type.text() != shape.name) continue;
    const std::int64_t column = component * shape.rows;
    return shape.columns == 1 ? column : shape.columns * ((column + 3) / 4 * 4);
  }
  type.fail("expected SCALAR, VEC2, VEC3, VEC4, MAT2, MAT3 or MAT4");
}

/// Copies the kept parts of a file's buffers into the buffer of its shell.
class ShellBuffer {
 public:
  ShellBuffer(GltfDocument& source, GltfBudget& budget, GltfScene& shell)
      : source_(source), budget_(budget), shell_(shell) {}

  std::size_t copy_bytes(ByteSpan bytes, const JsonPlace& user) {
    budget_.charge(static_cast<std::int64_t>(bytes.size()), user.pointer());
    return shell_.add_buffer_view({reinterpret_cast<const char*>(bytes.data()), bytes.size()});
  }

  /// Copies the accessor that `user` names; returns its new index.
  std::size_t keep(const JsonPlace& user) {
    const JsonPlace place = source_.object("accessors", user);
    const auto known = accessors_.find(place.pointer());
    if (known != accessors_.end()) return known->second;
    const std::int64_t count = place.member("count").integer(0, (std::int64_t{1} << 31) - 1);
    const std::int64_t element = element_bytes(place);
    Json accessor = Json(place.value());
    accessor.erase("byteOffset");
    if (place.has("bufferView")) accessor["bufferView"] = copy_elements(place, count, element);
    if (const auto sparse = place.find("sparse")) {
      copy_sparse(*sparse, count, element, accessor["sparse"]);
    }
    shell_.json["accessors"].push_back(std::move(accessor));
    const std::size_t index = shell_.json["accessors"].size() - 1;
    accessors_.emplace(place.pointer(), index);
    return index;
  }

  /// Copies the accessors that an object names, such as the attributes of a primitive.
  void keep_members(const JsonPlace& place, Json& copy) {
    for (auto& [key, index] : copy.items()) index = keep(place.member(key.c_str()));
  }

 private:
  /// Copies the elements that `owner` names, without data between them.
  std::size_t copy_elements(const JsonPlace& owner, std::int64_t count, std::int64_t element) {
    const JsonPlace user = owner.member("bufferView");
    const ByteSpan bytes = source_.buffer_view(user);
    const JsonPlace view = source_.object("bufferViews", user);
    const auto stride_given = view.find("byteStride");
    const std::int64_t stride = stride_given ? stride_given->integer(element, 252) : element;
    const auto offset_given = owner.find("byteOffset");
    const std::int64_t offset = offset_given ? offset_given->integer(0, kLargestOffset) : 0;
    if (count > 0 &&
        offset + (count - 1) * stride + element > static_cast<std::int64_t>(bytes.size())) {
      owner.fail(std::to_string(count) + " elements do not fit into their bufferView");
    }
    const std::int64_t packed = stride_given ? (element + 3) / 4 * 4 : element;
    budget_.charge(count * packed, owner.pointer());
    std::string copy(static_cast<std::size_t>(count * packed), '\0');
    for (std::int64_t i = 0; i < count; ++i) {
      const auto* from = reinterpret_cast<const char*>(bytes.data()) + offset + i * stride;
      std::copy(from, from + element, copy.begin() + i * packed);
    }
    const std::size_t index = shell_.add_buffer_view(copy);
    if (stride_given) shell_.json["bufferViews"][index]["byteStride"] = packed;
    if (const auto target = view.find("target")) {
      shell_.json["bufferViews"][index]["target"] = target->integer(0, 65535);
    }
    return index;
  }

  /// Copies the indices and values of a sparse accessor with `count` elements.
  void copy_sparse(const JsonPlace& sparse, std::int64_t count, std::int64_t element, Json& copy) {
    const std::int64_t replaced = sparse.member("count").integer(0, count);
    const JsonPlace indices = sparse.member("indices"), values = sparse.member("values");
    const std::int64_t code = indices.member("componentType").integer(5121, 5125);
    const std::int64_t index = code == 5121 ? 1 : code == 5123 ? 2 : 4;
    copy["indices"]["bufferView"] = copy_elements(indices, replaced, index);
    copy["values"]["bufferView"] = copy_elements(values, replaced, element);
    for (const char* part : {"indices", "values"}) copy[part].erase("byteOffset");
  }

  GltfDocument& source_;
  GltfBudget& budget_;
  GltfScene& shell_;
  std::map<std::string, std::size_t> accessors_;  ///< New indices by JSON pointer.
};

/// Removes the extensions that are not kept from a value and all its members, because they would
/// refer to data that have moved.
void drop_extensions(Json& value) {
  if (value.is_array()) {
    for (Json& member : value) drop_extensions(member);
    return;
  }
  if (!value.is_object()) return;
  const auto found = value.find("extensions");
  if (found != value.end() && found->is_object()) {
    Json kept = Json::object();
    for (auto& [name, content] : found->items()) {
      if (is_kept_extension(name)) kept[name] = std::move(content);
    }
    if (kept.empty()) {
      value.erase("extensions");
    } else {
      *found = std::move(kept);
    }
  }
  for (auto& [key, member] : value.items()) {
    if (key != "extras") drop_extensions(member);
  }
}

/// Removes extensions from the lists of used and required ones if the document does not use them.
void drop_unused_extensions(Json& document, bool any_primitive) {
  for (const char* list : {"extensionsUsed", "extensionsRequired"}) {
    const auto found = document.find(list);
    if (found == document.end()) continue;
    Json kept = Json::array();
    for (const Json& name : *found) {
      const auto& text = name.get_ref<const std::string&>();
      if (is_kept_extension(text) && (any_primitive || text != "KHR_mesh_quantization")) {
        kept.push_back(name);
      }
    }
    if (kept.empty()) {
      document.erase(list);
    } else {
      document[list] = std::move(kept);
    }
  }
}

class ShellReader {
 public:
  ShellReader(GltfDocument& source, const GltfResource& resource, GltfBudget& budget,
              std::vector<std::string>& warnings)
      : source_(source),
        resource_(resource),
        budget_(budget),
        warnings_(warnings),
        buffer_(source, budget, shell_) {}

  GltfScene read(const GltfKept& kept) {
    json() = Json(source_.json());
    for (const char* gone : {"buffers", "bufferViews", "accessors"}) json().erase(gone);
    json()["bufferViews"] = Json::array();
    json()["accessors"] = Json::array();
    const bool any_primitive = keep_meshes(kept);
    keep_nodes(kept.nodes);
    keep_skins();
    keep_animations();
    keep_images();
    drop_extensions(json());
    drop_unused_extensions(json(), any_primitive);
    return std::move(shell_);
  }

 private:
  Json& json() { return shell_.json; }

  [[nodiscard]] JsonPlace item(const char* array, std::int64_t index) const {
    return source_.root().member(array).item(index);
  }

  /// @return  true if any primitive is kept; points and lines of replaced meshes are.
  bool keep_meshes(const GltfKept& kept) {
    bool any_primitive = false;
    for (std::size_t m = 0; m < kept.meshes.size(); ++m) {
      Json& mesh = json()["meshes"][m];
      Json primitives = Json::array();
      const JsonPlace places = item("meshes", m).member("primitives");
      for (std::int64_t i = 0; i < places.size(); ++i) {
        const JsonPlace place = places.item(i);
        if (kept.meshes[m] || (kept.replaced[m] && !has_triangles(place))) {
          primitives.push_back(keep_primitive(place, std::move(mesh["primitives"][i])));
        }
      }
      any_primitive = any_primitive || !primitives.empty();
      mesh["primitives"] = std::move(primitives);
      if (kept.replaced[m]) keep_variants(places, mesh);
    }
    return any_primitive;
  }

  Json keep_primitive(const JsonPlace& place, Json primitive) {
    buffer_.keep_members(place.member("attributes"), primitive["attributes"]);
    if (const auto indices = place.find("indices")) primitive["indices"] = buffer_.keep(*indices);
    const auto targets = place.find("targets");
    for (std::int64_t t = 0; targets && t < targets->size(); ++t) {
      buffer_.keep_members(targets->item(t), primitive["targets"][t]);
    }
    return primitive;
  }

  /// Keeps material variants of a mesh by material, because new triangles know only their material.
  /// They are kept if primitives with the same material have the same variants.
  void keep_variants(const JsonPlace& primitives, Json& mesh) {
    Json of_materials = Json::object();
    for (std::int64_t i = 0; i < primitives.size(); ++i) {
      const JsonPlace place = primitives.item(i);
      const auto material = place.find("material");
      if (!material || !has_triangles(place)) continue;
      const auto extensions = place.find("extensions");
      const auto variants = extensions ? extensions->find(kVariants) : std::nullopt;
      const Json own = variants ? Json(variants->value()) : Json();
      const std::string key = std::to_string(material->integer(0, kLargestOffset));
      const auto known = of_materials.find(key);
      if (known != of_materials.end() && *known != own) {
        warn(warnings_, std::string(kVariants) +
                            " of primitives that share a material, but not its variants, is left "
                            "out");
        return;
      }
      of_materials[key] = own;
    }
    mesh[kVariantsOfMaterials] = std::move(of_materials);
  }

  void keep_nodes(const std::vector<bool>& is_kept) {
    bool any_emptied = false;
    for (std::size_t n = 0; n < is_kept.size(); ++n) {
      Json& node = json()["nodes"][n];
      if (!is_kept[n]) {
        for (const char* shown : {"mesh", "skin", "camera", "extensions", "weights"}) {
          any_emptied = node.erase(shown) > 0 || any_emptied;
        }
        continue;
      }
      const JsonPlace place = item("nodes", n);
      const auto extensions = place.find("extensions");
      const auto instances =
          extensions ? extensions->find("EXT_mesh_gpu_instancing") : std::nullopt;
      if (instances) {
        buffer_.keep_members(instances->member("attributes"),
                             node["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]);
      }
    }
    if (any_emptied) warn(warnings_, "what belongs to no scene is left out of its nodes");
  }

  void keep_skins() {
    for (std::int64_t i = 0; i < source_.count("skins"); ++i) {
      if (const auto matrices = item("skins", i).find("inverseBindMatrices")) {
        json()["skins"][i]["inverseBindMatrices"] = buffer_.keep(*matrices);
      }
    }
  }

  void keep_animations() {
    for (std::int64_t a = 0; a < source_.count("animations"); ++a) {
      const JsonPlace samplers = item("animations", a).member("samplers");
      for (std::int64_t i = 0; i < samplers.size(); ++i) {
        const JsonPlace place = samplers.item(i);
        Json& sampler = json()["animations"][a]["samplers"][i];
        sampler["input"] = buffer_.keep(place.member("input"));
        sampler["output"] = buffer_.keep(place.member("output"));
      }
    }
  }

  void keep_images() {
    for (std::int64_t i = 0; i < source_.count("images"); ++i) {
      const JsonPlace place = item("images", i);
      Json& image = json()["images"][i];
      if (place.has("bufferView")) {
        const JsonPlace user = place.member("bufferView");
        image["bufferView"] = buffer_.copy_bytes(source_.buffer_view(user), user);
        continue;
      }
      const JsonPlace uri = place.member("uri");
      const std::optional<Bytes> bytes = image_file(uri);
      if (!bytes) continue;
      const std::string_view type =
          image_type({reinterpret_cast<const char*>(bytes->data()), bytes->size()});
      if (type.empty()) {
        warn(warnings_, place.pointer() + " is not a PNG or JPEG image; only its name is kept");
        continue;
      }
      image.erase("uri");
      image["mimeType"] = type;
      image["bufferView"] = buffer_.copy_bytes(*bytes, uri);
    }
  }

  std::optional<Bytes> image_file(const JsonPlace& uri) {
    const std::string scheme = uri_scheme(uri.text());
    if (scheme == "data") return decode_data_uri(uri);
    if (!scheme.empty()) return std::nullopt;  // a remote image keeps its URI
    const std::string name = decode_relative_uri(uri);
    try {
      Bytes bytes = resource_(name, kLargestImage);
      budget_.add_file(static_cast<std::int64_t>(bytes.size()));
      return bytes;
    } catch (const InputError& error) {
      warn(warnings_, "image '" + name + "' is not read, only its name is kept: " + error.what());
    } catch (const std::filesystem::filesystem_error&) {
      warn(warnings_, "image '" + name + "' not found, only its name is kept");
    }
    return std::nullopt;
  }

  GltfDocument& source_;
  const GltfResource& resource_;
  GltfBudget& budget_;
  std::vector<std::string>& warnings_;
  GltfScene shell_;
  ShellBuffer buffer_;
};

}  // namespace

bool is_kept_extension(const std::string& name) {
  constexpr std::array<std::string_view, 12> kKept = {kCesiumRtc,
                                                      "EXT_mesh_gpu_instancing",
                                                      "EXT_texture_avif",
                                                      "EXT_texture_webp",
                                                      "KHR_animation_pointer",
                                                      "KHR_lights_punctual",
                                                      "KHR_node_visibility",
                                                      "KHR_mesh_quantization",
                                                      "KHR_texture_basisu",
                                                      "KHR_texture_transform",
                                                      "KHR_xmp_json_ld",
                                                      "MSFT_texture_dds"};
  return name.starts_with("KHR_materials_") ||
         std::find(kKept.begin(), kKept.end(), name) != kKept.end();
}

GltfScene read_gltf_shell(GltfDocument& source, const GltfKept& kept, const GltfResource& resource,
                          GltfBudget& budget, std::vector<std::string>& warnings) {
  return ShellReader(source, resource, budget, warnings).read(kept);
}

}  // namespace manip3d
