#include "io/gltf_document.hpp"

#include <algorithm>
#include <array>
#include <cctype>
#include <cstring>
#include <limits>
#include <string_view>
#include <type_traits>
#include <utility>

#include "manip3d/error.hpp"
#include "parse/base64.hpp"
#include "parse/json_text.hpp"
#include "parse/letters.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kMaxCount = std::numeric_limits<std::int32_t>::max();
constexpr std::int64_t kMaxLength = std::int64_t{1} << 53;  // JSON numbers are exact up to this
constexpr std::int64_t kBytesPerValue = 64;                 // bytes of a JSON value as an object
constexpr std::int64_t kHeaderBytes = 12;
constexpr std::int64_t kChunkHeaderBytes = 8;
constexpr std::uint32_t kJsonChunk = 0x4E4F534A;    // "JSON"
constexpr std::uint32_t kBinaryChunk = 0x004E4942;  // "BIN\0"

template <typename T>
T load(const std::byte* data) {  // little endian, like all supported machines
  T value;
  std::memcpy(&value, data, sizeof(T));
  return value;
}

std::string_view as_text(ByteSpan bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

int component_bytes(GltfType type) {
  switch (type) {
    case GltfType::kByte:
    case GltfType::kUnsignedByte:
      return 1;
    case GltfType::kShort:
    case GltfType::kUnsignedShort:
      return 2;
    case GltfType::kUnsignedInt:
    case GltfType::kFloat:
      break;
  }
  return 4;
}

GltfType component_type(const JsonPlace& place) {
  const std::int64_t code = place.integer(5120, 5126);
  if (code == 5124) place.fail("expected 5120, 5121, 5122, 5123, 5125 or 5126, got 5124");
  return static_cast<GltfType>(code);
}

int components_of(const JsonPlace& place) {
  constexpr std::array<const char*, 4> kTypes = {"SCALAR", "VEC2", "VEC3", "VEC4"};
  if (place.text() == "MAT4") return 16;  // columns of MAT4 need no padding
  const auto found = std::find(kTypes.begin(), kTypes.end(), place.text());
  if (found == kTypes.end()) place.fail("expected SCALAR, VEC2, VEC3, VEC4 or MAT4 here");
  return static_cast<int>(found - kTypes.begin()) + 1;
}

/// Converts normalised integers to [0, 1] or [-1, 1]: glTF 2.0 section 3.11 (animations) and
/// KHR_mesh_quantization. The lowest signed value also means -1.
template <typename T>
double as_double(T value, bool normalized) {
  const auto number = static_cast<double>(value);
  if constexpr (std::is_integral_v<T>) {
    if (normalized) return std::max(number / std::numeric_limits<T>::max(), -1.0);
  }
  return number;
}

/// Calls `use(T{})` with the C++ type T of a component type.
template <typename Use>
void with_type(GltfType type, const Use& use) {
  switch (type) {
    case GltfType::kByte:
      return use(std::int8_t{});
    case GltfType::kUnsignedByte:
      return use(std::uint8_t{});
    case GltfType::kShort:
      return use(std::int16_t{});
    case GltfType::kUnsignedShort:
      return use(std::uint16_t{});
    case GltfType::kUnsignedInt:
      return use(std::uint32_t{});
    case GltfType::kFloat:
      return use(float{});
  }
}

std::vector<std::uint32_t> load_indices(const GltfAccessor::Elements& elements,
                                        std::int64_t count) {
  std::vector<std::uint32_t> indices(count, 0);
  if (elements.data == nullptr) return indices;
  with_type(elements.type, [&](auto zero) {
    using T = decltype(zero);
    const std::byte* data = elements.data;
    for (std::uint32_t& index : indices) {
      index = static_cast<std::uint32_t>(load<T>(data));
      data += elements.stride;
    }
  });
  return indices;
}

void check_index_type(const JsonPlace& place, GltfType type) {
  if (type == GltfType::kUnsignedByte || type == GltfType::kUnsignedShort ||
      type == GltfType::kUnsignedInt) {
    return;
  }
  place.fail("expected unsigned integers (5121, 5123 or 5125) as indices, got component type " +
             std::to_string(static_cast<int>(type)));
}

std::string decode_percent(const JsonPlace& place, std::string_view text) {
  std::string decoded;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] != '%') {
      decoded += text[i];
      continue;
    }
    const auto digit = [&](std::size_t at) {
      const char c = at < text.size() ? text[at] : '?';
      if (std::isxdigit(static_cast<unsigned char>(c)) == 0) {
        place.fail("expected two hexadecimal digits after % in a URI");
      }
      return c <= '9' ? c - '0' : (c | 0x20) - 'a' + 10;
    };
    decoded += static_cast<char>(16 * digit(i + 1) + digit(i + 2));
    i += 2;
  }
  if (decoded.find('\0') != std::string::npos) place.fail("a URI holds a zero byte");
  return decoded;
}

}  // namespace

std::string uri_scheme(const std::string& uri) {
  const std::size_t colon = uri.find(':');
  if (colon == std::string::npos || uri.find('/') < colon) return "";
  return lower_case(std::string_view(uri).substr(0, colon));
}

Bytes decode_data_uri(const JsonPlace& uri) {
  const std::string_view text = uri.text();
  const std::size_t comma = text.find(',');
  if (comma == std::string_view::npos) uri.fail("expected data:...;base64,..., got no comma");
  if (!text.substr(0, comma).ends_with(";base64")) uri.fail("expected a data URI in base64");
  return decode_base64(uri, text.substr(comma + 1));
}

std::string decode_relative_uri(const JsonPlace& uri) {
  const std::string scheme = uri_scheme(uri.text());
  if (!scheme.empty())
    uri.fail("expected a relative path or data:, got a URI of \"" + scheme + ":\"");
  std::string path = decode_percent(uri, uri.text());
  if (path.empty()) uri.fail("expected a file name, got an empty URI");
  return path;
}

void GltfAccessor::decode(double* out) const {
  if (decode_any(out)) return;
  const double* bad = std::find_if_not(out, out + count * num_components,
                                       [](double value) { return std::isfinite(value); });
  place.fail("expected finite numbers, got " + number_text(*bad) + " in element " +
             std::to_string((bad - out) / num_components));
}

bool GltfAccessor::decode_any(double* out) const {
  const auto load_row = [&](const std::byte* data, GltfType type, double* row) {
    with_type(type, [&](auto zero) {
      using T = decltype(zero);
      for (int c = 0; c < num_components; ++c) {
        row[c] = as_double(load<T>(data + c * static_cast<int>(sizeof(T))), normalized);
      }
    });
  };
  const std::int64_t num_values = count * num_components;
  if (dense.data == nullptr) {
    std::fill_n(out, num_values, 0.0);
  } else {
    for (std::int64_t row = 0; row < count; ++row) {
      load_row(dense.data + row * dense.stride, dense.type, out + row * num_components);
    }
  }
  std::int64_t previous = -1;
  std::int64_t replacement = 0;
  for (const std::uint32_t row : load_indices(sparse_indices, num_sparse)) {
    if (row >= count || row <= previous) {
      place.fail("sparse: expected rising indices below " + std::to_string(count) + ", got " +
                 std::to_string(row) + " after " + std::to_string(previous));
    }
    previous = row;
    load_row(sparse_values.data + replacement++ * sparse_values.stride, sparse_values.type,
             out + row * num_components);
  }
  return std::all_of(out, out + num_values, [](double value) { return std::isfinite(value); });
}

void GltfAccessor::check_indices() const {
  check_index_type(place, dense.type);
  if (num_components != 1 || normalized) place.fail("expected plain SCALAR indices");
}

std::vector<std::uint32_t> GltfAccessor::decode_indices() const {
  if (num_sparse == 0) return load_indices(dense, count);
  std::vector<double> values(count);
  decode(values.data());  // double holds all 32-bit indices
  return {values.begin(), values.end()};
}

GltfDocument::GltfDocument(ByteSpan file, const GltfResource& resource, GltfBudget& budget)
    : resource_(resource), budget_(budget) {
  if (as_text(file).starts_with("glTF")) {
    split_chunks(file);
  } else {
    parse_json(file);
  }
}

void GltfDocument::split_chunks(ByteSpan file) {
  auto size = static_cast<std::int64_t>(file.size());
  if (size < kHeaderBytes) throw FormatError::at_byte(size, "GLB: the header is cut off");
  if (const auto version = load<std::uint32_t>(file.data() + 4); version != 2) {
    throw FormatError::at_byte(4, "GLB: expected version 2, got " + std::to_string(version));
  }
  const std::int64_t whole = load<std::uint32_t>(file.data() + 8);
  if (whole > size || whole < kHeaderBytes) {
    throw FormatError::at_byte(8, "GLB: the header says " + std::to_string(whole) +
                                      " bytes, the file has " + std::to_string(size));
  }
  size = whole;  // what follows is no part of the asset
  ByteSpan text;
  for (std::int64_t at = kHeaderBytes; at < size;) {
    if (size - at < kChunkHeaderBytes) throw FormatError::at_byte(at, "GLB: a chunk is cut off");
    const std::int64_t length = load<std::uint32_t>(file.data() + at);
    const auto type = load<std::uint32_t>(file.data() + at + 4);
    const std::int64_t begin = at + kChunkHeaderBytes;
    if (length > size - begin) {
      throw FormatError::at_byte(at, "GLB: the chunk says " + std::to_string(length) +
                                         " bytes, the file has " + std::to_string(size - begin));
    }
    const ByteSpan chunk = file.subspan(begin, length);
    if (at == kHeaderBytes) {
      if (type != kJsonChunk)
        throw FormatError::at_byte(at + 4, "GLB: expected a JSON chunk first");
      text = chunk;
      json_offset_ = begin;
    } else if (type == kBinaryChunk && !binary_chunk_) {
      binary_chunk_ = chunk;
      binary_offset_ = begin;
    }
    at = begin + length;
  }
  if (json_offset_ == 0) throw FormatError::at_byte(size, "GLB: no JSON chunk");
  parse_json(text);
}

void GltfDocument::parse_json(ByteSpan bytes) {
  const std::string_view text = as_text(bytes);
  budget_.charge(count_json_values(text, json_offset_) * kBytesPerValue, "JSON");
  json_ = manip3d::parse_json(text, json_offset_);
}

bool GltfDocument::place_meshes_without_nodes() {
  const std::int64_t num_meshes = count("meshes");
  if (num_meshes == 0 || count("nodes") > 0) return false;
  constexpr std::int64_t kValuesPerNode = 3;  // the node, its member, and its index among the roots
  budget_.charge(num_meshes * kValuesPerNode * kBytesPerValue, "/meshes");
  for (const char* array : {"nodes", "scenes", "scene"}) json_.erase(array);
  for (std::int64_t m = 0; m < num_meshes; ++m) json_["nodes"].push_back({{"mesh", m}});
  for (std::int64_t m = 0; m < num_meshes; ++m) json_["scenes"][0]["nodes"].push_back(m);
  return true;
}

JsonPlace GltfDocument::object(const char* array, const JsonPlace& user) const {
  const std::int64_t size = count(array);
  if (size == 0) user.fail(std::string("the file has no ") + array);
  return root().member(array).item(user.integer(0, size - 1));
}

std::int64_t GltfDocument::count(const char* array) const {
  const auto found = root().find(array);
  return found ? found->size() : 0;
}

Bytes GltfDocument::read_external(const JsonPlace& uri, std::int64_t length) {
  try {
    Bytes bytes = resource_(decode_relative_uri(uri), length);
    budget_.add_file(static_cast<std::int64_t>(bytes.size()));
    budget_.charge(static_cast<std::int64_t>(bytes.size()), uri.pointer());
    return bytes;
  } catch (const InputError& error) {
    uri.fail(error.what());
  }
}

ByteSpan GltfDocument::buffer(const JsonPlace& user) {
  const JsonPlace place = object("buffers", user);
  const std::int64_t length = place.member("byteLength").integer(0, kMaxLength);
  const auto uri = place.find("uri");
  ByteSpan bytes;
  std::int64_t offset = json_offset_;
  if (uri) {
    auto known = buffers_.find(place.pointer());
    if (known == buffers_.end()) {
      const bool embedded = uri_scheme(uri->text()) == "data";
      Bytes read = embedded ? decode_data_uri(*uri) : read_external(*uri, length);
      known = buffers_.emplace(place.pointer(), std::move(read)).first;
    }
    bytes = known->second;
  } else if (place.pointer() == "/buffers/0" && binary_chunk_) {
    bytes = *binary_chunk_;
    offset = binary_offset_;
  } else {
    place.fail("the buffer has no data");
  }
  if (length > static_cast<std::int64_t>(bytes.size())) {
    throw FormatError::at_byte(offset, place.pointer() + "/byteLength: says " +
                                           std::to_string(length) + " bytes, the buffer has " +
                                           std::to_string(bytes.size()));
  }
  return bytes.first(length);
}

ByteSpan GltfDocument::buffer_view(const JsonPlace& user) {
  const JsonPlace view = object("bufferViews", user);
  const auto packed = meshopt_extension(view);
  return packed ? decoded_view(view, *packed) : stored_bytes(view);
}

ByteSpan GltfDocument::stored_bytes(const JsonPlace& place) {
  const ByteSpan bytes = buffer(place.member("buffer"));
  const auto size = static_cast<std::int64_t>(bytes.size());
  const auto given = place.find("byteOffset");
  const std::int64_t offset = given ? given->integer(0, kMaxLength) : 0;
  const std::int64_t length = place.member("byteLength").integer(0, kMaxLength);
  if (offset + length > size) {
    place.fail("bytes " + std::to_string(offset) + " to " + std::to_string(offset + length) +
               " of a buffer of " + std::to_string(size));
  }
  return bytes.subspan(offset, length);
}

GltfAccessor::Elements GltfDocument::elements(const JsonPlace& owner, GltfType type,
                                              std::int64_t num_elements, int num_components) {
  const JsonPlace user = owner.member("bufferView");
  const ByteSpan bytes = buffer_view(user);
  const std::int64_t element = std::int64_t{component_bytes(type)} * num_components;
  const auto stride_given = object("bufferViews", user).find("byteStride");
  const std::int64_t stride = stride_given ? stride_given->integer(element, 252) : element;
  const auto offset_given = owner.find("byteOffset");
  const std::int64_t offset = offset_given ? offset_given->integer(0, kMaxLength) : 0;
  const auto size = static_cast<std::int64_t>(bytes.size());
  if (num_elements > 0 && offset + (num_elements - 1) * stride + element > size) {
    owner.fail(std::to_string(num_elements) + " elements of " + std::to_string(element) +
               " bytes, " + std::to_string(stride) + " apart from byte " + std::to_string(offset) +
               " on, do not fit into a bufferView of " + std::to_string(size));
  }
  return {num_elements > 0 ? bytes.data() + offset : nullptr, stride, type};
}

GltfAccessor GltfDocument::read_accessor(const JsonPlace& place) {
  GltfAccessor accessor{.place = place};
  const GltfType type = component_type(place.member("componentType"));
  accessor.dense.type = type;
  accessor.count = place.member("count").integer(0, kMaxCount);
  accessor.num_components = components_of(place.member("type"));
  if (const auto normalized = place.find("normalized")) accessor.normalized = normalized->boolean();
  // Some exporters say so of floating-point numbers, which stand for themselves.
  if (type == GltfType::kFloat) accessor.normalized = false;
  if (accessor.normalized && component_bytes(type) == 4) {
    place.fail("expected 8 or 16 bit integers to be normalized");
  }
  if (place.has("bufferView")) {
    accessor.dense = elements(place, type, accessor.count, accessor.num_components);
  }
  if (const auto sparse = place.find("sparse")) {
    accessor.num_sparse = sparse->member("count").integer(0, accessor.count);
    const JsonPlace indices = sparse->member("indices");
    const GltfType index_type = component_type(indices.member("componentType"));
    check_index_type(indices, index_type);
    accessor.sparse_indices = elements(indices, index_type, accessor.num_sparse, 1);
    accessor.sparse_values =
        elements(sparse->member("values"), type, accessor.num_sparse, accessor.num_components);
  }
  return accessor;
}

const GltfAccessor& GltfDocument::accessor(const JsonPlace& user) {
  const JsonPlace place = object("accessors", user);
  const auto known = accessors_.find(place.pointer());
  if (known != accessors_.end()) return known->second;
  return accessors_.emplace(place.pointer(), read_accessor(place)).first->second;
}

const GltfAccessor* GltfDocument::attribute(const JsonPlace& attributes, const char* name,
                                            int fewest, int most) {
  const auto user = attributes.find(name);
  if (!user) return nullptr;
  const GltfAccessor& found = accessor(*user);
  if (found.num_components < fewest || found.num_components > most) {
    found.place.fail(std::string("the type does not suit ") + name);
  }
  return &found;
}

bool has_triangles(const JsonPlace& primitive) {
  const auto mode = primitive.find("mode");
  return !mode || mode->integer(0, kModeTriangleFan) >= kModeTriangles;
}

}  // namespace manip3d
