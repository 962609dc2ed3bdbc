#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "simplify/relief_surface.hpp"

namespace manip3d::relief_detail {

/// Largest hole, in pixels that share sides, that the surface is continued over.
inline constexpr int kPinhole = 4;
/// Largest hole where so many pixels are in pinholes that larger holes are what chance makes of
/// them.
inline constexpr int kChanceHole = 32;

/// A grid without its pinholes: cameras lose single pixels everywhere on a surface, which is not an
/// end of it. Each would cost the triangulation a boundary.
class PinholeFiller {
 public:
  /// Continues the surface over holes of at most kPinhole pixels with measured ones all around, no
  /// step in depth and no edge that is too long among these: each pixel becomes the mean of its
  /// four neighbours. They have confidence 0, so that they are no evidence. A pixel with steps all
  /// around it is a hole, too. Where such holes are a fiftieth of the pixels, pixels are missing at
  /// random, and holes of at most kChanceHole are taken as well.
  /// @param surface  that of the grid by the rule: what it uses has a neighbour without a step.
  /// @return  false: fewer than one pixel of a thousand is in one, and grid() is not to be used.
  bool fill(const PointGridView& grid, const DenseRule& rule, std::span<const float> confidence,
            const Surface& surface);

  [[nodiscard]] PointGridView grid() const { return filled_; }
  [[nodiscard]] std::span<const float> confidence() const { return confidence_; }
  /// Pixels of the grid that are filled.
  [[nodiscard]] std::span<const std::int32_t> filled() const { return filled_pixels_; }
  [[nodiscard]] std::int64_t num_filled() const { return num_filled_; }
  /// Are pixels missing at random: was a fiftieth of them filled?
  [[nodiscard]] bool are_by_chance() const { return by_chance_; }
  /// Is this pixel of the grid a filled one?
  [[nodiscard]] bool is_filled(std::int64_t pixel) const { return state_[pixel] == kFilled; }
  void clear() {
    num_filled_ = 0;
    by_chance_ = false;
  }

 private:
  enum State : std::uint8_t { kMeasured, kUnseen, kOpen, kFilled };
  struct Hole {
    int size = 0;
    std::array<std::int32_t, kChanceHole> pixels;
  };
  /// Finds the holes of at most `most` pixels, and how many pixels they have.
  void find(const StepRule& steps, const DenseRule& rule, const Surface& surface, int most);
  /// Makes the grid without its pinholes.
  void fill_in(std::span<const float> confidence);
  void find_holes(const StepRule& steps, const Surface& surface, int most);
  void find_strays(const StepRule& steps, const Surface& surface);
  void gather(std::int32_t first, int most);
  /// Is a hole amid one surface? Those of its neighbours that are open end the surface.
  [[nodiscard]] bool is_amid_surface(const Hole& hole, const StepRule& steps,
                                     double max_edge) const;
  void open_beside_open();
  void interpolate();
  void interpolate(const Hole& hole);

  template <typename Visit>
  void visit_around(std::int64_t pixel, Visit&& visit) const;

  PointGridView grid_, filled_;
  std::vector<std::uint8_t> state_;  ///< By pixel.
  std::vector<Hole> holes_;
  std::vector<std::int64_t> open_;  ///< Pixels of holes that turned out open, to be looked around.
  std::vector<std::uint8_t> used_;  ///< Whether a pixel of a row is on the surface.
  std::vector<std::int32_t> hole_at_;
  std::vector<std::int32_t> filled_pixels_;
  std::vector<float> points_;
  std::vector<std::uint8_t> valid_;
  std::vector<float> confidence_;
  std::int64_t num_filled_ = 0;
  bool by_chance_ = false;
};

}  // namespace manip3d::relief_detail
