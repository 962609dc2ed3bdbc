#include "manip3d/capture/recorder.hpp"

#include <string>

#include "manip3d/capture/folder.hpp"
#include "manip3d/capture/mkv.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

std::string size_text(std::int64_t rows, std::int64_t cols) {
  return std::to_string(cols) + " x " + std::to_string(rows);
}

void check_size(const char* name, std::int64_t rows, std::int64_t cols, std::int64_t expected_rows,
                std::int64_t expected_cols) {
  if (rows == expected_rows && cols == expected_cols) return;
  throw InputError(std::string("frame.") + name + ": expected " +
                   size_text(expected_rows, expected_cols) + " pixels, got " +
                   size_text(rows, cols));
}

void check_length(const char* name, std::size_t length, std::int64_t expected) {
  if (length == static_cast<std::size_t>(expected)) return;
  throw InputError(std::string("frame.") + name + ": expected " + std::to_string(expected) +
                   " values, got " + std::to_string(length));
}

void check_grows(const char* name, std::int64_t value, std::int64_t before) {
  if (value > before) return;
  throw InputError(std::string("frame.") + name + ": expected more than the frame before has (" +
                   std::to_string(before) + "), got " + std::to_string(value));
}

RecordingKind kind_of(const std::filesystem::path& path) {
  const std::filesystem::path suffix = path.extension();
  if (suffix == ".mkv" || suffix == ".MKV") return RecordingKind::kMkv;
  if (suffix.empty()) return RecordingKind::kFolder;
  throw InputError("path: expected a folder or a file that ends in .mkv, got '" + path.string() +
                   "'");
}

}  // namespace

std::unique_ptr<RgbdRecorder> open_recorder(const std::filesystem::path& path,
                                            std::shared_ptr<const RgbdCalibration> calibration,
                                            const RecorderOptions& options) {
  if (options.jpeg_quality < 1 || options.jpeg_quality > 100) {
    throw InputError("jpeg_quality: expected 1 to 100, got " +
                     std::to_string(options.jpeg_quality));
  }
  switch (options.kind ? *options.kind : kind_of(path)) {
    case RecordingKind::kMkv:
      return record_mkv(path, std::move(calibration), options);
    case RecordingKind::kTum:
      return record_tum(path, std::move(calibration), options);
    case RecordingKind::kFolder:
      break;
  }
  return record_folder(path, std::move(calibration), options);
}

RecordingChecks::RecordingChecks(const RgbdCalibration& calibration)
    : rows_(calibration.depth.height), cols_(calibration.depth.width) {
  check_intrinsics(calibration.depth, "calibration.depth");
  const Intrinsics* color = &calibration.depth;
  if (calibration.registration) {
    check_registration(*calibration.registration);
    color = &calibration.registration->color;
  }
  if (calibration.depth.mirrored || color->mirrored) {
    throw InputError("calibration: expected cameras that are not mirrored");
  }
  color_rows_ = color->height;
  color_cols_ = color->width;
}

void RecordingChecks::check(const RgbdFrame& frame) {
  if (frame.skeletons.size() > kMaxSkeletons) {
    throw InputError("frame.skeletons: expected at most " + std::to_string(kMaxSkeletons) +
                     ", got " + std::to_string(frame.skeletons.size()));
  }
  check_size("depth", frame.rows, frame.cols, rows_, cols_);
  check_length("depth", frame.depth.size(), rows_ * cols_);
  if (!frame.body_index.empty()) check_length("body_index", frame.body_index.size(), rows_ * cols_);
  if (!frame.color.empty()) {
    check_size("color", frame.color_rows, frame.color_cols, color_rows_, color_cols_);
    check_length("color", frame.color.size(), 3 * color_rows_ * color_cols_);
  }
  if (!is_first_) {
    check_grows("number", frame.number, number_);
    check_grows("time_ns", frame.time_ns, time_ns_);
  }
  is_first_ = false;
  number_ = frame.number;
  time_ns_ = frame.time_ns;
}

}  // namespace manip3d
