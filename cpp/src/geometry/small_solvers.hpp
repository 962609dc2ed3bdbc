#pragma once

#include <Eigen/Core>

/// @file
/// Eigen's decompositions, compiled once, because each takes seconds to compile in every file that
/// uses it.
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

/// Return the inverse of A by LDL^T; only the lower triangle of A is read.
Eigen::Matrix<double, 6, 6> invert_symmetric(const Eigen::Matrix<double, 6, 6>& a);

struct LeastSquaresFit {
  Eigen::VectorXd solution;
  Eigen::Index rank;  ///< Below the number of columns, other solutions are as good.
};
/// The x with the smallest |A x - b|, by QR with column pivoting.
/// @param precision  Pivots below this share of the largest count as 0.
LeastSquaresFit least_squares(const Eigen::MatrixXd& a, const Eigen::VectorXd& b, double precision);

}  // namespace manip3d
