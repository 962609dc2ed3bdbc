#include "modify/stature.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <tuple>

namespace manip3d {
namespace {

// Chosen on the tuning half of benchmarks/bench_people.py, where the median of a trial's ratios is
// 0.985 to 1.04, and on simulated people, where it is 1.00 to 1.024. It is above 1 because the
// crown is farther from the head's joint than the head's radius, and the soles from a foot's joint
// than the foot's.
constexpr double kUsual = 1.01;
constexpr double kMaxOff = 0.06;  // allowed deviation of a mean over many frames
constexpr double kFewFrames = 3.0;

/// The farthest of some points in one direction, except for two, which may be noise.
class Farthest {
 public:
  void add(float along, std::int32_t pixel) {
    if (!(along > best_.back().along)) return;
    best_.back() = {along, pixel};
    for (std::size_t i = best_.size() - 1; i > 0 && best_[i].along > best_[i - 1].along; --i) {
      std::swap(best_[i], best_[i - 1]);
    }
  }
  [[nodiscard]] bool is_known() const { return best_.back().pixel >= 0; }
  [[nodiscard]] float along() const { return best_.back().along; }
  [[nodiscard]] std::int32_t pixel() const { return best_.back().pixel; }

 private:
  struct Place {
    float along = -std::numeric_limits<float>::max();
    std::int32_t pixel = -1;
  };
  std::array<Place, 3> best_;
};

bool is_at_border(std::int32_t pixel, const PersonPoints& points) {
  constexpr std::int64_t kBorder = 3;  // pixels
  const std::int64_t u = pixel % points.cols, v = pixel / points.cols;
  return std::min(u, points.cols - 1 - u) < kBorder || std::min(v, points.rows - 1 - v) < kBorder;
}

/// Whether the person continues below a pixel, hidden by something nearer.
bool goes_on_below(std::int32_t pixel, const Eigen::Vector2f& down, const PersonPoints& points,
                   const DepthView& depth) {
  constexpr float kBelow = 2.0F;  // pixels; those in between may mix both depths
  // Share of the depth. The floor 0.7 m below a camera at 4 m is nearer by only 0.031 of the depth.
  constexpr float kNearer = 0.035F;
  const Eigen::Vector2f below = kBelow * down;
  const auto u = pixel % points.cols + static_cast<std::int64_t>(std::lround(below.x()));
  const auto v = pixel / points.cols + static_cast<std::int64_t>(std::lround(below.y()));
  const float z = depth.at(v * points.cols + u);
  return z > 0.0F && z < (1.0F - kNearer) * depth.at(pixel);
}

/// Radius of the body around a bone's far end, metres; no value if the bone is missing.
std::optional<float> radius_at_end(const BoneSegments& bones, Joint joint) {
  for (std::size_t k = 0; k < bones.count; ++k) {
    if (bones.label[k] == static_cast<std::uint8_t>(joint)) return bones.radii[k].end;
  }
  return std::nullopt;
}

Eigen::Vector2f in_image(const Eigen::Vector3f& p) { return p.head<2>() / p.z(); }

/// Whether a leg shows the camera its sole, which is nearer than the ankle and rounder than a foot
/// seen from above.
bool shows_sole(const Eigen::Vector3f& knee, const Eigen::Vector3f& ankle) {
  constexpr float kTowards = 0.5F;  // cosine of 60 degrees
  const Eigen::Vector3f shin = ankle - knee;
  return !(-shin.dot(ankle.normalized()) < kTowards * shin.norm());
}

struct CrownAndGround {
  // In the image: distance from the head's joint along the line to the ankle.
  Farthest crown, ground;
};

/// Finds the highest pixels of the head and the lowest pixels of one foot.
CrownAndGround find_crown_and_ground(const PersonPoints& points, Joint ankle, Joint foot,
                                     const Eigen::Vector2f& head, const Eigen::Vector2f& down) {
  // Metres from the skin; with a focal length wrong by a factor of 1.4, soles are this far off.
  constexpr float kFarthest = 0.3F;
  CrownAndGround found;
  for (std::int64_t i = 0; i < points.count; ++i) {
    const auto label = static_cast<Joint>(points.label[i]);
    const bool is_head = label == Joint::kHead;
    if (!(is_head || label == ankle || label == foot)) continue;
    if (!(points.skin_distance[i] < kFarthest)) continue;
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    const float along = down.dot(in_image(p) - head);
    if (is_head) {
      found.crown.add(-along, points.pixel[i]);
    } else {
      found.ground.add(along, points.pixel[i]);
    }
  }
  return found;
}

/// Height of the pixels over that of the joints, from the crown to the sole of one leg.
std::optional<double> height_ratio(const Skeleton& person, Joint knee, Joint ankle, Joint foot,
                                   const BoneSegments& bones, const PersonPoints& points,
                                   const DepthView& depth, const PixelProjector& projector) {
  constexpr float kNearest = 0.3F;  // metres from the camera
  // Share of the distance along the axis; shorter lines are too inaccurate.
  constexpr float kShortest = 0.2F;
  // Trackers go on beyond the border of the image; what is seen of such a leg ends above its sole.
  const auto is_seen = [&](Joint joint) {
    const Eigen::Vector3f& p = person[joint];
    if (person.state(joint) != TrackingState::kTracked || !(p.z() > kNearest)) return false;
    const std::int32_t pixel = projector.pixel(p.x(), p.y(), p.z());
    return pixel >= 0 && !is_at_border(pixel, points);
  };
  if (!is_seen(Joint::kHead) || !is_seen(ankle) || !is_seen(foot)) return std::nullopt;
  if (shows_sole(person[knee], person[ankle])) return std::nullopt;
  const auto head_radius = radius_at_end(bones, Joint::kHead);
  const auto ankle_radius = radius_at_end(bones, ankle), foot_radius = radius_at_end(bones, foot);
  if (!head_radius || !ankle_radius || !foot_radius) return std::nullopt;
  const Eigen::Vector2f head = in_image(person[Joint::kHead]);
  const Eigen::Vector2f line = in_image(person[ankle]) - head;
  if (!(line.norm() > kShortest)) return std::nullopt;
  const Eigen::Vector2f down = line.normalized();
  const auto sole = [&](Joint joint, float radius) {
    return down.dot(in_image(person[joint]) - head) + radius / person[joint].z();
  };
  const float lowest = std::max(sole(ankle, *ankle_radius), sole(foot, *foot_radius));
  const float highest = *head_radius / person[Joint::kHead].z();
  const auto [crown, ground] = find_crown_and_ground(points, ankle, foot, head, down);
  if (!crown.is_known() || !ground.is_known()) return std::nullopt;
  if (is_at_border(crown.pixel(), points) || is_at_border(ground.pixel(), points)) {
    return std::nullopt;
  }
  if (goes_on_below(ground.pixel(), down, points, depth)) return std::nullopt;
  const float of_pixels = (crown.along() + ground.along()) / (highest + lowest);
  // A hat increases a person's height but does not move the soles, and high soles do not move the
  // crown. A wrong focal length moves both away from the optical axis. If the optical axis passes
  // near the soles, it cannot be told from a hat; if it passes near the crown, not from high soles.
  const float to_head = down.dot(head);
  const float to_sole = to_head + lowest, to_crown = highest - to_head;
  const float of_soles = to_sole > kShortest ? (to_head + ground.along()) / to_sole : 1.0F;
  const float of_crown = to_crown > kShortest ? (crown.along() - to_head) / to_crown : of_pixels;
  return static_cast<double>(std::min(of_pixels, std::max(std::min(of_soles, of_crown), 1.0F)));
}

}  // namespace

void Stature::learn(const Skeleton& person, const BoneSegments& bones, const PersonPoints& points,
                    const DepthView& depth, const PixelProjector& projector) {
  using enum Joint;
  double sum = 0.0;
  int legs = 0;
  for (const auto& [knee, ankle, foot] : {std::tuple{kKneeLeft, kAnkleLeft, kFootLeft},
                                          std::tuple{kKneeRight, kAnkleRight, kFootRight}}) {
    const auto ratio = height_ratio(person, knee, ankle, foot, bones, points, depth, projector);
    if (!ratio) continue;
    sum += *ratio;
    ++legs;
  }
  if (legs == 0) return;
  constexpr double kMemory = 90.0;             // frames
  constexpr double kLeast = 0.6, kMost = 1.6;  // a frame's ratio is clamped to this range
  frames_ = std::min(frames_ + 1.0, kMemory);
  const double now = std::clamp(sum / legs, kLeast, kMost);
  ratio_ += (now - ratio_) / frames_;
}

double Stature::misfit() const {
  if (!(frames_ > 0.0)) return 1.0;
  return std::max(ratio_ / kUsual, kUsual / ratio_);
}

double Stature::limit() const {
  return 1.0 + kMaxOff * (1.0 + kFewFrames / std::max(1.0, frames_));
}

}  // namespace manip3d
