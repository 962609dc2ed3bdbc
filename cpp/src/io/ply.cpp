#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "geometry/cell_cut.hpp"
#include "io/colors.hpp"
#include "io/formats.hpp"
#include "io/mesh_builder.hpp"
#include "io/ply_header.hpp"
#include "io/texture_files.hpp"
#include "io/unique_rows.hpp"
#include "io/warnings.hpp"
#include "manip3d/error.hpp"
#include "manip3d/io/range_grid.hpp"
#include "parse/input_buffer.hpp"
#include "parse/line_cursor.hpp"

namespace manip3d {
namespace {

using namespace ply;  // NOLINT(google-build-using-namespace): the header's own words

constexpr std::int32_t kMaxMaterials = 1 << 16;
constexpr float kScaleOf16Bits = 1.0F / 65535.0F;

// A value as a double; double is exact for all types of PLY.
double load_scalar(const char* bytes, Type type, bool swap) {
  const auto get = [&]<typename T>(T value) {
    std::array<char, sizeof(T)> raw;
    std::memcpy(raw.data(), bytes, sizeof(T));
    if (swap) std::reverse(raw.begin(), raw.end());
    std::memcpy(&value, raw.data(), sizeof(T));
    return static_cast<double>(value);
  };
  switch (type) {
    case Type::kInt8:
      return get(std::int8_t{});
    case Type::kUint8:
      return get(std::uint8_t{});
    case Type::kInt16:
      return get(std::int16_t{});
    case Type::kUint16:
      return get(std::uint16_t{});
    case Type::kInt32:
      return get(std::int32_t{});
    case Type::kUint32:
      return get(std::uint32_t{});
    case Type::kFloat:
      return get(float{});
    case Type::kDouble:
      return get(double{});
  }
  return 0.0;
}

// Reads the values of one element, property by property.
class RowReader {
 public:
  RowReader(InputBuffer& input, Encoding encoding)
      : input_(input),
        encoding_(encoding),
        swap_((encoding == Encoding::kBigEndian) == (std::endian::native == std::endian::little)) {}

  std::array<double, kNumScalars> scalars{};
  std::vector<double> indices, texcoord;

  void read(const Element& element) {
    indices.clear();
    texcoord.clear();
    if (encoding_ == Encoding::kAscii) {
      read_line(element);
    } else {
      read_bytes(element);
    }
  }

  [[nodiscard]] FormatError::Position position() const {
    if (encoding_ == Encoding::kAscii) return {input_.line(), std::nullopt};
    return {std::nullopt, start_};
  }
  [[noreturn]] void fail(const std::string& reason) const { throw FormatError(reason, position()); }

  /// A scalar, which must be finite.
  double finite(Role role, const char* name) const {
    if (!std::isfinite(scalars[role])) fail(std::string(name) + ": expected a finite number");
    return scalars[role];
  }
  std::int32_t index(double value, const char* what) const {
    if (!(value >= 0.0 && value < std::numeric_limits<std::int32_t>::max()) ||
        value != std::floor(value)) {
      fail(std::string(what) + ": expected an index >= 0, got " + number_text(value));
    }
    return static_cast<std::int32_t>(value);
  }

 private:
  std::vector<double>* list_of(Role role) {
    if (role == kIndices) return &indices;
    return role == kTexcoord ? &texcoord : nullptr;
  }

  /// Normals and texture coordinates do not change the surface; vertices may lack a position.
  static bool may_be_not_finite(Role role) {
    return (role >= kX && role <= kNz) || role == kS || role == kT;
  }

  // Reads an element from a line, as in Turk's original format.
  void read_line(const Element& element) {
    std::string_view line;
    do {
      if (!input_.next_line(line)) {
        throw FormatError::at_line(input_.line() + 1, "file ends within element " + element.name);
      }
    } while (LineCursor(line, 0).rest().empty());
    LineCursor cursor(line, input_.line());
    for (const Property& p : element.properties) {
      if (p.is_list) {
        read_list(cursor, p);
      } else if (p.role == kSkip) {
        if (cursor.word().empty()) cursor.fail(p.name.c_str(), "a value");
      } else if (may_be_not_finite(p.role) && (cursor.take_nan() || cursor.take_infinity())) {
        scalars[p.role] = std::numeric_limits<double>::quiet_NaN();
      } else {
        scalars[p.role] = cursor.number(p.name.c_str());
      }
    }
    if (!cursor.rest().empty()) {
      fail("element " + element.name + ": more values on the line than properties");
    }
  }

  void read_list(LineCursor& cursor, const Property& p) {
    const std::int64_t count = cursor.integer(p.name.c_str());
    if (count < 0) fail(p.name + ": expected a count >= 0, got " + std::to_string(count));
    std::vector<double>* list = list_of(p.role);
    for (std::int64_t i = 0; i < count; ++i) {  // ends at the end of the line at the latest
      if (list != nullptr) {
        list->push_back(cursor.number(p.name.c_str()));
      } else if (cursor.word().empty()) {
        cursor.fail(p.name.c_str(), "a value");
      }
    }
  }

  void read_bytes(const Element& element) {
    start_ = input_.offset();
    const char* what = element.name.c_str();
    for (const Property& p : element.properties) {
      if (!p.is_list) {
        const char* bytes = input_.bytes(size_of(p.type), what);
        if (p.role != kSkip) scalars[p.role] = load_scalar(bytes, p.type, swap_);
        continue;
      }
      const char* head = input_.bytes(size_of(p.count_type), what);
      const double count = load_scalar(head, p.count_type, swap_);
      if (!(count >= 0.0 && count <= 4294967295.0) || count != std::floor(count)) {
        fail(p.name + ": expected a count >= 0, got " + number_text(count));
      }
      read_values(p, static_cast<std::int64_t>(count), what);
    }
  }

  // Reads a list in blocks, so that a list that claims four billion values fails at the end of the
  // file.
  void read_values(const Property& p, std::int64_t count, const char* what) {
    constexpr std::int64_t kBlock = 4096;
    std::vector<double>* list = list_of(p.role);
    const std::int64_t size = size_of(p.type);
    while (count > 0) {
      const std::int64_t n = std::min(count, kBlock);
      const char* bytes = input_.bytes(static_cast<std::size_t>(n * size), what);
      if (list != nullptr) {
        if (list->size() > kLongestList) fail(p.name + ": list of more than 16 million values");
        for (std::int64_t i = 0; i < n; ++i) {
          list->push_back(load_scalar(bytes + i * size, p.type, swap_));
        }
      }
      count -= n;
    }
  }

  static constexpr std::size_t kLongestList = std::size_t{1} << 24;

  InputBuffer& input_;
  Encoding encoding_;
  bool swap_;
  std::int64_t start_ = 0;
};

// The materials of a mesh, from the header and from the properties of its faces.
class MaterialTable {
 public:
  explicit MaterialTable(const Header& header) : header_(header) {}

  // Do faces have a property material_index? Without it, the index of their texture is used.
  bool has_index = false;

  // The first face of a material decides on its texture and colour.
  void note_texture(std::int32_t material, std::int32_t texture) {
    texture_of_.try_emplace(material, texture);
  }
  void note_color(std::int32_t material, std::int32_t rgb) { color_of_.try_emplace(material, rgb); }

  // Sets the materials of the mesh: those that the header names, and those that its faces refer to.
  void make(TriangleMesh& mesh, std::vector<std::string>& warnings) const {
    if (!has_index && !header_.texture_files.empty()) make_of_textures(mesh, warnings);
    const std::int32_t largest =
        mesh.face_material.rows() > 0 ? mesh.face_material.maxCoeff() : MeshBuilder::kNone;
    const std::int64_t named =
        has_index && !header_.material_names.empty()
            ? std::min<std::int64_t>(header_.material_names.rbegin()->first, kMaxMaterials)
            : -1;
    const std::int64_t last = std::max<std::int64_t>(largest, named);
    for (auto i = static_cast<std::int64_t>(mesh.materials.size()); i <= last; ++i) {
      mesh.materials.push_back(numbered(i));
    }
  }

 private:
  void make_of_textures(TriangleMesh& mesh, std::vector<std::string>& warnings) const {
    for (const std::string& file : header_.texture_files) {
      mesh.materials.emplace_back().name = file;
      mesh.materials.back().textures["base_color"].path = file;
    }
    const std::string count = std::to_string(header_.texture_files.size());
    if (mesh.face_material.rows() == 0) {
      // Without texnumber, the texture applies to all faces.
      mesh.face_material.setZero(mesh.faces.rows());
      if (header_.texture_files.size() == 1) return;
      warn(warnings, "the file names " + count +
                         " textures, but not those of its faces: all faces have the first");
    } else if (const auto last = mesh.face_material.maxCoeff();
               last >= std::ssize(header_.texture_files)) {
      warn(warnings, "faces refer to texture " + std::to_string(last) + ", the file names " +
                         count + ": faces of missing ones have none");
    }
  }

  [[nodiscard]] Material numbered(std::int64_t i) const {
    Material material;
    const auto name = header_.material_names.find(i);
    material.name =
        name != header_.material_names.end() ? name->second : "material_" + std::to_string(i);
    const auto texture = texture_of_.find(static_cast<std::int32_t>(i));
    if (texture != texture_of_.end()) {
      const std::string file = texture_file(texture->second);
      if (!file.empty()) material.textures["base_color"].path = file;
    }
    const auto color = color_of_.find(static_cast<std::int32_t>(i));
    if (color != color_of_.end()) set_color(material, color->second);
    return material;
  }

  [[nodiscard]] std::string texture_file(std::int64_t i) const {
    const bool is_known = i >= 0 && i < static_cast<std::int64_t>(header_.texture_files.size());
    return is_known ? header_.texture_files[i] : "";
  }

  const Header& header_;
  std::map<std::int32_t, std::int32_t> texture_of_, color_of_;  // by material
};

class PlyReader {
 public:
  PlyReader(ByteSource& source, const Progress& progress)
      : input_(source, progress),
        builder_(input_),
        header_(read_header(input_)),
        materials_(header_) {
    result_.num_skipped = header_.num_skipped;
    for (const Element& e : header_.elements) {
      if (e.name == "vertex") note_vertex_attributes(e);
      if (e.count > 0) warn_of_properties(e);
      has_faces_ = has_faces_ || ((e.name == "face" || e.name == "tristrips") && e.count > 0);
    }
    note_textures();
  }

  ReadResult read_mesh() {
    read_elements();
    if (!has_faces_) grid_to_faces();
    if (has_textures_) set_textures();
    builder_.finish(result_);
    materials_.make(result_.mesh, result_.warnings);
    return std::move(result_);
  }

  RangeGrid read_grid() {
    read_elements();
    builder_.check_positions();
    if (!has_grid_) throw FormatError("no range_grid in this file", {});
    Colors colors = builder_.take_colors();  // first, because it needs the number of vertices
    RangeGrid grid{header_.num_rows, header_.num_cols, grid_.take(), builder_.vertices.take(),
                   std::move(colors)};
    for (Eigen::Index i = 0; i < grid.vertex.rows(); ++i) {
      if (grid.vertex[i] >= grid.points.rows()) fail_grid(i);
    }
    return grid;
  }

 private:
  using Corner = MeshBuilder::Corner;

  void note_vertex_attributes(const Element& e) {
    has_normals_ = e.has(kNx) && e.has(kNy) && e.has(kNz);
    has_colors_ = has_color(e);
    has_vertex_texcoords_ = e.has(kS) && e.has(kT);
    color_scale_ = color_scale(e);
  }

  // Are there elements with the texture coordinates of faces, and no other texture coordinates?
  void note_textures() {
    bool has_others = has_vertex_texcoords_, has_vertices = false, has_faces = false;
    for (const Element& e : header_.elements) {
      has_others = has_others || (e.name == "face" && e.has(kTexcoord));
      has_vertices = has_vertices || (e.name == kTextureVertices && e.has(kS) && e.has(kT));
      has_faces = has_faces || (e.name == kTextureFaces && e.has(kIndices) && e.count > 0);
    }
    has_textures_ = has_vertices && has_faces && !has_others;
    if (!has_faces || has_textures_) return;
    warn_of_textures(has_others ? "there are other texture coordinates"
                                : "its texture coordinates are not there");
  }

  void warn_of_textures(const std::string& why) {
    warn(result_.warnings, std::string(kTextureFaces) + " is left out: " + why);
  }

  static bool has_color(const Element& e) { return e.has(kRed) && e.has(kGreen) && e.has(kBlue); }

  // Scale of a colour property, which maps its full value to 1.
  static float color_scale(const Element& e) {
    for (const Property& p : e.properties) {
      if (p.role != kRed) continue;
      if (p.type == Type::kUint16) return kScaleOf16Bits;
      if (p.type != Type::kFloat && p.type != Type::kDouble) return 1.0F / 255.0F;
    }
    return 1.0F;
  }

  // Warns of skipped properties: measurements and labels such as quality and confidence.
  void warn_of_properties(const Element& e) {
    std::string names;
    for (const Property& p : e.properties) {
      if (p.role == kSkip) names += (names.empty() ? "" : ", ") + p.name;
    }
    if (!names.empty()) {
      warn(result_.warnings, "properties of element " + e.name + " are left out: " + names);
    }
  }

  // Warns once of alpha values, because colours of a mesh are opaque.
  void note_alpha(const Element& e, const RowReader& row, float scale) {
    if (!e.has(kAlpha) || scale * row.scalars[kAlpha] >= 1.0) return;
    warn_of_alpha();
  }

  void warn_of_alpha() {
    if (warned_of_alpha_) return;
    warned_of_alpha_ = true;
    warn(result_.warnings, "alpha of colors is left out");
  }

  void read_elements() {
    for (const Element& e : header_.elements) {
      const std::int64_t least = e.least_bytes(header_.encoding);
      if (least == 0) continue;  // an element without properties has no bytes
      const std::int64_t sure =
          input_.checked_claim(e.count, least, e.name.c_str(), {e.line, std::nullopt});
      RowReader row(input_, header_.encoding);
      if (e.name == "vertex") {
        read_vertices(e, row, sure);
      } else if (e.name == "face") {
        read_faces(e, row, sure);
      } else if (e.name == "tristrips") {
        read_strips(e, row);
      } else if (e.name == "range_grid") {
        read_range_grid(e, row, sure);
      } else if (has_textures_ && e.name == kTextureVertices) {
        read_texture_vertices(e, row, sure);
      } else if (has_textures_ && e.name == kTextureFaces) {
        read_texture_faces(e, row, sure);
      } else {
        ++result_.num_skipped;
        for (std::int64_t i = 0; i < e.count; ++i) row.read(e);
      }
    }
  }

  void read_vertices(const Element& e, RowReader& row, std::int64_t sure) {
    if (!(e.has(kX) && e.has(kY) && e.has(kZ))) {
      throw FormatError::at_line(e.line, "element vertex: expected properties x, y and z");
    }
    if (e.count > std::numeric_limits<std::int32_t>::max()) {
      throw FormatError::at_line(e.line, "more than 2147483647 vertices");
    }
    builder_.vertices.reserve(sure);
    if (has_normals_) builder_.normals.reserve(sure);
    for (std::int64_t i = 0; i < e.count; ++i) {
      row.read(e);
      double* position = builder_.vertices.append(input_);
      for (int k = 0; k < 3; ++k) position[k] = row.scalars[kX + k];
      if (!std::isfinite(position[0] + position[1] + position[2])) {
        note_position(position, row);
      }
      if (has_normals_) {
        double* normal = builder_.normals.append(input_);
        for (int k = 0; k < 3; ++k) normal[k] = row.scalars[kNx + k];
        builder_.may_have_nan |= !std::isfinite(normal[0] + normal[1] + normal[2]);
      }
      if (has_vertex_texcoords_) {
        double* texcoord = builder_.texcoords.append(input_);
        texcoord[0] = row.scalars[kS];
        texcoord[1] = row.scalars[kT];
        builder_.may_have_nan |= !std::isfinite(texcoord[0] + texcoord[1]);
      }
      if (has_colors_) {
        float* color = builder_.colors.append(input_);
        color[0] = color_scale_ * static_cast<float>(row.finite(kRed, "red"));
        color[1] = color_scale_ * static_cast<float>(row.finite(kGreen, "green"));
        color[2] = color_scale_ * static_cast<float>(row.finite(kBlue, "blue"));
        largest_color_ = std::max({largest_color_, color[0], color[1], color[2]});
        if (color_scale_ != kScaleOf16Bits) note_alpha(e, row, color_scale_);
        least_alpha_ = std::min(least_alpha_, e.has(kAlpha) ? row.scalars[kAlpha] : 65535.0);
      }
    }
    if (has_colors_ && color_scale_ == kScaleOf16Bits) finish_16_bit_colors();
  }

  /// Vertices without a position are left out unless a face uses them: scanners and programs that
  /// mesh depth images write one vertex per pixel.
  void note_position(const double* position, const RowReader& row) {
    for (int k = 0; k < 3; ++k) {
      if (std::isfinite(position[k])) continue;
      builder_.add_not_finite("xyz"[k], row.position());
      return;
    }
  }

  void read_texture_vertices(const Element& e, RowReader& row, std::int64_t sure) {
    builder_.texcoords.reserve(sure);
    for (std::int64_t i = 0; i < e.count; ++i) {
      row.read(e);
      double* texcoord = builder_.texcoords.append(input_);
      texcoord[0] = row.scalars[kS];
      texcoord[1] = row.scalars[kT];
      builder_.may_have_nan |= !std::isfinite(texcoord[0] + texcoord[1]);
    }
  }

  void read_texture_faces(const Element& e, RowReader& row, std::int64_t sure) {
    texture_faces_.reserve(sure);
    for (std::int64_t i = 0; i < e.count; ++i) {
      row.read(e);
      std::int32_t* face = texture_faces_.append(input_);
      std::fill_n(face, 4, row.indices.size() == 3 ? MeshBuilder::kNone : kNoTriangle);
      if (row.indices.size() != 3 || !std::ranges::all_of(row.indices, is_index)) continue;
      for (std::size_t c = 0; c < 3; ++c) face[c] = static_cast<std::int32_t>(row.indices[c]);
      const double texture = e.has(kTexnumber) ? row.scalars[kTexnumber] : 0.0;
      if (is_index(texture) && texture < kMaxMaterials)
        face[3] = static_cast<std::int32_t>(texture);
    }
  }

  static constexpr std::int32_t kNoTriangle = -2;  ///< In place of a corner's row.

  // Programs write -1, also as the largest number of an unsigned type, for a face without texture.
  static bool is_index(double value) {
    return value >= 0.0 && value < std::numeric_limits<std::int32_t>::max() &&
           value == std::floor(value);
  }

  // Gives faces the textures of read_texture_faces(). They have those of the same rows; therefore,
  // all must be triangles.
  void set_textures() {
    bool are_triangles = builder_.num_faces() == builder_.num_polygons() &&
                         builder_.num_faces() == texture_faces_.size();
    bool exist = true, has_several = false;
    for (std::int64_t i = 0; i < texture_faces_.size(); ++i) {
      const std::int32_t* face = texture_faces_.row(i);
      are_triangles = are_triangles && face[0] != kNoTriangle;
      exist = exist && std::max({face[0], face[1], face[2]}) < builder_.texcoords.size();
      has_several = has_several || face[3] > 0;
    }
    if (!are_triangles || !exist) {
      builder_.texcoords.take();
      return warn_of_textures(exist ? "expected a triangle for each face, and only triangles"
                                    : "it refers to texture coordinates that are not there");
    }
    const bool has_names = has_several || !header_.texture_files.empty();
    for (std::int64_t i = 0; i < texture_faces_.size(); ++i) {
      const std::int32_t* face = texture_faces_.row(i);
      const bool is_material = has_names && !materials_.has_index;
      builder_.set_texture(i, face, is_material ? face[3] : MeshBuilder::kNone);
    }
  }

  /// Some programs write values of 8 bits as numbers of 16 bits. A mesh that uses the whole range
  /// and has no value above 255 would be black, so its values are taken as 8 bits.
  void finish_16_bit_colors() {
    float full = 65535.0F;
    if (largest_color_ > 0.0F && largest_color_ <= 255.0F * kScaleOf16Bits) {
      full = 255.0F;
      for (std::int64_t i = 0; i < builder_.colors.size(); ++i) {
        float* color = builder_.colors.row(i);
        for (int k = 0; k < 3; ++k) color[k] *= 65535.0F / full;
      }
      warn_of_8_bits();
    }
    if (least_alpha_ < full) warn_of_alpha();
  }

  void warn_of_8_bits() {
    constexpr const char* kText = "16-bit colors are at most 255: they are read as 8-bit colors";
    if (std::ranges::find(result_.warnings, kText) == result_.warnings.end()) {
      warn(result_.warnings, kText);
    }
  }

  [[nodiscard]] Corner corner_of(std::int32_t vertex) const {
    return {vertex, has_vertex_texcoords_ ? vertex : MeshBuilder::kNone,
            has_normals_ ? vertex : MeshBuilder::kNone};
  }

  void read_faces(const Element& e, RowReader& row, std::int64_t sure) {
    if (!e.has(kIndices)) {
      throw FormatError::at_line(e.line, "element face: expected a list vertex_indices");
    }
    builder_.reserve_faces(sure);
    const bool has_texnumber = e.has(kTexnumber);
    const bool has_flag = e.has(kHasTexcoord);
    materials_.has_index = e.has(kMaterial);
    const bool has_face_colors = has_color(e);
    const float face_color_scale = color_scale(e);
    std::vector<FaceColor> wide_colors;  // of 16 bits: see finish_16_bit_colors()
    double least_alpha = 65535.0;
    for (std::int64_t i = 0; i < e.count; ++i) {
      row.read(e);
      corners_.clear();
      for (const double value : row.indices) {
        corners_.push_back(corner_of(row.index(value, "vertex_indices")));
      }
      if (!has_flag || row.scalars[kHasTexcoord] != 0.0) set_texcoords(row);
      const std::int32_t texture = has_texnumber ? number(row, kTexnumber) : MeshBuilder::kNone;
      std::int32_t material = texture;
      if (materials_.has_index) {
        material = number(row, kMaterial);
        if (texture >= 0) materials_.note_texture(material, texture);
      }
      const std::int64_t first_face = builder_.num_faces();
      builder_.add_polygon(corners_, material, row.position());
      if (!has_face_colors) continue;
      FaceColor color{first_face, builder_.num_faces(), material, {}};
      for (std::size_t k = 0; k < 3; ++k) color.values[k] = row.finite(kColor[k], kColorName[k]);
      if (face_color_scale == kScaleOf16Bits) {
        if (color.begin < color.end) wide_colors.push_back(color);
        least_alpha = std::min(least_alpha, e.has(kAlpha) ? row.scalars[kAlpha] : 65535.0);
      } else {
        note_alpha(e, row, face_color_scale);
        color_faces(color, face_color_scale);
      }
    }
    double largest = 0.0;
    for (const FaceColor& color : wide_colors) {
      largest = std::max(largest, *std::ranges::max_element(color.values));
    }
    const bool has_8_bits = largest > 0.0 && largest <= 255.0;
    if (has_8_bits) warn_of_8_bits();
    if (!wide_colors.empty() && least_alpha < (has_8_bits ? 255.0 : 65535.0)) warn_of_alpha();
    for (const FaceColor& color : wide_colors) {
      color_faces(color, has_8_bits ? 1.0F / 255.0F : kScaleOf16Bits);
    }
    if (has_face_colors && !materials_.has_index && !header_.texture_files.empty()) {
      warn(result_.warnings, "colors of faces are left out: there is a texture");
    }
  }

  /// The colour of a polygon as it is stored.
  struct FaceColor {
    std::int64_t begin, end;  // its faces
    std::int32_t material;
    std::array<double, 3> values;
  };
  static constexpr std::array<Role, 3> kColor{kRed, kGreen, kBlue};
  static constexpr std::array<const char*, 3> kColorName{"red", "green", "blue"};

  void color_faces(const FaceColor& color, double scale) {
    std::array<double, 3> values = color.values;
    for (double& value : values) value *= scale;
    const std::int32_t rgb = packed_color(values.data());
    if (materials_.has_index) {
      if (color.material >= 0) materials_.note_color(color.material, rgb);
    } else if (header_.texture_files.empty()) {
      builder_.color_faces(color.begin, color.end, rgb);
    }
  }

  // A number that may be absent: values below 0 mean none.
  static std::int32_t number(const RowReader& row, Role role) {
    const double value = row.scalars[role];
    if (value < 0.0) return MeshBuilder::kNone;
    const std::int32_t index = row.index(value, role == kMaterial ? "material_index" : "texnumber");
    if (index >= kMaxMaterials) row.fail("more than 65536 materials");
    return index;
  }

  // Sets texture coordinates by MeshLab's convention: u, v of each corner. An empty list means
  // none, and so does our property has_texcoord if it is 0.
  void set_texcoords(const RowReader& row) {
    if (row.texcoord.empty()) return;
    if (row.texcoord.size() != 2 * corners_.size()) {
      row.fail("texcoord: expected " + std::to_string(2 * corners_.size()) +
               " values or none, got " + std::to_string(row.texcoord.size()));
    }
    for (std::size_t c = 0; c < corners_.size(); ++c) {
      const double u = row.texcoord[2 * c];
      const double v = row.texcoord[2 * c + 1];
      if (!(std::isfinite(u) && std::isfinite(v))) row.fail("texcoord: expected finite numbers");
      corners_[c].texcoord = texcoords_.index({u, v}, input_);
    }
  }

  // Reads Stanford's triangle strips: -1 starts a new one, and every second triangle is reversed.
  void read_strips(const Element& e, RowReader& row) {
    for (std::int64_t i = 0; i < e.count; ++i) {
      row.read(e);
      std::size_t length = 0;
      Corner window[3];
      for (const double value : row.indices) {
        if (value == -1.0) {
          length = 0;
          continue;
        }
        window[0] = window[1];
        window[1] = window[2];
        window[2] = corner_of(row.index(value, "vertex_indices"));
        if (++length < 3) continue;
        corners_ = {window[0], window[1], window[2]};
        if (length % 2 == 0) std::swap(corners_[0], corners_[1]);
        builder_.add_polygon(corners_, MeshBuilder::kNone, row.position());
      }
    }
  }

  void read_range_grid(const Element& e, RowReader& row, std::int64_t sure) {
    const std::int64_t cols = header_.num_cols;
    const std::int64_t rows = header_.num_rows;
    if (!e.has(kIndices) || cols < 0 || rows < 0 || (cols > 0 && e.count / cols != rows) ||
        e.count != cols * rows) {
      throw FormatError::at_line(e.line,
                                 "range_grid: expected obj_info num_cols x num_rows lists "
                                 "vertex_indices");
    }
    has_grid_ = true;
    grid_.reserve(sure);
    for (std::int64_t i = 0; i < e.count; ++i) {
      row.read(e);
      if (row.indices.size() > 1) row.fail("range_grid: expected 0 or 1 vertex index per pixel");
      *grid_.append(input_) =
          row.indices.empty() ? MeshBuilder::kNone : row.index(row.indices[0], "vertex_indices");
    }
  }

  [[noreturn]] void fail_grid(std::int64_t pixel) const {
    throw FormatError(
        "range_grid: vertex index of pixel " + std::to_string(pixel) + " is out of range", {});
  }

  // Makes two triangles for each full 2x2 cell, and one if three of its pixels are valid. They are
  // counter-clockwise in a view with columns to the right and rows upwards, which is the view of
  // Stanford's scanner.
  void grid_to_faces() {
    const std::int64_t cols = header_.num_cols;
    for (std::int64_t i = 0; i < grid_.size(); ++i) {
      if (*grid_.row(i) >= builder_.vertices.size()) fail_grid(i);
    }
    for (std::int64_t r = 0; has_grid_ && r + 1 < header_.num_rows; ++r) {
      for (std::int64_t c = 0; c + 1 < cols; ++c) {
        const std::int64_t pixel = r * cols + c;
        corners_.clear();
        for (const std::int64_t p : cell_corners(pixel, cols, true)) {
          const std::int32_t vertex = *grid_.row(p);
          if (vertex >= 0) corners_.push_back(corner_of(vertex));
        }
        if (corners_.size() >= 3) builder_.add_polygon(corners_, MeshBuilder::kNone, {});
      }
    }
  }

  InputBuffer input_;
  MeshBuilder builder_;
  Header header_;
  MaterialTable materials_;
  ReadResult result_;
  bool has_normals_ = false, has_colors_ = false, has_vertex_texcoords_ = false;
  bool has_faces_ = false, has_grid_ = false, has_textures_ = false;
  bool warned_of_alpha_ = false;
  float color_scale_ = 1.0F;
  float largest_color_ = 0.0F;    // of vertices, scaled
  double least_alpha_ = 65535.0;  // of vertices
  std::vector<Corner> corners_;
  UniqueRows<Texcoords> texcoords_{builder_.texcoords};  ///< Texture coordinates of corners.
  GrowingTable<Indices> grid_;
  GrowingTable<Rows<std::int32_t, 4>> texture_faces_;  ///< Texture coordinates and texture.
};

}  // namespace

ReadResult read_ply(ByteSource& source, const ReadOptions&, const Progress& progress) {
  return PlyReader(source, progress).read_mesh();
}

RangeGrid read_range_grid(const std::filesystem::path& path, const ReadOptions& options,
                          const Progress& progress) {
  try {
    const auto source = decompressed(file_source(path), compression_of(path), options.max_bytes);
    return PlyReader(*source, progress).read_grid();
  } catch (const FormatError& error) {
    throw error.in_file(path.string());
  }
}

}  // namespace manip3d
