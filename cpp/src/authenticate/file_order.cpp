#include "authenticate/file_order.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include "geometry/constants.hpp"

namespace manip3d {
namespace {

// Radians: rounding x and y to 1 mm rotates a point 1 m away by less than this.
constexpr float kAzimuthRounding = 1e-3F;

// Bins of azimuth in which the starts of rings are counted.
constexpr int kStartBins = 360;
constexpr std::size_t kMinStarts = 8;

// Azimuth at which most rings of the file begin: 0 in KITTI's files, the angle of rotation if the
// frame was rotated about the vertical, and 0 if most rings have no common start.
float first_azimuth(const LatticeReading& reading) {
  std::vector<float> starts;
  for (Eigen::Index i = 1; i < reading.ring.size(); ++i) {
    if (reading.ring(i - 1) >= 0 && reading.ring(i) == reading.ring(i - 1) + 1) {
      starts.push_back(reading.azimuth(i));
    }
  }
  if (starts.size() < kMinStarts) return 0.0F;
  const auto bin_of = [](float azimuth) {
    return std::min(static_cast<int>(azimuth * (kStartBins / kFullTurnF)), kStartBins - 1);
  };
  std::vector<std::size_t> bins(kStartBins, 0);
  for (const float azimuth : starts) ++bins[bin_of(azimuth)];
  const auto most = std::max_element(bins.begin(), bins.end());
  if (2 * *most < starts.size() || most == bins.begin()) return 0.0F;
  float first = kFullTurnF;
  for (const float azimuth : starts) {
    if (bin_of(azimuth) == most - bins.begin()) first = std::min(first, azimuth);
  }
  return first;
}

// Sort key: ring, then azimuth. The bits of a non-negative float grow with its value.
std::uint64_t place_of(const LatticeReading& reading, std::int32_t i, float first) {
  const auto ring = static_cast<std::uint64_t>(reading.ring(i));
  const float ahead = reading.azimuth(i) - first;
  return ring << 32U | std::bit_cast<std::uint32_t>(ahead < 0.0F ? ahead + kFullTurnF : ahead);
}

// The row at which the order begins. It is the first row, or, if the rows were shifted cyclically,
// the one at which the order returns to its smallest place.
std::int32_t first_row(const LatticeReading& reading, float first) {
  constexpr std::uint64_t kNone = ~std::uint64_t{0};
  std::int32_t row = 0, previous = -1;
  std::uint64_t front = 0, back = 0, lowest = kNone;
  for (std::int32_t i = 0; i < reading.ring.size(); ++i) {
    if (reading.ring(i) < 0) continue;
    const std::uint64_t place = place_of(reading, i, first);
    if (previous < 0) front = place;
    if (previous >= 0 && reading.ring(i) < reading.ring(previous) && place < lowest) {
      lowest = place;
      row = i;
    }
    previous = i;
    back = place;
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

// The longest non-descending subsequence of the points with a ring [Fredman 1975].
Chain longest_in_order(const LatticeReading& reading, float first) {
  const auto n = static_cast<std::int32_t>(reading.ring.size());
  std::vector<std::uint64_t> ends;  // ends[k]: smallest last place of a subsequence of length k + 1
  std::vector<std::int32_t> last;   // the point with that place
  std::vector<std::int32_t> previous(n, -1);
  Chain chain{first_row(reading, first), {}};
  for (std::int32_t j = 0; j < n; ++j) {
    const std::int32_t i = shifted(j, chain.first_row, n);
    if (reading.ring(i) < 0) continue;
    const std::uint64_t place = place_of(reading, i, first);
    auto at = ends.end();
    if (!ends.empty() && place < ends.back()) at = std::upper_bound(ends.begin(), at, place);
    const std::size_t k = at - ends.begin();
    if (k > 0) previous[i] = last[k - 1];
    if (k == ends.size()) {
      ends.push_back(place);
      last.push_back(i);
    } else {
      ends[k] = place;
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

// The longest subsequence if rings begin at azimuth 0 or at another one, whichever is longer.
Chain longest_in_order(const LatticeReading& reading) {
  Chain chain = longest_in_order(reading, 0.0F);
  const float first = first_azimuth(reading);
  if (first > 0.0F) {
    Chain turned = longest_in_order(reading, first);
    if (turned.points.size() > chain.points.size()) return turned;
  }
  return chain;
}

bool is_rounding(const LatticeReading& reading, std::int32_t i, std::int32_t neighbour) {
  const float apart = std::abs(reading.azimuth(i) - reading.azimuth(neighbour));
  return reading.ring(i) == reading.ring(neighbour) &&
         std::min(apart, std::abs(kFullTurnF - apart)) < kAzimuthRounding;
}

}  // namespace

std::vector<std::int32_t> misplaced_in_file(const LatticeReading& reading) {
  const auto [first_row, chain] = longest_in_order(reading);
  const auto n = static_cast<std::int32_t>(reading.ring.size());
  std::vector<std::int32_t> misplaced;
  std::size_t next = 0;  // index in `chain` of its first point at or after i
  for (std::int32_t j = 0; j < n; ++j) {
    const std::int32_t i = shifted(j, first_row, n);
    if (next < chain.size() && chain[next] == i) {
      ++next;
      continue;
    }
    if (reading.ring(i) < 0) continue;
    const bool near = (next > 0 && is_rounding(reading, i, chain[next - 1])) ||
                      (next < chain.size() && is_rounding(reading, i, chain[next]));
    if (!near) misplaced.push_back(i);
  }
  std::sort(misplaced.begin(), misplaced.end());
  return misplaced;
}

}  // namespace manip3d
