#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <limits>
#include <random>

#include "manip3d/error.hpp"
#include "manip3d/geometry/bvh.hpp"

namespace manip3d {
namespace {

// Triangles with corners on a small grid, so that there are many degenerate faces, duplicates and
// ties.
TriangleMesh triangle_soup(int num_faces, unsigned seed) {
  std::mt19937 random(seed);
  TriangleMesh mesh;
  mesh.vertices.resize(60, 3);
  for (double& x : mesh.vertices.reshaped()) x = static_cast<double>(random() % 9);
  mesh.faces.resize(num_faces, 3);
  for (std::int32_t& v : mesh.faces.reshaped()) v = static_cast<std::int32_t>(random() % 60);
  return mesh;
}

TEST(TriangleBvh, AnswersDoNotDependOnTheTreeOrTheHint) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  for (unsigned seed = 0; seed < 20; ++seed) {
    const TriangleMesh mesh = triangle_soup(200, seed);
    const TriangleBvh bvh(mesh);
    std::vector<SurfacePoint> all;
    std::vector<SurfacePoint> near;
    std::mt19937 random(seed);
    for (int i = 0; i < 50; ++i) {
      const Eigen::Vector3d query(random() % 17 * 0.5, random() % 17 * 0.5, random() % 17 * 0.5);
      bvh.faces_within(query, kInfinity, all);
      ASSERT_EQ(all.size(), 200U);
      const auto& lowest = *std::min_element(
          all.begin(), all.end(), [](auto& a, auto& b) { return a.distance < b.distance; });
      const std::int32_t face = bvh.closest_point(query).face;
      EXPECT_EQ(all[face].distance, lowest.distance);
      EXPECT_EQ(bvh.closest_point(query, 57).face, face);
      EXPECT_EQ(bvh.closest_point(query, 199).face, face);
      bvh.faces_within(query, 1.25, near);
      std::erase_if(all, [](const SurfacePoint& p) { return p.distance > 1.25; });
      ASSERT_EQ(near.size(), all.size());
      for (std::size_t k = 0; k < near.size(); ++k) EXPECT_EQ(near[k].face, all[k].face);
    }
  }
}

TEST(TriangleBvh, RaysHitWhatAllFacesTellOneByOne) {
  std::mt19937 random(4);
  std::uniform_real_distribution<double> uniform(-1.0, 9.0), turn(-1.0, 1.0);
  int num_hits = 0;
  for (unsigned seed = 0; seed < 20; ++seed) {
    const TriangleMesh mesh = triangle_soup(30, seed);
    const TriangleBvh bvh(mesh);
    const auto is_odd = [](std::int32_t face) { return face % 2 == 1; };
    for (int i = 0; i < 200; ++i) {
      const Eigen::Vector3d from(uniform(random), uniform(random), uniform(random));
      const Eigen::Vector3d ray(turn(random), turn(random), turn(random));
      bool is_hit = false;
      for (Eigen::Index f = 1; f < mesh.faces.rows(); f += 2) {
        Eigen::Matrix3d system;  // from + t ray = a + b (second - a) + c (third - a)
        const Eigen::RowVector3d a = mesh.vertices.row(mesh.faces(f, 0));
        system.col(0) = -ray;
        system.col(1) = (mesh.vertices.row(mesh.faces(f, 1)) - a).transpose();
        system.col(2) = (mesh.vertices.row(mesh.faces(f, 2)) - a).transpose();
        if (system.col(1).cross(system.col(2)).norm() == 0.0) continue;
        const Eigen::Vector3d at = system.fullPivLu().solve(from - a.transpose());
        is_hit = is_hit || (at.minCoeff() >= 0.0 && at[1] + at[2] <= 1.0);
      }
      EXPECT_EQ(bvh.is_hit_where(from, ray, is_odd), is_hit);
      num_hits += is_hit ? 1 : 0;
    }
  }
  EXPECT_GT(num_hits, 500);
  EXPECT_LT(num_hits, 3500);
}

TEST(TriangleBvh, RefusesRaysAlongAnAxis) {
  const TriangleMesh mesh = triangle_soup(30, 1);
  const TriangleBvh bvh(mesh);
  const auto any = [](std::int32_t) { return true; };
  EXPECT_THROW((void)bvh.is_hit_where({0, 0, 0}, {1, 0, 0}, any), InputError);
  EXPECT_THROW((void)bvh.is_hit_where({0, 0, NAN}, {1, 1, 1}, any), InputError);
}

TEST(TriangleBvh, BarycentricWeightsGiveThePoint) {
  const TriangleMesh mesh = triangle_soup(200, 1);
  const TriangleBvh bvh(mesh);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(-1.0, 9.0);
  for (int i = 0; i < 500; ++i) {
    const Eigen::Vector3d query(uniform(random), uniform(random), uniform(random));
    const SurfacePoint nearest = bvh.closest_point(query);
    EXPECT_GE(nearest.barycentric.minCoeff(), 0.0);
    EXPECT_NEAR(nearest.barycentric.sum(), 1.0, 1e-15);
    Eigen::Vector3d point = Eigen::Vector3d::Zero();
    for (int k = 0; k < 3; ++k) {
      point += nearest.barycentric[k] * mesh.vertices.row(mesh.faces(nearest.face, k));
    }
    EXPECT_LT((point - nearest.point).norm(), 1e-13);
    EXPECT_NEAR((query - nearest.point).norm(), nearest.distance, 1e-13);
  }
}

TEST(TriangleBvh, BuildsOnAnySpacingOfTriangles) {
  // Coordinates from 1 down to 2^-1000: each split by surface area would separate only a few
  // triangles.
  TriangleMesh mesh;
  mesh.vertices.setZero(3000, 3);
  mesh.faces.resize(1000, 3);
  for (int f = 0; f < 1000; ++f) {
    for (int k = 0; k < 3; ++k) mesh.vertices.row(3 * f + k).setConstant(std::ldexp(1.0, -f));
    mesh.vertices(3 * f, 0) *= 1.5;
    mesh.faces.row(f) << 3 * f, 3 * f + 1, 3 * f + 2;
  }
  const TriangleBvh bvh(mesh);
  for (int f = 0; f < 1000; f += 50) {
    EXPECT_EQ(bvh.closest_point(mesh.vertices.row(3 * f)).distance, 0.0);
  }
}

TEST(TriangleBvh, RefusesBadInput) {
  TriangleMesh mesh = triangle_soup(3, 0);
  const TriangleBvh bvh(mesh);
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(static_cast<void>(bvh.closest_point({kNan, 0, 0})), InputError);
  EXPECT_THROW(static_cast<void>(bvh.closest_point({1e200, 0, 0})), InputError);
  EXPECT_NO_THROW(static_cast<void>(bvh.closest_point({1e100, 0, 0})));
  mesh.faces.resize(0, 3);
  EXPECT_THROW(TriangleBvh{mesh}, InputError);
}

}  // namespace
}  // namespace manip3d
