#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/connected_runs.hpp"
#include "manip3d/geometry/rgbd_frame.hpp"
#include "manip3d/geometry/skeleton.hpp"

namespace manip3d {

/// Hue 0 to 179 (half degrees), saturation and value 0 to 255: OpenCV's units for 8-bit images.
struct Hsv {
  int hue = 0, saturation = 0, value = 0;
};

/// Equals OpenCV's conversion for all 2^24 colours.
Hsv to_hsv(std::uint8_t red, std::uint8_t green, std::uint8_t blue);

struct ShoeCoverOptions {
  int min_hue = 100, max_hue = 130;  ///< Both included: blue.
  int min_saturation = 90, min_value = 40;
  double reach = 0.35;  ///< Metres around the ankle.
  int min_pixels = 40;
};

/// Finds the foot by its blue shoe cover (dissertation section 4.7.1): sensors do not see the small
/// movements of a foot. Nothing blue should be near by.
class ShoeCoverTracker {
 public:
  /// @throws InputError  an option out of range.
  explicit ShoeCoverTracker(const ShoeCoverOptions& options = {});

  /// The median, by coordinate, of the largest 8-connected patch of blue pixels with depth within
  /// reach of the ankle (the first one by rows if two are as large); none with fewer than
  /// min_pixels. Colour is looked up through the calibration's registration.
  /// @throws InputError  no calibration or colour, or images and rays of different sizes.
  std::optional<Eigen::Vector3f> find(const RgbdFrame& frame, const PixelRays& rays,
                                      const Eigen::Vector3f& ankle);

  /// Puts the found foot into the skeleton, tracked. False, and nothing changes, if the ankle is
  /// not tracked or nothing is found.
  bool update(const RgbdFrame& frame, const PixelRays& rays, bool left, Skeleton& skeleton);

  /// Pixels of the patch found last.
  [[nodiscard]] std::int64_t num_pixels() const { return num_pixels_; }

 private:
  void mark(const RgbdFrame& frame, const PixelRays& rays, const Eigen::Vector3f& ankle);
  void take_largest(std::int64_t cols);

  ShoeCoverOptions options_;
  std::int64_t num_pixels_ = 0;
  std::vector<std::uint8_t> blue_;                ///< By pixel.
  std::int64_t first_blue_ = 0, last_blue_ = -1;  ///< Pixels.
  ConnectedRuns patches_;
  std::vector<std::int64_t> sizes_;    ///< Points of each patch.
  std::vector<std::int64_t> largest_;  ///< Pixels of the largest patch.
  std::array<std::vector<float>, 3> coordinates_;
};

}  // namespace manip3d
