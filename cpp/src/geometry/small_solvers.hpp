#pragma once

#include <Eigen/Core>

/// @file
/// Eigen's decompositions of small matrices, compiled once, because each takes seconds to compile
/// in every file that uses it.
namespace manip3d {

/// The principal axes of points, from the smallest to the largest spread.
struct PrincipalAxes {
  Eigen::Vector3d spreads;     ///< Eigenvalues.
  Eigen::Matrix3d directions;  ///< A unit vector in each column.
};
PrincipalAxes principal_axes(const Eigen::Matrix3d& covariance);

/// Return the solution of A x = b by LDL^T; only the lower triangle of A is read.
Eigen::Vector3d solve_symmetric(const Eigen::Matrix3d& a, const Eigen::Vector3d& b);
Eigen::Vector4d solve_symmetric(const Eigen::Matrix4d& a, const Eigen::Vector4d& b);
Eigen::Vector<double, 6> solve_symmetric(const Eigen::Matrix<double, 6, 6>& a,
                                         const Eigen::Vector<double, 6>& b);

}  // namespace manip3d
