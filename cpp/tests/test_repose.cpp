#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/modify/repose.hpp"

namespace manip3d {
namespace {

constexpr double kDegrees = 3.14159265358979323846 / 180.0;
constexpr std::size_t kElbow = 5, kWrist = 6, kHand = 7, kHip = 12, kKnee = 13;

/// A person who stands before the camera: x to the person's left, y down, z away.
Skeleton standing() {
  Skeleton skeleton;
  skeleton.states.fill(TrackingState::kTracked);
  const auto put = [&](Joint joint, float x, float y, float z = 2.0F) {
    skeleton.positions[static_cast<std::size_t>(joint)] = {x, y, z};
  };
  using enum Joint;
  put(kSpineBase, 0, 0);
  put(kSpineMid, 0, -0.25F);
  put(kSpineShoulder, 0, -0.5F);
  put(kNeck, 0, -0.55F);
  put(kHead, 0, -0.7F);
  for (const float side : {1.0F, -1.0F}) {
    const bool left = side > 0;
    put(left ? kShoulderLeft : kShoulderRight, 0.2F * side, -0.5F);
    put(left ? kElbowLeft : kElbowRight, 0.2F * side, -0.2F);
    put(left ? kWristLeft : kWristRight, 0.2F * side, 0.05F);
    put(left ? kHandLeft : kHandRight, 0.2F * side, 0.13F);
    put(left ? kHandTipLeft : kHandTipRight, 0.2F * side, 0.2F);
    put(left ? kThumbLeft : kThumbRight, 0.2F * side, 0.1F, 1.95F);
    put(left ? kHipLeft : kHipRight, 0.1F * side, 0);
    put(left ? kKneeLeft : kKneeRight, 0.1F * side, 0.45F);
    put(left ? kAnkleLeft : kAnkleRight, 0.1F * side, 0.85F);
    put(left ? kFootLeft : kFootRight, 0.1F * side, 0.85F, 1.8F);
  }
  return skeleton;
}

/// The standing skeleton with the left forearm and hand bent forwards (towards the camera).
Skeleton with_elbow_at(double degrees) {
  Skeleton skeleton = standing();
  const Eigen::Vector3f elbow = skeleton.positions[kElbow];
  const Eigen::AngleAxisf turn(static_cast<float>(degrees * kDegrees), -Eigen::Vector3f::UnitX());
  for (const std::size_t joint : {6U, 7U, 21U, 22U}) {
    skeleton.positions[joint] = elbow + turn * (skeleton.positions[joint] - elbow);
  }
  return skeleton;
}

double angle_at(const Skeleton& skeleton, std::size_t start, std::size_t middle, std::size_t end) {
  const Eigen::Vector3d a = (skeleton.positions[middle] - skeleton.positions[start]).cast<double>();
  const Eigen::Vector3d b = (skeleton.positions[end] - skeleton.positions[middle]).cast<double>();
  return std::atan2(a.cross(b).norm(), a.dot(b)) / kDegrees;
}

/// A closed tube around the line through some joints, in rings of 16 every 5 mm.
struct Tube {
  std::vector<double> vertices;
  std::vector<std::pair<std::size_t, std::size_t>> edges;

  static constexpr std::size_t kRing = 16;
  Tube(const Skeleton& skeleton, std::initializer_list<std::size_t> joints, double radius) {
    std::size_t last = *joints.begin();
    for (const std::size_t joint : joints) {
      const Eigen::Vector3d from = skeleton.positions[last].cast<double>();
      const Eigen::Vector3d to = skeleton.positions[joint].cast<double>();
      const int steps = static_cast<int>((to - from).norm() / 0.005);
      for (int step = 0; step < steps; ++step) {
        add_ring(from + (to - from) * step / steps, to - from, radius);
      }
      last = joint;
    }
  }

  void add_ring(const Eigen::Vector3d& centre, const Eigen::Vector3d& along, double radius) {
    const Eigen::Vector3d side = Eigen::Vector3d::UnitX();
    const Eigen::Vector3d other = along.cross(side).normalized();
    const std::size_t first = vertices.size() / 3;
    for (std::size_t i = 0; i < kRing; ++i) {
      const double angle = 2.0 * 180.0 * kDegrees * static_cast<double>(i) / kRing;
      const Eigen::Vector3d p =
          centre + radius * (std::cos(angle) * side + std::sin(angle) * other);
      vertices.insert(vertices.end(), {p.x(), p.y(), p.z()});
      edges.emplace_back(first + i, first + (i + 1) % kRing);
      if (first > 0) edges.emplace_back(first + i - kRing, first + i);
    }
  }

  [[nodiscard]] std::vector<double> reposed(const Skeleton& skeleton,
                                            const ReposeOptions& options) const {
    const auto motions = amplify(skeleton, nullptr, options);
    std::vector<double> out(vertices.size());
    repose_vertices(vertices.data(), static_cast<std::int64_t>(vertices.size() / 3), skeleton,
                    *motions, options, out.data());
    return out;
  }

  [[nodiscard]] double length(const std::vector<double>& of, std::size_t edge) const {
    const Eigen::Map<const Eigen::Vector3d> a(of.data() + 3 * edges[edge].first);
    const Eigen::Map<const Eigen::Vector3d> b(of.data() + 3 * edges[edge].second);
    return (a - b).norm();
  }

  /// The stretch of the edge that is stretched most.
  [[nodiscard]] double stretch(const std::vector<double>& after) const {
    double most = 0.0;
    for (std::size_t edge = 0; edge < edges.size(); ++edge) {
      // Edges within the bend may be short before the motion.
      most = std::max(most, length(after, edge) / std::max(length(vertices, edge), 0.004));
    }
    return most;
  }
};

TEST(Repose, GainOneKeepsEveryBit) {
  std::mt19937_64 engine(3);
  std::normal_distribution<double> noise(0.0, 0.7);
  const Skeleton skeleton = with_elbow_at(40);
  std::vector<float> vertices(3 * 5000);
  for (float& value : vertices) value = static_cast<float>(noise(engine));
  vertices[7] = std::numeric_limits<float>::quiet_NaN();
  for (const bool blended : {true, false}) {
    ReposeOptions options;
    options.blended = blended;
    const auto motions = amplify(skeleton, nullptr, options);
    ASSERT_TRUE(motions);
    for (const bool moves : motions->moves) EXPECT_FALSE(moves);
    std::vector<float> out(vertices.size());
    repose_vertices(vertices.data(), 5000, skeleton, *motions, options, out.data());
    EXPECT_EQ(std::memcmp(out.data(), vertices.data(), out.size() * sizeof(float)), 0);
    const Skeleton moved = move_skeleton(skeleton, *motions);
    EXPECT_EQ(
        std::memcmp(moved.positions.data(), skeleton.positions.data(), sizeof moved.positions), 0);
  }
}

TEST(Repose, GainsMultiplyAnglesAndLimitsClampThem) {
  const Skeleton skeleton = with_elbow_at(30);
  EXPECT_NEAR(angle_at(skeleton, 4, 5, 6), 30, 1e-3);
  struct Case {
    double gain, limit, angle;
  };
  for (const Case& c : {Case{2, 180, 60}, {0.5, 180, 15}, {0, 180, 0}, {3, 75, 75}, {1, 20, 20}}) {
    ReposeOptions options;
    options.gain[kElbow] = c.gain;
    options.limit[kElbow] = c.limit * kDegrees;
    const auto motions = amplify(skeleton, nullptr, options);
    const Skeleton moved = move_skeleton(skeleton, *motions);
    EXPECT_NEAR(angle_at(moved, 4, 5, 6), c.angle, 1e-3);
    EXPECT_NEAR(angle_at(moved, 5, 6, 7), 0, 0.05) << "the hand goes with the forearm";
    // Bent forwards, the wrist is nearer to the camera than the elbow.
    EXPECT_NEAR(moved.positions[kWrist].z(), 2.0 - 0.25 * std::sin(c.angle * kDegrees), 1e-5);
    EXPECT_NEAR(moved.positions[kWrist].y(), -0.2 + 0.25 * std::cos(c.angle * kDegrees), 1e-5);
    EXPECT_EQ(moved.positions[kElbow], skeleton.positions[kElbow]);
    EXPECT_EQ(moved.positions[10], skeleton.positions[10]) << "the other arm";
  }
}

TEST(Repose, JointsAddUpAndBonesKeepTheirLengths) {
  std::mt19937_64 engine(11);
  std::normal_distribution<float> noise(0.0F, 0.05F);
  std::uniform_real_distribution<double> gain(0.0, 2.5);
  for (int i = 0; i < 200; ++i) {
    Skeleton skeleton = with_elbow_at(50);
    for (Eigen::Vector3f& p : skeleton.positions) {
      p += Eigen::Vector3f(noise(engine), noise(engine), noise(engine));
    }
    ReposeOptions options;
    for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
      if (is_posable(joint)) options.gain[joint] = gain(engine);
    }
    const Skeleton moved = move_skeleton(skeleton, *amplify(skeleton, nullptr, options));
    for (std::size_t bone = 1; bone < kNumJoints; ++bone) {
      const std::size_t parent = kJointParents[bone];
      EXPECT_NEAR((moved.positions[bone] - moved.positions[parent]).norm(),
                  (skeleton.positions[bone] - skeleton.positions[parent]).norm(), 1e-6);
    }
  }
}

TEST(Repose, TheWholePersonMayTurn) {
  const Skeleton skeleton = with_elbow_at(35);
  const Eigen::Quaternionf turn(Eigen::AngleAxisf(0.8F, Eigen::Vector3f(1, -2, 0.5F).normalized()));
  const Eigen::Vector3f shift(0.3F, -0.2F, 1.0F);
  Skeleton turned = skeleton;
  for (Eigen::Vector3f& p : turned.positions) p = turn * p + shift;
  ReposeOptions options;
  options.gain[4] = 1.7;
  options.gain[kElbow] = 1.5;
  options.gain[kHip] = 2.0;
  options.limit[kKnee] = 0.1;
  const Skeleton expected = move_skeleton(skeleton, *amplify(skeleton, nullptr, options));
  const Skeleton got = move_skeleton(turned, *amplify(turned, nullptr, options));
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    EXPECT_LT((got.positions[joint] - (turn * expected.positions[joint] + shift)).norm(), 1e-5F);
  }
}

TEST(Repose, RestMayBeASkeleton) {
  const Skeleton now = with_elbow_at(50), rest = with_elbow_at(20);
  ReposeOptions options;
  options.gain[kElbow] = 2.0;
  EXPECT_NEAR(angle_at(move_skeleton(now, *amplify(now, &rest, options)), 4, 5, 6), 80, 1e-3);
  const auto still = amplify(now, &now, options);
  EXPECT_NEAR(angle_at(move_skeleton(now, *still), 4, 5, 6), 50, 1e-3);
  Skeleton without = rest;
  without.states[0] = TrackingState::kNotTracked;
  EXPECT_FALSE(amplify(now, &without, options));
  EXPECT_FALSE(amplify(without, nullptr, options));
  without = now;
  without.positions[kWrist].x() = std::numeric_limits<float>::infinity();
  EXPECT_FALSE(amplify(without, nullptr, options)->moves[kHand]) << "no angle at the elbow";
}

TEST(Repose, RigidVerticesTurnAboutTheirJoint) {
  const Skeleton skeleton = with_elbow_at(30);
  ReposeOptions options;
  options.gain[kElbow] = 2.0;
  options.blended = false;
  const Tube tube(skeleton, {4, 5, 6}, 0.04);
  const auto out = tube.reposed(skeleton, options);
  const Eigen::Vector3d elbow = skeleton.positions[kElbow].cast<double>();
  const Eigen::AngleAxisd turn(30 * kDegrees, -Eigen::Vector3d::UnitX());
  int moved = 0, stayed = 0;
  for (std::size_t i = 0; i < out.size(); i += 3) {
    const Eigen::Map<const Eigen::Vector3d> from(tube.vertices.data() + i), to(out.data() + i);
    const Eigen::Vector3d rigid = elbow + turn * (from - elbow);
    if (to == from) {
      ++stayed;
    } else {
      EXPECT_LT((to - rigid).norm(), 1e-6);
      ++moved;
    }
  }
  EXPECT_GT(moved, 700);
  EXPECT_GT(stayed, 800);
}

TEST(Repose, BlendedJointsDoNotTear) {
  for (const double bend : {0.0, 20.0, 45.0, 80.0}) {
    const Skeleton skeleton = with_elbow_at(bend);
    const Tube tube(skeleton, {4, 5, 6}, 0.04);
    ReposeOptions options;
    // At rest the arm is bent by 45 degrees the other way. The gain adds 45 degrees for every bend.
    Skeleton rest = with_elbow_at(-45);
    options.gain[kElbow] = (bend + 90) / (bend + 45);
    const auto motions = amplify(skeleton, &rest, options);
    const Skeleton moved = move_skeleton(skeleton, *motions);
    EXPECT_NEAR(angle_at(moved, 4, 5, 6), bend + 45, 0.01);
    double stretch[2];
    for (const bool blended : {true, false}) {
      options.blended = blended;
      std::vector<double> out(tube.vertices.size());
      repose_vertices(tube.vertices.data(), static_cast<std::int64_t>(out.size() / 3), skeleton,
                      *motions, options, out.data());
      stretch[blended ? 0 : 1] = tube.stretch(out);
    }
    EXPECT_LT(stretch[0], 2.5) << bend;
    EXPECT_GT(stretch[1], 4.0) << bend << ": rigid, the skin opens at the elbow";
  }
}

TEST(Repose, FarFromJointsBlendedVerticesMoveRigidly) {
  const Skeleton skeleton = with_elbow_at(30);
  ReposeOptions options;
  options.gain[kElbow] = 2.0;
  const auto motions = amplify(skeleton, nullptr, options);
  // A point on the middle of the forearm, one on the upper arm, and the hip beside the hand.
  const Eigen::Vector3d middle =
      0.5 * (skeleton.positions[kElbow] + skeleton.positions[kWrist]).cast<double>();
  const std::vector<double> points = {
      middle.x() + 0.04, middle.y(), middle.z(), 0.24, -0.4, 2.0, 0.14, 0.02, 2.0};
  std::vector<double> out(points.size());
  repose_vertices(points.data(), 3, skeleton, *motions, options, out.data());
  const Eigen::Vector3d elbow = skeleton.positions[kElbow].cast<double>();
  const Eigen::AngleAxisd turn(30 * kDegrees, -Eigen::Vector3d::UnitX());
  const Eigen::Vector3d expected = elbow + turn * (Eigen::Vector3d(points.data()) - elbow);
  EXPECT_LT((Eigen::Vector3d(out.data()) - expected).norm(), 1e-6);
  EXPECT_EQ(std::memcmp(out.data() + 3, points.data() + 3, 6 * sizeof(double)), 0);
}

TEST(Repose, AHandAtTheHipDoesNotPullAtTheHip) {
  const Skeleton skeleton = standing();  // hands hang 10 cm beside the hips
  Skeleton rest = with_elbow_at(-45);
  ReposeOptions options;
  options.gain[kElbow] = 2.0;
  const auto motions = amplify(skeleton, &rest, options);
  EXPECT_TRUE(motions->moves[kHand]);
  // Points that are nearer to the hip's bones by less than the width of the blend.
  const std::vector<double> hip = {0.145, 0.05, 2.0, 0.13, 0.1, 1.95};
  std::vector<double> out(hip.size());
  repose_vertices(hip.data(), 2, skeleton, *motions, options, out.data());
  EXPECT_EQ(std::memcmp(out.data(), hip.data(), hip.size() * sizeof(double)), 0);
}

TEST(Repose, AnyNumberOfThreadsGivesTheSameBits) {
  const Skeleton skeleton = with_elbow_at(30);
  const Tube tube(skeleton, {4, 5, 6, 7, 21}, 0.05);
  ReposeOptions options;
  options.gain[kElbow] = 2.0;
  options.gain[kWrist] = 0.3;
  options.num_threads = 1;
  const auto one = tube.reposed(skeleton, options);
  for (const int threads : {2, 4}) {
    options.num_threads = threads;
    EXPECT_EQ(one, tube.reposed(skeleton, options));
  }
}

TEST(Repose, WrongOptionsAreRefused) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto with = [](auto&& change) {
    ReposeOptions options;
    change(options);
    return amplify(standing(), nullptr, options);
  };
  EXPECT_THROW((void)with([&](ReposeOptions& o) { o.gain[kElbow] = nan; }), InputError);
  EXPECT_THROW((void)with([&](ReposeOptions& o) { o.gain[kElbow] = -1; }), InputError);
  EXPECT_THROW((void)with([&](ReposeOptions& o) { o.limit[kElbow] = nan; }), InputError);
  EXPECT_THROW((void)with([&](ReposeOptions& o) { o.gain[0] = 2; }), InputError);
  EXPECT_THROW((void)with([&](ReposeOptions& o) { o.limit[20] = 0.1; }), InputError);
  ReposeOptions options;
  options.band = nan;
  const double point[3] = {0, 0, 2};
  double out[3];
  EXPECT_THROW(repose_vertices(point, 1, standing(), BoneMotions(), options, out), InputError);
}

}  // namespace
}  // namespace manip3d
