#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <string>

#include "manip3d/authenticate/turns.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

TEST(NumberText, IsTheShortestThatReadsBackAsTheNumber) {
  EXPECT_EQ(number_text(4.0), "4");
  EXPECT_EQ(number_text(0.1), "0.1");
  EXPECT_EQ(number_text(0.1F), "0.1");
  EXPECT_EQ(number_text(1.0 + 1e-9), "1.000000001");
  EXPECT_EQ(number_text(-1e-9), "-1e-09");
  EXPECT_EQ(number_text(1e300), "1e+300");
  EXPECT_EQ(number_text(std::nextafter(1.0, 0.0)), "0.9999999999999999");
  EXPECT_EQ(number_text(-std::numeric_limits<double>::min()), "-2.2250738585072014e-308");
  EXPECT_EQ(number_text(std::numeric_limits<double>::infinity()), "inf");
}

std::string refusal_of(const TurnOptions& options) {
  const Points none(0, 3);
  const PointsView view(PointsView::Map<Points>(none.data(), 0, 3));
  try {
    (void)compare_turns(view, view, view, {}, options);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TEST(TurnOptions, RefusalsNameWhatIsExpected) {
  TurnOptions options;
  options.nearest = 0.0;
  EXPECT_EQ(refusal_of(options), "nearest: expected a number > 0, got 0");
  options = {};
  options.farthest = 3.0;
  EXPECT_EQ(refusal_of(options), "farthest: expected a number > nearest, got 3");
  options = {};
  options.tolerance = 0.0;
  EXPECT_EQ(refusal_of(options), "tolerance: expected a number > 0 that is finite, got 0");
  options = {};
  options.tolerance_share = -0.1;
  EXPECT_EQ(refusal_of(options),
            "tolerance_share: expected a number >= 0 that is finite, got -0.1");
}

}  // namespace
}  // namespace manip3d
