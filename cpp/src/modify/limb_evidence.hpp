#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>

#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"
#include "modify/phantom_image.hpp"

/// @file
/// Evidence of joints and depth image about a limb: is it there, is it seen, was it guessed?
namespace manip3d {

/// May the person have a limb where the tracker sees it?
///
/// A tracker that was made for whole people invents the joints of a limb that is not there, and
/// says that it sees them. The depth image refutes a tracked joint if the camera looks through it:
/// nothing of the person is at its depth, and nothing at all is nearer. A bone that is much longer
/// than that of the other limb is refuted too. One refuted joint refutes the limb. `body_index` may
/// be null: then whatever is at a joint's depth counts as the person.
bool may_have_limb(const Skeleton& person, Limb limb, const DepthView& depth,
                   const std::uint8_t* body_index, const PixelProjector& projector);

/// Length of a limb along its usable joints, metres.
float limb_length(const Skeleton& skeleton, Limb limb);

/// Share of the limb, by length, in front of which the camera sees the limb. A part that it sees
/// through, onto what of the limb lies far behind, is not there.
double visible_share(const Skeleton& skeleton, Limb limb, const PixelProjector& projector,
                     const PhantomImage& image);

/// Does the camera see the limb where a joint is, tracked or guessed?
bool shows_limb_at(const Skeleton& skeleton, Limb limb, Joint joint,
                   const PixelProjector& projector, const PhantomImage& image);

/// Are joints of a limb guessed where only a stump is, of a person whose other limb is tracked? A
/// limb that is bent at the elbow or the knee still reaches .43 of its length from its root.
bool is_guessed_at_stump(const Skeleton& skeleton, Limb limb);

/// Has a tracker told all joints but those of a limb, of hands and feet?
bool has_main_joints(const Skeleton& skeleton, Limb affected);

/// Has the person the affected limb? An amputee has none in any frame, though the joints that a
/// tracker invents may lie on the person in some, so the answer is a running mean over about a
/// second.
class LimbPresence {
 public:
  void add(const Skeleton& skeleton, Limb affected, const PixelProjector& projector,
           const PhantomImage& image);
  [[nodiscard]] bool is_there() const { return share_ >= 0.5; }
  void reset() { share_ = frames_ = 0.0; }

 private:
  double share_ = 0.0;   ///< Share of the last frames in which the limb was seen.
  double frames_ = 0.0;  ///< How many these are.
};

/// For how long joints of a limb have been guessed.
class InferredClock {
 public:
  /// The root does not count: it is guessed whenever a seated person's thigh hides it, and the
  /// trunk tells where it is.
  /// @param is_seen  whether the depth image shows the limb at a joint, which makes a guess of it
  ///                 as good as any.
  /// @returns seconds since the joint that has been guessed for longest was known.
  template <typename Seen>
  double add(const Skeleton& skeleton, Limb limb, double time_s, const Seen& is_seen) {
    double longest = 0.0;
    for (std::size_t i = 1; i < kNumMainJoints; ++i) {
      const Joint joint = limb_chain(limb)[i];
      const bool is_first = !last_known_s_[i];
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
