#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "manip3d/geometry/depth_image.hpp"

namespace manip3d {

struct DepthSmootherOptions {
  /// Weight of the newest depth once a pixel has settled; (0, 1]. 1: depths are not smoothed.
  double newest_share = 0.15;
  double gate = 0.03;  ///< A pixel restarts if its depth changes by a larger share.
};

/// Remove the noise of single frames from a sequence of depth images. Motion is followed without
/// delay.
///
/// A change of depth that the surrounding pixels share is motion. Two means of changes are used:
/// the mean over 24 x 24 pixels, and the difference of the mean over 25 pixels from it. Both are
/// followed at once if they are well above the noise of such means; the large mean shows slow
/// motion of a camera or a body that is below the noise of the small one. The rest of a change is
/// noise: each pixel keeps a recursive mean of it and restarts if the change is far above the
/// noise. The result is the average of this mean and of those pairs of opposite pixels, within two
/// pixels, that lie on the same surface. The mesh that was shown last is moved by the large mean;
/// if the result is within the noise of it and few pixels around move on their own, the result
/// stays near to it.
///
/// The three noises are measured. They grow with the square of the depth; the factors come from the
/// changes in each frame, those of the means from second differences over time. The first frame is
/// returned unchanged, and all pixels restart if fewer than half of them continue.
class DepthSmoother {
 public:
  /// @throws InputError  newest_share not in (0, 1]; gate is not > 0.
  explicit DepthSmoother(const DepthSmootherOptions& options = {});
  /// Return the smoothed frame: (rows, cols) metres, 0 where the newest frame has 0 or NaN.
  /// Negative and infinite depths are no measurements and come back as they are, so that whoever
  /// uses the frame can refuse them. Valid until the next call. A frame of another size restarts
  /// everything. The mesh given to `show` is used by the next call only.
  const std::vector<float>& add(const DepthView& depth);
  /// Sets the mesh that was made from the last frame; where it throws, the mesh before stays.
  /// @param pixels  (n, 2) column and row of each vertex.
  /// @param depths  Depth of each vertex, metres; a vertex whose depth is not > 0 is on no surface.
  /// @throws InputError  a pixel outside the last frame; numbers of pixels and depths differ; an
  ///                     index out of range.
  void show(const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels, std::span<const float> depths,
            const Eigen::Ref<const Rows<std::int32_t, 3>>& faces);
  void reset();
  /// Whether the last frame was the first, or had too little in common with those before.
  bool starts_anew() const { return starts_anew_; }

 private:
  struct Box {
    std::int64_t u = 0, v = 0, end_u = 0, end_v = 0;
  };
  struct BlockSum {
    float value = 0.0F, depth = 0.0F, number = 0.0F;
  };
  /// Copies the newest depths to `out_` and sets the box around the measured ones.
  void take(const DepthView& depth);
  void find_changes();
  /// Keeps the newest depths for the next frame as they are.
  void remember();
  /// Computes the mean change of the pixels around each one.
  void find_motion();
  void measure_noise();
  /// Measures the noise of the mean of 25 pixels: a fifth of that of one pixel for white noise,
  /// more if the noise of neighbours is correlated.
  void measure_noise_of_means();
  void add_second_difference(std::int64_t pixel);
  /// Measures the noise of the mean change of a block and the blocks around it.
  void measure_noise_of_blocks();
  void clear_block_sums();
  /// Adds value(u), a BlockSum, for each pixel u of a row of the box.
  template <typename Value>
  void add_to_blocks(std::int64_t in_box, Value&& value);
  /// The sum over a block and the blocks around it.
  [[nodiscard]] BlockSum sum_around(std::int64_t v, std::int64_t u) const;
  /// Mean changes of 25 pixels above this are motion; relative to the noise of a Kinect.
  [[nodiscard]] float limit_of_motion() const;
  /// Computes the mean motion of each block and those around it, from pixels that do not move on
  /// their own.
  void find_block_motion();
  /// Writes the motion of a row of the box, interpolated linearly between the centres of the
  /// blocks.
  void interpolate_block_motion(std::int64_t v, float* drift) const;
  void update();
  /// Averages pixels with their pairs.
  void smooth_surface();
  /// Computes the share of moving pixels in each block and those around it.
  void find_moving_blocks();
  void stay_near_shown();
  /// Calls visit(in_box, in_image) with the start of each row of the box, as indices in the box and
  /// in the image.
  template <typename Visit>
  void for_each_row(Visit&& visit) const;
  void draw(std::array<std::array<std::int32_t, 2>, 3> at, std::array<float, 3> inverse);

  DepthSmootherOptions options_;
  std::int64_t rows_ = 0, cols_ = 0;
  std::vector<float> mean_;           ///< By pixel, metres.
  std::vector<std::uint16_t> count_;  ///< By pixel: frames since it (re)started; 0: none yet.
  Box box_;
  // By pixel of the box.
  std::vector<float> change_;   ///< From the mean; 0 where the pixel restarts.
  std::vector<float> goes_on_;  ///< 0 where the pixel restarts, else 1.
  std::vector<float> motion_;
  std::vector<float> drift_;  ///< The part of the motion that is common to the blocks around.
  /// Part of the change that is motion, 0 to 1; 1 where the pixel restarts.
  std::vector<float> moves_;
  std::vector<float> current_;               ///< The mean of pixels with a measurement, else 0.
  std::vector<float> sums_, numbers_, row_;  ///< Scratch.
  std::vector<float> shown_;                 ///< By pixel: depth of the mesh shown; 0: none.
  /// By pixel: the last frame and the one before, as measured.
  std::vector<float> last_, second_last_;
  std::vector<float> samples_;
  std::int64_t block_rows_ = 0, block_cols_ = 0;
  std::vector<BlockSum> block_sums_;
  std::vector<float> moving_blocks_, block_motion_;
  std::vector<float> out_;
  /// Whether `shown_` is the mesh of the last frame: set by `show`, cleared by each `add` and
  /// `reset`.
  bool has_shown_ = false;
  bool starts_anew_ = true;
  // Standard deviations relative to a Kinect's pixel; negative: unknown.
  double noise_ = -1.0, noise_of_means_ = -1.0, noise_of_blocks_ = -1.0;
};

}  // namespace manip3d
