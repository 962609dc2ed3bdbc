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

/// Convert a colour; equals OpenCV's conversion for all 2^24 colours.
Hsv to_hsv(std::uint8_t red, std::uint8_t green, std::uint8_t blue);

struct ShoeCoverOptions {
  int min_hue = 100, max_hue = 130;  ///< Both included. The default range is blue.
  int min_saturation = 90, min_value = 40;
  double reach = 0.35;  ///< Metres around the ankle in which the cover is searched.
  int min_pixels = 40;
};

/// Find the foot by its blue shoe cover (dissertation section 4.7.1), because body trackers do not
/// resolve small movements of a foot. No other blue object may be near the ankle.
class ShoeCoverTracker {
 public:
  /// @throws InputError  an option out of range.
  explicit ShoeCoverTracker(const ShoeCoverOptions& options = {});

  /// Return the median, by coordinate, of the largest 8-connected patch of blue pixels with depth
  /// within `reach` of the ankle (of two equally large patches, the first one by rows). No value if
  /// the patch has fewer than min_pixels. Colours are looked up through the calibration's
  /// registration.
  /// @throws InputError  no calibration or colour, or images and rays of different sizes.
  std::optional<Eigen::Vector3f> find(const RgbdFrame& frame, const PixelRays& rays,
                                      const Eigen::Vector3f& ankle);

  /// Moves the foot of the skeleton to the found place and marks it as tracked. Returns false and
  /// changes nothing if the ankle is not tracked or no patch is found.
  bool update(const RgbdFrame& frame, const PixelRays& rays, bool left, Skeleton& skeleton);

  /// Pixels of the patch found last.
  [[nodiscard]] std::int64_t num_pixels() const { return num_pixels_; }

 private:
  void mark(const RgbdFrame& frame, const PixelRays& rays, const Eigen::Vector3f& ankle);
  void take_largest(std::int64_t cols);

  ShoeCoverOptions options_;
  std::int64_t num_pixels_ = 0;
  std::vector<std::uint8_t> blue_;                ///< By pixel: 1 if blue.
  std::int64_t first_blue_ = 0, last_blue_ = -1;  ///< First and last blue pixel.
  ConnectedRuns patches_;
  std::vector<std::int64_t> sizes_;    ///< Points of each patch.
  std::vector<std::int64_t> largest_;  ///< Pixels of the largest patch.
  std::array<std::vector<float>, 3> coordinates_;
};

}  // namespace manip3d
