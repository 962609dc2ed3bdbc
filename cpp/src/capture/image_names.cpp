#include "capture/image_names.hpp"

#include <algorithm>
#include <charconv>
#include <iterator>
#include <numeric>
#include <unordered_map>
#include <utility>

#include "manip3d/error.hpp"
#include "parse/letters.hpp"

namespace manip3d {
namespace {

constexpr std::string_view kDigits = "0123456789";

bool is_digit(char c) { return c >= '0' && c <= '9'; }
bool is_letter(char c) {
  const char lower = lower_case(c);
  return (lower >= 'a' && lower <= 'z') || static_cast<unsigned char>(c) >= 0x80;  // UTF-8
}

/// Cuts characters off the front of a text up to a position, or all of them, and returns them.
std::string_view cut(std::string_view& text, std::size_t end) {
  const std::string_view front = text.substr(0, end);
  text.remove_prefix(front.size());
  return front;
}

std::string_view cut_digits(std::string_view& text) {
  return cut(text, text.find_first_not_of(kDigits));
}

std::string_view without_leading_zeros(std::string_view digits) {
  digits.remove_prefix(std::min(digits.find_first_not_of('0'), digits.size()));
  return digits;
}

// --- order --------------------------------------------------------------------------------------

/// The digits after the point of a file's name that is a decimal number (`0.25.png`): digits, a
/// point, digits, and a suffix that does not begin with a digit. Empty: it is another name.
std::string_view fraction_of(std::string_view name) {
  if (cut_digits(name).empty() || !name.starts_with('.')) return {};
  name.remove_prefix(1);
  const std::string_view fraction = cut_digits(name);
  const bool has_suffix = name.size() > 1 && name[0] == '.' && name[1] != '.' && !is_digit(name[1]);
  return has_suffix ? fraction : std::string_view{};
}

// --- words --------------------------------------------------------------------------------------

/// A run of letters, in lower case, or a number.
struct Word {
  std::string text;
  bool is_number = false;
};

/// Cuts digits off the front of a text, with a point and more digits if these follow.
std::string_view cut_number(std::string_view& text) {
  std::size_t end = text.find_first_not_of(kDigits);
  if (end < text.size() && text[end] == '.') {
    const std::size_t after = std::min(text.find_first_not_of(kDigits, end + 1), text.size());
    if (after > end + 1) end = after;
  }
  return cut(text, end);
}

std::vector<Word> words_of(std::string_view name) {
  std::vector<Word> words;
  while (!name.empty()) {
    if (is_digit(name[0])) {
      words.push_back({std::string(cut_number(name)), true});
    } else if (is_letter(name[0])) {
      const auto end = std::ranges::find_if_not(name, is_letter);
      words.push_back({lower_case(cut(name, static_cast<std::size_t>(end - name.begin())))});
    } else {
      name.remove_prefix(1);
    }
  }
  return words;
}

bool names_kind(const Word& word, ImageKind kind) {
  if (kind == ImageKind::kDepth) return word.text == "depth";
  return word.text == "color" || word.text == "colour" || word.text == "rgb";
}

/// Writes equal numbers equally: without zeros that do not change the value.
std::string by_value(std::string_view number) {
  const std::size_t point = std::min(number.find('.'), number.size());
  std::string text{without_leading_zeros(number.substr(0, point))};
  if (point < number.size()) {
    text += number.substr(point);
    text.erase(text.find_last_not_of('0') + 1);
    if (text.ends_with('.')) text.pop_back();
  }
  return text;
}

// --- pairs --------------------------------------------------------------------------------------

constexpr char kSeparator = '/';  // no name of a file contains it

/// The words of a name without the last one for its kind.
std::string words_key(const std::string& name, ImageKind kind) {
  std::vector<Word> words = words_of(name);
  const auto is_kind = [kind](const Word& word) { return names_kind(word, kind); };
  const auto last = std::find_if(words.rbegin(), words.rend(), is_kind);
  if (last != words.rend()) words.erase(std::next(last).base());
  std::string key;
  for (const Word& word : words) {
    key += (word.is_number ? by_value(word.text) : word.text) + kSeparator;
  }
  return key;
}

/// The numbers of a name, or the name itself if it has none.
std::string numbers_key(const std::string& name, ImageKind) {
  std::string key;
  for (const Word& word : words_of(name)) {
    if (word.is_number) key += by_value(word.text) + kSeparator;
  }
  return key.empty() ? name : key;
}

using Key = std::string (*)(const std::string& name, ImageKind kind);

/// The names that have a key; one that several names share tells none of them.
std::unordered_map<std::string, std::int64_t> index_of_keys(const std::vector<std::string>& names,
                                                            ImageKind kind, Key key_of) {
  std::unordered_map<std::string, std::int64_t> index;
  for (std::int64_t i = 0; i < std::ssize(names); ++i) {
    const auto [at, is_new] = index.emplace(key_of(names[i], kind), i);
    if (!is_new) at->second = -1;
  }
  return index;
}

std::vector<std::int64_t> pairs_by_key(const std::vector<std::string>& depth,
                                       const std::vector<std::string>& color, Key key_of) {
  std::vector<std::int64_t> partner(depth.size(), -1);
  const auto colors = index_of_keys(color, ImageKind::kColor, key_of);
  for (const auto& [key, i] : index_of_keys(depth, ImageKind::kDepth, key_of)) {
    const auto found = colors.find(key);
    if (i >= 0 && found != colors.end()) partner[i] = found->second;
  }
  return partner;
}

std::int64_t num_pairs(const std::vector<std::int64_t>& partner) {
  return std::ssize(partner) - std::ranges::count(partner, -1);
}

// --- numbers ------------------------------------------------------------------------------------

constexpr std::int64_t kLeastEpoch = 1'000'000'000;  // the year 2001, in seconds since 1970
constexpr std::int64_t kMostEpoch = 4'000'000'000;   // the year 2096
/// Longest sequence, in frames: its times fit 64 bits at the lowest rate of a folder, 0.01 a
/// second.
constexpr std::int64_t kMostFrames = 90'000'000;
constexpr std::int64_t kMostSeconds = 9'000'000'000;  // so that nanoseconds fit 64 bits

/// The last number of each name. Empty: a name has none that is whole and below 1e9, or they do not
/// ascend.
std::vector<std::int64_t> frame_numbers(const std::vector<std::string>& names) {
  std::vector<std::int64_t> numbers;
  for (const std::string& name : names) {
    std::string_view last;
    const std::vector<Word> words = words_of(name);
    for (const Word& word : words) {
      if (word.is_number) last = word.text;
    }
    const auto number = scaled_decimal(last, 0);
    if (!number || *number >= kLeastEpoch) return {};
    if (!numbers.empty() && *number <= numbers.back()) return {};
    numbers.push_back(*number);
  }
  return numbers;
}

std::vector<std::int64_t> differences(const std::vector<std::int64_t>& numbers) {
  std::vector<std::int64_t> steps;
  for (std::size_t i = 1; i < numbers.size(); ++i) steps.push_back(numbers[i] - numbers[i - 1]);
  return steps;
}

/// Whether numbers have equal differences, so that none is missing between them.
bool has_no_gaps(const std::vector<std::int64_t>& numbers) {
  const auto steps = differences(numbers);
  return !numbers.empty() &&
         std::ranges::count(steps, steps.empty() ? 0 : steps[0]) == std::ssize(steps);
}

/// Whether one list is numbered from 0, the other from 1, both in steps of 1.
bool count_from_0_and_1(const std::vector<std::int64_t>& a, const std::vector<std::int64_t>& b) {
  const auto last = [](const auto& numbers) { return numbers[0] + std::ssize(numbers) - 1; };
  if (a.empty() || b.empty()) return false;
  return std::min(a[0], b[0]) == 0 && std::max(a[0], b[0]) == 1 && a.back() == last(a) &&
         b.back() == last(b);
}

[[noreturn]] void refuse_pairs(const std::vector<std::string>& depth,
                               const std::vector<std::string>& color,
                               const std::vector<std::int64_t>& partner) {
  const auto first = std::ranges::find(partner, -1) - partner.begin();
  throw FormatError(
      "expected a colour image of the same number for each depth image, or, if no "
      "numbers agree, as many colour as depth images, got " +
          std::to_string(color.size()) + " and " + std::to_string(depth.size()) +
          "; the first depth image without one of its number is " + depth[first],
      {});
}

}  // namespace

bool comes_before(std::string_view a, std::string_view b) {
  const std::string_view whole_a = a, whole_b = b;
  const std::string_view fraction_a = fraction_of(a), fraction_b = fraction_of(b);
  while (!a.empty() && !b.empty()) {
    const bool is_number = is_digit(a[0]);
    if (is_number != is_digit(b[0])) return is_number;
    if (is_number) {
      const bool is_fraction = a.data() == fraction_a.data();
      if (is_fraction != (b.data() == fraction_b.data())) return !is_fraction;
      std::string_view x = cut_digits(a), y = cut_digits(b);
      if (!is_fraction) {
        x = without_leading_zeros(x);
        y = without_leading_zeros(y);
        if (x.size() != y.size()) return x.size() < y.size();
      }
      if (x != y) return x < y;
    } else {
      if (a[0] != b[0]) return a.substr(0, 1) < b.substr(0, 1);
      a.remove_prefix(1);
      b.remove_prefix(1);
    }
  }
  return a.empty() && b.empty() ? whole_a < whole_b : a.empty();
}

std::optional<std::int64_t> scaled_decimal(std::string_view text, int places) {
  const std::string_view whole = cut_digits(text);
  std::string_view fraction;
  if (text.size() > 1 && text[0] == '.') {
    text.remove_prefix(1);
    fraction = cut_digits(text);
  }
  if (whole.empty() || !text.empty()) return std::nullopt;
  std::string digits{whole};
  digits += fraction.substr(0, static_cast<std::size_t>(places));
  digits.resize(whole.size() + static_cast<std::size_t>(places), '0');
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  return error == std::errc() ? std::optional(value) : std::nullopt;
}

std::optional<std::int64_t> time_in_name(std::string_view name, ImageKind kind) {
  std::string number;
  for (const Word& word : words_of(name)) {
    if (word.is_number ? !number.empty() : !names_kind(word, kind)) return std::nullopt;
    if (word.is_number) number = word.text;
  }
  const bool has_fraction = number.find('.') != std::string::npos;
  const auto whole = scaled_decimal(number, 0);
  if (!whole) return std::nullopt;
  std::int64_t per_second = 1;
  for (const int places_to_ns : {6, 3, 0}) {  // of milliseconds, microseconds and nanoseconds
    per_second *= 1000;
    const std::int64_t seconds = *whole / per_second;
    if (seconds >= kLeastEpoch && seconds < kMostEpoch) return scaled_decimal(number, places_to_ns);
  }
  if (!has_fraction || *whole >= kMostSeconds) return std::nullopt;
  return scaled_decimal(number, 9);
}

bool are_times(const std::vector<std::optional<std::int64_t>>& times) {
  const auto is_time = [](const auto& time) { return time.has_value(); };
  return !times.empty() && 10 * std::ranges::count_if(times, is_time) >= 9 * std::ssize(times);
}

std::vector<std::int64_t> frame_indices(const std::vector<std::string>& names) {
  std::vector<std::int64_t> indices(names.size());
  std::iota(indices.begin(), indices.end(), 0);
  const std::vector<std::int64_t> numbers = frame_numbers(names);
  const std::vector<std::int64_t> steps = differences(numbers);
  if (steps.empty()) return indices;
  const std::int64_t step = std::ranges::min(steps);
  const auto is_multiple = [step](std::int64_t difference) { return difference % step == 0; };
  const bool is_usual = 2 * std::ranges::count(steps, step) > std::ssize(steps);
  const bool is_short = (numbers.back() - numbers[0]) / step < kMostFrames;
  if (!is_usual || !is_short || !std::ranges::all_of(steps, is_multiple)) return indices;
  for (std::size_t i = 0; i < numbers.size(); ++i) indices[i] = (numbers[i] - numbers[0]) / step;
  return indices;
}

std::vector<std::int64_t> pair_by_name(const std::vector<std::string>& depth,
                                       const std::vector<std::string>& color) {
  std::vector<std::int64_t> partner = pairs_by_key(depth, color, words_key);
  if (auto others = pairs_by_key(depth, color, numbers_key);
      num_pairs(others) > num_pairs(partner)) {
    partner = std::move(others);
  }
  const std::int64_t count = std::ssize(depth), agreeing = num_pairs(partner);
  if (agreeing == count) return partner;
  const auto a = frame_numbers(depth), b = frame_numbers(color);
  const bool are_equally_many = depth.size() == color.size();
  if (are_equally_many && (agreeing == 0 || count_from_0_and_1(a, b))) {
    std::iota(partner.begin(), partner.end(), 0);
    return partner;
  }
  const int without_gaps = (has_no_gaps(a) ? 1 : 0) + (has_no_gaps(b) ? 1 : 0);
  const bool is_enough = without_gaps == 2 ? 10 * agreeing >= 9 * count : 3 * agreeing >= 2 * count;
  if (!is_enough || (are_equally_many && without_gaps > 0)) refuse_pairs(depth, color, partner);
  return partner;
}

}  // namespace manip3d
