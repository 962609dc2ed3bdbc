#include <gtest/gtest.h>

#include <cstdint>
#include <limits>
#include <vector>

#include "manip3d/modify/segmentation.hpp"

namespace manip3d {
namespace {

TEST(LabelImage, HoldsLabelsAndDistancesOfThePointsAndNothingElsewhere) {
  PersonPoints points;
  points.set_shape(2, 3);
  points.make_room(3);
  // The order of the tiles is not that of the rows. Point 2 has no bone.
  points.count = 3;
  points.pixel = {4, 1, 5};
  points.label = {9, 2, 0};
  constexpr float kFar = std::numeric_limits<float>::infinity();
  points.squared_distance = {0.25F, 4.0F, kFar};
  const LabelImage image = label_image(points);
  EXPECT_EQ(image.labels, (std::vector<std::uint8_t>{0, 2, 0, 0, 9, 0}));
  EXPECT_EQ(image.distances, (std::vector<float>{kFar, 2.0F, kFar, kFar, 0.5F, kFar}));
}

TEST(LabelImage, LeavesOutPointsOfAnEarlierPerson) {
  PersonPoints points;
  points.set_shape(1, 2);
  points.make_room(2);
  points.count = 1;  // memory is kept for two
  points.pixel = {1, 0};
  points.label = {7, 8};
  points.squared_distance = {1.0F, 1.0F};
  EXPECT_EQ(label_image(points).labels, (std::vector<std::uint8_t>{0, 7}));
}

}  // namespace
}  // namespace manip3d
