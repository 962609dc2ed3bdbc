#include "manip3d/modify/phantom_pipeline.hpp"

#include <algorithm>
#include <chrono>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "geometry/constants.hpp"
#include "geometry/same_camera.hpp"
#include "manip3d/error.hpp"
#include "manip3d/modify/limb_fit.hpp"
#include "modify/body_plane.hpp"
#include "modify/border_memory.hpp"
#include "modify/check_option.hpp"
#include "modify/frame_clock.hpp"
#include "modify/girth.hpp"
#include "modify/held_phantom.hpp"
#include "modify/joint_offset.hpp"
#include "modify/limb_evidence.hpp"
#include "modify/loose_cloth.hpp"
#include "modify/patient.hpp"
#include "modify/phantom_mesh.hpp"
#include "modify/phantom_quality.hpp"
#include "modify/pixel_bounds.hpp"
#include "modify/stature.hpp"
#include "modify/stopped_joints.hpp"
#include "modify/surroundings.hpp"

namespace manip3d {
namespace {

void check_all_options(const PhantomOptions& o) {
  check_up_to("arm_radius", o.arm_radius, 1.0);
  check_up_to("leg_radius", o.leg_radius, 1.0);
  check_up_to("root_radius", o.root_radius, 1.0);
  check_up_to("least_visible", o.least_visible, 1.0);
  check_up_to("inferred_seconds", o.inferred_seconds, 3600.0);
  check_up_to("hold_seconds", o.hold_seconds, 3600.0);
  check_up_to("fade_seconds", o.fade_seconds, 3600.0);
  check_up_to("max_depth_step", o.mesh.max_depth_step, 100.0);
  check_options(o.mask);
}

/// Measures the time of the stages of a frame: end() adds the time since the last end() to a stage.
class StageClock {
 public:
  explicit StageClock(std::array<double, kNumPhantomStages>& seconds) : seconds_(seconds) {}
  void end(PhantomStage stage) {
    const auto now = Clock::now();
    seconds_[static_cast<std::size_t>(stage)] += std::chrono::duration<double>(now - last_).count();
    last_ = now;
  }

 private:
  using Clock = std::chrono::steady_clock;
  std::array<double, kNumPhantomStages>& seconds_;
  Clock::time_point last_ = Clock::now();
};

/// Measures how much farther the end of the phantom (hand or foot) moves from frame to frame than
/// the end of the intact limb: a mirrored limb moves as far as its original.
class LeapMeter {
 public:
  /// Adds the ends in a new frame.
  /// @return  the leap, metres, at least 0; 0 if the previous frame is too old.
  double add(const Eigen::Vector3f& phantom, const Eigen::Vector3f& intact, double time_s) {
    constexpr double kUnseen = 0.25;  // seconds after which a limb may be anywhere
    double leap = 0.0;
    if (last_ && time_s - last_->time_s <= kUnseen) {
      const float mine = (phantom - last_->phantom).norm();
      const float other = (intact - last_->intact).norm();
      leap = std::max(0.0, static_cast<double>(mine - other));
    }
    last_ = Ends{phantom, intact, time_s};
    return leap;
  }
  void reset() { last_.reset(); }

 private:
  struct Ends {
    Eigen::Vector3f phantom, intact;
    double time_s = 0.0;
  };
  std::optional<Ends> last_;
};

/// Reason for a frame in which the patient was not found. People are found by the joints of their
/// trunks; without any, nothing is known about who is in view.
PhantomReason reason_for_absence(std::span<const Skeleton> people) {
  const bool has_joints = std::ranges::any_of(
      people, [](const Skeleton& person) { return spine_base(person).has_value(); });
  return has_joints ? PhantomReason::kNoPerson : PhantomReason::kNoJoints;
}

}  // namespace

class PhantomPipeline::Workspace {
 public:
  explicit Workspace(const PhantomOptions& options)
      : options_(options), patient_(options), plane_(options) {
    check_all_options(options);
  }

  PhantomReport process(const PhantomInput& input, const PhantomBuffers& out) {
    check_input(input);
    PhantomReport report;
    const FrameOrder order = clock_.add(input.time_ns, input.number);
    report.late_frames = clock_.late_frames();
    if (order == FrameOrder::kLate) {
      report.state = PhantomState::kLate;
      report.reason = PhantomReason::kLate;
      return report;
    }
    if (order == FrameOrder::kNewRecording) start_anew();
    StageClock stages(report.seconds);
    follow_camera(input.camera);
    const double time_s = clock_.seconds();
    const PhantomImage image = image_of(input, out);
    const PatientFrame now = find_patient(input, time_s);
    const std::optional<Skeleton> fitted = find_points(now, input);
    report.down = plane_.down();
    report.down_source = plane_.down_source();
    segment(now, fitted, input, image, report);
    if (points_.count == 0) {  // a phantom without a person would float in the air
      leap_.reset();
      report.reason = reason_for_nobody(now, input);
      return report;
    }
    if (now.is_here) {
      measure_fit(now, input, image, report.quality);
      stopped_.learn(now.raw, points_, time_s);
    }
    stages.end(PhantomStage::kSegmentation);
    TakenOut taken;
    if (!options_.keep_residual) {
      if (now.is_here) look_for_limb(*now.person, *fitted, image);
      taken = remove(*fitted, input, image, report);
    }
    report.plane = plane_.frame();
    stages.end(PhantomStage::kRemoval);
    decide_state(now, *fitted, input.people, time_s, image, report);
    const Shown shown = mirror(*now.person, *fitted, input, image, report);
    stages.end(PhantomStage::kMirroring);
    const PixelBox all = fill(shown, time_s, image, report);
    stages.end(PhantomStage::kHoleFilling);
    report.skeleton = phantom_skeleton(*now.person, report.state);
    judge_picture(*now.person, taken, shown.drawn.num_outside, time_s, all, image, report);
    stages.end(PhantomStage::kSkeleton);
    report.num_points = write_points(image, all, rays_, out.mesh, pixel_scratch_);
    stages.end(PhantomStage::kPointCloud);
    report.mesh = write_mesh(image, all, rays_, report.num_points, pixel_scratch_,
                             input.registration, options_.mesh, out.mesh);
    stages.end(PhantomStage::kMesh);
    return report;
  }

  void select(std::int64_t id) { patient_.select(id); }

  void reset() {
    clock_.reset();
    start_anew();
  }

 private:
  /// @throws InputError  the images do not have the sizes of the camera and the registration.
  static void check_input(const PhantomInput& input) {
    check_intrinsics(input.camera, "camera");
    const DepthView& depth = input.depth;
    if ((depth.millimetres == nullptr) == (depth.metres == nullptr)) {
      throw InputError("depth: expected either millimetres or metres");
    }
    if (depth.rows != input.camera.height || depth.cols != input.camera.width) {
      throw InputError("depth: expected shape (" + std::to_string(input.camera.height) + ", " +
                       std::to_string(input.camera.width) + ") as the camera says, got (" +
                       std::to_string(depth.rows) + ", " + std::to_string(depth.cols) + ")");
    }
    if (input.registration != nullptr) check_registration(*input.registration);
    if (input.color.pixels == nullptr) return;
    const Intrinsics& color =
        input.registration != nullptr ? input.registration->color : input.camera;
    if (input.color.rows != color.height || input.color.cols != color.width) {
      throw InputError("color: expected shape (" + std::to_string(color.height) + ", " +
                       std::to_string(color.width) + ", 3) as the calibration says, got (" +
                       std::to_string(input.color.rows) + ", " + std::to_string(input.color.cols) +
                       ", 3)");
    }
  }

  /// Forgets everything about earlier frames, except the camera.
  void start_anew() {
    patient_.reset();
    plane_.forget_down();
    forget_person();
  }

  /// Forgets all that was learnt about the person.
  void forget_person() {
    inferred_.reset();
    presence_.reset();
    plane_.forget_person();
    girth_.reset();
    stature_.reset();
    offset_.reset();
    stopped_.reset();
    leap_.reset();
    forget_phantom();
  }

  void forget_phantom() {
    held_.forget();
    border_.forget();
  }

  /// If the camera changed: resizes memory for it, and forgets what depends on the camera.
  void follow_camera(const Intrinsics& camera) {
    if (camera_ && same_camera(*camera_, camera)) return;
    camera_.reset();
    rays_ = PixelRays(camera);
    points_.resize(camera.height, camera.width);
    const auto size = static_cast<std::size_t>(camera.width * camera.height);
    pixel_scratch_.resize(size);
    source_depth_.resize(size);
    removal_.resize(size);
    held_.reserve(size);
    fills_.reserve(size);
    border_.reserve(size);
    picture_.reserve(camera.height, camera.width);
    camera_ = camera;
    stopped_.reserve(size);
    stopped_.reset();
    stature_.reset();
    offset_.reset();
    plane_.forget_down();
    leap_.reset();
    forget_phantom();
  }

  [[nodiscard]] PhantomImage image_of(const PhantomInput& input, const PhantomBuffers& out) {
    return {input.depth.rows, input.depth.cols,     out.depth,      out.label, out.kind,
            out.source,       source_depth_.data(), removal_.data()};
  }

  /// Finds the patient in this frame. If it may be somebody else than in earlier frames, all that
  /// was learnt about the person is forgotten.
  PatientFrame find_patient(const PhantomInput& input, double time_s) {
    const auto& frame = plane_.frame();
    const PatientFrame now =
        patient_.find(input, rays_, frame && plane_.follows_trunk() ? &*frame : nullptr, time_s);
    if (now.is_new) forget_person();
    return now;
  }

  [[nodiscard]] PhantomReason reason_for_nobody(const PatientFrame& now,
                                                const PhantomInput& input) const {
    if (std::ranges::any_of(input.people, is_in_another_unit)) return PhantomReason::kCalibration;
    if (now.is_here && (is_beside_all_ || shows_elsewhere(*now.person, input))) {
      return PhantomReason::kCalibration;
    }
    return lacks_skeletons() ? PhantomReason::kNoSkeleton : reason_for_absence(input.people);
  }

  /// Does the body index have measured pixels of the person? Called if none of them is at the depth
  /// of the joints.
  static bool shows_elsewhere(const Skeleton& person, const PhantomInput& input) {
    if (input.body_index == nullptr || person.body == kNoBody) return false;
    const std::int64_t num_pixels = input.depth.rows * input.depth.cols;
    for (std::int64_t pixel = 0; pixel < num_pixels; ++pixel) {
      if (input.body_index[pixel] == person.body && input.depth.at(pixel) > 0.0F) return true;
    }
    return false;
  }

  /// Has the source shown no skeleton, although body trackers find one within this time?
  [[nodiscard]] bool lacks_skeletons() const {
    constexpr double kPatience = 1.0;  // seconds
    return !patient_.has_been_seen() && clock_.seconds() >= kPatience;
  }

  [[nodiscard]] double radius() const {
    return is_arm(options_.affected) ? options_.arm_radius : options_.leg_radius;
  }

  /// Metres from a limb's bones within which its points are removed. With BoneRule::kSkin, only
  /// points nearest to the limb are labelled as the limb, so that the radius can allow for errors
  /// of the joints.
  [[nodiscard]] double removal_radius() const {
    constexpr double kJointError = 0.08;  // metres
    return goes_by_skin() ? radius() + kJointError : radius();
  }

  [[nodiscard]] bool goes_by_skin() const { return options_.segmentation == BoneRule::kSkin; }

  /// Largest distance of the body's points from the skin of a bone, metres: points farther away are
  /// something else, such as a seat between two thighs.
  [[nodiscard]] double flesh() const {
    constexpr double kClothes = 0.06;  // metres, for clothes and errors of girths and joints
    return goes_by_skin() ? kClothes + static_cast<double>(girth_.limb()) : kInfinity;
  }

  /// Finds the person's points.
  /// @return  the joints of the person, with limbs moved into the flesh that the points show
  ///          (fit_limbs), for all steps that work on points. The report and the measures of fit
  ///          use the tracker's joints instead.
  std::optional<Skeleton> find_points(const PatientFrame& now, const PhantomInput& input) {
    points_.count = 0;
    is_beside_all_ = false;
    if (!now.person) return std::nullopt;
    const Skeleton& person = *now.person;
    const Skeleton believed = goes_by_skin() ? without_unseen_limb(person, input) : person;
    find_person(input.depth, input.body_index, believed, rays_, options_.mask, points_);
    if (now.is_here) plane_.learn_vertical(person, input, rays_, clock_.seconds());
    if (input.body_index == nullptr && goes_by_skin()) leave_surroundings(believed, input);
    return goes_by_skin() ? fit_limbs(believed, points_, girth_.trunk()) : believed;
  }

  /// Removes floor and furniture from the person's points. Needed without a body index, where all
  /// points at the depths of the joints count as the person.
  void leave_surroundings(const Skeleton& person, const PhantomInput& input) {
    const bool has_points = points_.count > 0;
    drop_surroundings(input.depth, bones_of(person), options_.affected, static_cast<float>(flesh()),
                      plane_.floor_under(person), points_, pixel_scratch_);
    is_beside_all_ = has_points && points_.count == 0;
  }

  [[nodiscard]] BoneSegments bones_of(const Skeleton& person) const {
    const BoneRule rule = options_.segmentation;
    return plane_.frame()
               ? body_bones(person, rule, options_.affected, plane_.mirror(), girth_.trunk())
               : body_bones(person, rule, girth_.trunk());
  }

  /// Returns the person without the joints of the affected limb if the depth image shows nothing at
  /// them: with bones to such joints, chest and neck on their way would be removed as the limb. The
  /// joints stay if the person has been seen to have the limb, since joints that are wrong for a
  /// moment are then the best estimate.
  [[nodiscard]] Skeleton without_unseen_limb(const Skeleton& person,
                                             const PhantomInput& input) const {
    const PixelProjector projector(*camera_, rays_);
    const Limb affected = options_.affected;
    if (presence_.is_there() ||
        may_have_limb(person, affected, input.depth, input.body_index, projector)) {
      return person;
    }
    return without_limb(person, affected);
  }

  /// Updates the plane of symmetry, gives each point its bone, and draws the person's points.
  void segment(const PatientFrame& now, const std::optional<Skeleton>& fitted,
               const PhantomInput& input, const PhantomImage& image, PhantomReport& report) {
    if (fitted) {
      const Skeleton* raw = now.is_here && !stopped_.are_stopped() ? &now.raw : nullptr;
      plane_.update(raw, *fitted, offset_, input, rays_, clock_.seconds());
      if (plane_.has_moved()) offset_.reset();  // the offset was that of joints at other places
      segment_by_bones(*fitted);
      plane_.learn_surface(points_, input, rays_);
    }
    draw_person(points_, image);
    report.num_person = points_.count;
    if (plane_.follows_trunk()) report.quality.plane_deg = plane_.deviation_deg();
  }

  /// Gives each point its bone, and learns the girth of the trunk. Bones depend on the girth, and
  /// the girth on the points of the bones: in the first frame both are estimated in turns until the
  /// girth hardly changes.
  void segment_by_bones(const Skeleton& person) {
    constexpr int kRounds = 10;
    constexpr float kSame = 0.02F;  // metres: a smaller change of the girth ends the rounds
    for (int round = 0; round < kRounds; ++round) {
      bones_ = bones_of(person);
      segment_bones(bones_, points_);
      const bool is_new = girth_.is_new();
      if (!goes_by_skin() ||
          std::abs(girth_.learn(bones_, points_, opposite(options_.affected))) < kSame || !is_new)
        break;
    }
    girth_.settle();
  }

  /// Region to search for an empty sleeve or leg of trousers; none for a person who has the limb.
  [[nodiscard]] std::optional<ClothSearch> cloth_search(const Skeleton& person) const {
    const Limb affected = options_.affected, intact = opposite(affected);
    if (presence_.is_there() || !plane_.frame() || !is_usable(person, limb_root(intact))) {
      return std::nullopt;
    }
    if (options_.mode != MirrorMode::kReflection) return std::nullopt;  // others keep no distances
    const Eigen::Vector3f root =
        is_usable(person, limb_root(affected))
            ? person[limb_root(affected)]
            : plane_.mirror()(person[limb_root(intact)].cast<double>()).cast<float>();
    return ClothSearch{affected,
                       root,
                       limb_length(person, intact),
                       static_cast<float>(camera_->fx),
                       *plane_.frame(),
                       plane_.mirror()};
  }

  /// Measures whether the joints, before smoothing, lie where the depth image shows the person.
  void measure_joints(const Skeleton& raw, const PhantomInput& input, const PhantomImage& image,
                      PhantomQuality& quality) const {
    const PixelProjector projector(*camera_, rays_);
    const auto [on_person, hidden] =
        joint_fit(raw, options_.affected, input.depth, projector, points_, image);
    // The share of points near bones says nothing without a body index, where furniture is among
    // the points, or if half of the bones are missing.
    const double most = input.body_index != nullptr && has_main_joints(raw, options_.affected)
                            ? bone_fit(points_, girth_)
                            : 1.0;
    quality.fit = std::min(on_person, most);
    quality.hidden = std::min(hidden, most - quality.fit);
  }

  /// Measures whether the joints lie on the person, are as tall as the person, and are inside of
  /// the limbs.
  void measure_fit(const PatientFrame& now, const PhantomInput& input, const PhantomImage& image,
                   PhantomQuality& quality) {
    measure_joints(now.raw, input, image, quality);
    // Without a body index the floor could be taken for the person's soles; without skins the
    // distance of soles from the foot's bone is unknown.
    if (input.body_index != nullptr && goes_by_skin()) {
      stature_.learn(*now.person, bones_, points_, input.depth, PixelProjector(*camera_, rays_));
      if (!plane_.has_far_joints()) learn_offset(now.raw);
    }
    quality.stature = stature_.ratio();
    quality.offset = offset_.metres();
  }

  /// Learns the offset of the joints from the limbs, from joints before smoothing, because smoothed
  /// ones lag. Without the main joints nothing is learnt: points of missing bones would count as
  /// those of other bones.
  void learn_offset(const Skeleton& raw) {
    if (has_main_joints(raw, options_.affected)) offset_.learn(raw, options_.affected, points_);
  }

  /// Learns whether the person has the affected limb, and aligns the plane of symmetry with the
  /// legs.
  void look_for_limb(const Skeleton& person, const Skeleton& fitted, const PhantomImage& image) {
    presence_.add(person, options_.affected, PixelProjector(*camera_, rays_), image);
    plane_.follow_legs(points_, fitted, presence_.is_there());
  }

  struct TakenOut {
    std::optional<ClothSearch> cloth;  ///< Region in which an empty sleeve or leg was searched.
    std::int64_t num_given = 0;        ///< Points relabelled from one leg to the other (two legs).
  };

  /// Removes the affected limb from the image.
  TakenOut remove(const Skeleton& fitted, const PhantomInput& input, const PhantomImage& image,
                  PhantomReport& report) {
    const Limb affected = options_.affected;
    TakenOut taken;
    if (plane_.tells_legs_apart()) {
      const bool is_there = presence_.is_there();
      const std::int64_t num_given =
          keep_to_side(affected, is_there, bones_, *plane_.frame(), points_, image, pixel_scratch_);
      if (is_there) taken.num_given = num_given;
    }
    report.num_removed = remove_limb(points_, affected, removal_radius(), flesh(), image);
    if (!goes_by_skin()) return taken;
    report.num_removed += remove_rest(points_, affected, image, pixel_scratch_);
    taken.cloth = cloth_search(fitted);
    if (taken.cloth) {
      report.num_removed +=
          remove_loose_cloth(points_, *taken.cloth, input.depth, PixelProjector(*camera_, rays_),
                             image, pixel_scratch_);
    }
    return taken;
  }

  /// Decides whether the intact limb can be mirrored, and if not, whether the last phantom is held,
  /// fades or is lost.
  void decide_state(const PatientFrame& now, const Skeleton& person,
                    std::span<const Skeleton> people, double time_s, const PhantomImage& image,
                    PhantomReport& report) {
    const Limb intact = opposite(options_.affected);
    const PixelProjector projector(*camera_, rays_);
    report.visible = visible_share(person, intact, projector, image);
    const bool is_stump = now.is_here && is_guessed_at_stump(now.raw, intact);
    const double guessed = inferred_.add(person, intact, time_s, [&](Joint joint) {
      return !is_stump && shows_limb_at(person, intact, joint, projector, image);
    });
    if (!now.is_here) {
      report.reason = reason_for_absence(people);
    } else if (stopped_.are_stopped()) {
      report.reason = PhantomReason::kStopped;
    } else if (!plane_.frame()) {
      report.reason = PhantomReason::kNoPlane;
    } else if (guessed > options_.inferred_seconds) {
      report.reason = PhantomReason::kInferred;
    } else if (report.visible < options_.least_visible) {
      report.reason = PhantomReason::kOccluded;
    }
    // Joints that do not fit the person are the cause of the other reasons.
    const bool misses = report.reason != PhantomReason::kNone &&
                        report.reason != PhantomReason::kStopped && now.is_here;
    if (const auto misfit_reason = misfit(report.quality, stature_, offset_);
        misses && misfit_reason != PhantomReason::kNone) {
      report.reason = misfit_reason;
    }
    if (report.reason == PhantomReason::kNone) {
      report.state = PhantomState::kTracking;
      report.opacity = 1.0;
      return;
    }
    const HeldPhantom::Fate fate =
        plane_.frame() ? held_.fate(options_, time_s) : HeldPhantom::Fate{};
    if (fate.state == PhantomState::kLost) forget_phantom();
    report.state = fate.state;
    report.opacity = fate.opacity;
  }

  /// Measures the quality of the drawn phantom. Beyond a limit of PhantomQuality it is kDegraded.
  void judge_picture(const Skeleton& person, const TakenOut& taken, std::int64_t num_outside,
                     double time_s, const PixelBox& box, const PhantomImage& image,
                     PhantomReport& report) {
    if (report.state != PhantomState::kTracking) {
      leap_.reset();
      return;
    }
    const Limb affected = options_.affected;
    picture_.measure(points_, taken.num_given, report.skeleton, bones_, girth_, *plane_.frame(),
                     box, options_, rays_, image, report.quality);
    if (taken.cloth) {
      const PixelProjector projector(*camera_, rays_);
      report.quality.cloth = share_of_unseen_cloth(points_, *taken.cloth, projector, image);
    }
    report.quality.outside = static_cast<double>(num_outside) /
                             static_cast<double>(std::max<std::int64_t>(report.num_mirrored, 1));
    const Joint end = limb_chain(affected)[kNumMainJoints - 1];
    const Joint intact_end = limb_chain(opposite(affected))[kNumMainJoints - 1];
    report.quality.leap = leap_.add(report.skeleton[end], person[intact_end], time_s);
    if (plane_.follows_trunk() && !is_arm(affected)) {
      report.quality.across = plane_.deviation_across(person);
    }
    report.reason = worst_of(affected, girth_, stature_, offset_, report.quality);
    if (report.reason != PhantomReason::kCalibration && report.reason != PhantomReason::kOccluded &&
        patient_.has_feet_backwards()) {
      report.reason = PhantomReason::kSides;
    }
    if (report.reason != PhantomReason::kNone) report.state = PhantomState::kDegraded;
    using enum PhantomReason;
    held_.set_misplaced(report.reason == kShaky || report.reason == kLeap ||
                        report.reason == kDetached);
  }

  /// The phantom as it is drawn in this frame.
  struct Shown {
    const MirroredLimb& points;  ///< Mirrored in this frame, or moved with the body.
    DrawnPhantom drawn;
  };

  /// Mirrors the intact limb, or moves the last phantom with the body, and draws it.
  Shown mirror(const Skeleton& person, const Skeleton& fitted, const PhantomInput& input,
               const PhantomImage& image, PhantomReport& report) {
    static const MirroredLimb kNothing;
    if (report.state == PhantomState::kLost) return {kNothing, {}};
    const MirroredLimb* points = &held_.points();
    if (report.state == PhantomState::kTracking) {
      mirror_intact_limb(fitted, image, held_.points());
      const BodyFrame& frame = *plane_.frame();
      held_.keep(frame, with_mirrored_limb(person, options_.affected, frame, plane_.mirror()),
                 input.number, clock_.seconds());
    } else {
      points = &held_.moved_to(*plane_.frame());
    }
    report.texture_number = held_.number();
    report.num_mirrored = static_cast<std::int64_t>(points->limb.size());
    report.num_away = std::ranges::count(points->limb, false, &MirroredPoint::faces_camera);
    return {*points,
            write_phantom(points->limb, options_.affected, PixelProjector(*camera_, rays_), image)};
  }

  void mirror_intact_limb(const Skeleton& fitted, const PhantomImage& image,
                          MirroredLimb& mirrored) const {
    const Limb intact = opposite(options_.affected);
    mirror_limb(points_, intact, radius(), flesh(), rays_, plane_.mirror(), image, mirrored.limb);
    mirrored.root.clear();
    if (!(options_.root_radius > 0.0) || !is_usable(fitted, limb_root(intact))) return;
    const BoneSet behind = goes_by_skin() ? bones_behind(options_.affected) : BoneSet{};
    mirror_around_root(points_, fitted[limb_root(intact)], options_.root_radius, *plane_.frame(),
                       plane_.mirror(), behind, image, mirrored.root);
  }

  /// Closes gaps of the phantom: bridges mirrored points that were neighbours in the image, fills
  /// holes of the phantom, fills holes around its root, and fills what is still open at its border.
  /// @return  the box of person and phantom.
  PixelBox fill(const Shown& shown, double time_s, const PhantomImage& image,
                PhantomReport& report) {
    const bool is_lost = report.state == PhantomState::kLost;
    const PixelProjector projector(*camera_, rays_);
    PixelBounds phantom;
    phantom.add(shown.drawn.box);
    if (!is_lost) {
      phantom.add(
          bridge_gaps(shown.points.limb, options_.affected, projector, image, pixel_scratch_));
    }
    report.num_filled = fill_holes(phantom.box(), rays_, image, fills_);
    PixelBounds all = phantom;
    all.add(points_.box);
    if (is_lost) return all.box();
    const PixelBox root = write_root(shown.points.root, projector, image);
    fill_holes(root, rays_, image, fills_, PixelKind::kRootFilled);
    all.add(root);
    give_back_lap(image);
    if (report.state != PhantomState::kTracking) return all.box();
    report.num_filled += fill_from_own_limb(image);
    phantom.add(root);
    all.add(border_.fill(phantom.box(), time_s, rays_, image, fills_));
    report.num_filled += static_cast<std::int64_t>(fills_.size());
    return all.box();
  }

  /// Restores pixels of the lap that were removed with the affected leg. A thigh has no visible
  /// border to the lap, unlike an arm beside the trunk.
  void give_back_lap(const PhantomImage& image) {
    constexpr double kSeam = 0.05;  // metres: farthest restored pixel from the skin of other bones
    if (options_.keep_residual || !goes_by_skin() || is_arm(options_.affected)) return;
    give_back(points_, options_.affected, bones_, kSeam, image);
    give_back_holes(points_, options_.affected, bones_, rays_, image, pixel_scratch_);
  }

  /// Fills holes of the mirrored leg with points of the affected leg that are within flesh() of the
  /// phantom's skin, the distance within which points of the intact leg are mirrored. Only for
  /// persons who have the affected leg.
  std::int64_t fill_from_own_limb(const PhantomImage& image) const {
    if (options_.keep_residual || !plane_.follows_trunk() || !goes_by_skin()) return 0;
    if (is_arm(options_.affected) || !presence_.is_there()) return 0;
    return fill_from_limb(points_, options_.affected, bones_, plane_.mirror(), flesh(), image);
  }

  [[nodiscard]] Skeleton phantom_skeleton(const Skeleton& person, PhantomState state) const {
    if (state == PhantomState::kLost) return without_limb(person, options_.affected);
    return held_.skeleton(person, options_.affected, *plane_.frame(),
                          state == PhantomState::kTracking);
  }

  PhantomOptions options_;
  FrameClock clock_;
  Patient patient_;
  std::optional<Intrinsics> camera_;
  PixelRays rays_;

  // Learnt about the person from all frames.
  LimbPresence presence_;
  InferredClock inferred_;
  BodyPlane plane_;
  Girth girth_;
  Stature stature_;
  JointOffset offset_;
  StoppedJoints stopped_;

  // State of the phantom that lasts from frame to frame.
  HeldPhantom held_;
  BorderMemory border_;
  LeapMeter leap_;

  // Results and scratch memory of one frame.
  bool is_beside_all_ = false;  ///< All points at the depths of the joints were surroundings.
  BoneSegments bones_;
  PersonPoints points_;
  std::vector<HoleFill> fills_;
  /// One number per pixel: scratch memory of several steps, at last the vertex of each pixel.
  std::vector<std::int32_t> pixel_scratch_;
  std::vector<float> source_depth_;
  std::vector<Removal> removal_;
  PictureJudge picture_;
};

PhantomPipeline::PhantomPipeline(const PhantomOptions& options)
    : workspace_(std::make_unique<Workspace>(options)) {}
PhantomPipeline::PhantomPipeline(PhantomPipeline&&) noexcept = default;
PhantomPipeline& PhantomPipeline::operator=(PhantomPipeline&&) noexcept = default;
PhantomPipeline::~PhantomPipeline() = default;

PhantomReport PhantomPipeline::process(const PhantomInput& input, const PhantomBuffers& out) {
  return workspace_->process(input, out);
}

void PhantomPipeline::select(std::int64_t id) { workspace_->select(id); }

void PhantomPipeline::reset() { workspace_->reset(); }

}  // namespace manip3d
