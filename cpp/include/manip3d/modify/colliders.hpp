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
/// Bodies as simple solids and their collisions (dissertation section 4.3: a capsule or a box for
/// each bone, because a collider of the mesh itself would have to be rebuilt in every frame).
namespace manip3d {

/// All points within `radius` of a segment.
struct Capsule {
  Eigen::Vector3f start = Eigen::Vector3f::Zero(), end = Eigen::Vector3f::Zero();
  float radius = 0.0F;  ///< 0: there is no capsule.
};

struct ColliderBox {
  Eigen::Vector3f centre = Eigen::Vector3f::Zero();
  Eigen::Quaternionf rotation = Eigen::Quaternionf::Identity();  ///< Box axes to camera frame.
  Eigen::Vector3f half_size = Eigen::Vector3f::Zero();           ///< All 0: there is no box.
};

/// The solids of one person in one frame, metres, camera frame.
struct BodyColliders {
  /// By bone. Bones inside the torso's box have none. Bone 3 has a sphere around the head.
  std::array<Capsule, kNumJoints> capsules{};
  /// The axes of the box point to the person's left, up and ahead.
  ColliderBox torso;
};

/// Whether a bone is part of the torso's box.
constexpr bool is_torso_bone(std::size_t bone) {
  return bone == 1 || bone == 20 || bone == 4 || bone == 8 || bone == 12 || bone == 16;
}
inline constexpr std::uint8_t kTorsoHit = 0;  ///< `Hit::bone` of the torso's box.

struct ColliderOptions {
  /// A bone's radius is this quantile of the distances of its points; 0 to 1.
  double percentile = 0.9;
  int frames = 30;      ///< Number of frames over which radii are averaged; 1 to 1000.
  int min_points = 20;  ///< A frame with fewer points of a bone is not used for its radius.
  double min_radius = 0.03, max_radius = 0.20;  ///< Limits of the radius, metres.
  /// Radius, metres, of a bone if neither it nor its opposite ever had points.
  double first_radius = 0.05;
};

/// Tracks a person's colliders from frame to frame. `update` allocates nothing.
class ColliderTracker {
 public:
  /// @throws InputError  an option out of range.
  explicit ColliderTracker(const ColliderOptions& options = {});

  /// @param label             The nearest bone of each of the person's points.
  /// @param squared_distance  Distance of each point to that bone, square metres.
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
  /// By bone: radii in the last `frames` frames that had enough points.
  std::vector<float> radii_;
  std::array<std::int64_t, kNumJoints> num_radii_{};
};

/// A sphere (or point) that moves in a straight line from one frame to the next.
struct MovingSphere {
  Eigen::Vector3f from = Eigen::Vector3f::Zero(), to = Eigen::Vector3f::Zero();
  float radius = 0.0F;
};

struct Hit {
  double time = 0.0;  ///< Time of the first contact: 0 at the previous frame, 1 at the current one.
  std::uint8_t bone = 0;                            ///< Bone of the capsule, or kTorsoHit.
  Eigen::Vector3f point = Eigen::Vector3f::Zero();  ///< Centre of the sphere at that time.
};

/// Surfaces within this distance of each other count as touching, metres.
inline constexpr double kTouch = 1e-4;

/// Return the first contact between two frames while both the body and the sphere move; the lower
/// bone if two contacts have the same time. Fast motion does not tunnel: time advances by distance
/// over relative velocity, an upper bound of how fast a distance shrinks, and so never beyond a
/// contact [conservative advancement, Mirtich, "Impulse-based dynamic simulation", 1996].
///
/// Ends of capsules and the centre of the box move in straight lines; the box turns by interpolated
/// quaternions. Sizes are those of `now`. A solid that is not in `before` stands still. A solid or
/// sphere that is not finite, or moves by more than a kilometre, has no contact.
std::optional<Hit> first_hit(const BodyColliders& before, const BodyColliders& now,
                             const MovingSphere& target);

}  // namespace manip3d
