#include <gtest/gtest.h>

#include <cstdint>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "simplify/rounding_weld.hpp"

namespace manip3d {
namespace {

/// Corners of triangles, each of which has vertices of its own.
struct Triangles {
  std::vector<Eigen::RowVector3d> corners;
  void add(const Eigen::RowVector3d& a, const Eigen::RowVector3d& b, const Eigen::RowVector3d& c) {
    corners.insert(corners.end(), {a, b, c});
  }
};

/// Whether the first two corners were welded.
bool is_welded(const Triangles& triangles) {
  TriangleMesh mesh;
  mesh.vertices.resize(static_cast<Eigen::Index>(triangles.corners.size()), 3);
  mesh.faces.resize(mesh.vertices.rows() / 3, 3);
  for (Eigen::Index i = 0; i < mesh.vertices.rows(); ++i) {
    mesh.vertices.row(i) = triangles.corners[static_cast<std::size_t>(i)];
    mesh.faces(i / 3, i % 3) = static_cast<std::int32_t>(i);
  }
  const MeshView view(mesh);
  const RoundingWeld weld(view, {});
  return weld.any() && weld.mesh().faces(0, 0) == weld.mesh().faces(0, 1);
}

// A tiny triangle at the common corner of two large ones:
//   a--b   edges of 1e-7; its own vertices have no long edge, those of the large triangles at the
//    \/    same positions have.
TEST(RoundingWeld, TheReachOfAVertexIsThatOfAllAtItsPosition) {
  const Eigen::RowVector3d a(0.0, 0.0, 0.0), b(1e-7, 0.0, 0.0), c(0.0, 1e-7, 0.0);
  Triangles mesh;
  mesh.add(a, b, c);
  mesh.add(a, {1.0, 0.0, 0.0}, {0.0, 1.0, 0.0});
  mesh.add(b, {1.0, 0.0, 0.0}, {0.0, -1.0, 0.0});
  EXPECT_TRUE(is_welded(mesh));
  // Another short edge, of a large triangle elsewhere, must change nothing.
  mesh.add({5.0, 5.0, 0.0}, {5.0 + 1e-7, 5.0, 0.0}, {5.0, 6.0, 0.0});
  EXPECT_TRUE(is_welded(mesh));
}

TEST(RoundingWeld, SmallPartsStay) {
  Triangles mesh;
  mesh.add({0.0, 0.0, 0.0}, {1e-7, 0.0, 0.0}, {0.0, 1e-7, 0.0});
  mesh.add({1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {1.0, 1.0, 0.0});
  EXPECT_FALSE(is_welded(mesh));
}

}  // namespace
}  // namespace manip3d
