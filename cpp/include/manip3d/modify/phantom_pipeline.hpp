#pragma once

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
  kSource,      ///< Each pixel's texture lies where its source pixel is.
  kCalibration  ///< Where the colour camera sees the pixel's own point: wrong for the phantom.
};

/// The source of the body's plane of symmetry.
enum class PlaneRule : std::uint8_t {
  kTrunk,  ///< The trunk, followed by its surface and all of its joints (TrunkTracker).
  kJoints  ///< Four joints of the frame alone, dissertation eq. 4.2 and 4.8.
};

struct PhantomMeshOptions {
  double max_depth_step = 0.05;  ///< Metres: no triangle spans more [Pajarola et al., 2003].
  Texturing texturing = Texturing::kSource;
};

struct PhantomOptions {
  Limb affected = Limb::kRightArm;
  MirrorMode mode = MirrorMode::kReflection;
  PlaneRule plane = PlaneRule::kTrunk;  ///< Used by kReflection; other modes take the joints.
  bool smooths = true;                  ///< False: joints are taken as they come.
  JointSmootherOptions smoothing;
  KeyPersonOptions key_person;
  PersonMaskOptions mask;
  BoneRule segmentation = BoneRule::kSkin;
  double arm_radius = 0.13, leg_radius = 0.18;  ///< Metres around the limb's bones.
  double root_radius = 0.20;      ///< Metres around shoulder or hip: second filling; 0: none.
  bool keep_residual = false;     ///< Leaves what there is of the affected limb.
  double least_visible = 0.5;     ///< Share of the intact limb that must be seen.
  double inferred_seconds = 0.2;  ///< A joint of the intact limb may be guessed for so long.
  double hold_seconds = 0.5, fade_seconds = 0.5;
  PhantomMeshOptions mesh;
};

/// Input data of one frame. Images are borrowed for the length of a call.
struct PhantomInput {
  DepthView depth;
  const std::uint8_t* body_index = nullptr;  ///< (rows, cols) or null.
  Intrinsics camera;                         ///< A ray table stays the same as long as it lives.
  const Registration* registration = nullptr;
  ColorView color;  ///< The people's clothes tell them apart; without pixels: only ids and places.
  std::span<const Skeleton> people;
  std::int64_t time_ns = 0, number = 0;
};

enum class PixelKind : std::uint8_t {
  kNone,        ///< Nothing here.
  kBody,        ///< A pixel of the body as measured.
  kPhantom,     ///< A mirrored point whose surface faces the camera.
  kAway,        ///< A mirrored point that shows the back of its surface.
  kFilled,      ///< A hole of the phantom, from its neighbours or the limb whose place it takes.
  kRootFilled,  ///< The gap at the root of the limb, from the intact side.
  kBridged      ///< Between two mirrored points that were neighbours.
};

/// Caller-owned memory, written whole.
struct PhantomBuffers {
  float* depth = nullptr;          ///< (rows, cols) metres: person and phantom; 0: nothing.
  std::uint8_t* label = nullptr;   ///< (rows, cols) bone, 1 to 24; 0: none.
  PixelKind* kind = nullptr;       ///< (rows, cols)
  std::int32_t* source = nullptr;  ///< (rows, cols, 2) row and column of the texture; -1: none.
  DepthMeshBuffers mesh;
};

enum class PhantomState : std::uint8_t {
  kTracking,  ///< The intact limb is seen, and mirrored.
  kDegraded,  ///< It is mirrored, but the phantom is not whole: `reason` says what is wrong.
  kHolding,   ///< It cannot be mirrored; the last phantom moves with the body.
  kFading,    ///< The held phantom loses opacity.
  kLost,      ///< There is no phantom.
  kLate       ///< The frame is not newer than the last one; nothing was done.
};
/// Why a state is not kTracking. Where several hold, kCalibration goes first, since joints beside
/// the person explain all else, then kOccluded, then kSides; of kShaky to kCloth, and an arm beside
/// its bones, the one that is farthest beyond its limit.
enum class PhantomReason : std::uint8_t {
  kNone,         ///< The state is kTracking.
  kNoPerson,     ///< The key person's skeleton is not there.
  kNoPlane,      ///< The axes of the body never were there.
  kOccluded,     ///< Too little of the intact limb is seen, or of the person.
  kInferred,     ///< A joint of the intact limb was guessed for long, or an arm is elsewhere.
  kNoSkeleton,   ///< No skeleton has been seen at all.
  kCalibration,  ///< The joints are beside the person's pixels, or of another height than these.
  kStopped,      ///< The joints stand still while the person moves.
  kSides,        ///< The feet point backwards if left is left: joints or images are mirrored.
  kShaky,        ///< The plane of symmetry is not known well enough.
  kLeap,         ///< The phantom moved much farther than the intact limb did.
  kDetached,     ///< The phantom does not hang at the body.
  kShredded,     ///< The phantom is in pieces.
  kCut,          ///< Too much of the person's silhouette was removed.
  kDoubled,      ///< Too much of the affected limb is still there, beside the phantom.
  kCloth,        ///< Too many pixels may be an empty sleeve or leg of trousers.
  kLate,         ///< The frame is not newer than the last one.
};

/// How far a frame with a phantom is from what nobody would believe.
struct PhantomQuality {
  double fit = 1.0;     ///< Share of the tracked joints that lie on the person's pixels.
  double hidden = 0.0;  ///< Share of the tracked joints that something nearer hides.
  /// Height of the person's pixels over that of its joints, a mean over frames; 1: not known.
  double stature = 1.0;
  /// Metres that the limbs' points lie beside their bones, a mean over frames; 0: not known.
  double offset = 0.0;
  double plane_deg = 0.0;  ///< Standard deviation of the plane's normal.
  /// Standard deviation of a leg's distance from the plane, metres, where it may be on either side.
  double across = 0.0;
  double leap = 0.0;     ///< Metres that the phantom's end moved farther than the intact one's.
  double gap = 0.0;      ///< Metres from the root to the largest piece of the phantom.
  double largest = 1.0;  ///< Share of the phantom's pixels that are in that piece.
  double lost = 0.0;     ///< Share of the silhouette below the hips, or of the trunk, gone.
  double left = 0.0;     ///< Share of the affected limb's pixels that are still there.
  /// Pixels that may be an empty sleeve or leg of trousers, as the intact limb hides their mirrored
  /// places, over the intact limb's own.
  double cloth = 0.0;
  /// Pixels above the hips that lie beside all bones, over those of the intact arm; legs: 0.
  double stray = 0.0;
  /// The worst of these over its limit: above 1 the state is not kTracking.
  double score = 0.0;
};

/// The rows of table 4.1.
enum class PhantomStage : std::uint8_t {
  kSegmentation,  ///< With smoothing, key person and mask.
  kRemoval,
  kMirroring,  ///< With writing.
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
  double opacity = 0.0;             ///< To draw the phantom with: 1, or less while it fades.
  double visible = 0.0;             ///< Share of the intact limb that is seen, by length.
  PhantomQuality quality;           ///< Without a phantom, that of a perfect frame.
  std::optional<BodyFrame> plane;   ///< The axes that were mirrored at.
  std::int64_t texture_number = 0;  ///< Frame whose colours the phantom's sources refer to.
  std::int64_t num_person = 0, num_removed = 0, num_mirrored = 0, num_filled = 0;  ///< Pixels.
  std::int64_t num_away = 0;    ///< Mirrored points whose surface faces away.
  std::int64_t num_points = 0;  ///< Vertices before those of seams.
  PhantomMeshSize mesh;
  Skeleton skeleton;             ///< Key person, smoothed, with the phantom's joints.
  std::int64_t late_frames = 0;  ///< Late frames since the start or reset.
  std::array<double, kNumPhantomStages> seconds{};
};

/// A person with a phantom in place of one limb, frame by frame (dissertation sections 4.3.1 and
/// 4.7): mask, smoothed joints, segmentation, removal, mirroring, hole filling, skeleton, points
/// and textured mesh.
///
/// While the intact limb cannot be mirrored (less than `least_visible` of it is seen, a joint of it
/// beyond the root is inferred for more than `inferred_seconds` where the depth image does not show
/// the limb, or on a stump, or the skeleton is gone) the last phantom is held in the body's frame,
/// then fades; where no pixel of the person is left, it is not drawn. Degenerate body axes keep
/// those of the last frame. The plane of a seated person who has the affected leg is that of both
/// legs (LegTurn). Without a body index, points of the floor, points far from the skin of every
/// bone and points that no surface joins to the person are left out; what of a chair touches the
/// person stays (with BoneRule::kPaper all within the depths of the joints is the person). Empty
/// pixels that showed the phantom in the frame before and have three
/// neighbours in it now are filled. A frame that is no newer than the last one is counted and
/// passed over, unless it is more than a second older: then a new recording begins. A stream whose
/// times are all 0 has no clock, nor has one after ten such frames in a row: frames count as 30 a
/// second. An object keeps its memory and allocates nothing after the first frame of a camera.
class PhantomPipeline {
 public:
  /// @throws InputError  an option out of range.
  explicit PhantomPipeline(const PhantomOptions& options = {});
  PhantomPipeline(PhantomPipeline&&) noexcept;
  PhantomPipeline& operator=(PhantomPipeline&&) noexcept;
  ~PhantomPipeline();

  /// @throws InputError  an empty image, sizes that differ from the camera's, a camera or
  ///                     registration out of range, a mesh capacity too small. The next frame is
  ///                     not affected.
  PhantomReport process(const PhantomInput& input, const PhantomBuffers& out);
  /// Makes the person of an id the key person from the next frame on that has it.
  void select(std::int64_t id);
  void reset();

 private:
  class Workspace;
  std::unique_ptr<Workspace> workspace_;
};

}  // namespace manip3d
