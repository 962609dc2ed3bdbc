#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <utility>

#include "capture/image_frames.hpp"
#include "capture/image_names.hpp"
#include "capture/rgbd_json.hpp"
#include "manip3d/error.hpp"
#include "parse/json_text.hpp"
#include "parse/letters.hpp"
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
    return is_digit(c) || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_' ||
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

/// Whether a word has the form of a number with a decimal comma.
bool has_decimal_comma(std::string_view word) {
  if (word.starts_with('-') || word.starts_with('+')) word.remove_prefix(1);
  const std::size_t comma = word.find(',');
  return comma != 0 && comma + 1 < word.size() && std::ranges::count(word, ',') == 1 &&
         std::ranges::count_if(word, is_digit) == std::ssize(word) - 1;
}

/// Makes commas blanks, as the benchmark's associate.py does, if one follows the time. Others are
/// the time's decimal comma or belong to the name of the file.
std::string without_commas(std::string_view text, std::int64_t line) {
  LineCursor words(text, line);
  const std::string_view word = words.word();
  const bool is_last = words.at_end();
  const std::size_t comma = word.find(',');
  const bool is_followed = words.position() < text.data() + text.size() && *words.position() == ',';
  // The word up to its second comma
  const std::string_view time =
      word.substr(0, comma == word.npos ? comma : word.find(',', comma + 1));
  std::string blank{text};
  if (has_decimal_comma(time)) {
    if (time.size() < word.size() || is_followed) {
      throw FormatError::at_line(line, "time: expected a decimal point, or blanks behind the time");
    }
    if (!is_last) return blank;
  }
  if (comma != word.npos || is_followed) std::ranges::replace(blank, ',', ' ');
  return blank;
}

/// Nanoseconds of a time in seconds: those of its decimals, which a double would round.
std::int64_t exact_nanoseconds(std::string_view text, double seconds) {
  const bool is_negative = text.starts_with('-');
  if (is_negative || text.starts_with('+')) text.remove_prefix(1);
  const std::optional<std::int64_t> size = scaled_decimal(text, 9);
  if (!size) return std::llround(seconds * 1e9);
  return is_negative ? -*size : *size;
}

/// Parses a line of a TUM sequence's list; returns nothing if it is blank or a comment.
std::optional<TimedFile> timed_file(std::string_view text, std::int64_t line) {
  const std::string spaced = without_commas(text, line);
  LineCursor words(spaced, line);
  if (words.at_end()) return std::nullopt;
  constexpr double kMaxSeconds = 9e9;  // so that nanoseconds fit 64 bits
  const char* start = words.position();
  const std::string_view exact = words.word();
  words.move_to(start);
  const double seconds = words.number("time");
  if (!(std::abs(seconds) <= kMaxSeconds)) {
    throw FormatError::at_line(line, "time: expected seconds up to 9e9");
  }
  const std::int64_t time_ns = exact_nanoseconds(exact, seconds);
  const std::string_view name = words.word();
  if (!is_inside(name)) {
    throw FormatError::at_line(line, "file: expected a name inside the sequence's folder");
  }
  return TimedFile{time_ns, std::string(name)};
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
  if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);  // byte order mark of UTF-8
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
  // The best chain of pairs that increase in both lists: pairs that cross are never better.
  constexpr std::int64_t kMostPairs = 8;  // of a file: those of 200 images a second; bounds memory
  struct Chain {
    std::int64_t pairs = 0, cost_ns = 0, last = -1;
  };
  struct Pair {
    std::int64_t file = 0, other = 0, before = -1;
  };
  const auto is_better = [](const Chain& a, const Chain& b) {
    return a.pairs != b.pairs ? a.pairs > b.pairs : a.cost_ns < b.cost_ns;
  };
  std::vector<Pair> pairs;
  // best[k]: the best of the chains that end at some of the others before k, as a Fenwick tree.
  std::vector<Chain> best(others.size() + 1);
  const auto best_before = [&](std::int64_t other) {
    Chain found;
    for (std::int64_t k = other; k > 0; k -= k & -k) {
      if (is_better(best[k], found)) found = best[k];
    }
    return found;
  };
  const std::int64_t count = std::ssize(others);
  std::int64_t first = 0;
  for (std::int64_t i = 0; i < std::ssize(files); ++i) {
    const std::int64_t time = files[i].time_ns;
    while (first < count && others[first].time_ns < time - most_ns) ++first;
    std::int64_t end = first;
    while (end < std::min(count, first + kMostPairs) && others[end].time_ns <= time + most_ns) {
      ++end;
    }
    for (std::int64_t k = end - 1; k >= first; --k) {  // later ones first: a file has one partner
      Chain chain = best_before(k);
      pairs.push_back({i, k, chain.last});
      chain = {chain.pairs + 1, chain.cost_ns + std::abs(others[k].time_ns - time),
               std::ssize(pairs) - 1};
      for (std::int64_t at = k + 1; at <= count; at += at & -at) {
        if (is_better(chain, best[at])) best[at] = chain;
      }
    }
  }
  std::vector<std::int64_t> partner(files.size(), -1);
  for (std::int64_t at = best_before(count).last; at >= 0; at = pairs[at].before) {
    partner[pairs[at].file] = pairs[at].other;
  }
  return partner;
}

}  // namespace manip3d
