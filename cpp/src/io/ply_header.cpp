#include "io/ply_header.hpp"

#include <algorithm>
#include <charconv>
#include <string>
#include <string_view>
#include <system_error>

#include "parse/letters.hpp"
#include "parse/line_cursor.hpp"

namespace manip3d::ply {
namespace {

struct TypeName {
  std::string_view name;
  Type type;
};
constexpr TypeName kTypeNames[] = {
    {"char", Type::kInt8},     {"int8", Type::kInt8},     {"uchar", Type::kUint8},
    {"uint8", Type::kUint8},   {"short", Type::kInt16},   {"int16", Type::kInt16},
    {"ushort", Type::kUint16}, {"uint16", Type::kUint16}, {"int", Type::kInt32},
    {"int32", Type::kInt32},   {"uint", Type::kUint32},   {"uint32", Type::kUint32},
    {"float", Type::kFloat},   {"float32", Type::kFloat}, {"double", Type::kDouble},
    {"float64", Type::kDouble}};
struct RoleName {
  std::string_view name;
  Role role;
};
constexpr RoleName kVertexRoles[] = {{"x", kX},
                                     {"y", kY},
                                     {"z", kZ},
                                     {"nx", kNx},
                                     {"ny", kNy},
                                     {"nz", kNz},
                                     {"red", kRed},
                                     {"green", kGreen},
                                     {"blue", kBlue},
                                     {"alpha", kAlpha},
                                     {"diffuse_red", kRed},
                                     {"diffuse_green", kGreen},
                                     {"diffuse_blue", kBlue},
                                     {"diffuse_alpha", kAlpha},
                                     {"r", kRed},
                                     {"g", kGreen},
                                     {"b", kBlue},
                                     {"s", kS},
                                     {"t", kT},
                                     {"u", kS},
                                     {"v", kT},
                                     {"texture_u", kS},
                                     {"texture_v", kT},
                                     {"texture_s", kS},
                                     {"texture_t", kT}};
constexpr RoleName kFaceRoles[] = {{"vertex_indices", kIndices},
                                   {"vertex_index", kIndices},
                                   {"texcoord", kTexcoord},
                                   {"texnumber", kTexnumber},
                                   {"material_index", kMaterial},
                                   {"has_texcoord", kHasTexcoord},
                                   {"red", kRed},
                                   {"green", kGreen},
                                   {"blue", kBlue},
                                   {"alpha", kAlpha}};

// Textures of Artec's and other scanners' files: as many faces as in the element face, whose
// corners refer to rows of texture coordinates.
constexpr RoleName kTextureVertexRoles[] = {
    {"u", kS}, {"v", kT}, {"s", kS}, {"t", kT}, {"tx", kTexnumber}};
constexpr RoleName kTextureFaceRoles[] = {
    {"texture_vertex_indices", kIndices}, {"texture_vertex_index", kIndices}, {"tx", kTexnumber}};

constexpr std::string_view kEncodedMaterial = "material_utf8";

bool is_printable_ascii(char c) { return c >= ' ' && c <= '~'; }

std::string encoded(std::string_view text) {
  constexpr std::string_view kDigits = "0123456789ABCDEF";
  std::string result;
  for (const char c : text) {
    if (is_printable_ascii(c) && c != '%') {
      result.push_back(c);
    } else {
      const auto byte = static_cast<unsigned char>(c);
      result.append({'%', kDigits[byte / 16], kDigits[byte % 16]});
    }
  }
  return result;
}

/// Decodes %XX. A % without two hexadecimal digits after it stays unchanged.
std::string decoded(std::string_view text) {
  std::string result;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] == '%' && i + 2 < text.size()) {
      unsigned char byte = 0;
      const char* const digits = text.data() + i + 1;
      const auto [stop, error] = std::from_chars(digits, digits + 2, byte, 16);
      if (error == std::errc() && stop == digits + 2) {
        result.push_back(static_cast<char>(byte));
        i += 2;
        continue;
      }
    }
    result.push_back(text[i]);
  }
  return result;
}

class HeaderReader {
 public:
  explicit HeaderReader(InputBuffer& input) : input_(input) {}

  Header read() {
    const std::string_view start = input_.peek(5);
    if (starts_with_in_any_case(start, "ply\r") && !start.ends_with('\n')) {
      input_.end_lines_with_cr();
    }
    std::string_view line;
    if (!input_.next_line(line) || lower_case(LineCursor(line, 1).word()) != "ply") {
      throw FormatError::at_line(1, "expected 'ply'");
    }
    bool has_format = false;
    while (input_.next_line(line)) {
      LineCursor cursor(line, input_.line());
      const std::string_view keyword = cursor.word();
      if (keyword == "end_header") {
        if (!has_format) input_.fail_at_line("expected a format line before end_header");
        return std::move(header_);
      }
      if (keyword == "format") {
        format(cursor);
        has_format = true;
      } else if (keyword == "comment") {
        header_.remarks.emplace_back(line);
        comment(cursor);
      } else if (keyword == "obj_info") {
        header_.remarks.emplace_back(line);
        obj_info(cursor);
      } else if (keyword == "element") {
        element(cursor);
      } else if (keyword == "property") {
        property(cursor);
      } else {
        ++header_.num_skipped;
      }
    }
    input_.fail_at_line("file ends within the header");
  }

 private:
  void format(LineCursor& cursor) {
    const std::string_view name = cursor.word();
    if (name == "ascii") {
      header_.encoding = Encoding::kAscii;
    } else if (name == "binary_little_endian") {
      header_.encoding = Encoding::kLittleEndian;
    } else if (name == "binary_big_endian") {
      header_.encoding = Encoding::kBigEndian;
    } else {
      input_.fail_at_line("format: expected ascii, binary_little_endian or binary_big_endian");
    }
    if (cursor.word() != "1.0") input_.fail_at_line("format: expected version 1.0");
  }

  // Parses the comments material N NAME, material_utf8 N NAME (ours), and TextureFile NAME
  // (MeshLab's).
  void comment(LineCursor& cursor) {
    const std::string_view kind = cursor.word();
    if (kind == "TextureFile") {
      header_.texture_files.emplace_back(cursor.rest());
    } else if (kind == "material" || kind == kEncodedMaterial) {
      const std::string_view number = cursor.word();
      std::int64_t index = 0;
      const auto [stop, error] =
          std::from_chars(number.data(), number.data() + number.size(), index);
      const bool whole = error == std::errc() && stop == number.data() + number.size();
      if (!whole || index < 0) return;
      const std::string_view name = cursor.rest();
      header_.material_names[index] = kind == "material" ? std::string(name) : decoded(name);
    }
  }

  void obj_info(LineCursor& cursor) {
    const std::string_view name = cursor.word();
    if (name == "num_cols") header_.num_cols = cursor.integer("num_cols");
    if (name == "num_rows") header_.num_rows = cursor.integer("num_rows");
  }

  void element(LineCursor& cursor) {
    Element& e = header_.elements.emplace_back();
    e.name = cursor.word();
    e.count = cursor.integer("element");
    e.line = cursor.line();
    if (e.count < 0) input_.fail_at_line("element: expected a count >= 0");
  }

  void property(LineCursor& cursor) {
    if (header_.elements.empty()) input_.fail_at_line("property before the first element");
    Element& e = header_.elements.back();
    Property p;
    std::string_view word = cursor.word();
    p.is_list = word == "list";
    if (p.is_list) {
      p.count_type = type(cursor.word());
      word = cursor.word();
    }
    p.type = type(word);
    p.name = cursor.word();
    p.role = role_of(e, p);
    // the first property with a meaning counts
    if (p.role != kSkip && e.has(p.role)) p.role = kSkip;
    if (p.role == kSkip) ++header_.num_skipped;
    e.properties.push_back(std::move(p));
  }

  [[nodiscard]] Type type(std::string_view word) const {
    for (const TypeName& t : kTypeNames) {
      if (t.name == word) return t.type;
    }
    input_.fail_at_line("property: unknown type '" + std::string(word.substr(0, 40)) + "'");
  }

  static Role role_of(const Element& e, const Property& p) {
    const auto find = [&](const auto& names) {
      for (const RoleName& r : names) {
        if (r.name == p.name && p.is_list == (r.role == kIndices || r.role == kTexcoord)) {
          return r.role;
        }
      }
      return kSkip;
    };
    if (e.name == "vertex") return find(kVertexRoles);
    if (e.name == "face" || e.name == "range_grid" || e.name == "tristrips") {
      return find(kFaceRoles);
    }
    if (e.name == kTextureVertices) return find(kTextureVertexRoles);
    if (e.name == kTextureFaces) return find(kTextureFaceRoles);
    return kSkip;
  }

  InputBuffer& input_;
  Header header_;
};

}  // namespace

std::string material_comment(std::size_t index, const std::string& name) {
  const bool is_plain = std::ranges::all_of(name, is_printable_ascii);
  const std::string kind = is_plain ? "material" : std::string(kEncodedMaterial);
  return "comment " + kind + " " + std::to_string(index) + " " + (is_plain ? name : encoded(name));
}

Header read_header(InputBuffer& input) { return HeaderReader(input).read(); }

}  // namespace manip3d::ply
