#include "manip3d/geometry/exact.hpp"

#include <Eigen/Geometry>
#include <array>
#include <cmath>

namespace manip3d {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

/// An exact sum of doubles: components that do not overlap, smallest first.
class ExactSum {
 public:
  void add(double value) {
    int kept = 0;
    for (int i = 0; i < size_; ++i) {
      const double sum = parts_[i] + value;
      const double from_value = sum - parts_[i];
      const double error = (parts_[i] - (sum - from_value)) + (value - from_value);
      if (error != 0.0) parts_[kept++] = error;
      value = sum;
    }
    if (value != 0.0) parts_[kept++] = value;
    size_ = kept;
  }
  void add_product(double a, double b) {
    const double product = a * b;
    add(product);
    add(std::fma(a, b, -product));
  }
  void add_product(double a, double b, double c) {
    const double product = a * b;
    add_product(product, c);
    add_product(std::fma(a, b, -product), c);
  }
  [[nodiscard]] int sign() const {
    if (size_ == 0) return 0;
    return parts_[size_ - 1] > 0.0 ? 1 : -1;
  }

 private:
  std::array<double, 97> parts_;  // 24 products of three factors give 96
  int size_ = 0;
};

/// Adds sign times the determinant with rows a, b, c.
void add_determinant(ExactSum& sum, double sign, const Vector3d& a, const Vector3d& b,
                     const Vector3d& c) {
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    sum.add_product(sign * a[i], b[j], c[k]);
    sum.add_product(-sign * a[i], b[k], c[j]);
  }
}

}  // namespace

bool is_exact(const Vector3d& point) {
  const auto magnitude = point.array().abs();
  return ((magnitude == 0.0) || (magnitude > 1e-90 && magnitude < 1e90)).all();
}

int orientation(const Vector2d& a, const Vector2d& b, const Vector2d& c) {
  ExactSum sum;
  const auto add_cross = [&](const Vector2d& p, const Vector2d& q) {
    sum.add_product(p.x(), q.y());
    sum.add_product(-p.y(), q.x());
  };
  add_cross(a, b);
  add_cross(b, c);
  add_cross(c, a);
  return sum.sign();
}

bool are_collinear(const Vector3d& a, const Vector3d& b, const Vector3d& c) {
  for (int i = 0; i < 3; ++i) {
    const auto along = [i](const Vector3d& p) { return Vector2d(p[i], p[(i + 1) % 3]); };
    if (orientation(along(a), along(b), along(c)) != 0) return false;
  }
  return true;
}

bool are_coplanar(const Vector3d& a, const Vector3d& b, const Vector3d& c, const Vector3d& d) {
  // If the rounded volume exceeds its error bound, it decides. Each product of three differences is
  // at most size.prod(), there are six, and each has less than ten roundings of 1.2e-16.
  const Vector3d ad = a - d, bd = b - d, cd = c - d;
  const Eigen::Array3d size = ad.array().abs().max(bd.array().abs()).max(cd.array().abs());
  const double volume = ad.dot(bd.cross(cd));
  if (std::abs(volume) > 1e-14 * 6.0 * size.prod()) return false;
  // The volume of the tetrahedron as four determinants of the points themselves, because the
  // differences above are rounded.
  ExactSum sum;
  add_determinant(sum, 1.0, a, b, c);
  add_determinant(sum, -1.0, a, b, d);
  add_determinant(sum, 1.0, a, c, d);
  add_determinant(sum, -1.0, b, c, d);
  return sum.sign() == 0;
}

}  // namespace manip3d
