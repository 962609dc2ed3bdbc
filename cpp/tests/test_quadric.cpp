#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <random>

#include "manip3d/simplify/qem.hpp"
#include "simplify/collapse_queue.hpp"
#include "simplify/quadric.hpp"

namespace manip3d {
namespace {

using Eigen::Vector3d;

class QuadricTest : public testing::Test {
 protected:
  double number() { return distribution_(engine_); }
  Vector3d point() { return {number(), number(), number()}; }
  Vector5d point5() {
    Vector5d p;
    p << number(), number(), number(), number(), number();
    return p;
  }

 private:
  std::mt19937 engine_{7};
  std::uniform_real_distribution<double> distribution_{-1.0, 1.0};
};

TEST_F(QuadricTest, IsTheWeightedSquaredDistanceToItsPlanes) {
  for (int repeat = 0; repeat < 100; ++repeat) {
    const Vector3d n1 = point().normalized(), n2 = point().normalized();
    const Vector3d p1 = point(), p2 = point(), x = point();
    Quadric q = Quadric::plane(n1, p1, 0.5);
    q += Quadric::plane(n2, p2, 2.0);
    const double d1 = n1.dot(x - p1), d2 = n2.dot(x - p2);
    EXPECT_NEAR(q(x), 0.5 * d1 * d1 + 2.0 * d2 * d2, 1e-14);
    q *= 3.0;
    EXPECT_NEAR(q(x), 1.5 * d1 * d1 + 6.0 * d2 * d2, 1e-13);
  }
}

/// Squared distance of x to the plane of p, q, r by least squares instead of eq. 2.7.
double squared_distance(const Vector5d& x, const Vector5d& p, const Vector5d& q,
                        const Vector5d& r) {
  Eigen::Matrix<double, 5, 2> span;
  span << q - p, r - p;
  const Eigen::Vector2d s = (span.transpose() * span).inverse() * (span.transpose() * (x - p));
  return (x - p - span * s).squaredNorm();
}

TEST_F(QuadricTest, OfATextureIsTheDistanceToTheTriangleInFiveDimensions) {
  for (int repeat = 0; repeat < 100; ++repeat) {
    const Vector5d p = point5(), q = point5(), r = point5(), x = point5();
    TextureQuadric quadric = TextureQuadric::plane(p, q, r, 0.25);
    quadric += TextureQuadric::plane(q, r, x, 1.0);
    EXPECT_NEAR(quadric(x), 0.25 * squared_distance(x, p, q, r), 1e-10);
  }
}

TEST_F(QuadricTest, OfADegenerateTriangleInTextureSpaceIsTheDistanceToALine) {
  const Vector5d p = point5(), q = point5(), x = point5();
  const Vector5d along = (q - p).normalized();
  const double expected = (x - p - along.dot(x - p) * along).squaredNorm();
  EXPECT_NEAR(TextureQuadric::plane(p, q, p, 1.0)(x), expected, 1e-12);
}

TEST(BoundaryCurvature, HasKnownValues) {
  const auto turning = [](const Vector3d& a, const Vector3d& b, const Vector3d& c) {
    return boundary_curvature(a, b, c, BoundaryCurvature::kTurning, 1.0);
  };
  EXPECT_EQ(turning({0, 0, 0}, {1, 0, 0}, {2, 0, 0}), 0.0);         // straight
  EXPECT_DOUBLE_EQ(turning({1, 0, 0}, {0, 0, 0}, {0, 1, 0}), 0.5);  // right angle
  EXPECT_EQ(turning({1, 0, 0}, {0, 0, 0}, {1, 0, 0}), 10.0);        // there and back
  EXPECT_EQ(turning({1, 0, 0}, {0, 0, 0}, {1, 1e-9, 0}), 10.0);     // clamped
}

TEST(BoundaryCurvature, OfACircleIsAQuarterOfItsCurvatureAsPrinted) {
  // Equation 2.5 uses differences over two steps as r' and over one step as r''.
  const double radius = 0.25, step = 0.01;
  const auto on_circle = [&](double t) {
    return Vector3d(radius * std::cos(t), radius * std::sin(t), 0.0);
  };
  const double k = boundary_curvature(on_circle(-step), on_circle(0), on_circle(step),
                                      BoundaryCurvature::kPaper, 1.0);
  EXPECT_NEAR(k, 0.25 / radius, 1e-3);
}

TEST(BoundaryCurvature, ByTurningDoesNotDependOnUnitPositionOrOrientation) {
  const Vector3d a(0.3, -0.2, 0.9), b(0.1, 0.4, 0.7), c(-0.5, 0.6, 0.2);
  const double k = boundary_curvature(a, b, c, BoundaryCurvature::kTurning, 1.0);
  const Eigen::AngleAxisd turn(1.1, Vector3d(1, 2, 3).normalized());
  const auto move = [&](const Vector3d& p) -> Vector3d {
    return 1000.0 * (turn * p) + Vector3d(5, -7, 9);
  };
  EXPECT_NEAR(boundary_curvature(move(a), move(b), move(c), BoundaryCurvature::kTurning, 42.0), k,
              1e-12);
  EXPECT_NEAR(boundary_curvature(c, b, a, BoundaryCurvature::kTurning, 1.0), k, 1e-15);
  // The printed curvature has the unit 1 / length: it is a thousandth for a mesh a thousand times
  // as large.
  EXPECT_NEAR(boundary_curvature(move(a), move(b), move(c), BoundaryCurvature::kPaper, 1.0),
              boundary_curvature(a, b, c, BoundaryCurvature::kPaper, 1.0) / 1000.0, 1e-12);
}

TEST(CollapseQueue, GivesTheLeastAfterAnyChanges) {
  std::mt19937 engine(3);
  constexpr std::int32_t kVertices = 50;
  std::vector<double> costs(kVertices, -1.0);  // -1: not in the queue
  CollapseQueue queue(kVertices);
  for (int step = 0; step < 5000; ++step) {
    const auto v = static_cast<std::int32_t>(engine() % kVertices);
    if (engine() % 3 == 0) {
      queue.remove(v);
      costs[v] = -1.0;
    } else {
      const double cost = static_cast<double>(engine() % 20);  // many ties
      queue.set({cost, 0.0, v, 0});
      costs[v] = cost;
    }
    double least = std::numeric_limits<double>::infinity();
    std::int32_t first = -1;
    for (std::int32_t w = 0; w < kVertices; ++w) {
      const double cost = costs[w];
      if (cost >= 0.0 && cost < least) {
        least = cost;
        first = w;
      }
    }
    ASSERT_EQ(queue.empty(), first < 0);
    if (first < 0) continue;
    ASSERT_EQ(queue.top().cost, least);
    ASSERT_EQ(queue.top().vertex, first);  // ties go to the lower index
  }
}

}  // namespace
}  // namespace manip3d
