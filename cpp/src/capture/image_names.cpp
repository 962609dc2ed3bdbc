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

std::string same_key(const std::string& name, ImageKind) { return name; }

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

/// The name that has each key; -1 for a key that several names share.
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

enum class Side { kFirst, kLast };  // of a name

/// The numbers of each name, from the first or the last one on.
std::vector<std::vector<std::string>> numbers_from(const std::vector<std::string>& names,
                                                   Side side) {
  std::vector<std::vector<std::string>> numbers;
  for (const std::string& name : names) {
    std::vector<std::string>& own = numbers.emplace_back();
    for (Word& word : words_of(name)) {
      if (word.is_number) own.push_back(std::move(word.text));
    }
    if (side == Side::kLast) std::ranges::reverse(own);
  }
  return numbers;
}

/// The first or the last number that is not the same in all names: others are a date or a size.
/// Empty: a name has none that is whole and below 1e9, or they do not ascend.
std::vector<std::int64_t> ascending_numbers(const std::vector<std::string>& names, Side side) {
  const auto listed = numbers_from(names, side);
  std::size_t fewest = listed.empty() ? 0 : listed[0].size(), place = 0;
  for (const auto& own : listed) fewest = std::min(fewest, own.size());
  if (fewest == 0) return {};
  const auto is_constant = [&] {
    return std::ranges::all_of(listed,
                               [&](const auto& own) { return own[place] == listed[0][place]; });
  };
  while (place + 1 < fewest && is_constant()) ++place;
  std::vector<std::int64_t> numbers;
  for (const auto& own : listed) {
    const auto number = scaled_decimal(own[place], 0);
    if (!number || *number >= kLeastEpoch) return {};
    if (!numbers.empty() && *number <= numbers.back()) return {};
    numbers.push_back(*number);
  }
  return numbers;
}

std::vector<std::int64_t> frame_numbers(const std::vector<std::string>& names) {
  return ascending_numbers(names, Side::kLast);
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

/// Whether ascending numbers are those of frames, of which some may be lost.
bool are_frame_numbers(const std::vector<std::int64_t>& numbers) {
  const auto steps = differences(numbers);
  if (steps.empty()) return false;
  const std::int64_t step = std::ranges::min(steps);
  const auto is_multiple = [step](std::int64_t difference) { return difference % step == 0; };
  return 2 * std::ranges::count(steps, step) > std::ssize(steps) &&
         (numbers.back() - numbers[0]) / step < kMostFrames &&
         std::ranges::all_of(steps, is_multiple);
}

/// Whether both lists are counted in steps of 1, from the same number, or from 0 and 1.
bool are_counted_alike(const std::vector<std::int64_t>& a, const std::vector<std::int64_t>& b) {
  const auto last = [](const auto& numbers) { return numbers[0] + std::ssize(numbers) - 1; };
  if (a.empty() || b.empty()) return false;
  const bool are_from_0_and_1 = std::min(a[0], b[0]) == 0 && std::max(a[0], b[0]) == 1;
  return (a[0] == b[0] || are_from_0_and_1) && a.back() == last(a) && b.back() == last(b);
}

/// Whether two counters may have numbered the images, that of colour at a higher rate: both lists
/// have equal steps and begin with the same number, and colour is longer than frames are lost.
bool may_have_two_counters(const std::vector<std::int64_t>& depth,
                           const std::vector<std::int64_t>& color) {
  return depth.size() > 1 && color.size() > 1 && has_no_gaps(depth) && has_no_gaps(color) &&
         depth[0] == color[0] && depth[1] == color[1] && 9 * color.size() > 10 * depth.size();
}

[[noreturn]] void refuse_pairs(const std::vector<std::string>& depth,
                               const std::vector<std::string>& color,
                               const std::vector<std::int64_t>& partner) {
  const std::string count = std::to_string(depth.size());
  const auto first = std::ranges::find(partner, -1) - partner.begin();
  const std::string example = "; the first depth image without one of its number is ";
  if (depth.size() == color.size()) {
    throw FormatError(
        "expected names of depth and colour images of which all agree, or none, got " +
            std::to_string(num_pairs(partner)) + " of " + count +
            " that agree: rename the images of one list" + example + depth[first],
        {});
  }
  throw FormatError(
      "expected a colour image of the same number for each depth image, or, if no numbers agree, "
      "as many colour as depth images, got " +
          std::to_string(color.size()) + " and " + count + example + depth[first],
      {});
}

[[noreturn]] void refuse_two_counters(std::size_t num_depth, std::size_t num_color) {
  throw FormatError(
      "expected about as many colour as depth images, since both are numbered without gaps and may "
      "have counters of their own, got " +
          std::to_string(num_color) + " and " + std::to_string(num_depth) +
          ": remove the colour images that belong to no depth image",
      {});
}

/// The pairs of names of both lists that agree in the best of the ways.
std::vector<std::int64_t> pairs_that_agree(const std::vector<std::string>& depth,
                                           const std::vector<std::string>& color) {
  std::vector<std::int64_t> partner(depth.size(), -1);
  for (const Key key : {same_key, words_key, numbers_key}) {
    auto others = pairs_by_key(depth, color, key);
    if (num_pairs(others) > num_pairs(partner)) partner = std::move(others);
  }
  return partner;
}

/// Whether lists are in the same order although few names agree, or none.
bool have_one_order(const std::vector<std::string>& depth, const std::vector<std::string>& color,
                    std::int64_t agreeing) {
  if (depth.size() != color.size()) return false;
  const auto a = frame_numbers(depth), b = frame_numbers(color);
  const bool have_others =
      !a.empty() && !b.empty() && !(are_frame_numbers(a) && are_frame_numbers(b));
  return agreeing == 0 || (have_others && 10 * agreeing <= std::ssize(depth)) ||
         are_counted_alike(a, b) ||
         are_counted_alike(ascending_numbers(depth, Side::kFirst),
                           ascending_numbers(color, Side::kFirst));
}

/// Both lists with_whole_numbers(), by one decision.
std::pair<std::vector<std::string>, std::vector<std::string>> with_whole_numbers_in_both(
    std::vector<std::string> names, const std::vector<std::string>& others) {
  const auto count = std::ssize(names);
  names.insert(names.end(), others.begin(), others.end());
  names = with_whole_numbers(std::move(names));
  std::vector<std::string> second(names.begin() + count, names.end());
  names.erase(names.begin() + count, names.end());
  return {std::move(names), std::move(second)};
}

}  // namespace

bool has_decimals(const std::vector<std::string>& names) {
  constexpr std::size_t kFineWhole = 5, kFineFraction = 3;  // digits; numbers of takes have fewer
  bool is_fine = false, ends_in_0 = false, has_one_length = true;
  std::size_t length = 0;  // of the first fraction
  for (const std::string& name : names) {
    for (const Word& word : words_of(name)) {
      const std::size_t point = word.is_number ? word.text.find('.') : std::string::npos;
      if (point == std::string::npos) continue;
      const std::size_t digits = word.text.size() - point - 1;
      if (length == 0) length = digits;
      has_one_length &= digits == length;
      is_fine |= point >= kFineWhole || digits >= kFineFraction;
      ends_in_0 |= digits > 1 && word.text.back() == '0';
    }
  }
  return is_fine && (has_one_length || !ends_in_0);
}

std::vector<std::string> with_whole_numbers(std::vector<std::string> names) {
  if (has_decimals(names)) return names;
  for (std::string& name : names) {
    for (std::size_t i = 1; i + 1 < name.size(); ++i) {
      if (name[i] == '.' && is_digit(name[i - 1]) && is_digit(name[i + 1])) name[i] = ' ';
    }
  }
  return names;
}

bool comes_before(std::string_view a, std::string_view b, bool decimals) {
  const std::string_view whole_a = a, whole_b = b;
  const std::string_view fraction_a = decimals ? fraction_of(a) : std::string_view{};
  const std::string_view fraction_b = decimals ? fraction_of(b) : std::string_view{};
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
  const std::vector<std::int64_t> numbers = frame_numbers(with_whole_numbers(names));
  if (!are_frame_numbers(numbers)) return indices;
  const std::int64_t step = std::ranges::min(differences(numbers));
  for (std::size_t i = 0; i < numbers.size(); ++i) indices[i] = (numbers[i] - numbers[0]) / step;
  return indices;
}

std::vector<std::int64_t> pair_by_name(const std::vector<std::string>& depth_names,
                                       const std::vector<std::string>& color_names) {
  const auto [depth, color] = with_whole_numbers_in_both(depth_names, color_names);
  std::vector<std::int64_t> partner = pairs_that_agree(depth, color);
  const std::int64_t count = std::ssize(depth), agreeing = num_pairs(partner);
  const auto a = frame_numbers(depth), b = frame_numbers(color);
  if (agreeing == count) {
    if (may_have_two_counters(a, b)) refuse_two_counters(depth.size(), color.size());
    return partner;
  }
  if (have_one_order(depth, color, agreeing)) {
    std::iota(partner.begin(), partner.end(), 0);
    return partner;
  }
  const int without_gaps = (has_no_gaps(a) ? 1 : 0) + (has_no_gaps(b) ? 1 : 0);
  const bool is_enough = without_gaps == 2 ? 10 * agreeing >= 9 * count : 3 * agreeing >= 2 * count;
  if (!is_enough || (depth.size() == color.size() && without_gaps > 0)) {
    refuse_pairs(depth_names, color_names, partner);
  }
  return partner;
}

}  // namespace manip3d
