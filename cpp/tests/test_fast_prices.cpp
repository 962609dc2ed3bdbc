#include <gtest/gtest.h>

#include <cstdint>
#include <random>

#include "manip3d/geometry/mesh.hpp"
#include "simplify/fast_mesh.hpp"
#include "simplify/fast_pieces.hpp"
#include "simplify/fast_prices.hpp"
#include "simplify/fast_quadrics.hpp"

namespace manip3d::fast_detail {
namespace {

/// A rough height field of `size` by `size` vertices.
TriangleMesh rough_field(int size) {
  std::mt19937 engine(3);
  std::uniform_real_distribution<double> height(0.0, 0.5);
  TriangleMesh mesh;
  mesh.vertices.resize(size * size, 3);
  mesh.faces.resize(2 * (size - 1) * (size - 1), 3);
  Eigen::Index row = 0;
  for (int y = 0; y < size; ++y) {
    for (int x = 0; x < size; ++x) {
      const int v = size * y + x;
      mesh.vertices.row(v) << x, y, height(engine);
      if (x + 1 == size || y + 1 == size) continue;
      mesh.faces.row(row++) << v, v + 1, v + size;
      mesh.faces.row(row++) << v + 1, v + size + 1, v + size;
    }
  }
  return mesh;
}

// Edges are priced four or eight at a time, depending on the processor; the bits must not depend on
// it.
TEST(FastPrices, AreThoseOfOneEdgeAtATime) {
  for (const int size : {2, 3, 4, 5, 20, 40}) {
    const TriangleMesh field = rough_field(size);
    const MeshView view(field);
    const Progress progress;
    Tasks tasks(1, progress);
    FastMesh mesh(view, bounding_box(view), {}, tasks);
    const std::vector<std::int32_t> looks;
    const FastPieces pieces(mesh, looks);
    sum_quadrics(mesh, {1.0, 1.0});
    const float limit = 1e-5F;
    Bulk<PricedEdge> edges;
    price_edges(mesh, pieces, limit, 0, mesh.num_faces(), edges);
    EXPECT_GE(edges.size(), static_cast<std::size_t>((size - 1) * (3 * size - 1)));
    for (const PricedEdge& priced : edges) {
      const auto [v, t] = mesh.edge_at(priced.slot);
      const EdgeQuadric<float> edge(mesh.vertices[v], mesh.vertices[t]);
      const float value = edge.value(edge.ux, edge.uy, edge.uz);
      EXPECT_EQ(priced.key,
                value > limit * edge.weight ? kTooExpensive : key_of(edge.price(value)));
    }
  }
}

}  // namespace
}  // namespace manip3d::fast_detail
