#include "capture/image_frames.hpp"

#include <zlib.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "capture/image_codec.hpp"
#include "capture/small_file.hpp"
#include "manip3d/capture/unmirror.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

using Bytes = std::vector<std::byte>;

std::string pixels_of(std::int64_t rows, std::int64_t cols) {
  return std::to_string(cols) + " x " + std::to_string(rows) + " pixels";
}

void check_crc(const Bytes& data, std::uint32_t expected) {
  const auto* bytes = reinterpret_cast<const Bytef*>(data.data());
  if (crc32_z(0, bytes, data.size()) == expected) return;
  throw FormatError("damaged: it is not what was recorded (CRC-32)", {});
}

constexpr std::int64_t kMaxPixels = std::int64_t{1} << 24;  // limit for colour images of any size

/// Reads the image of a file with `decode`. The file may be as large as `pixels` pixels can make
/// it.
template <typename Decode>
auto load_image(const ImageFile& file, std::int64_t pixels, const Decode& decode) {
  // more than any encoder needs
  constexpr std::uint64_t kBytesPerPixel = 8, kHeaderBytes = 1 << 20;
  const Bytes data = read_small_file(
      file.path, kBytesPerPixel * static_cast<std::uint64_t>(pixels) + kHeaderBytes);
  try {
    if (file.crc32) check_crc(data, *file.crc32);
    return decode(data, std::max(pixels, kMaxPixels));
  } catch (const FormatError& error) {
    throw error.in_file(file.path.string());
  }
}

/// Reads the image of a file, which must have the size of `camera`.
template <typename Decode>
auto load_image(const ImageFile& file, const Intrinsics& camera, const Decode& decode) {
  auto image = load_image(file, camera.width * camera.height, decode);
  try {
    if (image.rows != camera.height || image.cols != camera.width) {
      throw FormatError("expected " + pixels_of(camera.height, camera.width) +
                            " as the calibration says, got " + pixels_of(image.rows, image.cols),
                        {});
    }
    return image;
  } catch (const FormatError& error) {
    throw error.in_file(file.path.string());
  }
}

void set_color(RgbdFrame& frame, DecodedImage<std::uint8_t> color) {
  frame.color = std::move(color.pixels);
  frame.color_rows = color.rows;
  frame.color_cols = color.cols;
}

constexpr std::uint16_t kNoMeasurement = 65535;  // see ImageFrames::Listing::marks_missing

// Sets pixels that are not measured to 0 and returns the number of these that had another mark.
std::int64_t clear_marked(std::vector<std::uint16_t>& depth) {
  const std::int64_t marked = std::ranges::count(depth, kNoMeasurement);
  if (marked > 0) std::ranges::replace(depth, kNoMeasurement, std::uint16_t{0});
  return marked;
}

void to_millimetres(std::vector<std::uint16_t>& depth, double units_per_metre,
                    const std::filesystem::path& path) {
  if (units_per_metre == 1000.0) return;
  const double scale = 1000.0 / units_per_metre;
  for (std::uint16_t& value : depth) {
    const double millimetres = std::floor(value * scale + 0.5);
    if (!(millimetres <= 65535.0)) {
      throw FormatError("expected depths up to 65.535 m, got " + std::to_string(value) +
                            " units of which " + number_text(units_per_metre) + " are a metre",
                        {})
          .in_file(path.string());
    }
    value = static_cast<std::uint16_t>(millimetres);
  }
}

}  // namespace

ImageFrames::ImageFrames(Listing listing, std::shared_ptr<const RgbdCalibration> stored,
                         double units_per_metre)
    : listing_(std::move(listing)),
      stored_(std::move(stored)),
      calibration_(unmirrored(stored_)),
      units_per_metre_(units_per_metre) {}

Counters ImageFrames::counters() const {
  Counters counters = {{"frames", frames_}, {"out_of_order", out_of_order_}, {"damaged", damaged_}};
  if (unregistered_color_ > 0) counters.emplace_back("unregistered_color", unregistered_color_);
  if (marked_ > 0) counters.emplace_back("pixels_of_65535", marked_);
  if (narrow_ > 0) counters.emplace_back("depth_of_8_bits", narrow_);
  counters.insert(counters.end(), listing_.counters.begin(), listing_.counters.end());
  return counters;
}

Conversions ImageFrames::conversions() const {
  Conversions conversions = flips_of(*stored_);
  conversions.assumed_rate = listing_.assumed_rate;
  return conversions;
}

ReadStatus ImageFrames::read(RgbdFrame& frame, std::chrono::milliseconds) {
  while (listing_.next(files_)) {
    if (last_ && (files_.number <= last_->first || files_.time_ns <= last_->second)) {
      ++out_of_order_;
      continue;
    }
    last_ = {files_.number, files_.time_ns};
    load(frame);
    ++frames_;
    return ReadStatus::kFrame;
  }
  stop();
  return ReadStatus::kEnd;
}

void ImageFrames::seek(std::int64_t index) {
  check_frame_index(index);
  listing_.seek(index);
  last_.reset();
  if (listing_.lock) listing_.lock->hold();
}

void ImageFrames::load(RgbdFrame& frame) try {
  const Intrinsics& depth_camera = stored_->depth;
  frame.number = files_.number;
  frame.time_ns = files_.time_ns;
  frame.rows = depth_camera.height;
  frame.cols = depth_camera.width;
  auto depth = load_image(files_.depth, depth_camera, decode_depth);
  frame.depth = std::move(depth.pixels);
  narrow_ += depth.has_8_bits ? 1 : 0;
  if (listing_.marks_missing) marked_ += clear_marked(frame.depth);
  to_millimetres(frame.depth, units_per_metre_, files_.depth.path);
  frame.body_index.clear();
  if (!files_.body_index.path.empty()) {
    frame.body_index = load_image(files_.body_index, depth_camera, decode_grey).pixels;
  }
  frame.color.clear();
  frame.color_rows = frame.color_cols = 0;
  if (!files_.color.path.empty()) {
    if (const auto& registration = stored_->registration) {
      set_color(frame, load_image(files_.color, registration->color, decode_rgb));
    } else if (auto color = load_image(files_.color, kMaxPixels, decode_rgb);
               color.rows == depth_camera.height && color.cols == depth_camera.width) {
      set_color(frame, std::move(color));
    } else {
      ++unregistered_color_;  // without a registration, the depth pixels of the colours are unknown
    }
  }
  frame.skeletons = files_.skeletons;
  frame.calibration = calibration_;
  unmirror_images(*stored_, frame);
} catch (...) {
  ++damaged_;
  throw;
}

}  // namespace manip3d
