#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "geometry/small_solvers.hpp"

namespace manip3d {
namespace {

TEST(SmallSolvers, AxesAreOrderedFromLeastToMost) {
  const Eigen::Matrix3d turn =
      Eigen::AngleAxisd(0.7, Eigen::Vector3d(1.0, 2.0, 3.0).normalized()).toRotationMatrix();
  const Eigen::Vector3d spreads(9.0, 1.0, 4.0);
  const PrincipalAxes axes = principal_axes(turn * spreads.asDiagonal() * turn.transpose());
  EXPECT_NEAR((axes.spreads - Eigen::Vector3d(1.0, 4.0, 9.0)).norm(), 0.0, 1e-12);
  EXPECT_NEAR(std::abs(axes.directions.col(0).dot(turn.col(1))), 1.0, 1e-12);
  EXPECT_NEAR(std::abs(axes.directions.col(1).dot(turn.col(2))), 1.0, 1e-12);
  EXPECT_NEAR(std::abs(axes.directions.col(2).dot(turn.col(0))), 1.0, 1e-12);
}

template <int kSize>
void expect_solved() {
  Eigen::Matrix<double, kSize, kSize> a;
  Eigen::Vector<double, kSize> x;
  for (int i = 0; i < kSize; ++i) {
    x[i] = 1.0 - i;
    for (int j = 0; j < kSize; ++j) a(i, j) = i == j ? 10.0 + i : 1.0 / (1.0 + i + j);
  }
  const Eigen::Vector<double, kSize> b = a * x;
  a.template triangularView<Eigen::StrictlyUpper>().setConstant(1e9);  // must not be read
  EXPECT_NEAR((solve_symmetric(a, b) - x).norm(), 0.0, 1e-12);
}

TEST(SmallSolvers, SolveFromTheLowerTriangle) {
  expect_solved<3>();
  expect_solved<4>();
  expect_solved<6>();
}

}  // namespace
}  // namespace manip3d
