#include "modify/leg_turn.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {
namespace {

constexpr double kWindow = 90.0;        // frames of the means
constexpr double kErrorGain = 0.1;      // of the means' errors: a third of a second
constexpr double kLeastError = 0.0001;  // squared sine: half a degree
constexpr double kUnsure = 0.06;        // radians: of what trunk and legs err by
constexpr std::size_t kNumParts = 2;    // thigh and shin: feet are short and half hidden

/// The direction made square to the spine.
Eigen::Vector3d upright(const Eigen::Vector3d& direction, const BodyFrame& trunk) {
  return (direction - direction.dot(trunk.y) * trunk.y).normalized();
}

/// The points of a leg's parts.
struct Part {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double count = 0.0;
};
using Parts = std::array<Part, kNumParts>;

/// Gives each point of the leg to the nearest part between two of its joints.
Parts parts_of(const PersonPoints& points, const Skeleton& person, Limb leg) {
  const auto chain = limb_chain(leg);
  std::array<bool, kNumJoints> is_leg{};
  for (std::size_t bone = 0; bone < kNumJoints; ++bone) is_leg[bone] = is_limb_bone(leg, bone);
  Parts parts{};
  for (std::int64_t i = 0; i < points.count; ++i) {
    if (!is_leg[points.label[i]]) continue;
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    float nearest = std::numeric_limits<float>::max();
    std::size_t part = 0;
    for (std::size_t k = 0; k <= kNumParts; ++k) {
      const Eigen::Vector3f from = person[chain[k]], bone = person[chain[k + 1]] - from;
      const float along =
          std::clamp((p - from).dot(bone) / std::max(bone.squaredNorm(), 1e-9F), 0.0F, 1.0F);
      const float off = (p - from - along * bone).squaredNorm();
      if (!(off < nearest)) continue;
      nearest = off;
      part = k;
    }
    if (part == kNumParts) continue;  // the foot
    parts[part].sum += p.cast<double>();
    parts[part].count += 1.0;
  }
  return parts;
}

bool has_parts(const Skeleton& person, Limb leg) {
  const auto main = limb_chain(leg).first(kNumMainJoints);
  return std::ranges::all_of(main, [&](Joint joint) { return is_usable(person, joint); });
}

/// The squared sine of the angle between a thigh and the trunk: 1 on a seat, 0 standing.
double seated_share(const Skeleton& person, Limb leg, const BodyFrame& trunk) {
  const auto chain = limb_chain(leg);
  if (!is_usable(person, chain[0]) || !is_usable(person, chain[1])) return 0.0;
  const Eigen::Vector3d thigh = (person[chain[1]] - person[chain[0]]).cast<double>();
  const double along = trunk.y.dot(thigh);
  return 1.0 - along * along / std::max(thigh.squaredNorm(), 1e-9);
}

/// The plane at which one leg is mirrored onto the other.
struct LegPlane {
  double turn = 0.0, shift = 0.0;
};

/// With parts at a_k and b_k, weights w_k of sum W, means a and b, and d = b - a: the reflection at
/// the plane n through the means' middle that leaves the least sum of w_k |R a_k - b_k|^2 has the
/// unit normal with the least n' (4 sum w_k (a_k - a)(b_k - b)' - W d d') n. Upright in the trunk,
/// n = c n_t + s z_t, and this is a quadratic form of (c, s).
std::optional<LegPlane> plane_between(const Parts& intact, const Parts& affected,
                                      const BodyFrame& trunk) {
  constexpr double kLeastPoints = 60.0, kLeastShare = 0.4;  // of a part; of the other leg's
  constexpr double kMostOff = 0.06;    // metres: legs in different poses are farther off
  constexpr double kMostTurn = 0.6;    // tangent: 31 degrees, what a spine turns by
  constexpr double kMostShift = 0.10;  // metres
  double weight = 0.0;
  Eigen::Vector3d mean_a = Eigen::Vector3d::Zero(), mean_b = mean_a;
  std::array<Eigen::Vector3d, kNumParts> a, b;
  std::array<double, kNumParts> w{};
  for (std::size_t k = 0; k < kNumParts; ++k) {
    const double less = std::min(intact[k].count, affected[k].count);
    const double more = std::max(intact[k].count, affected[k].count);
    if (!(less >= kLeastPoints && less >= kLeastShare * more)) return std::nullopt;
    a[k] = intact[k].sum / intact[k].count - trunk.origin;
    b[k] = affected[k].sum / affected[k].count - trunk.origin;
    w[k] = less;
    weight += w[k];
    mean_a += w[k] * a[k];
    mean_b += w[k] * b[k];
  }
  mean_a /= weight;
  mean_b /= weight;
  const Eigen::Vector3d across = mean_b - mean_a;
  Eigen::Matrix3d form = -weight * across * across.transpose();
  for (std::size_t k = 0; k < kNumParts; ++k) {
    form += 4.0 * w[k] * (a[k] - mean_a) * (b[k] - mean_b).transpose();
  }
  const double nn = trunk.n.dot(form * trunk.n), zz = trunk.z.dot(form * trunk.z);
  const double nz = 0.5 * (trunk.n.dot(form * trunk.z) + trunk.z.dot(form * trunk.n));
  // The eigenvector of the lesser eigenvalue; its tangent by the half-angle formula.
  const double half = 0.5 * (zz - nn), length = std::sqrt(half * half + nz * nz);
  if (!(half + length > 1e-9 * weight)) return std::nullopt;
  const double turn = -nz / (half + length);
  const Eigen::Vector3d n = (trunk.n + turn * trunk.z).normalized();
  const double offset = 0.5 * n.dot(mean_a + mean_b);
  const double shift = offset / n.dot(trunk.n);
  if (!(std::abs(turn) < kMostTurn && std::abs(shift) < kMostShift)) return std::nullopt;
  for (std::size_t k = 0; k < kNumParts; ++k) {
    const Eigen::Vector3d mirrored = a[k] - 2.0 * (n.dot(a[k]) - offset) * n;
    if (!((mirrored - b[k]).norm() < kMostOff)) return std::nullopt;
  }
  return LegPlane{turn, shift};
}

}  // namespace

void LegTurn::learn(const PersonPoints& points, const Skeleton& person, const BodyFrame& trunk) {
  constexpr double kLeastSeated = 0.5;  // of a squared sine: 45 degrees
  const Limb intact = opposite(affected_);
  trust_ = 1.0;
  seated_ = seated_share(person, intact, trunk);
  if (!(std::min(seated_, seated_share(person, affected_, trunk)) > kLeastSeated)) return;
  if (!has_parts(person, affected_) || !has_parts(person, intact)) return;
  const auto told =
      plane_between(parts_of(points, person, intact), parts_of(points, person, affected_), trunk);
  if (!told) return;
  const double gain = 1.0 / std::min(frames_ + 1.0, kWindow);
  const Eigen::Vector3d normal = upright(trunk.n + told->turn * trunk.z, trunk);
  if (frames_ > 0.0) {
    const double with_seat = normal.cross(upright(normal_, trunk)).squaredNorm();
    const double with_trunk = normal.cross(upright(turned(trunk), trunk)).squaredNorm();
    seat_error_ += kErrorGain * (with_seat - seat_error_);
    trunk_error_ += kErrorGain * (with_trunk - trunk_error_);
  }
  normal_ += gain * (normal - normal_);
  turn_ += gain * (told->turn - turn_);
  shift_ += gain * (told->shift - shift_);
  frames_ = std::min(frames_ + 1.0, kWindow);
}

void LegTurn::forget() {
  constexpr double kMemory = 0.9;  // from frame to frame
  constexpr double kNone = 0.01;
  trust_ *= kMemory;
  if (trust_ < kNone) reset();
}

BodyFrame LegTurn::of(const BodyFrame& trunk) const {
  if (frames_ == 0.0) return trunk;
  const double seat = std::max(seat_error_, kLeastError),
               with_trunk = std::max(trunk_error_, kLeastError);
  const Eigen::Vector3d told = upright(with_trunk * with_trunk * upright(normal_, trunk) +
                                           seat * seat * upright(turned(trunk), trunk),
                                       trunk);
  const double turn2 = told.cross(trunk.n).squaredNorm();
  // All of the turn from 45 degrees on, none of it below 30.
  const double seated = std::clamp(4.0 * seated_ - 1.0, 0.0, 1.0);
  const double share = trust_ * seated * turn2 / (turn2 + kUnsure * kUnsure);
  BodyFrame legs = trunk;
  legs.n = legs.x = (trunk.n + share * (told - trunk.n)).normalized();
  legs.z = legs.n.cross(trunk.y);
  legs.origin += share * shift_ * trunk.n;
  return legs;
}

}  // namespace manip3d
