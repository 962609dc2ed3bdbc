#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <queue>
#include <string>
#include <tuple>
#include <utility>

#include "capture/image_frames.hpp"
#include "capture/rgbd_json.hpp"
#include "manip3d/error.hpp"
#include "parse/json_text.hpp"
#include "parse/line_cursor.hpp"

// Parsers of the text files that describe the frames of a folder.
namespace manip3d {
namespace {

constexpr std::int64_t kLeast = std::numeric_limits<std::int64_t>::min();
constexpr std::int64_t kMost = std::numeric_limits<std::int64_t>::max();
constexpr std::int64_t kMaxLineValues = 100'000;  // 64 skeletons have 13 000

/// Parses one line of a file, or all of it, as JSON of limited size.
JsonPlace::Json parse_bounded(std::string_view text) {
  if (count_json_values(text, 0) > kMaxLineValues) {
    throw FormatError("expected at most " + std::to_string(kMaxLineValues) + " values", {});
  }
  return parse_json(text, 0);
}

/// A plain file name, which cannot lead out of its folder.
std::string file_name(const JsonPlace& place) {
  const std::string& name = place.text();
  const auto is_plain = [](char c) {
    return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_' ||
           c == '-' || c == '.';
  };
  if (name.empty() || name.front() == '.' || !std::ranges::all_of(name, is_plain)) {
    place.fail("expected the name of a file in this folder");
  }
  return name;
}

ImageFile image_file(const JsonPlace& place, const std::filesystem::path& folder) {
  constexpr std::int64_t kMaxCrc = 0xffffffff;
  return {folder / file_name(place.member("file")),
          static_cast<std::uint32_t>(place.member("crc32").integer(0, kMaxCrc))};
}

bool is_inside(std::string_view path) {
  const std::filesystem::path parts{path};
  return !path.empty() && !parts.is_absolute() && path.find('\0') == std::string_view::npos &&
         std::ranges::none_of(parts, [](const auto& part) { return part == ".."; });
}

/// Converts decimal seconds to nanoseconds exactly; a double would round them. The text has digits,
/// and at most nine of them after a point.
std::optional<std::int64_t> exact_ns(std::string_view seconds) {
  const std::size_t point = std::min(seconds.find('.'), seconds.size());
  std::string digits{seconds.substr(0, point)};
  const std::string_view fraction = seconds.substr(std::min(point + 1, seconds.size()));
  if (point > 10 || fraction.size() > 9) return std::nullopt;
  digits += fraction;
  digits.append(9 - fraction.size(), '0');
  const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
  if (!std::ranges::all_of(digits, is_digit)) return std::nullopt;
  return std::stoll(digits);
}

/// Parses a line of a TUM sequence's list; returns nothing if it is blank or a comment.
std::optional<TimedFile> timed_file(std::string_view text, std::int64_t line) {
  LineCursor words(text, line);
  if (words.at_end()) return std::nullopt;
  constexpr double kMaxSeconds = 9e9;  // so that nanoseconds fit 64 bits
  const char* start = words.position();
  const std::string_view exact = words.word();
  words.move_to(start);
  const double seconds = words.number("time");
  if (!(std::abs(seconds) <= kMaxSeconds)) {
    throw FormatError::at_line(line, "time: expected seconds up to 9e9");
  }
  const std::string_view name = words.word();
  if (!is_inside(name)) {
    throw FormatError::at_line(line, "file: expected a name inside the sequence's folder");
  }
  return TimedFile{exact_ns(exact).value_or(std::llround(seconds * 1e9)), std::string(name)};
}

}  // namespace

void parse_frame_line(std::string_view text, std::int64_t line, const std::filesystem::path& folder,
                      FrameFiles& files) {
  try {
    const JsonPlace::Json json = parse_bounded(text);
    const JsonPlace root(json, "", 0);
    files.number = root.member("number").integer(kLeast, kMost);
    files.time_ns = root.member("time_ns").integer(kLeast, kMost);
    files.depth = image_file(root.member("depth"), folder / "depth");
    files.body_index = files.color = {};
    if (const auto image = root.find("body_index")) {
      files.body_index = image_file(*image, folder / "body_index");
    }
    if (const auto image = root.find("colour")) {
      files.color = image_file(*image, folder / "colour");
    }
    skeletons_from_json(root.member("skeletons"), files.skeletons);
  } catch (const FormatError& error) {
    throw FormatError::at_line(line, error.reason());
  }
}

std::shared_ptr<const RgbdCalibration> parse_calibration(std::string_view text) {
  const JsonPlace::Json json = parse_bounded(text);
  const JsonPlace root(json, "", 0);
  if (root.member("format").text() != "manip3d-rgbd") root.fail("expected format manip3d-rgbd");
  if (root.member("version").integer(1, kMost) != 1) root.fail("expected version 1");
  return calibration_from_json(root.member("calibration"));
}

TumList parse_tum_list(std::string_view text,
                       const std::function<bool(const std::string&)>& exists) {
  TumList list;
  std::int64_t line = 0;
  while (!text.empty()) {
    const std::size_t end = text.find('\n');
    const bool may_be_torn = end == std::string_view::npos;
    const std::string_view words = text.substr(0, end);
    text.remove_prefix(may_be_torn ? text.size() : end + 1);
    try {
      std::optional<TimedFile> file = timed_file(words, ++line);
      if (!file) continue;
      list.is_torn = may_be_torn && !exists(file->name);
      if (!list.is_torn) list.files.push_back(std::move(*file));
    } catch (const FormatError&) {
      if (!may_be_torn) throw;
      list.is_torn = true;
    }
  }
  std::ranges::sort(list.files, {}, [](const TimedFile& file) {
    return std::pair<std::int64_t, std::string_view>(file.time_ns, file.name);
  });
  return list;
}

std::vector<std::int64_t> associate(const std::vector<TimedFile>& files,
                                    const std::vector<TimedFile>& others, std::int64_t most_ns) {
  // All files in order of time, as a list from which pairs are taken. The nearest pair that is left
  // always stands side by side: a file between the two would be nearer to one of them.
  struct Entry {
    std::int64_t time_ns = 0, index = 0;
    bool is_other = false;
    std::int64_t before = 0, after = 0;
  };
  std::vector<Entry> entries;
  entries.reserve(files.size() + others.size());
  for (std::int64_t i = 0; i < std::ssize(files); ++i) {
    entries.push_back({files[i].time_ns, i, false});
  }
  for (std::int64_t i = 0; i < std::ssize(others); ++i) {
    entries.push_back({others[i].time_ns, i, true});
  }
  std::ranges::sort(entries, {}, [](const Entry& entry) {
    return std::tuple(entry.time_ns, entry.is_other, entry.index);
  });
  const std::int64_t count = std::ssize(entries);
  using Pair = std::tuple<std::int64_t, std::int64_t, std::int64_t>;  // distance, two places
  std::priority_queue<Pair, std::vector<Pair>, std::greater<>> pairs;
  const auto consider = [&](std::int64_t a, std::int64_t b) {
    if (a < 0 || b >= count || entries[a].is_other == entries[b].is_other) return;
    if (entries[a].time_ns < entries[b].time_ns - most_ns) return;  // their difference may overflow
    pairs.emplace(entries[b].time_ns - entries[a].time_ns, a, b);
  };
  for (std::int64_t k = 0; k < count; ++k) {
    entries[k].before = k - 1;
    entries[k].after = k + 1;
    consider(k - 1, k);
  }
  std::vector<std::int64_t> partner(files.size(), -1);
  std::vector<bool> is_taken(entries.size());
  while (!pairs.empty()) {
    const auto [apart, a, b] = pairs.top();
    pairs.pop();
    if (is_taken[a] || is_taken[b]) continue;
    is_taken[a] = is_taken[b] = true;
    const Entry& file = entries[entries[a].is_other ? b : a];
    partner[file.index] = entries[entries[a].is_other ? a : b].index;
    const std::int64_t before = entries[a].before, after = entries[b].after;
    if (before >= 0) entries[before].after = after;
    if (after < count) entries[after].before = before;
    consider(before, after);
  }
  return partner;
}

}  // namespace manip3d
