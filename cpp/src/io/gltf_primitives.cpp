#include "io/gltf_primitives.hpp"

#include <algorithm>
#include <limits>
#include <numeric>

#include "io/gltf_shell.hpp"
#include "io/warnings.hpp"

namespace manip3d {
namespace {

/// Does a material use a set of texture coordinates other than the first?
bool needs_more_texcoords(const JsonPlace::Json& value) {
  if (!value.is_structured()) return false;
  if (value.is_object()) {
    const auto set = value.find("texCoord");
    if (set != value.end() && set->is_number() && set->get<double>() != 0.0) return true;
  }
  return std::any_of(value.begin(), value.end(), needs_more_texcoords);
}

std::optional<GltfPrimitive> read_primitive(GltfDocument& document, const JsonPlace& place,
                                            GltfTexcoords texcoords,
                                            std::vector<std::string>& warnings) {
  GltfPrimitive p{.place = place};
  if (const auto mode = place.find("mode")) p.mode = mode->integer(0, kModeTriangleFan);
  if (p.mode < kModeTriangles) {
    warn(warnings, "points and lines are left out");
    return std::nullopt;
  }
  p.targets = place.find("targets");
  const JsonPlace attributes = place.member("attributes");
  if (attributes.has("TANGENT")) {
    warn(warnings, "tangents are left out: viewers compute them from the texture coordinates");
  }
  p.position = document.attribute(attributes, "POSITION", 3, 3);
  if (p.position == nullptr) {
    warn(warnings, "primitives without POSITION are left out");
    return std::nullopt;
  }
  p.normal = document.attribute(attributes, "NORMAL", 3, 3);
  if (const auto user = place.find("material")) {
    const JsonPlace material = document.object("materials", *user);  // checks the index
    p.material =
        static_cast<std::int32_t>(user->integer(0, std::numeric_limits<std::int32_t>::max()));
    if (texcoords == GltfTexcoords::kPlaced) p.texture = first_texture_transform(material);
  }
  p.texcoord = document.attribute(attributes, texcoords_in_set(p.texture.set).c_str(), 2, 2);
  p.color = document.attribute(attributes, "COLOR_0", 3, 4);
  p.shows_alpha = shows_alpha(document, place);
  if (texcoords == GltfTexcoords::kStored) p.more_texcoords = more_texcoords_of(document, place);
  std::vector<const GltfAccessor*> others = p.more_texcoords;
  others.insert(others.begin(), {p.normal, p.texcoord, p.color});
  for (const GltfAccessor* other : others) {
    if (other != nullptr && other->count != p.position->count) {
      other->place.fail("has " + std::to_string(other->count) + " elements, POSITION of " +
                        p.place.pointer() + " " + std::to_string(p.position->count));
    }
  }
  if (const auto indices = place.find("indices")) {
    p.indices = &document.accessor(*indices);
    p.indices->check_indices();
  }
  if (p.mode == kModeTriangles && p.num_corners() % 3 != 0) {
    place.fail(std::to_string(p.num_corners()) + " corners do not make whole triangles");
  }
  return p;
}

}  // namespace

std::int64_t GltfPrimitive::num_corners() const {
  return indices != nullptr ? indices->count : position->count;
}

std::int64_t GltfPrimitive::num_faces() const {
  return mode == kModeTriangles ? num_corners() / 3 : std::max<std::int64_t>(num_corners() - 2, 0);
}

std::vector<std::uint32_t> GltfPrimitive::corners() const {
  if (indices == nullptr) {
    std::vector<std::uint32_t> corners(position->count);
    std::iota(corners.begin(), corners.end(), 0U);
    return corners;
  }
  std::vector<std::uint32_t> corners = indices->decode_indices();
  for (std::size_t i = 0; i < corners.size(); ++i) {
    if (corners[i] < static_cast<std::uint64_t>(position->count)) continue;
    indices->place.fail("element " + std::to_string(i) + " is " + std::to_string(corners[i]) +
                        ", " + place.pointer() + " has " + std::to_string(position->count) +
                        " vertices");
  }
  return corners;
}

std::array<std::int64_t, 3> GltfPrimitive::face_corners(std::int64_t face) const {
  if (mode == kModeTriangleStrip) return {face, face + 1 + face % 2, face + 2 - face % 2};
  if (mode == kModeTriangleFan) return {face + 1, face + 2, 0};
  return {3 * face, 3 * face + 1, 3 * face + 2};
}

std::vector<GltfPrimitive> read_primitives(GltfDocument& document, std::int64_t mesh,
                                           GltfTexcoords texcoords,
                                           std::vector<std::string>& warnings) {
  const JsonPlace list = document.root().member("meshes").item(mesh).member("primitives");
  std::vector<GltfPrimitive> primitives;
  for (std::int64_t i = 0; i < list.size(); ++i) {
    auto primitive = read_primitive(document, list.item(i), texcoords, warnings);
    if (primitive) primitives.push_back(*std::move(primitive));
  }
  return primitives;
}

bool shows_alpha(const GltfDocument& document, const JsonPlace& primitive) {
  const auto user = primitive.find("material");
  const auto mode = user ? document.object("materials", *user).find("alphaMode") : std::nullopt;
  return mode && mode->text() != "OPAQUE";
}

bool reads_more_texcoords(const GltfDocument& document, const JsonPlace& primitive) {
  const auto needs = [&](const std::optional<JsonPlace>& material) {
    return material && needs_more_texcoords(document.object("materials", *material).value());
  };
  if (needs(primitive.find("material"))) return true;
  const auto extensions = primitive.find("extensions");
  const auto variants = extensions ? extensions->find(kVariants) : std::nullopt;
  const auto mappings = variants ? variants->find("mappings") : std::nullopt;
  for (std::int64_t i = 0; mappings && i < mappings->size(); ++i) {
    if (needs(mappings->item(i).find("material"))) return true;
  }
  return false;
}

std::vector<const GltfAccessor*> more_texcoords_of(GltfDocument& document,
                                                   const JsonPlace& primitive) {
  std::vector<const GltfAccessor*> sets;
  if (!reads_more_texcoords(document, primitive)) return sets;
  const JsonPlace attributes = primitive.member("attributes");
  for (;;) {
    const std::string name = texcoords_in_set(std::ssize(sets) + 1);
    const GltfAccessor* set = document.attribute(attributes, name.c_str(), 2, 2);
    if (set == nullptr) return sets;
    sets.push_back(set);
  }
}

}  // namespace manip3d
