#include "authenticate/range_windows.hpp"

#include <algorithm>
#include <array>
#include <bit>

#include "authenticate/natural_log.hpp"

namespace manip3d {
namespace {

// Half sizes in rows of 2 lasers and columns of 0.72 degrees: a pedestrian at 30 m to a car at 6 m.
// All are 3 layers deep, from 0.65 to 1.5 times the distance.
struct Extent {
  int rows, columns;
};
constexpr std::array<Extent, 3> kWindows = {{{1, 1}, {2, 4}, {4, 9}}};

// Forged ranges are incoherent by half; a window that holds much fewer is not looked at further.
constexpr double kLeastShare = 0.25;

// Fewer incoherent ranges in a window reach no exponent that counts.
constexpr std::int32_t kFewestIncoherent = 6;

// P(X >= x) <= exp(-chernoff) for the sum X of n independent 0-1 variables of mean p [Chernoff
// 1952].
double chernoff(const RangeTally& tally, double p) {
  const double n = tally.points;
  const double x = tally.incoherent;
  if (!(x > p * n)) return 0.0;
  const double hits = x * natural_log(x / (n * p));
  return x < n ? hits + (n - x) * natural_log((n - x) / (n - n * p)) : hits;
}

// A window around a voxel; columns go around the horizon, rows and layers end.
class Window {
 public:
  template <typename Value>
  Window(const RangeVoxels<Value>& voxels, int row, int column, int layer, const Extent& extent)
      : columns_(voxels.columns()),
        top_(std::max(0, row - extent.rows)),
        bottom_(std::min(voxels.rows() - 1, row + extent.rows)),
        left_(column - std::min(extent.columns, columns_ / 2)),
        right_(column + std::min(extent.columns, (columns_ - 1) / 2)),
        near_(std::max(0, layer - 1)),
        far_(std::min(RangeVoxels<Value>::kLayers - 1, layer + 1)) {}

  template <typename Visit>
  void each(const Visit& visit) const {
    for (int row = top_; row <= bottom_; ++row) {
      for (int c = left_; c <= right_; ++c) {
        const int column = (c + columns_) % columns_;
        for (int layer = near_; layer <= far_; ++layer) visit(row, column, layer);
      }
    }
  }

 private:
  int columns_, top_, bottom_, left_, right_, near_, far_;
};

}  // namespace

int range_layer(float squared_range) {
  // Exponent and first bit of the mantissa: two layers per octave of the square.
  constexpr int kNearestOctave = 250;  // of 0.25
  const auto octaves = static_cast<int>(std::bit_cast<std::uint32_t>(squared_range) >> 22U);
  return std::clamp(octaves - kNearestOctave, 0, RangeVoxels<float>::kLayers - 1);
}

RangeVoxels<float> incoherent_windows(const RangeVoxels<RangeTally>& voxels, double incoherence,
                                      double threshold) {
  RangeVoxels<float> strongest(voxels.rows(), voxels.columns(), 0.0F);
  const auto examine = [&](int row, int column, int layer) {
    for (const Extent& extent : kWindows) {
      const Window window(voxels, row, column, layer, extent);
      RangeTally sum;
      window.each([&](int r, int c, int l) {
        sum.points += voxels(r, c, l).points;
        sum.incoherent += voxels(r, c, l).incoherent;
      });
      if (sum.incoherent < kLeastShare * sum.points) return;  // the larger ones hold fewer still
      if (sum.incoherent < kFewestIncoherent) continue;
      const auto exponent = static_cast<float>(chernoff(sum, incoherence));
      if (exponent < threshold) continue;
      window.each([&](int r, int c, int l) {
        if (voxels(r, c, l).points > 0) strongest(r, c, l) = std::max(strongest(r, c, l), exponent);
      });
    }
  };
  for (int row = 0; row < voxels.rows(); ++row) {
    for (int column = 0; column < voxels.columns(); ++column) {
      for (int layer = 0; layer < RangeVoxels<RangeTally>::kLayers; ++layer) {
        const RangeTally& tally = voxels(row, column, layer);
        if (tally.incoherent > 1 && 4 * tally.incoherent > tally.points)
          examine(row, column, layer);
      }
    }
  }
  return strongest;
}

}  // namespace manip3d
