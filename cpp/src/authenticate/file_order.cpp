#include "authenticate/file_order.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include "geometry/constants.hpp"

namespace manip3d {
namespace {

// Radians: rounding x and y to 1 mm rotates a point 1 m away by less than this.
constexpr float kAzimuthRounding = 1e-3F;

// Rings begin together if most of their first azimuths are in a window of this width, radians.
constexpr float kStartSpan = kFullTurnF / 360.0F;
constexpr std::size_t kMinStarts = 8;

// Places of the points of a file on their rings, radians in [0, 2 pi]; negative: not judged.
struct Places {
  const Indices& ring;
  std::vector<float> angle;
};

Places places_by_azimuth(const LatticeReading& reading) {
  Places places{reading.ring, std::vector<float>(reading.ring.size(), -1.0F)};
  for (Eigen::Index i = 0; i < reading.ring.size(); ++i) {
    if (reading.ring(i) >= 0) places.angle[i] = reading.azimuth(i);
  }
  return places;
}

// Lasers that point ahead of others reach azimuth 0 at a later count of the encoder than these.
Places places_by_count(const LatticeReading& reading, double azimuth_step) {
  Places places{reading.ring, std::vector<float>(reading.ring.size(), -1.0F)};
  for (Eigen::Index i = 0; i < reading.ring.size(); ++i) {
    if (reading.count(i) >= 0) {
      places.angle[i] = static_cast<float>(reading.count(i) * azimuth_step);
    }
  }
  return places;
}

// Angle at which most rings of the file begin: 0 in KITTI's files, the angle of rotation if the
// frame was rotated about the vertical, and 0 if most rings have no common start.
float common_start(const Places& places) {
  std::vector<float> starts;
  for (Eigen::Index i = 1; i < places.ring.size(); ++i) {
    if (places.ring(i - 1) >= 0 && places.ring(i) == places.ring(i - 1) + 1 &&
        places.angle[i] >= 0.0F) {
      starts.push_back(places.angle[i]);
    }
  }
  const std::size_t n = starts.size();
  if (n < kMinStarts) return 0.0F;
  std::sort(starts.begin(), starts.end());
  for (std::size_t i = 0; i < n; ++i) starts.push_back(starts[i] + kFullTurnF);
  std::size_t first = 0, most = 0, end = 0;
  for (std::size_t begin = 0; begin < n; ++begin) {
    while (end < begin + n && starts[end] < starts[begin] + kStartSpan) ++end;
    if (end - begin > most) {
      most = end - begin;
      first = begin;
    }
  }
  return 2 * most < n ? 0.0F : starts[first];
}

// Sort key: ring, then angle. The bits of a non-negative float grow with its value.
std::uint64_t key_of(const Places& places, std::int32_t i, float start) {
  const auto ring = static_cast<std::uint64_t>(places.ring(i));
  const float ahead = places.angle[i] - start;
  return ring << 32U | std::bit_cast<std::uint32_t>(ahead < 0.0F ? ahead + kFullTurnF : ahead);
}

// The row at which the order begins. It is the first row, or, if the rows were shifted cyclically,
// the one at which the order returns to its smallest key.
std::int32_t first_row(const Places& places, float start) {
  constexpr std::uint64_t kNone = ~std::uint64_t{0};
  std::int32_t row = 0, previous = -1;
  std::uint64_t front = 0, back = 0, lowest = kNone;
  for (std::int32_t i = 0; i < places.ring.size(); ++i) {
    if (places.angle[i] < 0.0F) continue;
    const std::uint64_t key = key_of(places, i, start);
    if (previous < 0) front = key;
    if (previous >= 0 && places.ring(i) < places.ring(previous) && key < lowest) {
      lowest = key;
      row = i;
    }
    previous = i;
    back = key;
  }
  return back <= front && lowest <= front ? row : 0;
}

// Row j of n after a cyclic shift by `first`, which is below n.
std::int32_t shifted(std::int32_t j, std::int32_t first, std::int32_t n) {
  return j < n - first ? first + j : first + j - n;
}

// A subsequence in order, from the row at which the order of the file begins.
struct Chain {
  std::int32_t first_row = 0;
  std::vector<std::int32_t> points;
};

// The longest non-descending subsequence of the points that are judged [Fredman 1975].
Chain longest_in_order(const Places& places, float start) {
  const auto n = static_cast<std::int32_t>(places.ring.size());
  std::vector<std::uint64_t> ends;  // ends[k]: smallest last key of a subsequence of length k + 1
  std::vector<std::int32_t> last;   // the point with that key
  std::vector<std::int32_t> previous(n, -1);
  Chain chain{first_row(places, start), {}};
  for (std::int32_t j = 0; j < n; ++j) {
    const std::int32_t i = shifted(j, chain.first_row, n);
    if (places.angle[i] < 0.0F) continue;
    const std::uint64_t key = key_of(places, i, start);
    auto at = ends.end();
    if (!ends.empty() && key < ends.back()) at = std::upper_bound(ends.begin(), at, key);
    const std::size_t k = at - ends.begin();
    if (k > 0) previous[i] = last[k - 1];
    if (k == ends.size()) {
      ends.push_back(key);
      last.push_back(i);
    } else {
      ends[k] = key;
      last[k] = i;
    }
  }
  if (last.empty()) return chain;
  for (std::int32_t i = last.back(); i >= 0; i = previous[i]) {
    chain.points.push_back(i);
  }
  std::reverse(chain.points.begin(), chain.points.end());
  return chain;
}

// The longest subsequence if rings begin at angle 0 or at another one, whichever is longer.
Chain longest_in_order(const Places& places) {
  Chain chain = longest_in_order(places, 0.0F);
  const float start = common_start(places);
  if (start > 0.0F) {
    Chain turned = longest_in_order(places, start);
    if (turned.points.size() > chain.points.size()) return turned;
  }
  return chain;
}

bool is_rounding(const LatticeReading& reading, std::int32_t i, std::int32_t neighbour) {
  const float apart = std::abs(reading.azimuth(i) - reading.azimuth(neighbour));
  return reading.ring(i) == reading.ring(neighbour) &&
         std::min(apart, std::abs(kFullTurnF - apart)) < kAzimuthRounding;
}

// The judged points that are not in the chain, unless rounding explains that.
std::vector<std::int32_t> points_beside(const Chain& chain, const Places& places,
                                        const LatticeReading& reading) {
  const auto n = static_cast<std::int32_t>(reading.ring.size());
  std::vector<std::int32_t> beside;
  std::size_t next = 0;  // index in the chain of its first point at or after i
  for (std::int32_t j = 0; j < n; ++j) {
    const std::int32_t i = shifted(j, chain.first_row, n);
    if (next < chain.points.size() && chain.points[next] == i) {
      ++next;
      continue;
    }
    if (places.angle[i] < 0.0F) continue;
    const bool near = (next > 0 && is_rounding(reading, i, chain.points[next - 1])) ||
                      (next < chain.points.size() && is_rounding(reading, i, chain.points[next]));
    if (!near) beside.push_back(i);
  }
  std::sort(beside.begin(), beside.end());
  return beside;
}

}  // namespace

std::vector<std::int32_t> misplaced_in_file(const LatticeReading& reading, double azimuth_step) {
  const Places by_azimuth = places_by_azimuth(reading);
  const Chain chain = longest_in_order(by_azimuth);
  std::vector<std::int32_t> misplaced = points_beside(chain, by_azimuth, reading);
  if (misplaced.empty()) return misplaced;
  const Places by_count = places_by_count(reading, azimuth_step);
  const Chain counted = longest_in_order(by_count);
  if (counted.points.size() <= chain.points.size()) return misplaced;
  return points_beside(counted, by_count, reading);
}

}  // namespace manip3d
