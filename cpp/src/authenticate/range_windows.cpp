#include "authenticate/range_windows.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace manip3d {
namespace {

struct Extent {
  int rows, columns;
};

// In cells of 2 rings x 0.72 degrees: a pedestrian at 30 m to a car at 5 m.
constexpr std::array<Extent, 5> kWindows = {{{2, 2}, {4, 4}, {4, 12}, {8, 8}, {10, 24}}};

// ln x for x > 0 from additions, multiplications and divisions: the same bits on every CPU.
double natural_log(double x) {
  int exponent = 0;
  const double mantissa = std::frexp(x, &exponent);        // in [0.5, 1)
  const double t = (mantissa - 0.75) / (mantissa + 0.75);  // ln m = ln 0.75 + 2 artanh t
  const double s = t * t;                                  // <= 0.04
  double series = 0.0;
  for (int k = 19; k >= 1; k -= 2) series = series * s + 1.0 / k;
  constexpr double kLogThreeQuarters = -0.28768207245178093;
  return exponent * std::numbers::ln2 + kLogThreeQuarters + 2.0 * t * series;
}

// P(X >= x) <= exp(-chernoff) for the sum X of n independent 0-1 variables of mean p [Chernoff
// 1952].
double chernoff(const RangeTally& tally, double p) {
  const double n = tally.points;
  const double x = tally.incoherent;
  if (!(x > p * n)) return 0.0;
  const double hits = x * natural_log(x / (n * p));
  return x < n ? hits + (n - x) * natural_log((n - x) / (n - n * p)) : hits;
}

// Sums over [0, row) x [0, column) of the cells, which repeat once beyond the last column.
class Sums {
 public:
  explicit Sums(const RingImage<RangeTally>& cells)
      : sums_(cells.rings() + 1, 2 * cells.columns() + 1, RangeTally{}) {
    for (int row = 0; row < cells.rings(); ++row) {
      RangeTally along;
      for (int column = 0; column < 2 * cells.columns(); ++column) {
        const RangeTally& cell = cells(row, column % cells.columns());
        along.points += cell.points;
        along.incoherent += cell.incoherent;
        const RangeTally& above = sums_(row, column + 1);
        sums_(row + 1, column + 1) = {above.points + along.points,
                                      above.incoherent + along.incoherent};
      }
    }
  }

  [[nodiscard]] RangeTally of(int row, int column, const Extent& window) const {
    const RangeTally& a = sums_(row, column);
    const RangeTally& b = sums_(row, column + window.columns);
    const RangeTally& c = sums_(row + window.rows, column);
    const RangeTally& d = sums_(row + window.rows, column + window.columns);
    return {d.points - b.points - c.points + a.points,
            d.incoherent - b.incoherent - c.incoherent + a.incoherent};
  }

 private:
  RingImage<RangeTally> sums_;
};

}  // namespace

RingImage<double> incoherent_windows(const RingImage<RangeTally>& cells, double incoherence,
                                     double threshold) {
  const Sums sums(cells);
  RingImage<double> strongest(cells.rings(), cells.columns(), 0.0);
  for (const Extent& window : kWindows) {
    for (int row = 0; row + window.rows <= cells.rings(); row += window.rows / 2) {
      for (int column = 0; column < cells.columns(); column += window.columns / 2) {
        const double exponent = chernoff(sums.of(row, column, window), incoherence);
        if (exponent < threshold) continue;
        for (int r = row; r < row + window.rows; ++r) {
          for (int c = column; c < column + window.columns; ++c) {
            double& cell = strongest(r, strongest.wrapped(c));
            cell = std::max(cell, exponent);
          }
        }
      }
    }
  }
  return strongest;
}

}  // namespace manip3d
