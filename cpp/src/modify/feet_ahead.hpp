#pragma once

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"

namespace manip3d {

/// Which way a person's feet point, over the frames.
///
/// Shoulders, hips and the spine say where ahead is, if left is left: to the left's cross product
/// with up. Joints whose sides are exchanged, and those of a mirrored image, say behind; feet point
/// ahead all the same. Of recorded people (the tuning half of benchmarks/bench_people.py) a foot's
/// joint lies 1 to 6 cm ahead of the ankle's in the mean of a second, of simulated people 8 cm and
/// more.
class FeetAhead {
 public:
  /// Learns from a frame. Feet of shins that do not stand, and those of the affected leg, which a
  /// tracker invents, tell nothing.
  void learn(const Skeleton& person, Limb affected);
  /// The person's sides are told right, or wrong; neither where too little is known.
  [[nodiscard]] bool point_ahead() const { return is_known() && ahead_m_ > kTelling; }
  [[nodiscard]] bool point_backwards() const { return is_known() && ahead_m_ < -kTelling; }
  void reset() { *this = {}; }

 private:
  static constexpr double kTelling = 0.005;  // metres: a third of what the least trial has
  static constexpr double kLeast = 8.0;      // frames
  [[nodiscard]] bool is_known() const { return frames_ >= kLeast; }
  double frames_ = 0.0, ahead_m_ = 0.0;
};

}  // namespace manip3d
