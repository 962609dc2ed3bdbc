#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"
#include "modify/leg_turn.hpp"

namespace manip3d {
namespace {

using enum Joint;
constexpr double kDegree = 0.017453292519943295;

/// The horizontal axis to the side of a body that is rotated about the vertical by this angle.
Eigen::Vector3d aside(double degrees) {
  return {std::cos(degrees * kDegree), 0.0, std::sin(degrees * kDegree)};
}

/// The horizontal axis forward, towards the camera, which looks along z.
Eigen::Vector3d ahead(double degrees) {
  return {std::sin(degrees * kDegree), 0.0, -std::cos(degrees * kDegree)};
}

BodyFrame trunk_at(double degrees) {
  BodyFrame trunk;
  trunk.origin = {0.0, 0.0, 2.5};
  trunk.n = trunk.x = aside(degrees);
  trunk.y = -Eigen::Vector3d::UnitY();
  trunk.z = trunk.n.cross(trunk.y);
  return trunk;
}

struct Legs {
  Skeleton person;
  PersonPoints points;
};

/// Points along thighs and shins; the left leg is the affected one.
/// @param thigh  forward and downward extent of a thigh, metres.
/// @param right_foot  from the right knee, metres in the body's axes: sideways, down, forward.
/// @param num_points  of each thigh and of each shin.
Legs legs_at(double degrees, const Eigen::Vector2d& thigh,
             const Eigen::Vector3d& right_foot = {0.0, 0.42, 0.0}, int num_points = 200) {
  const Eigen::Vector3d n = aside(degrees), z = ahead(degrees), down = Eigen::Vector3d::UnitY();
  Legs legs;
  legs.person.states.fill(TrackingState::kTracked);
  const auto place = [&](Joint joint, const Eigen::Vector3d& p) {
    legs.person.positions[static_cast<std::size_t>(joint)] = p.cast<float>();
  };
  const auto add = [&](Joint from, Joint to, std::uint8_t label) {
    const Eigen::Vector3f a = legs.person[from], b = legs.person[to];
    for (int i = 0; i < num_points; ++i) {
      const float share = (static_cast<float>(i) + 0.5F) / static_cast<float>(num_points);
      const Eigen::Vector3f p = a + share * (b - a);
      legs.points.x.push_back(p.x());
      legs.points.y.push_back(p.y());
      legs.points.z.push_back(p.z());
      legs.points.label.push_back(label);
      ++legs.points.count;
    }
  };
  for (const bool is_left : {true, false}) {
    const Eigen::Vector3d hip = Eigen::Vector3d(0.0, 0.0, 2.5) + (is_left ? 0.1 : -0.1) * n;
    const Eigen::Vector3d knee = hip + thigh.x() * z + thigh.y() * down;
    const Eigen::Vector3d shin = is_left ? Eigen::Vector3d(0.0, 0.42, 0.0) : right_foot;
    const Eigen::Vector3d ankle = knee + shin.x() * n + shin.y() * down + shin.z() * z;
    const Joint joints[] = {is_left ? kHipLeft : kHipRight, is_left ? kKneeLeft : kKneeRight,
                            is_left ? kAnkleLeft : kAnkleRight, is_left ? kFootLeft : kFootRight};
    place(joints[0], hip);
    place(joints[1], knee);
    place(joints[2], ankle);
    place(joints[3], ankle + 0.15 * z);
    for (std::size_t k = 0; k < 2; ++k) {
      const auto bone = static_cast<std::uint8_t>(joints[k + 1]);
      add(joints[k], joints[k + 1], is_left ? limb_label(Limb::kLeftLeg) : bone);
    }
  }
  return legs;
}

const Eigen::Vector2d kOnSeat(0.42, 0.05), kStanding(0.02, 0.42);

void learn(LegTurn& turn, const Legs& legs, const BodyFrame& trunk) {
  turn.learn(legs.points, legs.person, trunk);
}

/// The angle of the legs' plane, defined as in aside().
double angle_of(const LegTurn& turn, const BodyFrame& trunk) {
  const Eigen::Vector3d n = turn.of(trunk).n;
  return std::atan2(n.z(), n.x()) / kDegree;
}

TEST(LegTurn, IsToldByBothLegs) {
  LegTurn turn(Limb::kLeftLeg);
  const BodyFrame trunk = trunk_at(0.0);
  learn(turn, legs_at(12.0, kOnSeat), trunk);
  EXPECT_NEAR(angle_of(turn, trunk), 12.0, 0.5);  // the trunk's plane is the prior of the fit
  const BodyFrame legs = turn.of(trunk);
  EXPECT_NEAR(legs.n.norm(), 1.0, 1e-12);
  EXPECT_NEAR(legs.n.dot(legs.y), 0.0, 1e-12);
  EXPECT_LT((legs.n.cross(legs.y) - legs.z).norm(), 1e-12);
  turn.reset();
  EXPECT_EQ(turn.of(trunk).n, trunk.n);
}

TEST(LegTurn, TellsNothingByFewPointsOnly) {
  const BodyFrame trunk = trunk_at(0.0);
  for (const int num_points : {40, 59, 60, 99, 101, 118, 119, 201}) {
    LegTurn turn(Limb::kLeftLeg);
    learn(turn, legs_at(12.0, kOnSeat, {0.0, 0.42, 0.0}, num_points), trunk);
    EXPECT_NEAR(angle_of(turn, trunk), num_points < 60 ? 0.0 : 12.0, 0.5) << num_points;
  }
}

TEST(LegTurn, ThePlaneIsShiftedAlongItsOwnNormal) {
  LegTurn turn(Limb::kLeftLeg);
  BodyFrame trunk = trunk_at(0.0);
  trunk.origin += 0.06 * trunk.n;
  learn(turn, legs_at(25.0, kOnSeat), trunk);
  const BodyFrame legs = turn.of(trunk);
  const Eigen::Vector3d shift = legs.origin - trunk.origin;
  EXPECT_LT(shift.dot(legs.n), -0.04);
  EXPECT_LT(shift.cross(legs.n).norm(), 1e-12);
}

TEST(LegTurn, MirrorsOneLegOntoTheOther) {
  LegTurn turn(Limb::kLeftLeg);
  const BodyFrame trunk = trunk_at(5.0);
  const Legs legs = legs_at(25.0, kOnSeat);
  learn(turn, legs, trunk);
  const Mirror mirror = make_mirror(turn.of(trunk), MirrorMode::kReflection);
  const Eigen::Vector3d knee = mirror(legs.person[kKneeRight].cast<double>());
  EXPECT_LT((knee - legs.person[kKneeLeft].cast<double>()).norm(), 0.025);
}

/// Points on the halves of thick legs that a camera at the origin sees, thinned out as by its
/// pixels.
Legs skin_at(double degrees, double bend = 0.0) {
  Legs legs = legs_at(degrees, kOnSeat, {0.0, 0.42 * std::cos(bend), 0.42 * std::sin(bend)});
  const auto bones = std::exchange(legs.points, PersonPoints{});
  const auto add = [&](const Eigen::Vector3d& p, std::uint8_t label) {
    legs.points.x.push_back(static_cast<float>(p.x()));
    legs.points.y.push_back(static_cast<float>(p.y()));
    legs.points.z.push_back(static_cast<float>(p.z()));
    legs.points.label.push_back(label);
    ++legs.points.count;
  };
  constexpr std::int64_t kPart = 200;  // points per bone in legs_at()
  for (std::int64_t i = 0; i < bones.count; ++i) {
    const std::int64_t first = i / kPart * kPart, last = first + kPart - 1;
    const auto at = [&](std::int64_t k) {
      return Eigen::Vector3f(bones.x[k], bones.y[k], bones.z[k]).cast<double>().eval();
    };
    const bool is_thigh = first / kPart % 2 == 0;
    const Eigen::Vector3d along = (at(last) - at(first)).normalized(), u = along.unitOrthogonal();
    constexpr int kAround = 24;
    for (int k = 0; k < kAround; ++k) {
      const double angle = (k + i % 7 / 7.0) * 360.0 / kAround * kDegree;
      const Eigen::Vector3d out = std::cos(angle) * u + std::sin(angle) * along.cross(u);
      const Eigen::Vector3d p = at(i) + (is_thigh ? 0.075 : 0.05) * out;
      const double facing = -out.dot(p.normalized()), dither = (7 * i + 5 * k) % 16 / 16.0;
      if (facing > dither) add(p, bones.label[i]);
    }
  }
  return legs;
}

TEST(LegTurn, IsToldByTheHalfOfTheSkinThatIsSeen) {
  for (const double degrees : {-27.0, -20.0, -12.0, -3.0, 3.0, 12.0, 20.0, 27.0}) {
    LegTurn turn(Limb::kLeftLeg);
    learn(turn, skin_at(degrees), trunk_at(0.0));
    EXPECT_NEAR(angle_of(turn, trunk_at(0.0)), degrees, 1.0) << degrees;
  }
}

TEST(LegTurn, SkinStaysOnTheSeatWhileTheTrunkTurns) {
  LegTurn turn(Limb::kLeftLeg);
  for (int frame = 0; frame < 30; ++frame) {
    const double trunk = frame < 10 ? 0.0 : frame - 10.0;
    learn(turn, skin_at(12.0), trunk_at(-trunk));
  }
  EXPECT_NEAR(angle_of(turn, trunk_at(-19.0)), 12.0, 1.5);
}

TEST(LegTurn, AKneeThatIsBentLessIsNoTurn) {
  for (const double bend : {10.0, 20.0, 30.0}) {
    LegTurn turn(Limb::kLeftLeg);
    learn(turn, skin_at(12.0, bend * kDegree), trunk_at(0.0));
    EXPECT_NEAR(angle_of(turn, trunk_at(0.0)), 12.0, 1.0) << bend;
    EXPECT_NEAR(turn.of(trunk_at(0.0)).n.y(), 0.0, 0.02) << bend;
  }
}

TEST(LegTurn, StaysOnTheSeatWhileTheTrunkTurns) {
  LegTurn turn(Limb::kLeftLeg);
  for (int frame = 0; frame < 30; ++frame) {
    const double trunk = frame < 10 ? 0.0 : frame - 10.0;
    learn(turn, legs_at(12.0, kOnSeat), trunk_at(-trunk));
  }
  EXPECT_NEAR(angle_of(turn, trunk_at(-19.0)), 12.0, 1.5);
}

TEST(LegTurn, TurnsWithTheTrunkWhenTheSeatDoes) {
  LegTurn turn(Limb::kLeftLeg);
  for (int frame = 0; frame < 30; ++frame) {
    const double body = frame < 10 ? 0.0 : frame - 10.0;
    learn(turn, legs_at(12.0 + body, kOnSeat), trunk_at(body));
  }
  EXPECT_NEAR(angle_of(turn, trunk_at(19.0)), 31.0, 1.5);
}

TEST(LegTurn, ALegThatIsStretchedTellsNothing) {
  LegTurn turn(Limb::kLeftLeg);
  const BodyFrame trunk = trunk_at(0.0);
  learn(turn, legs_at(12.0, kOnSeat, {0.0, 0.10, 0.40}), trunk);
  EXPECT_EQ(turn.of(trunk).n, trunk.n);
}

TEST(LegTurn, WhoStandsHasThePlaneOfTheTrunk) {
  LegTurn turn(Limb::kLeftLeg);
  const BodyFrame trunk = trunk_at(0.0);
  learn(turn, legs_at(12.0, kStanding), trunk);
  EXPECT_EQ(turn.of(trunk).n, trunk.n);
  learn(turn, legs_at(12.0, kOnSeat), trunk);
  EXPECT_GT(angle_of(turn, trunk), 10.0);
  learn(turn, legs_at(12.0, kStanding), trunk);
  EXPECT_NEAR(angle_of(turn, trunk), 0.0, 1e-9);
}

TEST(LegTurn, OfALegThatIsGoneIsForgotten) {
  LegTurn turn(Limb::kLeftLeg);
  const BodyFrame trunk = trunk_at(0.0);
  learn(turn, legs_at(12.0, kOnSeat), trunk);
  double before = angle_of(turn, trunk);
  for (int frame = 0; frame < 50; ++frame) {
    turn.lose_trust();
    EXPECT_LE(angle_of(turn, trunk), before);
    before = angle_of(turn, trunk);
  }
  EXPECT_EQ(turn.of(trunk).n, trunk.n);
}

TEST(LegTurn, MissingJointsTellNothing) {
  LegTurn turn(Limb::kLeftLeg);
  const BodyFrame trunk = trunk_at(0.0);
  Legs legs = legs_at(12.0, kOnSeat);
  legs.person.states[static_cast<std::size_t>(kAnkleLeft)] = TrackingState::kNotTracked;
  learn(turn, legs, trunk);
  learn(turn, Legs{}, trunk);
  EXPECT_EQ(turn.of(trunk).n, trunk.n);
}

}  // namespace
}  // namespace manip3d
