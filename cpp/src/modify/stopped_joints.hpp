#pragma once

#include <cstddef>
#include <vector>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/segmentation.hpp"

namespace manip3d {

/// Detects joints that stand still while the person moves.
///
/// A tracker that hangs repeats the same joints bit for bit, which a working one never does. People
/// who stand still, and joints that arrive less often than depth images, must not be reported:
/// joints count as stopped only after they have been the same for a while and the person's points
/// have moved since then.
class StoppedJoints {
 public:
  void reserve(std::size_t num_pixels) { depth_.resize(num_pixels); }

  /// Updates the state with a frame in which the person was found.
  /// @param reported  Joints as received.
  void learn(const Skeleton& reported, const PersonPoints& points, double time_s);
  /// Whether the joints have stopped.
  [[nodiscard]] bool are_stopped() const { return are_stopped_; }
  void reset();

 private:
  void remember(const PersonPoints& points);
  [[nodiscard]] double moved_share(const PersonPoints& points) const;

  Skeleton reported_;
  bool is_known_ = false, is_repeated_ = false, are_stopped_ = false;
  double since_s_ = 0.0;  ///< Time of the first frame with these joints.
  /// Depths of the person when its joints were first repeated; 0 elsewhere.
  std::vector<float> depth_;
};

}  // namespace manip3d
