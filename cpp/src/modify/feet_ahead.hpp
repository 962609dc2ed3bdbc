#pragma once

#include <algorithm>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"

namespace manip3d {

/// Direction in which a person's feet point and its head leans, over the frames.
///
/// Ahead follows from shoulders, hips and spine, if left and right are correct: it is the cross
/// product of left and up. With left and right exchanged, or in a mirrored image, the cross product
/// points backwards, while feet point ahead and heads lie ahead of the shoulders in any case. In
/// recordings of people (the tuning half of benchmarks/bench_people.py) the joint of a foot is 5 to
/// 60 mm ahead of that of the ankle, averaged over two thirds of a second; a single foot can be up
/// to 6 mm behind. The sum with the head's position is at least 2 mm ahead. Sides count as
/// exchanged only if both feet and sum say so.
class FeetAhead {
 public:
  /// Updates the means with a frame that has a head. Feet of shins that are not upright are not
  /// used, nor those of the affected leg, which a tracker invents.
  void learn(const Skeleton& person, Limb affected);
  /// Whether the person's sides are correct, or exchanged; both are false while too little is
  /// known.
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
  /// Metres by which feet are ahead of ankles, and the head of the middle of the shoulders.
  double feet_m_ = 0.0, head_m_ = 0.0;
};

}  // namespace manip3d
