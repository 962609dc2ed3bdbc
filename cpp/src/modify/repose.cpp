#include "manip3d/modify/repose.hpp"

#include <algorithm>
#include <cmath>
#include <span>
#include <string>

#include "geometry/constants.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/parallel.hpp"
#include "manip3d/modify/joint_smoother.hpp"
#include "modify/bone_direction.hpp"
#include "modify/torso_frame.hpp"

namespace manip3d {
namespace {

/// The joint at the other end of a posable joint's bone; 0 if the joint is not posable.
constexpr std::array<std::uint8_t, kNumJoints> kNext = {
    0, 0, 3, 0, 5, 6, 7, 0, 9, 10, 11, 0, 13, 14, 15, 0, 17, 18, 19, 0, 0, 0, 0, 0, 0};

bool has(const Skeleton& skeleton, std::size_t joint) {
  return is_usable(skeleton, static_cast<Joint>(joint));
}

/// Directions of the bones in the rest pose, and the axes of the torso in it.
struct Rest {
  Eigen::Matrix3d torso = Eigen::Matrix3d::Identity();
  std::array<std::optional<Eigen::Vector3d>, kNumJoints> direction;

  static std::optional<Rest> of(const Skeleton* skeleton) {
    Rest rest;
    if (skeleton == nullptr) {  // In the torso's own axes: left, up, ahead.
      rest.direction.fill(Eigen::Vector3d(0, -1, 0));
      for (const std::size_t foot : {15U, 19U}) rest.direction[foot] = Eigen::Vector3d(0, 0, 1);
      constexpr std::size_t kHead = 3;
      rest.direction[kHead] = Eigen::Vector3d(0, 1, 0);
      return rest;
    }
    const auto torso = torso_frame(*skeleton);
    if (!torso) return {};
    rest.torso = torso->cast<double>();
    for (std::size_t bone = 1; bone < kNumJoints; ++bone) {
      rest.direction[bone] = bone_direction(*skeleton, bone);
    }
    return rest;
  }
};

/// The shortest rotation from one direction to another.
struct Turn {
  double angle = 0.0;
  Eigen::Vector3d axis = Eigen::Vector3d::UnitX();

  static std::optional<Turn> between(const Eigen::Vector3d& from, const Eigen::Vector3d& to) {
    const Eigen::Vector3d across = from.cross(to);
    const double sine = across.norm(), cosine = from.dot(to);
    constexpr double kNone = 1e-9;
    if (!(sine > kNone)) {
      if (cosine < 0.0) return {};
      return Turn{};
    }
    return Turn{std::atan2(sine, cosine), across / sine};
  }
  [[nodiscard]] Eigen::Quaterniond by(double amount) const {
    return Eigen::Quaterniond(Eigen::AngleAxisd(amount, axis));
  }
};

void check(const ReposeOptions& options) {
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    const double gain = options.gain[joint], limit = options.limit[joint];
    const std::string name = kJointNames[joint];
    if (!(gain >= 0.0 && gain <= 100.0)) {
      throw InputError("gain of " + name + ": expected 0 to 100, got " + number_text(gain));
    }
    if (!(limit >= 0.0)) {
      throw InputError("limit of " + name + ": expected at least 0, got " + number_text(limit));
    }
    if (!is_posable(joint) && (gain != 1.0 || limit < kPi)) {
      throw InputError(
          "joint: expected a shoulder, elbow, wrist, hip, knee, ankle or the neck, got " + name);
    }
  }
}

/// The bones of a pose, and distances between their points along the skeleton.
class BoneMap {
 public:
  explicit BoneMap(const Skeleton& skeleton) {
    for (auto& row : way_) row.fill(kInfinity);
    for (std::size_t joint = 0; joint < kNumJoints; ++joint) way_[joint][joint] = 0.0;
    for (std::size_t bone = 1; bone < kNumJoints; ++bone) {
      const std::size_t parent = kJointParents[bone];
      if (!has(skeleton, parent) || !has(skeleton, bone)) continue;
      start_[bone] = skeleton.positions[parent].cast<double>();
      along_[bone] = skeleton.positions[bone].cast<double>() - start_[bone];
      length_[bone] = along_[bone].norm();
      way_[bone][parent] = way_[parent][bone] = length_[bone];
      bones_[num_bones_++] = bone;
    }
    for (std::size_t k = 0; k < kNumJoints; ++k) {
      for (std::size_t i = 0; i < kNumJoints; ++i) {
        for (std::size_t j = 0; j < kNumJoints; ++j) {
          way_[i][j] = std::min(way_[i][j], way_[i][k] + way_[k][j]);
        }
      }
    }
  }

  [[nodiscard]] std::span<const std::size_t> bones() const { return {bones_.data(), num_bones_}; }

  /// Position of the point of a bone nearest to x along the bone, 0 to 1, and its distance from x.
  struct Foot {
    double at = 0.0, distance = 0.0;
  };
  [[nodiscard]] Foot foot(std::size_t bone, const Eigen::Vector3d& x) const {
    const Eigen::Vector3d from_start = x - start_[bone];
    const double length2 = along_[bone].squaredNorm();
    const double at =
        length2 > 0.0 ? std::clamp(from_start.dot(along_[bone]) / length2, 0.0, 1.0) : 0.0;
    return {at, (from_start - at * along_[bone]).norm()};
  }

  /// Distance along the skeleton from a point of bone a to a point of bone b.
  [[nodiscard]] double way(std::size_t a, double at_a, std::size_t b, double at_b) const {
    const std::size_t parent_a = kJointParents[a], parent_b = kJointParents[b];
    const double to_end_a = (1.0 - at_a) * length_[a], to_start_a = at_a * length_[a];
    const double to_end_b = (1.0 - at_b) * length_[b], to_start_b = at_b * length_[b];
    return std::min({to_end_a + way_[a][b] + to_end_b, to_end_a + way_[a][parent_b] + to_start_b,
                     to_start_a + way_[parent_a][b] + to_end_b,
                     to_start_a + way_[parent_a][parent_b] + to_start_b});
  }

 private:
  std::array<std::size_t, kNumJoints> bones_{};
  std::size_t num_bones_ = 0;
  std::array<Eigen::Vector3d, kNumJoints> start_, along_;
  std::array<double, kNumJoints> length_{};
  std::array<std::array<double, kNumJoints>, kNumJoints> way_;
};

/// A weighted sum of rigid motions.
class DualQuaternion {
 public:
  void add(double weight, const Eigen::Quaterniond& rotation, const Eigen::Vector3d& translation) {
    if (real_.dot(rotation.coeffs()) < 0.0) weight = -weight;  // q and -q are the same rotation
    const Eigen::Quaterniond move(0.0, translation.x(), translation.y(), translation.z());
    real_ += weight * rotation.coeffs();
    dual_ += weight * 0.5 * (move * rotation).coeffs();
  }
  [[nodiscard]] Eigen::Vector3d apply(const Eigen::Vector3d& x) const {
    const double norm = real_.norm();
    const Eigen::Quaterniond rotation(Eigen::Vector4d(real_ / norm));
    const Eigen::Quaterniond dual(Eigen::Vector4d(dual_ / norm));
    return rotation * x + 2.0 * (dual * rotation.conjugate()).vec();
  }

 private:
  Eigen::Vector4d real_ = Eigen::Vector4d::Zero(), dual_ = Eigen::Vector4d::Zero();
};

/// g: 1 up to 0.15 m along the skeleton, 0 from 0.3 m on.
double nearness(double way) { return std::clamp((0.3 - way) / 0.15, 0.0, 1.0); }

class Skin {
 public:
  Skin(const Skeleton& skeleton, const BoneMotions& motions, const ReposeOptions& options)
      : map_(skeleton), motions_(motions), options_(options) {}

  /// New position of x; no value: it does not move.
  [[nodiscard]] std::optional<Eigen::Vector3d> move(const Eigen::Vector3d& x) const {
    std::array<BoneMap::Foot, kNumJoints> feet;
    std::size_t nearest = 0;
    for (const std::size_t bone : map_.bones()) {
      feet[bone] = map_.foot(bone, x);
      const double best = nearest == 0 ? kInfinity : feet[nearest].distance;
      if (feet[bone].distance < best) nearest = bone;
    }
    if (nearest == 0) return {};
    if (options_.blended) return blend(x, feet, nearest);
    if (!motions_.moves[nearest]) return {};
    return motions_.apply(nearest, x);
  }

 private:
  [[nodiscard]] std::optional<Eigen::Vector3d> blend(
      const Eigen::Vector3d& x, const std::array<BoneMap::Foot, kNumJoints>& feet,
      std::size_t nearest) const {
    DualQuaternion sum;
    sum.add(1.0, motions_.rotation[nearest], motions_.translation[nearest]);
    bool moves = motions_.moves[nearest];
    for (const std::size_t bone : map_.bones()) {
      const double beyond = (feet[bone].distance - feet[nearest].distance) / options_.band;
      if (bone == nearest || !(beyond < 1.0)) continue;
      const double weight = (1.0 - beyond) * (1.0 - beyond) *
                            nearness(map_.way(nearest, feet[nearest].at, bone, feet[bone].at));
      if (!(weight > 0.0)) continue;
      sum.add(weight, motions_.rotation[bone], motions_.translation[bone]);
      moves = moves || motions_.moves[bone];
    }
    if (!moves) return {};
    return sum.apply(x);
  }

  BoneMap map_;
  const BoneMotions& motions_;
  const ReposeOptions& options_;
};

}  // namespace

ReposeOptions::ReposeOptions() {
  gain.fill(1.0);
  limit.fill(kPi);
}

bool is_posable(std::size_t joint) { return joint < kNumJoints && kNext[joint] != 0; }

BoneMotions::BoneMotions() {
  rotation.fill(Eigen::Quaterniond::Identity());
  translation.fill(Eigen::Vector3d::Zero());
}

std::optional<BoneMotions> amplify(const Skeleton& now, const Skeleton* rest,
                                   const ReposeOptions& options) {
  check(options);
  const auto torso = torso_frame(now);
  const auto from = Rest::of(rest);
  if (!torso || !from) return {};
  const Eigen::Quaterniond turned(Eigen::Matrix3d(torso->cast<double>() * from->torso.transpose()));
  std::array<Eigen::Quaterniond, kNumJoints> since_rest;  // of each bone: rotation from rest to now
  since_rest.fill(turned);

  BoneMotions motions;
  std::array<Eigen::Quaterniond, kNumJoints> extra;  // of each joint: additional rotation
  extra.fill(Eigen::Quaterniond::Identity());
  std::array<bool, kNumJoints> has_extra{};
  for (const std::size_t bone : kJointsOutwards) {
    if (bone == 0) continue;
    const std::size_t joint = kJointParents[bone];
    if (kNext[joint] != 0) since_rest[bone] = since_rest[joint];
    const auto is = bone_direction(now, bone);
    if (kNext[joint] == bone && is && from->direction[bone]) {
      const auto turn = Turn::between(since_rest[joint] * *from->direction[bone], *is);
      if (turn) {
        since_rest[bone] = turn->by(turn->angle) * since_rest[joint];
        const double wanted = std::min(options.gain[joint] * turn->angle, options.limit[joint]);
        has_extra[joint] = wanted != turn->angle;
        if (has_extra[joint]) extra[joint] = turn->by(wanted - turn->angle);
      }
    }
    motions.rotation[bone] = motions.rotation[joint];
    motions.translation[bone] = motions.translation[joint];
    motions.moves[bone] = motions.moves[joint] || has_extra[joint];
    if (!has_extra[joint]) continue;
    // x -> p + extra (x - p) about the joint, followed by the motion of the joint itself.
    const Eigen::Vector3d p = now.positions[joint].cast<double>();
    motions.translation[bone] += motions.rotation[joint] * (p - extra[joint] * p);
    motions.rotation[bone] = (motions.rotation[joint] * extra[joint]).normalized();
  }
  return motions;
}

Skeleton move_skeleton(const Skeleton& now, const BoneMotions& motions) {
  Skeleton moved = now;
  for (std::size_t joint = 1; joint < kNumJoints; ++joint) {
    if (!motions.moves[joint]) continue;
    moved.positions[joint] =
        motions.apply(joint, now.positions[joint].cast<double>()).cast<float>();
    const auto& [w, x, y, z] = now.orientations[joint];
    const Eigen::Quaternionf turned =
        motions.rotation[joint].cast<float>() * Eigen::Quaternionf(w, x, y, z);
    moved.orientations[joint] = {turned.w(), turned.x(), turned.y(), turned.z()};
  }
  return moved;
}

template <typename Scalar>
void repose_vertices(const Scalar* vertices, std::int64_t count, const Skeleton& now,
                     const BoneMotions& motions, const ReposeOptions& options, Scalar* out,
                     const Progress& progress) {
  if (!(options.band > 0.0)) {
    throw InputError("band: expected above 0, got " + number_text(options.band));
  }
  using Row = Eigen::Matrix<Scalar, 3, 1>;
  const Skin skin(now, motions, options);
  constexpr std::int64_t kChunk = 1024;
  const auto move = [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const Eigen::Map<const Row> from(vertices + 3 * i);
      const auto to = skin.move(from.template cast<double>());
      Eigen::Map<Row>(out + 3 * i) = to ? Row(to->template cast<Scalar>()) : Row(from);
    }
  };
  parallel_chunks(count, kChunk, options.num_threads, move, progress);
}

template void repose_vertices<float>(const float*, std::int64_t, const Skeleton&,
                                     const BoneMotions&, const ReposeOptions&, float*,
                                     const Progress&);
template void repose_vertices<double>(const double*, std::int64_t, const Skeleton&,
                                      const BoneMotions&, const ReposeOptions&, double*,
                                      const Progress&);

}  // namespace manip3d
