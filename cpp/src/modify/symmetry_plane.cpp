#include "modify/symmetry_plane.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cstddef>

#include "geometry/small_solvers.hpp"

namespace manip3d {
namespace {

constexpr double kMaxPlanes = 45.0;   // frames over which the plane is averaged
constexpr double kFirstPlanes = 5.0;  // frames
constexpr double kNoise = 0.02;       // metres; difference between left and right of a clothed body
// Standard deviation of the trunk's offset from its joints, as a share of the offset of the limbs.
constexpr double kUnknownOffset = 0.5;

}  // namespace

// The plane has the normal n and the point o; s = n (p - o), and the mirror image p' = p - 2 s n
// has the normal m'. A turn of n by a y + b z and a shift of o by c n move p' by -2 (a y (p - o) +
// b z (p - o) - c) n - 2 s (a y + b z).
void SymmetryPlane::measure(const Prior& prior, const KeySurface& surface, const TrunkPose& pose,
                            double pelvis_turn, const SeenDepth& seen) {
  const BodyFrame& axes = prior.axes;
  if (!surface.is_known()) {
    covariance_ = Eigen::Matrix3d(prior.variance.asDiagonal());
    return;
  }
  const Eigen::Matrix3d rotation = pose.rotation.toRotationMatrix();
  // If the plane were fixed at joints beside the points, it would turn to fit the surface; the
  // offset is therefore a free parameter with this variance.
  Eigen::Vector3d variance = prior.variance;
  variance[2] += kUnknownOffset * kUnknownOffset * prior.aside * prior.aside;
  const Eigen::Vector3d information_of_joints = variance.cwiseInverse();
  Eigen::Vector3d moved = Eigen::Vector3d::Zero();
  std::size_t agreed = 0;
  const Eigen::Vector3d origin = axes.origin + prior.aside * axes.n;
  Eigen::Vector3d n = axes.n, o = origin;
  Eigen::Matrix3d of_surface;  // information of the surface alone
  // The first frames use wider scales, because the plane of the joints may be far off; later ones
  // start near the mean.
  const int wider = frames_ < kFirstPlanes ? 4 : 0;
  for (int iteration = -wider; iteration < 2; ++iteration) {
    const double scale = kSurfaceScale * (iteration < 0 ? 1.0 - 0.5 * iteration : 1.0);
    of_surface.setZero();
    Eigen::Vector3d gradient = -information_of_joints.cwiseProduct(moved);
    agreed = 0;
    for (const KeySurface::Point& point : surface.points()) {
      const Eigen::Vector3d from = rotation * point.place + pose.translation - o;
      const double s = n.dot(from);
      const Eigen::Vector3d turned = rotation * point.normal;
      Eigen::Vector3d p = from + o - 2.0 * s * n, normal = turned - 2.0 * n.dot(turned) * n;
      // The key frame is not twisted: its points are mirrored in the untwisted trunk, then twisted.
      if (const double turn = point.share * pelvis_turn; turn != 0.0) {
        const Eigen::Matrix3d back = rotation.transpose();
        p = rotation * about_spine(back * (p - pose.translation), turn) + pose.translation;
        normal = rotation * about_spine(back * normal, turn);
      }
      // Cosine of the angle between normal and ray; the camera sees only surfaces above it.
      constexpr double kMinCosine = 0.3;
      if (!(-normal.dot(p) > kMinCosine * p.norm())) continue;
      const auto found = seen.residual_at(p, normal, scale);
      if (!found) continue;
      if (found->agrees()) ++agreed;
      const double weight = found->weight(kNoise);
      const double across = -2.0 * normal.dot(n);
      const Eigen::Vector3d row(across * axes.y.dot(from) - 2.0 * s * normal.dot(axes.y),
                                across * axes.z.dot(from) - 2.0 * s * normal.dot(axes.z), -across);
      of_surface += weight * row * row.transpose();
      gradient += weight * found->off * row;
    }
    const Eigen::Matrix3d information =
        of_surface + Eigen::Matrix3d(information_of_joints.asDiagonal());
    moved += solve_symmetric(information, gradient);
    n = (axes.n + moved[0] * axes.y + moved[1] * axes.z).normalized();
    o = origin + moved[2] * axes.n;
  }
  Eigen::Matrix3d known = information_of_joints.asDiagonal();
  if (agreed >= kMinSurface) known += of_surface / (kSharedNoise * kSharedNoise);
  covariance_ = known.inverse();
  if (agreed < kMinSurface) return;
  frames_ = std::min(frames_ + 1.0, kMaxPlanes);
  const double gain = 1.0 / frames_;
  normal_ += gain * (pose.rotation.conjugate() * n - normal_);
  offset_ += gain * (n.dot(o - pose.translation) - offset_);
}

BodyFrame SymmetryPlane::move(const BodyFrame& axes, const TrunkPose& pose) const {
  if (!is_measured()) return axes;
  BodyFrame frame = axes;
  const Eigen::Vector3d n = (pose.rotation * normal_).normalized();
  frame.origin += (offset_ - n.dot(frame.origin - pose.translation)) * n;
  frame.n = frame.x = n;
  frame.y = (frame.y - frame.y.dot(n) * n).normalized();
  frame.z = n.cross(frame.y);
  return frame;
}

}  // namespace manip3d
