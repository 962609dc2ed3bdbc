#pragma once

#include <Eigen/Core>

namespace manip3d {

/// Weighted sum of squared distances to planes: Q(x) = x'Ax + 2b'x + c (eq. 2.3).
struct Quadric {
  double xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;  // A
  double bx = 0, by = 0, bz = 0;
  double c = 0;

  /// weight times the plane through `point` with the unit normal `n` (eq. 2.2).
  static Quadric plane(const Eigen::Vector3d& n, const Eigen::Vector3d& point, double weight) {
    const double d = -n.dot(point);
    const Eigen::Vector3d wn = weight * n;
    return {wn.x() * n.x(), wn.x() * n.y(), wn.x() * n.z(), wn.y() * n.y(), wn.y() * n.z(),
            wn.z() * n.z(), wn.x() * d,     wn.y() * d,     wn.z() * d,     weight * d * d};
  }

  Quadric& operator+=(const Quadric& q) {
    xx += q.xx, xy += q.xy, xz += q.xz, yy += q.yy, yz += q.yz, zz += q.zz;
    bx += q.bx, by += q.by, bz += q.bz, c += q.c;
    return *this;
  }

  Quadric& operator*=(double s) {
    xx *= s, xy *= s, xz *= s, yy *= s, yz *= s, zz *= s;
    bx *= s, by *= s, bz *= s, c *= s;
    return *this;
  }

  double operator()(const Eigen::Vector3d& p) const {
    const double x = p.x(), y = p.y(), z = p.z();
    return x * (xx * x + 2.0 * (xy * y + xz * z + bx)) + y * (yy * y + 2.0 * (yz * z + by)) +
           z * (zz * z + 2.0 * bz) + c;
  }
};

/// Position and texture coordinate of a wedge: (x, y, z, u, v).
using Vector5d = Eigen::Matrix<double, 5, 1>;

/// Squared distance to the plane of a triangle in (x, y, z, u, v) [Garland & Heckbert 1998].
struct TextureQuadric {
  Eigen::Matrix<double, 5, 5> A = Eigen::Matrix<double, 5, 5>::Zero();
  Vector5d b = Vector5d::Zero();
  double c = 0;

  /// `weight` times the plane spanned by the triangle p, q, r (eq. 2.7). For a degenerate triangle,
  /// the distance is that to a line or a point.
  static TextureQuadric plane(const Vector5d& p, const Vector5d& q, const Vector5d& r,
                              double weight) {
    const auto unit = [](const Vector5d& x) -> Vector5d {
      const double length = x.norm();
      return length > 0.0 ? Vector5d(x / length) : Vector5d(Vector5d::Zero());
    };
    const Vector5d e1 = unit(q - p);
    const Vector5d e2 = unit(r - p - e1.dot(r - p) * e1);
    TextureQuadric t;
    t.A = weight *
          (Eigen::Matrix<double, 5, 5>::Identity() - e1 * e1.transpose() - e2 * e2.transpose());
    t.b = weight * (p.dot(e1) * e1 + p.dot(e2) * e2 - p);
    t.c = weight * (p.dot(p) - p.dot(e1) * p.dot(e1) - p.dot(e2) * p.dot(e2));
    return t;
  }

  TextureQuadric& operator+=(const TextureQuadric& q) {
    A += q.A;
    b += q.b;
    c += q.c;
    return *this;
  }

  double operator()(const Vector5d& x) const { return x.dot(A * x) + 2.0 * b.dot(x) + c; }
};

}  // namespace manip3d
