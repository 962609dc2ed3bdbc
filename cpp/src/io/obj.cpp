#include <algorithm>
#include <charconv>
#include <initializer_list>
#include <limits>
#include <map>
#include <set>
#include <string>
#include <string_view>
#include <system_error>
#include <unordered_map>
#include <vector>

#include "io/formats.hpp"
#include "io/mesh_builder.hpp"
#include "io/texture_files.hpp"
#include "io/warnings.hpp"
#include "manip3d/error.hpp"
#include "manip3d/io/mtl.hpp"
#include "parse/input_buffer.hpp"
#include "parse/line_cursor.hpp"

namespace manip3d {
namespace fs = std::filesystem;
namespace {

// Name that we write for faces without a material if other faces have one. OBJ has no standard
// statement for that, and programs give faces after a `usemtl` without a name, or before the first
// one, the material of others.
constexpr std::string_view kNoMaterial = "manip3d_no_material";

class ObjReader {
 public:
  ObjReader(ByteSource& source, const ReadOptions& options, const Progress& progress)
      : options_(options), input_(source, progress), builder_(input_, 1) {}

  ReadResult read() {
    std::string_view line;
    while (input_.next_joined_line(line)) {
      LineCursor cursor(line, input_.line());
      if (!cursor.at_end()) statement(cursor);
    }
    if (builder_.vertices.size() == 0 && unknown_line_ > 0) {
      throw FormatError::at_line(unknown_line_, "expected OBJ statements (v, f, ...), found none");
    }
    builder_.finish(result_);
    for (const std::string& name : material_names_) {
      const auto known = library_.find(name);
      Material& material = result_.mesh.materials.emplace_back();
      if (known != library_.end()) material = known->second;
      material.name = name;
    }
    return std::move(result_);
  }

 private:
  using Corner = MeshBuilder::Corner;
  // A statement that a mesh has no place for and that may be the only content of a file.
  struct LeftOut {
    std::string_view keyword;
    const char* warning;  // null: no part of the shape is lost
  };
  static constexpr const char* kNoLines = "points and lines are left out";
  static constexpr const char* kNoCurves = "free-form curves and surfaces are left out";
  static constexpr LeftOut kLeftOut[] = {
      {"o", nullptr},  {"g", nullptr},  {"s", nullptr},    {"mg", nullptr},     {"l", kNoLines},
      {"p", kNoLines}, {"vp", nullptr}, {"call", nullptr}, {"curv", kNoCurves}, {"surf", kNoCurves},
  };

  void statement(LineCursor& cursor) {
    const std::string_view keyword = cursor.word();
    if (keyword == "v") {
      vertex(cursor);
    } else if (keyword == "vt") {
      texcoord(cursor);
    } else if (keyword == "vn") {
      double* row = builder_.normals.append(input_);
      for (int k = 0; k < 3; ++k) row[k] = attribute(cursor, "vn");
    } else if (keyword == "f" || keyword == "fo") {
      face(cursor);
    } else if (keyword == "usemtl") {
      use_material(cursor.rest());
    } else if (keyword == "mtllib") {
      load_libraries(cursor.rest());
    } else {
      leave_out(keyword, cursor.line());
    }
  }

  void leave_out(std::string_view keyword, std::int64_t line) {
    ++result_.num_skipped;
    const auto* known = std::find_if(std::begin(kLeftOut), std::end(kLeftOut),
                                     [&](const LeftOut& l) { return l.keyword == keyword; });
    if (known == std::end(kLeftOut)) {
      if (unknown_line_ == 0) unknown_line_ = line;
    } else if (known->warning != nullptr && warned_.insert(known->warning).second) {
      warn(result_.warnings, known->warning);
    }
  }

  // v x y z [w] | v x y z r g b [a]; w belongs to rational curves, which are skipped.
  void vertex(LineCursor& cursor) {
    double* row = builder_.vertices.append(input_);
    for (int k = 0; k < 3; ++k) row[k] = cursor.number("v");
    if (cursor.at_end()) return;
    double extra[4];
    int num_extra = 0;
    while (num_extra < 4 && !cursor.at_end()) extra[num_extra++] = cursor.number("v");
    if (num_extra == 2 || !cursor.at_end()) cursor.fail("v", "3, 4, 6 or 7 numbers");
    if (num_extra < 3) return;
    builder_.colors.fill(builder_.vertices.size() - 1, std::numeric_limits<float>::quiet_NaN(),
                         input_);
    float* color = builder_.colors.append(input_);
    for (int k = 0; k < 3; ++k) color[k] = static_cast<float>(extra[k]);
  }

  void texcoord(LineCursor& cursor) {
    double* row = builder_.texcoords.append(input_);
    row[0] = attribute(cursor, "vt");
    row[1] = cursor.at_end() ? 0.0 : attribute(cursor, "vt");
  }

  // Exporters that divide by zero write NaN, which does not change the surface.
  double attribute(LineCursor& cursor, const char* what) {
    if (!cursor.take_nan()) return cursor.number(what);
    builder_.may_have_nan = true;
    return std::numeric_limits<double>::quiet_NaN();
  }

  void face(LineCursor& cursor) {
    corners_.clear();
    while (!cursor.at_end()) corners_.push_back(corner(cursor));
    builder_.add_polygon(corners_, material_, {cursor.line(), std::nullopt});
  }

  // a | a/b | a//c | a/b/c
  Corner corner(LineCursor& cursor) {
    const char* start = cursor.position();
    const char* at = start;
    const char* end = cursor.end();
    const auto more = [&] { return at < end && !LineCursor::is_blank(*at); };
    Corner corner;
    bool good = index(at, end, builder_.vertices.size(), corner.vertex);
    if (good && more() && *at == '/') {
      ++at;
      if (more() && *at != '/') good = index(at, end, builder_.texcoords.size(), corner.texcoord);
      if (good && more() && *at == '/') {
        ++at;
        if (more()) good = index(at, end, builder_.normals.size(), corner.normal);
      }
    }
    if (!good || more()) {
      cursor.move_to(start);
      cursor.fail("face", "v, v/vt, v//vn or v/vt/vn with indices that exist");
    }
    cursor.move_to(at);
    return corner;
  }

  // Reads an index: from 1, or negative for counting back from the last row. Rows that may still
  // come are checked at the end.
  static bool index(const char*& at, const char* end, std::int64_t size, std::int32_t& result) {
    std::int64_t value = 0;
    const auto [stop, error] = std::from_chars(at, end, value);
    if (error != std::errc()) return false;
    at = stop;
    value += value < 0 ? size : -1;
    if (value < 0 || value >= std::numeric_limits<std::int32_t>::max()) return false;
    result = static_cast<std::int32_t>(value);
    return true;
  }

  // Without a name, the following faces have no material.
  void use_material(std::string_view name) {
    if (name.empty() || name == kNoMaterial) {
      material_ = MeshBuilder::kNone;
      return;
    }
    const auto [item, is_new] =
        material_of_name_.try_emplace(std::string(name), material_names_.size());
    if (is_new) material_names_.emplace_back(name);
    material_ = static_cast<std::int32_t>(item->second);
  }

  // `names` is one name with blanks, or several names. If none of these is a file, one name with
  // blanks is likelier.
  void load_libraries(std::string_view names) {
    if (options_.folder.empty()) {
      warn(result_.warnings,
           "material library '" + std::string(names) + "' left out: no folder to read it from");
      return;
    }
    std::string whole(names);
    std::replace(whole.begin(), whole.end(), '\\', '/');
    if (libraries_named_.contains(whole)) return;
    const auto is_there = [&](const std::string& name) {
      std::error_code missing;
      return fs::exists(options_.folder / name, missing);
    };
    const std::vector<std::string> words = library_words(whole);
    if (is_there(whole) || std::none_of(words.begin(), words.end(), is_there)) {
      return load_library(whole);
    }
    for (const std::string& word : words) load_library(word);
  }

  std::vector<std::string> library_words(std::string_view names) const {
    std::vector<std::string> words;
    LineCursor cursor(names, input_.line());
    while (!cursor.at_end()) {
      words.emplace_back(cursor.word());
      check_number_of_libraries(words.size());
    }
    return words;
  }

  // Each library takes system calls.
  void check_number_of_libraries(std::size_t number) const {
    constexpr std::size_t kMaxLibraries = 100;
    if (number > kMaxLibraries) {
      throw FormatError::at_line(input_.line(), "more than 100 material libraries");
    }
  }

  // A library that is missing or outside of the folder loses its materials, not the mesh.
  void load_library(const std::string& name) {
    if (!libraries_named_.insert(name).second) return;
    check_number_of_libraries(libraries_named_.size());
    fs::path path;
    try {
      path =
          options_.allow_outside ? options_.folder / name : resolve_inside(options_.folder, name);
    } catch (const InputError& error) {
      warn(result_.warnings, "material library left out: " + std::string(error.what()));
      return;
    }
    std::error_code refused;
    if (!fs::is_regular_file(path, refused)) {
      warn(result_.warnings, "material library '" + name + "' not found");
      return;
    }
    if (!libraries_read_.insert(fs::weakly_canonical(path, refused)).second) return;
    try {
      const auto source = decompressed(file_source(path), Compression::kNone, options_.max_bytes);
      for (Material& m : read_mtl(*source, name, result_.warnings)) {
        std::string key = m.name;
        library_.try_emplace(std::move(key), std::move(m));
      }
    } catch (const FormatError& error) {
      throw error.in_file(path.string());
    }
  }

  const ReadOptions& options_;
  InputBuffer input_;
  MeshBuilder builder_;
  ReadResult result_;
  std::int64_t unknown_line_ = 0;  // line of the first unknown statement; 0: none
  std::set<std::string_view> warned_;
  std::vector<Corner> corners_;
  std::unordered_map<std::string, std::size_t> material_of_name_;
  std::vector<std::string> material_names_;
  std::int32_t material_ = MeshBuilder::kNone;
  std::unordered_map<std::string, Material> library_;
  std::set<std::string> libraries_named_;
  std::set<fs::path> libraries_read_;
};

}  // namespace

namespace {

bool clamps(const Texture& texture) {
  return texture.smooth && texture.wrap[0] == TextureWrap::kClamp &&
         texture.wrap[1] == TextureWrap::kClamp;
}

void map_line(std::string& text, const char* keyword, const std::string& name,
              const Texture& texture) {
  if (name.empty()) return;
  text += std::string(keyword) + (clamps(texture) ? " -clamp on " : " ") + name + "\n";
}

std::string mtl_text(const WriteJob& job, const std::vector<std::string>& names, bool is_some_bare,
                     CompanionFiles& companions) {
  std::string text;
  if (is_some_bare) text = "newmtl " + std::string(kNoMaterial) + "\nKd 1 1 1\nd 1\nPr 1\nPm 0\n";
  for (std::size_t i = 0; i < names.size(); ++i) {
    const Material& m = job.materials[i];
    const bool is_opaque = m.alpha_mode == AlphaMode::kOpaque;  // whatever its alpha
    const double opacity = is_opaque ? 1.0 : m.base_color[3];
    text += "newmtl " + names[i] + "\nKd " + number_text(m.base_color[0]) + " " +
            number_text(m.base_color[1]) + " " + number_text(m.base_color[2]) + "\nd " +
            number_text(opacity) + "\nPr " + number_text(m.roughness) + "\nPm " +
            number_text(m.metallic) + "\n";
    if (m.emits()) {
      text += "Ke " + number_text(m.emissive[0]) + " " + number_text(m.emissive[1]) + " " +
              number_text(m.emissive[2]) + "\n";
    }
    const auto add = [&](const char* role, std::initializer_list<const char*> keywords) {
      const std::string name = companions.texture_name(m, role);
      if (name.empty()) return;
      const Texture& texture = m.textures.at(role);
      for (const char* keyword : keywords) map_line(text, keyword, name, texture);
      if (texture.has_usual_sampler() || clamps(texture)) return;
      warn(job.warnings, "material " + names[i] +
                             ": OBJ holds no textures that mirror, clamp along one side, or are "
                             "not smoothed");
    };
    add("base_color", {"map_Kd"});
    if (!is_opaque) add("base_color", {"map_d"});
    add("emissive", {"map_Ke"});
    add("normal", {"norm"});
    add("metallic_roughness", {"map_Pr", "map_Pm"});
    if (m.alpha_mode == AlphaMode::kMask && (m.alpha_cutoff != 0.5 || opacity < 1.0)) {
      warn(job.warnings, "material " + names[i] + ": OBJ holds no alpha cutoff");
    }
    if (m.textures.contains("occlusion")) {
      warn(job.warnings, "material " + names[i] + ": OBJ holds no occlusion texture");
    }
  }
  return text;
}

void write_vertices(Output& out, const MeshView& mesh) {
  const bool has_colors = mesh.colors.rows() > 0;
  for (Eigen::Index i = 0; i < mesh.vertices.rows(); ++i) {
    out.text("v");
    for (int k = 0; k < 3; ++k) {
      out.text(" ");
      out.number(mesh.vertices(i, k));
    }
    for (int k = 0; has_colors && k < 3; ++k) {
      out.text(" ");
      out.number(static_cast<float>(mesh.colors(i, k)) / 255.0F);
    }
    out.text("\n");
  }
}

template <typename Table>
void write_rows(Output& out, const char* keyword, const Table& table) {
  for (Eigen::Index i = 0; i < table.rows(); ++i) {
    out.text(keyword);
    for (Eigen::Index k = 0; k < table.cols(); ++k) {
      out.text(" ");
      out.number(table(i, k));
    }
    out.text("\n");
  }
}

void write_corner(Output& out, const MeshView& mesh, Eigen::Index face, int corner) {
  const std::int32_t texcoord =
      mesh.face_texcoords.rows() > 0 ? mesh.face_texcoords(face, corner) : MeshBuilder::kNone;
  const std::int32_t normal =
      mesh.face_normals.rows() > 0 ? mesh.face_normals(face, corner) : MeshBuilder::kNone;
  out.text(" ");
  out.number(std::int64_t{mesh.faces(face, corner)} + 1);
  if (texcoord < 0 && normal < 0) return;
  out.text("/");
  if (texcoord >= 0) out.number(std::int64_t{texcoord} + 1);
  if (normal < 0) return;
  out.text("/");
  out.number(std::int64_t{normal} + 1);
}

}  // namespace

void write_obj(Output& out, const WriteJob& job) {
  const MeshView& mesh = job.mesh;
  std::vector<std::string> names = unique_names(job.materials);
  // A material of the mesh with this name would be read as none.
  if (const auto taken = std::find(names.begin(), names.end(), kNoMaterial); taken != names.end()) {
    std::string other = *taken;
    while (std::find(names.begin(), names.end(), other) != names.end()) other += "_";
    *taken = other;
  }
  const auto material_of = [&](Eigen::Index f) {
    const std::int32_t given = mesh.has_materials() ? mesh.face_material[f] : MeshBuilder::kNone;
    return given < static_cast<std::int32_t>(names.size()) ? given : MeshBuilder::kNone;
  };
  CompanionFiles companions(job);
  if (!names.empty()) {
    bool is_some_bare = false;
    for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f) {
      is_some_bare |= mesh.has_materials() && material_of(f) < 0;
    }
    const fs::path stem = without_compression_suffix(job.path).stem();
    const std::string content = mtl_text(job, names, is_some_bare, companions);
    out.text("mtllib " + companions.place(line_name(stem.string()) + ".mtl", content) + "\n");
  }
  write_vertices(out, mesh);
  write_rows(out, "vt", mesh.texcoords);
  write_rows(out, "vn", mesh.normals);
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f) {
    const std::int32_t now = material_of(f);
    if (!names.empty() && mesh.has_materials() && (f == 0 || now != material_of(f - 1))) {
      out.text("usemtl " + (now < 0 ? std::string(kNoMaterial) : names[now]) + "\n");
    }
    out.text("f");
    for (int c = 0; c < 3; ++c) write_corner(out, mesh, f, c);
    out.text("\n");
  }
  companions.commit(out);
}

ReadResult read_obj(ByteSource& source, const ReadOptions& options, const Progress& progress) {
  return ObjReader(source, options, progress).read();
}

}  // namespace manip3d
