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

/// The plane at which a limb is mirrored, tracked over the frames.
///
/// With PlaneRule::kTrunk the trunk is tracked (TrunkTracker), the vertical comes from the floor
/// (Vertical) or from a person who stands upright (Upright), and the legs of a seated person turn
/// the plane (LegTurn). With PlaneRule::kJoints, and in all modes except kReflection, the plane is
/// that of the joints of each frame. In a frame without a plane, the last plane is used, moved with
/// the spine.
class BodyPlane {
 public:
  explicit BodyPlane(const PhantomOptions& options)
      : options_(options), trunk_(options.affected), legs_(options.affected) {}

  /// No value before the first frame with a plane.
  [[nodiscard]] const std::optional<BodyFrame>& frame() const { return frame_; }
  /// The mirror at frame().
  [[nodiscard]] const Mirror& mirror() const { return mirror_; }

  [[nodiscard]] bool follows_trunk() const {
    return options_.plane == PlaneRule::kTrunk && options_.mode == MirrorMode::kReflection;
  }

  /// Learns the vertical from a floor around the person, or else from an upright person.
  /// @param person  Joints as measured by the tracker.
  void learn_vertical(const Skeleton& person, const PhantomInput& input, const PixelRays& rays,
                      double time_s);
  /// The vertical as a unit vector in the camera frame.
  [[nodiscard]] const Eigen::Vector3d& down() const {
    return vertical_.is_known() ? vertical_.down() : upright_.down();
  }
  [[nodiscard]] DownSource down_source() const;
  /// The floor; no value if a tracked foot is well below it, because it is a table or a bed then.
  [[nodiscard]] std::optional<FloorPlane> floor_under(const Skeleton& person) const;

  /// Updates the plane with the joints of a frame.
  /// @param raw     Joints as measured by the tracker; null: there are none that are reliable.
  /// @param fitted  Joints fitted to the person's points.
  /// @param offset  Offset of the joints from the points around them.
  void update(const Skeleton* raw, const Skeleton& fitted, const JointOffset& offset,
              const PhantomInput& input, const PixelRays& rays, double time_s);
  /// Updates the plane with the surface of the trunk in the same frame.
  void learn_surface(const PersonPoints& points, const PhantomInput& input, const PixelRays& rays);
  /// Turns the plane by the positions of the two legs.
  /// @param has_limb  whether the person has the affected leg.
  void follow_legs(const PersonPoints& points, const Skeleton& fitted, bool has_limb);

  /// Whether the last joints are far from where the trunk has them.
  [[nodiscard]] bool has_far_joints() const { return trunk_.has_far_joints(); }
  /// Whether the plane was found anew because the joints stay at other places of the body.
  [[nodiscard]] bool has_moved() const { return trunk_.has_moved(); }
  /// Standard deviation of the plane's direction, degrees.
  [[nodiscard]] double deviation_deg() const { return trunk_.deviation_deg(); }
  /// The largest standard deviation of the distance of an intact joint from the plane, metres,
  /// among the joints that are so near to the plane that they may be on its other side.
  [[nodiscard]] double deviation_across(const Skeleton& person) const;
  /// Whether the plane is known well enough to tell which leg is on its left.
  [[nodiscard]] bool tells_legs_apart() const;

  /// Forgets the person, but keeps the vertical.
  void forget_person();
  /// Forgets the vertical, because the camera was replaced or moved.
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
  std::optional<BodyFrame> frame_;  ///< `trunk_frame_`, turned by the legs.
  Mirror mirror_;
};

}  // namespace manip3d
