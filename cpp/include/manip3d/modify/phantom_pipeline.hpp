#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/color_image.hpp"
#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/geometry/grid_mesh.hpp"
#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/joint_smoother.hpp"
#include "manip3d/modify/key_person.hpp"
#include "manip3d/modify/limb.hpp"
#include "manip3d/modify/mirror.hpp"
#include "manip3d/modify/segmentation.hpp"

namespace manip3d {

enum class Texturing : std::uint8_t {
  kSource,  ///< Each pixel shows the colour of its source pixel.
  /// Colour where the colour camera sees the pixel's own point, as for measured points. This is
  /// wrong for the phantom, which is not in the colour image.
  kCalibration
};

/// Source of the body's plane of symmetry.
enum class PlaneRule : std::uint8_t {
  kTrunk,  ///< The trunk, tracked by its surface and all of its joints (TrunkTracker).
  kJoints  ///< Four joints of the current frame, dissertation eq. 4.2 and 4.8.
};

struct PhantomMeshOptions {
  /// Metres: no triangle spans a larger depth difference [Pajarola et al., 2003].
  double max_depth_step = 0.05;
  Texturing texturing = Texturing::kSource;
};

struct PhantomOptions {
  Limb affected = Limb::kRightArm;
  MirrorMode mode = MirrorMode::kReflection;
  /// Used by kReflection only; other modes always use kJoints.
  PlaneRule plane = PlaneRule::kTrunk;
  bool smooths = true;  ///< False: joints are used unsmoothed.
  JointSmootherOptions smoothing;
  KeyPersonOptions key_person;
  PersonMaskOptions mask;
  BoneRule segmentation = BoneRule::kSkin;
  /// Metres around the bones of an arm and of a leg within which points belong to the limb.
  double arm_radius = 0.13, leg_radius = 0.18;
  /// Metres around shoulder or hip within which the gap is filled in a second pass; 0: no second
  /// pass.
  double root_radius = 0.20;
  bool keep_residual = false;  ///< Keep the measured points of the affected limb.
  /// Smallest share of the intact limb, by length, that must be visible.
  double least_visible = 0.5;
  double inferred_seconds = 0.2;  ///< Seconds for which a joint of the intact limb may be inferred.
  /// Seconds for which the last phantom is held, then fades, while the intact limb cannot be
  /// mirrored.
  double hold_seconds = 0.5, fade_seconds = 0.5;
  PhantomMeshOptions mesh;
};

/// Input data of one frame. Images are borrowed for the length of a call.
struct PhantomInput {
  DepthView depth;
  const std::uint8_t* body_index = nullptr;  ///< (rows, cols) or null.
  Intrinsics camera;                         ///< A ray table must not change during its lifetime.
  const Registration* registration = nullptr;
  /// Clothes help to tell people apart; if it has no pixels, only ids and places do.
  ColorView color;
  std::span<const Skeleton> people;
  std::int64_t time_ns = 0, number = 0;
};

enum class PixelKind : std::uint8_t {
  kNone,        ///< No person and no phantom.
  kBody,        ///< A pixel of the body as measured.
  kPhantom,     ///< A mirrored point whose surface faces the camera.
  kAway,        ///< A mirrored point that shows the back of its surface to the camera.
  kFilled,      ///< A hole of the phantom, filled from its neighbours or from the affected limb.
  kRootFilled,  ///< The gap at the root of the limb, filled from the intact side.
  kBridged      ///< A pixel between two mirrored points whose source pixels were neighbours.
};

/// Caller-owned memory; every value is written.
struct PhantomBuffers {
  float* depth = nullptr;          ///< (rows, cols) metres, person and phantom; 0: nothing.
  std::uint8_t* label = nullptr;   ///< (rows, cols) bone, 1 to 24; 0: none.
  PixelKind* kind = nullptr;       ///< (rows, cols)
  std::int32_t* source = nullptr;  ///< (rows, cols, 2) row and column of the texture; -1: none.
  DepthMeshBuffers mesh;
};

enum class PhantomState : std::uint8_t {
  kTracking,  ///< The intact limb is visible and mirrored.
  kDegraded,  ///< The limb is mirrored, but the phantom is faulty; `reason` says why.
  kHolding,   ///< The limb cannot be mirrored; the last phantom moves with the body.
  kFading,    ///< The held phantom loses opacity.
  kLost,      ///< There is no phantom.
  kLate       ///< The frame is not newer than the last one and was skipped.
};
/// Reason of a state other than kTracking. If several apply, kCalibration has priority, because
/// displaced joints explain all other faults, then kOccluded, then kSides; of kShaky to kCloth, the
/// one that exceeds its limit by the largest factor.
enum class PhantomReason : std::uint8_t {
  kNone,      ///< The state is kTracking.
  kNoPerson,  ///< The key person is not among the skeletons, or has no pixels.
  kNoPlane,   ///< The axes of the body have not been found in any frame yet.
  /// Too little of the intact limb, or of the person, is visible, or the phantom lies outside the
  /// image.
  kOccluded,
  kInferred,    ///< A joint of the intact limb was inferred for too long.
  kNoSkeleton,  ///< No skeleton has been received at all.
  /// The joints lie beside the person's pixels, or the heights of joints and pixels differ.
  kCalibration,
  kStopped,   ///< The joints stand still while the person moves.
  kSides,     ///< The feet point backwards, so left and right of joints or images are exchanged.
  kShaky,     ///< The plane of symmetry is too uncertain.
  kLeap,      ///< The phantom moved much farther than the intact limb did.
  kDetached,  ///< The phantom is detached from the body.
  kShredded,  ///< The phantom is in pieces.
  kCut,       ///< Too much of the person's silhouette was removed.
  kDoubled,   ///< Too much of the affected limb is still visible beside the phantom.
  kCloth,     ///< Too many pixels may be an empty sleeve or leg of trousers.
  kLate,      ///< The frame is not newer than the last one.
  kNoJoints,  ///< No skeleton of the frame has a joint of a trunk.
};

/// Evidence for the direction of the vertical.
enum class DownSource : std::uint8_t {
  kAssumed,  ///< None yet: the camera is assumed to be level.
  kPosture,  ///< Spine and leg of the person; no floor has been seen.
  kFloor     ///< A floor that was seen.
};

/// Measures of how wrong a frame with a phantom looks.
struct PhantomQuality {
  /// Share of the tracked joints, before smoothing, that lie on the person's pixels. Joints
  /// without the person near them do not count where no depth is measured; for an arm, neither do
  /// those of the legs where something hides them.
  double fit = 1.0;
  double hidden = 0.0;  ///< Share of the tracked joints that a nearer surface hides.
  /// Height of the person's pixels over that of the joints, averaged over frames; 1: unknown.
  double stature = 1.0;
  /// Distance from the limbs' bones to the middle of the points around them, metres, averaged over
  /// frames; 0: unknown.
  double offset = 0.0;
  double plane_deg = 0.0;  ///< Standard deviation of the plane's normal, degrees.
  /// Standard deviation of the distance of a leg's joint from the plane, metres, for joints that
  /// may be on either side of it.
  double across = 0.0;
  /// Metres by which the phantom's end moved farther than the intact limb's end.
  double leap = 0.0;
  double gap = 0.0;      ///< Metres from the root to the largest piece of the phantom.
  double largest = 1.0;  ///< Share of the phantom's pixels in that piece.
  /// Share of the silhouette below the hips, or of the trunk, that was removed.
  double lost = 0.0;
  double left = 0.0;  ///< Share of the affected limb's pixels that were not removed.
  /// Pixels that may be an empty sleeve or leg of trousers, because the intact limb hides their
  /// mirrored places, relative to the pixels of the intact limb.
  double cloth = 0.0;
  /// Pixels above the hips that lie away from the skin of all bones, relative to the pixels of the
  /// intact arm; 0 for legs.
  double stray = 0.0;
  double outside = 0.0;  ///< Share of the mirrored points that lie outside the image.
  /// The largest ratio of a measure to its limit; above 1 the state is not kTracking.
  double score = 0.0;
};

/// The rows of table 4.1 of the dissertation.
enum class PhantomStage : std::uint8_t {
  kSegmentation,  ///< Includes smoothing, key person and mask.
  kRemoval,
  kMirroring,  ///< Includes drawing the mirrored points.
  kHoleFilling,
  kSkeleton,
  kPointCloud,
  kMesh
};
inline constexpr std::size_t kNumPhantomStages = 7;
inline constexpr std::array<const char*, kNumPhantomStages> kPhantomStageNames = {
    "segmentation",     "removal",     "mirroring",    "hole filling",
    "phantom skeleton", "point cloud", "textured mesh"};

struct PhantomMeshSize {
  std::int64_t num_vertices = 0, num_faces = 0;
};

struct PhantomReport {
  PhantomState state = PhantomState::kLost;
  PhantomReason reason = PhantomReason::kNone;
  double opacity = 0.0;            ///< Opacity to draw the phantom with: 1, or less while it fades.
  double visible = 0.0;            ///< Visible share of the intact limb, by length.
  PhantomQuality quality;          ///< Without a phantom, the values of a perfect frame.
  std::optional<BodyFrame> plane;  ///< The axes at which the limb was mirrored.
  /// The vertical as a unit vector in the camera frame (x right, y down, z ahead).
  Eigen::Vector3d down = Eigen::Vector3d::UnitY();
  DownSource down_source = DownSource::kAssumed;
  /// Number of the frame whose colours the phantom's sources refer to.
  std::int64_t texture_number = 0;
  std::int64_t num_person = 0, num_removed = 0, num_mirrored = 0, num_filled = 0;  ///< Pixels.
  std::int64_t num_away = 0;    ///< Mirrored points whose surface faces away.
  std::int64_t num_points = 0;  ///< Number of vertices, not counting duplicates along seams.
  PhantomMeshSize mesh;
  Skeleton skeleton;  ///< The key person's smoothed skeleton with the joints of the phantom.
  std::int64_t late_frames = 0;  ///< Late frames since the start or reset.
  std::array<double, kNumPhantomStages> seconds{};
};

/// Replaces one limb of a person by a phantom, frame by frame (dissertation sections 4.3.1 and
/// 4.7): mask, smoothed joints, segmentation, removal, mirroring, hole filling, skeleton, points
/// and textured mesh.
///
/// The intact limb cannot be mirrored if less than `least_visible` of it is visible, if one of its
/// joints beyond the root is inferred for more than `inferred_seconds` while the depth image does
/// not show the limb or the limb is a stump, or if the skeleton is missing. The last phantom is
/// then held in the body's frame and fades afterwards. It is not drawn if no pixel of the person is
/// left. If the body axes are degenerate, those of the last frame are used. If a seated person has
/// the affected leg, the plane is that between both legs (LegTurn).
///
/// Without a body index, points of the floor, points far from the skin of every bone and points
/// that no surface connects to the person are left out; parts of a chair that touch the person
/// stay. (With BoneRule::kPaper all points within the depths of the joints count as the person.)
/// Empty pixels that showed the phantom in the previous frame and have three neighbours in the
/// current phantom are filled.
///
/// A frame that is not newer than the last one is counted and skipped. If it is more than a second
/// older, it begins a new recording instead. A stream whose times are all 0 has no clock; nor has a
/// stream from its eleventh such frame in a row on. Its frames count as 30 a second. An object
/// keeps its memory and allocates nothing after the first frame of a camera.
class PhantomPipeline {
 public:
  /// @throws InputError  an option out of range.
  explicit PhantomPipeline(const PhantomOptions& options = {});
  PhantomPipeline(PhantomPipeline&&) noexcept;
  PhantomPipeline& operator=(PhantomPipeline&&) noexcept;
  ~PhantomPipeline();

  /// @throws InputError  an empty image, sizes that differ from the camera's, a camera or
  /// registration out of range, a mesh capacity too small. The next frame is not affected.
  PhantomReport process(const PhantomInput& input, const PhantomBuffers& out);
  /// Makes the person of this id the key person from the next frame on in which it is present.
  void select(std::int64_t id);
  void reset();

 private:
  class Workspace;
  std::unique_ptr<Workspace> workspace_;
};

}  // namespace manip3d
