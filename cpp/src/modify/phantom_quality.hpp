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
/// Would a patient believe the picture? Measures of one frame, and their limits.
namespace manip3d {

/// Tracked joints outside the affected limb, as shares of those in the image.
struct JointFit {
  double on_person = 1.0;  ///< They project into the person's pixels or next to them.
  double hidden = 0.0;     ///< They do not, and what is there is much nearer to the camera.
};

/// All joints are on the person where fewer than five are in the image.
JointFit joint_fit(const Skeleton& person, Limb affected, const DepthView& depth,
                   const PixelProjector& projector, const PhantomImage& image);

/// Share of the person's points that lie within reach of some bone; 1 without points. A stout trunk
/// reaches farther.
double bone_fit(const PersonPoints& points, const Girth& girth);

/// Below it, joints and depth do not belong together.
inline constexpr double kLeastFit = 0.7;

/// kCalibration where joints and depth do not belong together, the person is not as tall in both,
/// or its flesh not around its bones; kOccluded where the joints that miss the person are hidden.
PhantomReason misfit(const PhantomQuality& quality, const Stature& stature,
                     const JointOffset& offset);

/// Measures what was drawn. Keeps its memory.
class PictureJudge {
 public:
  void reserve(std::int64_t rows, std::int64_t cols);

  /// Fills in gap, largest, lost, left and stray.
  /// @param points    of the person, as segmented.
  /// @param num_given of these, flesh of the affected leg by its joints and of the other by the
  /// plane:
  ///                  while both legs are there, nobody knows which is right.
  /// @param phantom   its joints in place of the affected limb's.
  /// @param bones     that they were segmented by, of a person of that girth.
  /// @param box       of all that was drawn.
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
    float nearest = 0.0F;  ///< To the root, squared metres.
  };
  std::vector<Piece> sizes_;
};

/// The measure that is worst against its limit, if it is beyond; sets the score. Roots lie deeper
/// in a stout person.
PhantomReason worst_of(Limb affected, const Girth& girth, const Stature& stature,
                       const JointOffset& offset, PhantomQuality& quality);

}  // namespace manip3d
