#include "modify/leg_turn.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "geometry/small_solvers.hpp"
#include "manip3d/modify/joint_smoother.hpp"
#include "modify/bone_direction.hpp"

namespace manip3d {
namespace {

constexpr double kWindow = 90.0;  // frames in the means
// Weight of a frame in the errors of the means: they cover a third of a second.
constexpr double kErrorGain = 0.1;
constexpr double kMinError = 0.0001;  // squared sine of half a degree
constexpr std::size_t kNumParts = 2;  // thigh and shin; feet are short and half hidden
// A squared sine, of 33 degrees; not more, because trackers place the hips of seated people too
// high.
constexpr double kMinSeated = 0.3;

/// The direction, made orthogonal to the spine and normalized.
Eigen::Vector3d upright(const Eigen::Vector3d& direction, const BodyFrame& trunk) {
  return (direction - direction.dot(trunk.y) * trunk.y).normalized();
}

/// Points of one part of a leg.
struct Part {
  static constexpr std::size_t kMost = 100;  // points; more make the plane no steadier
  std::array<Eigen::Vector3d, kMost> points;
  std::size_t count = 0;
  std::size_t num_visible = 0;  ///< Before they were thinned out to `points`.
};
using Parts = std::array<Part, kNumParts>;

/// Calls use(part, point) for each point of the leg with the part (between two joints) that is
/// nearest.
template <typename Use>
void for_each_part(const PersonPoints& points, const Skeleton& person, Limb leg, const Use& use) {
  const auto chain = limb_chain(leg);
  std::array<bool, kNumJoints> is_leg{};
  for (std::size_t bone = 0; bone < kNumJoints; ++bone) is_leg[bone] = is_limb_bone(leg, bone);
  for (std::int64_t i = 0; i < points.count; ++i) {
    if (!is_leg[points.label[i]]) continue;
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    float nearest = std::numeric_limits<float>::max();
    std::size_t part = 0;
    // The last bone is the foot: it competes for the points too, and its points are left out.
    for (std::size_t k = 0; k <= kNumParts; ++k) {
      const Eigen::Vector3f from = person[chain[k]], bone = person[chain[k + 1]] - from;
      const float along = std::clamp((p - from).dot(bone) / squared_length(bone), 0.0F, 1.0F);
      const float off = (p - from - along * bone).squaredNorm();
      if (!(off < nearest)) continue;
      nearest = off;
      part = k;
    }
    if (part < kNumParts) use(part, p.cast<double>());
  }
}

/// Evenly spread points of each part of the leg.
Parts parts_of(const PersonPoints& points, const Skeleton& person, Limb leg) {
  Parts parts;
  for_each_part(points, person, leg,
                [&](std::size_t part, const auto&) { ++parts[part].num_visible; });
  std::array<std::size_t, kNumParts> seen{};
  for_each_part(points, person, leg, [&](std::size_t k, const Eigen::Vector3d& p) {
    Part& part = parts[k];
    const std::size_t stride = (part.num_visible + Part::kMost - 1) / Part::kMost;
    if (seen[k]++ % stride == 0) part.points[part.count++] = p;
  });
  return parts;
}

/// The skin of one part of a leg: a capsule around the bone between two joints whose radius is the
/// mean distance of the points.
class Skin {
 public:
  Skin(const Eigen::Vector3d& from, const Eigen::Vector3d& to, const Part& part)
      : from_(from), bone_(to - from), length2_(squared_length(bone_)) {
    double sum = 0.0;
    for (std::size_t i = 0; i < part.count; ++i) sum += from_bone(part.points[i] - from).norm();
    radius_ = sum / static_cast<double>(std::max<std::size_t>(part.count, 1));
  }
  /// Vector from the nearest point of the bone to a point, which is relative to the bone's first
  /// joint.
  [[nodiscard]] Eigen::Vector3d from_bone(const Eigen::Vector3d& p) const {
    return p - std::clamp(p.dot(bone_) / length2_, 0.0, 1.0) * bone_;
  }
  [[nodiscard]] const Eigen::Vector3d& first_joint() const { return from_; }
  [[nodiscard]] double radius() const { return radius_; }

 private:
  Eigen::Vector3d from_, bone_;
  double length2_, radius_ = 0.0;
};

/// Visible points of a leg, and the skins through them.
struct SeenLeg {
  Parts parts;
  std::array<Skin, kNumParts> skins;
};

SeenLeg see(const PersonPoints& points, const Skeleton& person, Limb leg) {
  const auto chain = limb_chain(leg);
  const Parts parts = parts_of(points, person, leg);
  const auto skin = [&](std::size_t part) {
    return Skin(person[chain[part]].cast<double>(), person[chain[part + 1]].cast<double>(),
                parts[part]);
  };
  return {parts, {skin(0), skin(1)}};
}

bool has_parts(const Skeleton& person, Limb leg) {
  const auto main = limb_chain(leg).first(kNumMainJoints);
  return std::ranges::all_of(main, [&](Joint joint) { return is_usable(person, joint); });
}

/// The squared sine of the angle between a thigh and the trunk: 1 for a person who sits upright, 0
/// for one who stands.
double seated_share(const Skeleton& person, Limb leg, const BodyFrame& trunk) {
  const auto chain = limb_chain(leg);
  if (!is_usable(person, chain[0]) || !is_usable(person, chain[1])) return 0.0;
  const Eigen::Vector3d thigh = (person[chain[1]] - person[chain[0]]).cast<double>();
  const double along = trunk.y.dot(thigh);
  return 1.0 - along * along / squared_length(thigh);
}

/// The plane at which one leg is mirrored onto the other, relative to the plane of the trunk.
struct LegPlane {
  double turn = 0.0, roll = 0.0;  ///< Tangents from the trunk's n to its z, and to its y.
  double shift = 0.0;             ///< Metres.
};

/// Fits the plane at which the points of each leg lie on the skin of the other, with the plane of
/// the trunk as a wide prior.
///
/// The visible part of a thigh depends on its direction. Points are therefore fitted to the
/// skin and not to points: they may lie anywhere along the bone. Both directions (each leg onto the
/// other) are used, because the joints of either leg can be wrong. A knee that is bent more than
/// the other must not be fitted as a turn: mirrored shins may rotate about the plane's normal at
/// the knee by a fourth unknown. Residuals have the Geman-McClure weight of a heavy-tailed
/// distribution, whose scale decreases from step to step.
class PlaneFit {
 public:
  explicit PlaneFit(const BodyFrame& trunk) : trunk_(trunk) {}

  /// Does one Gauss-Newton step.
  /// @param scale  Residual at which the weight is a quarter, metres.
  void step(const SeenLeg& intact, const SeenLeg& affected, double scale) {
    // Standard deviations of turn, roll, shift and bend. A narrower prior would pull the plane of
    // turned legs to that of the trunk.
    const Eigen::Vector4d deviation(0.6, 0.1, 0.05, 0.5);
    const Eigen::Vector4d prior = deviation.cwiseProduct(deviation).cwiseInverse();
    off_.fill(0.0);
    n_ = (trunk_.n + plane_[0] * trunk_.z + plane_[1] * trunk_.y).normalized();
    information_ = prior.asDiagonal();
    gradient_ = -prior.cwiseProduct(plane_);
    for (std::size_t k = 0; k < kNumParts; ++k) {
      lay(affected, intact, k, -1.0, scale);
      lay(intact, affected, k, 1.0, scale);
    }
    plane_ += solve_symmetric(information_, gradient_);
  }

  /// The plane; none if it is an unlikely one, or the legs do not lie on each other.
  [[nodiscard]] std::optional<LegPlane> found() const {
    constexpr double kMaxTurn = 0.6;    // tangent of 31 degrees, the most that a spine turns
    constexpr double kMaxShift = 0.10;  // metres
    constexpr double kMaxOff = 0.04;  // metres; the distance is larger for legs in different poses
    const bool is_likely = std::abs(plane_[0]) < kMaxTurn && std::abs(plane_[2]) < kMaxShift;
    const bool fits = std::ranges::all_of(off_, [](double o) { return o < kMaxOff; });
    if (!(is_likely && fits)) return std::nullopt;
    return LegPlane{plane_[0], plane_[1], plane_[2]};
  }

 private:
  /// Adds the mirrored points of a part of one leg, as residuals from the skin of the other. With
  /// the normal n = n_t + a z_t + b y_t, the shift c, s = n (p - o) - c and the mirrored point p' =
  /// p - 2 s n, changes of a, b and c move p' by -2 (z_t (p - o) n + s z_t) da - 2 (y_t (p - o) n +
  /// s y_t) db + 2 n dc.
  /// @param bend  Sign of the rotation of the shin.
  void lay(const SeenLeg& from, const SeenLeg& onto, std::size_t k, double bend, double scale) {
    // Metres, error of a whole part, because joints are wrong by as much.
    constexpr double kNoise = 0.02;
    const Part& part = from.parts[k];
    const Skin& skin = onto.skins[k];
    const bool is_shin = k == 1;
    const Eigen::AngleAxisd bent(is_shin ? bend * plane_[3] : 0.0, n_);
    const auto count = 2.0 * static_cast<double>(part.count);
    for (std::size_t i = 0; i < part.count; ++i) {
      const Eigen::Vector3d p = part.points[i] - trunk_.origin;
      const double s = n_.dot(p) - plane_[2];
      const Eigen::Vector3d mirrored = bent * (part.points[i] - 2.0 * s * n_ - skin.first_joint());
      const Eigen::Vector3d away = skin.from_bone(mirrored);
      const double distance = std::max(away.norm(), 1e-6), e = distance - skin.radius();
      off_[k] += std::abs(e) / count;
      const Eigen::Vector3d out = away / distance;
      const double along = out.dot(n_);
      const Eigen::Vector4d row(-2.0 * (trunk_.z.dot(p) * along + s * out.dot(trunk_.z)),
                                -2.0 * (trunk_.y.dot(p) * along + s * out.dot(trunk_.y)),
                                2.0 * along, is_shin ? bend * out.dot(n_.cross(mirrored)) : 0.0);
      const double share = 1.0 + (e * e) / (scale * scale);
      const double weight = 1.0 / (kNoise * kNoise * count * share * share);
      information_ += weight * row * row.transpose();
      gradient_ -= weight * e * row;
    }
  }

  const BodyFrame& trunk_;
  Eigen::Vector4d plane_ = Eigen::Vector4d::Zero();  ///< Turn, roll, shift and bend.
  Eigen::Vector3d n_ = Eigen::Vector3d::Zero();      ///< Normal of the plane.
  Eigen::Matrix4d information_ = Eigen::Matrix4d::Zero();
  Eigen::Vector4d gradient_ = Eigen::Vector4d::Zero();
  std::array<double, kNumParts> off_{};  ///< Metres: mean distance of the points from the skin.
};

std::optional<LegPlane> plane_between(const SeenLeg& intact, const SeenLeg& affected,
                                      const BodyFrame& trunk) {
  // Metres: from legs that point past each other down to residuals of well-aligned legs.
  constexpr std::array kScales = {0.30, 0.30, 0.20, 0.15, 0.10, 0.08, 0.06, 0.06};
  PlaneFit fit(trunk);
  for (const double scale : kScales) fit.step(intact, affected, scale);
  return fit.found();
}

}  // namespace

void LegTurn::learn(const PersonPoints& points, const Skeleton& person, const BodyFrame& trunk) {
  const Limb intact = opposite(affected_);
  trust_ = 1.0;
  seated_ = seated_share(person, intact, trunk);
  if (!(std::min(seated_, seated_share(person, affected_, trunk)) > kMinSeated)) return;
  if (!has_parts(person, affected_) || !has_parts(person, intact)) return;
  const SeenLeg mine = see(points, person, affected_), other = see(points, person, intact);
  constexpr std::size_t kMinPoints = 60;
  const auto is_seen = [](const Part& part) { return part.num_visible >= kMinPoints; };
  if (!std::ranges::all_of(mine.parts, is_seen) || !std::ranges::all_of(other.parts, is_seen))
    return;
  const auto measured = plane_between(other, mine, trunk);
  if (!measured) return;
  const double gain = 1.0 / std::min(frames_ + 1.0, kWindow);
  const Eigen::Vector3d normal = upright(trunk.n + measured->turn * trunk.z, trunk);
  if (frames_ > 0.0) {
    const double with_seat = normal.cross(upright(normal_, trunk)).squaredNorm();
    const double with_trunk = normal.cross(upright(turned(trunk), trunk)).squaredNorm();
    seat_error_ += kErrorGain * (with_seat - seat_error_);
    trunk_error_ += kErrorGain * (with_trunk - trunk_error_);
  }
  normal_ += gain * (normal - normal_);
  turn_ += gain * (measured->turn - turn_);
  roll_ += gain * (measured->roll - roll_);
  shift_ += gain * (measured->shift - shift_);
  frames_ = std::min(frames_ + 1.0, kWindow);
}

void LegTurn::lose_trust() {
  constexpr double kMemory = 0.9;  // weight of the previous trust, per frame
  constexpr double kNone = 0.01;
  trust_ *= kMemory;
  if (trust_ < kNone) reset();
}

BodyFrame LegTurn::of(const BodyFrame& trunk) const {
  if (frames_ == 0.0) return trunk;
  const double seat = std::max(seat_error_, kMinError),
               with_trunk = std::max(trunk_error_, kMinError);
  // The weights are 1 / error^2, times the squares of both errors. The errors are squared sines
  // already, so that the better mean decides almost alone.
  const Eigen::Vector3d normal = upright(with_trunk * with_trunk * upright(normal_, trunk) +
                                             seat * seat * upright(turned(trunk), trunk),
                                         trunk);
  // The whole turn is used from 33 degrees on, none below 23 degrees.
  const double seated = trust_ * std::clamp(2.0 * seated_ / kMinSeated - 1.0, 0.0, 1.0);
  BodyFrame legs = trunk;
  legs.n = legs.x = (trunk.n + seated * (normal - trunk.n) + seated * roll_ * trunk.y).normalized();
  legs.y = (trunk.y - trunk.y.dot(legs.n) * legs.n).normalized();
  legs.z = legs.n.cross(legs.y);
  legs.origin += seated * shift_ * legs.n;  // PlaneFit measures it along its own normal
  return legs;
}

}  // namespace manip3d
