#include "simplify/spatial_order.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <tuple>
#include <utility>

#include "geometry/bulk.hpp"
#include "manip3d/geometry/parallel.hpp"

namespace manip3d {
namespace {

/// Inserts two zero bits between each two of the lower ten bits.
std::uint32_t spread(std::uint32_t x) {
  x = (x | (x << 16)) & 0x030000FFU;
  x = (x | (x << 8)) & 0x0300F00FU;
  x = (x | (x << 4)) & 0x030C30C3U;
  return (x | (x << 2)) & 0x09249249U;
}

struct Coded {
  std::uint32_t code;
  std::int32_t vertex;
};

/// Stable radix sort of 30 bits.
void sort_by_code(Bulk<Coded>& items) {
  constexpr int kBits = 10;
  constexpr std::size_t kBins = 1U << kBits;
  Bulk<Coded> other(items.size(), items.get_allocator());
  for (int shift = 0; shift < 30; shift += kBits) {
    std::array<std::uint32_t, kBins> start{};
    for (const Coded& item : items) ++start[(item.code >> shift) & (kBins - 1)];
    std::uint32_t sum = 0;
    for (std::uint32_t& count : start) sum += std::exchange(count, sum);
    for (const Coded& item : items) other[start[(item.code >> shift) & (kBins - 1)]++] = item;
    items.swap(other);
  }
}

}  // namespace

SpatialOrder spatial_order(const MeshView& mesh, const BoundingBox& box, int num_threads,
                           Arena& arena, const Progress& progress) {
  SpatialOrder order{Bulk<std::int32_t>(arena), Bulk<std::int32_t>(arena)};
  order.rank.assign(mesh.num_vertices(), -1);
  for (Eigen::Index i = 0; i < mesh.faces.size(); ++i) order.rank[mesh.faces.data()[i]] = 0;
  if (progress) progress(0.1);
  const double extent = (box.max - box.min).maxCoeff();
  const double cells = extent > 0.0 && std::isfinite(extent) ? 1023.0 / extent : 0.0;
  Bulk<Coded> items(mesh.num_vertices(), arena);
  parallel_chunks(
      mesh.num_vertices(), 1 << 14, num_threads, [&](std::int64_t begin, std::int64_t end) {
        for (auto v = static_cast<std::int32_t>(begin); v < end; ++v) {
          std::uint32_t code = 0;
          for (int k = 0; k < 3; ++k) {
            const double cell = cells > 0.0 ? (mesh.vertices(v, k) - box.min[k]) * cells : 0.0;
            code |= spread(static_cast<std::uint32_t>(std::clamp(cell, 0.0, 1023.0))) << k;
          }
          items[v] = {code, v};
        }
      });
  std::erase_if(items, [&](const Coded& item) { return order.rank[item.vertex] < 0; });
  if (progress) progress(0.3);
  sort_by_code(items);
  if (progress) progress(0.6);
  const auto place = [&](const Coded& item) {
    const double* p = mesh.vertices.data() + 3 * static_cast<std::ptrdiff_t>(item.vertex);
    return std::tie(p[0], p[1], p[2]);
  };
  order.source.reserve(items.size());
  for (std::size_t begin = 0, end = 0; begin < items.size(); begin = end) {
    while (end < items.size() && items[end].code == items[begin].code) ++end;
    const auto first = items.begin() + static_cast<std::ptrdiff_t>(begin);
    const auto last = items.begin() + static_cast<std::ptrdiff_t>(end);
    if (end - begin > 1) {
      std::sort(first, last, [&](const Coded& a, const Coded& b) {
        return std::tuple_cat(place(a), std::tie(a.vertex)) <
               std::tuple_cat(place(b), std::tie(b.vertex));
      });
    }
    for (auto item = first; item != last; ++item) {
      if (item == first || place(*item) != place(item[-1])) order.source.push_back(item->vertex);
      order.rank[item->vertex] = static_cast<std::int32_t>(order.source.size()) - 1;
    }
  }
  return order;
}

}  // namespace manip3d
