#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "capture/jpeg.hpp"
#include "manip3d/error.hpp"

/// @file
/// Names and limits of the files of manip3d/capture/mkv.hpp.
namespace manip3d::mkv {

inline constexpr const char* kDepth = "depth";
inline constexpr const char* kBodyIndex = "body index";
inline constexpr const char* kColor = "colour";
inline constexpr const char* kFrames = "frames";
inline constexpr const char* kCalibration = "calibration.json";
inline constexpr std::size_t kHashDigits = 64;

/// Largest number of pixels of an image: 4096 x 4096. Blank images take hardly any bytes, so that
/// the length of a file does not limit the memory they need.
inline constexpr std::int64_t kMaxPixels = std::int64_t{1} << 24;

/// The error message for an image of this size; empty: the size is valid.
inline std::string complaint(ImageSize size) {
  // Sides have 32 bits in files and are at most kMaxImageSide in calibrations: the product does not
  // overflow.
  if (size.rows > 0 && size.cols > 0 && size.rows * size.cols <= kMaxPixels) return "";
  return "expected images of 1 to " + std::to_string(kMaxPixels) + " pixels, got " +
         std::to_string(size.cols) + " x " + std::to_string(size.rows);
}

}  // namespace manip3d::mkv
