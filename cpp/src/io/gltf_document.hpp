#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "io/gltf.hpp"
#include "parse/json_place.hpp"

namespace manip3d {

using Bytes = std::vector<std::byte>;
using ByteSpan = std::span<const std::byte>;

inline constexpr const char* kDraco = "KHR_draco_mesh_compression";

// Modes of a primitive, glTF 2.0, section 5.24.4; the smaller ones are points and lines.
inline constexpr std::int64_t kModeTriangles = 4;
inline constexpr std::int64_t kModeTriangleStrip = 5;
inline constexpr std::int64_t kModeTriangleFan = 6;

/// Component types of glTF accessors; the values are those in files (from OpenGL).
enum class GltfType : int {
  kByte = 5120,
  kUnsignedByte = 5121,
  kShort = 5122,
  kUnsignedShort = 5123,
  kUnsignedInt = 5125,
  kFloat = 5126,
};

/// A checked accessor: all elements and all sparse replacements lie inside its buffer.
struct GltfAccessor {
  struct Elements {
    const std::byte* data = nullptr;  ///< Null: all elements are zero.
    std::int64_t stride = 0;
    GltfType type = GltfType::kFloat;
  };
  JsonPlace place;
  std::int64_t count = 0;
  int num_components = 1;
  bool normalized = false;
  Elements dense = {};
  std::int64_t num_sparse = 0;
  Elements sparse_indices = {};
  Elements sparse_values = {};

  /// Writes `count` rows of `num_components` finite doubles, row by row.
  void decode(double* out) const;
  /// Writes the same for an attribute that may be missing; returns whether all values are finite.
  [[nodiscard]] bool decode_any(double* out) const;
  /// Checks that it contains unsigned integers of type SCALAR.
  /// @throws FormatError  it does not.
  void check_indices() const;
  /// The values of an accessor that passed check_indices().
  [[nodiscard]] std::vector<std::uint32_t> decode_indices() const;
};

/// The elements of an accessor, decoded from a Draco stream.
struct DracoElements {
  std::size_t accessor;
  std::int64_t stride;
  bool is_attribute;
  Bytes bytes;
};

/// The JSON of a .gltf or .glb file and the bytes that it refers to. All of it is checked before it
/// is used.
class GltfDocument {
 public:
  GltfDocument(ByteSpan file, const GltfResource& resource, GltfBudget& budget);

  [[nodiscard]] JsonPlace root() const { return {json_, "", json_offset_}; }
  [[nodiscard]] const JsonPlace::Json& json() const { return json_; }
  /// The element of a top-level array such as "accessors" with the index that `user` contains.
  [[nodiscard]] JsonPlace object(const char* array, const JsonPlace& user) const;
  /// Number of elements of a top-level array; 0: there is no such array.
  [[nodiscard]] std::int64_t count(const char* array) const;

  const GltfAccessor& accessor(const JsonPlace& user);
  /// The accessor of an attribute; null: there is no such attribute.
  /// @throws FormatError  the number of components is not in [fewest, most].
  const GltfAccessor* attribute(const JsonPlace& attributes, const char* name, int fewest,
                                int most);
  /// The bytes of a bufferView; compressed ones are decoded (see meshopt_extension()).
  ByteSpan buffer_view(const JsonPlace& user);

  /// Replaces Draco streams (kDraco) of the meshes that are read by plain accessors.
  /// @throws FormatError  a stream is damaged or does not fit its accessors.
  void expand_draco(const DracoDecoder& decode, const std::vector<bool>& is_read);
  /// Gives each mesh of a file without nodes a node of its own.
  /// @return  true if it did.
  bool place_meshes_without_nodes();

 private:
  void split_chunks(ByteSpan file);
  void parse_json(ByteSpan text);
  void add_elements(DracoElements elements);
  ByteSpan buffer(const JsonPlace& user);
  /// The bytes given by an object with `buffer`, `byteOffset` and `byteLength`.
  ByteSpan stored_bytes(const JsonPlace& place);
  ByteSpan decoded_view(const JsonPlace& view, const JsonPlace& packed);
  Bytes read_external(const JsonPlace& uri, std::int64_t length);
  GltfAccessor read_accessor(const JsonPlace& place);
  GltfAccessor::Elements elements(const JsonPlace& owner, GltfType type, std::int64_t count,
                                  int num_components);

  const GltfResource& resource_;
  GltfBudget& budget_;
  JsonPlace::Json json_;
  std::int64_t json_offset_ = 0;
  std::optional<ByteSpan> binary_chunk_;
  std::int64_t binary_offset_ = 0;
  /// Decoded data URIs, external files, and decompressed views, by JSON pointer.
  std::map<std::string, Bytes> buffers_;
  std::map<std::string, GltfAccessor> accessors_;  ///< By JSON pointer.
};

/// An array of N numbers.
/// @throws FormatError  `place` has none.
template <int N>
Eigen::Vector<double, N> vector_of(const JsonPlace& place) {
  if (place.size() != N) place.fail("expected " + std::to_string(N) + " numbers");
  Eigen::Vector<double, N> values;
  for (int i = 0; i < N; ++i) values[i] = place.item(i).number();
  return values;
}

/// Does a primitive consist of triangles (list, strip or fan)?
bool has_triangles(const JsonPlace& primitive);
/// Is it EXT_meshopt_compression or KHR_meshopt_compression? Version 0 of the latter is the same
/// format.
bool is_meshopt_extension(std::string_view name);
/// The description of the compressed bytes in a bufferView with such an extension; empty: none.
std::optional<JsonPlace> meshopt_extension(const JsonPlace& view);

/// The part of a URI before ":" in lower case; "": a relative reference.
std::string uri_scheme(const std::string& uri);
/// The bytes of a data: URI.
/// @throws FormatError  it is not base64, or malformed.
Bytes decode_data_uri(const JsonPlace& uri);
/// A relative reference with its %XX decoded.
/// @throws FormatError  it is malformed, or has a scheme.
std::string decode_relative_uri(const JsonPlace& uri);

}  // namespace manip3d
