#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "manip3d/error.hpp"
#include "manip3d/geometry/shading.hpp"

namespace manip3d {
namespace {

/// A roof: two squares that meet in the ridge 1-4 (x = 0), each falling by `slope` per unit.
///
///   0---1---2   y = 0
///   | \ | \ |
///   3---4---5   y = 1
TriangleMesh roof(double slope) {
  TriangleMesh mesh;
  mesh.vertices.resize(6, 3);
  mesh.vertices << -1, 0, -slope, 0, 0, 0, 1, 0, -slope,  //
      -1, 1, -slope, 0, 1, 0, 1, 1, -slope;
  mesh.faces.resize(4, 3);
  mesh.faces << 0, 1, 4, 0, 4, 3, 1, 2, 5, 1, 5, 4;
  return mesh;
}

Eigen::Vector3d normal_at(const ShadingNormals& shading, Eigen::Index face, Eigen::Index corner) {
  return shading.normals.row(shading.face_normals(face, corner));
}

TEST(ShadingNormals, JoinFacesWithinTheCreaseAngleOnly) {
  const TriangleMesh mesh = roof(1.0);  // the faces meet at 90 degrees
  const ShadingNormals sharp = shading_normals(mesh, 40.0);
  EXPECT_EQ(sharp.normals.rows(), 2);
  EXPECT_TRUE(normal_at(sharp, 0, 1).isApprox(Eigen::Vector3d(-1, 0, 1).normalized()));
  EXPECT_TRUE(normal_at(sharp, 2, 0).isApprox(Eigen::Vector3d(1, 0, 1).normalized()));
  // Each slope has an angle of 90 degrees at the ridge, in any triangulation.
  const ShadingNormals smooth = shading_normals(mesh, 100.0);
  EXPECT_TRUE(normal_at(smooth, 0, 1).isApprox(Eigen::Vector3d::UnitZ()));
  EXPECT_TRUE(normal_at(smooth, 2, 0).isApprox(Eigen::Vector3d::UnitZ()));
  EXPECT_TRUE(normal_at(smooth, 0, 0).isApprox(Eigen::Vector3d(-1, 0, 1).normalized()));
}

TEST(ShadingNormals, DoNotShowASeam) {
  TriangleMesh whole = roof(0.1);
  TriangleMesh split = whole;  // the ridge's vertices exist once per side, as at a texture seam
  split.vertices.conservativeResize(8, 3);
  split.vertices.row(6) = whole.vertices.row(1);
  split.vertices.row(7) = whole.vertices.row(4);
  split.faces << 0, 1, 4, 0, 4, 3, 6, 2, 5, 6, 5, 7;
  const ShadingNormals a = shading_normals(whole, 40.0);
  const ShadingNormals b = shading_normals(split, 40.0);
  EXPECT_EQ(a.normals, b.normals);
  EXPECT_EQ(a.face_normals, b.face_normals);
  EXPECT_EQ(welded_boundary(split), welded_boundary(whole));
  EXPECT_EQ(welded_boundary(whole).rows(), 6);
}

TEST(ShadingNormals, KeepTheMeshsOwnOnTheSideOfTheFace) {
  TriangleMesh mesh = roof(0.0);
  mesh.normals.resize(3, 3);
  mesh.normals << 0.6, 0, 0.8, -0.6, 0, -0.8, 0, 0, 0;
  mesh.face_normals.resize(4, 3);
  mesh.face_normals << 0, 1, 2, -1, -1, -1, -1, -1, -1, -1, -1, -1;
  const ShadingNormals shading = shading_normals(mesh, 40.0);
  EXPECT_TRUE(normal_at(shading, 0, 0).isApprox(Eigen::Vector3d(0.6, 0, 0.8)));
  EXPECT_TRUE(normal_at(shading, 0, 1).isApprox(Eigen::Vector3d(0.6, 0, 0.8)));  // turned round
  // a normal of zero is ignored
  EXPECT_TRUE(normal_at(shading, 0, 2).isApprox(Eigen::Vector3d::UnitZ()));
  EXPECT_TRUE(normal_at(shading, 1, 0).isApprox(Eigen::Vector3d::UnitZ()));
}

TEST(ShadingNormals, OfFacesStoredTwiceDoNotCancel) {
  TriangleMesh mesh = roof(0.0);
  mesh.faces << 0, 1, 4, 0, 4, 3, 0, 4, 1, 0, 3, 4;  // front and back
  const ShadingNormals shading = shading_normals(mesh, 40.0);
  EXPECT_TRUE(normal_at(shading, 0, 0).isApprox(Eigen::Vector3d::UnitZ()));
  EXPECT_TRUE(normal_at(shading, 2, 0).isApprox(-Eigen::Vector3d::UnitZ()));
}

TEST(ShadingNormals, AreOfUnitLengthWhateverTheFaces) {
  TriangleMesh mesh = roof(0.5);
  mesh.faces << 0, 0, 0, 0, 1, 1, 0, 1, 4, 3, 3, 5;
  for (const double scale : {1.0, 1e-150, 1e150, 0.0}) {
    TriangleMesh scaled = mesh;
    scaled.vertices *= scale;
    const ShadingNormals shading = shading_normals(scaled, 40.0);
    EXPECT_TRUE(shading.normals.rowwise().norm().isOnes(1e-12)) << scale;
    EXPECT_GE(shading.face_normals.minCoeff(), 0);
  }
  EXPECT_EQ(shading_normals(TriangleMesh{}, 40.0).normals.rows(), 0);
  EXPECT_EQ(welded_boundary(TriangleMesh{}).rows(), 0);
}

TEST(ShadingNormals, OfAHubAreTheMeanOfAllFaces) {
  constexpr std::int32_t kRim = 1000;  // a blunt cone
  TriangleMesh mesh;
  mesh.vertices = Vertices::Zero(kRim + 1, 3);
  mesh.faces.resize(kRim, 3);
  for (std::int32_t i = 0; i < kRim; ++i) {
    const double angle = 2.0 * EIGEN_PI * i / kRim;
    mesh.vertices.row(i + 1) << std::cos(angle), std::sin(angle), -0.2;
    mesh.faces.row(i) << 0, i + 1, (i + 1) % kRim + 1;
  }
  const ShadingNormals shading = shading_normals(mesh, 40.0);
  EXPECT_TRUE(normal_at(shading, 17, 0).isApprox(Eigen::Vector3d::UnitZ(), 1e-9));
}

TEST(ShadingNormals, AreTheSameForAnyNumberOfThreads) {
  TriangleMesh mesh;
  mesh.vertices = Vertices::Random(3000, 3);
  mesh.faces = Faces::NullaryExpr(20000, 3, [](Eigen::Index i, Eigen::Index j) {
    return std::int32_t((i * 7 + j * 911) % 3000);
  });
  const ShadingNormals one = shading_normals(mesh, 60.0, 1);
  for (const int threads : {2, 4}) {
    const ShadingNormals many = shading_normals(mesh, 60.0, threads);
    EXPECT_EQ(one.normals, many.normals);
    EXPECT_EQ(one.face_normals, many.face_normals);
  }
}

TEST(ShadingNormals, RefuseACreaseAngleOutOfRange) {
  for (const double angle : {-1.0, 181.0, std::numeric_limits<double>::quiet_NaN()}) {
    EXPECT_THROW(shading_normals(roof(0.0), angle), InputError);
  }
}

}  // namespace
}  // namespace manip3d
