#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "geometry/constants.hpp"
#include "geometry/lanes.hpp"
#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/geometry/depth_step.hpp"
#include "manip3d/simplify/depth_coverage.hpp"

namespace manip3d::relief_detail {

using Vec3 = Eigen::Vector3f;

/// Reserves memory for `size` items. If that needs an allocation, a quarter more is reserved, since
/// frames of a sequence differ in size: after a few frames none needs an allocation.
template <typename Item>
void make_room(std::vector<Item>& items, std::int64_t size) {
  const auto needed = static_cast<std::size_t>(size);
  if (items.capacity() < needed) items.reserve(needed + needed / 4);
}

/// Images of more pixels than this are not frames of a camera. Their scratch memory is freed as
/// soon as it is not needed, because it would be most of the memory at the peak.
inline constexpr std::int64_t kManyPixels = std::int64_t{1} << 22;

/// Frees the memory of a vector.
template <typename Item>
void release(std::vector<Item>& items) {
  std::vector<Item>().swap(items);
}

/// A measured point with the weight of its distance from a mesh: a third of the area of each dense
/// triangle around it, times its confidence.
struct Sample {
  float x = 0.0F, y = 0.0F, z = 0.0F, weight = 0.0F;
  [[nodiscard]] Vec3 point() const { return {x, y, z}; }
};

/// Role of a pixel in a mesh that follows another one.
enum class Keep : std::uint8_t {
  kFree,
  kPrefer,  ///< A vertex of the previous frame.
  kFixed,   ///< A vertex of a smaller mesh that shares vertices with this one.
};

/// Tells which differences in depth are steps, by a DenseRule.
class StepRule {
 public:
  StepRule() = default;
  explicit StepRule(const DenseRule& rule) : share_(static_cast<float>(rule.max_step)) {
    if (rule.focal > 0.0) slope_.emplace(DepthStepOptions{}, rule.focal);
  }
  [[nodiscard]] bool has_steps() const { return std::isfinite(share_); }
  /// The largest difference in depth from this depth to that of the next pixel that is no step.
  [[nodiscard]] float limit(float depth) const {
    const float share = share_ * depth;
    return slope_ ? std::max(share, slope_->limit(depth)) : share;
  }
  /// limit() of four depths.
  [[nodiscard]] Float4 limit(Float4 depth) const {
    const Float4 share = share_ * depth;
    if (!slope_) return share;
    const Float4 slope = slope_->limits(depth);
    return share < slope ? slope : share;
  }
  [[nodiscard]] bool is_step(float nearest, float farthest) const {
    return !(farthest - nearest <= limit(nearest));
  }

 private:
  float share_ = kInfinityF;
  std::optional<DepthStep> slope_;
};

/// The dense triangles of a 2x2 cell of pixels. Its corners are a (lowest u and v), b (next u), c
/// (next v) and d (both); the triangles are counter-clockwise with v up.
enum Cell : std::uint8_t {
  kFirst = 1,        ///< abd, or abc if cut from b to c.
  kSecond = 2,       ///< adc, or bdc.
  kFull = 3,         ///< Both.
  kCutFromBToC = 4,  ///< The cell is cut from b to c; without this bit from a to d.
};

/// The number of dense triangles that a cell lacks. The instruction that counts bits is missing in
/// the oldest processors, and a call instead took a fifth of the time.
constexpr int num_missing(std::uint8_t cell) {
  return ((cell & kFirst) == 0 ? 1 : 0) + ((cell & kSecond) == 0 ? 1 : 0);
}

/// The dense surface of a point grid, cropped to its valid pixels, centred, scaled to a bounding
/// box of diagonal 1, and padded to whole tiles with pixels that no triangle uses.
class Surface {
 public:
  static constexpr int kTile = 16;  ///< Pixels between the corners of the coarsest triangles.

  /// Builds the dense mesh of grid_mesh(), without triangles that break the rule.
  /// @param confidence  by pixel of the grid, 0 to 1; may be empty: all are 1.
  void assign(const PointGridView& whole, const DenseRule& rule, std::span<const float> confidence,
              int num_threads);
  /// Builds the surface of a grid that differs from another grid only in pixels that were filled:
  /// copies the surface of the other grid, and rebuilds it around these pixels.
  /// @param before  the surface of the grid before pixels were filled.
  /// @param filled  the filled pixels of the grid.
  /// @return  false if the surfaces may differ elsewhere too, for example because the bounding box
  ///          changed: nothing is usable then, and assign() is needed.
  bool assign_filled(const Surface& before, const PointGridView& grid, const DenseRule& rule,
                     std::span<const float> confidence, std::span<const std::int32_t> filled);

  [[nodiscard]] bool empty() const { return num_faces_ == 0; }
  [[nodiscard]] int cols() const { return cols_; }
  [[nodiscard]] int rows() const { return rows_; }
  [[nodiscard]] std::size_t num_pixels() const { return samples_.size(); }
  [[nodiscard]] int u(std::int32_t pixel) const { return pixel % cols_; }
  [[nodiscard]] int v(std::int32_t pixel) const { return pixel / cols_; }
  [[nodiscard]] const Sample& sample(std::int32_t pixel) const { return samples_[pixel]; }
  /// Whether the pixel is a corner of a dense triangle with an area above 0.
  [[nodiscard]] bool is_used(std::int32_t pixel) const { return used_[pixel] != 0; }
  /// Whether the pixel was measured; also true for lone pixels, which no triangle uses.
  [[nodiscard]] bool is_valid(std::int32_t pixel) const { return valid_[pixel] != 0; }
  [[nodiscard]] bool has_confidence() const { return !confidence_.empty(); }
  [[nodiscard]] float confidence(std::int32_t pixel) const {
    return confidence_.empty() ? 1.0F : confidence_[pixel];
  }
  /// Whether all pixels of a box (last pixels included) have a confidence of 1. The result may be
  /// false even then, because whole tiles are looked up.
  [[nodiscard]] bool has_full_confidence(int first_u, int first_v, int last_u, int last_v) const {
    const int across = cols_ / kConfidenceTile + 1;
    for (int v = first_v / kConfidenceTile; v <= last_v / kConfidenceTile; ++v) {
      for (int u = first_u / kConfidenceTile; u <= last_u / kConfidenceTile; ++u) {
        if (unsure_tiles_[std::ptrdiff_t{v} * across + u] != 0) return false;
      }
    }
    return true;
  }
  [[nodiscard]] std::uint8_t cell(std::int32_t pixel) const { return cells_[pixel]; }
  [[nodiscard]] std::int64_t num_faces() const { return num_faces_; }
  /// Pixels that some dense triangle uses.
  [[nodiscard]] std::int64_t num_used() const { return num_used_; }
  /// Valid pixels of the grid.
  [[nodiscard]] std::int64_t num_valid() const { return num_valid_; }
  [[nodiscard]] const StepRule& steps() const { return steps_; }
  /// The z of a pixel in units of the input.
  [[nodiscard]] float depth(std::int32_t pixel) const {
    return static_cast<float>(unit_ * double{samples_[pixel].z} + center_.z());
  }
  /// depth() of all pixels.
  void depths(std::span<float> out) const;
  /// cell() of all pixels, and is_used() of all pixels.
  [[nodiscard]] std::span<const std::uint8_t> cells() const { return cells_; }
  [[nodiscard]] std::span<const std::uint8_t> used() const { return used_; }
  /// Mean confidence of the used pixels; 1 if all are 0.
  [[nodiscard]] float mean_confidence() const { return mean_confidence_; }
  /// Confidence below which a pixel has none: a thousandth of the mean, or 0 if all are 0. It is
  /// above 0 so that a few pixels at the rim of a region, where confidences of another resolution
  /// were rounded, do not decide about it.
  [[nodiscard]] float least_sure() const { return least_sure_; }
  /// Lets is_unsure() hold. Confidences that only mark filled pinholes do not need it.
  void avoid_unsure() { avoids_unsure_ = has_confidence(); }
  [[nodiscard]] bool avoids_unsure() const { return avoids_unsure_; }
  /// Whether a pixel has no confidence, so that no vertex within the surface should be there.
  [[nodiscard]] bool is_unsure(std::int32_t pixel) const {
    return avoids_unsure_ && confidence_[pixel] < least_sure_;
  }
  /// Column and row of the input.
  [[nodiscard]] std::int32_t input_u(std::int32_t pixel) const { return u(pixel) + u0_; }
  [[nodiscard]] std::int32_t input_v(std::int32_t pixel) const { return v(pixel) + v0_; }
  /// The pixel of this surface at a pixel of the input, or -1 outside.
  [[nodiscard]] std::int32_t pixel_at(std::int64_t input_u, std::int64_t input_v) const;
  /// is_used() for each column of a row of the input.
  /// @param out  as long as a row of the input.
  void uses_of_row(std::int64_t input_v, std::span<std::uint8_t> out) const;
  /// A pixel of the input as one number, for sizes up to 65 536.
  [[nodiscard]] std::uint32_t place(int u, int v) const {
    return static_cast<std::uint32_t>(v + v0_) << 16 | static_cast<std::uint32_t>(u + u0_);
  }
  /// All dense triangles with an area above 0.
  void dense_triangles(std::vector<std::array<std::int32_t, 3>>& out) const;
  /// Whether these pixels (column, row) are inside this surface and valid.
  [[nodiscard]] bool holds_all(const std::array<std::array<std::int32_t, 2>, 3>& pixels) const {
    return std::ranges::all_of(pixels, [this](const auto& p) {
      return p[0] >= 0 && p[1] >= 0 && p[0] < cols_ && p[1] < rows_ &&
             valid_[std::ptrdiff_t{p[1]} * cols_ + p[0]] != 0;
    });
  }
  /// The normalised sum of area times normal over the complete cells; (0, 0, 1) if that is 0.
  [[nodiscard]] Vec3 mean_normal() const;
  /// The columns and rows by which a small move (in input units) from a pixel's point goes along
  /// the surface: least squares in the tangents that central differences give.
  [[nodiscard]] Eigen::Vector2f pixels_along(std::int32_t pixel, const Vec3& move) const;
  /// Mean area of the used pixels, before confidences weight it.
  [[nodiscard]] float mean_area() const;
  [[nodiscard]] double unit() const { return unit_; }
  [[nodiscard]] const Eigen::Vector3d& center() const { return center_; }

 private:
  bool crop(const PointGridView& grid);
  /// Whether the bounding box may be so much larger than the surface, because of lone pixels far
  /// away, that single precision is too coarse for the surface.
  [[nodiscard]] bool is_stretched(const DenseRule& rule) const;
  /// Fills `joined_` with the valid pixels that a triangle can use by the rule.
  void find_joined(const PointGridView& grid, const DenseRule& rule);
  /// Builds samples, cells and uses of all pixels.
  void build(const PointGridView& grid, const DenseRule& rule, int num_threads);
  /// Rebuilds the cells at a pixel of the crop and the samples of their corners.
  void build_around(const PointGridView& grid, const DenseRule& rule, int u, int v);
  void add_areas();
  [[nodiscard]] float mean_weight() const;
  void find_unsure_tiles();
  void weigh(const PointGridView& grid, std::span<const float> confidence);

  int cols_ = 0, rows_ = 0;            ///< Padded.
  int u0_ = 0, v0_ = 0;                ///< The crop's corner in the input.
  int used_cols_ = 0, used_rows_ = 0;  ///< Shape of the crop.
  double unit_ = 1.0;                  ///< Input units per unit of the samples.
  Eigen::Vector3d center_ = Eigen::Vector3d::Zero();
  std::vector<Sample> samples_;
  std::vector<std::uint8_t> valid_, used_;
  std::vector<float> confidence_;            ///< By pixel; or empty.
  static constexpr int kConfidenceTile = 4;  ///< Pixels.
  /// By tile of kConfidenceTile x kConfidenceTile pixels: whether one of them has a confidence
  /// below 1.
  std::vector<std::uint8_t> unsure_tiles_;
  std::vector<std::uint8_t> cells_;
  std::vector<float> row_floats_;  ///< Scratch memory of loops over rows, like the next two.
  std::vector<std::uint8_t> row_cells_;
  std::vector<std::array<int, 2>> row_counts_;
  std::vector<std::uint8_t> joined_;  ///< By pixel of the grid; see find_joined().
  StepRule steps_;
  Eigen::Vector3d low_ = Eigen::Vector3d::Zero(), high_ = Eigen::Vector3d::Zero();
  std::int64_t num_faces_ = 0, num_used_ = 0, num_valid_ = 0;
  float mean_confidence_ = 1.0F, least_sure_ = 0.0F;
  bool avoids_unsure_ = false;
  float mean_area_ = 0.0F;  ///< mean_area(), set only if there are confidences.
};

/// The corners (pixels) of the second or first triangle of a cell.
/// @param a  the pixel at corner a.
inline std::array<std::int32_t, 3> cell_triangle(std::uint8_t cell, bool second, std::int32_t a,
                                                 int cols) {
  const std::int32_t b = a + 1, c = a + cols, d = c + 1;
  if ((cell & kCutFromBToC) != 0) {
    return second ? std::array<std::int32_t, 3>{b, d, c} : std::array<std::int32_t, 3>{a, b, c};
  }
  return second ? std::array<std::int32_t, 3>{a, d, c} : std::array<std::int32_t, 3>{a, b, d};
}

}  // namespace manip3d::relief_detail
