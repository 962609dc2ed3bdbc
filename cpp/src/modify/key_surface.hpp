#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numbers>
#include <optional>
#include <span>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/modify/segmentation.hpp"
#include "modify/phantom_image.hpp"
#include "modify/trunk_pose.hpp"

/// @file
/// The surface of a trunk in a key frame, and what a depth image shows of it.
namespace manip3d {

/// With fewer points than these, a surface tells nothing.
inline constexpr std::size_t kLeastSurface = 60;
inline constexpr double kSurfaceScale = 0.02;  ///< Metres, of the Geman-McClure weight.
/// Neighbours share their noise, so that 500 points tell as much as some thirty: four times the
/// noise of one is that of all.
inline constexpr double kSharedNoise = 4.0;

/// How far the depth image is from a point of a surface, along its normal.
struct SurfaceResidual {
  double off = 0.0;    ///< Metres.
  double share = 1.0;  ///< The Geman-McClure weight is 1 / share^2.
  /// Below sqrt(3) of the scale: there the weight is 1 / 16.
  [[nodiscard]] bool agrees() const { return std::abs(off) < std::numbers::sqrt3 * kSurfaceScale; }
  [[nodiscard]] double weight(double noise) const { return 1.0 / (noise * noise * share * share); }
};

/// The depth image of a frame, and where its pixels look. Borrows both.
class SeenDepth {
 public:
  SeenDepth(const DepthView& depth, const PixelRays& rays, const Intrinsics& camera)
      : depth_(&depth), rays_(&rays), projector_(camera, rays) {}

  /// At the pixel that a point projects to; none where nothing was measured.
  [[nodiscard]] std::optional<SurfaceResidual> residual_at(const Eigen::Vector3d& p,
                                                           const Eigen::Vector3d& normal,
                                                           double scale = kSurfaceScale) const;

  /// The normal of the least-squares plane z = a x + b y + c through the points around a pixel,
  /// towards the camera; none on edges.
  [[nodiscard]] std::optional<Eigen::Vector3d> normal_at(std::int32_t pixel) const;

 private:
  const DepthView* depth_;
  const PixelRays* rays_;
  PixelProjector projector_;
};

/// Points of a trunk as it is turned nowhere in itself.
class KeySurface {
 public:
  struct Point {
    Eigen::Vector3d place, normal;  ///< In the trunk, not twisted.
    double share = 0.0;             ///< Part that it has in the pelvis's turn.
  };
  /// The part of the trunk that the joints enclose, metres in the trunk.
  struct Extent {
    double low = 0.0, high = 0.0;
    double half = 0.17;  ///< Half of its width, that of a narrow adult at least.
  };
  /// Between the key frame and the surface that is seen.
  struct Agreement {
    std::size_t points = 0;
    double off = 0.0;  ///< Sum of their distances, metres.
  };

  KeySurface();

  [[nodiscard]] std::span<const Point> points() const { return points_; }
  [[nodiscard]] bool is_known() const { return points_.size() >= kLeastSurface; }
  /// Noise of a pixel's distance to the key frame, metres.
  [[nodiscard]] double noise() const;

  /// Is the trunk turned so far, or so little of it seen, that another key frame tells more?
  [[nodiscard]] bool is_outdated(const TrunkPose& pose) const;
  /// Takes the points of a person that lie on the trunk, not on what hangs beside it, unless they
  /// are too few: a frame without depth does not end what is known.
  /// @param pelvis_turn  radians that the pelvis is turned by; nothing turns with it for an arm.
  /// @return  whether it took them.
  bool renew(const PersonPoints& person, const SeenDepth& seen, const TrunkPose& pose,
             const Extent& extent, bool is_arm, double pelvis_turn);

  /// Learns how much of it a frame shows, and with what residual.
  void learn(const Agreement& agreed);

  void reset();

 private:
  std::vector<Point> points_;
  Eigen::Quaterniond key_rotation_ = Eigen::Quaterniond::Identity();
  double residual_ = 0.0;  ///< Mean distance of what is seen from the key frame, metres.
  double share_ = 0.0;     ///< Share of the points that the last frame agreed with.
};

}  // namespace manip3d
