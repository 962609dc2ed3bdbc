#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#if defined(__SSE2__)
#include <emmintrin.h>
#endif

namespace manip3d {

/// Four numbers at a time, in one instruction on every processor with 16-byte vectors. Each number
/// gets the same bits as in scalar code.
using Float4 = float __attribute__((vector_size(16)));
using Int4 = std::int32_t __attribute__((vector_size(16)));

inline Float4 all_of(float value) { return Float4{value, value, value, value}; }
inline Float4 load4(const float* from) {
  Float4 lanes;
  std::memcpy(&lanes, from, sizeof lanes);
  return lanes;
}
inline Int4 load4(const std::int32_t* from) {
  Int4 lanes;
  std::memcpy(&lanes, from, sizeof lanes);
  return lanes;
}
inline void store4(float* to, Float4 lanes) { std::memcpy(to, &lanes, sizeof lanes); }

inline Float4 sqrt4(Float4 lanes) {
#if defined(__SSE2__)
  __m128 roots;
  std::memcpy(&roots, &lanes, sizeof roots);
  roots = _mm_sqrt_ps(roots);
  std::memcpy(&lanes, &roots, sizeof roots);
#else
  for (int i = 0; i < 4; ++i) lanes[i] = std::sqrt(lanes[i]);
#endif
  return lanes;
}

/// Transposes four rows.
inline std::array<Float4, 4> transpose(const std::array<Float4, 4>& r) {
  const Float4 a = __builtin_shufflevector(r[0], r[1], 0, 4, 1, 5);
  const Float4 b = __builtin_shufflevector(r[2], r[3], 0, 4, 1, 5);
  const Float4 c = __builtin_shufflevector(r[0], r[1], 2, 6, 3, 7);
  const Float4 d = __builtin_shufflevector(r[2], r[3], 2, 6, 3, 7);
  return {__builtin_shufflevector(a, b, 0, 1, 4, 5), __builtin_shufflevector(a, b, 2, 3, 6, 7),
          __builtin_shufflevector(c, d, 0, 1, 4, 5), __builtin_shufflevector(c, d, 2, 3, 6, 7)};
}

using Double2 = double __attribute__((vector_size(16)));
using Float2 = float __attribute__((vector_size(8)));

/// Two of four lanes in double precision.
inline Double2 low_doubles(Float4 lanes) {
#if defined(__SSE2__)
  __m128 floats;
  std::memcpy(&floats, &lanes, sizeof floats);
  const __m128d two = _mm_cvtps_pd(floats);
  Double2 doubles;
  std::memcpy(&doubles, &two, sizeof doubles);
  return doubles;
#else
  return __builtin_convertvector(__builtin_shufflevector(lanes, lanes, 0, 1), Double2);
#endif
}
inline Double2 high_doubles(Float4 lanes) {
  return low_doubles(__builtin_shufflevector(lanes, lanes, 2, 3, 2, 3));
}

/// Four numbers, each rounded once.
inline Float4 rounded(Double2 low, Double2 high) {
#if defined(__SSE2__)
  __m128d two, others;
  std::memcpy(&two, &low, sizeof two);
  std::memcpy(&others, &high, sizeof others);
  const __m128 four = _mm_movelh_ps(_mm_cvtpd_ps(two), _mm_cvtpd_ps(others));
  Float4 lanes;
  std::memcpy(&lanes, &four, sizeof lanes);
  return lanes;
#else
  return __builtin_shufflevector(__builtin_convertvector(low, Float2),
                                 __builtin_convertvector(high, Float2), 0, 1, 2, 3);
#endif
}

/// scale * lane + shift, computed in double precision and rounded once.
inline Float4 affine4(double scale, Float4 lanes, double shift) {
  return rounded(scale * low_doubles(lanes) + shift, scale * high_doubles(lanes) + shift);
}

using Long2 = std::int64_t __attribute__((vector_size(16)));

/// Bit i: lane i of a comparison of doubles is true.
inline unsigned true_lanes(Long2 compared) {
#if defined(__SSE2__)
  __m128d lanes;
  std::memcpy(&lanes, &compared, sizeof lanes);
  return static_cast<unsigned>(_mm_movemask_pd(lanes));
#else
  return (compared[0] != 0 ? 1U : 0U) | (compared[1] != 0 ? 2U : 0U);
#endif
}

/// Bit i: lane i of a comparison is true.
inline unsigned true_lanes(Int4 compared) {
#if defined(__SSE2__)
  __m128 lanes;
  std::memcpy(&lanes, &compared, sizeof lanes);
  return static_cast<unsigned>(_mm_movemask_ps(lanes));
#else
  unsigned bits = 0;
  for (int i = 0; i < 4; ++i) bits |= compared[i] != 0 ? 1U << i : 0U;
  return bits;
#endif
}

}  // namespace manip3d
