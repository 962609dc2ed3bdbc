#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>

#include "geometry/lanes.hpp"
#include "manip3d/forge/composite.hpp"

namespace manip3d {

/// Bilinear interpolation of an image's colours. Places outside the image get the colour at its
/// edge.
class TextureSampler {
 public:
  /// A place in the image: the pixel above and left of it, and the weights of the right and the
  /// lower pixels in units of 1/256.
  struct Place {
    std::int32_t u, v, right, below;
  };
  struct FourPlaces {
    Int4 u, v, right, below;
    [[nodiscard]] Place operator[](int lane) const {
      return {u[lane], v[lane], right[lane], below[lane]};
    }
  };

  explicit TextureSampler(const ColorView& image)
      : pixels_(image.pixels),
        stride_(3 * image.cols),
        below_(image.rows > 1 ? stride_ : 0),
        first_with_two_before_(image.cols > 1 ? 2 : 3 * image.rows * image.cols),
        beside_(image.cols > 1 ? 3 : 0),
        last_row_(image.rows - 1),
        last_u_(static_cast<float>(image.cols - 1)),
        last_v_(static_cast<float>(image.rows - 1)),
        most_u_(static_cast<float>(std::max<std::int64_t>(image.cols - 2, 0))),
        most_v_(static_cast<float>(std::max<std::int64_t>(image.rows - 2, 0))) {}

  [[nodiscard]] FourPlaces places(Float4 u, Float4 v) const {
    const auto [u0, right] = along(u, last_u_, most_u_);
    const auto [v0, below] = along(v, last_v_, most_v_);
    return {u0, v0, right, below};
  }

  /// The colour R + 2^8 G + 2^16 B at a place.
  [[nodiscard]] std::uint32_t packed(const Place& place) const {
    const std::int64_t at = place.v * stride_ + 3 * place.u;
    return blend(pair(at), pair(at + below_), place.right, place.below);
  }
  [[nodiscard]] std::uint32_t packed(float u, float v) const {
    return packed(places(all_of(u), all_of(v))[0]);
  }
  /// Prefetches the pixels a few rows below a place: row by row painting reads them soon, and
  /// hardware prefetchers do not predict it.
  void fetch_below(const Place& place) const {
    constexpr std::int32_t kAhead = 3;  // rows: painting them takes about as long as a cache miss
    const std::int64_t v = std::min<std::int64_t>(place.v + kAhead, last_row_);
    __builtin_prefetch(pixels_ + v * stride_ + 3 * place.u);
  }

 private:
  struct Along {
    Int4 pixel, next;
  };
  /// The pixel and weight along one axis. The last pixel belongs to the last pair, with a weight of
  /// 1.
  static Along along(Float4 at, float last, float most) {
    at = at > 0.0F ? at : all_of(0.0F);
    at = at < last ? at : all_of(last);
    const Int4 pixel = __builtin_convertvector(at < most ? at : all_of(most), Int4);
    const Float4 fraction = at - __builtin_convertvector(pixel, Float4);
    return {pixel, __builtin_convertvector(fraction * 256.0F + 0.5F, Int4)};
  }

  /// The six bytes of a pixel and the one to its right.
  [[nodiscard]] std::uint64_t pair(std::int64_t at) const {
    std::uint64_t bytes = 0;
    // reads two bytes before the pixel, because there may be none after the last one
    if (at >= first_with_two_before_) {
      std::memcpy(&bytes, pixels_ + at - 2, sizeof bytes);
      return bytes >> 16;
    }
    for (std::int64_t i = 5; i >= 0; --i) {
      bytes = bytes << 8 | pixels_[i < 3 ? at + i : at + beside_ + i - 3];
    }
    return bytes;
  }

  /// Mixes the upper and the lower pair. All sums are whole numbers, which are rounded once.
  static std::uint32_t blend(std::uint64_t above, std::uint64_t under, std::int32_t right,
                             std::int32_t below) {
#if defined(__SSE2__)
    const __m128i weights = _mm_set1_epi32(256 - right + (right << 16));
    const __m128i a = across(above, weights), b = across(under, weights);
    // Both are at most 256 x 255: minus 2^15 they fit into signed 16 bits.
    const __m128i both = _mm_xor_si128(_mm_or_si128(a, _mm_slli_epi32(b, 16)),
                                       _mm_set1_epi32(static_cast<int>(0x80008000U)));
    const __m128i sum = _mm_madd_epi16(both, _mm_set1_epi32(256 - below + (below << 16)));
    constexpr int kHalf = 1 << 15, kLess = 256 << 15;
    const __m128i rgb = _mm_srli_epi32(_mm_add_epi32(sum, _mm_set1_epi32(kLess + kHalf)), 16);
    const __m128i words = _mm_packs_epi32(rgb, rgb);
    return static_cast<std::uint32_t>(_mm_cvtsi128_si32(_mm_packus_epi16(words, words))) &
           0xffffffU;
  }

  /// Weighted sums of R, G and B: (256 - right) times the first pixel and right times the second.
  static __m128i across(std::uint64_t two, __m128i weights) {
    const __m128i first = _mm_cvtsi64_si128(static_cast<long long>(two));
    const __m128i bytes = _mm_unpacklo_epi8(first, _mm_srli_epi64(first, 24));
    const __m128i words = _mm_unpacklo_epi8(bytes, _mm_setzero_si128());
    return _mm_madd_epi16(words, weights);
  }
#else
    const auto u = static_cast<std::uint32_t>(right), v = static_cast<std::uint32_t>(below);
    const auto channel = [](std::uint64_t two, int byte) {
      return static_cast<std::uint32_t>(two >> (8 * byte)) & 0xffU;
    };
    std::uint32_t rgb = 0;
    for (int i = 2; i >= 0; --i) {
      const std::uint32_t a = (256 - u) * channel(above, i) + u * channel(above, i + 3);
      const std::uint32_t b = (256 - u) * channel(under, i) + u * channel(under, i + 3);
      rgb = rgb << 8 | ((256 - v) * a + v * b + 0x8000U) >> 16;
    }
    return rgb;
  }
#endif

  const std::uint8_t* pixels_;
  std::int64_t stride_, below_, first_with_two_before_, beside_, last_row_;
  float last_u_, last_v_, most_u_, most_v_;
};

}  // namespace manip3d
