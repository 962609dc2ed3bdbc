#include <gtest/gtest.h>

#include "manip3d/geometry/compact.hpp"
#include "manip3d/geometry/topology.hpp"
#include "manip3d/geometry/weld.hpp"

namespace manip3d {
namespace {

Faces make_faces(std::initializer_list<std::initializer_list<std::int32_t>> rows) {
  return Faces(rows);
}

TEST(Edges, AreSortedAndKnowTheirFaces) {
  // Three triangles with the edge 1-2, and one with a repeated index.
  const Faces faces = make_faces({{2, 1, 0}, {1, 2, 3}, {4, 1, 2}, {0, 0, 4}});
  const Edges edges = find_edges(faces, 5);
  Rows<std::int32_t, 2> expected(7, 2);
  expected << 0, 1, 0, 2, 1, 2, 1, 3, 1, 4, 2, 3, 2, 4;
  ASSERT_EQ(edges.vertices, expected);
  const auto shared = edges.faces_of(2);
  EXPECT_EQ(std::vector<std::int32_t>(shared.begin(), shared.end()),
            (std::vector<std::int32_t>{0, 1, 2}));
  EXPECT_TRUE(edges.is_non_manifold(2));
  EXPECT_TRUE(edges.is_boundary(0));
  EXPECT_EQ(count_boundary_neighbors(edges, 5), (Indices(5) << 2, 3, 3, 2, 2).finished());
}

TEST(Edges, OfNothingAreNone) {
  EXPECT_EQ(find_edges(Faces(0, 3), 0).size(), 0);
  EXPECT_EQ(find_edges(Faces(0, 3), 3).size(), 0);
  EXPECT_EQ(find_components(Faces(0, 3), 3).count, 0);
}

TEST(Components, AreNumberedByTheirLowestVertex) {
  const Components components = find_components(make_faces({{5, 6, 3}, {1, 4, 2}}), 8);
  EXPECT_EQ(components.count, 2);
  EXPECT_EQ(components.of_vertex, (Indices(8) << -1, 0, 0, 1, 0, 1, 1, -1).finished());
}

TEST(Weld, NumbersValuesByTheirFirstRows) {
  Texcoords table(5, 2);
  table << 3, 0, 1, 0, 3, -0.0, 0, 0, 1, 0;
  const Weld weld = weld_rows<2>(table);
  EXPECT_EQ(weld.value, (Indices(5) << 0, 1, 0, 2, 1).finished());
  EXPECT_EQ(weld.first_row, (Indices(3) << 0, 1, 3).finished());
  EXPECT_EQ(weld_indices(make_faces({{4, -1, 3}}), weld), make_faces({{1, -1, 2}}));
}

TEST(RemoveUnreferenced, KeepsTheOrderOfWhatStays) {
  TriangleMesh mesh;
  mesh.vertices = Vertices::Random(5, 3);
  mesh.colors = Colors::Constant(5, 3, 7);
  mesh.faces = make_faces({{4, 1, 2}});
  mesh.texcoords = Texcoords::Random(3, 2);
  mesh.face_texcoords = make_faces({{2, -1, 2}});
  const TriangleMesh before = mesh;
  EXPECT_EQ(remove_unreferenced(mesh), (Indices(5) << -1, 0, 1, -1, 2).finished());
  EXPECT_EQ(mesh.faces, make_faces({{2, 0, 1}}));
  EXPECT_EQ(mesh.vertices.row(2), before.vertices.row(4));
  EXPECT_EQ(mesh.colors.rows(), 3);
  EXPECT_EQ(mesh.face_texcoords, make_faces({{0, -1, 0}}));
  EXPECT_EQ(mesh.texcoords.row(0), before.texcoords.row(2));
}

}  // namespace
}  // namespace manip3d
