#include "geometry/small_solvers.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/QR>

namespace manip3d {

PrincipalAxes principal_axes(const Eigen::Matrix3d& covariance) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
  return {solver.eigenvalues(), solver.eigenvectors()};
}

Eigen::Vector3d solve_symmetric(const Eigen::Matrix3d& a, const Eigen::Vector3d& b) {
  return a.ldlt().solve(b);
}

Eigen::Vector4d solve_symmetric(const Eigen::Matrix4d& a, const Eigen::Vector4d& b) {
  return a.ldlt().solve(b);
}

Eigen::Vector<double, 6> solve_symmetric(const Eigen::Matrix<double, 6, 6>& a,
                                         const Eigen::Vector<double, 6>& b) {
  return a.ldlt().solve(b);
}

Eigen::Matrix<double, 6, 6> invert_symmetric(const Eigen::Matrix<double, 6, 6>& a) {
  return a.ldlt().solve(Eigen::Matrix<double, 6, 6>::Identity());
}

LeastSquaresFit least_squares(const Eigen::MatrixXd& a, const Eigen::VectorXd& b,
                              double precision) {
  Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(a.rows(), a.cols());
  qr.setThreshold(precision);
  qr.compute(a);
  return {qr.solve(b), qr.rank()};
}

}  // namespace manip3d
