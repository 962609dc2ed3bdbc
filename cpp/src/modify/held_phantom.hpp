#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "geometry/constants.hpp"
#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/mirror.hpp"
#include "manip3d/modify/phantom_pipeline.hpp"
#include "modify/phantom_image.hpp"

namespace manip3d {

/// The mirrored points of a limb, and those that fill the gap around its root.
struct MirroredLimb {
  std::vector<MirroredPoint> limb, root;

  void reserve(std::size_t num_pixels) {
    limb.reserve(num_pixels);
    root.reserve(num_pixels);
  }
};

/// The phantom of the last frame in which the intact limb could be mirrored. In frames in which it
/// cannot be mirrored, this phantom moves with the body for a while, and fades.
class HeldPhantom {
 public:
  void reserve(std::size_t num_pixels);
  void forget();

  /// Memory for the points that are mirrored in the current frame.
  [[nodiscard]] MirroredLimb& points() { return points_; }
  /// Keeps points() as the phantom of this frame.
  /// @param frame     Axes of the body.
  /// @param skeleton  The person's skeleton with the joints of the phantom.
  /// @param number    Number of the frame, whose colours are the phantom's.
  void keep(const BodyFrame& frame, const Skeleton& skeleton, std::int64_t number, double time_s);
  /// Sets whether the kept phantom is at a wrong place; a misplaced phantom is not held.
  void set_misplaced(bool is_misplaced) { kept_->is_misplaced = is_misplaced; }

  struct Fate {
    PhantomState state = PhantomState::kLost;
    double opacity = 0.0;
  };
  /// State and opacity of the phantom in a frame in which the limb cannot be mirrored.
  [[nodiscard]] Fate fate(const PhantomOptions& options, double time_s) const;

  /// The points, moved with the body to the axes `frame`; valid until the next call.
  [[nodiscard]] const MirroredLimb& moved_to(const BodyFrame& frame);
  /// Number of the frame that was kept.
  [[nodiscard]] std::int64_t number() const { return kept_->number; }
  /// A person's joints with those of the phantom. The latter are marked as inferred unless they
  /// were mirrored in the current frame.
  [[nodiscard]] Skeleton skeleton(const Skeleton& person, Limb affected, const BodyFrame& frame,
                                  bool is_mirrored_now) const;

 private:
  struct Kept {
    BodyFrame frame;
    Skeleton skeleton;
    std::int64_t number = 0;
    bool is_misplaced = false;
  };
  std::optional<Kept> kept_;
  double time_s_ = -kInfinity;  ///< Time of the frame that was kept.
  MirroredLimb points_, moved_;
};

/// Calls use(joint) for the joints that a phantom replaces.
template <typename Use>
void for_each_phantom_joint(Limb affected, const Use& use) {
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    if (is_limb_bone(affected, joint)) use(joint);
  }
}

/// A person without the joints that a phantom replaces.
Skeleton without_limb(const Skeleton& person, Limb affected);

}  // namespace manip3d
