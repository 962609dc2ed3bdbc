#include "simplify/fast_prices.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <utility>

#include "geometry/lanes.hpp"
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
  const Int4 positive = prices > 0.0F, others = ~(prices <= 0.0F) & bits_of(kDearest);
  return (positive & std::bit_cast<Int4>(prices)) | (~positive & others);
}

/// Each edge once: in a closed surface from the lower vertex to the higher one.
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
  const Int4 too_dear = value > squared_limit * edge.weight;
  const Int4 keys = (too_dear & bits_of(kTooDear)) | (~too_dear & keys_of(edge.price(value)));
  for (std::size_t i = 0; i < 4; ++i) {
    to[i] = {static_cast<std::uint32_t>(keys[i]), from[i].slot};
  }
}

}  // namespace

void price_edges(const FastMesh& mesh, const FastPieces& pieces, float squared_limit,
                 std::int64_t begin, std::int64_t end, Bulk<PricedEdge>& edges) {
  constexpr std::int64_t kFaces = 256;  // so many that their edges stay in the nearest cache
  edges.clear();
  edges.reserve(2 * (end - begin));               // three for two faces, more where it is open
  std::array<EdgeWithEnds, 3 * kFaces + 3> here;  // NOLINT: filled below
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
    for (std::size_t i = count; i % 4 != 0; ++i) here[i] = here[count - 1];
    const std::size_t first = edges.size();
    edges.resize(first + count + 3);
    for (std::size_t i = 0; i < count; i += 4)
      price_four(mesh, squared_limit, &here[i], &edges[first + i]);
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
