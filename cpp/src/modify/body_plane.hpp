#pragma once

#include <optional>

#include "manip3d/modify/mirror.hpp"
#include "manip3d/modify/phantom_pipeline.hpp"
#include "manip3d/modify/segmentation.hpp"
#include "modify/joint_offset.hpp"
#include "modify/leg_turn.hpp"
#include "modify/trunk_tracker.hpp"
#include "modify/upright.hpp"
#include "modify/vertical.hpp"

namespace manip3d {

/// The plane about which a limb is mirrored, and what tells it over the frames.
///
/// By PlaneRule::kTrunk the trunk is followed (TrunkTracker), which way is down is told by the
/// floor (Vertical) or by how the person stands (Upright), and the legs of a seated person turn the
/// plane (LegTurn). By PlaneRule::kJoints, and in other modes than a reflection, it is that of the
/// joints in each frame. While nothing tells the plane, it is the last one, moved with the spine.
class BodyPlane {
 public:
  explicit BodyPlane(const PhantomOptions& options)
      : options_(options), trunk_(options.affected), legs_(options.affected) {}

  /// None as long as nothing has told it.
  [[nodiscard]] const std::optional<BodyFrame>& frame() const { return frame_; }
  /// At frame().
  [[nodiscard]] const Mirror& mirror() const { return mirror_; }

  [[nodiscard]] bool follows_trunk() const {
    return options_.plane == PlaneRule::kTrunk && options_.mode == MirrorMode::kReflection;
  }

  /// Looks for a floor around the person, or for how they stand, where somebody asks for it.
  /// @param person  its joints as the tracker sees them.
  void look_for_floor(const Skeleton& person, const PhantomInput& input, const PixelRays& rays,
                      double time_s);
  /// The floor, unless a tracked foot is well below it: then it is a table or a bed.
  [[nodiscard]] std::optional<FloorPlane> floor_under(const Skeleton& person) const;

  /// Takes in the joints of a frame.
  /// @param raw     as the tracker sees them; null: there are none that can be believed.
  /// @param fitted  joints that lie in the flesh.
  /// @param offset  of the joints from the flesh.
  void update(const Skeleton* raw, const Skeleton& fitted, const JointOffset& offset,
              const PhantomInput& input, const PixelRays& rays, double time_s);
  /// Takes in the surface of the trunk in the same frame.
  void learn_surface(const PersonPoints& points, const PhantomInput& input, const PixelRays& rays);
  /// Turns the plane by what two legs show.
  /// @param has_limb  whether the person has the affected leg.
  void follow_legs(const PersonPoints& points, const Skeleton& fitted, bool has_limb);

  /// Standard deviation of the plane's direction, degrees.
  [[nodiscard]] double deviation_deg() const { return trunk_.deviation_deg(); }
  /// The largest standard deviation of an intact joint's distance from the plane, metres, among the
  /// joints so near to the plane that they may be on its other side.
  [[nodiscard]] double deviation_across(const Skeleton& person) const;
  /// Is the plane known well enough to say which leg is on its left?
  [[nodiscard]] bool tells_legs_apart() const;

  /// Forgets the person, not which way is down.
  void forget_person();
  /// Forgets which way is down: the camera is another one, or has moved.
  void forget_down();

 private:
  void set_frame(const BodyFrame& trunk);
  [[nodiscard]] bool is_of_leg() const { return !is_arm(options_.affected); }
  [[nodiscard]] bool goes_by_skin() const { return options_.segmentation == BoneRule::kSkin; }

  PhantomOptions options_;
  TrunkTracker trunk_;
  LegTurn legs_;
  Vertical vertical_;
  Upright upright_;
  std::optional<BodyFrame> trunk_frame_;
  std::optional<BodyFrame> frame_;  ///< `trunk_frame_` with the turn of the legs.
  Mirror mirror_;
};

}  // namespace manip3d
