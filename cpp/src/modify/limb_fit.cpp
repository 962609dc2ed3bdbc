#include "manip3d/modify/limb_fit.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>

#include "manip3d/modify/body_bones.hpp"
#include "manip3d/modify/joint_smoother.hpp"
#include "manip3d/modify/limb.hpp"
#include "modify/bone_direction.hpp"

namespace manip3d {
namespace {

constexpr std::size_t kMaxSamples = 1024;
// Lengths are in metres.
// Scale of the Geman-McClure weights in each step. Points farther than this from the skin hardly
// count; it decreases as the skins come nearer to their points.
constexpr std::array kScales = {0.12F, 0.08F, 0.05F, 0.03F};
constexpr float kFarthest = 0.15F;     // points farther than this from every skin are not used
constexpr double kPointNoise = 0.015;  // standard error of a skin's radius, clothes included
// The errors of points on one bone are not independent: together they weigh as much as this many
// independent points.
constexpr double kIndependentPoints = 25.0;
constexpr double kJointNoise = 0.05;   // standard deviation of the prior: error of a tracked joint
constexpr double kMaxMoved = 0.12;     // largest distance of a fitted joint from the tracked one
constexpr std::size_t kMaxMoving = 4;  // joints of a limb beyond its root
constexpr std::size_t kBlock = 32;     // samples with a common bounding box
constexpr std::uint8_t kNoBone = 0xff;

/// A sample of the person's points, with the bone whose skin is nearest to each.
struct Samples {
  std::size_t count = 0;
  alignas(32) std::array<float, kMaxSamples> x, y, z;
  /// Distance from the nearest skin of a bone that is not fitted; at most kFarthest.
  alignas(32) std::array<float, kMaxSamples> other;
  alignas(32) std::array<float, kMaxSamples> skin;  ///< Distance from the nearest skin of any bone.
  alignas(
      32) std::array<std::int32_t, kMaxSamples> bone;  ///< Fitted bone of that skin, or kNoBone.
  std::array<Eigen::AlignedBox3f, kMaxSamples / kBlock> boxes;  ///< Around each block.

  explicit Samples(const PersonPoints& points) {
    const std::size_t all = points.count;
    const std::size_t stride = std::max<std::size_t>(1, (all + kMaxSamples - 1) / kMaxSamples);
    for (std::size_t i = stride / 2; i < all; i += stride) {
      x[count] = points.x[i], y[count] = points.y[i], z[count] = points.z[i];
      boxes[count / kBlock].extend(Eigen::Vector3f(x[count], y[count], z[count]));
      other[count++] = kFarthest;
    }
  }

  /// Updates the least distances `to`, which are at most kFarthest, and `bone` by the distances
  /// from the skin of bone `number`.
  void measure(const Eigen::Vector3f& from, const Eigen::Vector3f& end, const BoneRadii& radii,
               std::int32_t number, std::array<float, kMaxSamples>& to) {
    const Eigen::Vector3f b = end - from;
    const Eigen::Vector3f t = b / squared_length(b);
    const float taper = radii.end - radii.start;
    constexpr float kRounding = 1e-3F;  // metres: far above the rounding of these floats
    const float reach = kFarthest + std::max(radii.start, radii.end) + kRounding;
    const Eigen::AlignedBox3f around(from.cwiseMin(end), from.cwiseMax(end));
    for (std::size_t begin = 0; begin < count; begin += kBlock) {
      if (boxes[begin / kBlock].squaredExteriorDistance(around) > reach * reach) continue;
      measure_block(begin, std::min(begin + kBlock, count), from, b, t, radii.start, taper, number,
                    to);
    }
  }

  void measure_block(std::size_t first, std::size_t last, const Eigen::Vector3f& from,
                     const Eigen::Vector3f& b, const Eigen::Vector3f& t, float radius, float taper,
                     std::int32_t number, std::array<float, kMaxSamples>& to) {
    for (std::size_t i = first; i < last; ++i) {
      const float dx = x[i] - from.x(), dy = y[i] - from.y(), dz = z[i] - from.z();
      const float along = std::clamp(dx * t.x() + dy * t.y() + dz * t.z(), 0.0F, 1.0F);
      const float ex = dx - along * b.x(), ey = dy - along * b.y(), ez = dz - along * b.z();
      const float off = std::sqrt(ex * ex + ey * ey + ez * ez) - (radius + along * taper);
      const bool nearer = off < to[i];
      to[i] = nearer ? off : to[i];
      bone[i] = nearer ? number : bone[i];
    }
  }
};

/// The joints of a limb from its root to the last usable one, with the radii of its bones.
struct Chain {
  std::size_t count = 0;
  std::array<Joint, kMaxMoving + 1> joint;
  std::array<Eigen::Vector3f, kMaxMoving + 1> tracked, place;  ///< Tracked and fitted positions.
  std::array<BoneRadii, kMaxMoving + 1> radii;  ///< Radii of the bone that ends at the joint.

  Chain(const Skeleton& skeleton, Limb limb, const BoneSegments& bones) {
    for (const Joint next : limb_chain(limb)) {
      if (!is_usable(skeleton, next)) break;
      const auto end = bones.label.begin() + static_cast<std::ptrdiff_t>(bones.count);
      const auto found = std::find(bones.label.begin(), end, static_cast<std::uint8_t>(next));
      if (count > 0 && found == end) break;
      joint[count] = next;
      tracked[count] = place[count] = skeleton[next];
      if (count > 0) radii[count] = bones.radii[found - bones.label.begin()];
      ++count;
    }
  }
};

/// Solves for the joints of all four limbs; see fit_limbs().
class LimbFit {
 public:
  LimbFit(const Skeleton& skeleton, const BoneSegments& bones, const PersonPoints& points)
      : samples_(points),
        chains_{Chain(skeleton, Limb::kLeftArm, bones), Chain(skeleton, Limb::kRightArm, bones),
                Chain(skeleton, Limb::kLeftLeg, bones), Chain(skeleton, Limb::kRightLeg, bones)} {
    for (std::size_t i = 0; i < bones.count; ++i) {
      if (is_fitted(bones.label[i])) continue;
      samples_.measure(bones.start[i], bones.end[i], bones.radii[i], kNoBone, samples_.other);
    }
  }

  void solve() {
    for (const float scale : kScales) {
      assign();
      for (std::size_t limb = 0; limb < kNumLimbs; ++limb) step(limb, scale);
    }
  }

  [[nodiscard]] const std::array<Chain, kNumLimbs>& chains() const { return chains_; }

 private:
  using Matrix = Eigen::Matrix<double, 3 * kMaxMoving, 3 * kMaxMoving>;
  using Vector = Eigen::Matrix<double, 3 * kMaxMoving, 1>;
  static constexpr std::size_t kBonesOfLimb = 8;  // numbers of bones: limb * 8 + place in the chain

  [[nodiscard]] bool is_fitted(std::uint8_t bone) const {
    for (const Chain& chain : chains_) {
      for (std::size_t k = 1; k < chain.count; ++k) {
        if (static_cast<std::uint8_t>(chain.joint[k]) == bone) return true;
      }
    }
    return false;
  }

  /// Assigns each sample to the nearest skin.
  void assign() {
    const std::size_t count = samples_.count;
    for (std::size_t i = 0; i < count; ++i) {
      samples_.skin[i] = std::min(samples_.other[i], kFarthest);
      samples_.bone[i] = kNoBone;
    }
    for (std::size_t limb = 0; limb < kNumLimbs; ++limb) {
      const Chain& chain = chains_[limb];
      for (std::size_t k = 1; k < chain.count; ++k) {
        samples_.measure(chain.place[k - 1], chain.place[k], chain.radii[k],
                         static_cast<std::int32_t>(kBonesOfLimb * limb + k), samples_.skin);
      }
    }
    num_of_.fill(0);
    for (std::size_t i = 0; i < count; ++i) {
      if (samples_.bone[i] != kNoBone) ++num_of_[samples_.bone[i]];
    }
  }

  /// Moves the joints of one limb by one Gauss-Newton step.
  void step(std::size_t limb, float scale) {
    Chain& chain = chains_[limb];
    if (chain.count < 2) return;
    constexpr double kPrior = 1.0 / (kJointNoise * kJointNoise);
    Matrix information = kPrior * Matrix::Identity();
    Vector gradient = Vector::Zero();
    for (std::size_t k = 1; k < chain.count; ++k) {
      gradient.segment<3>(static_cast<Eigen::Index>(3 * (k - 1))) =
          kPrior * (chain.tracked[k] - chain.place[k]).cast<double>();
    }
    for (std::size_t i = 0; i < samples_.count; ++i) {
      const std::size_t bone = samples_.bone[i];
      if (bone == kNoBone || bone / kBonesOfLimb != limb) continue;
      add(limb, bone % kBonesOfLimb, i, scale, information, gradient);
    }
    const Vector moved = information.ldlt().solve(gradient);  // reads the lower triangle only
    for (std::size_t k = 1; k < chain.count; ++k) {
      chain.place[k] += moved.segment<3>(static_cast<Eigen::Index>(3 * (k - 1))).cast<float>();
      const Eigen::Vector3f off = chain.place[k] - chain.tracked[k];
      const float most = static_cast<float>(kMaxMoved) / std::max(off.norm(), 1e-6F);
      if (most < 1.0F) chain.place[k] = chain.tracked[k] + most * off;
    }
  }

  /// Adds the normal equations of sample i on bone k of a limb. Let A and B be the ends of the
  /// bone, P the sample, Q = A + t (B - A) the point of the bone nearest to it and u = (P - Q) / |P
  /// - Q|. If the ends move by dA and dB, the distance of the skin from P decreases by (1 - t) u.dA
  /// + t u.dB.
  void add(std::size_t limb, std::size_t k, std::size_t i, float scale, Matrix& information,
           Vector& gradient) const {
    const Chain& chain = chains_[limb];
    const Eigen::Vector3f p(samples_.x[i], samples_.y[i], samples_.z[i]);
    const Eigen::Vector3f a = chain.place[k - 1], b = chain.place[k] - a;
    const float along = b.dot(p - a) / squared_length(b);
    const bool is_past_the_end = along >= 1.0F && k + 1 == chain.count;
    if (is_past_the_end || along < 0.0F) return;  // beyond the ends u is not across the bone
    const float t = std::min(along, 1.0F);
    const Eigen::Vector3f off = p - a - t * b;
    const Eigen::Vector3d u = off.normalized().cast<double>();
    const float outlier = 1.0F + samples_.skin[i] * samples_.skin[i] / (scale * scale);
    const double share = std::min(1.0, kIndependentPoints / num_of_[kBonesOfLimb * limb + k]);
    const double weight = share / (kPointNoise * kPointNoise * outlier * outlier);
    const double of_start = 1.0 - t, of_end = t;
    const Eigen::Matrix3d block = weight * u * u.transpose();
    const Eigen::Vector3d pull = weight * samples_.skin[i] * u;
    const auto end = static_cast<Eigen::Index>(3 * (k - 1));
    information.block<3, 3>(end, end) += of_end * of_end * block;
    gradient.segment<3>(end) += of_end * pull;
    if (k == 1) return;  // the root stays
    const Eigen::Index start = end - 3;
    information.block<3, 3>(start, start) += of_start * of_start * block;
    information.block<3, 3>(end, start) += of_start * of_end * block;  // below the diagonal
    gradient.segment<3>(start) += of_start * pull;
  }

  Samples samples_;
  std::array<Chain, kNumLimbs> chains_;
  std::array<std::int32_t, 256> num_of_{};  ///< Number of samples assigned to each bone.
};

}  // namespace

Skeleton fit_limbs(const Skeleton& skeleton, const PersonPoints& points, float trunk) {
  const BoneSegments bones = body_bones(skeleton, BoneRule::kSkin, trunk);
  const bool has_radii = std::any_of(bones.radii.begin(),
                                     bones.radii.begin() + static_cast<std::ptrdiff_t>(bones.count),
                                     [](const BoneRadii& r) { return r.end > 0.0F; });
  if (!has_radii) return skeleton;
  LimbFit fit(skeleton, bones, points);
  fit.solve();
  Skeleton result = skeleton;
  for (const Chain& chain : fit.chains()) {
    for (std::size_t k = 1; k < chain.count; ++k) {
      result.positions[static_cast<std::size_t>(chain.joint[k])] = chain.place[k];
    }
  }
  // Joints that were not fitted, such as fingers and thumbs, move with their parents.
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    const std::size_t parent = kJointParents[joint];
    const bool is_fitted = result.positions[joint] != skeleton.positions[joint];
    if (is_fitted || !is_usable(skeleton, static_cast<Joint>(joint))) continue;
    if (!is_usable(skeleton, static_cast<Joint>(parent))) continue;
    result.positions[joint] += result.positions[parent] - skeleton.positions[parent];
  }
  return result;
}

}  // namespace manip3d
