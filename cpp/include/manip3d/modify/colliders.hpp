#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "manip3d/geometry/skeleton.hpp"

/// @file
/// Bodies as simple solids, and what runs into them (dissertation section 4.3: a capsule or a box
/// for each bone, because a collider of the mesh itself would have to be built every frame).
namespace manip3d {

/// All points within `radius` of a segment.
struct Capsule {
  Eigen::Vector3f start = Eigen::Vector3f::Zero(), end = Eigen::Vector3f::Zero();
  float radius = 0.0F;  ///< 0: there is none.
};

struct ColliderBox {
  Eigen::Vector3f centre = Eigen::Vector3f::Zero();
  Eigen::Quaternionf rotation = Eigen::Quaternionf::Identity();  ///< Box axes to camera frame.
  Eigen::Vector3f half_size = Eigen::Vector3f::Zero();           ///< All 0: there is none.
};

/// The solids of one person in one frame, metres, camera frame.
struct BodyColliders {
  /// By bone; those inside the torso have none. Bone 3's is a sphere around the head.
  std::array<Capsule, kNumJoints> capsules{};
  /// The axes of the box: to the person's left, up, and ahead.
  ColliderBox torso;
};

/// Is a bone part of the torso's box?
constexpr bool is_torso_bone(std::size_t bone) {
  return bone == 1 || bone == 20 || bone == 4 || bone == 8 || bone == 12 || bone == 16;
}
inline constexpr std::uint8_t kTorsoHit = 0;  ///< `Hit::bone` of the torso's box.

struct ColliderOptions {
  double percentile = 0.9;  ///< Which of the distances of a bone's points is its radius.
  int frames = 30;          ///< Over which radii are averaged; 1 to 1000.
  int min_points = 20;      ///< With fewer a frame says nothing about the bone's radius.
  double min_radius = 0.03, max_radius = 0.20;  ///< Metres.
  double first_radius = 0.05;  ///< Radius of a bone that neither had points nor its twin.
};

/// Follows a person's colliders from frame to frame. `update` allocates nothing.
class ColliderTracker {
 public:
  /// @throws InputError  an option out of range.
  explicit ColliderTracker(const ColliderOptions& options = {});

  /// @param label             of each of the person's points: the nearest bone.
  /// @param squared_distance  of each point to it, square metres.
  /// @throws InputError  numbers of labels and distances differ.
  void update(const Skeleton& skeleton, std::span<const std::uint8_t> label,
              std::span<const float> squared_distance);
  void reset();

  [[nodiscard]] const BodyColliders& now() const { return now_; }
  [[nodiscard]] const BodyColliders& before() const { return before_; }

 private:
  void measure(std::span<const std::uint8_t> label, std::span<const float> squared_distance);
  [[nodiscard]] float radius(std::size_t bone) const;

  ColliderOptions options_;
  BodyColliders now_, before_;
  std::vector<float> radii_;  ///< By bone, of the last `frames` frames that had points.
  std::array<std::int64_t, kNumJoints> num_radii_{};
};

/// A sphere (or point) that moves in a straight line from one frame to the next.
struct MovingSphere {
  Eigen::Vector3f from = Eigen::Vector3f::Zero(), to = Eigen::Vector3f::Zero();
  float radius = 0.0F;
};

struct Hit {
  double time = 0.0;      ///< When it first touched: 0 at the frame before, 1 now.
  std::uint8_t bone = 0;  ///< Bone of the capsule, or kTorsoHit.
  Eigen::Vector3f point = Eigen::Vector3f::Zero();  ///< Where the sphere's centre was.
};

/// Surfaces as near as this touch, metres.
inline constexpr double kTouch = 1e-4;

/// The first touch between two frames, with everything in motion; the lower bone if two come at the
/// same time. No speed is too high: distances shrink no faster than relative velocities allow, so
/// time advances by distance over velocity and never past a touch [conservative advancement,
/// Mirtich, "Impulse-based dynamic simulation", 1996].
///
/// Ends of capsules and the box's centre move in straight lines, the box turns by interpolated
/// quaternions. Sizes are those of `now`; what was not there before stands still. What is not
/// finite, or jumps by more than a kilometre, touches nothing.
std::optional<Hit> first_hit(const BodyColliders& before, const BodyColliders& now,
                             const MovingSphere& target);

}  // namespace manip3d
