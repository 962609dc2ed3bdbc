#include <algorithm>
#include <array>
#include <cctype>
#include <iterator>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "capture/image_frames.hpp"
#include "capture/image_names.hpp"
#include "capture/small_file.hpp"
#include "manip3d/capture/folder.hpp"
#include "manip3d/capture/grab_thread.hpp"
#include "manip3d/error.hpp"
#include "manip3d/files/byte_source.hpp"
#include "parse/input_buffer.hpp"
#include "parse/letters.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;
using Calibration = std::shared_ptr<const RgbdCalibration>;

constexpr double kMillimetres = 1000.0;
constexpr double kTumUnits = 5000.0;
/// Largest difference in time, in nanoseconds, of images that are paired: 0.02 s, as in
/// associate.py of the TUM benchmark.
constexpr std::int64_t kMaxApart = 20'000'000;

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
    list(*at, files);
    ++*at;
    return true;
  };
  const auto seek = [at, count](std::int64_t index) { *at = std::min(index, count); };
  return {next, seek, count, std::move(counters)};
}

// --- plain folders ------------------------------------------------------------------------------

/// Images of one kind, in the order of their times if their names are times, or else of their
/// names.
struct ImageList {
  std::vector<fs::path> paths;
  std::vector<TimedFile> times;  ///< One per image; empty: the names are no times.
};

/// The names of files without their suffixes.
std::vector<std::string> names_of(const std::vector<fs::path>& paths) {
  std::vector<std::string> names;
  for (const fs::path& path : paths) names.push_back(path.stem().string());
  return names;
}

/// Depth images are PNGs only, because JPEG would change their values.
bool is_image_suffix(const std::string& suffix, ImageKind kind) {
  return suffix == ".png" || (kind == ImageKind::kColor && (suffix == ".jpg" || suffix == ".jpeg"));
}

std::vector<fs::path> images_in(const fs::path& folder, ImageKind kind) {
  std::vector<fs::path> images;
  if (!fs::is_directory(folder)) return images;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
    const std::string suffix = lower_case(entry.path().extension().string());
    const bool is_hidden = entry.path().filename().string().starts_with('.');
    if (!is_hidden && is_image_suffix(suffix, kind)) images.push_back(entry.path());
  }
  const bool decimals = has_decimals(names_of(images));
  std::ranges::sort(images, [decimals](const fs::path& a, const fs::path& b) {
    return comes_before(a.filename().native(), b.filename().native(), decimals);
  });
  return images;
}

/// Lists the images of a folder. An image whose name is no time among others whose names are is an
/// error for depth images, and left out for colour images, which belong to no frame then.
ImageList listed_images(const fs::path& folder, ImageKind kind) {
  ImageList list{images_in(folder, kind), {}};
  std::vector<std::optional<std::int64_t>> times;
  for (const std::string& name : with_whole_numbers(names_of(list.paths))) {
    times.push_back(time_in_name(name, kind));
  }
  if (!are_times(times)) return list;
  for (std::size_t i = 0; i < times.size(); ++i) {
    if (times[i]) {
      list.times.push_back({*times[i], list.paths[i].native()});
    } else if (kind == ImageKind::kDepth) {
      throw FormatError("expected a time as its name, as other images of its folder have", {})
          .in_file(list.paths[i].string());
    }
  }
  std::ranges::stable_sort(list.times, {}, &TimedFile::time_ns);
  list.paths.clear();
  for (const TimedFile& file : list.times) list.paths.emplace_back(file.name);
  return list;
}

/// Times in whole microseconds, as those of colors_of_frames in Python, which pairs by the same
/// rule.
std::vector<TimedFile> in_microseconds(std::vector<TimedFile> files) {
  for (TimedFile& file : files) file.time_ns = (file.time_ns + 500) / 1000 * 1000;
  return files;
}

/// The smallest difference between the times of two sorted lists, in nanoseconds.
std::int64_t least_difference(const std::vector<TimedFile>& files,
                              const std::vector<TimedFile>& others) {
  std::int64_t least = std::numeric_limits<std::int64_t>::max();
  for (const TimedFile& file : files) {
    const auto after = std::ranges::lower_bound(others, file.time_ns, {}, &TimedFile::time_ns);
    if (after != others.end()) least = std::min(least, after->time_ns - file.time_ns);
    if (after != others.begin()) least = std::min(least, file.time_ns - std::prev(after)->time_ns);
  }
  return least;
}

/// Pairs images by time. Lists without any pair have the times of two clocks.
std::vector<std::int64_t> pair_by_time(const std::vector<TimedFile>& depth,
                                       const std::vector<TimedFile>& color) {
  std::vector<std::int64_t> partner = associate(depth, color, kMaxApart);
  if (std::ranges::count(partner, -1) < std::ssize(partner)) return partner;
  throw FormatError(
      "expected colour images within 0.02 s of depth images, got " +
          std::to_string(static_cast<double>(least_difference(depth, color)) / 1e9) +
          " s as the smallest difference: name both by one clock, or by frame numbers",
      {});
}

/// The index of each depth image's colour image, or -1: by the times of both, or else by their
/// names.
/// @throws FormatError  it is not known which images belong together.
std::vector<std::int64_t> partners_of(const ImageList& depth, const ImageList& color) {
  if (depth.times.empty() || color.times.empty()) {
    return pair_by_name(names_of(depth.paths), names_of(color.paths));
  }
  return pair_by_time(in_microseconds(depth.times), in_microseconds(color.times));
}

/// Colour images, and the index of each depth image's among them, or -1.
struct ColorImages {
  std::vector<fs::path> paths;
  std::vector<std::int64_t> partner;
};

/// The colour images of a folder; no paths: it has none.
/// @throws FormatError  it is not known which depth images they belong to.
ColorImages paired_colors(const fs::path& folder, const ImageList& depth) {
  ImageList list = listed_images(folder, ImageKind::kColor);
  if (list.paths.empty()) return {};
  std::vector<std::int64_t> partner = partners_of(depth, list);
  return {std::move(list.paths), std::move(partner)};
}

ColorImages colors_of(const fs::path& folder, const ImageList& depth) {
  for (const char* name : {"color", "colour", "rgb"}) {
    if (ColorImages colors = paired_colors(folder / name, depth); !colors.paths.empty()) {
      return colors;
    }
  }
  // SUN3D and Polycam name their colour images so. Elsewhere folders of these names hold any
  // pictures, which must not keep the depth images from being read.
  for (const char* name : {"image", "images"}) {
    try {
      if (ColorImages colors = paired_colors(folder / name, depth); !colors.paths.empty()) {
        return colors;
      }
    } catch (const FormatError&) {
      continue;
    }
  }
  return {};
}

/// Numbers and times of the depth images' frames. Names that are no times are evenly spaced, except
/// for gaps where frame numbers are missing.
std::vector<FrameFiles> frames_of(const ImageList& depth, double rate) {
  std::vector<FrameFiles> frames(depth.paths.size());
  const std::vector<std::int64_t> indices = frame_indices(names_of(depth.paths));
  for (std::size_t i = 0; i < frames.size(); ++i) {
    frames[i].depth.path = depth.paths[i];
    if (depth.times.empty()) {
      frames[i].number = indices[i];
      frames[i].time_ns = static_cast<std::int64_t>(static_cast<double>(indices[i]) * 1e9 / rate);
    } else {
      frames[i].number = static_cast<std::int64_t>(i);
      frames[i].time_ns = depth.times[i].time_ns;
    }
  }
  return frames;
}

[[noreturn]] void refuse_rate(const fs::path& folder) {
  throw InputError("rate: expected none, since the frames of " + folder.string() + " have times");
}

/// @param rate  Frames per second; 0: none is given.
ImageFrames::Listing plain_frames(const fs::path& folder, double rate) {
  const ImageList depth = listed_images(folder / "depth", ImageKind::kDepth);
  if (depth.paths.empty()) {
    throw FormatError("expected frames.jsonl, or PNG images in " + (folder / "depth").string(), {})
        .in_file(folder.string());
  }
  const bool has_times = !depth.times.empty();
  if (has_times && rate > 0.0) refuse_rate(folder);
  const double assumed_rate = rate > 0.0 ? rate : kFolderRate;
  std::vector<FrameFiles> frames = frames_of(depth, assumed_rate);
  Counters counters;
  if (const ColorImages colors = colors_of(folder, depth); !colors.paths.empty()) {
    for (std::size_t i = 0; i < frames.size(); ++i) {
      if (colors.partner[i] >= 0) frames[i].color.path = colors.paths[colors.partner[i]];
    }
    counters.emplace_back("without_color", std::ranges::count(colors.partner, -1));
  }
  const std::int64_t count = std::ssize(frames);
  const auto list = [frames = std::move(frames)](std::int64_t index, FrameFiles& files) {
    files = frames[index];
  };
  ImageFrames::Listing found = listed(count, list, std::move(counters));
  found.assumed_rate = has_times ? 0.0 : assumed_rate;
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

/// The list of colour images; empty: the depth camera had none beside it. OpenLORIS names it
/// color.txt.
std::optional<fs::path> tum_color_list(const fs::path& folder) {
  for (const char* name : {"rgb.txt", "color.txt"}) {
    if (fs::exists(folder / name)) return folder / name;
  }
  return std::nullopt;
}

ImageFrames::Listing tum_frames(const fs::path& folder) {
  // The lock comes first, so that nobody replaces the recording while the lists are read.
  auto lock = std::make_shared<RecordingLock>(folder, RecordingLock::For::kReading);
  const auto parse = [&folder](std::string_view text) {
    return parse_tum_list(text, [&folder](const std::string& name) {
      std::error_code error;  // of a name that no file can have
      return fs::is_regular_file(folder / name, error);
    });
  };
  const auto [depth, is_depth_torn] = parse_file(folder / "depth.txt", parse);
  const std::optional<fs::path> color_list = tum_color_list(folder);
  const auto [color, is_color_torn] = color_list ? parse_file(*color_list, parse) : TumList{};
  const std::vector<std::int64_t> partner = associate(depth, color, kMaxApart);
  const auto list = [folder, depth, color, partner](std::int64_t index, FrameFiles& f) {
    const std::size_t i = index;
    f.number = index;
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
  if (is_recording && options.rate > 0.0) refuse_rate(folder);
  ImageFrames::Listing frames =
      is_recording ? recorded_frames(folder) : plain_frames(folder, options.rate);
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
