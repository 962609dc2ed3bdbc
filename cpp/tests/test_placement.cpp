#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "manip3d/error.hpp"
#include "manip3d/modify/placement.hpp"

namespace manip3d {
namespace {

/// A person who sits 2 m away and faces the camera; the lower legs hang down.
Skeleton sitting(float knee_height = 0.5F) {
  Skeleton skeleton;
  skeleton.states.fill(TrackingState::kTracked);
  const auto put = [&](Joint joint, float x, float y, float z) {
    skeleton.positions[static_cast<std::size_t>(joint)] = {x, y, z};
  };
  using enum Joint;
  put(kSpineBase, 0.1F, 0, 2);
  put(kSpineShoulder, 0.1F, -0.5F, 2);
  put(kShoulderLeft, 0.3F, -0.45F, 2);
  put(kShoulderRight, -0.1F, -0.45F, 2);
  put(kKneeLeft, 0.2F, 0, 1.6F);
  put(kAnkleLeft, 0.2F, knee_height, 1.6F);
  put(kKneeRight, 0, 0, 1.6F);
  put(kAnkleRight, 0, 0.2F, 1.6F);  // amputated: only the intact leg counts
  return skeleton;
}

TEST(Placement, TargetsStandBeforeTheHipCentreAtAShareOfTheReach) {
  PlacementEstimator estimator;
  const auto& placement = estimator.update(sitting(), true);
  ASSERT_TRUE(placement);
  EXPECT_NEAR(placement->knee_height, 0.5, 1e-6);
  EXPECT_NEAR(placement->reach, 0.5 * 0.491 / 0.246, 1e-6);
  const Eigen::Vector3f centre(0.1F, 0, 2);
  const double distance = 0.9 * placement->reach;
  EXPECT_NEAR((placement->left - centre).norm(), distance, 1e-6);
  EXPECT_NEAR((placement->right - centre).norm(), distance, 1e-6);
  EXPECT_NEAR(placement->left.x() - 0.1, 0.35 * distance, 1e-6);
  EXPECT_NEAR(placement->right.x() - 0.1, -0.35 * distance, 1e-6);
  EXPECT_NEAR(placement->left.y(), 0.0, 1e-6);
  EXPECT_LT(placement->left.z(), 2.0F) << "towards the camera";
  EXPECT_FLOAT_EQ(placement->left.z(), placement->right.z());
}

TEST(Placement, ItFreezesAfterSixtyStableFrames) {
  PlacementEstimator estimator;
  for (int i = 0; i < 59; ++i) {
    EXPECT_FALSE(estimator.update(sitting(0.5F + (i % 2 == 0 ? 0.005F : -0.005F)), true)->frozen);
  }
  EXPECT_TRUE(estimator.update(sitting(0.495F), true)->frozen);
  EXPECT_NEAR(estimator.placement()->knee_height, 0.5, 1e-5);
  EXPECT_NEAR(estimator.update(sitting(0.3F), true)->knee_height, 0.5, 1e-5);
  estimator.reset();
  EXPECT_FALSE(estimator.placement());
  EXPECT_NEAR(estimator.update(sitting(0.3F), true)->knee_height, 0.3, 1e-6);
}

TEST(Placement, WhoMovesStartsAnew) {
  PlacementEstimator estimator;
  for (int i = 0; i < 40; ++i) estimator.update(sitting(), true);
  EXPECT_EQ(estimator.placement()->stable_frames, 40);
  EXPECT_EQ(estimator.update(sitting(0.55F), true)->stable_frames, 1);
  Skeleton moved = sitting(0.55F);
  for (Eigen::Vector3f& position : moved.positions) position.x() += 0.1F;
  EXPECT_EQ(estimator.update(moved, true)->stable_frames, 1);
  EXPECT_EQ(estimator.update(moved, true)->stable_frames, 2);
}

TEST(Placement, FramesWithoutTheLegSayNothing) {
  PlacementEstimator estimator;
  Skeleton skeleton = sitting();
  skeleton.states[14] = TrackingState::kInferred;
  EXPECT_FALSE(estimator.update(skeleton, true));
  EXPECT_NEAR(estimator.update(skeleton, false)->knee_height, 0.2, 1e-6);
  skeleton = sitting();
  skeleton.positions[20].x() = std::numeric_limits<float>::quiet_NaN();
  EXPECT_EQ(estimator.update(skeleton, false)->stable_frames, 1);
}

TEST(Placement, WrongOptionsAreRefused) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(PlacementEstimator({.share = nan}), InputError);
  EXPECT_THROW(PlacementEstimator({.spread = 1.0}), InputError);
  EXPECT_THROW(PlacementEstimator({.stable_frames = 0}), InputError);
  EXPECT_THROW(PlacementEstimator({.tolerance = nan}), InputError);
}

}  // namespace
}  // namespace manip3d
