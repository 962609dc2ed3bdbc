#pragma once

#include <Eigen/Core>

/// @file
/// Eigen's decompositions of small matrices for those files that share them: each takes seconds to
/// compile wherever it stands.
namespace manip3d {

/// The axes along which points spread, from least to most.
struct PrincipalAxes {
  Eigen::Vector3d spreads;     ///< Eigenvalues.
  Eigen::Matrix3d directions;  ///< A unit vector in each column.
};
PrincipalAxes principal_axes(const Eigen::Matrix3d& covariance);

/// x of A x = b by LDL^T; only the lower triangle of A is read.
Eigen::Vector3d solve_symmetric(const Eigen::Matrix3d& a, const Eigen::Vector3d& b);
Eigen::Vector4d solve_symmetric(const Eigen::Matrix4d& a, const Eigen::Vector4d& b);
Eigen::Vector<double, 6> solve_symmetric(const Eigen::Matrix<double, 6, 6>& a,
                                         const Eigen::Vector<double, 6>& b);

}  // namespace manip3d
