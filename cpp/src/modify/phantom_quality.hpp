#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "manip3d/geometry/connected_runs.hpp"
#include "manip3d/modify/phantom_pipeline.hpp"
#include "modify/girth.hpp"
#include "modify/joint_offset.hpp"
#include "modify/phantom_image.hpp"
#include "modify/stature.hpp"

/// @file
/// Measures of how wrong the picture of one frame looks, and their limits.
namespace manip3d {

/// Tracked joints outside the affected limb, as shares of those that project into the image. Joints
/// do not count where no depth is measured and the person is not seen near them, as in black
/// trousers; for an arm, neither do joints of the legs where something nearer to the camera is
/// measured and the person is not seen near them. All count if fewer than five would be left.
struct JointFit {
  double on_person = 1.0;  ///< Joints that project onto the person's pixels or next to them.
  /// Other joints at whose pixel something nearer to the camera was measured: much nearer, or with
  /// the person not seen near the joint.
  double hidden = 0.0;
};

/// Measure the fit of the joints; `on_person` is 1 and `hidden` 0 if fewer than five are in the
/// image.
/// @param person  Joints before smoothing, because smoothed ones lag.
/// @param points  Points of the person.
JointFit joint_fit(const Skeleton& person, Limb affected, const DepthView& depth,
                   const PixelProjector& projector, const PersonPoints& points,
                   const PhantomImage& image);

/// Share of the person's points within a limit of their nearest bone, which is larger for a stout
/// trunk; 1 without points.
double bone_fit(const PersonPoints& points, const Girth& girth);

/// Below this share of fitting joints, joints and depth image do not match.
inline constexpr double kMinFit = 0.7;

/// Return kCalibration if joints and depth image do not match, if the person's heights in the two
/// differ, or if the points are not around the bones; kOccluded if the joints that miss the person
/// are hidden; else kNone.
PhantomReason misfit(const PhantomQuality& quality, const Stature& stature,
                     const JointOffset& offset);

/// Measures a drawn frame. Keeps its memory.
class PictureJudge {
 public:
  void reserve(std::int64_t rows, std::int64_t cols);

  /// Fill in `gap`, `largest`, `lost` and `left`.
  /// @param points     Points of the person, as segmented.
  /// @param num_given  Number of points that belong to the affected leg according to the joints and
  ///                   to the other leg according to the plane; while both legs are present, it is
  ///                   unknown which is right.
  /// @param phantom    Skeleton with the joints of the phantom.
  /// @param bones      Bones by which the points were segmented, for a person of this girth.
  /// @param box        Box around everything that was drawn.
  void measure(const PersonPoints& points, std::int64_t num_given, const Skeleton& phantom,
               const BoneSegments& bones, const Girth& girth, const BodyFrame& frame,
               const PixelBox& box, const PhantomOptions& options, const PixelRays& rays,
               const PhantomImage& image, PhantomQuality& quality);

 private:
  void measure_pieces(const Eigen::Vector3f& root, const PixelBox& box, const PixelRays& rays,
                      const PhantomImage& image, PhantomQuality& quality);

  std::vector<std::uint8_t> cells_;
  ConnectedRuns pieces_;
  struct Piece {
    std::int64_t pixels = 0;
    float nearest = 0.0F;  ///< To the root, square metres.
  };
  std::vector<Piece> sizes_;
};

/// Set the score, and return the reason of the measure that exceeds its limit by the largest
/// factor, if any does. In stout people, roots lie deeper in the body.
PhantomReason worst_of(Limb affected, const Girth& girth, const Stature& stature,
                       const JointOffset& offset, PhantomQuality& quality);

}  // namespace manip3d
