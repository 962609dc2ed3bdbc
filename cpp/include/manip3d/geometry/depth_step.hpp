#pragma once

namespace manip3d {

struct DepthStepOptions {
  /// Standard deviation of a depth at 1 m, metres; it grows with the square of the depth
  /// [Khoshelham & Elberink, "Accuracy and resolution of Kinect depth data", Sensors 2012].
  double noise_at_1_m = 1.425e-3;
  /// Metres: pixels with a larger difference of depth are not connected, at any depth. 0: use the
  /// rule below.
  double max_step = 0.0;
};

/// Tells whether neighbouring pixels of a depth image lie on one surface.
///
/// The depth of a plane that is tilted by t relative to the image plane changes by about z / f tan
/// t from one pixel to the next. A change of depth is a slope up to a tilt of 78 degrees plus three
/// standard deviations of the noise; a larger change is a step from one surface to another.
class DepthStep {
 public:
  /// @param focal  Focal length, pixels.
  /// @throws InputError  an option is negative or not finite; the focal length is not positive.
  DepthStep(const DepthStepOptions& options, double focal);

  /// Whether pixels with these smallest and largest depths are on one surface.
  [[nodiscard]] bool connects(float nearest, float farthest) const {
    return farthest - nearest <= limit(nearest);
  }

  /// The largest change of depth, metres, from a pixel of this depth to the next one on the same
  /// surface.
  [[nodiscard]] float limit(float nearest) const { return limits(nearest); }

  /// limit() of one number, or of several at once (geometry/lanes.hpp).
  template <typename Lanes>
  [[nodiscard]] Lanes limits(Lanes nearest) const {
    return fixed_ + nearest * (slope_ + noise_ * nearest);
  }

 private:
  float fixed_ = 0.0F, slope_ = 0.0F, noise_ = 0.0F;
};

}  // namespace manip3d
