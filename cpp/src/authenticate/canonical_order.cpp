#include "authenticate/canonical_order.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <string>
#include <tuple>

#include "manip3d/error.hpp"
#include "manip3d/geometry/angles.hpp"

namespace manip3d {
namespace {

constexpr int kCells = 4096;        // cells of diamond angles; each holds at most one border
constexpr double kScale = 1 << 28;  // borders times coordinates of 31 bits fit 64 bits
constexpr int kDigitBits = 11;
// Number of digits of the sort key. kHeightFirst has a third one for rho^2, because many points
// have the same height.
constexpr int digits_of(WatermarkOrder order) {
  return order == WatermarkOrder::kHeightFirst ? 3 : 2;
}
constexpr int kRowBits = 31;  // bits of an item for the row, below its key
constexpr std::uint64_t kRows = std::uint64_t{1} << kRowBits;
constexpr std::uint32_t kBuckets = 1U << kDigitBits;
constexpr std::size_t kShortRun = 24;  // longer runs of equal keys are sorted with std::sort

// The diamond angle: a function of direction that grows from 0 to 4 over a turn, like the azimuth.
// In single precision its error is about 1e-7.
float diamond_angle(float x, float y) {
  const float sum = std::abs(x) + std::abs(y);
  const float t = y / (sum > 0.0F ? sum : 1.0F);
  const float half = x < 0.0F ? 2.0F - t : t;
  return half < 0.0F ? half + 4.0F : half;
}

std::uint64_t squared_radius(const WatermarkSample& s) {
  const auto x = static_cast<std::int64_t>(s.x), y = static_cast<std::int64_t>(s.y);
  return static_cast<std::uint64_t>(x * x) + static_cast<std::uint64_t>(y * y);
}

template <WatermarkOrder kOrder>
bool precedes(const WatermarkSample& a, const WatermarkSample& b) {
  const auto sides = [](const WatermarkSample& s) { return std::tuple(s.x, s.y, s.intensity); };
  if constexpr (kOrder == WatermarkOrder::kColumnsFirst) {
    return std::tuple(sides(a), a.z) < std::tuple(sides(b), b.z);
  }
  if (a.z != b.z) return a.z < b.z;
  if constexpr (kOrder == WatermarkOrder::kHeightFirst) {
    const std::uint64_t near = squared_radius(a), far = squared_radius(b);
    if (near != far) return near < far;
  }
  return sides(a) < sides(b);
}

// The first field of the order.
template <WatermarkOrder kOrder>
std::int32_t first_of(const WatermarkSample& s) {
  return kOrder == WatermarkOrder::kColumnsFirst ? s.x : s.z;
}

// The second field of the order (rho^2), rounded to a float, whose bits grow with its value. It has
// the same relative precision near and far. Ties are resolved later by all fields.
template <WatermarkOrder kOrder>
std::uint32_t second_of(const WatermarkSample& s) {
  if constexpr (kOrder != WatermarkOrder::kHeightFirst) return 0;
  const double x = s.x, y = s.y;
  return std::bit_cast<std::uint32_t>(static_cast<float>(x * x + y * y));
}

// Layout of a key of `kKeyBits`, made of the first two fields.
struct KeyLayout {
  std::int64_t low = 0;  // smallest value of the first field
  int first_drop = 0;    // number of low bits of the first field that are left out
  std::uint32_t second_low = 0;
  int second_bits = 0, second_drop = 0;

  template <WatermarkOrder kOrder>
  static KeyLayout of(const std::vector<WatermarkSample>& samples,
                      std::vector<std::uint32_t>& seconds) {
    std::int32_t low = std::numeric_limits<std::int32_t>::max();
    std::int32_t high = std::numeric_limits<std::int32_t>::min();
    std::uint32_t varying = 0;
    std::uint32_t least = std::numeric_limits<std::uint32_t>::max(), most = 0;
    seconds.resize(samples.size());
    const WatermarkSample* const all = samples.data();
    const std::int32_t first = first_of<kOrder>(all[0]);
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const std::int32_t value = first_of<kOrder>(all[i]);
      low = std::min(low, value);
      high = std::max(high, value);
      varying |= static_cast<std::uint32_t>(value ^ first);
      const std::uint32_t second = second_of<kOrder>(all[i]);
      seconds[i] = second;
      least = std::min(least, second);
      most = std::max(most, second);
    }
    KeyLayout layout;
    constexpr int kKeyBits = digits_of(kOrder) * kDigitBits;
    layout.low = low;
    // number of low bits that all values have cleared
    const int same = varying == 0 ? 0 : std::countr_zero(varying);
    const int width = static_cast<int>(
        std::bit_width(static_cast<std::uint64_t>(std::int64_t{high} - std::int64_t{low})));
    layout.first_drop = std::max(same, width - kKeyBits);
    const int left = kKeyBits - std::max(0, width - layout.first_drop);
    layout.second_low = least;
    const int second_width = static_cast<int>(std::bit_width(most - least));
    layout.second_bits = std::min(left, second_width);
    layout.second_drop = second_width - layout.second_bits;
    return layout;
  }

  template <WatermarkOrder kOrder>
  [[nodiscard]] std::uint64_t key(const WatermarkSample& s, std::uint32_t second) const {
    const auto high = static_cast<std::uint64_t>(first_of<kOrder>(s) - low) >> first_drop;
    if constexpr (kOrder != WatermarkOrder::kHeightFirst) return high << second_bits;
    return (high << second_bits) | ((second - second_low) >> second_drop);
  }
};

// Sorts items by their keys, lowest digit first; the sort is stable. With an odd number of digits
// the result is in `other`.
template <int kDigits>
void radix_sort(std::uint64_t* items, std::uint64_t* other, std::size_t size) {
  std::array<std::array<std::uint32_t, kBuckets>, kDigits> places{};
  const auto digit = [](std::uint64_t item, int number) {
    return (item >> (kRowBits + number * kDigitBits)) % kBuckets;
  };
  for (std::size_t i = 0; i < size; ++i) {
    for (int d = 0; d < kDigits; ++d) ++places[d][digit(items[i], d)];
  }
  for (auto& each : places) {
    std::uint32_t sum = 0;
    for (std::uint32_t& place : each) sum += std::exchange(place, sum);
  }
  for (int d = 0; d < kDigits; ++d) {
    std::array<std::uint32_t, kBuckets>& next = places[d];
    for (std::size_t i = 0; i < size; ++i) other[next[digit(items[i], d)]++] = items[i];
    std::swap(items, other);
  }
}

}  // namespace

SliceTable::SliceTable(int num_slices) {
  if (!(num_slices >= 4 && num_slices <= 360)) {
    throw InputError("slices: expected 4 to 360, got " + std::to_string(num_slices));
  }
  for (int slice = 0; slice < num_slices; ++slice) {
    const SinCos at = sin_cos(2.0 * std::numbers::pi * slice / num_slices);
    x_.push_back(static_cast<std::int32_t>(std::floor(at.cos * kScale + 0.5)));
    y_.push_back(static_cast<std::int32_t>(std::floor(at.sin * kScale + 0.5)));
  }
  guesses_.assign(kCells, 0);
  for (int slice = 1; slice < num_slices; ++slice) {
    const std::size_t s = slice;
    const float angle = diamond_angle(static_cast<float>(x_[s]), static_cast<float>(y_[s]));
    // No direction in the second cell behind the border, or later, is before the border.
    const int first = static_cast<int>(angle * (kCells / 4)) + 2;
    for (int cell = first; cell < kCells; ++cell) {
      guesses_[cell] = static_cast<std::uint16_t>(slice);
    }
  }
}

template <typename Wide, std::size_t kStride, typename Value>
void SliceTable::find_all(const Value* xy, std::size_t count, std::uint16_t* slices) const {
  for (std::size_t i = 0; i < count; ++i) {
    const float angle =
        diamond_angle(static_cast<float>(xy[i * kStride]), static_cast<float>(xy[i * kStride + 1]));
    slices[i] =
        static_cast<std::uint16_t>(std::min(kCells - 1, static_cast<int>(angle * (kCells / 4))));
  }
  const auto last = static_cast<std::uint16_t>(x_.size() - 1);
  const std::int32_t *boundary_x = x_.data(), *boundary_y = y_.data();
  const std::uint16_t* guesses = guesses_.data();
  for (std::size_t i = 0; i < count; ++i) {
    const Value x = xy[i * kStride], y = xy[i * kStride + 1];
    const std::uint16_t slice = guesses[slices[i]];
    // The cross product of the next border and the point is exact: 28 bits times 31 or 24 bits.
    const auto next = static_cast<std::uint16_t>(slice + (slice < last));
    const auto left = static_cast<Wide>(boundary_x[next]) * static_cast<Wide>(y);
    const auto right = static_cast<Wide>(boundary_y[next]) * static_cast<Wide>(x);
    const bool behind = (left >= right) & ((x != 0) | (y != 0));
    slices[i] = behind ? next : slice;
  }
}

void SliceTable::find(const WatermarkSample* samples, std::size_t count,
                      std::uint16_t* slices) const {
  if (count > 0) find_all<std::int64_t, 4>(&samples->x, count, slices);
}

void SliceTable::find(const float* xyz, std::size_t count, std::uint16_t* slices) const {
  find_all<double, 3>(xyz, count, slices);
}

std::vector<std::uint32_t> count_slices(const std::vector<std::uint16_t>& slices, int num_slices) {
  std::vector<std::uint32_t> counts(num_slices, 0);
  // Neighbours in the file are mostly in one slice. Counting a run at once avoids additions that
  // wait for the previous one.
  for (std::size_t begin = 0; begin < slices.size();) {
    std::size_t end = begin + 1;
    while (end < slices.size() && slices[end] == slices[begin]) ++end;
    counts[slices[begin]] += static_cast<std::uint32_t>(end - begin);
    begin = end;
  }
  return counts;
}

std::vector<std::uint16_t> merge_slices(const std::vector<std::uint32_t>& counts,
                                        std::uint32_t least, WatermarkMerge merge) {
  // Groups of slices in order of azimuth, with their numbers of points.
  struct Group {
    std::uint64_t points;
    std::vector<std::size_t> slices;
  };
  std::vector<Group> groups;
  for (std::size_t slice = 0; slice < counts.size(); ++slice) {
    groups.push_back({counts[slice], {slice}});
  }
  const auto fewer = [](const Group& a, const Group& b) { return a.points < b.points; };
  while (groups.size() > 1) {
    const auto smallest = std::min_element(groups.begin(), groups.end(), fewer);
    if (smallest->points >= least) break;
    const std::size_t at = smallest - groups.begin();
    Group taken = std::move(groups[at]);
    const std::size_t size = groups.size();
    std::size_t into = 0;
    if (merge == WatermarkMerge::kAdjacent) {
      const std::size_t before = (at + size - 1) % size, after = (at + 1) % size;
      into = groups[after].points < groups[before].points ? after : before;
    } else {
      groups[at].points = std::numeric_limits<std::uint64_t>::max();
      into = static_cast<std::size_t>(std::min_element(groups.begin(), groups.end(), fewer) -
                                      groups.begin());
    }
    groups[into].points += taken.points;
    groups[into].slices.insert(groups[into].slices.end(), taken.slices.begin(), taken.slices.end());
    groups.erase(groups.begin() + static_cast<std::ptrdiff_t>(at));
  }
  constexpr auto kNone = std::numeric_limits<std::uint16_t>::max();
  std::vector<std::size_t> group_of(counts.size());
  for (std::size_t g = 0; g < groups.size(); ++g) {
    for (const std::size_t slice : groups[g].slices) group_of[slice] = g;
  }
  // Tiles are numbered in the order of their first slices.
  std::vector<std::uint16_t> number(groups.size(), kNone), tile_of(counts.size());
  std::uint16_t tiles = 0;
  for (std::size_t slice = 0; slice < counts.size(); ++slice) {
    std::uint16_t& tile = number[group_of[slice]];
    if (tile == kNone) tile = tiles++;
    tile_of[slice] = tile;
  }
  return tile_of;
}

void CanonicalOrder::sort(const std::vector<WatermarkSample>& samples,
                          const std::vector<std::uint8_t>& marks,
                          const std::vector<std::uint16_t>& slices,
                          const std::vector<std::uint16_t>& tile_of, int num_tiles,
                          WatermarkOrder order, TiledSamples& tiled) {
  const std::size_t size = samples.size();
  std::vector<std::uint32_t>& begins = tiled.begins;
  begins.assign(static_cast<std::size_t>(num_tiles) + 1, 0);
  const std::vector<std::uint32_t> counts = count_slices(slices, static_cast<int>(tile_of.size()));
  for (std::size_t s = 0; s < counts.size(); ++s) begins[tile_of[s] + 1U] += counts[s];
  std::partial_sum(begins.begin(), begins.end(), begins.begin());

  items_.resize(size);
  other_.resize(size);
  switch (order) {
    case WatermarkOrder::kHeightFirst:
      sort_by<WatermarkOrder::kHeightFirst>(samples, slices, tile_of, begins);
      break;
    case WatermarkOrder::kColumnsFirst:
      sort_by<WatermarkOrder::kColumnsFirst>(samples, slices, tile_of, begins);
      break;
    case WatermarkOrder::kPlain:
      sort_by<WatermarkOrder::kPlain>(samples, slices, tile_of, begins);
      break;
  }
  tiled.samples.resize(size);
  tiled.marks.resize(marks.size());
  tiled.rows.resize(size);
  const std::uint64_t* const sorted = (digits_of(order) % 2 == 0 ? items_ : other_).data();
  const WatermarkSample* const from = samples.data();
  WatermarkSample* const to = tiled.samples.data();
  std::uint32_t* const rows = tiled.rows.data();
  constexpr std::size_t kAhead = 16;  // prefetch distance, since rows are scattered over the scan
  for (std::size_t i = 0; i < size; ++i) {
    if (i + kAhead < size) __builtin_prefetch(from + sorted[i + kAhead] % kRows);
    const auto row = static_cast<std::uint32_t>(sorted[i] % kRows);
    to[i] = from[row];
    rows[i] = row;
  }
  for (std::size_t i = 0; i < marks.size(); ++i) tiled.marks[i] = marks[rows[i]];
}

template <WatermarkOrder kOrder>
void CanonicalOrder::sort_by(const std::vector<WatermarkSample>& samples,
                             const std::vector<std::uint16_t>& slices,
                             const std::vector<std::uint16_t>& tile_of,
                             std::vector<std::uint32_t>& begins) {
  if (samples.empty()) return;
  const KeyLayout layout = KeyLayout::of<kOrder>(samples, seconds_);
  std::vector<std::uint32_t> next(begins.begin(), begins.end() - 1);
  for (std::size_t begin = 0; begin < samples.size();) {
    std::size_t end = begin + 1;  // end of a run of one slice, which stays together
    while (end < samples.size() && slices[end] == slices[begin]) ++end;
    std::uint32_t& place = next[tile_of[slices[begin]]];
    std::uint64_t* const items = items_.data() + place;
    for (std::size_t i = begin; i < end; ++i) {
      items[i - begin] = (layout.key<kOrder>(samples[i], seconds_[i]) << kRowBits) | i;
    }
    place += static_cast<std::uint32_t>(end - begin);
    begin = end;
  }
  const auto before = [&](std::uint64_t a, std::uint64_t b) {
    const std::size_t i = a % kRows, j = b % kRows;
    if (samples[i] == samples[j]) return i < j;
    return precedes<kOrder>(samples[i], samples[j]);
  };
  std::vector<std::uint64_t>& sorted = digits_of(kOrder) % 2 == 0 ? items_ : other_;
  for (std::size_t t = 0; t + 1 < begins.size(); ++t) {
    std::uint64_t* items = sorted.data() + begins[t];
    const std::size_t size = begins[t + 1] - begins[t];
    radix_sort<digits_of(kOrder)>(items_.data() + begins[t], other_.data() + begins[t], size);
    // Sort runs of equal keys by all fields.
    for (std::size_t i = 0; i < size;) {
      std::size_t run = i + 1;
      while (run < size && items[run] >> kRowBits == items[i] >> kRowBits) ++run;
      if (run - i > kShortRun) {
        std::sort(items + i, items + run, before);
      } else {
        for (std::size_t j = i + 1; j < run; ++j) {
          const std::uint64_t item = items[j];
          std::size_t k = j;
          for (; k > i && before(item, items[k - 1]); --k) items[k] = items[k - 1];
          items[k] = item;
        }
      }
      i = run;
    }
  }
}

}  // namespace manip3d
