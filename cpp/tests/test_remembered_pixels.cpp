#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/range_image.hpp"
#include "modify/phantom_image.hpp"

namespace manip3d {
namespace {

/// An image of letters: P is the phantom, B the body, and a dot nothing.
class Picture {
 public:
  explicit Picture(const std::vector<std::string>& rows)
      : rows_(static_cast<std::int64_t>(rows.size())),
        cols_(static_cast<std::int64_t>(rows.front().size())),
        rays_(Intrinsics{cols_, rows_, 100.0, 100.0, 0.0, 0.0, {}, nullptr, false}) {
    const std::size_t size = rows.size() * rows.front().size();
    depth_.resize(size);
    source_depth_.resize(size);
    label_.resize(size);
    kind_.resize(size, PixelKind::kNone);
    source_.resize(2 * size, -1);
    for (std::size_t p = 0; p < size; ++p) {
      const char letter = rows[p / cols_][p % cols_];
      if (letter == '.') continue;
      kind_[p] = letter == 'P' ? PixelKind::kPhantom : PixelKind::kBody;
      depth_[p] = source_depth_[p] = 2.0F + 0.01F * static_cast<float>(p);
      label_[p] = letter == 'P' ? 9 : 2;
      source_[2 * p] = static_cast<std::int32_t>(p);
      source_[2 * p + 1] = 50;
    }
  }
  PhantomImage image() {
    return {rows_,        cols_,          depth_.data(),        label_.data(),
            kind_.data(), source_.data(), source_depth_.data(), nullptr};
  }
  std::vector<std::int32_t> shown() {
    std::vector<std::int32_t> pixels;
    list_phantom({0, 0, cols_, rows_}, image(), pixels);
    return pixels;
  }
  PixelBox remember(const std::vector<std::int32_t>& before) {
    return fill_remembered(before, rays_, image(), fills_);
  }
  [[nodiscard]] std::vector<std::string> letters() const {
    std::vector<std::string> rows(static_cast<std::size_t>(rows_));
    for (std::size_t p = 0; p < kind_.size(); ++p) {
      const PixelKind kind = kind_[p];
      rows[p / cols_] += kind == PixelKind::kNone     ? '.'
                         : kind == PixelKind::kBody   ? 'B'
                         : kind == PixelKind::kFilled ? 'F'
                                                      : 'P';
    }
    return rows;
  }

  std::vector<float> depth_, source_depth_;
  std::vector<std::uint8_t> label_;
  std::vector<PixelKind> kind_;
  std::vector<std::int32_t> source_;

 private:
  std::int64_t rows_, cols_;
  PixelRays rays_;
  std::vector<HoleFill> fills_;
};

using Rows = std::vector<std::string>;

TEST(RememberedPixels, FillTheRaggedBorder) {
  Picture before({".......",  //
                  "..PPP..",  //
                  ".PPPPP.",  //
                  ".PPPPP.",  //
                  "......."});
  Picture now({".......",  //
               "..P.P..",  //
               ".P.PP..",  //
               ".PPPP..",  //
               "......."});
  const PixelBox box = now.remember(before.shown());
  // Pixels of the last column have two neighbours in each of their rows, and are therefore not
  // filled.
  EXPECT_EQ(now.letters(), (Rows{".......",  //
                                 "..PFP..",  //
                                 ".PFPPF.",  //
                                 ".PPPP..",  //
                                 "......."}));
  EXPECT_EQ(box.u0, 2);
  EXPECT_EQ(box.v0, 1);
  EXPECT_EQ(box.width, 4);
  EXPECT_EQ(box.height, 2);
}

TEST(RememberedPixels, NothingGrowsThatWasNotThere) {
  Picture before({".....", "..P..", ".....", "....."});
  Picture now({".....", ".PPP.", ".PPP.", "....."});
  now.remember(before.shown());
  EXPECT_EQ(now.letters(), (Rows{".....", ".PPP.", ".PPP.", "....."}));
}

TEST(RememberedPixels, TheBodyIsNoNeighbourAndStays) {
  Picture before({"......", ".PPPP.", ".PPPP.", "......"});
  Picture now({"......", ".B.BP.", ".BB.P.", "......"});
  now.remember(before.shown());
  EXPECT_EQ(now.letters(), (Rows{"......", ".B.BP.", ".BB.P.", "......"}));
}

TEST(RememberedPixels, HaveTheMeanDepthOfTheNearestSurface) {
  Picture before({".....", ".PPP.", ".PPP.", "....."});
  Picture now({".....", ".P.P.", ".PPP.", "....."});
  now.depth_[6] = 2.00F;
  now.depth_[8] = 2.04F;
  now.depth_[11] = 2.03F;
  now.depth_[12] = 2.50F;  // another surface
  now.depth_[13] = 2.50F;
  now.remember(before.shown());
  EXPECT_EQ(now.kind_[7], PixelKind::kFilled);
  EXPECT_NEAR(now.depth_[7], (2.00F + 2.04F + 2.03F) / 3.0F, 1e-6F);
  EXPECT_EQ(now.label_[7], 9);
  EXPECT_EQ(now.source_[14], 6);  // from the first neighbour
  EXPECT_EQ(now.source_[15], 50);
  EXPECT_EQ(now.source_depth_[7], now.source_depth_[6]);
}

TEST(RememberedPixels, AtTheImageBorderAreLeft) {
  Picture before({"PPP", "PPP", "PPP"});
  Picture now({".PP", "PPP", "PPP"});
  now.remember(before.shown());
  EXPECT_EQ(now.letters(), (Rows{".PP", "PPP", "PPP"}));
}

}  // namespace
}  // namespace manip3d
