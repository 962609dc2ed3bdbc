#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <vector>

#include "authenticate/ring_image.hpp"

namespace manip3d {

/// Counts the points of a scan in sectors of 5 degrees of azimuth. Sectors separate edits from
/// processing of the whole frame: an edit affects few sectors, processing affects all.
class HorizonSectors {
 public:
  static constexpr std::size_t kSectors = 72;
  using Tally = std::array<std::int64_t, kSectors>;

  /// @param azimuth  Radians, in [0, 2 pi].
  [[nodiscard]] static std::size_t sector(double azimuth) {
    return static_cast<std::size_t>(azimuth_column(azimuth, kSectors));
  }

  void add(double azimuth) {
    ++points_[sector(azimuth)];
    ++num_points_;
  }
  [[nodiscard]] std::int64_t num_points() const { return num_points_; }

  /// Share of the points in `found`: the mean over the sectors that hold points, so that each
  /// direction counts the same, however many points were pasted into one of them.
  [[nodiscard]] double share(const Tally& found) const {
    const std::vector<double> shares = shares_of_sectors(found);
    return std::accumulate(shares.begin(), shares.end(), 0.0) / static_cast<double>(shares.size());
  }

  /// Is the share larger than `most`, or do more than half of the sectors have a share larger than
  /// `least`?
  [[nodiscard]] bool is_everywhere(const Tally& found, double least, double most) const {
    const std::vector<double> shares = shares_of_sectors(found);
    const auto spoiled =
        std::count_if(shares.begin(), shares.end(), [least](double s) { return s > least; });
    return share(found) > most ||
           (shares.size() >= kMinSectors && 2 * spoiled > std::ssize(shares));
  }

 private:
  static constexpr std::int64_t kMinOfSector = 100;
  static constexpr std::size_t kMinSectors = 8;

  /// The share of each sector with enough points; one share of all points if there are few such
  /// sectors.
  [[nodiscard]] std::vector<double> shares_of_sectors(const Tally& found) const {
    std::vector<double> shares;
    for (std::size_t s = 0; s < kSectors; ++s) {
      if (points_[s] < kMinOfSector) continue;
      shares.push_back(static_cast<double>(found[s]) / static_cast<double>(points_[s]));
    }
    if (shares.size() >= kMinSectors) return shares;
    const auto all = std::accumulate(found.begin(), found.end(), std::int64_t{0});
    return {static_cast<double>(all) / static_cast<double>(std::max<std::int64_t>(num_points_, 1))};
  }

  Tally points_{};
  std::int64_t num_points_ = 0;
};

}  // namespace manip3d
