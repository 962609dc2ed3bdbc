#include "simplify/cs3_sampling.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include "simplify/importance_rows.hpp"

namespace manip3d {
namespace {

constexpr int kDigitBits = kKeyBits / 2;
constexpr std::uint32_t kDigits = 1U << kDigitBits;

// Exclusive prefix sum: the count of each digit becomes the index of its first item.
void sum_up(std::vector<std::uint32_t>& counts) {
  std::uint32_t sum = 0;
  for (std::uint32_t& count : counts) {
    const std::uint32_t own = count;
    count = sum;
    sum += own;
  }
}

}  // namespace

// Radix sort, least significant digit first. It is stable, so that ties stay in the order of slots.
// Between the passes, an item holds the upper digit of its key above its slot.
template <typename Item>
void ImportanceOrder::sort_items(const ImportanceMap& map, std::vector<Item>& items) {
  constexpr int kSlotBits = static_cast<int>(sizeof(Item)) * 8 - kDigitBits;
  low_.assign(kDigits, 0);
  high_.assign(kDigits, 0);
  std::size_t count = 0;
  for (const ImportanceKey key : map.keys) {
    if (key == kNoKey) continue;
    ++low_[key & (kDigits - 1)];
    ++high_[key >> kDigitBits];
    ++count;
  }
  sum_up(low_);
  sum_up(high_);
  items.reserve(map.keys.capacity());
  if (items.size() < count) items.resize(count);
  for (std::size_t slot = 0; slot < map.keys.size(); ++slot) {
    const ImportanceKey key = map.keys[slot];
    if (key == kNoKey) continue;
    items[low_[key & (kDigits - 1)]++] =
        (static_cast<Item>(key >> kDigitBits) << kSlotBits) | static_cast<Item>(slot);
  }
  slots_.reserve(map.keys.capacity());
  slots_.resize(count);
  for (std::size_t i = 0; i < count; ++i) {
    const Item item = items[i];
    slots_[high_[item >> kSlotBits]++] = static_cast<Slot>(item & ((Item{1} << kSlotBits) - 1));
  }
}

void ImportanceOrder::sort(const ImportanceMap& map) {
  if (map.keys.size() <= (std::size_t{1} << (32 - kDigitBits))) {
    sort_items(map, small_items_);
  } else {
    sort_items(map, large_items_);
  }
}

/// Data that do not change during the search for the factor.
struct Cs3Sampler::Frame {
  const RangeImage& image;
  const ImportanceMap& map;
  const std::vector<Slot>& order;
  const Cs3Options& options;
  Cs3Reading::Rounding rounding;
  float omega_min = 0.0F, omega_max = 0.0F;
  double interval = 0.0;  ///< s = Rd_max = sqrt(w h / n).

  Frame(const RangeImage& image_in, const ImportanceMap& map_in, const std::vector<Slot>& order_in,
        const Cs3Options& options_in)
      : image(image_in),
        map(map_in),
        order(order_in),
        options(options_in),
        rounding(options_in.reading.rounding) {
    const auto outliers =
        static_cast<std::size_t>(options.reading.outliers * static_cast<double>(order.size()));
    omega_max = to_importance(map.keys[order[std::min(outliers, order.size() - 1)]]);
    omega_min = to_importance(map.keys[order.back()]);
    interval = std::sqrt(static_cast<double>(map.box.width) * static_cast<double>(map.box.height) /
                         static_cast<double>(options.target_points));
  }

  [[nodiscard]] std::int64_t u(Slot slot) const { return slot % static_cast<Slot>(map.stride); }
  [[nodiscard]] std::int64_t v(Slot slot) const { return slot / static_cast<Slot>(map.stride); }

  /// Start of the search for the factor. With eq. 3.8 it is 1, as printed. Eq. 3.9 makes all radii
  /// smaller, so the factor starts where its squares have the density of those of eq. 3.8. The mean
  /// is taken over every sixteenth pixel, because near and far pixels are well mixed in the order
  /// of importance.
  [[nodiscard]] double first_factor() const {
    if (!options.distance_dependent) return 1.0;
    constexpr std::size_t kStep = 16;
    constexpr double kUsual = 0.9;  // relative to the factor of equal density, on scenes and people
    double sum = 0.0;
    for (std::size_t i = 0; i < order.size(); i += kStep) {
      const double ratio = relative_distance(order[i]);
      sum += 1.0 / (ratio * ratio);
    }
    return kUsual * std::sqrt(sum / static_cast<double>((order.size() + kStep - 1) / kStep));
  }

  /// R(u) / R_max.
  [[nodiscard]] double relative_distance(Slot slot) const {
    return double{image.depth(map.box.u0 + u(slot), map.box.v0 + v(slot))} / map.max_depth;
  }

  /// Rd(u) / Rd_max (eq. 3.8, 3.9).
  [[nodiscard]] double relative_radius(Slot slot) const {
    double radius = 1.0;
    if (omega_max > omega_min) {
      const double omega = std::min(omega_max, to_importance(map.keys[slot]));
      radius = 1.0 - (omega - omega_min) / (double{omega_max} - omega_min);
    }
    if (options.distance_dependent) radius *= relative_distance(slot);
    return radius;
  }
};

// Marks the square around a chosen point (section 3.3.2, "repulsive force").
void Cs3Sampler::block(const Frame& frame, Slot slot, double radius) {
  const std::int64_t r = frame.rounding == Cs3Reading::Rounding::kDown
                             ? static_cast<std::int64_t>(radius)
                             : rounded_by(frame.rounding, radius);
  const std::int64_t u = frame.u(slot), v = frame.v(slot);
  const std::int64_t u0 = std::max<std::int64_t>(0, u - r);
  const std::int64_t u1 = std::min(frame.map.stride - 1, u + r);
  const std::int64_t v0 = std::max<std::int64_t>(0, v - r);
  const std::int64_t v1 = std::min(frame.map.box.height - 1, v + r);
  const std::int64_t words = frame.map.stride / 64;
  const std::uint64_t first = ~std::uint64_t{0} << (u0 % 64);
  const std::uint64_t last = ~std::uint64_t{0} >> (63 - u1 % 64);
  std::uint64_t* row = blocked_.data() + v0 * words;
  if (u0 / 64 == u1 / 64) {
    for (std::int64_t i = v0; i <= v1; ++i, row += words) row[u0 / 64] |= first & last;
    return;
  }
  for (std::int64_t i = v0; i <= v1; ++i, row += words) {
    row[u0 / 64] |= first;
    for (std::int64_t w = u0 / 64 + 1; w < u1 / 64; ++w) row[w] = ~std::uint64_t{0};
    row[u1 / 64] |= last;
  }
}

std::int64_t Cs3Sampler::sample_by_order(const Frame& frame, double factor) {
  blocked_.assign(frame.map.keys.size() / 64, 0);
  chosen_.clear();
  for (const Slot slot : frame.order) {
    if ((blocked_[slot / 64] >> (slot % 64) & 1) != 0) continue;
    chosen_.push_back(slot);
    block(frame, slot, factor * frame.interval * frame.relative_radius(slot));
  }
  return static_cast<std::int64_t>(chosen_.size());
}

namespace {

PrincipalDirections principal_directions(double uu, double vv, double uv) {
  const double mean = 0.5 * (uu + vv), half = 0.5 * (uu - vv);
  const double root = std::sqrt(half * half + uv * uv);
  const double large = mean >= 0.0 ? mean + root : mean - root;
  const double small = mean >= 0.0 ? mean - root : mean + root;
  constexpr double kMaxStretch = 4.0;
  PrincipalDirections result;
  const double ratio = std::abs(large) / std::abs(small);
  result.stretch = ratio < kMaxStretch * kMaxStretch ? std::sqrt(ratio) : kMaxStretch;
  // (M - small I) maps every vector to the direction of `large`; take its longer column.
  const double aa = (uu - small) * (uu - small) + uv * uv;
  const double bb = (vv - small) * (vv - small) + uv * uv;
  const double length = std::sqrt(std::max(aa, bb));
  if (!(length > 0.0 && length < std::numeric_limits<double>::infinity())) return result;
  result.u = (aa >= bb ? uu - small : uv) / length;
  result.v = (aa >= bb ? uv : vv - small) / length;
  return result;
}

}  // namespace

void Cs3Sampler::find_directions(const Frame& frame) {
  const ImportanceMap& map = frame.map;
  directions_.reserve(map.keys.capacity());
  directions_.resize(map.keys.size());
  for (const Slot slot : frame.order) {
    directions_[slot] =
        principal_directions(map.hessian_uu[slot], map.hessian_vv[slot], map.hessian_uv[slot]);
  }
}

namespace {

// The integer nearest to x, halves up, for |x| < 2^20; faster than a call of floor().
std::int64_t nearest(double x) {
  constexpr std::int64_t kOffset = 1 << 20;  // truncation is floor for positive numbers
  return static_cast<std::int64_t>(x + (static_cast<double>(kOffset) + 0.5)) - kOffset;
}

}  // namespace

// Keeps the points whose importance is the greatest along both principal directions; ties go to the
// earlier pixel. Directions are ordered by the absolute values of the eigenvalues; w_min is at most
// 4 w_max.
std::int64_t Cs3Sampler::sample_maxima(const Frame& frame, double factor) {
  const double w_max = factor * frame.interval;
  const ImportanceMap& map = frame.map;
  chosen_.clear();
  for (const Slot slot : frame.order) {
    const auto u = static_cast<double>(frame.u(slot)), v = static_cast<double>(frame.v(slot));
    // Whether the pixel at this offset is more important, or as important and earlier.
    const auto is_exceeded = [&](double du, double dv) {
      const std::int64_t other_u = nearest(u + du), other_v = nearest(v + dv);
      if (other_u < 0 || other_v < 0 || other_u >= map.box.width || other_v >= map.box.height) {
        return false;
      }
      const auto other = static_cast<Slot>(other_v * map.stride + other_u);
      // Invalid pixels have the largest key.
      const ImportanceKey key = map.keys[other], own = map.keys[slot];
      return key < own || (key == own && other < slot);
    };
    const PrincipalDirections& d = directions_[slot];
    const auto steps_max = static_cast<std::int64_t>(w_max);
    const auto steps_min = static_cast<std::int64_t>(d.stretch * w_max);
    bool is_maximum = true;
    for (std::int64_t k = 1; is_maximum && k <= steps_min; ++k) {  // stretch >= 1
      const double du = static_cast<double>(k) * d.u, dv = static_cast<double>(k) * d.v;
      is_maximum = !is_exceeded(-dv, du) && !is_exceeded(dv, -du) &&
                   (k > steps_max || (!is_exceeded(du, dv) && !is_exceeded(-du, -dv)));
    }
    if (is_maximum) chosen_.push_back(slot);
  }
  return static_cast<std::int64_t>(chosen_.size());
}

std::int64_t Cs3Sampler::sample(const Frame& frame, double factor) {
  return frame.options.sampling == Cs3Sampling::kImportanceOrder ? sample_by_order(frame, factor)
                                                                 : sample_maxima(frame, factor);
}

namespace {

// Approximately proportional to the factor that gives this count: on scans and people, the factor
// is proportional to count^(-1 / 1.6). Computed from square roots, which have the same bits
// everywhere.
double factor_measure(double count) {
  const double root = std::sqrt(count);
  return 1.0 / (root * std::sqrt(std::sqrt(root)));
}

}  // namespace

// Searches the factor for which the count is in [99 % of n, n]: secant steps within the interval of
// factors that are known to give too many and too few. At the end, chosen_ holds the points of the
// returned factor.
double Cs3Sampler::search(const Frame& frame, Cs3Report& report) {
  constexpr int kMaxPasses = 24;
  const std::int64_t n = frame.options.target_points;
  const std::int64_t enough = n - n / 100;
  const double aim = factor_measure(0.5 * static_cast<double>(n + enough));
  const double largest =
      static_cast<double>(frame.map.stride + frame.map.box.height) / frame.interval;
  double few = 0.0, many = 0.0;  // factors known to give too few and too many; 0: unknown
  double factor = std::min(frame.first_factor(), largest), last_factor = 0.0, last_measure = 0.0;
  std::int64_t count = sample(frame, factor);
  if (!frame.options.distance_dependent) report.literal_count = count;
  for (report.passes = 1; report.passes < kMaxPasses; ++report.passes) {
    if (count >= enough && count <= n) return factor;
    (count > n ? many : few) = factor;
    if (many >= largest) break;                                 // no factor gives so few
    if (few > 0.0 && many > 0.0 && few < many * 1.0005) break;  // the count jumps across the target
    const double measure = factor_measure(static_cast<double>(count));
    double next = measure != last_measure
                      ? factor + (aim - measure) * (factor - last_factor) / (measure - last_measure)
                      : 0.0;
    const double low = many > 0.0 ? many : few / 8.0;
    const double high = few > 0.0 ? few : many * 8.0;
    if (!(next > low && next < high)) next = std::sqrt(low * high);
    last_factor = factor;
    last_measure = measure;
    factor = std::min(next, largest);
    count = sample(frame, factor);
  }
  if (few > 0.0) {  // Too few rather than too many: the most important remaining points are added.
    if (factor != few) sample(frame, few);
    report.reached = Cs3Reached::kContinued;
    go_on(frame);
    return few;
  }
  if (factor != many) sample(frame, many);
  report.reached = Cs3Reached::kCut;
  chosen_.resize(n);
  return many;
}

// Adds the most important points that are not chosen yet, up to n, without regard to blocked
// squares.
void Cs3Sampler::go_on(const Frame& frame) {
  const std::size_t n = frame.options.target_points;
  blocked_.assign(frame.map.keys.size() / 64, 0);
  for (const Slot slot : chosen_) blocked_[slot / 64] |= std::uint64_t{1} << (slot % 64);
  for (const Slot slot : frame.order) {
    if (chosen_.size() >= n) return;
    if ((blocked_[slot / 64] >> (slot % 64) & 1) == 0) chosen_.push_back(slot);
  }
}

void Cs3Sampler::sort_by_pixel(const Frame& frame) {
  selected_.assign(frame.map.keys.size() / 64, 0);
  for (const Slot slot : chosen_) selected_[slot / 64] |= std::uint64_t{1} << (slot % 64);
  slots_.clear();
  for (std::size_t word = 0; word < selected_.size(); ++word) {
    for (std::uint64_t bits = selected_[word]; bits != 0; bits &= bits - 1) {
      slots_.push_back(static_cast<Slot>(64 * word) + static_cast<Slot>(std::countr_zero(bits)));
    }
  }
}

void Cs3Sampler::choose(const RangeImage& image, const ImportanceMap& map,
                        const ImportanceOrder& order, const Cs3Options& options,
                        Cs3Report& report) {
  const auto valid = static_cast<std::int64_t>(order.slots().size());
  slots_.clear();
  for (auto* slots : {&chosen_, &slots_}) slots->reserve(map.keys.capacity());
  for (auto* bits : {&blocked_, &selected_}) bits->reserve(map.keys.capacity() / 64);
  report.reached = Cs3Reached::kFactor;
  report.literal_count.reset();
  if (!options.distance_dependent) report.literal_count = 0;
  if (valid == 0 || options.target_points == 0) {
    if (valid == 0) report.reached = Cs3Reached::kAllPixels;
    return;
  }
  const Frame frame(image, map, order.slots(), options);
  if (options.sampling == Cs3Sampling::kNonMaximum) find_directions(frame);
  if (valid <= options.target_points) {
    if (!options.distance_dependent) report.literal_count = sample(frame, 1.0);
    report.passes = 1;
    chosen_ = order.slots();
    report.reached = Cs3Reached::kAllPixels;
  } else {
    report.factor = search(frame, report);
  }
  sort_by_pixel(frame);
}

}  // namespace manip3d
