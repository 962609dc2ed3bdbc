#include "manip3d/authenticate/watermark_picture.hpp"

#include <algorithm>
#include <array>
#include <string>

#include "authenticate/little_endian.hpp"
#include "authenticate/watermark_record.hpp"
#include "authenticate/watermark_suite.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr std::uint8_t kLowestBit = 1;

}  // namespace

void check_picture(const PictureView& picture) {
  if (picture.channels != 1 && picture.channels != 3) {
    throw InputError("picture: expected grey or three channels, got " +
                     std::to_string(picture.channels));
  }
  // Height times width times channels can overflow 64 bits, so the size is divided instead.
  const std::uint64_t row = std::uint64_t{picture.width} * picture.channels;
  const std::uint64_t size = picture.samples.size();
  const bool fits =
      row == 0 || picture.height == 0 ? size == 0 : size % row == 0 && size / row == picture.height;
  if (!fits) throw InputError("picture: expected as many samples as its shape has");
  if (size < kCarrierSamples) {
    throw InputError("picture: expected at least 16384 samples to carry a record, got " +
                     std::to_string(size));
  }
}

std::vector<std::uint8_t> without_record(const PictureView& picture) {
  check_picture(picture);
  std::vector<std::uint8_t> cleared(picture.samples.begin(), picture.samples.end());
  for (std::size_t i = 0; i < kCarrierSamples; ++i) {
    cleared[i] = static_cast<std::uint8_t>(cleared[i] & ~kLowestBit);
  }
  return cleared;
}

WatermarkTag tag_of_picture(std::span<const std::uint8_t> key, const PictureView& picture) {
  const std::vector<std::uint8_t> cleared = without_record(picture);
  std::array<std::uint8_t, 12> shape;
  store(picture.height, shape.data());
  store(picture.width, shape.data() + 4);
  store(picture.channels, shape.data() + 8);
  TagHash hash(key);
  hash.update("m3d-image");
  hash.update(shape);
  hash.update(cleared);
  return hash.finish();
}

std::vector<std::uint8_t> with_record(const PictureView& picture,
                                      std::span<const std::uint8_t> record) {
  if (record.size() > kMaxCarried) {
    throw InputError("record: expected at most " + std::to_string(kMaxCarried) +
                     " bytes for a picture, got " + std::to_string(record.size()));
  }
  std::vector<std::uint8_t> samples = without_record(picture);
  for (std::size_t i = 0; i < 8 * record.size(); ++i) {
    samples[i] = static_cast<std::uint8_t>(samples[i] | ((record[i / 8] >> (i % 8)) & kLowestBit));
  }
  return samples;
}

std::vector<std::uint8_t> record_in(const PictureView& picture) {
  check_picture(picture);
  std::vector<std::uint8_t> bytes(kMaxCarried, 0);
  for (std::size_t i = 0; i < kCarrierSamples; ++i) {
    bytes[i / 8] =
        static_cast<std::uint8_t>(bytes[i / 8] | (picture.samples[i] & kLowestBit) << (i % 8));
  }
  if (!std::equal(kRecordMagic.begin(), kRecordMagic.end(), bytes.begin())) {
    throw FormatError::at_byte(0, "the picture carries no record");
  }
  const std::size_t size = record_size(load<std::uint16_t>(bytes.data() + kSlicesOffset),
                                       load<std::uint16_t>(bytes.data() + kTilesOffset));
  if (size > bytes.size()) {
    throw FormatError::at_byte(kSlicesOffset, "a record longer than a picture carries");
  }
  const auto end = bytes.begin() + static_cast<std::ptrdiff_t>(size);
  if (std::any_of(end, bytes.end(), [](std::uint8_t byte) { return byte != 0; })) {
    throw FormatError::at_byte(static_cast<std::int64_t>(size), "expected zeros behind the record");
  }
  bytes.erase(end, bytes.end());
  return bytes;
}

}  // namespace manip3d
