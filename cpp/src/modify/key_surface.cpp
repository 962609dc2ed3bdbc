#include "modify/key_surface.hpp"

#include <algorithm>

#include "geometry/small_solvers.hpp"
#include "modify/ray_at.hpp"

namespace manip3d {
namespace {

constexpr std::size_t kMaxSurface = 500;  // points of a key frame; more make the pose no steadier
// Metres, lower limit; the depth steps of a Kinect V1 are 2 cm.
constexpr double kSurfaceNoise = 0.010;
constexpr double kNewKeyTurn = 0.99;  // cosine of half the rotation after which points are renewed
// Points are renewed if less than this share of them agrees with the visible surface.
constexpr double kNewKeyShare = 0.55;
// The trunk twists in the loins. Heights of their lower and upper end, as a share of the way from
// hips to neck.
constexpr double kLowLoins = 0.2, kHighLoins = 0.7;

bool is_on_trunk(std::uint8_t bone) {
  using enum Joint;
  switch (static_cast<Joint>(bone)) {
    case kSpineMid:
    case kSpineShoulder:
    case kShoulderLeft:
    case kShoulderRight:
    case kHipLeft:
    case kHipRight:
      return true;
    default:
      return false;
  }
}

}  // namespace

std::optional<SurfaceResidual> SeenDepth::residual_at(const Eigen::Vector3d& p,
                                                      const Eigen::Vector3d& normal,
                                                      double scale) const {
  const std::int32_t pixel = projector_.pixel(static_cast<float>(p.x()), static_cast<float>(p.y()),
                                              static_cast<float>(p.z()));
  if (pixel < 0) return std::nullopt;
  const float z = depth_->at(pixel);
  if (!(z > 0.0F)) return std::nullopt;
  const Eigen::Vector3d q =
      lift(*rays_, pixel % depth_->cols, pixel / depth_->cols, z).cast<double>();
  const double off = normal.dot(q - p);
  return SurfaceResidual{off, 1.0 + (off * off) / (scale * scale)};
}

std::optional<Eigen::Vector3d> SeenDepth::normal_at(std::int32_t pixel,
                                                    std::span<const std::uint8_t> is_arm) const {
  const DepthView& depth = *depth_;
  const PixelRays& rays = *rays_;
  constexpr double kReach = 0.05;  // metres; large, because one depth step of a Kinect V1 is 2 cm
  constexpr double kSameTrunk = 0.08;  // metres; larger differences of depth are another surface
  constexpr double kMinCosine = 0.3;   // of normal and ray; surfaces at a grazing angle are edges
  const std::int64_t u = pixel % depth.cols, v = pixel / depth.cols;
  if (u < 1 || v < 1 || u + 1 >= depth.cols || v + 1 >= depth.rows) return std::nullopt;
  const double z = depth.at(pixel);
  const Eigen::Vector3d p = lift(rays, u, v, static_cast<float>(z)).cast<double>();
  const double pitch = (lift(rays, u + 1, v, 1.0F) - lift(rays, u - 1, v, 1.0F)).norm() * 0.5 * z;
  if (!(pitch > 1e-5)) return std::nullopt;
  const auto reach = static_cast<std::int64_t>(std::clamp(kReach / pitch, 2.0, 24.0));
  const std::int64_t step = std::max<std::int64_t>(1, reach / 4);
  Eigen::Matrix3d moments = Eigen::Matrix3d::Zero();
  Eigen::Vector3d sums = Eigen::Vector3d::Zero();
  int used = 0, asked = 0, of_arms = 0;
  for (std::int64_t dv = -reach; dv <= reach; dv += step) {
    for (std::int64_t du = -reach; du <= reach; du += step) {
      ++asked;
      if (u + du < 0 || v + dv < 0 || u + du >= depth.cols || v + dv >= depth.rows) continue;
      const auto other = static_cast<std::int32_t>((v + dv) * depth.cols + u + du);
      if (is_arm[other] != 0) {
        ++of_arms;
        continue;
      }
      const float there = depth.at(other);
      if (!(std::abs(there - z) < kSameTrunk) || !has_ray(rays, u + du, v + dv)) continue;
      const Eigen::Vector3d q = lift(rays, u + du, v + dv, there).cast<double>() - p;
      const Eigen::Vector3d row(q.x(), q.y(), 1.0);
      moments += row * row.transpose();
      sums += q.z() * row;
      ++used;
    }
  }
  if (4 * used < 3 * (asked - of_arms) || 2 * used < asked) return std::nullopt;
  const Eigen::Vector3d slope = solve_symmetric(moments, sums);
  const Eigen::Vector3d normal = Eigen::Vector3d(slope.x(), slope.y(), -1.0).normalized();
  if (!(-normal.dot(p) > kMinCosine * p.norm())) return std::nullopt;
  return normal;
}

KeySurface::KeySurface() { points_.reserve(kMaxSurface); }

double KeySurface::noise() const { return std::max(kSurfaceNoise, kSharedNoise * residual_); }

bool KeySurface::is_outdated(const TrunkPose& pose) const {
  const double half_turn = std::abs(pose.rotation.dot(key_rotation_));
  return !(is_known() && share_ > kNewKeyShare && half_turn > kNewKeyTurn);
}

bool KeySurface::renew(const PersonPoints& person, const SeenDepth& seen, const TrunkPose& pose,
                       const Extent& extent, bool is_arm, double pelvis_turn) {
  const Eigen::Quaterniond back = pose.rotation.conjugate();
  const auto place_of = [&](std::size_t i) -> Eigen::Vector3d {
    return back * (Eigen::Vector3d(person.x[i], person.y[i], person.z[i]) - pose.translation);
  };
  const auto is_candidate = [&](std::size_t i) {
    if (!is_on_trunk(person.label[i])) return false;
    const Eigen::Vector3d place = place_of(i);
    return place.y() > extent.low - 0.02 && place.y() < extent.high + 0.02 &&
           std::abs(place.x()) < extent.half;
  };
  const auto num_points = static_cast<std::size_t>(person.count);
  std::size_t count = 0;
  for (std::size_t i = 0; i < num_points; ++i) count += is_candidate(i);
  if (count < kMinSurface) return false;
  const std::size_t stride = std::max<std::size_t>(1, (count + kMaxSurface - 1) / kMaxSurface);
  points_.clear();
  is_arm_.assign(static_cast<std::size_t>(person.rows * person.cols), 0);
  for (std::size_t i = 0; i < num_points; ++i) {
    is_arm_[person.pixel[i]] = is_limb_bone(Limb::kLeftArm, person.label[i]) ||
                                       is_limb_bone(Limb::kRightArm, person.label[i])
                                   ? 1
                                   : 0;
  }
  std::size_t passed = 0;
  for (std::size_t i = 0; i < num_points; ++i) {
    if (!is_candidate(i) || passed++ % stride != 0) continue;
    const auto normal = seen.normal_at(person.pixel[i], is_arm_);
    if (!normal || points_.size() == kMaxSurface) continue;
    const Eigen::Vector3d place = place_of(i);
    const double loins = (place.y() - extent.low) / std::max(extent.high - extent.low, 0.1);
    const double chest = std::clamp((loins - kLowLoins) / (kHighLoins - kLowLoins), 0.0, 1.0);
    const double share = is_arm ? 0.0 : 1.0 - chest;
    const double turn = share * pelvis_turn;
    points_.push_back({about_spine(place, -turn), about_spine(back * *normal, -turn), share});
  }
  key_rotation_ = pose.rotation;
  return true;
}

void KeySurface::learn(const Agreement& agreed) {
  share_ = points_.empty()
               ? 0.0
               : static_cast<double>(agreed.points) / static_cast<double>(points_.size());
  if (agreed.points < kMinSurface) return;
  constexpr double kMemory = 0.9;  // weight of the previous mean
  residual_ =
      kMemory * residual_ + (1.0 - kMemory) * agreed.off / static_cast<double>(agreed.points);
}

void KeySurface::reset() {
  points_.clear();
  residual_ = share_ = 0.0;
}

}  // namespace manip3d
