#include "authenticate/range_windows.hpp"

#include <algorithm>
#include <array>
#include <bit>

#include "authenticate/natural_log.hpp"

namespace manip3d {
namespace {

// Half sizes of windows, in rows of 2 lasers and columns of 0.72 degrees: from a pedestrian at 30 m
// to a car at 6 m. All windows have 3 layers, from 0.65 to 1.5 times the distance.
struct Extent {
  int rows, columns;
};
constexpr std::array<Extent, 3> kWindows = {{{1, 1}, {2, 4}, {4, 9}}};

// Half of forged ranges are incoherent. Windows with a share below kMinShare, and larger ones
// around them, are skipped.
constexpr double kMinShare = 0.25;

// Windows with fewer incoherent ranges cannot reach an exponent that counts.
constexpr std::int32_t kMinIncoherent = 6;

// Chernoff exponent of a window: P(X >= x) <= exp(-chernoff) for the sum X of n independent 0-1
// variables with mean p [Chernoff 1952].
double chernoff(const RangeTally& tally, double p) {
  const double n = tally.points;
  const double x = tally.incoherent;
  if (!(x > p * n)) return 0.0;
  const double hits = x * natural_log(x / (n * p));
  return x < n ? hits + (n - x) * natural_log((n - x) / (n - n * p)) : hits;
}

// A window around a voxel. Columns are cyclic; rows and layers are cut off at the ends.
class Window {
 public:
  Window(const RangeVoxels& voxels, const RangeVoxel& at, const Extent& extent)
      : voxels_(voxels),
        top_(std::max(0, at.row - extent.rows)),
        bottom_(std::min(voxels.rows() - 1, at.row + extent.rows)),
        left_(at.column - std::min(extent.columns, voxels.columns() / 2)),
        right_(at.column + std::min(extent.columns, (voxels.columns() - 1) / 2)),
        near_(std::max(0, at.layer - 1)),
        far_(std::min(RangeVoxels::kLayers - 1, at.layer + 1)) {}

  // Calls visit(number) for the voxels of the window that hold points.
  template <typename Visit>
  void each(const Visit& visit) const {
    const int columns = voxels_.columns();
    for (int row = top_; row <= bottom_; ++row) {
      for (int column = left_; column <= right_; ++column) {
        const auto [first, last] = voxels_.numbers(row, (column + columns) % columns, near_, far_);
        for (std::int32_t k = first; k < last; ++k) visit(k);
      }
    }
  }

 private:
  const RangeVoxels& voxels_;
  int top_, bottom_, left_, right_, near_, far_;
};

}  // namespace

int range_layer(float squared_range) {
  // Exponent and first mantissa bit of the squared range: two layers per octave of the square.
  constexpr int kNearestOctave = 250;  // exponent and mantissa bit of 0.25
  const auto octaves = static_cast<int>(std::bit_cast<std::uint32_t>(squared_range) >> 22U);
  return std::clamp(octaves - kNearestOctave, 0, RangeVoxels::kLayers - 1);
}

void RangeVoxels::number() {
  voxels_.clear();
  for (int row = 0; row < rows_; ++row) {
    for (int column = 0; column < columns_; ++column) {
      Cell& at = cells_[cell(row, column)];
      at.first = static_cast<std::int32_t>(voxels_.size());
      for (std::uint32_t layers = at.layers; layers != 0; layers &= layers - 1U) {
        voxels_.push_back({row, column, std::countr_zero(layers)});
      }
    }
  }
}

std::vector<float> incoherent_windows(const RangeVoxels& voxels,
                                      const std::vector<RangeTally>& tallies, double incoherence,
                                      double threshold) {
  std::vector<float> strongest(voxels.size(), 0.0F);
  const auto examine = [&](const RangeVoxel& at) {
    for (const Extent& extent : kWindows) {
      const Window window(voxels, at, extent);
      RangeTally sum;
      window.each([&](std::size_t k) {
        sum.points += tallies[k].points;
        sum.incoherent += tallies[k].incoherent;
      });
      // larger windows have an even smaller share
      if (sum.incoherent < kMinShare * sum.points) return;
      if (sum.incoherent < kMinIncoherent) continue;
      const auto exponent = static_cast<float>(chernoff(sum, incoherence));
      if (exponent < threshold) continue;
      window.each([&](std::size_t k) { strongest[k] = std::max(strongest[k], exponent); });
    }
  };
  for (std::size_t k = 0; k < voxels.size(); ++k) {
    const RangeTally& tally = tallies[k];
    if (tally.incoherent > 1 && 4 * tally.incoherent > tally.points) examine(voxels.voxels()[k]);
  }
  return strongest;
}

}  // namespace manip3d
