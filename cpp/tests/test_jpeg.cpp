#include <gtest/gtest.h>

#include <vector>

#include "capture/jpeg.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

std::vector<std::uint8_t> gradient(ImageSize size) {
  std::vector<std::uint8_t> color;
  for (std::int64_t v = 0; v < size.rows; ++v) {
    for (std::int64_t u = 0; u < size.cols; ++u) {
      color.push_back(static_cast<std::uint8_t>(200 * u / size.cols));
      color.push_back(static_cast<std::uint8_t>(200 * v / size.rows));
      color.push_back(100);
    }
  }
  return color;
}

TEST(Jpeg, RoundTripKeepsChannelsAndOddSizes) {
  JpegEncoder encoder(95);
  JpegDecoder decoder;
  for (const ImageSize size : {ImageSize{1, 1}, ImageSize{17, 33}, ImageSize{48, 64}}) {
    const auto color = gradient(size);
    const auto packet = encoder.encode(color.data(), size);
    EXPECT_EQ(decoder.size(packet).rows, size.rows);
    EXPECT_EQ(decoder.size(packet).cols, size.cols);
    std::vector<std::uint8_t> decoded(color.size());
    decoder.decode(packet, size, decoded.data());
    for (std::size_t i = 0; i < color.size(); ++i) {
      EXPECT_NEAR(decoded[i], color[i], 12) << i;  // 4:2:0 halves the resolution of hue
    }
  }
}

TEST(Jpeg, RefusesOtherSizesCutImagesAndNoise) {
  JpegEncoder encoder(90);
  JpegDecoder decoder;
  const ImageSize size{40, 40};
  const auto color = gradient(size);
  const auto packet = encoder.encode(color.data(), size);
  std::vector<std::uint8_t> decoded(color.size());
  EXPECT_THROW(decoder.decode(packet, {40, 39}, decoded.data()), FormatError);
  for (std::size_t length = 0; length < packet.size(); ++length) {
    EXPECT_THROW(decoder.decode(packet.first(length), size, decoded.data()), FormatError) << length;
    ASSERT_NO_THROW(decoder.decode(packet, size, decoded.data())) << length;
  }
  EXPECT_THROW(decoder.size({}), FormatError);
  EXPECT_THROW(decoder.size(std::as_bytes(std::span(color))), FormatError);
  EXPECT_THROW(JpegEncoder(0), InputError);
}

}  // namespace
}  // namespace manip3d
