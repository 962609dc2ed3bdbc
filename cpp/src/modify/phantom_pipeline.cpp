#include "manip3d/modify/phantom_pipeline.hpp"

#include <algorithm>
#include <chrono>
#include <limits>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/modify/limb_fit.hpp"
#include "manip3d/modify/trunk_tracker.hpp"
#include "modify/girth.hpp"
#include "modify/leg_turn.hpp"
#include "modify/limb_evidence.hpp"
#include "modify/loose_cloth.hpp"
#include "modify/phantom_mesh.hpp"
#include "modify/phantom_quality.hpp"
#include "modify/pixel_bounds.hpp"
#include "modify/stature.hpp"
#include "modify/surroundings.hpp"
#include "modify/vertical.hpp"

namespace manip3d {
namespace {

constexpr double kNever = -std::numeric_limits<double>::infinity();

constexpr std::int64_t kNominalPeriod = 33'333'333;  // nanoseconds

/// a - b, or the nearest number there is.
std::int64_t difference(std::int64_t a, std::int64_t b) {
  using Limits = std::numeric_limits<std::int64_t>;
  if (b < 0 && a > Limits::max() + b) return Limits::max();
  if (b > 0 && a < Limits::min() + b) return Limits::min();
  return a - b;
}

double seconds_of(std::int64_t time_ns) { return 1e-9 * static_cast<double>(time_ns); }

void check_all_options(const PhantomOptions& o) {
  const auto check = [](const char* name, double value, double most) {
    if (value >= 0.0 && value <= most) return;
    throw InputError(std::string(name) + ": expected 0 to " + std::to_string(most) + ", got " +
                     std::to_string(value));
  };
  check("arm_radius", o.arm_radius, 1.0);
  check("leg_radius", o.leg_radius, 1.0);
  check("root_radius", o.root_radius, 1.0);
  check("least_visible", o.least_visible, 1.0);
  check("inferred_seconds", o.inferred_seconds, 3600.0);
  check("hold_seconds", o.hold_seconds, 3600.0);
  check("fade_seconds", o.fade_seconds, 3600.0);
  check("max_depth_step", o.mesh.max_depth_step, 100.0);
  check_options(o.mask);
}

bool same_camera(const Intrinsics& a, const Intrinsics& b) {
  return a.width == b.width && a.height == b.height && a.fx == b.fx && a.fy == b.fy &&
         a.cx == b.cx && a.cy == b.cy && a.distortion == b.distortion &&
         a.ray_table == b.ray_table && a.mirrored == b.mirrored;
}

/// Adds the time since it was last asked to one stage after the other.
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

/// Do shoulders and hips, as far as they are there, point against the body's left?
bool has_sides_swapped(const Skeleton& told, const BodyFrame& frame) {
  using enum Joint;
  constexpr std::array kPairs = {std::pair{kShoulderLeft, kShoulderRight},
                                 std::pair{kHipLeft, kHipRight}};
  constexpr double kAgainst = -0.5;  // cosine: a body that turns passes 90 degrees slowly
  bool is_told = false;
  for (const auto& [left, right] : kPairs) {
    if (!is_usable(told, left) || !is_usable(told, right)) continue;
    const Eigen::Vector3d across = (told[left] - told[right]).cast<double>();
    if (!(frame.n.dot(across) < kAgainst * across.norm())) return false;
    is_told = true;
  }
  return is_told;
}

Skeleton with_sides_swapped(const Skeleton& told) {
  Skeleton result = told;
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    const std::size_t other = kMirroredJoints[joint];
    result.positions[joint] = told.positions[other];
    result.orientations[joint] = told.orientations[other];
    result.states[joint] = told.states[other];
  }
  return result;
}

/// For how long joints of a limb have been guessed.
class InferredClock {
 public:
  /// The root does not count: it is guessed whenever a seated person's thigh hides it, and the
  /// trunk tells where it is.
  /// @param is_seen  whether the depth image shows the limb at a joint, which makes a guess of it
  ///                 as good as any.
  template <typename Seen>
  double add(const Skeleton& skeleton, Limb limb, double time_s, const Seen& is_seen) {
    double longest = 0.0;
    for (std::size_t i = 1; i < kNumMainJoints; ++i) {
      const Joint joint = limb_chain(limb)[i];
      if (skeleton.state(joint) == TrackingState::kTracked || is_seen(joint)) {
        last_tracked_[i] = time_s;
      } else if (last_tracked_[i] == kNever) {
        last_tracked_[i] = time_s;  // the first frame of all
      }
      longest = std::max(longest, time_s - last_tracked_[i]);
    }
    return longest;
  }
  void reset() { last_tracked_.fill(kNever); }

 private:
  std::array<double, kNumMainJoints> last_tracked_{kNever, kNever, kNever, kNever};
};

/// Share of the limb, by length, in front of which the camera sees the limb.
double visible_share(const Skeleton& skeleton, Limb limb, const PixelProjector& projector,
                     const std::uint8_t* label) {
  constexpr int kSamples = 16;  // per bone: every two centimetres
  double seen = 0.0, all = 0.0;
  for (std::size_t i = 1; i < kNumMainJoints; ++i) {
    const Joint from = limb_chain(limb)[i - 1], to = limb_chain(limb)[i];
    if (!is_usable(skeleton, from) || !is_usable(skeleton, to)) continue;
    const Eigen::Vector3f step = (skeleton[to] - skeleton[from]) / kSamples;
    const auto length = static_cast<double>(step.norm());
    for (int k = 0; k < kSamples; ++k) {
      const Eigen::Vector3f p = skeleton[from] + (static_cast<float>(k) + 0.5F) * step;
      const std::int32_t pixel = projector.pixel(p.x(), p.y(), p.z());
      all += length;
      if (pixel >= 0 && is_limb_bone(limb, label[pixel])) seen += length;
    }
  }
  return all > 0.0 ? seen / all : 0.0;
}

/// Does the camera see the limb where a joint is, tracked or guessed?
bool shows_limb_at(const Skeleton& skeleton, Limb limb, Joint joint,
                   const PixelProjector& projector, const PhantomImage& image) {
  constexpr float kWithinLimb = 0.12F;  // metres from a joint to the skin before it
  if (!is_usable(skeleton, joint)) return false;
  const Eigen::Vector3f& p = skeleton[joint];
  const std::int32_t pixel = projector.pixel(p.x(), p.y(), p.z());
  if (pixel < 0 || std::abs(image.depth[pixel] - p.z()) > kWithinLimb) return false;
  return is_limb_bone(limb, image.label[pixel]);
}

/// Are all tracked joints farther away than any camera sees, as millimetres are that were taken for
/// metres?
bool is_in_another_unit(const Skeleton& skeleton) {
  constexpr float kFarthest = 100.0F;  // metres
  bool is_far = false;
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    if (skeleton.states[joint] != TrackingState::kTracked) continue;
    const Eigen::Vector3f& p = skeleton.positions[joint];
    if (!(p.cwiseAbs().maxCoeff() > kFarthest && p.allFinite())) return false;
    is_far = true;
  }
  return is_far;
}

/// Has a tracker told all joints but those of a limb, of hands and feet?
bool has_main_joints(const Skeleton& skeleton, Limb affected) {
  constexpr std::size_t kInner = kNumMainJoints - 1;
  bool all = is_usable(skeleton, Joint::kHead) && is_usable(skeleton, Joint::kSpineBase) &&
             is_usable(skeleton, Joint::kSpineMid) && is_usable(skeleton, Joint::kSpineShoulder);
  for (const Limb limb : {Limb::kLeftArm, Limb::kRightArm, Limb::kLeftLeg, Limb::kRightLeg}) {
    if (limb == affected) continue;
    for (const Joint joint : limb_chain(limb).first(kInner)) {
      all = all && is_usable(skeleton, joint);
    }
  }
  return all;
}

/// Length of a limb along its usable joints, metres.
float limb_length(const Skeleton& skeleton, Limb limb) {
  float length = 0.0F;
  Joint last = limb_root(limb);
  for (const Joint joint : limb_chain(limb)) {
    if (!is_usable(skeleton, joint) || !is_usable(skeleton, last)) continue;
    length += (skeleton[joint] - skeleton[last]).norm();
    last = joint;
  }
  return length;
}

/// Are joints of a limb guessed where only a stump is, of a person whose other limb is tracked? A
/// limb that is bent at the elbow or the knee still reaches .43 of its length from its root.
bool is_guessed_at_stump(const Skeleton& skeleton, Limb limb) {
  constexpr float kShort = 0.4F;  // of the other limb's length
  const auto is_tracked = [&](Joint joint) {
    return skeleton.state(joint) == TrackingState::kTracked;
  };
  const auto mine = limb_chain(limb).first(kNumMainJoints).subspan(1);
  const auto other = limb_chain(opposite(limb)).first(kNumMainJoints).subspan(1);
  if (std::ranges::all_of(mine, is_tracked) || !std::ranges::all_of(other, is_tracked)) {
    return false;
  }
  float reach = 0.0F;
  for (const Joint joint : mine) {
    if (!is_usable(skeleton, joint) || !is_usable(skeleton, limb_root(limb))) continue;
    reach = std::max(reach, (skeleton[joint] - skeleton[limb_root(limb)]).norm());
  }
  return reach < kShort * limb_length(skeleton, opposite(limb));
}

/// Has the person the affected limb? An amputee has none in any frame, though the joints that a
/// tracker invents may lie on the person in some, so the answer is a running mean over about a
/// second.
class LimbPresence {
 public:
  void add(const Skeleton& skeleton, Limb affected, const PixelProjector& projector,
           const std::uint8_t* label) {
    constexpr double kLeastVisible = 0.5, kMemory = 0.95;  // of a limb's length; frame to frame
    constexpr float kOtherLength = 0.3F;  // two arms, or two legs, of a person differ by less
    const float length = limb_length(skeleton, affected);
    const float intact = limb_length(skeleton, opposite(affected));
    // Without the root, which is guessed whenever a seated person's thigh hides it.
    const auto chain = limb_chain(affected).first(kNumMainJoints).subspan(1);
    const bool is_tracked = std::ranges::all_of(
        chain, [&](Joint j) { return skeleton.state(j) == TrackingState::kTracked; });
    const bool is_seen = is_tracked && std::abs(length - intact) < kOtherLength * intact &&
                         visible_share(skeleton, affected, projector, label) >= kLeastVisible;
    const double now = is_seen ? 1.0 : 0.0;
    share_ = share_ ? kMemory * *share_ + (1.0 - kMemory) * now : now;
  }
  [[nodiscard]] bool is_there() const { return share_ && *share_ >= 0.5; }
  void reset() { share_.reset(); }

 private:
  std::optional<double> share_;  ///< Share of the frames in which the limb was seen.
};

/// Takes the body from where it was to where it is.
class BodyMotion {
 public:
  BodyMotion(const BodyFrame& from, const BodyFrame& to) {
    Eigen::Matrix3d a, b;
    a << from.n, from.y, from.z;
    b << to.n, to.y, to.z;
    const Eigen::Matrix3d rotation = b * a.transpose();
    rotation_ = rotation.cast<float>();
    translation_ = (to.origin - rotation * from.origin).cast<float>();
  }
  [[nodiscard]] Eigen::Vector3f operator()(const Eigen::Vector3f& p) const {
    return rotation_ * p + translation_;
  }
  void move(const std::vector<MirroredPoint>& from, std::vector<MirroredPoint>& to) const {
    to.assign(from.begin(), from.end());
    for (MirroredPoint& point : to) {
      const Eigen::Vector3f p = (*this)(Eigen::Vector3f(point.x, point.y, point.z));
      point.x = p.x(), point.y = p.y(), point.z = p.z();
    }
  }

 private:
  Eigen::Matrix3f rotation_;
  Eigen::Vector3f translation_;
};

}  // namespace

class PhantomPipeline::Workspace {
 public:
  explicit Workspace(const PhantomOptions& options)
      : options_(options),
        smoother_(options.smoothing),
        key_person_(options.key_person),
        trunk_(options.affected),
        legs_(options.affected) {
    check_all_options(options);
  }

  PhantomReport process(const PhantomInput& input, const PhantomBuffers& out) {
    check_input(input);
    PhantomReport report;
    if (is_late(input)) {
      report.state = PhantomState::kLate;
      report.reason = PhantomReason::kLate;
      report.late_frames = late_frames_;
      return report;
    }
    report.late_frames = late_frames_;
    StageClock clock(report.seconds);
    follow_camera(input.camera);
    const double time_s = seconds_of(clock_ns_);
    const PhantomImage image = image_of(input, out);
    const std::optional<Skeleton> person = find_key_person(input, time_s);
    const std::optional<Skeleton> fitted = find_points(person, input);
    segment(fitted, input, image, report);
    if (points_.count == 0) {  // a phantom without a person would float in the air
      ends_.reset();
      report.reason = reason_for_nobody(input);
      return report;
    }
    if (is_here_) look_at_calibration(*person, input, image, report.quality);
    clock.end(PhantomStage::kSegmentation);
    std::optional<ClothSearch> cloth;
    if (!options_.keep_residual) {
      if (is_here_) look_for_limb(*person, *fitted, image);
      cloth = remove(*fitted, input, image, report);
    }
    report.plane = frame_;
    clock.end(PhantomStage::kRemoval);
    judge(*fitted, time_s, image, report);
    const PixelBox phantom = mirror(*person, *fitted, input, image, report);
    clock.end(PhantomStage::kMirroring);
    const PixelBox all = fill(phantom, time_s, image, report);
    clock.end(PhantomStage::kHoleFilling);
    report.skeleton = phantom_skeleton(*person, report.state);
    inspect(*person, cloth, time_s, all, image, report);
    clock.end(PhantomStage::kSkeleton);
    report.num_points = write_points(image, all, rays_, out.mesh, vertex_of_);
    clock.end(PhantomStage::kPointCloud);
    report.mesh = write_mesh(image, all, rays_, report.num_points, vertex_of_, input.registration,
                             options_.mesh, out.mesh);
    clock.end(PhantomStage::kMesh);
    return report;
  }

  void select(std::int64_t id) { key_person_.select(id); }

  void reset() {
    late_frames_ = 0;
    start_anew();
  }

 private:
  static void check_input(const PhantomInput& input) {
    check_intrinsics(input.camera, "camera");
    const DepthView& depth = input.depth;
    if (depth.rows != input.camera.height || depth.cols != input.camera.width ||
        (depth.millimetres == nullptr) == (depth.metres == nullptr)) {
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

  /// Frames that are not newer are late, unless there are so many of them that the source's clock
  /// must be wrong: it stands, or runs back. Then frames count as 30 a second until times grow
  /// again.
  bool is_late(const PhantomInput& input) {
    constexpr std::int64_t kNewRecording = 1'000'000'000, kMostLate = 10;
    if (!has_time_) {
      start_clock(input.time_ns);
      return false;
    }
    const std::int64_t elapsed = difference(input.time_ns, last_time_ns_);
    if (elapsed > 0) {
      late_in_row_ = 0;
      advance_clock(input.time_ns, elapsed);
      return false;
    }
    const bool has_clock = input.time_ns != 0 || last_time_ns_ != 0;
    if (!has_clock) {
      advance_clock(0, kNominalPeriod);
      return false;
    }
    ++late_frames_;
    if (elapsed < -kNewRecording) {
      start_anew();
      start_clock(input.time_ns);
      return false;
    }
    if (++late_in_row_ <= kMostLate) return true;
    late_in_row_ = kMostLate;
    advance_clock(input.time_ns, kNominalPeriod);
    return false;
  }

  void start_clock(std::int64_t time_ns) {
    has_time_ = true;
    last_time_ns_ = time_ns;
    late_in_row_ = clock_ns_ = 0;
  }

  void advance_clock(std::int64_t time_ns, std::int64_t elapsed) {
    constexpr std::int64_t kLongest = 3600 * std::int64_t{1'000'000'000};  // all is forgotten
    last_time_ns_ = time_ns;
    clock_ns_ += std::min(elapsed, kLongest);
  }

  void start_anew() {
    has_time_ = has_skeleton_ = false;
    key_person_.reset();
    vertical_.reset();
    start_person(std::nullopt);
  }

  void start_person(std::optional<std::int64_t> id) {
    person_id_ = id;
    person_.reset();
    smoother_.reset();
    inferred_.reset();
    presence_.reset();
    trunk_.reset();
    girth_.reset();
    stature_.reset();
    legs_.reset();
    trunk_frame_.reset();
    frame_.reset();
    ends_.reset();
    forget_phantom();
  }

  void forget_phantom() {
    held_.reset();
    shown_time_s_ = kNever;
    last_tracking_ = kNever;
  }

  void follow_camera(const Intrinsics& camera) {
    if (camera_ && same_camera(*camera_, camera)) return;
    camera_.reset();
    rays_ = PixelRays(camera);
    points_.resize(camera.height, camera.width);
    const auto size = static_cast<std::size_t>(camera.width * camera.height);
    vertex_of_.resize(size);
    source_depth_.resize(size);
    removal_.resize(size);
    for (auto* list : {&mirrored_, &moved_}) list->reserve(size);
    for (auto* list : {&root_, &moved_root_}) list->reserve(size);
    fills_.reserve(size);
    for (auto* list : {&shown_, &shown_before_}) list->reserve(size);
    shown_time_s_ = kNever;
    picture_.reserve(camera.height, camera.width);
    camera_ = camera;
    stature_.reset();
    vertical_.reset();
    ends_.reset();
    forget_phantom();
  }

  [[nodiscard]] PhantomImage image_of(const PhantomInput& input, const PhantomBuffers& out) {
    return {input.depth.rows, input.depth.cols,     out.depth,      out.label, out.kind,
            out.source,       source_depth_.data(), removal_.data()};
  }

  /// The smoothed skeleton; for a while the last one, when there is none.
  std::optional<Skeleton> find_key_person(const PhantomInput& input, double time_s) {
    look_at_clothes(input);
    const auto index = key_person_.find(input.people, input.camera, time_s, clothes_);
    is_here_ = index.has_value();
    if (!index) {
      const double most = options_.hold_seconds + options_.fade_seconds;
      if (key_person_.lost_for(time_s) >= most) start_person(std::nullopt);
      return person_;
    }
    const Skeleton& told = input.people[*index];
    has_skeleton_ = true;
    if (person_id_ != told.id && !is_at_same_place(told)) start_person(told.id);
    person_id_ = told.id;
    const Skeleton raw = with_sides_kept(told, time_s);
    raw_ = raw;
    person_ = smoother_.add(raw);
    if (!options_.smooths) restore_positions(raw);
    return person_;
  }

  void look_at_clothes(const PhantomInput& input) {
    clothes_.clear();
    if (input.color.pixels == nullptr) return;
    const ColoredScene scene{input.depth, input.body_index,   &*camera_,
                             &rays_,      input.registration, input.color};
    for (const Skeleton& person : input.people) {
      clothes_.push_back(clothing_colors(person, scene));
    }
  }

  /// A tracker may take left for right for a moment, which does not move a limb to the other side.
  /// One that keeps to it is believed, and the person is begun anew: the later, the longer it has
  /// told otherwise.
  Skeleton with_sides_kept(const Skeleton& told, double time_s) {
    constexpr double kLeast = 0.5, kMost = 2.0;  // seconds
    if (!frame_ || !follows_trunk()) sides_known_since_ = time_s;
    if (!frame_ || !follows_trunk() || !has_sides_swapped(told, *frame_)) {
      sides_kept_since_ = time_s;
      return told;
    }
    const double patience =
        std::clamp(0.5 * (sides_kept_since_ - sides_known_since_), kLeast, kMost);
    if (time_s - sides_kept_since_ <= patience) return with_sides_swapped(told);
    start_person(told.id);
    sides_kept_since_ = sides_known_since_ = time_s;
    return told;
  }

  /// A tracker may give the same person another id.
  [[nodiscard]] bool is_at_same_place(const Skeleton& raw) const {
    constexpr float kSamePlace = 0.3F;  // metres
    const auto before = person_ ? spine_base(*person_) : std::nullopt, now = spine_base(raw);
    return before && now && (*before - *now).norm() < kSamePlace;
  }

  void restore_positions(const Skeleton& raw) {
    for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
      if (person_->states[joint] != TrackingState::kNotTracked) {
        person_->positions[joint] = raw.positions[joint];
      }
    }
  }

  [[nodiscard]] PhantomReason reason_for_nobody(const PhantomInput& input) const {
    if (std::ranges::any_of(input.people, is_in_another_unit)) return PhantomReason::kCalibration;
    if (is_here_ && is_beside_all_) return PhantomReason::kCalibration;
    return lacks_skeletons() ? PhantomReason::kNoSkeleton : PhantomReason::kNoPerson;
  }

  /// Has the source had time to show a skeleton, and has not?
  [[nodiscard]] bool lacks_skeletons() const {
    constexpr std::int64_t kPatience = 1'000'000'000;
    return !has_skeleton_ && clock_ns_ >= kPatience;
  }

  [[nodiscard]] double radius() const {
    return is_arm(options_.affected) ? options_.arm_radius : options_.leg_radius;
  }

  /// By skins, what is nearest to the limb belongs to it even where the joints are off.
  [[nodiscard]] double removal_radius() const {
    constexpr double kOff = 0.08;  // metres
    return goes_by_skin() ? radius() + kOff : radius();
  }

  [[nodiscard]] bool goes_by_skin() const { return options_.segmentation == BoneRule::kSkin; }

  /// Points farther from the skin are no flesh: a seat between two thighs.
  [[nodiscard]] double flesh() const {
    constexpr double kClothes = 0.06;  // metres, and what girths and joints are off by
    return goes_by_skin() ? kClothes + static_cast<double>(girth_.limb())
                          : std::numeric_limits<double>::infinity();
  }

  /// The person's points, and its joints where the flesh is: for all that follows the points. What
  /// is reported and asked for its fit are the tracker's.
  std::optional<Skeleton> find_points(const std::optional<Skeleton>& person,
                                      const PhantomInput& input) {
    points_.count = 0;
    is_beside_all_ = false;
    if (!person) return person;
    const Skeleton believed = goes_by_skin() ? without_unseen_limb(*person, input) : *person;
    find_person(input.depth, input.body_index, believed, rays_, options_.mask, points_);
    look_for_floor(*person, input);
    if (input.body_index == nullptr && goes_by_skin()) leave_surroundings(believed, input);
    return goes_by_skin() ? fit_limbs(believed, points_, girth_.trunk()) : believed;
  }

  /// Without a body index, floor and furniture between the depths of the joints are no person.
  void leave_surroundings(const Skeleton& person, const PhantomInput& input) {
    const bool has_points = points_.count > 0;
    drop_surroundings(input.depth, bones_of(person), options_.affected, static_cast<float>(flesh()),
                      floor_under(person), points_, vertex_of_);
    is_beside_all_ = has_points && points_.count == 0;
  }

  /// The floor, unless a tracked foot is well below it: then it is a table or a bed.
  [[nodiscard]] std::optional<FloorPlane> floor_under(const Skeleton& person) const {
    constexpr float kFootIsOff = 0.12F;  // metres
    using enum Joint;
    const auto& floor = vertical_.floor();
    if (!floor) return std::nullopt;
    for (const Joint joint : {kAnkleLeft, kAnkleRight, kFootLeft, kFootRight}) {
      if (person.state(joint) != TrackingState::kTracked || !is_usable(person, joint)) continue;
      if (floor->normal.dot(person[joint]) > floor->height + kFootIsOff) return std::nullopt;
    }
    return floor;
  }

  [[nodiscard]] BoneSegments bones_of(const Skeleton& person) const {
    const BoneRule rule = options_.segmentation;
    return frame_ ? body_bones(person, rule, options_.affected, mirror_, girth_.trunk())
                  : body_bones(person, rule, girth_.trunk());
  }

  /// The person without joints of the affected limb that the picture refutes: bones to them would
  /// take chest and neck out on their way. If the person has the limb, joints that are off for a
  /// moment are still the best that is known of it.
  [[nodiscard]] Skeleton without_unseen_limb(const Skeleton& person,
                                             const PhantomInput& input) const {
    const PixelProjector projector(*camera_, rays_);
    const Limb affected = options_.affected;
    if (presence_.is_there() ||
        may_have_limb(person, affected, input.depth, input.body_index, projector)) {
      return person;
    }
    Skeleton result = person;
    for_each_phantom_joint([&](std::size_t joint) {
      result.states[joint] = TrackingState::kNotTracked;
      result.positions[joint].setZero();
    });
    return result;
  }

  void segment(const std::optional<Skeleton>& person, const PhantomInput& input,
               const PhantomImage& image, PhantomReport& report) {
    if (person) {
      update_frame(*person, input);
      segment_by_bones(*person);
      if (follows_trunk()) {
        trunk_.learn(points_, input.depth, rays_, input.camera);
        if (const auto learnt = trunk_.frame()) set_frame(*learnt);
      }
    }
    draw_person(points_, image);
    report.num_person = points_.count;
    if (follows_trunk()) report.quality.plane_deg = trunk_.deviation_deg();
  }

  /// Gives each point its bone, and learns how stout the trunk is: in the first frame until that is
  /// known.
  void segment_by_bones(const Skeleton& person) {
    constexpr int kRounds = 10;
    constexpr float kSame = 0.02F;
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

  [[nodiscard]] bool follows_trunk() const {
    return options_.plane == PlaneRule::kTrunk && options_.mode == MirrorMode::kReflection;
  }

  /// The axes of the body; those of the last frame where they cannot be told.
  void update_frame(const Skeleton& person, const PhantomInput& input) {
    const auto frame = follows_trunk() ? trunk_.update(is_here_ ? &raw_ : nullptr, input.depth,
                                                       rays_, input.camera, seconds_of(clock_ns_))
                                       : body_frame(person, options_.affected);
    if (frame) {
      set_frame(*frame);
    } else if (trunk_frame_) {
      const Joint origin = is_arm(options_.affected) ? Joint::kSpineMid : Joint::kSpineBase;
      const bool seen = is_usable(person, origin) && person[origin].z() > 0.1F;
      if (seen) trunk_frame_->origin = person[origin].cast<double>();
      set_frame(*trunk_frame_);
    }
  }

  void look_for_floor(const Skeleton& person, const PhantomInput& input) {
    const bool is_asked =
        input.body_index == nullptr || (follows_trunk() && !is_arm(options_.affected));
    if (!is_asked || !is_here_ || !is_usable(person, Joint::kSpineBase)) return;
    vertical_.learn(input.depth, input.body_index, rays_, person[Joint::kSpineBase]);
    if (!is_arm(options_.affected)) trunk_.set_down(vertical_.down());
  }

  void set_frame(const BodyFrame& trunk) {
    trunk_frame_ = trunk;
    frame_ = legs_.of(trunk);
    mirror_ = make_mirror(*frame_, options_.mode);
  }

  /// Turns the plane as the two legs of a person who has both tell.
  void follow_legs(const Skeleton& person) {
    if (!follows_trunk() || !goes_by_skin() || is_arm(options_.affected) || !trunk_frame_) return;
    if (presence_.is_there()) {
      legs_.learn(points_, person, *trunk_frame_);
    } else {
      legs_.forget();
    }
    set_frame(*trunk_frame_);
  }

  /// Where to look for an empty sleeve or leg of trousers; none for a person who has the limb.
  [[nodiscard]] std::optional<ClothSearch> cloth_search(const Skeleton& person) const {
    const Limb affected = options_.affected, intact = opposite(affected);
    if (presence_.is_there() || !frame_ || !is_usable(person, limb_root(intact))) {
      return std::nullopt;
    }
    if (options_.mode != MirrorMode::kReflection) return std::nullopt;  // others keep no distances
    const Eigen::Vector3f root =
        is_usable(person, limb_root(affected))
            ? person[limb_root(affected)]
            : mirror_(person[limb_root(intact)].cast<double>()).cast<float>();
    return ClothSearch{
        affected, root,   limb_length(person, intact), static_cast<float>(camera_->fx),
        *frame_,  mirror_};
  }

  /// Do the joints belong to the depth image?
  [[nodiscard]] double fit_of(const Skeleton& person, const PhantomInput& input,
                              const PhantomImage& image) const {
    const PixelProjector projector(*camera_, rays_);
    const double fit = joint_fit(person, options_.affected, projector, image);
    // Without a body index, furniture within the person's depths is far from all bones too; with
    // half of the bones, the person is.
    return input.body_index != nullptr && has_main_joints(person, options_.affected)
               ? std::min(fit, bone_fit(points_, girth_))
               : fit;
  }

  /// Do the joints lie where the depth image shows the person, and are they as tall?
  void look_at_calibration(const Skeleton& person, const PhantomInput& input,
                           const PhantomImage& image, PhantomQuality& quality) {
    quality.fit = fit_of(person, input, image);
    // Without a body index a floor would be the person's, and without skins there are no soles.
    if (input.body_index != nullptr && goes_by_skin()) stature_.learn(person, bones_, points_);
    quality.stature = stature_.ratio();
  }

  /// Has the person the affected limb, and what does it tell of the plane?
  void look_for_limb(const Skeleton& person, const Skeleton& fitted, const PhantomImage& image) {
    presence_.add(person, options_.affected, PixelProjector(*camera_, rays_), image.label);
    follow_legs(fitted);
  }

  /// Takes out the affected limb. Returns where cloth of it was looked for.
  std::optional<ClothSearch> remove(const Skeleton& fitted, const PhantomInput& input,
                                    const PhantomImage& image, PhantomReport& report) {
    const Limb affected = options_.affected;
    report.num_removed = remove_limb(points_, affected, removal_radius(), flesh(), image);
    if (!goes_by_skin()) return std::nullopt;
    report.num_removed += remove_rest(points_, affected, image, vertex_of_);
    const std::optional<ClothSearch> cloth = cloth_search(fitted);
    if (cloth) {
      report.num_removed += remove_loose_cloth(points_, *cloth, input.depth,
                                               PixelProjector(*camera_, rays_), image, vertex_of_);
    }
    return cloth;
  }

  /// Can the intact limb be mirrored, and if not, what becomes of the last phantom?
  void judge(const Skeleton& person, double time_s, const PhantomImage& image,
             PhantomReport& report) {
    const Limb intact = opposite(options_.affected);
    const PixelProjector projector(*camera_, rays_);
    report.visible = visible_share(person, intact, projector, image.label);
    const bool is_stump = is_here_ && is_guessed_at_stump(raw_, intact);
    const double guessed = inferred_.add(person, intact, time_s, [&](Joint joint) {
      return !is_stump && shows_limb_at(person, intact, joint, projector, image);
    });
    if (!is_here_) {
      report.reason = PhantomReason::kNoPerson;
    } else if (!frame_) {
      report.reason = PhantomReason::kNoPlane;
    } else if (guessed > options_.inferred_seconds) {
      report.reason = PhantomReason::kInferred;
    } else if (report.visible < options_.least_visible) {
      report.reason = PhantomReason::kOccluded;
    }
    // Joints beside the person explain all else.
    const bool misses = report.reason != PhantomReason::kNone && is_here_;
    if (misses && !fits(report.quality, stature_)) report.reason = PhantomReason::kCalibration;
    if (report.reason == PhantomReason::kNone) {
      report.state = PhantomState::kTracking;
      report.opacity = 1.0;
      last_tracking_ = time_s;
      return;
    }
    const double age = time_s - last_tracking_;
    // A phantom at the wrong place is not held there.
    const bool is_misplaced = held_ && held_->is_misplaced;
    if (!held_ || !frame_ || is_misplaced ||
        !(age <= options_.hold_seconds + options_.fade_seconds)) {
      forget_phantom();
      return;  // kLost
    }
    const double faded = std::max(0.0, age - options_.hold_seconds);
    report.state = faded > 0.0 ? PhantomState::kFading : PhantomState::kHolding;
    report.opacity = faded > 0.0 ? 1.0 - faded / options_.fade_seconds : 1.0;
  }

  /// Measures what was drawn; what nobody would believe is not called tracking.
  void inspect(const Skeleton& person, const std::optional<ClothSearch>& cloth, double time_s,
               const PixelBox& box, const PhantomImage& image, PhantomReport& report) {
    if (report.state != PhantomState::kTracking) {
      ends_.reset();
      return;
    }
    const Limb affected = options_.affected;
    picture_.measure(points_, report.skeleton, bones_, girth_, *frame_, box, options_, rays_, image,
                     report.quality);
    if (cloth) {
      const PixelProjector projector(*camera_, rays_);
      report.quality.cloth = share_of_unseen_cloth(points_, *cloth, projector, image);
    }
    const Joint end = limb_chain(affected)[kNumMainJoints - 1];
    const Joint intact_end = limb_chain(opposite(affected))[kNumMainJoints - 1];
    const Ends ends{report.skeleton[end], person[intact_end], time_s};
    constexpr double kUnseen = 0.25;  // seconds in which a limb may be anywhere
    if (ends_ && time_s - ends_->time_s <= kUnseen) {
      const float mine = (ends.phantom - ends_->phantom).norm();
      const float intact = (ends.intact - ends_->intact).norm();
      report.quality.leap = std::max(0.0, static_cast<double>(mine - intact));
    }
    ends_ = ends;
    if (follows_trunk() && !is_arm(affected)) report.quality.across = deviation_across(person);
    report.reason = worst_of(affected, girth_, stature_, report.quality);
    if (report.reason != PhantomReason::kNone) report.state = PhantomState::kDegraded;
    using enum PhantomReason;
    held_->is_misplaced =
        report.reason == kShaky || report.reason == kLeap || report.reason == kDetached;
  }

  /// The largest standard deviation of a joint's distance from the plane, of those that may be on
  /// its other side.
  [[nodiscard]] double deviation_across(const Skeleton& person) const {
    constexpr double kSure = 2.0;  // standard deviations
    const Limb intact = opposite(options_.affected);
    const double left = limb_root(intact) == Joint::kHipLeft ? 1.0 : -1.0;
    double worst = 0.0;
    for (const Joint joint : limb_chain(intact).subspan(1)) {
      if (!is_usable(person, joint)) continue;
      const Eigen::Vector3d p = person[joint].cast<double>();
      const double deviation = trunk_.deviation_at(p, *frame_);
      const double distance = left * frame_->n.dot(p - frame_->origin);
      if (distance < kSure * deviation) worst = std::max(worst, deviation);
    }
    return worst;
  }

  PixelBox mirror(const Skeleton& person, const Skeleton& fitted, const PhantomInput& input,
                  const PhantomImage& image, PhantomReport& report) {
    moved_.clear();
    moved_root_.clear();
    if (report.state == PhantomState::kLost) return {};
    if (report.state == PhantomState::kTracking) {
      const Limb intact = opposite(options_.affected);
      mirror_limb(points_, intact, radius(), flesh(), rays_, mirror_, image, mirrored_);
      root_.clear();
      if (options_.root_radius > 0.0 && is_usable(fitted, limb_root(intact))) {
        const BoneSet behind = goes_by_skin() ? bones_behind(options_.affected) : BoneSet{};
        mirror_around_root(points_, fitted[limb_root(intact)], options_.root_radius, *frame_,
                           mirror_, behind, image, root_);
      }
      held_ = Held{*frame_, with_mirrored_limb(person, options_.affected, *frame_, mirror_),
                   input.number, false};
    }
    const BodyMotion motion(held_->frame, *frame_);
    const bool is_held = report.state != PhantomState::kTracking;
    if (is_held) {
      motion.move(mirrored_, moved_);
      motion.move(root_, moved_root_);
    }
    report.texture_number = held_->number;
    report.num_mirrored = static_cast<std::int64_t>(mirrored_.size());
    report.num_away = std::ranges::count(mirrored_, false, &MirroredPoint::faces_camera);
    return write_phantom(is_held ? moved_ : mirrored_, options_.affected,
                         PixelProjector(*camera_, rays_), image);
  }

  /// Bridges and both fillings, and what the second one leaves open between pixels, as mirrored
  /// points lie farther apart. Returns the box of everything there is.
  PixelBox fill(const PixelBox& written, double time_s, const PhantomImage& image,
                PhantomReport& report) {
    const bool is_held = report.state != PhantomState::kTracking;
    const PixelProjector projector(*camera_, rays_);
    PixelBounds phantom;
    phantom.add(written);
    if (report.state != PhantomState::kLost) {
      phantom.add(bridge_gaps(is_held ? moved_ : mirrored_, projector, image, vertex_of_));
    }
    report.num_filled = fill_holes(phantom.box(), rays_, image, fills_);
    PixelBounds all = phantom;
    all.add(points_.box);
    if (report.state != PhantomState::kLost) {
      const PixelBox root = write_root(is_held ? moved_root_ : root_, projector, image);
      fill_holes(root, rays_, image, fills_, PixelKind::kRootFilled);
      all.add(root);
      give_back_lap(image);
      if (!is_held) report.num_filled += fill_from_own_limb(image);
      if (!is_held) all.add(remember(phantom.box(), root, time_s, image, report));
    }
    return all.box();
  }

  /// Keeps the phantom's ragged border still: a pixel that showed it in the frame before is filled.
  PixelBox remember(const PixelBox& limb, const PixelBox& root, double time_s,
                    const PhantomImage& image, PhantomReport& report) {
    constexpr double kLatest = 0.1;  // seconds: an older frame says nothing of this one
    const bool is_known = time_s - shown_time_s_ <= kLatest;
    shown_before_.swap(shown_);
    PixelBounds bounds;
    bounds.add(limb);
    bounds.add(root);
    list_phantom(bounds.box(), image, shown_);
    shown_time_s_ = time_s;
    if (!is_known) return {};
    const PixelBox filled = fill_remembered(shown_before_, rays_, image, fills_);
    report.num_filled += static_cast<std::int64_t>(fills_.size());
    return filled;
  }

  /// An arm beside the trunk is no part of it, but a lap has no seam between the thighs.
  void give_back_lap(const PhantomImage& image) {
    constexpr double kSeam = 0.05;  // metres
    if (options_.keep_residual || !goes_by_skin() || is_arm(options_.affected)) return;
    give_back(points_, options_.affected, bones_, kSeam, image);
    give_back_holes(points_, options_.affected, bones_, rays_, image, vertex_of_);
  }

  /// Closes the mirrored leg with the affected one where that is at its place. Points that are so
  /// near to the intact leg's skin are mirrored as its flesh; the affected leg's are taken as near
  /// to the phantom's skin. Only persons who have the leg have such points.
  std::int64_t fill_from_own_limb(const PhantomImage& image) const {
    if (options_.keep_residual || !follows_trunk() || !goes_by_skin()) return 0;
    if (is_arm(options_.affected) || !presence_.is_there()) return 0;
    return fill_from_limb(points_, options_.affected, bones_, mirror_, flesh(), image);
  }

  /// Calls use(joint) for the joints that the phantom replaces.
  template <typename Use>
  void for_each_phantom_joint(const Use& use) const {
    for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
      if (is_limb_bone(options_.affected, joint)) use(joint);
    }
  }

  [[nodiscard]] Skeleton phantom_skeleton(const Skeleton& person, PhantomState state) const {
    Skeleton result = person;
    if (state == PhantomState::kLost) {
      for_each_phantom_joint([&](std::size_t joint) {
        result.states[joint] = TrackingState::kNotTracked;
        result.positions[joint].setZero();
        result.orientations[joint] = {};
      });
      return result;
    }
    const BodyMotion motion(held_->frame, *frame_);
    const auto take = [&](std::size_t joint) {
      const Skeleton& held = held_->skeleton;
      result.states[joint] = held.states[joint];
      result.positions[joint] = held.positions[joint];
      result.orientations[joint] = held.orientations[joint];
      if (state == PhantomState::kTracking || held.states[joint] == TrackingState::kNotTracked) {
        return;
      }
      result.states[joint] = TrackingState::kInferred;
      result.positions[joint] = motion(held.positions[joint]);
    };
    take(static_cast<std::size_t>(limb_root(options_.affected)));
    for_each_phantom_joint(take);
    return result;
  }

  struct Ends {  ///< Positions of the last joint of the phantom and of the intact limb.
    Eigen::Vector3f phantom, intact;
    double time_s = 0.0;
  };

  struct Held {
    BodyFrame frame;    ///< The body's frame when the intact limb was last seen.
    Skeleton skeleton;  ///< With the phantom's joints.
    std::int64_t number = 0;
    bool is_misplaced = false;
  };

  PhantomOptions options_;
  JointSmoother smoother_;
  KeyPerson key_person_;
  InferredClock inferred_;
  LimbPresence presence_;
  TrunkTracker trunk_;
  Girth girth_;
  Stature stature_;
  Vertical vertical_;
  LegTurn legs_;
  PictureJudge picture_;
  std::optional<Ends> ends_;  ///< In the last frame with a phantom of its own.
  std::optional<Intrinsics> camera_;
  PixelRays rays_;

  bool has_time_ = false, is_here_ = false, has_skeleton_ = false;
  bool is_beside_all_ = false;  ///< No measured point is near the joints of this frame.
  std::int64_t last_time_ns_ = 0, late_frames_ = 0;
  std::int64_t late_in_row_ = 0;
  std::int64_t clock_ns_ = 0;  ///< Since the first frame, by the source's clock or a nominal one.
  Skeleton raw_;               ///< The patient in this frame as tracked, before smoothing.
  std::optional<std::int64_t> person_id_;
  std::optional<Skeleton> person_;     ///< The patient as last seen, smoothed.
  double sides_kept_since_ = kNever;   ///< Since when the tracker takes left for right.
  double sides_known_since_ = kNever;  ///< Since when the body's left is known.
  std::optional<BodyFrame> trunk_frame_;
  std::optional<BodyFrame> frame_;  ///< The same, with the turn of the legs.
  Mirror mirror_;
  std::optional<Held> held_;
  double last_tracking_ = kNever;

  BoneSegments bones_;
  PersonPoints points_;
  std::vector<MirroredPoint> mirrored_, root_, moved_, moved_root_;
  std::vector<HoleFill> fills_;
  std::vector<std::int32_t> vertex_of_;
  /// Pixels of the phantom in the last frame that had one of its own, before those that were filled
  /// because of the frame before it; and the same list of that frame.
  std::vector<std::int32_t> shown_, shown_before_;
  double shown_time_s_ = kNever;
  std::vector<float> source_depth_;
  std::vector<Removal> removal_;
  std::vector<ClothingColors> clothes_;  ///< Clothes of the people in this frame.
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
