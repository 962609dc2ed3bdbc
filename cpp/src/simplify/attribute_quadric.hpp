#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cmath>

#include "simplify/quadric.hpp"

namespace manip3d {

/// Files store texture coordinates in single precision, which from this value on resolves only a
/// sixty-fourth of the picture. Such faces show no meaningful texture, so theirs is ignored.
constexpr double kFarthestTexture = 131072.0;

/// Weighted sum over faces of the squared difference between an attribute s of N numbers at a
/// point p and the linear continuation of the face's own: sum w |G p + d - s|^2 [Hoppe 1999].
template <int N>
struct AttributeQuadricOf {
  using Value = Eigen::Matrix<double, N, 1>;

  Quadric q;  // of G p + d alone
  double weight = 0.0;
  Eigen::Matrix<double, N, 3> g = Eigen::Matrix<double, N, 3>::Zero();
  Value d = Value::Zero();

  /// The quadric of a triangle with these corners and attributes, times `weight`; zero if it has
  /// no area.
  static AttributeQuadricOf triangle(const std::array<Eigen::Vector3d, 3>& p,
                                     const std::array<Value, 3>& s, double weight) {
    AttributeQuadricOf result;
    const Eigen::Vector3d e1 = p[1] - p[0], e2 = p[2] - p[0];
    const Eigen::Vector3d normal = e1.cross(e2);
    const double squared = normal.squaredNorm();
    if (!(squared > 0.0)) return result;
    // Gradients of the barycentric coordinates of the second and the third corner.
    const Eigen::Vector3d b1 = e2.cross(normal) / squared, b2 = normal.cross(e1) / squared;
    result.weight = weight;
    for (int j = 0; j < N; ++j) {
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

  AttributeQuadricOf& operator+=(const AttributeQuadricOf& o) {
    q += o.q;
    weight += o.weight;
    g += o.g;
    d += o.d;
    return *this;
  }

  /// The s that minimizes the sum at p; the weight must be above zero.
  [[nodiscard]] Value best(const Eigen::Vector3d& p) const { return (g * p + d) / weight; }

  /// The sum at p for that s.
  double operator()(const Eigen::Vector3d& p) const {
    return weight > 0.0 ? q(p) - (g * p + d).squaredNorm() / weight : 0.0;
  }
};
using AttributeQuadric = AttributeQuadricOf<2>;  ///< Texture coordinates.
using ColorQuadric = AttributeQuadricOf<3>;      ///< Colours, 0 to 1.

/// Squared gradient of the colours, summed over the channels and the weights of the faces.
inline double squared_gradient(const ColorQuadric& colors) {
  return colors.q.xx + colors.q.yy + colors.q.zz;
}

/// The quadric of the colours of a triangle. A colour that changes by 1 within less than a
/// thousandth of the diagonal of the mesh, as across a needle, gets a smaller weight.
inline ColorQuadric color_quadric(const std::array<Eigen::Vector3d, 3>& p,
                                  const std::array<Eigen::Vector3d, 3>& colors, double weight,
                                  double diagonal) {
  constexpr double kShortest = 1e-3;
  const double shortest = kShortest * diagonal;
  const ColorQuadric shown = ColorQuadric::triangle(p, colors, weight);
  const double steep = shortest * shortest * squared_gradient(shown);
  return steep > weight ? ColorQuadric::triangle(p, colors, weight * weight / steep) : shown;
}

/// Length on a surface over which its colours typically change by 1, which makes a difference of
/// colours comparable with a distance. It is the inverse of the root mean square gradient, and at
/// most a twentieth of the diagonal: small differences of an almost uniform colour count little.
/// @param squares  Sum of squared_gradient() over the faces, weighted by their areas.
inline double color_length(double squares, double area, double diagonal) {
  constexpr double kLongest = 0.05;
  const double longest = kLongest * diagonal;
  return squares * longest * longest > area ? std::sqrt(area / squares) : longest;
}

/// Minimizes a sum of quadrics.
class LeastSquares {
 public:
  void add(const Quadric& q, double weight) {
    a_(0, 0) += weight * q.xx, a_(1, 0) += weight * q.xy, a_(2, 0) += weight * q.xz;
    a_(1, 1) += weight * q.yy, a_(2, 1) += weight * q.yz, a_(2, 2) += weight * q.zz;
    b_ += weight * Eigen::Vector3d(q.bx, q.by, q.bz);
  }
  template <int N>
  void add(const AttributeQuadricOf<N>& q, double weight) {
    if (!(q.weight > 0.0)) return;
    add(q.q, weight);
    const Eigen::Matrix3d gg = q.g.transpose() * q.g;
    a_ -= (weight / q.weight) * gg;
    b_ -= (weight / q.weight) * (q.g.transpose() * q.d);
  }

  /// Return the point with normal.p = offset that minimizes the sum plus pull |p - point|^2; where
  /// the sum alone leaves the point undetermined, the result is the nearest to `point`. Not finite
  /// if the sum has no minimum.
  ///
  /// @param slack  The pull moves the result off planes in which it should lie. If it moves the
  ///               result by at most this distance, the pull is repeated from the result, which
  ///               reduces the deviation [iterated Tikhonov regularisation]; if by more, the sum is
  ///               too weak to determine the point, and the first result stays. more, the sum is
  ///               weak and the pull is what decides.
  [[nodiscard]] Eigen::Vector3d solve(const Eigen::Vector3d& point, double pull, double slack,
                                      const Eigen::Vector3d& normal, double offset) const {
    const Cholesky factors(a_, pull);
    const Eigen::Vector3d y = factors.solve(normal);
    const double ny = normal.dot(y);
    const auto bound = [&](const Eigen::Vector3d& free) -> Eigen::Vector3d {
      if (!(ny > 0.0)) return free;
      return free + y * ((offset - normal.dot(free)) / ny);
    };
    const Eigen::Vector3d free = factors.solve(pull * point - b_), first = bound(free);
    Eigen::Vector3d best = first;
    for (int i = 1; i < kPulls; ++i) {
      best = bound(free + factors.solve(pull * (best - point)));
      if (!((best - first).squaredNorm() <= slack * slack)) return first;
    }
    return best;
  }

 private:
  /// Largest number of pulls; each divides the deviation due to the pull by about 1e5.
  static constexpr int kPulls = 3;

  /// L L' = a + shift I, of three rows; NaN if that is not positive definite.
  struct Cholesky {
    Cholesky(const Eigen::Matrix3d& a, double shift) {
      r0 = 1.0 / std::sqrt(a(0, 0) + shift);
      l10 = a(1, 0) * r0, l20 = a(2, 0) * r0;
      r1 = 1.0 / std::sqrt(a(1, 1) + shift - l10 * l10);
      l21 = (a(2, 1) - l20 * l10) * r1;
      r2 = 1.0 / std::sqrt(a(2, 2) + shift - l20 * l20 - l21 * l21);
    }
    [[nodiscard]] Eigen::Vector3d solve(const Eigen::Vector3d& b) const {
      const double x = b[0] * r0, y = (b[1] - l10 * x) * r1, z = (b[2] - l20 * x - l21 * y) * r2;
      Eigen::Vector3d result;
      result[2] = z * r2;
      result[1] = (y - l21 * result[2]) * r1;
      result[0] = (x - l10 * result[1] - l20 * result[2]) * r0;
      return result;
    }
    double l10, l20, l21;
    double r0, r1, r2;  // 1 / the diagonal of L
  };

  Eigen::Matrix3d a_ = Eigen::Matrix3d::Zero();  // only the lower triangle is used
  Eigen::Vector3d b_ = Eigen::Vector3d::Zero();
};

}  // namespace manip3d
