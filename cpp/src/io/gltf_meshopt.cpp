#include <array>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "io/gltf_document.hpp"
#include "io/meshopt_codec.hpp"

namespace manip3d {
namespace {

constexpr std::array<const char*, 2> kMeshoptNames = {"EXT_meshopt_compression",
                                                      "KHR_meshopt_compression"};
constexpr std::int64_t kMaxMeshoptCount = std::numeric_limits<std::int32_t>::max();
constexpr std::int64_t kMaxMeshoptStride = 256;

/// The index of a text in a list.
/// @throws FormatError  it is not in the list.
template <std::size_t N>
std::size_t place_in(const std::array<const char*, N>& names, const JsonPlace& text) {
  std::string listed;
  for (std::size_t i = 0; i < N; ++i) {
    if (text.text() == names[i]) return i;
    listed += std::string(i == 0 ? "" : ", ") + names[i];
  }
  text.fail("expected one of " + listed + ", got \"" + text.text() + "\"");
}

MeshoptLayout layout_of(const JsonPlace& packed) {
  constexpr std::array<const char*, 3> kModes = {"ATTRIBUTES", "TRIANGLES", "INDICES"};
  constexpr std::array<const char*, 5> kFilters = {"NONE", "OCTAHEDRAL", "QUATERNION",
                                                   "EXPONENTIAL", "COLOR"};
  MeshoptLayout layout;
  layout.count = packed.member("count").integer(1, kMaxMeshoptCount);
  layout.stride = packed.member("byteStride").integer(2, kMaxMeshoptStride);
  layout.mode = static_cast<MeshoptMode>(place_in(kModes, packed.member("mode")));
  if (const auto filter = packed.find("filter")) {
    layout.filter = static_cast<MeshoptFilter>(place_in(kFilters, *filter));
  }
  return layout;
}

}  // namespace

bool is_meshopt_extension(std::string_view name) {
  return name == kMeshoptNames[0] || name == kMeshoptNames[1];
}

std::optional<JsonPlace> meshopt_extension(const JsonPlace& view) {
  const auto extensions = view.find("extensions");
  if (!extensions) return std::nullopt;
  for (const char* name : kMeshoptNames) {
    if (auto packed = extensions->find(name)) return packed;
  }
  return std::nullopt;
}

ByteSpan GltfDocument::decoded_view(const JsonPlace& view, const JsonPlace& packed) {
  const auto known = buffers_.find(view.pointer());
  if (known != buffers_.end()) return known->second;
  const MeshoptLayout layout = layout_of(packed);
  const std::int64_t size = layout.count * layout.stride;
  const JsonPlace length = view.member("byteLength");
  if (length.integer(0, std::numeric_limits<std::int64_t>::max()) != size) {
    length.fail("expected " + std::to_string(size) + " as the meshopt stream has, got " +
                length.value().dump());
  }
  const ByteSpan stream = stored_bytes(packed);
  budget_.add_compressed(static_cast<std::int64_t>(stream.size()));
  budget_.charge(size, view.pointer());
  try {
    return buffers_.emplace(view.pointer(), decode_meshopt(stream, layout)).first->second;
  } catch (const FormatError& error) {
    packed.fail(std::string("damaged meshopt stream: ") + error.what());
  }
}

}  // namespace manip3d
