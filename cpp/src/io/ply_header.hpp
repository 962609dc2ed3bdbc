#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "parse/input_buffer.hpp"

/// @file
/// The header of a PLY file, for the readers of meshes and of points.
namespace manip3d::ply {

enum class Encoding : std::uint8_t { kAscii, kLittleEndian, kBigEndian };
enum class Type : std::uint8_t { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat, kDouble };

constexpr std::int64_t kTypeSizes[] = {1, 1, 2, 2, 4, 4, 4, 8};

constexpr std::int64_t size_of(Type type) { return kTypeSizes[static_cast<int>(type)]; }

/// Elements with the texture coordinates of faces, and which of them each face has.
constexpr const char* kTextureVertices = "multi_texture_vertex";
constexpr const char* kTextureFaces = "multi_texture_face";

// The meaning of a property for manip3d; all others are skipped.
enum Role : std::uint8_t {
  kX,
  kY,
  kZ,
  kNx,
  kNy,
  kNz,
  kRed,
  kGreen,
  kBlue,
  kAlpha,  // of vertices or faces
  kS,
  kT,  // of vertices
  kTexnumber,
  kMaterial,
  kHasTexcoord,  // of faces
  kNumScalars,
  kIndices,
  kTexcoord,  // lists
  kSkip
};

struct Property {
  Type type = Type::kFloat;
  bool is_list = false;
  Type count_type = Type::kUint8;
  Role role = kSkip;
  std::string name;
};

struct Element {
  std::string name;
  std::int64_t count = 0;
  std::int64_t line = 0;
  std::vector<Property> properties;

  [[nodiscard]] bool has(Role role) const {
    return std::any_of(properties.begin(), properties.end(),
                       [&](const Property& p) { return p.role == role; });
  }
  [[nodiscard]] std::int64_t least_bytes(Encoding encoding) const {
    std::int64_t bytes = 0;
    for (const Property& p : properties) {
      if (encoding == Encoding::kAscii) {
        bytes += 2;  // a digit and a separator at least
      } else {
        bytes += p.is_list ? size_of(p.count_type) : size_of(p.type);
      }
    }
    return bytes;
  }
};

struct Header {
  Encoding encoding = Encoding::kAscii;
  std::vector<Element> elements;
  std::map<std::int64_t, std::string> material_names;
  std::vector<std::string> texture_files;
  std::int64_t num_cols = -1, num_rows = -1;
  std::int64_t num_skipped = 0;
  std::vector<std::string> remarks;  ///< Complete lines of comment and obj_info.
};

/// The comment that names a material: `comment material N NAME`. Some readers refuse headers that
/// are not ASCII; other names are therefore written as `comment material_utf8 N NAME`, with `%` and
/// two hexadecimal digits for '%' and bytes that are not ASCII.
std::string material_comment(std::size_t index, const std::string& name);

/// Reads the header.
/// @throws FormatError  (with the line) it is malformed.
Header read_header(InputBuffer& input);

}  // namespace manip3d::ply
