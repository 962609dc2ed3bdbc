#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "manip3d/geometry/skeleton.hpp"
#include "modify/upright.hpp"

namespace manip3d {
namespace {

using enum Joint;
constexpr double kDegree = std::numbers::pi / 180.0;

struct Tilts {
  double spine = 0.0, leg = 0.0;  ///< Degrees, clockwise in the image.
  bool is_seated = false;         ///< The thigh points at the camera.
  double ahead = 0.0;             ///< Degrees: rotation of the whole scene about the image's rows.
  double turn = 0.0;              ///< Degrees: rotation of the body about its own axis.
};

/// A person at 2.5 m; the left leg is the affected one.
Skeleton person_with(const Tilts& tilts) {
  Skeleton person;
  person.states.fill(TrackingState::kTracked);
  const Eigen::Vector3d hips(0.0, 0.0, 2.5);
  const Eigen::AngleAxisd pitch(tilts.ahead * kDegree, Eigen::Vector3d::UnitX());
  const Eigen::AngleAxisd turn(tilts.turn * kDegree, Eigen::Vector3d::UnitY());
  const auto place = [&](Joint joint, double degrees, const Eigen::Vector3d& from_hips) {
    const Eigen::AngleAxisd roll(degrees * kDegree, Eigen::Vector3d::UnitZ());
    const Eigen::Vector3d p = hips + roll * (pitch * (turn * from_hips));
    person.positions[static_cast<std::size_t>(joint)] = p.cast<float>();
  };
  place(kSpineBase, 0.0, {0.0, 0.0, 0.0});
  place(kSpineShoulder, tilts.spine, {0.0, -0.53, 0.0});
  place(kShoulderLeft, tilts.spine, {0.18, -0.5, 0.0});
  place(kShoulderRight, tilts.spine, {-0.18, -0.5, 0.0});
  const double ahead = tilts.is_seated ? -0.42 : 0.0, thigh = tilts.is_seated ? 0.0 : 0.42;
  place(kHipRight, tilts.leg, {-0.09, 0.0, 0.0});
  place(kKneeRight, tilts.leg, {-0.09, thigh, ahead});
  place(kAnkleRight, tilts.leg, {-0.09, thigh + 0.42, ahead});
  return person;
}

Upright after_seconds(double seconds, const Tilts& tilts) {
  constexpr double kStep = 1.0 / 30.0;
  Upright upright;
  for (double t = 0.0; t < seconds; t += kStep) {
    upright.learn(person_with(tilts), Limb::kLeftLeg, t);
  }
  return upright;
}

double roll_of(const Upright& upright) {
  return std::atan2(-upright.down().x(), upright.down().y()) / kDegree;
}

double deviation_of(const Upright& upright) {
  return std::sqrt(upright.covariance()(0, 0)) / kDegree;
}

TEST(Upright, IsAlongTheColumnsUntilSomebodyIsSeen) {
  const Upright upright;
  EXPECT_EQ(upright.down(), Eigen::Vector3d::UnitY());
  EXPECT_EQ(upright.covariance(), Eigen::Matrix3d::Zero());
}

TEST(Upright, FollowsSpineAndLegThatTiltAlike) {
  for (const double roll : {-20.0, -10.0, 8.0, 15.0}) {
    const Upright upright = after_seconds(4.0, {roll, roll});
    EXPECT_NEAR(roll_of(upright), roll, 1.0);
    EXPECT_LT(deviation_of(upright), 2.5);
  }
}

TEST(Upright, IsNotTiltedByAPersonWhoLeansAside) {
  for (const double lean : {-15.0, -8.0, 8.0, 15.0}) {
    EXPECT_LT(std::abs(roll_of(after_seconds(4.0, {lean, 0.0}))), 1.0);
  }
}

TEST(Upright, StaysAlongTheColumnsOfALevelCamera) {
  const Upright upright = after_seconds(4.0, {1.5, -2.0});
  EXPECT_EQ(upright.down(), Eigen::Vector3d::UnitY());
  EXPECT_LT(deviation_of(upright), 1.0);
}

TEST(Upright, DoubtsItselfWhereTheSpineAloneTilts) {
  const double doubt = deviation_of(after_seconds(4.0, {8.0, 8.0, true}));
  const Upright lean = after_seconds(4.0, {10.0, 3.0, true});
  EXPECT_GT(deviation_of(lean), 1.5);
  EXPECT_GT(doubt, 1.0);
}

TEST(Upright, TellsAPitchedCameraByAPersonWhoIsTurned) {
  const Upright upright = after_seconds(4.0, {0.0, 0.0, false, 25.0, 30.0});
  EXPECT_NEAR(std::asin(upright.down().z()) / kDegree, 25.0, 5.0);
  EXPECT_NEAR(roll_of(upright), 0.0, 2.0);
}

TEST(Upright, LearnsNothingOfJointsThatAreGuessed) {
  Skeleton person = person_with({15.0, 15.0});
  person.states.fill(TrackingState::kInferred);
  Upright upright;
  upright.learn(person, Limb::kLeftLeg, 0.0);
  EXPECT_EQ(upright.down(), Eigen::Vector3d::UnitY());
}

}  // namespace
}  // namespace manip3d
