#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstring>
#include <limits>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "io/colors.hpp"
#include "io/formats.hpp"
#include "io/mesh_builder.hpp"
#include "io/unique_rows.hpp"
#include "io/warnings.hpp"
#include "parse/input_buffer.hpp"
#include "parse/letters.hpp"
#include "parse/line_cursor.hpp"

namespace manip3d {
namespace {

constexpr std::size_t kStlHeaderBytes = 84;  // 80 bytes of comment, then the number of triangles
constexpr std::size_t kTriangleBytes = 50;
constexpr std::uint16_t kMarked = 0x8000;

class StlReader {
 public:
  StlReader(ByteSource& source, const Progress& progress)
      : input_(source, progress), builder_(input_), vertices_(builder_.vertices) {}

  ReadResult read() {
    if (is_binary()) {
      read_binary();
    } else {
      read_ascii();
    }
    builder_.finish(result_);
    return std::move(result_);
  }

 private:
  // Is the file binary? It may begin with "solid" as well. The length of the file must fit the
  // number of triangles in a binary header; else a byte that text cannot contain decides.
  bool is_binary() {
    const auto size = input_.remaining();
    const std::string_view head = input_.peek(2 * kStlHeaderBytes);
    if (size && head.size() >= kStlHeaderBytes &&
        *size == kStlHeaderBytes + std::uint64_t{kTriangleBytes} * claimed(head)) {
      return true;
    }
    std::string_view text = head;
    if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);  // byte order mark of UTF-8
    const auto first = std::find_if(text.begin(), text.end(),
                                    [](unsigned char c) { return std::isspace(c) == 0; });
    const bool says_solid = starts_with_in_any_case({first, text.end()}, "solid");
    const bool has_text_only = std::all_of(head.begin(), head.end(), [](unsigned char c) {
      return c >= 0x80 || std::isprint(c) != 0 || std::isspace(c) != 0;
    });
    if (has_text_only && !says_solid && !head.empty()) {
      throw FormatError::at_line(1, "expected a text that begins with solid, or a binary STL file");
    }
    return head.empty() || !has_text_only;
  }

  static std::uint32_t claimed(std::string_view head) {
    const auto byte = [&](std::size_t i) {
      return std::uint32_t{static_cast<unsigned char>(head[kStlHeaderBytes - 4 + i])};
    };
    return byte(0) | byte(1) << 8U | byte(2) << 16U | byte(3) << 24U;
  }

  // Number of triangles. Programs that stream their output leave it 0; all triangles that follow
  // are then read.
  std::uint32_t num_triangles(std::string_view head) {
    const std::uint32_t count = claimed(head);
    const std::uint64_t rest = input_.remaining().value_or(0);
    if (count != 0 || rest == 0 || rest % kTriangleBytes != 0) return count;
    warn(result_.warnings, "0 triangles claimed, all that follow are read");
    return static_cast<std::uint32_t>(
        std::min<std::uint64_t>(rest / kTriangleBytes, std::numeric_limits<std::int32_t>::max()));
  }

  void read_binary() {
    const std::string head(input_.bytes(kStlHeaderBytes, "the header"), kStlHeaderBytes);
    const std::uint32_t num_faces = num_triangles(head);
    const bool has_part_color = part_color(head) != MeshBuilder::kNone;
    std::vector<std::uint16_t> attributes;  // empty if each face tells its colour on its own
    constexpr std::int64_t kCountOffset = kStlHeaderBytes - 4;
    builder_.reserve_faces(
        input_.checked_claim(num_faces, kTriangleBytes, "triangles", {std::nullopt, kCountOffset}));
    for (std::uint32_t i = 0; i < num_faces; ++i) {
      const std::int64_t start = input_.offset();
      const char* bytes = input_.bytes(kTriangleBytes, "the triangles");
      std::array<float, 12> values;  // normal and three positions; two bytes of attributes follow
      std::memcpy(values.data(), bytes, sizeof(values));
      for (std::size_t c = 0; c < 3; ++c) {
        const float* p = values.data() + 3 * (c + 1);
        if (!(std::isfinite(p[0]) && std::isfinite(p[1]) && std::isfinite(p[2]))) {
          throw FormatError::at_byte(start, "vertex: expected finite numbers");
        }
        corners_[c].vertex = vertices_.index({p[0], p[1], p[2]}, input_);
      }
      builder_.add_polygon(corners_, MeshBuilder::kNone, {std::nullopt, start});
      std::uint16_t attribute = 0;
      std::memcpy(&attribute, bytes + sizeof(values), sizeof(attribute));
      if (has_part_color) {
        attributes.push_back(attribute);
      } else if ((attribute & kMarked) != 0) {
        builder_.color_last_polygon(viscam_color(attribute));
      }
    }
    if (has_part_color) color_faces(attributes, head);
    if (!input_.at_end()) {
      warn(result_.warnings, "bytes after the last triangle left out");
    }
  }

  // Materialise Magics writes the colour of the whole part into the header: COLOR= and four bytes,
  // followed by ,MATERIAL= and further colours.
  static std::int32_t part_color(std::string_view head) {
    constexpr std::string_view kKey = "COLOR=";
    const std::string_view comment = head.substr(0, kStlHeaderBytes - 4);
    const std::size_t at = comment.find(kKey);
    if (at == std::string_view::npos || at + kKey.size() + 4 > comment.size()) {
      return MeshBuilder::kNone;
    }
    std::int32_t rgb = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      rgb = rgb << 8 | static_cast<unsigned char>(comment[at + kKey.size() + k]);
    }
    return rgb;
  }

  // MeshLab writes a blank where Magics writes a comma.
  static bool is_of_meshlab(std::string_view head) {
    constexpr std::string_view kKey = "COLOR=";
    return head.substr(head.find(kKey) + kKey.size() + 4).starts_with(" MATERIAL=");
  }

  // Colours have five bits per channel. VisCAM and SolidView: blue is lowest, and bit 15 set means
  // that the face has a colour.
  static std::int32_t viscam_color(std::uint16_t attribute) {
    const auto five_bits = [&](int shift) { return (attribute >> shift & 0x1F) / 31.0; };
    const std::array<double, 3> values{five_bits(10), five_bits(5), five_bits(0)};
    return packed_color(values.data());
  }
  // In files with a colour of the part, red is lowest.
  static std::int32_t magics_color(std::uint16_t attribute) {
    const auto red = static_cast<std::uint16_t>(attribute & 0x1FU);
    return viscam_color(
        static_cast<std::uint16_t>(red << 10U | (attribute & 0x3E0U) | (attribute >> 10U & 0x1FU)));
  }

  // Colours the faces of a file with a colour of the part. Magics: bit 15 set means that the face
  // has that colour. MeshLab sets this bit on each face that has a colour of its own, and so do
  // other programs in whose files the bits below it differ; only 0x8000 and 0xFFFF are then the
  // part's. A face without attributes has the colour of the part, because many programs write no
  // others.
  void color_faces(const std::vector<std::uint16_t>& attributes, std::string_view head) {
    const bool is_meshlab = is_of_meshlab(head);
    const auto says_part = [&](std::uint16_t attribute) {
      return attribute == 0 || (!is_meshlab && (attribute == kMarked || attribute == 0xFFFF));
    };
    std::set<std::uint16_t> marked;
    for (const std::uint16_t attribute : attributes) {
      if ((attribute & kMarked) != 0 && !says_part(attribute)) marked.insert(attribute);
    }
    const bool are_colors = is_meshlab || marked.size() > 1;
    const std::int32_t color_of_part = part_color(head);
    for (std::size_t f = 0; f < attributes.size(); ++f) {
      const std::uint16_t attribute = attributes[f];
      const bool is_own = !says_part(attribute) && (are_colors || (attribute & kMarked) == 0);
      const auto face = static_cast<std::int64_t>(f);
      builder_.color_faces(face, face + 1, is_own ? magics_color(attribute) : color_of_part);
    }
  }

  // Reads solid, facet normal, outer loop, vertex x y z (three times), endloop, endfacet, endsolid.
  // Only the vertices between loops matter; other lines are ignored. Some programs write no
  // endloop.
  void read_ascii() {
    std::string_view line;
    std::size_t num_corners = 0;
    bool ended = false;
    while (input_.next_line(line)) {
      LineCursor cursor(line, input_.line());
      const std::string_view keyword = cursor.word();  // some programs write capitals
      if (is_same_in_any_case(keyword, "vertex")) {
        if (num_corners == 3) input_.fail_at_line("facet: expected 3 vertices, got more");
        const double x = cursor.number("vertex");
        const double y = cursor.number("vertex");
        const double z = cursor.number("vertex");
        corners_[num_corners++].vertex = vertices_.index({x, y, z}, input_);
        ended = false;
      } else if (is_same_in_any_case(keyword, "endloop") ||
                 (num_corners > 0 && is_same_in_any_case(keyword, "endfacet"))) {
        if (num_corners != 3) {
          input_.fail_at_line("facet: expected 3 vertices, got " + std::to_string(num_corners));
        }
        builder_.add_polygon(corners_, MeshBuilder::kNone, {input_.line(), std::nullopt});
        num_corners = 0;
      } else if (is_same_in_any_case(keyword, "endsolid")) {
        ended = true;
      }
    }
    if (num_corners != 0 || !ended) {
      throw FormatError::at_line(input_.line() + 1, "file ends before endsolid");
    }
  }

  InputBuffer input_;
  MeshBuilder builder_;
  // STL repeats the positions of each triangle; equal ones become one vertex.
  UniqueRows<Vertices> vertices_;
  ReadResult result_;
  std::array<MeshBuilder::Corner, 3> corners_;
};

// VisCAM's attribute for a colour; -1: no colour.
std::uint16_t attribute_of(std::int32_t rgb) {
  if (rgb < 0) return 0;
  std::int32_t attribute = kMarked;
  for (int k = 0; k < 3; ++k) {
    attribute |= static_cast<std::int32_t>(std::lround(channel(rgb, k) * 31.0 / 255.0))
                 << (10 - 5 * k);
  }
  return static_cast<std::uint16_t>(attribute);
}

}  // namespace

ReadResult read_stl(ByteSource& source, const ReadOptions&, const Progress& progress) {
  return StlReader(source, progress).read();
}

void write_stl(Output& out, const WriteJob& job) {
  const MeshView& mesh = job.mesh;
  if (mesh.has_texcoords()) warn(job.warnings, "STL: texture coordinates left out");
  const std::vector<std::int32_t> colors = colors_of(job.materials);
  if (mesh.has_materials()) {
    warn(job.warnings, colors.empty() ? "STL: materials left out"
                                      : "STL: of materials only colors of 15 bits are kept");
  }
  if (mesh.colors.rows() > 0) warn(job.warnings, "STL: colors left out");
  // Never "solid", which other readers would take as text.
  std::string header = "binary STL";
  header.resize(kStlHeaderBytes - 4, ' ');
  out.text(header);
  out.binary(static_cast<std::uint32_t>(mesh.num_faces()));
  bool exact = true;
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f) {
    const Eigen::Vector3d a = mesh.vertices.row(mesh.faces(f, 0));
    const Eigen::Vector3d b = mesh.vertices.row(mesh.faces(f, 1));
    const Eigen::Vector3d c = mesh.vertices.row(mesh.faces(f, 2));
    const Eigen::Vector3d normal = (b - a).cross(c - a).normalized();
    for (const Eigen::Vector3d& row :
         {Eigen::Vector3d(normal.allFinite() ? normal : Eigen::Vector3d::Zero()), a, b, c}) {
      for (int k = 0; k < 3; ++k) out.binary(static_cast<float>(row[k]));
    }
    for (const Eigen::Vector3d& p : {a, b, c}) {
      exact = exact && p == p.cast<float>().cast<double>();
      if (!p.cast<float>().allFinite()) {
        throw InputError("vertices: STL holds 32-bit numbers, a coordinate is too large for them");
      }
    }
    out.binary(attribute_of(color_of_face(mesh, colors, f)));
  }
  if (!exact) warn(job.warnings, "STL: coordinates rounded to 32 bits");
}

}  // namespace manip3d
