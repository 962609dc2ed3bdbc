#include "modify/loose_cloth.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>

namespace manip3d {
namespace {

// Lengths in metres.
// A body that is this far behind the mirrored place is not at that place.
constexpr float kSeenThrough = 0.08F;
constexpr float kMargin = 0.03F;  // error of the plane and of the symmetry of bodies
// A point farther from the skin of a limb is not certainly that limb's.
constexpr float kOffSkin = 0.03F;
// The same for an arm; larger, because fingers reach beyond the joints.
constexpr float kOffArmSkin = 0.10F;
constexpr float kAbove = 0.05F;      // cloth hangs below the root
constexpr float kTrunkHalf = 0.10F;  // the sleeve of an arm hangs farther from the plane than this
// Trunks of real people reach this far to either side of the plane.
constexpr float kTrunkWidth = 0.16F;
// Pixels; for small limbs, single pixels would be a large share.
constexpr double kMinIntact = 250.0;
constexpr float kBeyond = 1.15F;        // longest cloth, relative to the length of the limb
constexpr std::size_t kMinPixels = 20;  // fewer pixels are noise of an edge

/// Tests whether a point violates the body's symmetry.
class ClothTest {
 public:
  ClothTest(const ClothSearch& search, const PixelProjector& projector, const PhantomImage& image)
      : search_(search),
        projector_(projector),
        image_(image),
        linear_(search.mirror.linear.cast<float>()),
        offset_(search.mirror.offset.cast<float>()),
        n_(search.frame.n.cast<float>()),
        up_(search.frame.y.cast<float>()),
        origin_(search.frame.origin.cast<float>()),
        side_(n_.dot(search.root - origin_) < 0.0F ? -1.0F : 1.0F) {}

  /// Whether the cloth of the limb can hang at a point.
  [[nodiscard]] bool is_in_reach(const Eigen::Vector3f& p) const {
    const Eigen::Vector3f from = p - search_.root;
    const float most = kBeyond * search_.length;
    const float least = is_arm(search_.affected) ? kTrunkHalf : kMargin;
    return from.squaredNorm() < most * most && up_.dot(from) < kAbove && aside(p) > least;
  }

  /// Whether the place of the mirrored point, moved towards the plane by `margin`, is empty or
  /// occupied by the intact limb.
  [[nodiscard]] bool is_cloth(const Eigen::Vector3f& p, float margin,
                              const DepthView& depth) const {
    const Eigen::Vector3f q = mirrored(p, margin);
    const std::int32_t pixel = projector_.pixel(q.x(), q.y(), q.z());
    if (pixel < 0 || image_.removal[pixel] == Removal::kRemoved) return false;
    if (image_.kind[pixel] == PixelKind::kBody) {
      const float least = is_intact(pixel) ? -kSameSurface : kSeenThrough;
      return image_.depth[pixel] - q.z() > least;
    }
    const float z = depth.at(pixel);
    return !(z > 0.0F) || z > q.z() + kSameSurface;
  }

  /// Whether the intact limb hides the mirrored place.
  [[nodiscard]] bool is_hidden(const Eigen::Vector3f& p) const {
    const Eigen::Vector3f q = mirrored(p, 0.0F);
    const std::int32_t pixel = projector_.pixel(q.x(), q.y(), q.z());
    if (pixel < 0 || image_.kind[pixel] != PixelKind::kBody || !is_intact(pixel)) return false;
    return q.z() - image_.depth[pixel] > kSameSurface;
  }

  /// Distance from the plane, positive on the affected side.
  [[nodiscard]] float aside(const Eigen::Vector3f& p) const { return side_ * n_.dot(p - origin_); }

 private:
  [[nodiscard]] Eigen::Vector3f mirrored(const Eigen::Vector3f& p, float margin) const {
    return linear_ * p + offset_ + side_ * margin * n_;
  }
  [[nodiscard]] bool is_intact(std::int32_t pixel) const {
    return is_limb_bone(opposite(search_.affected), image_.label[pixel]);
  }

  const ClothSearch& search_;
  const PixelProjector& projector_;
  const PhantomImage& image_;
  Eigen::Matrix3f linear_;
  Eigen::Vector3f offset_, n_, up_, origin_;
  float side_;
};

/// Whether a point is so far from the skin of its nearest bone that it may be cloth.
bool is_far_from_skin(std::uint8_t label, float skin_distance) {
  const bool is_of_arm =
      is_limb_bone(Limb::kLeftArm, label) || is_limb_bone(Limb::kRightArm, label);
  return skin_distance > (is_of_arm ? kOffArmSkin : kOffSkin);
}

/// Marks the points that pass the weak or the strong test.
void mark_cloth(const PersonPoints& points, const ClothSearch& search, const ClothTest& test,
                const DepthView& depth, const PhantomImage& image) {
  for (std::int64_t i = 0; i < points.count; ++i) {
    const std::int32_t pixel = points.pixel[i];
    if (image.kind[pixel] != PixelKind::kBody) continue;
    const std::uint8_t label = points.label[i];
    const bool may_be = label == limb_label(search.affected) || is_spine_or_hip(label) ||
                        is_far_from_skin(label, points.skin_distance[i]);
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    if (!may_be || !test.is_in_reach(p) || !test.is_cloth(p, 0.0F, depth)) continue;
    image.removal[pixel] =
        test.is_cloth(p, kMargin, depth) ? Removal::kSurelyCloth : Removal::kPerhapsCloth;
  }
}

/// A connected piece of cloth: pixels that pass the strong test, and pixels that pass only the weak
/// one within a given number of rings around them.
class ClothPiece {
 public:
  ClothPiece(const PhantomImage& image, std::vector<std::int32_t>& stack)
      : image_(image), stack_(stack) {}

  /// Number of pixels that pass the strong test.
  std::size_t start(std::int32_t pixel) {
    count_ = 0;
    add(pixel);
    for (std::size_t next = 0; next < count_; ++next) spread(stack_[next], Removal::kSurelyCloth);
    return count_;
  }

  void grow(std::int32_t rings) {
    std::size_t begin = 0;
    for (std::int32_t ring = 0; ring < rings; ++ring) {
      const std::size_t end = count_;
      for (; begin < end; ++begin) spread(stack_[begin], Removal::kPerhapsCloth);
    }
  }

  std::int64_t take_all_out() const {
    for (std::size_t k = 0; k < count_; ++k) take_out(stack_[k], image_);
    return static_cast<std::int64_t>(count_);
  }

 private:
  void add(std::int32_t pixel) {
    image_.removal[pixel] = Removal::kExamined;
    stack_[count_++] = pixel;
  }
  void spread(std::int32_t pixel, Removal to) {
    for_each_neighbor(pixel, image_, [&](std::int32_t beside) {
      if (beside < 0 || image_.removal[beside] != to) return;
      const float step = image_.source_depth[beside] - image_.source_depth[pixel];
      if (std::abs(step) < kSameSurface) add(beside);
    });
  }

  const PhantomImage& image_;
  std::vector<std::int32_t>& stack_;
  std::size_t count_ = 0;
};

}  // namespace

std::int64_t remove_loose_cloth(PersonPoints& points, const ClothSearch& search,
                                const DepthView& depth, const PixelProjector& projector,
                                const PhantomImage& image, std::vector<std::int32_t>& stack) {
  mark_cloth(points, search, ClothTest(search, projector, image), depth, image);
  const auto rings = static_cast<std::int32_t>(
      std::ceil(kMargin * search.focal / std::max(search.root.z(), 0.1F)));
  ClothPiece piece(image, stack);
  std::int64_t removed = 0;
  for (std::int64_t i = 0; i < points.count; ++i) {
    if (image.removal[points.pixel[i]] != Removal::kSurelyCloth) continue;
    if (piece.start(points.pixel[i]) < kMinPixels) continue;
    piece.grow(rings);
    removed += piece.take_all_out();
  }
  for (std::int64_t i = 0; i < points.count; ++i) {
    const bool was_removed = image.removal[points.pixel[i]] == Removal::kRemoved;
    if (was_removed && points.label[i] != limb_label(search.affected)) points.label[i] = 0;
  }
  return removed;
}

double share_of_unseen_cloth(const PersonPoints& points, const ClothSearch& search,
                             const PixelProjector& projector, const PhantomImage& image) {
  const ClothTest test(search, projector, image);
  const auto may_be = [&](std::uint8_t label, const Eigen::Vector3f& p) {
    const bool is_of_trunk = is_spine_or_hip(label) || label == limb_label(search.affected) ||
                             label == static_cast<std::uint8_t>(limb_root(search.affected));
    // Cloth beside one leg is labelled as the other leg; points with labels of trunk or affected
    // leg may be the pelvis and the stump.
    if (!is_arm(search.affected)) return !is_of_trunk;
    return is_of_trunk && test.aside(p) > kTrunkWidth;
  };
  std::int64_t intact = 0, unseen = 0;
  for (std::int64_t i = 0; i < points.count; ++i) {
    if (image.kind[points.pixel[i]] != PixelKind::kBody) continue;
    const std::uint8_t label = points.label[i];
    intact += is_limb_bone(opposite(search.affected), label);
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    unseen += test.is_in_reach(p) && may_be(label, p) && test.is_hidden(p);
  }
  return static_cast<double>(unseen) / std::max(kMinIntact, static_cast<double>(intact));
}

}  // namespace manip3d
