#include "manip3d/io/mtl.hpp"

#include <algorithm>
#include <cctype>
#include <string_view>
#include <utility>

#include "io/warnings.hpp"
#include "parse/input_buffer.hpp"
#include "parse/line_cursor.hpp"

namespace manip3d {
namespace {

// Options of a map and how many arguments they take, at most and at least.
struct MapOption {
  std::string_view name;
  int least, most;
  bool changes_picture;
};
constexpr MapOption kMapOptions[] = {
    {"-blendu", 1, 1, false}, {"-blendv", 1, 1, false}, {"-boost", 1, 1, false},
    {"-bm", 1, 1, false},     {"-cc", 1, 1, false},     {"-clamp", 1, 1, true},
    {"-imfchan", 1, 1, true}, {"-mm", 2, 2, true},      {"-o", 1, 3, true},
    {"-s", 1, 3, true},       {"-t", 1, 3, true},       {"-texres", 1, 1, false},
    {"-type", 1, 1, false},
};

bool looks_like_number(std::string_view word) {
  if (word.starts_with('-') || word.starts_with('+')) word.remove_prefix(1);
  if (word.empty()) return false;
  return std::all_of(word.begin(), word.end(), [](char c) {
    return std::isdigit(static_cast<unsigned char>(c)) != 0 || c == '.' || c == 'e' || c == '-';
  });
}

// The file name after the options of a map; names may hold blanks.
std::string map_path(LineCursor& cursor, std::vector<std::string>& warnings) {
  while (true) {
    const char* before = cursor.position();
    const std::string_view word = cursor.word();
    const auto* option = std::find_if(std::begin(kMapOptions), std::end(kMapOptions),
                                      [&](const MapOption& o) { return o.name == word; });
    if (option == std::end(kMapOptions)) {
      cursor.move_to(before);
      break;
    }
    if (option->changes_picture) {
      warn(warnings, "line " + std::to_string(cursor.line()) + ": texture option " +
                         std::string(word) + " is not supported and was left out");
    }
    for (int i = 0; i < option->most; ++i) {
      before = cursor.position();
      const std::string_view argument = cursor.word();
      if (i >= option->least && !looks_like_number(argument)) {
        cursor.move_to(before);
        break;
      }
    }
  }
  std::string path(cursor.rest());
  std::replace(path.begin(), path.end(), '\\', '/');
  return path;
}

double fraction(LineCursor& cursor, const char* what) {
  return std::clamp(cursor.number(what), 0.0, 1.0);
}

// Kd: three numbers, or one for all; spectral curves (`Kd spectral FILE`) are left out.
void read_color(LineCursor& cursor, Material& material) {
  if (cursor.at_end()) cursor.fail("Kd", "three numbers");
  const char first = *cursor.position();
  if (first == 's' || first == 'x') return;
  material.base_color[0] = fraction(cursor, "Kd");
  material.base_color[1] = cursor.at_end() ? material.base_color[0] : fraction(cursor, "Kd");
  material.base_color[2] = cursor.at_end() ? material.base_color[0] : fraction(cursor, "Kd");
}

void set_opacity(Material& material, double opacity) {
  material.base_color[3] = opacity;
  material.alpha_mode = opacity < 1.0 ? AlphaMode::kBlend : AlphaMode::kOpaque;
}

class MtlReader {
 public:
  explicit MtlReader(std::vector<std::string>& warnings) : warnings_(warnings) {}

  void statement(LineCursor& cursor) {
    const std::string_view keyword = cursor.word();
    if (keyword == "newmtl") {
      finish_material();
      materials_.emplace_back().name = cursor.rest();
      return;
    }
    if (materials_.empty()) return;  // before the first material
    Material& m = materials_.back();
    if (keyword == "Kd") {
      read_color(cursor, m);
    } else if (keyword == "d") {
      if (cursor.at_end()) cursor.fail("d", "a number");
      if (*cursor.position() == '-') cursor.word();  // -halo: by the angle of view
      set_opacity(m, fraction(cursor, "d"));
    } else if (keyword == "Tr") {
      set_opacity(m, 1.0 - fraction(cursor, "Tr"));
    } else if (keyword == "Pr") {
      m.roughness = fraction(cursor, "Pr");
    } else if (keyword == "Pm") {
      m.metallic = fraction(cursor, "Pm");
    } else if (keyword == "map_Kd") {
      m.textures["base_color"].path = map_path(cursor, warnings_);
    } else if (keyword == "map_Ke") {
      m.textures["emissive"].path = map_path(cursor, warnings_);
    } else if (keyword == "norm") {
      m.textures["normal"].path = map_path(cursor, warnings_);
    } else if (keyword == "map_Pr") {
      roughness_map_ = map_path(cursor, warnings_);
    } else if (keyword == "map_Pm") {
      metallic_map_ = map_path(cursor, warnings_);
    }
  }

  std::vector<Material> finish() {
    finish_material();
    return std::move(materials_);
  }

 private:
  // glTF keeps both in one image; so does the MTL written from it.
  void finish_material() {
    if (!materials_.empty()) {
      auto& textures = materials_.back().textures;
      if (!roughness_map_.empty() && roughness_map_ == metallic_map_) {
        textures["metallic_roughness"].path = roughness_map_;
      }
      std::erase_if(textures, [](const auto& item) { return item.second.path.empty(); });
    }
    roughness_map_.clear();
    metallic_map_.clear();
  }

  std::vector<std::string>& warnings_;
  std::vector<Material> materials_;
  std::string roughness_map_, metallic_map_;
};

}  // namespace

std::vector<Material> read_mtl(ByteSource& source, std::vector<std::string>& warnings) {
  InputBuffer input(source);
  MtlReader reader(warnings);
  std::string_view line;
  while (input.next_joined_line(line)) {
    LineCursor cursor(line, input.line());
    if (!cursor.at_end()) reader.statement(cursor);
  }
  return reader.finish();
}

}  // namespace manip3d
