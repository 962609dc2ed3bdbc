#pragma once

#include <algorithm>
#include <bit>
#include <cstdint>

#include "geometry/bulk.hpp"
#include "simplify/fast_mesh.hpp"
#include "simplify/fast_pieces.hpp"

namespace manip3d::fast_detail {

// Prices are not negative, so their bits, as integers, have the same order.
constexpr std::uint32_t kNoPrice = 0xFFFFFFFFU;
constexpr std::uint32_t kTooExpensive = 0xFFFFFFFEU;  // above max_error
constexpr std::uint32_t kMaxPrice = 0x7F800000U;      // infinity

inline std::uint32_t key_of(float price) {
  return price > 0.0F ? std::min(std::bit_cast<std::uint32_t>(price), kMaxPrice)
                      : (price <= 0.0F ? 0U : kMaxPrice);
}

/// An edge of a face with its price; sorted by price, then by slot.
struct PricedEdge {
  std::uint32_t key;
  std::uint32_t slot;  // 3 face + corner
};

/// Prices the edges of the faces from `begin` to `end`, each once: in a closed surface, from the
/// lower vertex to the higher one. Leaves out pieces that can only be removed as a whole.
void price_edges(const FastMesh& mesh, const FastPieces& pieces, float squared_limit,
                 std::int64_t begin, std::int64_t end, Bulk<PricedEdge>& edges);

/// Stable radix sort with 16-bit digits over the bits in which the keys differ. `other` is a
/// buffer.
void sort_by_price(Bulk<PricedEdge>& items, Bulk<PricedEdge>& other);

}  // namespace manip3d::fast_detail
