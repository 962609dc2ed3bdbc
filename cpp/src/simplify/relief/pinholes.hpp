#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "simplify/relief/surface.hpp"

namespace manip3d::relief_detail {

/// Largest hole, in pixels connected by sides, over which the surface is continued.
inline constexpr int kPinhole = 4;
/// Side of the smallest square without a measurement, in pixels, that is a gap even where pixels
/// are missing by chance: of 640x480 pixels, of which 60 % are missing at random, one such square
/// is expected.
inline constexpr int kChanceGap = 5;

/// Fills pinholes of a grid. Cameras lose single pixels anywhere on a surface, and each would cost
/// the triangulation a boundary.
class PinholeFiller {
 public:
  /// Continues the surface over holes of at most kPinhole pixels that are surrounded by measured
  /// pixels without a step in depth or a too long edge between them: each filled pixel is the mean
  /// of its four neighbours. Filled pixels have confidence 0, so that they are no evidence. A pixel
  /// with steps all around it counts as a hole, too. Pixels are missing by chance if, outside of
  /// squares of kChanceGap pixels a side without a measurement, a fiftieth of the pixels have none
  /// and have only measurements of one surface within two pixels. These pixels are filled then,
  /// whatever their number in a hole.
  /// @param surface  Surface of the grid by the same rule; every pixel that it uses has a neighbour
  ///                 without a step.
  /// @return  False if less than one pixel in a thousand is in a pinhole; grid() must not be used
  ///          then.
  bool fill(const PointGridView& grid, const DenseRule& rule, std::span<const float> confidence,
            const Surface& surface);

  [[nodiscard]] PointGridView grid() const { return filled_; }
  [[nodiscard]] std::span<const float> confidence() const { return confidence_; }
  /// Filled pixels of the grid.
  [[nodiscard]] std::span<const std::int32_t> filled() const { return filled_pixels_; }
  [[nodiscard]] std::int64_t num_filled() const { return num_filled_; }
  /// Whether pixels are missing by chance: at least a fiftieth of them were filled.
  [[nodiscard]] bool are_by_chance() const { return by_chance_; }
  /// Whether a pixel of the grid was filled.
  [[nodiscard]] bool is_filled(std::int64_t pixel) const { return state_[pixel] == kFilled; }
  void clear() {
    num_filled_ = 0;
    by_chance_ = false;
  }

 private:
  enum State : std::uint8_t { kMeasured, kUnseen, kOpen, kFilled };
  struct Hole {
    int size = 0;
    std::array<std::int32_t, kPinhole> pixels;
  };
  /// Measured points around a pixel, at most `reach` columns and rows away.
  struct Around {
    int reach = 0, count = 0;
    Eigen::Array3f sum = Eigen::Array3f::Zero();
    Eigen::Array3f low = Eigen::Array3f::Constant(kInfinityF), high = -low;
  };
  void find_unseen(const StepRule& steps, const Surface& surface);
  void find_strays(const StepRule& steps, const Surface& surface);
  void open_gaps();
  bool find_chance(const StepRule& steps, double max_edge);
  [[nodiscard]] std::int64_t num_lone() const;
  [[nodiscard]] Around look_around(std::int32_t pixel) const;
  [[nodiscard]] bool is_amid_surface(std::int32_t pixel, const StepRule& steps,
                                     double max_edge) const;
  /// Finds the pinholes and their total number of pixels.
  void find_pinholes(const StepRule& steps, double max_edge);
  void find_holes();
  void gather(std::int32_t first);
  /// Whether a hole is within one surface. Open neighbours are ends of the surface.
  [[nodiscard]] bool is_amid_surface(const Hole& hole, const StepRule& steps,
                                     double max_edge) const;
  void open_beside_open();
  /// Builds the grid without its pinholes.
  void fill_in(std::span<const float> confidence);
  void interpolate_chance();
  void interpolate();
  void interpolate(const Hole& hole);

  template <typename Visit>
  void visit_around(std::int64_t pixel, Visit&& visit) const;

  PointGridView grid_, filled_;
  std::vector<std::uint8_t> state_;  ///< By pixel.
  std::vector<Hole> holes_;
  /// Pixels of holes that became open, whose neighbours must be tested.
  std::vector<std::int64_t> open_;
  std::vector<std::uint8_t> used_;  ///< Whether a pixel of a row is on the surface.
  std::vector<std::int32_t> hole_at_;
  std::vector<std::uint8_t> gaps_, gaps_of_rows_;  ///< Scratch memory of open_gaps().
  std::vector<std::int32_t> filled_pixels_;
  std::vector<float> points_;
  std::vector<std::uint8_t> valid_;
  std::vector<float> confidence_;
  std::int64_t num_filled_ = 0;
  bool by_chance_ = false;
};

}  // namespace manip3d::relief_detail
