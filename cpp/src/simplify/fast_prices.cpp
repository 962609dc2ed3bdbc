#include "simplify/fast_prices.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <utility>

#include "geometry/lanes.hpp"
#include "geometry/wide_vectors.hpp"
#include "simplify/quadric_vertex.hpp"

namespace manip3d::fast_detail {
namespace {

/// An edge of a face with its ends.
struct EdgeWithEnds {
  std::uint32_t slot;
  std::int32_t v, t;
};

Int4 bits_of(std::uint32_t bits) {
  const auto number = static_cast<std::int32_t>(bits);
  return Int4{number, number, number, number};
}

/// key_of() of four prices.
Int4 keys_of(Float4 prices) {
  const Int4 positive = prices > 0.0F, others = ~(prices <= 0.0F) & bits_of(kMaxPrice);
  return (positive & std::bit_cast<Int4>(prices)) | (~positive & others);
}

/// Whether the edge is priced at this face, so that each edge is priced once: in a closed surface,
/// from the lower vertex to the higher one.
bool is_priced_here(const FastMesh& mesh, std::int32_t from, std::int32_t to) {
  return (from < to) | ((mesh.is_open[from] & mesh.is_open[to]) != 0);
}

/// Prices four edges.
void price_four(const FastMesh& mesh, float squared_limit, const EdgeWithEnds* from,
                PricedEdge* to) {
  const auto four = [&](std::int32_t EdgeWithEnds::* end) {
    const auto of = [&](std::size_t i) -> const QuadricVertex* {
      return &mesh.vertices[from[i].*end];
    };
    return transpose(std::array{of(0), of(1), of(2), of(3)});
  };
  const EdgeQuadric<Float4> edge(four(&EdgeWithEnds::v), four(&EdgeWithEnds::t));
  const Float4 value = edge.value(edge.ux, edge.uy, edge.uz);
  const Int4 too_expensive = value > squared_limit * edge.weight;
  const Int4 keys =
      (too_expensive & bits_of(kTooExpensive)) | (~too_expensive & keys_of(edge.price(value)));
  for (std::size_t i = 0; i < 4; ++i) {
    to[i] = {static_cast<std::uint32_t>(keys[i]), from[i].slot};
  }
}

// Lambdas and members of templates use wider vectors only with these pragmas, which clang lacks.
#if defined(MANIP3D_AVX2) && !defined(__clang__)
#define MANIP3D_PRICES_EIGHT
#pragma GCC push_options
#pragma GCC target("avx2")
namespace wide {

using Float8 = float __attribute__((vector_size(32)));
using Int8 = std::int32_t __attribute__((vector_size(32)));

#define MANIP3D_EDGE_QUADRIC EdgeQuadric8
#include "simplify/edge_quadric.inc"
#undef MANIP3D_EDGE_QUADRIC

/// Transposes eight vertices into one with eight numbers per member.
void transpose8(const FastMesh& mesh, const EdgeWithEnds* edges, std::int32_t EdgeWithEnds::* end,
                QuadricVertexOf<Float8>& out) {
  std::array<const float*, 8> from;  // NOLINT: filled below
  for (std::size_t i = 0; i < 8; ++i) from[i] = &mesh.vertices[edges[i].*end].x;
  Float8* to = &out.x;
  for (int row = 0; row < 4; ++row, to += 4) {
    const auto pair = [&](std::size_t i) {  // of the vertices i and i + 4
      return __builtin_shufflevector(load4(from[i] + 4 * row), load4(from[i + 4] + 4 * row), 0, 1,
                                     2, 3, 4, 5, 6, 7);
    };
    const Float8 r0 = pair(0), r1 = pair(1), r2 = pair(2), r3 = pair(3);
    const Float8 a = __builtin_shufflevector(r0, r1, 0, 8, 1, 9, 4, 12, 5, 13);
    const Float8 b = __builtin_shufflevector(r2, r3, 0, 8, 1, 9, 4, 12, 5, 13);
    const Float8 c = __builtin_shufflevector(r0, r1, 2, 10, 3, 11, 6, 14, 7, 15);
    const Float8 d = __builtin_shufflevector(r2, r3, 2, 10, 3, 11, 6, 14, 7, 15);
    to[0] = __builtin_shufflevector(a, b, 0, 1, 8, 9, 4, 5, 12, 13);
    to[1] = __builtin_shufflevector(a, b, 2, 3, 10, 11, 6, 7, 14, 15);
    to[2] = __builtin_shufflevector(c, d, 0, 1, 8, 9, 4, 5, 12, 13);
    to[3] = __builtin_shufflevector(c, d, 2, 3, 10, 11, 6, 7, 14, 15);
  }
}

Int8 bits8(std::uint32_t bits) { return Int8{} + static_cast<std::int32_t>(bits); }

/// price_four() for eight edges at a time, with the same operations and so the same bits.
void price_eight(const FastMesh& mesh, float squared_limit, const EdgeWithEnds* from,
                 PricedEdge* to) {
  QuadricVertexOf<Float8> v, t;  // NOLINT: filled below
  transpose8(mesh, from, &EdgeWithEnds::v, v);
  transpose8(mesh, from, &EdgeWithEnds::t, t);
  const EdgeQuadric8<Float8> edge(v, t);
  const Float8 value = edge.value(edge.ux, edge.uy, edge.uz), price = edge.price(value);
  const Int8 too_expensive = value > squared_limit * edge.weight;
  const Int8 positive = price > 0.0F, others = ~(price <= 0.0F) & bits8(kMaxPrice);
  const Int8 known = (positive & reinterpret_cast<Int8>(price)) | (~positive & others);
  const Int8 keys = (too_expensive & bits8(kTooExpensive)) | (~too_expensive & known);
  for (std::size_t i = 0; i < 8; ++i) {
    to[i] = {static_cast<std::uint32_t>(keys[i]), from[i].slot};
  }
}

}  // namespace wide
#pragma GCC pop_options
#endif

/// Prices edges, eight at a time if the processor supports it. Both tables must have room for
/// kLanes more.
constexpr std::size_t kLanes = 8;
void price(const FastMesh& mesh, float squared_limit, EdgeWithEnds* from, std::size_t count,
           PricedEdge* to) {
  for (std::size_t i = count; i % kLanes != 0; ++i) from[i] = from[count - 1];
#ifdef MANIP3D_PRICES_EIGHT
  if (has_avx2()) {
    for (std::size_t i = 0; i < count; i += kLanes) {
      wide::price_eight(mesh, squared_limit, from + i, to + i);
    }
    return;
  }
#endif
  for (std::size_t i = 0; i < count; i += 4) price_four(mesh, squared_limit, from + i, to + i);
}

}  // namespace

void price_edges(const FastMesh& mesh, const FastPieces& pieces, float squared_limit,
                 std::int64_t begin, std::int64_t end, Bulk<PricedEdge>& edges) {
  constexpr std::int64_t kFaces = 256;  // faces whose edges fit into the first-level cache
  edges.clear();
  edges.reserve(2 * (end - begin));  // three edges for two faces, more at boundaries
  std::array<EdgeWithEnds, 3 * kFaces + kLanes> here;  // NOLINT: filled below
  for (std::int64_t f = begin; f < end;) {
    std::size_t count = 0;
    for (const std::int64_t stop = std::min(end, f + kFaces); f < stop; ++f) {
      if (pieces.num_spent() > 0 && pieces.is_spent(mesh.faces[f])) continue;
      for (std::uint32_t c = 0; c < 3; ++c) {
        const std::int32_t a = mesh.faces[f][c], b = mesh.faces[f][after(c)];
        here[count] = {static_cast<std::uint32_t>(3 * f) + c, std::min(a, b), std::max(a, b)};
        count += static_cast<std::size_t>(is_priced_here(mesh, a, b));
      }
    }
    if (count == 0) continue;
    const std::size_t first = edges.size();
    edges.resize(first + count + kLanes);
    price(mesh, squared_limit, here.data(), count, &edges[first]);
    edges.resize(first + count);
  }
}

void sort_by_price(Bulk<PricedEdge>& items, Bulk<PricedEdge>& other) {
  if (items.size() < 2) return;
  std::uint32_t least = kNoPrice, most = 0;
  for (const PricedEdge& item : items) {
    least = std::min(least, item.key);
    most = std::max(most, item.key);
  }
  const int shift = std::max(0, static_cast<int>(std::bit_width(most - least)) - 16);
  other.resize(items.size());
  for (int pass = 0; pass < 2; ++pass) {
    std::array<std::uint32_t, 256> start{};
    const auto digit = [&](const PricedEdge& item) {
      return (((item.key - least) >> shift) >> (8 * pass)) & 255U;
    };
    for (const PricedEdge& item : items) ++start[digit(item)];
    std::uint32_t sum = 0;
    for (std::uint32_t& count : start) sum += std::exchange(count, sum);
    for (const PricedEdge& item : items) other[start[digit(item)]++] = item;
    items.swap(other);
  }
}

}  // namespace manip3d::fast_detail
