#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

#include "io/colors.hpp"
#include "io/formats.hpp"
#include "io/mesh_builder.hpp"
#include "io/warnings.hpp"
#include "parse/input_buffer.hpp"
#include "parse/line_cursor.hpp"

namespace manip3d {
namespace {

// Header of Geomview's OFF: [ST][C][N][4][n]OFF [BINARY], the dimension after n, then counts,
// vertices, polygons. MeshLab writes [N][C][ST]OFF, and colours before normals.
struct OffHeader {
  bool has_texcoords = false, has_colors = false, has_normals = false;
  bool has_colors_first = false;
  std::int64_t num_vertices = 0, num_polygons = 0;
};

class OffReader {
 public:
  OffReader(ByteSource& source, const Progress& progress)
      : input_(source, progress), builder_(input_) {}

  ReadResult read() {
    read_header();
    for (std::int64_t i = 0; i < header_.num_vertices; ++i) read_vertex();
    for (std::int64_t i = 0; i < header_.num_polygons; ++i) read_polygon();
    color_faces_of_ones();
    builder_.finish(result_);
    return std::move(result_);
  }

 private:
  // The next line that has more than blanks and a comment.
  LineCursor next_line(const char* what) {
    std::string_view line;
    while (input_.next_line(line)) {
      LineCursor cursor(line.substr(0, line.find('#')), input_.line());
      if (!cursor.at_end()) return cursor;
    }
    throw FormatError::at_line(input_.line() + 1, std::string("file ends within ") + what);
  }

  // The keyword may be missing, and the counts may be on its line.
  void read_header() {
    LineCursor cursor = next_line("the header");
    const char* start = cursor.position();
    std::string_view keyword = cursor.word();
    if (keyword.ends_with("OFF")) {
      parse_keyword(keyword.substr(0, keyword.size() - 3), cursor);
      if (cursor.at_end()) cursor = next_line("the header");
    } else if (std::isdigit(static_cast<unsigned char>(keyword.front())) != 0) {
      cursor.move_to(start);
    } else {
      throw FormatError::at_line(cursor.line(), "expected OFF");
    }
    const FormatError::Position position{cursor.line(), std::nullopt};
    constexpr std::int64_t kMinVertex = 6, kMinPolygon = 4;  // "0 0 0\n", "3 0 ..."
    header_.num_vertices = cursor.integer("number of vertices");
    header_.num_polygons = cursor.integer("number of faces");
    if (!cursor.at_end()) cursor.integer("number of edges");  // the number of edges is not used
    expect_end(cursor);
    if (header_.num_vertices > std::numeric_limits<std::int32_t>::max()) {
      throw FormatError("more than 2147483647 vertices", position);
    }
    builder_.vertices.reserve(
        input_.checked_claim(header_.num_vertices, kMinVertex, "vertices", position));
    builder_.reserve_faces(
        input_.checked_claim(header_.num_polygons, kMinPolygon, "faces", position));
  }

  void parse_keyword(std::string_view prefix, LineCursor& cursor) {
    const auto take = [&](std::string_view part) {
      if (!prefix.starts_with(part)) return false;
      prefix.remove_prefix(part.size());
      return true;
    };
    const std::string whole(prefix);
    header_.has_texcoords = take("ST");
    header_.has_colors = take("C");
    header_.has_normals = take("N");
    if (!header_.has_texcoords) {
      header_.has_colors_first = header_.has_normals && !header_.has_colors && take("C");
      header_.has_colors |= header_.has_colors_first;
      header_.has_texcoords = (header_.has_colors || header_.has_normals) && take("ST");
    }
    const bool has_dimension = take("n");
    if (!prefix.empty()) {
      throw FormatError::at_line(cursor.line(),
                                 "expected [ST][C][N]OFF or [N][C][ST]OFF of three "
                                 "dimensions, got " +
                                     whole + "OFF");
    }
    const char* start = cursor.position();
    if (cursor.word() == "BINARY") {
      throw FormatError::at_line(cursor.line(), "binary OFF is not supported");
    }
    cursor.move_to(start);
    if (!has_dimension) return;
    if (cursor.at_end()) cursor = next_line("the header");
    if (cursor.integer("dimension") != 3) cursor.fail("dimension", "3");
  }

  // x y z [nx ny nz] [r g b a] [s t], or the colour before the normal
  void read_vertex() {
    LineCursor cursor = next_line("the vertices");
    read_numbers(cursor, builder_.vertices.append(input_), 3, "vertex");
    if (header_.has_colors_first) read_vertex_color(cursor);
    if (header_.has_normals) {
      read_numbers(cursor, builder_.normals.append(input_), 3, "normal");
    }
    if (header_.has_colors && !header_.has_colors_first) read_vertex_color(cursor);
    if (header_.has_texcoords) {
      read_numbers(cursor, builder_.texcoords.append(input_), 2, "texture coordinate");
    }
    // Plain OFF files often have colours, which only the further numbers on the line show.
    if (!header_.has_colors && !header_.has_normals && !header_.has_texcoords && !cursor.at_end()) {
      read_vertex_color(cursor);
    }
    expect_end(cursor);
  }

  static void read_numbers(LineCursor& cursor, double* row, int count, const char* what) {
    for (int k = 0; k < count; ++k) row[k] = cursor.number(what);
  }

  // Reads a colour with or without alpha. Whether the numbers are 0 to 1 or 0 to 255 shows in the
  // whole table: some programs write 1.0 as "1".
  void read_vertex_color(LineCursor& cursor) {
    const std::int64_t vertex = builder_.vertices.size() - 1;
    builder_.colors.fill(vertex, std::numeric_limits<float>::quiet_NaN(), input_);
    float* color = builder_.colors.append(input_);
    for (int k = 0; k < 3; ++k) color[k] = static_cast<float>(cursor.number("color"));
    // Skips the alpha value, unless the rest are the normal and the two texture coordinates.
    const int rest = (header_.has_colors_first ? 3 : 0) + (header_.has_texcoords ? 2 : 0);
    if (words_left(cursor) == rest + 1) cursor.number("color");
  }

  // n i1 ... in [color: 0, 1, 3 or 4 numbers]
  void read_polygon() {
    LineCursor cursor = next_line("the faces");
    const std::int64_t num_corners = cursor.integer("number of corners");
    if (num_corners < 0) {
      throw FormatError::at_line(cursor.line(), "number of corners: expected at least 0, got " +
                                                    std::to_string(num_corners));
    }
    corners_.clear();
    for (std::int64_t c = 0; c < num_corners; ++c) {  // ends at the end of the line at the latest
      const std::int64_t vertex = cursor.integer("vertex index");
      if (vertex < 0 || vertex >= builder_.vertices.size()) {
        throw FormatError::at_line(cursor.line(), "vertex index: expected 0 to " +
                                                      std::to_string(builder_.vertices.size() - 1) +
                                                      ", got " + std::to_string(vertex));
      }
      const auto index = static_cast<std::int32_t>(vertex);
      corners_.push_back({index, header_.has_texcoords ? index : MeshBuilder::kNone,
                          header_.has_normals ? index : MeshBuilder::kNone});
    }
    const std::int64_t first = builder_.num_faces();
    builder_.add_polygon(corners_, MeshBuilder::kNone, {cursor.line(), std::nullopt});
    if (!cursor.at_end()) read_face_color(cursor, first);
  }

  // Reads a colour of three or four numbers, integers 0 to 255 or numbers 0 to 1. A single number
  // is an index into a colour map that is not in the file.
  void read_face_color(LineCursor& cursor, std::int64_t first) {
    const int count = words_left(cursor);
    if (count != 3 && count != 4) {
      if (result_.num_skipped++ == 0) {
        warn(result_.warnings, "colors of faces that are no 3 or 4 numbers are left out");
      }
      return;
    }
    std::array<double, 4> color{};  // with alpha, which is not kept
    bool whole = true;
    for (int k = 0; k < count; ++k) {
      cursor.at_end();  // skips blanks
      const char* start = cursor.position();
      color[k] = cursor.number("color");
      whole = whole && std::all_of(start, cursor.position(),
                                   [](unsigned char c) { return std::isdigit(c) != 0; });
    }
    const double largest = std::max({color[0], color[1], color[2]});
    if (whole && largest == 1.0) {
      faces_of_ones_.push_back({first, builder_.num_faces(), packed_color(color.data())});
    }
    has_fractions_ = has_fractions_ || (!whole && largest <= 1.0);
    has_bytes_ = has_bytes_ || largest > 1.0;
    for (double& channel : color) channel /= whole ? 255.0 : 1.0;
    builder_.color_last_polygon(packed_color(color.data()));
  }

  // Some programs write 1.0 as "1", which the colours of the other faces show.
  void color_faces_of_ones() {
    if (!has_fractions_ || has_bytes_) return;
    for (const FaceOfOnes& face : faces_of_ones_) {
      builder_.recolor_faces(face.begin, face.end, face.rgb);
    }
  }

  // Number of words up to the end of the line or a comment; the cursor does not move.
  static int words_left(LineCursor& cursor) {
    const char* start = cursor.position();
    int count = 0;
    while (!cursor.at_end() && !cursor.word().empty()) ++count;
    cursor.move_to(start);
    return count;
  }

  static void expect_end(LineCursor& cursor) {
    if (!cursor.at_end()) cursor.fail("line", "its end");
  }

  InputBuffer input_;
  MeshBuilder builder_;
  OffHeader header_;
  ReadResult result_;
  std::vector<MeshBuilder::Corner> corners_;
  // Faces whose colour is of zeros and ones, and that colour if the ones are the brightest.
  struct FaceOfOnes {
    std::int64_t begin, end;
    std::int32_t rgb;
  };
  std::vector<FaceOfOnes> faces_of_ones_;
  bool has_fractions_ = false, has_bytes_ = false;
};

}  // namespace

ReadResult read_off(ByteSource& source, const ReadOptions&, const Progress& progress) {
  return OffReader(source, progress).read();
}

void write_off(Output& out, const WriteJob& job) {
  const MeshView& mesh = job.mesh;
  const bool has_colors = mesh.colors.rows() > 0;
  if (mesh.has_texcoords()) warn(job.warnings, "OFF: texture coordinates left out");
  const std::vector<std::int32_t> face_colors = colors_of(job.materials);
  if (mesh.has_materials()) {
    warn(job.warnings, face_colors.empty() ? "OFF: materials left out"
                                           : "OFF: of materials only colors are kept");
  }
  if (mesh.face_normals.rows() > 0) warn(job.warnings, "OFF: normals left out");
  out.text(has_colors ? "COFF\n" : "OFF\n");
  out.number(mesh.num_vertices());
  out.text(" ");
  out.number(mesh.num_faces());
  out.text(" 0\n");
  for (Eigen::Index i = 0; i < mesh.vertices.rows(); ++i) {
    for (int k = 0; k < 3; ++k) {
      if (k > 0) out.text(" ");
      out.number(mesh.vertices(i, k));
    }
    for (int k = 0; has_colors && k < 3; ++k) {
      out.text(" ");
      out.number(int{mesh.colors(i, k)});
    }
    out.text(has_colors ? " 255\n" : "\n");  // COFF has an alpha value
  }
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f) {
    out.text("3");
    for (int c = 0; c < 3; ++c) {
      out.text(" ");
      out.number(mesh.faces(f, c));
    }
    const std::int32_t rgb = color_of_face(mesh, face_colors, f);
    for (int k = 0; rgb >= 0 && k < 3; ++k) {
      out.text(" ");
      out.number(channel(rgb, k));
    }
    out.text("\n");
  }
}

}  // namespace manip3d
