#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"
#include "manip3d/modify/mirror.hpp"
#include "manip3d/modify/phantom_pipeline.hpp"
#include "modify/girth.hpp"
#include "modify/phantom_image.hpp"
#include "modify/phantom_quality.hpp"

namespace manip3d {
namespace {

constexpr std::uint8_t kLeftKnee = static_cast<std::uint8_t>(Joint::kKneeLeft);
constexpr std::uint8_t kRightKnee = static_cast<std::uint8_t>(Joint::kKneeRight);

/// A row of points in front of a camera, with the images into which they were drawn and from which
/// they were removed.
struct Row {
  static constexpr std::size_t kCount = 5;
  PersonPoints points;
  std::array<float, kCount> depth{}, source_depth{};
  std::array<std::uint8_t, kCount> label{};
  std::array<PixelKind, kCount> kind{};
  std::array<std::int32_t, 2 * kCount> source{};
  std::array<Removal, kCount> removal{};

  Row() {
    points.resize(1, kCount);
    points.count = 0;
  }
  void add(float x, std::uint8_t bone) {
    const std::int64_t i = points.count++;
    points.x[i] = x;
    points.y[i] = 0.0F;
    points.z[i] = 2.0F;
    points.pixel[i] = static_cast<std::int32_t>(i);
    points.label[i] = bone;
    points.squared_distance[i] = points.skin_distance[i] = 0.0F;
  }
  PhantomImage image() {
    return {1,           kCount,        depth.data(),        label.data(),
            kind.data(), source.data(), source_depth.data(), removal.data()};
  }
};

TEST(PhantomImage, BonesOfALimbAreThoseWhoseParentsLeadToItsRoot) {
  for (std::size_t limb = 0; limb < kNumLimbs; ++limb) {
    const auto root = static_cast<std::size_t>(limb_root(static_cast<Limb>(limb)));
    for (std::size_t bone = 0; bone < kNumJoints; ++bone) {
      bool leads = false;
      for (std::size_t joint = bone; joint != 0 && !leads;) {
        joint = kJointParents[joint];
        leads = joint == root;
      }
      EXPECT_EQ(is_limb_bone(static_cast<Limb>(limb), bone), leads) << limb << ' ' << bone;
    }
  }
}

TEST(PhantomImage, FillsFromTheLimbWithinReachOfTheMirroredSkin) {
  // The thigh of the right leg stands 20 cm to the left of the image's middle and is 8 cm thick:
  // its mirror image about the plane at 1 cm has its skin at 14 cm and at 30 cm.
  BoneSegments bones;
  bones.add({-0.20F, -0.2F, 2.0F}, {-0.20F, 0.2F, 2.0F}, kRightKnee, {0.08F, 0.08F});
  bones.add({0.45F, -0.2F, 2.0F}, {0.45F, 0.2F, 2.0F}, kLeftKnee, {0.08F, 0.08F});
  BodyFrame frame;
  frame.origin = {0.01, 0.0, 2.0};
  frame.n = frame.x = Eigen::Vector3d::UnitX();
  frame.y = -Eigen::Vector3d::UnitY();
  frame.z = frame.n.cross(frame.y);
  const Mirror mirror = make_mirror(frame, MirrorMode::kReflection);
  Row row;
  row.add(0.34F, kLeftKnee);   // 4 cm from the mirrored skin
  row.add(0.37F, kLeftKnee);   // 7 cm
  row.add(0.22F, kLeftKnee);   // inside
  row.add(0.22F, kRightKnee);  // of another bone
  row.add(0.22F, kLeftKnee);   // still visible
  const PhantomImage image = row.image();
  draw_person(row.points, image);
  for (std::int32_t pixel = 0; pixel < 4; ++pixel) take_out(pixel, image);
  EXPECT_EQ(fill_from_limb(row.points, Limb::kLeftLeg, bones, mirror, 0.06, image), 2);
  using enum PixelKind;
  EXPECT_EQ(row.kind, (std::array{kFilled, kNone, kFilled, kNone, kBody}));
  EXPECT_EQ(row.label, (std::array<std::uint8_t, 5>{kLeftKnee, 0, kLeftKnee, 0, kLeftKnee}));
  EXPECT_EQ(row.depth[0], 2.0F);
  EXPECT_EQ(row.source[1], 0);
  EXPECT_EQ(row.source[5], 2);
}

TEST(PhantomImage, FillsBehindAnArmFromTheOtherThigh) {
  BodyFrame frame;
  frame.origin.setZero();
  frame.n = frame.x = Eigen::Vector3d::UnitX();
  frame.y = -Eigen::Vector3d::UnitY();
  frame.z = frame.n.cross(frame.y);
  const Mirror mirror = make_mirror(frame, MirrorMode::kReflection);
  Row row;
  row.add(0.20F, kLeftKnee);
  row.add(0.20F, static_cast<std::uint8_t>(Joint::kAnkleLeft));
  row.add(-0.20F, kRightKnee);  // on the side of the affected arm
  const PhantomImage image = row.image();
  draw_person(row.points, image);
  std::vector<MirroredPoint> mirrored;
  const Eigen::Vector3f shoulder(0.2F, -0.6F, 2.0F);
  const auto around = [&](const BoneSet& behind) {
    mirror_around_root(row.points, shoulder, 0.2, frame, mirror, behind, image, mirrored);
    return mirrored.size();
  };
  EXPECT_EQ(around(bones_behind(Limb::kRightLeg)), 0);
  ASSERT_EQ(around(bones_behind(Limb::kRightArm)), 1);
  EXPECT_FLOAT_EQ(mirrored[0].x, -0.20F);
  EXPECT_EQ(mirrored[0].label, kRightKnee);
  EXPECT_TRUE(mirrored[0].only_removed);
}

/// Assigns a leg of three points to the left leg, whose bone is at x; the plane is at x = 0 and the
/// right leg's bone at -0.3 m. Returns which of the points remain assigned to the left leg.
std::vector<bool> left_with_bone_at(float x, bool is_there = false, bool has_other = false) {
  BoneSegments bones;
  bones.add({x, -0.2F, 2.0F}, {x, 0.2F, 2.0F}, limb_label(Limb::kLeftLeg), {0.08F, 0.08F});
  bones.add({-0.3F, -0.2F, 2.0F}, {-0.3F, 0.2F, 2.0F}, kRightKnee, {0.08F, 0.08F});
  BodyFrame frame;
  frame.origin = {0.0, 0.0, 2.0};
  frame.n = frame.x = Eigen::Vector3d::UnitX();
  frame.y = -Eigen::Vector3d::UnitY();
  frame.z = frame.n.cross(frame.y);
  Row row;
  for (const float at : {0.10F, -0.01F, -0.10F}) row.add(at, limb_label(Limb::kLeftLeg));
  for (int i = 0; i < 2 && has_other; ++i) row.add(-0.30F, kRightKnee);
  const PhantomImage image = row.image();
  draw_person(row.points, image);
  std::vector<std::int32_t> memory(Row::kCount);
  const std::int64_t given =
      keep_to_side(Limb::kLeftLeg, is_there, bones, frame, row.points, image, memory);
  std::vector<bool> left;
  for (std::size_t i = 0; i < 3; ++i) {
    left.push_back(row.points.label[i] == limb_label(Limb::kLeftLeg));
    EXPECT_EQ(row.label[i], row.points.label[i]);
    EXPECT_TRUE(left.back() || row.points.label[i] == kRightKnee);
  }
  EXPECT_EQ(given, std::ranges::count(left, false));
  return left;
}

const std::vector<bool> kOwnSide = {true, false, false}, kAll(3, true);

TEST(PhantomImage, FleshBeyondThePlaneIsTheOtherLegs) {
  EXPECT_EQ(left_with_bone_at(0.1F), kOwnSide);
  EXPECT_EQ(left_with_bone_at(-0.05F), kOwnSide);  // a small error of the joint
}

TEST(PhantomImage, CrossedLegsMayLieBeyondThePlane) { EXPECT_EQ(left_with_bone_at(-0.1F), kAll); }

TEST(PhantomImage, LegsThatBothHaveTheirFleshKeepItWherePlanesAreOff) {
  EXPECT_EQ(left_with_bone_at(-0.05F, true, false), kOwnSide);
  EXPECT_EQ(left_with_bone_at(-0.05F, true, true), kAll);  // one more point, and two to give away
  EXPECT_EQ(left_with_bone_at(-0.05F, false, true), kOwnSide);
}

TEST(PhantomQuality, FleshThatJointsAndPlaneDisagreeAboutCountsAsLeft) {
  BodyFrame frame;
  frame.n = frame.x = Eigen::Vector3d::UnitX();
  frame.origin.setZero();
  PhantomOptions options;
  options.affected = Limb::kLeftLeg;
  PictureJudge judge;
  judge.reserve(1, Row::kCount);
  Row row;
  row.add(-0.3F, kRightKnee);
  const auto left = [&](std::int64_t num_given) {
    PhantomQuality quality;
    judge.measure(row.points, num_given, {}, {}, {}, frame, {}, options, {}, row.image(), quality);
    return quality.left;
  };
  EXPECT_EQ(left(0), 0.0);
  EXPECT_EQ(left(50), 0.2);  // the limb counts as at least 250 pixels
  EXPECT_EQ(left(500), 1.0);
}

}  // namespace
}  // namespace manip3d
