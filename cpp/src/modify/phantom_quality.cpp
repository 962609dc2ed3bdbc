#include "modify/phantom_quality.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "manip3d/modify/joint_smoother.hpp"
#include "modify/ray_at.hpp"

namespace manip3d {
namespace {

// The limits at which a frame is degraded, chosen while looking at UTD-MHAD trials of both halves
// (kMostLeft: of the tuning half of benchmarks/bench_people.py): no rate measured on those trials
// is one for other people.
constexpr double kMostPlane = 6.0;  // degrees: 6 cm at a hand 0.3 m from the plane
constexpr double kMostLeap = 0.12;  // metres in one frame
constexpr double kMostGapArm = 0.10,
                 kMostGapLeg = 0.16;   // metres: a hip lies deeper than a shoulder
constexpr double kLeastLargest = 0.7;  // of the phantom's pixels
constexpr double kMostLostLegs = 0.15, kMostLostTrunk = 0.05;
constexpr double kMostLeft = 0.15;    // of the affected limb's pixels
constexpr double kLeastLimb = 250.0;  // pixels: of a small limb, slivers are a large share

constexpr float kAwayFromRoot = 0.10F;  // metres: nearer to it, a stump may show
constexpr float kBehind = 0.15F;        // metres behind all joints of a limb there is none of it

bool is_drawn_limb(PixelKind kind) {
  return kind >= PixelKind::kPhantom && kind != PixelKind::kRootFilled;
}

}  // namespace

double joint_fit(const Skeleton& person, Limb affected, const PixelProjector& projector,
                 const PhantomImage& image) {
  constexpr std::int32_t kMargin = 2;  // pixels: a wrist is as narrow as a joint is off
  constexpr int kLeastJoints = 5;
  int fits = 0, all = 0;
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    const auto j = static_cast<Joint>(joint);
    if (is_limb_bone(affected, joint) || j == limb_root(affected)) continue;
    if (person.state(j) != TrackingState::kTracked || !is_usable(person, j)) continue;
    ++all;
    const Eigen::Vector3f& p = person[j];
    const std::int32_t pixel = projector.pixel(p.x(), p.y(), p.z());
    if (pixel < 0) continue;
    const auto cols = static_cast<std::int32_t>(image.cols);
    const std::int32_t u = pixel % cols, v = pixel / cols;
    bool found = false;
    for (std::int32_t dv = -kMargin; dv <= kMargin && !found; ++dv) {
      for (std::int32_t du = -kMargin; du <= kMargin && !found; ++du) {
        if (u + du < 0 || v + dv < 0 || u + du >= cols || v + dv >= image.rows) continue;
        found = image.kind[(v + dv) * cols + u + du] == PixelKind::kBody;
      }
    }
    fits += found;
  }
  return all < kLeastJoints ? 1.0 : static_cast<double>(fits) / all;
}

double bone_fit(const PersonPoints& points) {
  constexpr float kReach = 0.20F;  // metres: of real people's points 97 % and more are nearer
  std::int64_t near = 0;
  for (std::size_t i = 0; i < static_cast<std::size_t>(points.count); ++i) {
    near += points.squared_distance[i] < kReach * kReach;
  }
  return points.count > 0 ? static_cast<double>(near) / static_cast<double>(points.count) : 1.0;
}

void PictureJudge::reserve(std::int64_t rows, std::int64_t cols) {
  cells_.resize(static_cast<std::size_t>(rows * cols));
  pieces_.reserve(rows, cols);
  sizes_.reserve(static_cast<std::size_t>(rows * ((cols + 1) / 2)));
}

void PictureJudge::measure(const PersonPoints& points, const Skeleton& phantom,
                           const BodyFrame& frame, const PhantomOptions& options,
                           const PixelRays& rays, const PhantomImage& image,
                           PhantomQuality& quality) {
  const Limb affected = options.affected;
  const Eigen::Vector3f root = phantom[limb_root(affected)];
  measure_pieces(root, rays, image, quality);
  // Lost: below the hips for legs; for arms within the trunk, which an arm before it may cut.
  const bool arm = is_arm(affected);
  const Eigen::Vector3f origin = frame.origin.cast<float>(), n = frame.n.cast<float>();
  const Eigen::Vector3f up = frame.y.cast<float>();
  constexpr float kHalfTrunk = 0.13F, kTrunkUp = 0.20F, kTrunkDown = 0.30F;  // of SpineMid, metres
  std::int64_t all = 0, lost = 0;
  float farthest = 0.0F;
  for (const Joint joint : limb_chain(affected)) {
    if (is_usable(phantom, joint)) farthest = std::max(farthest, phantom[joint].z());
  }
  std::int64_t limb = 0, left = 0;
  for (std::size_t i = 0; i < static_cast<std::size_t>(points.count); ++i) {
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    const std::int32_t pixel = points.pixel[i];
    const PixelKind kind = image.kind[pixel];
    const float height = up.dot(p - origin);
    const bool counts =
        arm ? std::abs(n.dot(p - origin)) < kHalfTrunk && height < kTrunkUp && height > -kTrunkDown
            : height < 0.0F;
    all += counts;
    lost += counts && kind == PixelKind::kNone;
    if (points.label[i] != limb_label(affected) || !(p.z() < farthest + kBehind)) continue;
    ++limb;
    left += kind == PixelKind::kBody && image.label[pixel] == limb_label(affected) &&
            (p - root).squaredNorm() > kAwayFromRoot * kAwayFromRoot;
  }
  if (!options.keep_residual) {
    quality.left = static_cast<double>(left) / std::max(kLeastLimb, static_cast<double>(limb));
  }
  quality.lost = all > 0 ? static_cast<double>(lost) / static_cast<double>(all) : 0.0;
}

void PictureJudge::measure_pieces(const Eigen::Vector3f& root, const PixelRays& rays,
                                  const PhantomImage& image, PhantomQuality& quality) {
  const std::int64_t size = image.rows * image.cols;
  for (std::int64_t i = 0; i < size; ++i) {
    cells_[static_cast<std::size_t>(i)] = is_drawn_limb(image.kind[i]);
  }
  sizes_.clear();
  std::int64_t all = 0;
  for (const MarkedRun& run : pieces_.find(cells_.data(), image.rows, image.cols, false)) {
    const auto piece = static_cast<std::size_t>(run.component);
    if (piece == sizes_.size()) sizes_.push_back({0, 1e6F});
    for (std::int64_t u = run.first; u <= run.last; ++u) {
      const float z = image.depth[run.row * image.cols + u];
      const float off = (lift(rays, u, run.row, z) - root).squaredNorm();
      sizes_[piece].nearest = std::min(sizes_[piece].nearest, off);
    }
    sizes_[piece].pixels += run.last - run.first + 1;
    all += run.last - run.first + 1;
  }
  const auto largest = std::ranges::max_element(sizes_, {}, &Piece::pixels);
  if (largest == sizes_.end()) return;
  quality.gap = std::sqrt(static_cast<double>(largest->nearest));
  quality.largest = static_cast<double>(largest->pixels) / static_cast<double>(all);
}

PhantomReason worst_of(Limb affected, PhantomQuality& quality) {
  const double most_lost = is_arm(affected) ? kMostLostTrunk : kMostLostLegs;
  const std::array<std::pair<PhantomReason, double>, 7> measures = {{
      {PhantomReason::kCalibration, (1.0 - quality.fit) / (1.0 - kLeastFit)},
      {PhantomReason::kShaky, quality.plane_deg / kMostPlane},
      {PhantomReason::kLeap, quality.leap / kMostLeap},
      {PhantomReason::kDetached, quality.gap / (is_arm(affected) ? kMostGapArm : kMostGapLeg)},
      {PhantomReason::kShredded, (1.0 - quality.largest) / (1.0 - kLeastLargest)},
      {PhantomReason::kCut, quality.lost / most_lost},
      {PhantomReason::kDoubled, quality.left / kMostLeft},
  }};
  const auto worst =
      std::ranges::max_element(measures, {}, &decltype(measures)::value_type::second);
  quality.score = worst->second;
  if (quality.fit < kLeastFit) return PhantomReason::kCalibration;  // it explains all else
  return worst->second > 1.0 ? worst->first : PhantomReason::kNone;
}

}  // namespace manip3d
