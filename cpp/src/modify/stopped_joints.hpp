#pragma once

#include <cstddef>
#include <vector>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/segmentation.hpp"

namespace manip3d {

/// Do a person's joints stand still while its flesh moves?
///
/// A tracker that hangs tells the same joints again and again, to the last bit, which one that
/// measures never does. A person who stands still, and one whose joints come less often than depth
/// images, lose nothing by it: joints count as stopped once they have been the same for a while and
/// the person's points are no longer where they were then.
class StoppedJoints {
 public:
  void reserve(std::size_t num_pixels) { depth_.resize(num_pixels); }

  /// Learns from a frame whose person was found.
  /// @param told  the joints as they came.
  void learn(const Skeleton& told, const PersonPoints& points, double time_s);
  /// Have the joints stopped?
  [[nodiscard]] bool are_stopped() const { return are_stopped_; }
  void reset();

 private:
  void remember(const PersonPoints& points);
  [[nodiscard]] double moved_share(const PersonPoints& points) const;

  Skeleton told_;
  bool is_known_ = false, is_repeated_ = false, are_stopped_ = false;
  double since_s_ = 0.0;      ///< Time of the first frame with these joints.
  std::vector<float> depth_;  ///< The person when its joints came again; 0 elsewhere.
};

}  // namespace manip3d
