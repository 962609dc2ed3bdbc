#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>

#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/joint_smoother.hpp"
#include "manip3d/modify/limb.hpp"
#include "modify/phantom_image.hpp"

/// @file
/// Evidence of joints and depth image about a limb: whether it exists, is visible, or was inferred.
namespace manip3d {

/// Whether the person may have a limb where the tracker reports it.
///
/// A tracker that was made for whole people invents the joints of a missing limb and reports them
/// as tracked. The depth image refutes a tracked joint if the camera looks through it: nothing of
/// the person is at its depth, and nothing at all is nearer. A bone that is much longer than that
/// of the other limb is refuted as well, if the end of the latter is tracked. One refuted joint
/// refutes the limb. `body_index` may be null; then anything at a joint's depth counts as the
/// person.
bool may_have_limb(const Skeleton& person, Limb limb, const DepthView& depth,
                   const std::uint8_t* body_index, const PixelProjector& projector);

/// Length of a limb along its usable joints, metres.
float limb_length(const Skeleton& skeleton, Limb limb);

/// Return the share of the limb, by length, at which the camera sees the limb itself or a part of
/// it that is in front. Places at which the visible part of the limb is far behind the bone do not
/// count.
double visible_share(const Skeleton& skeleton, Limb limb, const PixelProjector& projector,
                     const PhantomImage& image);

/// Whether the camera sees the limb at a joint, which may be tracked or inferred.
bool shows_limb_at(const Skeleton& skeleton, Limb limb, Joint joint,
                   const PixelProjector& projector, const PhantomImage& image);

/// Whether some joints of a limb are inferred and lie within a stump, while the other limb is
/// tracked. (A limb that is bent at the elbow or the knee still reaches 0.43 of its length from its
/// root.)
bool is_guessed_at_stump(const Skeleton& skeleton, Limb limb);

/// Whether head, spine and the three inner joints of all other limbs are usable.
bool has_main_joints(const Skeleton& skeleton, Limb affected);

/// Whether the person has the affected limb. An amputee has none in any frame, but in some frames
/// the joints that a tracker invents may lie on the person; the answer is therefore a running mean
/// over about a second.
class LimbPresence {
 public:
  void add(const Skeleton& skeleton, Limb affected, const PixelProjector& projector,
           const PhantomImage& image);
  [[nodiscard]] bool is_there() const { return share_ >= 0.5; }
  void reset() { share_ = frames_ = 0.0; }

 private:
  double share_ = 0.0;   ///< Share of the last frames in which the limb was visible.
  double frames_ = 0.0;  ///< Number of these frames.
};

/// Seconds for which joints of a limb have been inferred.
class InferredClock {
 public:
  /// Update with a frame. The root does not count: it is inferred whenever a seated person's thigh
  /// hides it, and its place follows from the trunk. Nor does a joint that was never known, because
  /// some trackers have no joints of hands and feet.
  /// @param is_seen  Whether the depth image shows the limb at a joint; an inferred joint then
  ///                 counts as known.
  /// @returns seconds since the last known state of the joint that has been inferred for longest.
  template <typename Seen>
  double add(const Skeleton& skeleton, Limb limb, double time_s, const Seen& is_seen) {
    double longest = 0.0;
    for (std::size_t i = 1; i < kNumMainJoints; ++i) {
      const Joint joint = limb_chain(limb)[i];
      const bool is_first = !last_known_s_[i];
      if (is_first && !is_usable(skeleton, joint)) continue;
      if (is_first || skeleton.state(joint) == TrackingState::kTracked || is_seen(joint)) {
        last_known_s_[i] = time_s;
      }
      longest = std::max(longest, time_s - *last_known_s_[i]);
    }
    return longest;
  }
  void reset() { last_known_s_.fill(std::nullopt); }

 private:
  std::array<std::optional<double>, kNumMainJoints> last_known_s_{};
};

}  // namespace manip3d
