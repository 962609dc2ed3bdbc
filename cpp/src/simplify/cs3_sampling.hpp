#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/simplify/cs3.hpp"
#include "simplify/importance_map.hpp"

namespace manip3d {

/// The valid slots in order of decreasing importance; ties by slot.
class ImportanceOrder {
 public:
  void sort(const ImportanceMap& map);
  [[nodiscard]] const std::vector<Slot>& slots() const { return slots_; }

 private:
  template <typename Item>
  void sort_items(const ImportanceMap& map, std::vector<Item>& items);

  std::vector<Slot> slots_;
  std::vector<std::uint32_t> small_items_;
  std::vector<std::uint64_t> large_items_;
  std::vector<std::uint32_t> low_, high_;  ///< Index of the next item of each digit.
};

/// Eigenvectors of A's Hessian: (u, v) is that of the eigenvalue with the larger magnitude.
struct PrincipalDirections {
  double u = 1.0, v = 0.0;
  double stretch = 1.0;  ///< sqrt(|lambda_max / lambda_min|), at most 4 (eq. 3.7).
};

/// Chooses slots by either sampling method, for one factor or for a number of points.
class Cs3Sampler {
 public:
  /// Fills slots(), ordered by pixel, and the counts in the report.
  void choose(const RangeImage& image, const ImportanceMap& map, const ImportanceOrder& order,
              const Cs3Options& options, Cs3Report& report);
  [[nodiscard]] const std::vector<Slot>& slots() const { return slots_; }

 private:
  struct Frame;
  std::int64_t sample(const Frame& frame, double factor);
  std::int64_t sample_by_order(const Frame& frame, double factor);
  void find_directions(const Frame& frame);
  std::int64_t sample_maxima(const Frame& frame, double factor);
  void block(const Frame& frame, Slot slot, double radius);
  double search(const Frame& frame, Cs3Report& report);
  void go_on(const Frame& frame);
  void sort_by_pixel(const Frame& frame);

  std::vector<Slot> chosen_;                     ///< In order of importance.
  std::vector<Slot> slots_;                      ///< In order of pixels.
  std::vector<std::uint64_t> blocked_;           ///< One bit per slot.
  std::vector<std::uint64_t> selected_;          ///< One bit per slot.
  std::vector<PrincipalDirections> directions_;  ///< By slot, for non-maximum suppression.
};

}  // namespace manip3d
