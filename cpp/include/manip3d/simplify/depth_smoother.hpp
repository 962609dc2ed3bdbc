#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "manip3d/geometry/depth_image.hpp"

namespace manip3d {

struct DepthSmootherOptions {
  /// Weight of the newest depth once a pixel has settled; (0, 1]. 1: depths are given as they are.
  double newest_share = 0.15;
  double gate = 0.03;  ///< A pixel that changes by a larger part of its depth starts anew.
};

/// Depths of a sequence without the noise of single frames. What moves is followed, not delayed.
///
/// A change of depth that the pixels around have as well is motion: the mean of the changes of 24 x
/// 24 pixels, and what the mean of 25 changes differs from it, are taken at once where they are
/// well above the noise of such means. The large mean shows the slow motion of a camera or a body
/// that is below the noise of the small one. The rest of a change is noise: each pixel keeps a
/// recursive mean of it, and starts anew where it is far above the noise. The result is the mean of
/// that and of the pairs of pixels on both sides within two pixels that agree with it. Where the
/// mesh that was shown last, moved along with the large mean, is within the noise, and little
/// around moves by itself, the result stays near to its surface.
///
/// The three noises are measured: they grow with the square of the depth, by factors that the
/// changes of each frame show, those of means from second differences over time. A first frame is
/// given as it is, and all pixels start anew where less than half of them go on.
class DepthSmoother {
 public:
  /// @throws InputError  newest_share not in (0, 1]; gate is not > 0.
  explicit DepthSmoother(const DepthSmootherOptions& options = {});
  /// The smoothed frame: (rows, cols) metres, 0 where the newest frame has no measurement. Valid
  /// until the next call. A frame of another size starts anew.
  const std::vector<float>& add(const DepthView& depth);
  /// Takes the mesh that was made of the last frame.
  /// @param pixels  (n, 2) column and row of each vertex.
  /// @param depths  of each vertex, metres; one that is not > 0 belongs to no surface.
  /// @throws InputError  a pixel outside of the last frame; other numbers of pixels and depths; an
  ///                     index out of range.
  void show(const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels, std::span<const float> depths,
            const Eigen::Ref<const Rows<std::int32_t, 3>>& faces);
  void reset();
  /// Whether the last frame had nothing in common with those before, or was the first.
  bool starts_anew() const { return starts_anew_; }

 private:
  struct Box {
    std::int64_t u = 0, v = 0, end_u = 0, end_v = 0;
  };
  struct BlockSum {
    float value = 0.0F, depth = 0.0F, number = 0.0F;
  };
  /// Takes the newest depths into `out_`, and the box around those that are measured.
  void take(const DepthView& depth);
  void find_changes();
  /// The mean change of the pixels around each one.
  void find_motion();
  void measure_noise();
  /// The noise of the mean of 25 pixels: a fifth of that of one if it is white, more if neighbours
  /// have some of it in common.
  void measure_noise_of_means();
  void add_second_difference(std::int64_t pixel);
  /// The noise of the mean change of a block and those around it.
  void measure_noise_of_blocks();
  void clear_block_sums();
  /// Adds value(u), a BlockSum, for each pixel of a row of the box.
  template <typename Value>
  void add_to_blocks(std::int64_t in_box, Value&& value);
  /// The sum over a block and those around it.
  [[nodiscard]] BlockSum sum_around(std::int64_t v, std::int64_t u) const;
  /// Mean changes of 25 pixels above this are motion; over the noise of a Kinect.
  [[nodiscard]] float limit_of_motion() const;
  /// The mean motion of each block and those around it, of the pixels without motion of their own.
  void find_block_motion();
  /// Writes a row of the box, linear between the centres of the blocks.
  void interpolate_block_motion(std::int64_t v, float* drift) const;
  void update();
  /// Takes the means of pixels and their pairs.
  void smooth_surface();
  /// The share of pixels that move, in each block and those around it.
  void find_moving_blocks();
  void stay_near_shown();
  /// Calls visit(in_box, in_image): where each row of the box begins.
  template <typename Visit>
  void for_each_row(Visit&& visit) const;
  void draw(std::array<std::array<std::int32_t, 2>, 3> at, std::array<float, 3> inverse);

  DepthSmootherOptions options_;
  std::int64_t rows_ = 0, cols_ = 0;
  std::vector<float> mean_;           ///< By pixel, metres; 0: nothing yet.
  std::vector<std::uint16_t> count_;  ///< By pixel: frames since its start.
  Box box_;
  // By pixel of the box.
  std::vector<float> change_;   ///< From the mean; 0 where the pixel starts anew.
  std::vector<float> goes_on_;  ///< 0 where it starts anew, else 1.
  std::vector<float> motion_;
  std::vector<float> drift_;    ///< The part of the motion that the blocks around have in common.
  std::vector<float> moves_;    ///< Part of the change that is motion, 0 to 1; 1: starts anew.
  std::vector<float> current_;  ///< The mean where there is a measurement, else 0.
  std::vector<float> sums_, numbers_, row_;  ///< Scratch.
  std::vector<float> shown_;                 ///< By pixel: depth of the mesh shown; 0: none.
  std::vector<float> last_, second_last_;    ///< By pixel: frames before as they were measured.
  std::vector<float> samples_;
  std::int64_t block_rows_ = 0, block_cols_ = 0;
  std::vector<BlockSum> block_sums_;
  std::vector<float> moving_blocks_, block_motion_;
  std::vector<float> out_;
  bool has_shown_ = false;
  bool starts_anew_ = true;
  // Standard deviations over that of a Kinect's pixel; negative: not known.
  double noise_ = -1.0, noise_of_means_ = -1.0, noise_of_blocks_ = -1.0;
};

}  // namespace manip3d
