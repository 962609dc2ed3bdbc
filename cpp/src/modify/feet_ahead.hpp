#pragma once

#include <algorithm>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"

namespace manip3d {

/// Which way a person's feet point and its head leans, over the frames.
///
/// Shoulders, hips and the spine say where ahead is, if left is left: to the left's cross product
/// with up. Joints whose sides are exchanged, and those of a mirrored image, say behind; feet point
/// ahead all the same, and heads lie ahead of shoulders. Of recorded people (the tuning half of
/// benchmarks/bench_people.py) a foot's joint lies 5 to 60 mm ahead of the ankle's in the mean of
/// two thirds of a second, but one foot alone down to 6 mm behind; with the head's place it is 2 mm
/// ahead and more. Only where both say so, sides are wrong.
class FeetAhead {
 public:
  /// Learns from a frame with a head. Feet of shins that do not stand, and those of the affected
  /// leg, which a tracker invents, tell nothing.
  void learn(const Skeleton& person, Limb affected);
  /// The person's sides are told right, or wrong; neither where too little is known.
  [[nodiscard]] bool point_ahead() const { return is_known() && least() > kTelling; }
  [[nodiscard]] bool point_backwards() const { return is_known() && most() < -kTelling; }
  void reset() { *this = {}; }

 private:
  static constexpr double kTelling = 0.005;  // metres
  static constexpr double kLeast = 8.0;      // frames
  [[nodiscard]] bool is_known() const { return frames_ >= kLeast; }
  [[nodiscard]] double least() const { return std::min(feet_m_, feet_m_ + head_m_); }
  [[nodiscard]] double most() const { return std::max(feet_m_, feet_m_ + head_m_); }
  double frames_ = 0.0;
  double feet_m_ = 0.0, head_m_ = 0.0;  ///< Ahead of ankles and of the shoulders' middle.
};

}  // namespace manip3d
