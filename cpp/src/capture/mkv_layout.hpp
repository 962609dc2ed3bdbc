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

/// Most pixels of an image: 4096 x 4096. Blank images take next to nothing in a file, so that its
/// length says nothing about the memory they need.
inline constexpr std::int64_t kMaxPixels = std::int64_t{1} << 24;

/// Complaint about an image of this size; empty: nothing is wrong.
inline std::string complaint(ImageSize size) {
  // Sides have 32 bits in files and at most kMaxImageSide in calibrations: the product fits.
  if (size.rows > 0 && size.cols > 0 && size.rows * size.cols <= kMaxPixels) return "";
  return "expected images of 1 to " + std::to_string(kMaxPixels) + " pixels, got " +
         std::to_string(size.cols) + " x " + std::to_string(size.rows);
}

}  // namespace manip3d::mkv
