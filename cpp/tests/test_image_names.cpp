#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <vector>

#include "capture/image_names.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

using Names = std::vector<std::string>;
using Indices = std::vector<std::int64_t>;

/// Names of the numbers from `first` to `last` without those of `lost`.
Names numbered(std::int64_t first, std::int64_t last, const Indices& lost = {},
               const std::string& before = "") {
  Names names;
  for (std::int64_t n = first; n <= last; ++n) {
    if (std::ranges::find(lost, n) == lost.end()) names.push_back(before + std::to_string(n));
  }
  return names;
}

Indices in_order(std::int64_t count) {
  Indices indices(static_cast<std::size_t>(count));
  for (std::int64_t i = 0; i < count; ++i) indices[i] = i;
  return indices;
}

TEST(ImageNames, DecimalNumbersAreInTheOrderOfTheirValues) {
  const Names order = {"0.25.png",  "0.5.png",       "00.75.png", "1.03333.png", "1.1.png",
                       "1.10.png",  "1.2.png",       "2.0.png",   "10.5.jpg",    "a1.9.png",
                       "a1.10.png", "v1.2.3.10.png", "v1.2.10.9"};
  for (std::size_t i = 0; i < order.size(); ++i) {
    for (std::size_t k = 0; k < order.size(); ++k) {
      EXPECT_EQ(comes_before(order[i], order[k], true), i < k) << order[i] << " " << order[k];
    }
  }
  EXPECT_TRUE(comes_before("1.9.10.png", "1.10.9.png", true));  // no decimal number
  EXPECT_TRUE(comes_before("1.9.3ds", "1.10.3ds", true));
  EXPECT_TRUE(comes_before("1.9", "1.10", true));
  EXPECT_TRUE(comes_before("1.9.png", "1.10.png", false));
}

TEST(ImageNames, NumbersOfTakesAndFramesAreNoDecimals) {
  EXPECT_TRUE(has_decimals({"0.0", "0.03333", "0.1", "0.13333", "0.2"}));  // Python's floats
  EXPECT_TRUE(has_decimals({"1700000000.5", "1700000001.0"}));
  EXPECT_TRUE(has_decimals({"depth_7.100", "depth_7.120"}));
  EXPECT_FALSE(has_decimals(numbered(1, 12, {}, "1.")));
  EXPECT_FALSE(has_decimals(numbered(1, 9, {}, "1.")));
  EXPECT_FALSE(has_decimals(numbered(1, 120, {}, "1.")));
  EXPECT_FALSE(has_decimals({"1700000000.5", "1700000000.30"}));  // seconds.nanoseconds
  EXPECT_FALSE(has_decimals({"1", "a", ""}));
  EXPECT_EQ(with_whole_numbers({"1.9", "a1.10.b"}), (Names{"1 9", "a1 10.b"}));
  EXPECT_EQ(with_whole_numbers({"1.900", "1.100"}), (Names{"1.900", "1.100"}));
}

TEST(ImageNames, TheOrderOfNamesIsStrict) {
  const Names names = {"1.5.png", "1.5a.png", "1.25.png", "1.30.2.png",
                       "1.5",     "1..png",   "1.png",    "01.5.png"};
  for (const std::string& a : names) {
    EXPECT_FALSE(comes_before(a, a, true)) << a;
    for (const std::string& b : names) {
      EXPECT_EQ(comes_before(a, b, true), a != b && !comes_before(b, a, true)) << a << " " << b;
      for (const std::string& c : names) {
        EXPECT_TRUE(!comes_before(a, b, true) || !comes_before(b, c, true) ||
                    comes_before(a, c, true))
            << a << b << c;
      }
    }
  }
}

TEST(ImageNames, DecimalsAreScaledExactly) {
  EXPECT_EQ(scaled_decimal("1305031102.160407", 9), 1'305'031'102'160'407'000);
  EXPECT_EQ(scaled_decimal("0.1234567899", 9), 123'456'789);
  EXPECT_EQ(scaled_decimal("7", 0), 7);
  EXPECT_EQ(scaled_decimal("7.9", 0), 7);
  for (const char* text :
       {"", ".", ".5", "5.", "1.2.3", "-1", "1e3", "1,5", "9223372036.854775808"}) {
    EXPECT_EQ(scaled_decimal(text, 9), std::nullopt) << text;
  }
}

TEST(ImageNames, TimesHaveAFractionOrManyDigits) {
  const auto time = [](const char* name) { return time_in_name(name, ImageKind::kDepth); };
  constexpr std::int64_t kTime = 1'700'000'000'033'330'000;
  EXPECT_EQ(time("1700000000.03333"), kTime);
  EXPECT_EQ(time("depth_1700000000.03333"), kTime);
  EXPECT_EQ(time("1700000000033.33"), kTime);
  EXPECT_EQ(time("1700000000033330"), kTime);
  EXPECT_EQ(time("1700000000033330000"), kTime);
  EXPECT_EQ(time("1700000000033"), kTime / 1'000'000 * 1'000'000);
  EXPECT_EQ(time("0.5"), 500'000'000);
  EXPECT_EQ(time("0.33333333333333331"), 333'333'333);
  EXPECT_EQ(time_in_name("rgb-0.5", ImageKind::kColor), 500'000'000);
  for (const char* name : {"7", "1700000000", "20210304123400", "20210304123400.5", "rgb_0.5",
                           "frame_0.5", "1.5_2", "preview", "", "99999999999999999999999"}) {
    EXPECT_EQ(time(name), std::nullopt) << name;
  }
  EXPECT_FALSE(are_times({}));
  std::vector<std::optional<std::int64_t>> times(10, 1);
  times[3].reset();
  EXPECT_TRUE(are_times(times));
  times[4].reset();
  EXPECT_FALSE(are_times(times));
}

TEST(ImageNames, LostFramesLeaveGaps) {
  EXPECT_EQ(frame_indices(numbered(0, 5, {3})), (Indices{0, 1, 2, 4, 5}));
  EXPECT_EQ(frame_indices(numbered(7, 12, {9, 10}, "img_")), (Indices{0, 1, 4, 5}));
  EXPECT_EQ(frame_indices({"0", "10", "20", "40"}), (Indices{0, 1, 2, 4}));
  EXPECT_EQ(frame_indices({"5"}), Indices{0});
  EXPECT_EQ(frame_indices({}), Indices{});
  // These are no frame numbers: milliseconds, dates, others that do not ascend, and none at all.
  EXPECT_EQ(frame_indices({"0", "33", "67", "100"}), in_order(4));
  EXPECT_EQ(frame_indices({"0", "33", "66", "99", "133"}), in_order(5));
  EXPECT_EQ(frame_indices({"20210304120000", "20210304120001", "20210304120101"}), in_order(3));
  EXPECT_EQ(frame_indices({"0", "1", "2", "90000000"}), in_order(4));
  EXPECT_EQ(frame_indices({"1", "01", "3"}), in_order(3));
  EXPECT_EQ(frame_indices({"a", "b", "d"}), in_order(3));
}

TEST(ImageNames, ImagesArePairedByTheirNumbers) {
  // Depth 3 and colour 7 are lost: equally many, and an order is shifted.
  EXPECT_EQ(pair_by_name(numbered(0, 11, {3}), numbered(0, 11, {7})),
            (Indices{0, 1, 2, 4, 5, 6, -1, 7, 8, 9, 10}));
  EXPECT_EQ(pair_by_name(numbered(0, 11), numbered(0, 11, {7})),
            (Indices{0, 1, 2, 3, 4, 5, 6, -1, 7, 8, 9, 10}));
  EXPECT_EQ(pair_by_name({"4", "2"}, numbered(0, 9)), (Indices{4, 2}));
  EXPECT_EQ(pair_by_name(numbered(0, 10), numbered(1, 10)),
            (Indices{-1, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9}));
}

TEST(ImageNames, NamesAgreeWithoutTheWordsForTheirKinds) {
  const Indices pairs = {0, -1, 2};
  EXPECT_EQ(pair_by_name({"frame-0001.depth", "frame-0002.depth", "frame-0004.depth"},
                         {"frame-1.color", "frame-3.color", "frame-4.color"}),
            pairs);
  EXPECT_EQ(pair_by_name({"Depth_1", "Depth_2", "Depth_4"}, {"rgb_01", "rgb_3", "rgb_4"}), pairs);
  EXPECT_EQ(pair_by_name({"depth1", "depth2", "depth4"}, {"frame1", "frame3", "frame4"}), pairs);
  EXPECT_EQ(pair_by_name({"a", "b", "d"}, {"a", "c", "d"}), pairs);
  EXPECT_EQ(pair_by_name({"a1", "b1"}, {"b1", "a1"}), (Indices{1, 0}));
  EXPECT_EQ(pair_by_name({"1.500", "1.250"}, {"01.250", "01.500"}), (Indices{1, 0}));
  EXPECT_EQ(pair_by_name(numbered(1, 12, {}, "1."), numbered(1, 12, {}, "rgb_1.")), in_order(12));
  EXPECT_EQ(pair_by_name({"1.5", "1.50"}, {"1.50", "1.5"}), (Indices{1, 0}));
  for (const Names& names : {Names{"-1", "0", "1"}, Names{"1", "01", "2"}}) {  // the same keys
    EXPECT_EQ(pair_by_name(names, names), in_order(3));
  }
}

TEST(ImageNames, OtherNumbersAreInOrder) {
  EXPECT_EQ(pair_by_name(numbered(0, 5), numbered(1, 6)), in_order(6));
  EXPECT_EQ(pair_by_name(numbered(1, 6), numbered(0, 5)), in_order(6));
  EXPECT_EQ(pair_by_name(numbered(0, 5), numbered(100, 105)), in_order(6));
  EXPECT_EQ(pair_by_name({"a", "b"}, {"c", "d"}), in_order(2));
  EXPECT_EQ(pair_by_name({"1.5", "2.5"}, {"1.05", "2.05"}), in_order(2));
}

/// These names, each with `before` and `after`.
Names with(const Names& names, const std::string& before, const std::string& after) {
  Names all;
  for (const std::string& name : names) all.push_back(before + name + after);
  return all;
}

TEST(ImageNames, ANumberThatAllNamesHaveIsNoFrameNumber) {
  for (const char* after : {"_640x480", "_20210304", "_cam0"}) {
    const Names depth = with(numbered(0, 5), "", after), color = with(numbered(1, 6), "", after);
    EXPECT_EQ(pair_by_name(depth, color), in_order(6)) << after;
    EXPECT_EQ(pair_by_name(color, depth), in_order(6)) << after;
    EXPECT_EQ(frame_indices(with(numbered(0, 5, {3}), "", after)), (Indices{0, 1, 2, 4, 5}))
        << after;
  }
}

TEST(ImageNames, FewNamesThatAgreeByChanceDoNotHideTheOrder) {
  // SUN3D: the number of the frame, and its time.
  EXPECT_EQ(
      pair_by_name({"1-000000", "2-033369", "3-066738"}, {"1-000000", "2-033900", "3-066100"}),
      in_order(3));
  // Milliseconds since the beginning.
  const Names depth = {"0", "33", "66", "101", "133", "167", "200", "233", "267", "301"};
  Names color = {"0", "38", "71", "104", "138", "171", "206", "238", "271", "304"};
  EXPECT_EQ(pair_by_name(depth, color), in_order(10));
  color[9] = "301";
  EXPECT_THROW(pair_by_name(depth, color), FormatError);
  EXPECT_THROW(pair_by_name(numbered(0, 9), numbered(9, 18)), FormatError);  // frame numbers
}

TEST(ImageNames, ColorOfAHigherRateMayHaveItsOwnCounter) {
  const Names depth = numbered(0, 9);
  EXPECT_EQ(pair_by_name(depth, numbered(0, 10)), in_order(10));
  try {
    pair_by_name(depth, numbered(0, 11));
    FAIL();
  } catch (const FormatError& error) {
    EXPECT_EQ(error.reason(),
              "expected about as many colour as depth images, since both are numbered without gaps "
              "and may have counters of their own, got 12 and 10: remove the colour images that "
              "belong to no depth image");
  }
  EXPECT_EQ(pair_by_name({"0", "2", "4", "6"}, numbered(0, 7)), (Indices{0, 2, 4, 6}));
  EXPECT_EQ(pair_by_name({"1", "2"}, numbered(0, 9)), (Indices{1, 2}));
  EXPECT_EQ(pair_by_name({"0"}, numbered(0, 9)), Indices{0});
}

TEST(ImageNames, UnknownPairsAreRefused) {
  const auto is_refused = [](const Names& depth, const Names& color) {
    EXPECT_THROW(pair_by_name(depth, color), FormatError) << depth.size() << " " << color.size();
  };
  is_refused(numbered(0, 3), numbered(0, 2));         // or colour is slower
  is_refused(numbered(0, 99), numbered(0, 66));       // slower
  is_refused(numbered(2, 6), numbered(1, 5));         // or colour is numbered from 1, depth from 2
  is_refused(numbered(0, 10), numbered(0, 11, {5}));  // or depth has numbers of its own
  is_refused({"0", "1", "2", "3"}, {"0", "2", "4", "6"});  // every second number
  is_refused({"0", "1", "3", "9"}, {"0", "2", "5", "6"});  // few numbers agree
  is_refused({"a", "b"}, {"c"});
  try {
    pair_by_name({"1.1", "1.2"}, {"1.2"});
    FAIL();
  } catch (const FormatError& error) {
    EXPECT_TRUE(error.reason().ends_with("number is 1.1")) << error.reason();
  }
  try {
    pair_by_name({"003", "004"}, {"004"});
    FAIL();
  } catch (const FormatError& error) {
    EXPECT_EQ(error.reason(),
              "expected a colour image of the same number for each depth image, or, if no numbers "
              "agree, as many colour as depth images, got 1 and 2; the first depth image without "
              "one of its number is 003");
  }
  try {
    pair_by_name({"0", "2", "3", "9"}, {"0", "2", "5", "6"});
    FAIL();
  } catch (const FormatError& error) {
    EXPECT_EQ(error.reason(),
              "expected names of depth and colour images of which all agree, or none, got 2 of 4 "
              "that agree: rename the images of one list; the first depth image without one of its "
              "number is 3");
  }
}

}  // namespace
}  // namespace manip3d
