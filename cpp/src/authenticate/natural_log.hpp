#pragma once

#include <cmath>
#include <numbers>

namespace manip3d {

/// ln x for x > 0, from additions, multiplications and divisions only, so that all CPUs give the
/// same bits.
inline double natural_log(double x) {
  int exponent = 0;
  const double mantissa = std::frexp(x, &exponent);        // in [0.5, 1)
  const double t = (mantissa - 0.75) / (mantissa + 0.75);  // ln m = ln 0.75 + 2 artanh t
  const double s = t * t;                                  // <= 0.04
  double series = 0.0;
  for (int k = 19; k >= 1; k -= 2) series = series * s + 1.0 / k;
  constexpr double kLogThreeQuarters = -0.28768207245178093;
  return exponent * std::numbers::ln2 + kLogThreeQuarters + 2.0 * t * series;
}

}  // namespace manip3d
