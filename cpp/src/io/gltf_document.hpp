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

/// Component types of glTF accessors; the values are those of the file (OpenGL's).
enum class GltfType : int {
  kByte = 5120,
  kUnsignedByte = 5121,
  kShort = 5122,
  kUnsignedShort = 5123,
  kUnsignedInt = 5125,
  kFloat = 5126,
};

/// A checked accessor: every element, and every sparse replacement, lies inside its buffer.
struct GltfAccessor {
  struct Elements {
    const std::byte* data = nullptr;  ///< nullptr: zeros.
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

  /// Writes `count` rows of `num_components` finite doubles, row after row.
  void decode(double* out) const;
  /// Whether it holds SCALAR unsigned integers. @throws FormatError  it does not.
  void check_indices() const;
  /// The values of an accessor that passed check_indices().
  [[nodiscard]] std::vector<std::uint32_t> decode_indices() const;
};

/// The elements of an accessor that lay in a Draco stream.
struct DracoElements {
  std::size_t accessor;
  std::int64_t stride;
  bool is_attribute;
  Bytes bytes;
};

/// The JSON of a .gltf or .glb and the bytes it refers to; nothing is believed unchecked.
class GltfDocument {
 public:
  GltfDocument(ByteSpan file, const GltfResource& resource, GltfBudget& budget);

  [[nodiscard]] JsonPlace root() const { return {json_, "", json_offset_}; }
  [[nodiscard]] const JsonPlace::Json& json() const { return json_; }
  /// The `index`-th object of a top-level array such as "accessors"; `user` is who refers to it.
  [[nodiscard]] JsonPlace object(const char* array, const JsonPlace& user) const;
  /// Elements of a top-level array; 0 where it is absent.
  [[nodiscard]] std::int64_t count(const char* array) const;

  const GltfAccessor& accessor(const JsonPlace& user);
  /// The accessor of an attribute; null where there is none.
  /// @throws FormatError  its elements have fewer or more components.
  const GltfAccessor* attribute(const JsonPlace& attributes, const char* name, int fewest,
                                int most);
  /// The bytes of a view, decoded where they are compressed (meshopt_extension()).
  ByteSpan buffer_view(const JsonPlace& user);

  /// Puts plain accessors in the place of Draco streams (kDraco), of the meshes that are read.
  /// @throws FormatError  a stream that is damaged, or does not suit its accessors.
  void expand_draco(const DracoDecoder& decode, const std::vector<bool>& is_read);
  /// Gives each mesh of a file without nodes a node of its own. @return whether it did.
  bool place_meshes_without_nodes();

 private:
  void split_chunks(ByteSpan file);
  void parse_json(ByteSpan text);
  void add_elements(DracoElements elements);
  ByteSpan buffer(const JsonPlace& user);
  /// The bytes that an object with `buffer`, `byteOffset` and `byteLength` names.
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
  /// By pointer: decoded data URIs and external files, and views that were compressed.
  std::map<std::string, Bytes> buffers_;
  std::map<std::string, GltfAccessor> accessors_;  ///< By pointer.
};

/// An array of N numbers. @throws FormatError  it is not that.
template <int N>
Eigen::Vector<double, N> vector_of(const JsonPlace& place) {
  if (place.size() != N) place.fail("expected " + std::to_string(N) + " numbers");
  Eigen::Vector<double, N> values;
  for (int i = 0; i < N; ++i) values[i] = place.item(i).number();
  return values;
}

/// Whether a primitive is neither points nor lines.
bool has_triangles(const JsonPlace& primitive);
/// Whether it is EXT_meshopt_compression or KHR_meshopt_compression, of which version 0 is the
/// same.
bool is_meshopt_extension(std::string_view name);
/// Description of the compressed bytes in such an extension of a bufferView.
std::optional<JsonPlace> meshopt_extension(const JsonPlace& view);

/// The part of a URI before ":" in lower case, or "" for a relative reference.
std::string uri_scheme(const std::string& uri);
/// The bytes of a data: URI. @throws FormatError  not base64, or malformed.
Bytes decode_data_uri(const JsonPlace& uri);
/// A relative reference with its %XX undone. @throws FormatError  malformed, or with a scheme.
std::string decode_relative_uri(const JsonPlace& uri);

}  // namespace manip3d
