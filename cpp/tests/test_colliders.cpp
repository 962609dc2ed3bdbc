#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <limits>
#include <random>
#include <vector>

#include "allocations.hpp"
#include "manip3d/error.hpp"
#include "manip3d/modify/colliders.hpp"

namespace manip3d {
namespace {

constexpr std::size_t kForearm = 6;

BodyColliders with_capsule(const Eigen::Vector3f& start, const Eigen::Vector3f& end, float radius) {
  BodyColliders body;
  body.capsules[kForearm] = {start, end, radius};
  return body;
}

Eigen::Vector3d mix(const Eigen::Vector3f& a, const Eigen::Vector3f& b, double t) {
  return ((1.0 - t) * a.cast<double>() + t * b.cast<double>()).eval();
}

double gap_at(const Capsule& before, const Capsule& now, const MovingSphere& target, double t) {
  const Eigen::Vector3d a = mix(before.start, now.start, t), b = mix(before.end, now.end, t);
  const Eigen::Vector3d c = mix(target.from, target.to, t);
  double best = std::numeric_limits<double>::infinity();
  const double length2 = (b - a).squaredNorm();
  const double s = length2 > 0.0 ? std::min(1.0, std::max(0.0, (c - a).dot(b - a) / length2)) : 0.0;
  for (const double at : {0.0, s, 1.0}) best = std::min(best, (c - (a + at * (b - a))).norm());
  return best - now.radius - target.radius;
}

double gap_at(const ColliderBox& before, const ColliderBox& now, const MovingSphere& target,
              double t) {
  Eigen::Vector4d q0 = before.rotation.cast<double>().coeffs();
  Eigen::Vector4d q1 = now.rotation.cast<double>().coeffs();
  if (q0.dot(q1) < 0.0) q1 = -q1;
  const Eigen::Quaterniond q(Eigen::Vector4d(((1.0 - t) * q0 + t * q1).normalized()));
  const Eigen::Vector3d local =
      q.toRotationMatrix().transpose() *
      (mix(target.from, target.to, t) - mix(before.centre, now.centre, t));
  double squared = 0.0;
  for (int axis = 0; axis < 3; ++axis) {
    const double beyond = std::abs(local[axis]) - static_cast<double>(now.half_size[axis]);
    if (beyond > 0.0) squared += beyond * beyond;
  }
  return std::sqrt(squared) - target.radius;
}

/// Compares with sub-steps so fine that the gap cannot shrink by more than `resolution` in one of
/// them.
template <typename Solid>
void expect_like_substeps(const Solid& before, const Solid& now, const MovingSphere& target,
                          const std::optional<Hit>& hit, int case_number) {
  constexpr int kSteps = 4000;
  double least = std::numeric_limits<double>::infinity();
  double first = -1.0;
  double largest_change = 0.0, last = 0.0;
  for (int i = 0; i <= kSteps; ++i) {
    const double t = static_cast<double>(i) / kSteps;
    const double gap = gap_at(before, now, target, t);
    if (i > 0) largest_change = std::max(largest_change, std::abs(gap - last));
    last = gap;
    least = std::min(least, gap);
    if (first < 0.0 && gap <= 0.0) first = t;
  }
  if (first >= 0.0) {
    ASSERT_TRUE(hit) << case_number;
    EXPECT_LE(hit->time, first + 1e-9) << case_number;
    EXPECT_LE(gap_at(before, now, target, hit->time), kTouch * 1.001) << case_number;
  } else if (hit) {  // a contact between two sub-steps
    EXPECT_LE(least, kTouch + largest_change) << case_number;
    EXPECT_LE(gap_at(before, now, target, hit->time), kTouch * 1.001) << case_number;
  }
}

class Random {
 public:
  float number(double least, double most) {
    return static_cast<float>(least + (most - least) * unit_(engine_));
  }
  Eigen::Vector3f vector(double reach) {
    return {number(-reach, reach), number(-reach, reach), number(-reach, reach)};
  }

 private:
  std::mt19937_64 engine_{7};
  std::uniform_real_distribution<double> unit_{0.0, 1.0};
};

TEST(Colliders, SweptCapsulesAgreeWithFineSubsteps) {
  Random random;
  int hits = 0;
  for (int i = 0; i < 1500; ++i) {
    const Eigen::Vector3f a = random.vector(0.4), b = random.vector(0.4);
    const float speed = i % 3 == 0 ? 0.05F : 1.0F;
    const float radius = random.number(0.03, 0.2);
    const auto before = with_capsule(a, i % 7 == 0 ? a : b, radius);
    const auto now = with_capsule(a + random.vector(speed), b + random.vector(speed), radius);
    const MovingSphere target{random.vector(0.8), random.vector(0.8),
                              i % 2 == 0 ? 0.0F : random.number(0.0, 0.1)};
    const auto hit = first_hit(before, now, target);
    expect_like_substeps(before.capsules[kForearm], now.capsules[kForearm], target, hit, i);
    hits += hit ? 1 : 0;
  }
  EXPECT_GT(hits, 150);
  EXPECT_LT(hits, 1200);
}

TEST(Colliders, SweptBoxesAgreeWithFineSubsteps) {
  Random random;
  int hits = 0;
  for (int i = 0; i < 1000; ++i) {
    BodyColliders before, now;
    const auto turned = [&] {
      Eigen::Vector4f q(random.number(-1, 1), random.number(-1, 1), random.number(-1, 1),
                        random.number(-1, 1));
      return Eigen::Quaternionf(Eigen::Vector4f(q.normalized()));
    };
    now.torso = {random.vector(0.3),
                 turned(),
                 {random.number(0.05, 0.3), random.number(0.05, 0.3), random.number(0.05, 0.3)}};
    before.torso = {random.vector(0.3), i % 2 == 0 ? turned() : now.torso.rotation,
                    now.torso.half_size};
    const MovingSphere target{random.vector(1.0), random.vector(1.0), random.number(0.0, 0.1)};
    const auto hit = first_hit(before, now, target);
    expect_like_substeps(before.torso, now.torso, target, hit, i);
    hits += hit ? 1 : 0;
  }
  EXPECT_GT(hits, 150);
  EXPECT_LT(hits, 900);
}

TEST(Colliders, NothingIsTooFastToBeHit) {
  // A target at 30 m per frame through an arm of 3 cm; then a moving arm and a resting target.
  const auto arm = with_capsule({0, -0.3F, 0}, {0, 0.3F, 0}, 0.03F);
  const auto hit = first_hit(arm, arm, {{-15, 0, 0}, {15, 0, 0}, 0.0F});
  ASSERT_TRUE(hit);
  EXPECT_NEAR(hit->time, (15.0 - 0.03) / 30.0, 1e-5);
  EXPECT_NEAR(hit->point.x(), -0.03, 2e-4);
  EXPECT_EQ(hit->bone, kForearm);
  const auto left = with_capsule({-15, -0.3F, 0}, {-15, 0.3F, 0}, 0.03F);
  const auto right = with_capsule({15, -0.3F, 0}, {15, 0.3F, 0}, 0.03F);
  EXPECT_TRUE(first_hit(left, right, {{0, 0, 0}, {0, 0, 0}, 0.0F}));
  // A target just beside the arm does not hit it.
  EXPECT_FALSE(first_hit(arm, arm, {{-15, 0, 0.0302F}, {15, 0, 0.0302F}, 0.0F}));
  EXPECT_TRUE(first_hit(arm, arm, {{-15, 0, 0.0299F}, {15, 0, 0.0299F}, 0.0F}));
}

TEST(Colliders, ASwingingForearmHitsWhatLiesInItsSweep) {
  // The hand moves from left to right. The target is between these positions, on the chord of the
  // motion.
  const auto before = with_capsule({0, 0, 2}, {-0.25F, 0, 2}, 0.03F);
  const auto now = with_capsule({0, 0, 2}, {0, -0.25F, 2}, 0.03F);
  const MovingSphere bubble{{-0.12F, -0.12F, 2}, {-0.12F, -0.12F, 2}, 0.02F};
  const auto hit = first_hit(before, now, bubble);
  ASSERT_TRUE(hit);
  EXPECT_GT(hit->time, 0.1);
  EXPECT_LT(hit->time, 0.5);
}

TEST(Colliders, TheEarliestThenTheLowestBoneIsHit) {
  BodyColliders body = with_capsule({0, 0, 0}, {0, 1, 0}, 0.1F);
  body.capsules[2] = {{0.5F, 0, 0}, {0.5F, 1, 0}, 0.1F};
  EXPECT_EQ(first_hit(body, body, {{1, 0.5F, 0}, {-1, 0.5F, 0}, 0})->bone, 2);
  EXPECT_EQ(first_hit(body, body, {{-1, 0.5F, 0}, {1, 0.5F, 0}, 0})->bone, kForearm);
  body.capsules[2] = body.capsules[kForearm];
  EXPECT_EQ(first_hit(body, body, {{-1, 0.5F, 0}, {1, 0.5F, 0}, 0})->bone, 2);
  body.torso = {{0, 0.5F, 0}, Eigen::Quaternionf::Identity(), {0.1F, 0.5F, 0.1F}};
  EXPECT_EQ(first_hit(body, body, {{-1, 0.5F, 0}, {1, 0.5F, 0}, 0})->bone, kTorsoHit);
  const auto inside = first_hit(body, body, {{0, 0.5F, 0}, {5, 5, 5}, 0});
  EXPECT_EQ(inside->time, 0.0);
}

TEST(Colliders, WhatIsNotFiniteTouchesNothing) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinity = std::numeric_limits<float>::infinity();
  const auto arm = with_capsule({0, -0.3F, 0}, {0, 0.3F, 0}, 0.03F);
  for (const float bad : {nan, infinity, -infinity, 1e30F}) {
    EXPECT_FALSE(first_hit(arm, arm, {{bad, 0, 0}, {1, 0, 0}, 0.01F}));
    EXPECT_FALSE(first_hit(arm, arm, {{-1, 0, 0}, {1, bad, 0}, 0.01F}));
    EXPECT_FALSE(first_hit(arm, with_capsule({0, bad, 0}, {0, 1, 0}, 0.03F),
                           {{-1, 0, 0}, {1, 0, 0}, 0.01F}));
  }
  EXPECT_FALSE(first_hit(arm, arm, {{-1, 0, 0}, {1, 0, 0}, nan}));
  EXPECT_FALSE(first_hit(arm, arm, {{-1, 0, 0}, {1, 0, 0}, infinity}));
  const auto endless = with_capsule({0, -0.3F, 0}, {0, 0.3F, 0}, infinity);
  EXPECT_FALSE(first_hit(endless, endless, {{-1, 0, 0}, {1, 0, 0}, 0.01F}));
}

Skeleton standing() {
  Skeleton skeleton;
  skeleton.states.fill(TrackingState::kTracked);
  const auto put = [&](Joint joint, float x, float y) {
    skeleton.positions[static_cast<std::size_t>(joint)] = {x, y, 2.0F};
  };
  using enum Joint;
  put(kSpineBase, 0, 0);
  put(kSpineMid, 0, -0.25F);
  put(kSpineShoulder, 0, -0.5F);
  put(kNeck, 0, -0.55F);
  put(kHead, 0, -0.7F);
  for (const float side : {1.0F, -1.0F}) {
    const bool left = side > 0;
    put(left ? kShoulderLeft : kShoulderRight, 0.2F * side, -0.45F);
    put(left ? kElbowLeft : kElbowRight, 0.25F * side, -0.2F);
    put(left ? kWristLeft : kWristRight, 0.3F * side, 0);
    put(left ? kHandLeft : kHandRight, 0.3F * side, 0.08F);
    put(left ? kHandTipLeft : kHandTipRight, 0.3F * side, 0.15F);
    put(left ? kThumbLeft : kThumbRight, 0.25F * side, 0.08F);
    put(left ? kHipLeft : kHipRight, 0.1F * side, 0);
    put(left ? kKneeLeft : kKneeRight, 0.1F * side, 0.45F);
    put(left ? kAnkleLeft : kAnkleRight, 0.1F * side, 0.85F);
    put(left ? kFootLeft : kFootRight, 0.1F * side, 0.9F);
  }
  return skeleton;
}

TEST(ColliderTracker, RadiiAreThePercentileOfABonesPointsAveraged) {
  ColliderTracker tracker;
  // 100 points from 1 to 100 mm: 90 of them lie within 90 mm.
  std::vector<std::uint8_t> label(100, kForearm);
  std::vector<float> squared(100);
  for (std::size_t i = 0; i < 100; ++i) {
    const float metres = 0.001F * static_cast<float>(i + 1) - 0.0002F;
    squared[99 - i] = metres * metres;
  }
  tracker.update(standing(), label, squared);
  EXPECT_FLOAT_EQ(tracker.now().capsules[kForearm].radius, 0.09F);
  EXPECT_FLOAT_EQ(tracker.now().capsules[10].radius, 0.09F) << "the other arm has no points";
  EXPECT_FLOAT_EQ(tracker.now().capsules[13].radius, 0.05F) << "a leg had none yet";
  for (float& value : squared) value = 0.05F * 0.05F;
  tracker.update(standing(), label, squared);
  EXPECT_NEAR(tracker.now().capsules[kForearm].radius, 0.5F * (0.09F + 0.05F), 0.6e-3F);
  tracker.update(standing(), std::span(label).first(19), std::span(squared).first(19));
  EXPECT_NEAR(tracker.now().capsules[kForearm].radius, 0.07F, 0.6e-3F) << "too few points";
  for (int i = 0; i < 30; ++i) tracker.update(standing(), label, squared);
  EXPECT_NEAR(tracker.now().capsules[kForearm].radius, 0.05F, 1.1e-3F) << "30 frames later";
  for (const auto& [metres, radius] : {std::pair{0.001F, 0.03F}, {2.0F, 0.2F}}) {
    tracker.reset();
    for (float& value : squared) value = metres * metres;
    tracker.update(standing(), label, squared);
    EXPECT_FLOAT_EQ(tracker.now().capsules[kForearm].radius, radius);
  }
}

TEST(ColliderTracker, EveryBoneIsCoveredAndLostJointsAreNot) {
  ColliderTracker tracker;
  Skeleton skeleton = standing();
  tracker.update(skeleton, {}, {});
  for (std::size_t bone = 1; bone < kNumJoints; ++bone) {
    EXPECT_EQ(tracker.now().capsules[bone].radius > 0.0F, !is_torso_bone(bone)) << bone;
  }
  const Capsule& head = tracker.now().capsules[3];
  EXPECT_EQ(head.start, head.end);
  const ColliderBox& torso = tracker.now().torso;
  EXPECT_TRUE(torso.half_size.isApprox(Eigen::Vector3f(0.2F, 0.25F, 0.05F), 1e-5F));
  EXPECT_TRUE(torso.centre.isApprox(Eigen::Vector3f(0, -0.25F, 2), 1e-6F));
  // Left is x, up is -y, hence ahead is -z: towards the camera.
  EXPECT_NEAR((torso.rotation * Eigen::Vector3f::UnitZ()).z(), -1.0F, 1e-6F);

  skeleton.positions[5].x() = std::numeric_limits<float>::quiet_NaN();
  skeleton.states[13] = TrackingState::kNotTracked;
  skeleton.states[16] = TrackingState::kNotTracked;
  tracker.update(skeleton, {}, {});
  for (const std::size_t bone : {5U, 6U, 13U, 14U, 17U}) {
    EXPECT_EQ(tracker.now().capsules[bone].radius, 0.0F) << bone;
  }
  EXPECT_GT(tracker.now().capsules[7].radius, 0.0F);
  EXPECT_EQ(tracker.now().torso.half_size.x(), 0.0F);
  EXPECT_GT(tracker.before().capsules[5].radius, 0.0F);
}

TEST(ColliderTracker, FramesAndHitsAllocateNothing) {
  if (!testing::kCountsAllocations) GTEST_SKIP() << "the sanitizer has operators of its own";
  ColliderTracker tracker;
  const Skeleton skeleton = standing();
  const std::vector<std::uint8_t> label(15000, kForearm);
  const std::vector<float> squared(15000, 0.002F);
  tracker.update(skeleton, label, squared);
  int hits = 0;
  const std::int64_t before = testing::num_allocations();
  for (int frame = 0; frame < 100; ++frame) {
    tracker.update(skeleton, label, squared);
    const float x = 0.01F * static_cast<float>(frame);
    hits += first_hit(tracker.before(), tracker.now(), {{x, 0, 0}, {0, -0.2F, 4}, 0.02F}) ? 1 : 0;
  }
  EXPECT_EQ(testing::num_allocations(), before);
  EXPECT_GT(hits, 50);
}

TEST(ColliderTracker, WrongOptionsAreRefused) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(ColliderTracker({.percentile = nan}), InputError);
  EXPECT_THROW(ColliderTracker({.frames = 0}), InputError);
  EXPECT_THROW(ColliderTracker({.min_points = 0}), InputError);
  EXPECT_THROW(ColliderTracker({.min_radius = 0.3}), InputError);
  EXPECT_THROW(ColliderTracker({.max_radius = nan}), InputError);
  ColliderTracker tracker;
  const std::vector<std::uint8_t> label(3);
  EXPECT_THROW(tracker.update(standing(), label, {}), InputError);
}

}  // namespace
}  // namespace manip3d
