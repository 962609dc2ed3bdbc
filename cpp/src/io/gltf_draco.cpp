#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "io/gltf_document.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kDracoTriangles = 4;
constexpr std::int64_t kMaxDracoId = std::numeric_limits<std::uint32_t>::max();
constexpr std::int64_t kBytesPerElement = 12;         // at least: three numbers per face or point
constexpr std::int64_t kJsonBytesPerAccessor = 1024;  // of a buffer and a bufferView as objects

template <typename T>
void store_draco(const JsonPlace& accessor, double value, std::byte* out) {
  if constexpr (std::is_integral_v<T>) {
    if (!(value >= std::numeric_limits<T>::lowest() && value <= std::numeric_limits<T>::max())) {
      accessor.fail("the Draco stream holds " + number_text(value) +
                    ", which its component type cannot");
    }
  }
  const T stored = static_cast<T>(value);
  std::memcpy(out, &stored, sizeof(T));
}

/// Converts the numbers of a stream to the component type T of an accessor. Attributes start at
/// multiples of four bytes (glTF 2.0 section 3.6.2.4).
template <typename T>
DracoElements encode_draco(const JsonPlace& accessor, std::size_t index,
                           const DracoMesh::Attribute& attribute, bool is_attribute) {
  if (std::is_integral_v<T> != attribute.is_integer) {
    accessor.fail(std::string("the Draco stream holds ") +
                  (attribute.is_integer ? "integers" : "floats") +
                  ", the component type says otherwise");
  }
  const std::int64_t columns = attribute.num_components;
  const auto packed = static_cast<std::int64_t>(sizeof(T)) * columns;
  const std::int64_t stride = is_attribute ? (packed + 3) / 4 * 4 : packed;
  const auto num_values = static_cast<std::int64_t>(attribute.values.size());
  DracoElements elements{index, stride, is_attribute, {}};
  elements.bytes.resize(num_values / columns * stride);
  for (std::int64_t i = 0; i < num_values; ++i) {
    const std::int64_t at =
        i / columns * stride + i % columns * static_cast<std::int64_t>(sizeof(T));
    store_draco<T>(accessor, attribute.values[i], elements.bytes.data() + at);
  }
  return elements;
}

DracoElements encode_draco_as(const JsonPlace& accessor, std::size_t index,
                              const DracoMesh::Attribute& attribute, bool is_attribute) {
  const JsonPlace type = accessor.member("componentType");
  switch (type.integer(5120, 5126)) {
    case 5120:
      return encode_draco<std::int8_t>(accessor, index, attribute, is_attribute);
    case 5121:
      return encode_draco<std::uint8_t>(accessor, index, attribute, is_attribute);
    case 5122:
      return encode_draco<std::int16_t>(accessor, index, attribute, is_attribute);
    case 5123:
      return encode_draco<std::uint16_t>(accessor, index, attribute, is_attribute);
    case 5125:
      return encode_draco<std::uint32_t>(accessor, index, attribute, is_attribute);
    case 5126:
      return encode_draco<float>(accessor, index, attribute, is_attribute);
    default:
      type.fail("expected 5120, 5121, 5122, 5123, 5125 or 5126, got 5124");
  }
}

/// Number of faces and points in the header of a stream, for which the library allocates memory
/// before it reads the rest. See Draco bitstream 2.2, sections 3 and 4; with edgebreaker, a face
/// has at most three points. Metadata (for example, names of feature identifiers) come before the
/// counts.
std::int64_t announced_elements(const JsonPlace& draco, ByteSpan stream) {
  constexpr std::size_t kHead = 11, kMethod = 8, kFlags = 10;
  constexpr unsigned kEdgebreaker = 1, kMetadata = 0x80;
  const auto byte = [&](std::size_t i) {
    if (i >= stream.size()) draco.fail("damaged Draco stream: it ends within its head");
    return std::to_integer<unsigned>(stream[i]);
  };
  std::size_t at = kHead;
  const auto count = [&] {
    std::int64_t value = 0;
    for (int shift = 0; shift < 35; shift += 7) {
      const unsigned part = byte(at++);
      value |= static_cast<std::int64_t>(part & 0x7FU) << shift;
      if ((part & 0x80U) == 0) break;
    }
    return value;
  };
  if ((byte(kFlags) & kMetadata) != 0) {
    const auto skip_name = [&] { at += 1 + std::size_t{byte(at)}; };
    // Depth first: each nested element follows its name.
    const auto skip_element = [&] {
      for (std::int64_t left = 1; left > 0; --left) {
        for (std::int64_t entries = count(); entries > 0; --entries) {
          skip_name();
          const std::int64_t size = count();
          at += static_cast<std::size_t>(size);
        }
        const std::int64_t within = count();
        left += within;
        if (left > 1) skip_name();
      }
    };
    for (std::int64_t attributes = count(); attributes > 0; --attributes) {
      count();  // identifier of the attribute
      skip_element();
    }
    skip_element();
  }
  const bool is_edgebreaker = byte(kMethod) == kEdgebreaker;
  if (is_edgebreaker) ++at;
  const std::int64_t first = count(), second = count();
  // Sequential encoding: faces, points; edgebreaker: vertices, faces.
  return is_edgebreaker ? first + 4 * second : first + second;
}

/// Decodes the streams that a document's primitives refer to, without changing the document.
class DracoReader {
 public:
  DracoReader(GltfDocument& document, const DracoDecoder& decode, GltfBudget& budget)
      : document_(document), decode_(decode), budget_(budget) {}

  /// Decodes the attributes and indices of a primitive, unless they exist as plain accessors too.
  void read(const JsonPlace& primitive) {
    const JsonPlace draco = primitive.member("extensions").member(kDraco);
    const JsonPlace attributes = primitive.member("attributes");
    if (is_plain(primitive, draco)) return;
    if (const auto mode = primitive.find("mode"); mode && mode->integer(0, 6) != kDracoTriangles) {
      mode->fail("expected triangles (4) of a Draco stream");
    }
    const DracoMesh& mesh = decoded(draco);
    const JsonPlace ids = draco.member("attributes");
    static_cast<void>(ids.member("POSITION"));
    for (const auto& [name, id] : ids.value().items()) {
      const JsonPlace place = ids.member(name.c_str());
      const auto found =
          mesh.attributes.find(static_cast<std::uint32_t>(place.integer(0, kMaxDracoId)));
      if (found == mesh.attributes.end()) place.fail("the Draco stream has no such attribute");
      add(attributes.member(name.c_str()), found->second, true);
    }
    add(primitive.member("indices"), mesh.corners, false);
  }

  std::vector<DracoElements> take() { return std::move(elements_); }

 private:
  /// Are all data of the stream available in bufferViews as well?
  [[nodiscard]] bool is_plain(const JsonPlace& primitive, const JsonPlace& draco) const {
    const JsonPlace attributes = primitive.member("attributes");
    const auto has_view = [&](const JsonPlace& user) {
      return document_.object("accessors", user).has("bufferView");
    };
    const auto indices = primitive.find("indices");
    if (!attributes.has("POSITION") || !indices || !has_view(*indices)) return false;
    const auto& ids = draco.member("attributes").value();
    if (!ids.is_object()) return false;
    return std::ranges::all_of(ids.items(), [&](const auto& item) {
      const auto user = attributes.find(item.key().c_str());
      return user && has_view(*user);
    });
  }

  const DracoMesh& decoded(const JsonPlace& draco) {
    const JsonPlace view = draco.member("bufferView");
    const std::string stream = document_.object("bufferViews", view).pointer();
    const auto known = meshes_.find(stream);
    if (known != meshes_.end()) return known->second;
    if (!decode_) draco.fail(std::string("extension ") + kDraco + " is not read");
    const ByteSpan bytes = document_.buffer_view(view);
    budget_.add_compressed(static_cast<std::int64_t>(bytes.size()));
    const std::int64_t announced = kBytesPerElement * announced_elements(draco, bytes);
    budget_.charge(announced, draco.pointer());
    DracoMesh mesh;
    try {
      mesh = decode_(bytes);
    } catch (const FormatError& error) {
      draco.fail(error.reason());
    }
    auto num_values = static_cast<std::int64_t>(mesh.corners.values.size());
    for (const auto& [id, attribute] : mesh.attributes) {
      num_values += static_cast<std::int64_t>(attribute.values.size());
    }
    const std::int64_t needed = num_values * static_cast<std::int64_t>(sizeof(double));
    budget_.charge(std::max<std::int64_t>(0, needed - announced), draco.pointer());
    return meshes_.emplace(stream, std::move(mesh)).first->second;
  }

  /// Adds an accessor. Primitives may share one if they also share its stream.
  void add(const JsonPlace& user, const DracoMesh::Attribute& attribute, bool is_attribute) {
    const JsonPlace accessor = document_.object("accessors", user);
    const auto [known, is_new] = sources_.try_emplace(accessor.pointer(), &attribute);
    if (!is_new) {
      if (known->second != &attribute) accessor.fail("two Draco attributes give its elements");
      return;
    }
    constexpr std::array<const char*, 4> kTypes = {"SCALAR", "VEC2", "VEC3", "VEC4"};
    const int columns = attribute.num_components;
    if (columns < 1 || columns > 4 || accessor.member("type").text() != kTypes[columns - 1]) {
      accessor.fail("the Draco stream has " + std::to_string(columns) +
                    " components, the type says otherwise");
    }
    const auto rows = static_cast<std::int64_t>(attribute.values.size()) / columns;
    const std::int64_t count = accessor.member("count").integer(0, kMaxDracoId);
    if (count != rows) {
      accessor.fail("says " + std::to_string(count) + " elements, the Draco stream has " +
                    std::to_string(rows));
    }
    const std::size_t index = user.integer(0, kMaxDracoId);
    elements_.push_back(encode_draco_as(accessor, index, attribute, is_attribute));
    budget_.charge(static_cast<std::int64_t>(elements_.back().bytes.size()) + kJsonBytesPerAccessor,
                   accessor.pointer());
  }

  GltfDocument& document_;
  const DracoDecoder& decode_;
  GltfBudget& budget_;
  std::map<std::string, DracoMesh> meshes_;  ///< By JSON pointer of the bufferView.
  /// By JSON pointer of the accessor.
  std::map<std::string, const DracoMesh::Attribute*> sources_;
  std::vector<DracoElements> elements_;
};

/// Does a primitive use the extension? A malformed primitive is refused later, when it is read.
bool has_draco(const JsonPlace::Json& primitive) {
  if (!primitive.is_object()) return false;
  const auto extensions = primitive.find("extensions");
  return extensions != primitive.end() && extensions->is_object() && extensions->contains(kDraco);
}

}  // namespace

void GltfDocument::expand_draco(const DracoDecoder& decode, const std::vector<bool>& is_read) {
  DracoReader reader(*this, decode, budget_);
  std::vector<std::pair<std::int64_t, std::int64_t>> found;
  for (std::int64_t m = 0; m < count("meshes"); ++m) {
    if (!is_read[m]) continue;
    const JsonPlace mesh = root().member("meshes").item(m);
    const auto list = mesh.is_object() ? mesh.find("primitives") : std::nullopt;
    if (!list || !list->value().is_array()) continue;
    for (std::int64_t i = 0; i < list->size(); ++i) {
      if (!has_draco(list->item(i).value())) continue;
      reader.read(list->item(i));
      found.emplace_back(m, i);
    }
  }
  for (DracoElements& elements : reader.take()) add_elements(std::move(elements));
  for (const auto& [m, i] : found) {
    JsonPlace::Json& primitive = json_["meshes"][m]["primitives"][i];
    primitive["extensions"].erase(kDraco);
    if (primitive["extensions"].empty()) primitive.erase("extensions");
  }
}

void GltfDocument::add_elements(DracoElements elements) {
  const std::size_t size = elements.bytes.size();
  const std::size_t buffer = json_["buffers"].size();
  JsonPlace::Json view = {{"buffer", buffer}, {"byteLength", size}};
  if (elements.is_attribute) view["byteStride"] = elements.stride;
  JsonPlace::Json& accessor = json_["accessors"][elements.accessor];
  accessor["bufferView"] = json_["bufferViews"].size();
  accessor.erase("byteOffset");
  json_["bufferViews"].push_back(std::move(view));
  json_["buffers"].push_back({{"byteLength", size}, {"uri", ""}});  // buffers_ has its bytes
  buffers_.emplace("/buffers/" + std::to_string(buffer), std::move(elements.bytes));
}

}  // namespace manip3d
