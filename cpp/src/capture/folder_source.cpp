#include <algorithm>
#include <array>
#include <cctype>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "capture/image_frames.hpp"
#include "capture/small_file.hpp"
#include "manip3d/capture/folder.hpp"
#include "manip3d/capture/grab_thread.hpp"
#include "manip3d/error.hpp"
#include "manip3d/io/byte_source.hpp"
#include "parse/input_buffer.hpp"
#include "parse/letters.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;
using Calibration = std::shared_ptr<const RgbdCalibration>;

constexpr double kMillimetres = 1000.0;
constexpr double kTumUnits = 5000.0;

/// Runs `parse` on the text of a file, and adds the file's name to its errors.
template <typename Parse>
auto parse_file(const fs::path& path, const Parse& parse) {
  const std::vector<std::byte> bytes = read_small_file(path, kMaxFolderText);
  try {
    return parse(as_text(bytes));
  } catch (const FormatError& error) {
    throw error.in_file(path.string());
  }
}

std::unique_ptr<RgbdSource> make_source(ImageFrames::Listing listing, Calibration stored,
                                        double units_per_metre, const RgbdOptions& options) {
  if (options.units_per_metre > 0.0) units_per_metre = options.units_per_metre;
  auto source =
      std::make_unique<ImageFrames>(std::move(listing), std::move(stored), units_per_metre);
  if (options.speed == 0.0) return source;
  return in_real_time(std::move(source), options.speed);
}

/// The calibration in the folder's calibration.json; null if there is none.
Calibration stored_calibration(const fs::path& folder) {
  const fs::path described = folder / "calibration.json";
  return fs::exists(described) ? parse_file(described, parse_calibration) : nullptr;
}

// --- recordings ---------------------------------------------------------------------------------

/// Counts the complete lines; the second value says if an incomplete line follows them.
std::pair<std::int64_t, bool> count_lines(const fs::path& path) {
  const auto source = file_source(path);
  std::vector<char> block(std::size_t{1} << 16);
  std::int64_t lines = 0;
  char last = '\n';
  while (const std::size_t got = source->read(block.data(), block.size())) {
    lines += std::count(block.begin(), block.begin() + static_cast<std::ptrdiff_t>(got), '\n');
    last = block[got - 1];
  }
  return {lines, last != '\n'};
}

/// The complete lines of frames.jsonl. A recorder that was killed may leave an incomplete line,
/// which is ignored.
class RecordedFrames {
 public:
  RecordedFrames(fs::path folder, std::int64_t num_lines)
      : folder_(std::move(folder)), path_(folder_ / "frames.jsonl"), num_lines_(num_lines) {
    rewind();
  }

  bool next(FrameFiles& files) {
    if (line_ == num_lines_) return false;
    ++line_;
    try {
      std::string_view text;
      if (!buffer_->next_line(text)) return false;
      parse_frame_line(text, buffer_->line(), folder_, files);
    } catch (const FormatError& error) {
      throw error.in_file(path_.string());
    }
    return true;
  }

  void seek(std::int64_t index) {
    if (index < line_) rewind();
    std::string_view text;
    while (line_ < std::min(index, num_lines_) && buffer_->next_line(text)) ++line_;
  }

 private:
  void rewind() {
    auto fresh = file_source(path_);  // may throw: until then the old source stays valid
    buffer_.reset();
    source_ = std::move(fresh);
    buffer_.emplace(*source_);
    line_ = 0;
  }

  fs::path folder_, path_;
  std::unique_ptr<ByteSource> source_;
  std::optional<InputBuffer> buffer_;
  std::int64_t num_lines_, line_ = 0;
};

ImageFrames::Listing recorded_frames(const fs::path& folder) {
  const auto [num_lines, is_cut] = count_lines(folder / "frames.jsonl");
  const auto frames = std::make_shared<RecordedFrames>(folder, num_lines);
  return {[frames](FrameFiles& files) { return frames->next(files); },
          [frames](std::int64_t index) { frames->seek(index); },
          num_lines,
          {{"incomplete", is_cut ? 1 : 0}},
          std::make_shared<RecordingLock>(folder, RecordingLock::For::kReading)};
}

/// A listing of frames that can be listed in any order.
ImageFrames::Listing listed(std::int64_t count,
                            std::function<void(std::int64_t, FrameFiles&)> list_frame,
                            Counters counters) {
  const auto at = std::make_shared<std::int64_t>(0);
  const auto next = [at, count, list = std::move(list_frame)](FrameFiles& files) {
    if (*at == count) return false;
    files = {};
    files.number = *at;
    list(*at, files);
    ++*at;
    return true;
  };
  const auto seek = [at, count](std::int64_t index) { *at = std::min(index, count); };
  return {next, seek, count, std::move(counters)};
}

// --- plain folders ------------------------------------------------------------------------------

/// Cuts the digits off the front of a text and returns them without leading zeros.
std::string_view cut_number(std::string_view& text) {
  const std::size_t end = std::min(text.find_first_not_of("0123456789"), text.size());
  std::string_view number = text.substr(0, end);
  text.remove_prefix(end);
  number.remove_prefix(std::min(number.find_first_not_of('0'), number.size()));
  return number;
}

/// Whether a name comes before another. Digits are compared by the value of their run, so that 2 is
/// before 10, and come before other characters; 01 is before 1.
bool comes_before(std::string_view a, std::string_view b) {
  const auto starts_with_digit = [](std::string_view s) { return s[0] >= '0' && s[0] <= '9'; };
  const std::string_view whole_a = a, whole_b = b;
  while (!a.empty() && !b.empty()) {
    const bool is_number = starts_with_digit(a);
    if (is_number != starts_with_digit(b)) return is_number;
    if (is_number) {
      const std::string_view x = cut_number(a), y = cut_number(b);
      if (x != y) return x.size() != y.size() ? x.size() < y.size() : x < y;
    } else {
      if (a[0] != b[0]) return a.substr(0, 1) < b.substr(0, 1);
      a.remove_prefix(1);
      b.remove_prefix(1);
    }
  }
  return a.empty() && b.empty() ? whole_a < whole_b : a.empty();
}

std::vector<fs::path> images_in(const fs::path& folder) {
  std::vector<fs::path> images;
  if (!fs::is_directory(folder)) return images;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
    const std::string suffix = lower_case(entry.path().extension().string());
    const bool is_hidden = entry.path().filename().string().starts_with('.');
    if (!is_hidden && (suffix == ".png" || suffix == ".jpg" || suffix == ".jpeg")) {
      images.push_back(entry.path());
    }
  }
  std::ranges::sort(images, [](const fs::path& a, const fs::path& b) {
    return comes_before(a.filename().native(), b.filename().native());
  });
  return images;
}

std::vector<fs::path> color_images_in(const fs::path& folder) {
  for (const char* name : {"color", "colour", "rgb"}) {
    if (auto images = images_in(folder / name); !images.empty()) return images;
  }
  return {};
}

ImageFrames::Listing plain_frames(const fs::path& folder, double rate) {
  const std::vector<fs::path> depth = images_in(folder / "depth");
  const std::vector<fs::path> color = color_images_in(folder);
  if (depth.empty()) {
    throw FormatError("expected frames.jsonl, or images in " + (folder / "depth").string(), {})
        .in_file(folder.string());
  }
  if (!color.empty() && color.size() != depth.size()) {
    throw FormatError("expected as many colour as depth images, got " +
                          std::to_string(color.size()) + " and " + std::to_string(depth.size()),
                      {})
        .in_file(folder.string());
  }
  const auto list = [depth, color, rate](std::int64_t index, FrameFiles& files) {
    const std::size_t i = index;
    files.time_ns = static_cast<std::int64_t>(static_cast<double>(index) * 1e9 / rate);
    files.depth.path = depth[i];
    if (!color.empty()) files.color.path = color[i];
  };
  ImageFrames::Listing found = listed(std::ssize(depth), list, {});
  found.assumed_rate = rate;
  return found;
}

// --- TUM ----------------------------------------------------------------------------------------

struct TumCamera {
  double fx, fy, cx, cy;
};
/// Colour cameras of freiburg1, 2 and 3, to which the depth images are registered, from the
/// benchmark's page on intrinsics. Their distortion is ignored, as in the benchmark's own tools.
constexpr std::array kTumCameras = {TumCamera{517.3, 516.5, 318.6, 255.3},
                                    TumCamera{520.9, 521.0, 325.1, 249.7},
                                    TumCamera{535.4, 539.2, 320.1, 247.6}};
/// "ROS default" of this page, which is valid for all pre-registered images.
constexpr TumCamera kNominalTumCamera = {525.0, 525.0, 319.5, 239.5};

/// The published camera of a folder whose name contains freiburgN or frN, without a letter or digit
/// before it or a digit after it.
std::optional<TumCamera> published_tum_camera(const fs::path& folder) {
  const fs::path whole = fs::absolute(folder).lexically_normal();
  const std::string name = (whole.has_filename() ? whole : whole.parent_path()).filename();
  const auto at = [&](std::size_t i) {
    return i < name.size() ? static_cast<unsigned char>(name[i]) : 0U;
  };
  for (const std::string_view word : {"freiburg", "fr"}) {
    for (std::size_t i = name.find(word); i != std::string::npos; i = name.find(word, i + 1)) {
      const std::size_t number = i + word.size();
      const bool is_word = i == 0 || std::isalnum(static_cast<int>(at(i - 1))) == 0;
      const bool ends_number = std::isdigit(static_cast<int>(at(number + 1))) == 0;
      const std::size_t camera = at(number) - std::size_t{'1'};
      if (is_word && ends_number && camera < kTumCameras.size()) return kTumCameras[camera];
    }
  }
  return std::nullopt;
}

Calibration tum_calibration(const TumCamera& camera) {
  auto calibration = std::make_shared<RgbdCalibration>();
  calibration->depth.width = 640;
  calibration->depth.height = 480;
  calibration->depth.fx = camera.fx;
  calibration->depth.fy = camera.fy;
  calibration->depth.cx = camera.cx;
  calibration->depth.cy = camera.cy;
  return calibration;
}

ImageFrames::Listing tum_frames(const fs::path& folder) {
  constexpr std::int64_t kMaxApart = 20'000'000;  // associate.py of the benchmark: 0.02 s
  // The lock comes first, so that nobody replaces the recording while the lists are read.
  auto lock = std::make_shared<RecordingLock>(folder, RecordingLock::For::kReading);
  const auto parse = [&folder](std::string_view text) {
    return parse_tum_list(text, [&folder](const std::string& name) {
      std::error_code error;  // of a name that no file can have
      return fs::is_regular_file(folder / name, error);
    });
  };
  const auto [depth, is_depth_torn] = parse_file(folder / "depth.txt", parse);
  const auto [color, is_color_torn] = parse_file(folder / "rgb.txt", parse);
  const std::vector<std::int64_t> partner = associate(depth, color, kMaxApart);
  const auto list = [folder, depth, color, partner](std::int64_t index, FrameFiles& f) {
    const std::size_t i = index;
    f.time_ns = depth[i].time_ns;
    f.depth.path = folder / depth[i].name;
    if (partner[i] >= 0) f.color.path = folder / color[partner[i]].name;
  };
  ImageFrames::Listing found = listed(std::ssize(depth), list,
                                      {{"without_color", std::ranges::count(partner, -1)},
                                       {"incomplete", is_depth_torn || is_color_torn ? 1 : 0}});
  found.lock = std::move(lock);
  return found;
}

}  // namespace

std::unique_ptr<RgbdSource> open_folder(const fs::path& folder, const RgbdOptions& options) {
  Calibration calibration = options.calibration ? options.calibration : stored_calibration(folder);
  const bool is_recording = fs::exists(folder / "frames.jsonl");
  if (is_recording && options.rate > 0.0) {
    throw InputError("rate: expected none, since the frames of " + folder.string() + " have times");
  }
  ImageFrames::Listing frames =
      is_recording ? recorded_frames(folder)
                   : plain_frames(folder, options.rate > 0.0 ? options.rate : kFolderRate);
  frames.marks_missing = !is_recording;
  if (!calibration) {
    throw InputError("calibration: " + folder.string() +
                     " has no calibration.json: expected the camera of its images "
                     "(--intrinsics, or camera= in Python)");
  }
  return make_source(std::move(frames), std::move(calibration), kMillimetres, options);
}

std::unique_ptr<RgbdSource> open_tum(const fs::path& folder, const RgbdOptions& options) {
  ImageFrames::Listing frames = tum_frames(folder);
  frames.marks_missing = true;
  Calibration calibration = options.calibration ? options.calibration : stored_calibration(folder);
  if (!calibration) {
    const std::optional<TumCamera> camera = published_tum_camera(folder);
    if (!camera) frames.counters.emplace_back("nominal_camera", 1);
    calibration = tum_calibration(camera.value_or(kNominalTumCamera));
  }
  return make_source(std::move(frames), std::move(calibration), kTumUnits, options);
}

}  // namespace manip3d
