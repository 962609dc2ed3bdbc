#pragma once

#include <bit>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/range_image.hpp"
#include "manip3d/simplify/cs3.hpp"

namespace manip3d {

/// A slot is a pixel of the box around the valid pixels: row * stride + column.
using Slot = std::uint32_t;

/// Importance as a sortable number of 22 bits; a smaller one is more important. IEEE 754 floats
/// sort like integers once the bits of negative ones are inverted; the last ten bits are dropped.
using ImportanceKey = std::uint32_t;
inline constexpr int kDroppedBits = 10;
inline constexpr int kKeyBits = 32 - kDroppedBits;
inline constexpr ImportanceKey kNoKey = ~ImportanceKey{0};  ///< No measurement.

inline ImportanceKey to_key(float importance) {
  const auto bits = std::bit_cast<std::int32_t>(importance);
  const std::int32_t ascending = bits ^ ((bits >> 31) | std::int32_t{-0x7FFFFFFF - 1});
  return ~static_cast<std::uint32_t>(ascending) >> kDroppedBits;
}

inline float to_importance(ImportanceKey key) {
  const std::uint32_t ascending = ~(key << kDroppedBits);
  const std::uint32_t sign = (ascending >> 31) != 0 ? 0x80000000U : 0xFFFFFFFFU;
  return std::bit_cast<float>(ascending ^ sign);
}

/// The importance of the pixels of a range image.
struct ImportanceMap {
  PixelBox box;             ///< Box around the valid pixels, as far as known before reading them.
  std::int64_t stride = 0;  ///< Slots per row; a multiple of 64.
  std::vector<ImportanceKey> keys;                        ///< By slot.
  std::vector<float> hessian_uu, hessian_vv, hessian_uv;  ///< By slot; empty if not needed.
  float max_depth = 0.0F;                                 ///< Largest z of a valid pixel.

  [[nodiscard]] Slot slot(std::int64_t u, std::int64_t v) const {
    return static_cast<Slot>((v - box.v0) * stride + (u - box.u0));
  }
  [[nodiscard]] bool is_valid(Slot slot) const { return keys[slot] != kNoKey; }
};

/// Computes importance maps; keeps its memory.
class ImportanceMapper {
 public:
  /// Reads the image once, row by row: points, A, the Hessian and its importance of a few rows at a
  /// time stay in the cache. Only the map is written to memory.
  void compute(const RangeImage& image, const Cs3Options& options, ImportanceMap& map);

 private:
  std::vector<std::vector<float>> scratch_;  ///< One for each chunk of rows.
  std::vector<float> max_depths_;            ///< One for each chunk of rows.
};

}  // namespace manip3d
