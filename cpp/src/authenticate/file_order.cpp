#include "authenticate/file_order.hpp"

#include <algorithm>
#include <bit>

namespace manip3d {
namespace {

// Half a millimetre of rounding in x and y turns a point 1 m away by this much at most.
constexpr float kAzimuthRounding = 1e-3F;

// Orders by ring, then by azimuth: the bits of a float that is not negative ascend with it.
std::uint64_t place_of(const LatticeReading& reading, std::int32_t i) {
  const auto ring = static_cast<std::uint64_t>(reading.ring(i));
  return ring << 32U | std::bit_cast<std::uint32_t>(reading.azimuth(i));
}

// The longest non-descending subsequence of the points that have a ring [Fredman 1975].
std::vector<std::int32_t> longest_in_order(const LatticeReading& reading) {
  const auto n = static_cast<std::int32_t>(reading.ring.size());
  std::vector<std::uint64_t> ends;  // ends[k]: the lowest last place of a subsequence of k + 1
  std::vector<std::int32_t> last;   // the point with that place
  std::vector<std::int32_t> previous(n, -1);
  for (std::int32_t i = 0; i < n; ++i) {
    if (reading.ring(i) < 0) continue;
    const std::uint64_t place = place_of(reading, i);
    auto at = ends.end();
    if (!ends.empty() && place < ends.back()) at = std::upper_bound(ends.begin(), at, place);
    const auto k = static_cast<std::size_t>(at - ends.begin());
    if (k > 0) previous[i] = last[k - 1];
    if (k == ends.size()) {
      ends.push_back(place);
      last.push_back(i);
    } else {
      ends[k] = place;
      last[k] = i;
    }
  }
  std::vector<std::int32_t> chain;
  if (last.empty()) return chain;
  for (std::int32_t i = last.back(); i >= 0; i = previous[i]) {
    chain.push_back(i);
  }
  std::reverse(chain.begin(), chain.end());
  return chain;
}

bool is_rounding(const LatticeReading& reading, std::int32_t i, std::int32_t neighbour) {
  return reading.ring(i) == reading.ring(neighbour) &&
         std::abs(reading.azimuth(i) - reading.azimuth(neighbour)) < kAzimuthRounding;
}

}  // namespace

std::vector<std::int32_t> misplaced_in_file(const LatticeReading& reading) {
  const std::vector<std::int32_t> chain = longest_in_order(reading);
  std::vector<std::int32_t> misplaced;
  std::size_t next = 0;  // the first of the chain at or behind i
  for (std::int32_t i = 0; i < reading.ring.size(); ++i) {
    if (next < chain.size() && chain[next] == i) {
      ++next;
      continue;
    }
    if (reading.ring(i) < 0) continue;
    const bool near = (next > 0 && is_rounding(reading, i, chain[next - 1])) ||
                      (next < chain.size() && is_rounding(reading, i, chain[next]));
    if (!near) misplaced.push_back(i);
  }
  return misplaced;
}

}  // namespace manip3d
