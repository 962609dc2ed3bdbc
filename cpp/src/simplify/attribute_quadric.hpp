#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <array>

#include "simplify/quadric.hpp"

namespace manip3d {

/// Files hold texture coordinates in single precision, whose steps are a sixty-fourth of the
/// picture from here on: such faces show no texture but the rubbish of an exporter, and none is
/// kept.
constexpr double kFarthestTexture = 131072.0;

/// Weighted sum over faces of the squared difference between a texture coordinate s at a point p
/// and the face's own, continued linearly: sum w |G p + d - s|^2 [Hoppe 1999].
struct AttributeQuadric {
  Quadric q;  // of G p + d alone
  double weight = 0.0;
  Eigen::Matrix<double, 2, 3> g = Eigen::Matrix<double, 2, 3>::Zero();
  Eigen::Vector2d d = Eigen::Vector2d::Zero();

  /// weight times the triangle with these corners and texture coordinates; zero without area.
  static AttributeQuadric triangle(const std::array<Eigen::Vector3d, 3>& p,
                                   const std::array<Eigen::Vector2d, 3>& s, double weight) {
    AttributeQuadric result;
    const Eigen::Vector3d e1 = p[1] - p[0], e2 = p[2] - p[0];
    const Eigen::Vector3d normal = e1.cross(e2);
    const double squared = normal.squaredNorm();
    if (!(squared > 0.0)) return result;
    // Gradients of the barycentric coordinates of the second and the third corner.
    const Eigen::Vector3d b1 = e2.cross(normal) / squared, b2 = normal.cross(e1) / squared;
    result.weight = weight;
    for (int j = 0; j < 2; ++j) {
      const Eigen::Vector3d g = (s[1][j] - s[0][j]) * b1 + (s[2][j] - s[0][j]) * b2;
      const double d = s[0][j] - g.dot(p[0]);
      const Eigen::Vector3d wg = weight * g;
      result.q +=
          Quadric{wg.x() * g.x(), wg.x() * g.y(), wg.x() * g.z(), wg.y() * g.y(), wg.y() * g.z(),
                  wg.z() * g.z(), wg.x() * d,     wg.y() * d,     wg.z() * d,     weight * d * d};
      result.g.row(j) = wg.transpose();
      result.d[j] = weight * d;
    }
    return result;
  }

  AttributeQuadric& operator+=(const AttributeQuadric& o) {
    q += o.q;
    weight += o.weight;
    g += o.g;
    d += o.d;
    return *this;
  }

  /// The s for which the sum is least at p; only with a weight above zero.
  [[nodiscard]] Eigen::Vector2d best(const Eigen::Vector3d& p) const {
    return (g * p + d) / weight;
  }

  /// The sum at p with that s.
  double operator()(const Eigen::Vector3d& p) const {
    return weight > 0.0 ? q(p) - (g * p + d).squaredNorm() / weight : 0.0;
  }
};

/// Sum of quadrics, and where it is least.
class LeastSquares {
 public:
  void add(const Quadric& q, double weight) {
    a_(0, 0) += weight * q.xx, a_(1, 0) += weight * q.xy, a_(2, 0) += weight * q.xz;
    a_(1, 1) += weight * q.yy, a_(2, 1) += weight * q.yz, a_(2, 2) += weight * q.zz;
    b_ += weight * Eigen::Vector3d(q.bx, q.by, q.bz);
  }
  void add(const AttributeQuadric& q, double weight) {
    if (!(q.weight > 0.0)) return;
    add(q.q, weight);
    const Eigen::Matrix3d gg = q.g.transpose() * q.g;
    a_ -= (weight / q.weight) * gg;
    b_ -= (weight / q.weight) * (q.g.transpose() * q.d);
  }
  /// weight times the squared distance to a point.
  void add(const Eigen::Vector3d& point, double weight) {
    a_.diagonal().array() += weight;
    b_ -= weight * point;
  }

  /// The best point with normal.p = offset; not finite when the sum has no minimum.
  [[nodiscard]] Eigen::Vector3d solve(const Eigen::Vector3d& normal, double offset) const {
    const auto factors = a_.selfadjointView<Eigen::Lower>().llt();
    const Eigen::Vector3d x = factors.solve(-b_), y = factors.solve(normal);
    const double ny = normal.dot(y);
    return ny > 0.0 ? Eigen::Vector3d(x + y * ((offset - normal.dot(x)) / ny)) : x;
  }

 private:
  Eigen::Matrix3d a_ = Eigen::Matrix3d::Zero();  // the lower triangle counts
  Eigen::Vector3d b_ = Eigen::Vector3d::Zero();
};

}  // namespace manip3d
