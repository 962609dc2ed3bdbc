#include "manip3d/io/mtl.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <iterator>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>

#include "io/warnings.hpp"
#include "parse/input_buffer.hpp"
#include "parse/letters.hpp"
#include "parse/line_cursor.hpp"
#include "parse/number.hpp"

namespace manip3d {
namespace {

// Options of a map with the least and the largest number of their arguments, and the arguments that
// leave the picture as it is; empty: any do.
struct MapOption {
  std::string_view name;
  int least, most;
  std::array<std::string_view, 3> neutral;
};
constexpr MapOption kMapOptions[] = {
    {"-blendu", 1, 1, {}},
    {"-blendv", 1, 1, {}},
    {"-boost", 1, 1, {}},
    {"-bm", 1, 1, {}},
    {"-cc", 1, 1, {}},
    {"-clamp", 1, 1, {"off"}},
    {"-imfchan", 1, 1, {"rgb"}},
    {"-mm", 2, 2, {"0", "1"}},
    {"-o", 1, 3, {"0", "0", "0"}},
    {"-s", 1, 3, {"1", "1", "1"}},
    {"-t", 1, 3, {"0", "0", "0"}},
    {"-texres", 1, 1, {}},
    {"-type", 1, 1, {}},
};

// The finite number that a whole word stands for, if it stands for one.
std::optional<double> number_of(std::string_view word) {
  word = without_plus(word);
  const char* const end = word.data() + word.size();
  double number = 0.0;
  const auto [parsed, error] = to_double(word, number);
  if (error != std::errc() || parsed != end || !std::isfinite(number)) return std::nullopt;
  return number;
}

// Whether two words are equal, or stand for equal numbers: 1, +1, 1.0 and 1.000000.
bool is_equal(std::string_view a, std::string_view b) {
  if (a == b) return true;
  const std::optional<double> x = number_of(a), y = number_of(b);
  return x && y && *x == *y;
}

// Reads the file name after the options of a map; names may contain blanks, and some exporters
// quote them. `warn_of` is called for the options that change the picture, except `-clamp on`.
template <typename WarnOf>
Texture read_map(LineCursor& cursor, const char* what, const WarnOf& warn_of) {
  Texture texture;
  while (true) {
    const char* before = cursor.position();
    const std::string_view word = cursor.word();
    const auto* option =
        std::find_if(std::begin(kMapOptions), std::end(kMapOptions),
                     [&](const MapOption& o) { return is_same_in_any_case(word, o.name); });
    if (option == std::end(kMapOptions)) {
      cursor.move_to(before);
      break;
    }
    const bool may_change = !option->neutral[0].empty();
    bool changes_picture = false;
    for (int i = 0; i < option->most; ++i) {
      before = cursor.position();
      const std::string_view argument = cursor.word();
      if (i >= option->least && !number_of(argument)) {
        cursor.move_to(before);
        break;
      }
      changes_picture |= may_change && !is_equal(argument, option->neutral[i]);
      if (option->name == "-clamp" && argument == "on") {
        texture.wrap.fill(TextureWrap::kClamp);
        changes_picture = false;
      }
    }
    if (changes_picture) warn_of(option->name);
  }
  std::string path(cursor.rest());
  if (path.size() > 2 && path.front() == '"' && path.back() == '"') {
    path = path.substr(1, path.size() - 2);
  }
  if (path.empty()) cursor.fail(what, "a file name");
  std::replace(path.begin(), path.end(), '\\', '/');
  texture.path = std::move(path);
  return texture;
}

double from_zero_to(double most, LineCursor& cursor, const char* what) {
  return std::clamp(cursor.number(what), 0.0, most);
}

double fraction(LineCursor& cursor, const char* what) { return from_zero_to(1.0, cursor, what); }

// Reads three numbers, or one for all three. Spectral curves (`Kd spectral FILE`) are left out.
void read_color(LineCursor& cursor, const char* what, double most, double* color) {
  if (cursor.at_end()) cursor.fail(what, "three numbers");
  const char first = *cursor.position();
  if (first == 's' || first == 'x') return;
  double rgb[3];  // a line with an error changes nothing
  rgb[0] = from_zero_to(most, cursor, what);
  rgb[1] = cursor.at_end() ? rgb[0] : from_zero_to(most, cursor, what);
  rgb[2] = cursor.at_end() ? rgb[0] : from_zero_to(most, cursor, what);
  std::copy(std::begin(rgb), std::end(rgb), color);
}

// Does the statement name an image? A Material has a place for some of these.
bool names_texture(std::string_view keyword) {
  constexpr std::string_view kOthers[] = {"bump", "decal", "disp", "norm", "refl"};
  return keyword.starts_with("map_") ||
         std::find(std::begin(kOthers), std::end(kOthers), keyword) != std::end(kOthers);
}

class MtlReader {
 public:
  MtlReader(const std::string& file, std::vector<std::string>& warnings)
      : file_(file), warnings_(warnings) {}

  // Reads a line. An error in it loses its content, not the mesh.
  void line(LineCursor& cursor) {
    const std::string_view written = cursor.word();
    const std::string keyword = lower_case(written);  // map_Kd, map_kd and map_KD are the same
    try {
      statement(keyword, written, cursor);
    } catch (const FormatError& error) {
      constexpr std::int64_t kMost = 100'000;  // each of these lines takes microseconds
      if (++num_bad_lines_ > kMost) throw;
      const auto known = bad_lines_.find(keyword);
      if (known != bad_lines_.end()) {
        ++known->second.num_more;
      } else {
        bad_lines_.emplace(keyword, BadLines{error.in_file(file_).what()});
      }
    }
  }

  std::vector<Material> finish() {
    finish_material();
    for (const auto& [keyword, bad] : bad_lines_) {
      std::string text = bad.first + "; the line is left out";
      if (bad.num_more > 0) text += ", and " + std::to_string(bad.num_more) + " more of its kind";
      warn(warnings_, text);
    }
    return std::move(materials_);
  }

 private:
  // Errors of lines with the same keyword, since libraries may have thousands of materials.
  struct BadLines {
    std::string first;
    std::int64_t num_more = 0;
  };

  void statement(const std::string& keyword, std::string_view written, LineCursor& cursor) {
    if (keyword == "newmtl") {
      finish_material();
      materials_.emplace_back().name = cursor.rest();
      return;
    }
    if (materials_.empty()) return;  // before the first material
    Material& m = materials_.back();
    if (keyword == "kd") {
      read_color(cursor, "Kd", 1.0, m.base_color);
    } else if (keyword == "ke") {
      read_color(cursor, "Ke", std::numeric_limits<double>::max(), m.emissive);
    } else if (keyword == "d") {
      if (cursor.at_end()) cursor.fail("d", "a number");
      const char* const before = cursor.position();
      const bool is_halo = is_same_in_any_case(cursor.word(), "-halo");  // by angle of view
      if (!is_halo) cursor.move_to(before);
      set_opacity(m, fraction(cursor, "d"));
    } else if (keyword == "tr") {
      set_opacity(m, 1.0 - fraction(cursor, "Tr"));
    } else if (keyword == "pr") {
      m.roughness = fraction(cursor, "Pr");
    } else if (keyword == "pm") {
      m.metallic = fraction(cursor, "Pm");
    } else if (names_texture(keyword)) {
      texture(keyword, written, cursor);
    }
  }

  // An opacity of 0 becomes 1, since exporters that write it do not mean an invisible surface: some
  // write the opacity as Tr, which is the transparency.
  void set_opacity(Material& m, double opacity) {
    if (!(opacity > 0.0)) {
      opacity = 1.0;
      if (!std::exchange(has_invisible_, true)) {
        warn(warnings_, file_ + ": materials of opacity 0 (d 0, Tr 1) are read as opaque");
      }
    }
    m.base_color[3] = opacity;
    m.alpha_mode = opacity < 1.0 ? AlphaMode::kBlend : AlphaMode::kOpaque;
  }

  void texture(std::string_view keyword, std::string_view written, LineCursor& cursor) {
    auto& textures = materials_.back().textures;
    const auto map = [&] {
      return read_map(cursor, std::string(written).c_str(), [&](std::string_view option) {
        warn(warnings_, file_ + ": line " + std::to_string(cursor.line()) + ": texture option " +
                            std::string(option) + " is not supported and was left out");
      });
    };
    if (keyword == "map_kd") {
      textures["base_color"] = map();
    } else if (keyword == "map_ke") {
      textures["emissive"] = map();
    } else if (keyword == "norm") {
      textures["normal"] = map();
    } else if (keyword == "map_pr") {
      roughness_map_ = map();
    } else if (keyword == "map_pm") {
      metallic_map_ = map();
    } else if (keyword == "map_d") {
      opacity_map_ = map();
    } else {
      leave_out(written, "a material has no place for it");
    }
  }

  // Warns once per keyword, since libraries may have thousands of materials.
  void leave_out(std::string_view keyword, const char* why) {
    if (!left_out_.emplace(keyword).second) return;
    warn(warnings_, "textures of " + std::string(keyword) + " are left out: " + why);
  }

  void finish_material() {
    if (!materials_.empty()) {
      combine_maps(materials_.back());
      std::erase_if(materials_.back().textures,
                    [](const auto& item) { return item.second.path.empty(); });
    }
    roughness_map_ = metallic_map_ = opacity_map_ = {};
  }

  // Combines maps: glTF has roughness and metallic in one image, and opacity in the image of the
  // base colour. MTL files converted from glTF do as well.
  void combine_maps(Material& m) {
    if (roughness_map_.path == metallic_map_.path) {
      m.textures["metallic_roughness"] = roughness_map_;
    } else {
      leave_out("map_Pr and map_Pm", "expected the same image for both");
    }
    if (opacity_map_.empty()) return;
    if (opacity_map_.path != m.textures["base_color"].path) {
      leave_out("map_d", "expected the image of map_Kd");
    } else if (m.alpha_mode == AlphaMode::kOpaque) {
      m.alpha_mode = AlphaMode::kMask;
    }
  }

  const std::string& file_;
  std::vector<std::string>& warnings_;
  std::map<std::string, BadLines> bad_lines_;  // by keyword
  std::int64_t num_bad_lines_ = 0;
  std::vector<Material> materials_;
  Texture roughness_map_, metallic_map_, opacity_map_;
  std::set<std::string, std::less<>> left_out_;  // keywords with a warning
  bool has_invisible_ = false;                   // whether there was a warning of opacity 0
};

}  // namespace

std::vector<Material> read_mtl(ByteSource& source, const std::string& file,
                               std::vector<std::string>& warnings) {
  InputBuffer input(source);
  MtlReader reader(file, warnings);
  std::string_view line;
  while (input.next_joined_line(line)) {
    LineCursor cursor(line, input.line());
    if (!cursor.at_end()) reader.line(cursor);
  }
  return reader.finish();
}

}  // namespace manip3d
