#include "modify/phantom_image.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

#include "modify/nearest_skin.hpp"
#include "modify/pixel_bounds.hpp"
#include "modify/ray_at.hpp"

namespace manip3d {
namespace {

BoneSet limb_bones(Limb limb) {
  BoneSet bones{};
  for (std::size_t bone = 0; bone < kNumJoints; ++bone) bones[bone] = is_limb_bone(limb, bone);
  return bones;
}

bool is_phantom(PixelKind kind) { return kind >= PixelKind::kPhantom; }

/// Points and normals of a depth image.
class Surface {
 public:
  Surface(const PixelRays& rays, const PhantomImage& image) : rays_(rays), image_(image) {}

  [[nodiscard]] Eigen::Vector3f point(std::int64_t u, std::int64_t v) const {
    return lift(rays_, u, v, image_.depth[v * image_.cols + u]);
  }

  /// Normal of the surface at a pixel, of any length and to either side; 0 for a lone pixel.
  [[nodiscard]] Eigen::Vector3f normal(std::int64_t u, std::int64_t v) const {
    constexpr std::int64_t kStep = 2;  // pixels: less noise than next neighbours, and still narrow
    return difference(u, v, kStep, 0).cross(difference(u, v, 0, kStep));
  }

 private:
  [[nodiscard]] Eigen::Vector3f difference(std::int64_t u, std::int64_t v, std::int64_t du,
                                           std::int64_t dv) const {
    const Eigen::Vector3f ahead = beside(u, v, u + du, v + dv);
    const Eigen::Vector3f behind = beside(u, v, u - du, v - dv);
    return ahead - behind;
  }
  /// The point of a nearby pixel, or that of (u, v) itself if the pixel shows another surface.
  [[nodiscard]] Eigen::Vector3f beside(std::int64_t u, std::int64_t v, std::int64_t to_u,
                                       std::int64_t to_v) const {
    if (to_u < 0 || to_v < 0 || to_u >= image_.cols || to_v >= image_.rows) return point(u, v);
    const float z = image_.depth[v * image_.cols + u];
    const float other = image_.depth[to_v * image_.cols + to_u];
    return std::abs(z - other) < kSameSurface ? point(to_u, to_v) : point(u, v);
  }

  const PixelRays& rays_;
  const PhantomImage& image_;
};

void draw(const HoleFill& fill, PixelKind kind, const PhantomImage& image) {
  image.depth[fill.pixel] = fill.depth;
  image.label[fill.pixel] = fill.label;
  image.kind[fill.pixel] = kind;
  image.source[2 * fill.pixel] = fill.row;
  image.source[2 * fill.pixel + 1] = fill.col;
  image.source_depth[fill.pixel] = fill.source_depth;
}

void draw(const MirroredPoint& point, std::int32_t pixel, PixelKind kind,
          const PhantomImage& image) {
  const auto cols = static_cast<std::int32_t>(image.cols);
  draw({pixel, point.z, point.source_depth, point.source / cols, point.source % cols, point.label},
       kind, image);
}

/// Draws a pixel of the person with the measured point as its own source.
void draw_measured(std::int32_t pixel, float z, std::uint8_t label, const PhantomImage& image,
                   PixelKind kind = PixelKind::kBody) {
  const auto cols = static_cast<std::int32_t>(image.cols);
  draw({pixel, z, z, pixel / cols, pixel % cols, label}, kind, image);
}

/// The depth that a mirrored point must be in front of to be drawn at a pixel. A stump hides points
/// up to kSameSurface before it, which would otherwise pierce its noisy surface.
float barrier(std::int32_t pixel, Limb affected, const PhantomImage& image) {
  const bool stump =
      image.kind[pixel] == PixelKind::kBody && image.label[pixel] == limb_label(affected);
  return stump ? image.depth[pixel] - kSameSurface : image.depth[pixel];
}

/// Mirrors points of the person in single precision.
class LimbMirror {
 public:
  explicit LimbMirror(const Mirror& mirror)
      : linear_(mirror.linear.cast<float>()), offset_(mirror.offset.cast<float>()) {}

  [[nodiscard]] MirroredPoint operator()(const PersonPoints& points, std::size_t i) const {
    const Eigen::Vector3f p =
        linear_ * Eigen::Vector3f(points.x[i], points.y[i], points.z[i]) + offset_;
    return {p.x(), p.y(), p.z(), points.z[i], points.pixel[i], kMirroredJoints[points.label[i]],
            true,  false};
  }

 private:
  Eigen::Matrix3f linear_;
  Eigen::Vector3f offset_;
};

}  // namespace

PixelProjector::PixelProjector(const Intrinsics& camera, const PixelRays& rays)
    : rays_(&rays),
      fx_(static_cast<float>(camera.mirrored ? -camera.fx : camera.fx)),
      fy_(static_cast<float>(camera.fy)),
      cx_(static_cast<float>(camera.cx)),
      cy_(static_cast<float>(camera.cy)),
      width_(static_cast<std::int32_t>(camera.width)),
      height_(static_cast<std::int32_t>(camera.height)) {}

std::int32_t PixelProjector::pixel(float x, float y, float z) const {
  if (!(z > 0.0F)) return -1;
  const float ray_x = x / z, ray_y = y / z;
  float u = fx_ * ray_x + cx_, v = fy_ * ray_y + cy_;
  if (!rays_->is_separable()) {
    // Newton steps on the table of rays, with the derivative of the pinhole model.
    constexpr int kSteps = 4;
    for (int i = 0; i < kSteps; ++i) {
      const auto col =
          static_cast<std::int32_t>(std::clamp(u + 0.5F, 0.0F, static_cast<float>(width_ - 1)));
      const auto row =
          static_cast<std::int32_t>(std::clamp(v + 0.5F, 0.0F, static_cast<float>(height_ - 1)));
      u = static_cast<float>(col) + fx_ * (ray_x - rays_->x(row)[col]);
      v = static_cast<float>(row) + fy_ * (ray_y - rays_->y(row)[col]);
      if (!(std::abs(u) < 1e6F && std::abs(v) < 1e6F)) return -1;
    }
  }
  u += 0.5F;
  v += 0.5F;
  if (!(u >= 0.0F && v >= 0.0F && u < static_cast<float>(width_) &&
        v < static_cast<float>(height_))) {
    return -1;
  }
  return static_cast<std::int32_t>(v) * width_ + static_cast<std::int32_t>(u);
}

void draw_person(const PersonPoints& points, const PhantomImage& image) {
  const std::int64_t size = image.rows * image.cols;
  std::fill_n(image.depth, size, 0.0F);
  std::fill_n(image.label, size, std::uint8_t{0});
  std::fill_n(image.kind, size, PixelKind::kNone);
  std::fill_n(image.source, 2 * size, -1);
  std::fill_n(image.removal, size, Removal::kNone);
  for (std::int64_t i = 0; i < points.count; ++i) {
    draw_measured(points.pixel[i], points.z[i], points.label[i], image);
  }
}

void take_out(std::int32_t pixel, const PhantomImage& image) {
  image.depth[pixel] = 0.0F;
  image.label[pixel] = 0;
  image.kind[pixel] = PixelKind::kNone;
  image.source[2 * pixel] = image.source[2 * pixel + 1] = -1;
  image.removal[pixel] = Removal::kRemoved;
}

std::int64_t remove_limb(const PersonPoints& points, Limb limb, double radius, double flesh,
                         const PhantomImage& image) {
  const auto most = static_cast<float>(radius * radius);
  const auto most_skin = static_cast<float>(flesh);
  std::int64_t removed = 0;
  for (std::int64_t i = 0; i < points.count; ++i) {
    if (points.label[i] != limb_label(limb) || !(points.squared_distance[i] <= most)) continue;
    if (!(points.skin_distance[i] <= most_skin)) continue;
    take_out(points.pixel[i], image);
    ++removed;
  }
  return removed;
}

std::int64_t remove_rest(const PersonPoints& points, Limb limb, const PhantomImage& image,
                         std::vector<std::int32_t>& stack) {
  const auto is_rest = [&](std::int32_t pixel) {
    return image.kind[pixel] == PixelKind::kBody && image.label[pixel] == limb_label(limb);
  };
  std::int64_t removed = 0;
  for (std::int64_t i = 0; i < points.count; ++i) {
    const std::int32_t first = points.pixel[i];
    if (points.label[i] != limb_label(limb) || !is_rest(first)) continue;
    if (image.removal[first] != Removal::kNone) continue;
    std::size_t count = 0;
    bool hangs_on_body = false, hangs_on_removed = false;
    const auto add = [&](std::int32_t pixel) {
      image.removal[pixel] = Removal::kExamined;
      stack[count++] = pixel;
    };
    add(first);
    for (std::size_t next = 0; next < count; ++next) {
      const std::int32_t pixel = stack[next];
      for_each_neighbor(pixel, image, [&](std::int32_t beside) {
        if (beside < 0) return;
        const bool was_removed = image.removal[beside] == Removal::kRemoved;
        if (image.kind[beside] != PixelKind::kBody && !was_removed) return;
        const float step = image.source_depth[beside] - image.source_depth[pixel];
        if (!(std::abs(step) < kSameSurface)) return;
        if (was_removed) {
          hangs_on_removed = true;
        } else if (!is_rest(beside)) {
          hangs_on_body = true;
        } else if (image.removal[beside] == Removal::kNone) {
          add(beside);
        }
      });
    }
    if (hangs_on_body || !hangs_on_removed) continue;
    for (std::size_t k = 0; k < count; ++k) take_out(stack[k], image);
    removed += static_cast<std::int64_t>(count);
  }
  return removed;
}

namespace {

NearestSkin nearest_other_skin(const Eigen::Vector3f& p, const BoneSegments& bones,
                               std::uint8_t left_out) {
  return nearest_skin(p, bones, [left_out](std::uint8_t label) { return label != left_out; });
}

}  // namespace

std::int64_t keep_to_side(Limb leg, bool is_there, const BoneSegments& bones,
                          const BodyFrame& frame, PersonPoints& points, const PhantomImage& image,
                          std::vector<std::int32_t>& given) {
  const BoneSet is_other = limb_bones(opposite(leg));
  const Eigen::Vector3f n = frame.n.cast<float>(), origin = frame.origin.cast<float>();
  const auto point = [&](std::int64_t i) {
    return Eigen::Vector3f(points.x[i], points.y[i], points.z[i]);
  };
  const auto beyond = [&](const Eigen::Vector3f& p) {  // metres beyond the plane of symmetry
    const float left = n.dot(p - origin);              // n points to the person's left
    return leg == Limb::kLeftLeg ? -left : left;
  };
  std::int64_t count = 0, more = 0;
  for (std::int64_t i = 0; i < points.count; ++i) {
    if (is_other[points.label[i]]) --more;
    if (points.label[i] != limb_label(leg)) continue;
    ++more;
    const Eigen::Vector3f p = point(i);
    if (!(beyond(p) > 0.0F)) continue;
    const NearestSkin mine =
        nearest_skin(p, bones, [&](std::uint8_t label) { return label == limb_label(leg); });
    if (beyond(mine.on_bone) > mine.radius) continue;
    given[count++] = static_cast<std::int32_t>(i);
  }
  if (is_there && count > more) return 0;
  for (std::int64_t k = 0; k < count; ++k) {
    const std::int32_t i = given[k];
    const NearestSkin other =
        nearest_skin(point(i), bones, [&](std::uint8_t label) { return is_other[label]; });
    if (other.label == 0) return 0;  // no bone of the other leg is known
    points.label[i] = image.label[points.pixel[i]] = other.label;
  }
  return count;
}

std::int64_t give_back(const PersonPoints& points, Limb limb, const BoneSegments& bones,
                       double reach, const PhantomImage& image) {
  std::int64_t given = 0;
  for (std::int64_t i = 0; i < points.count; ++i) {
    const std::int32_t pixel = points.pixel[i];
    if (points.label[i] != limb_label(limb) || image.kind[pixel] != PixelKind::kNone) continue;
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    const NearestSkin nearest = nearest_other_skin(p, bones, limb_label(limb));
    if (!(nearest.distance <= static_cast<float>(reach))) continue;
    draw_measured(pixel, points.z[i], nearest.label, image);
    ++given;
  }
  return given;
}

std::int64_t give_back_holes(const PersonPoints& points, Limb limb, const BoneSegments& bones,
                             const PixelRays& rays, const PhantomImage& image,
                             std::vector<std::int32_t>& stack) {
  const std::uint8_t label = limb_label(limb);
  constexpr float kLap = 0.40F;  // metres from the hip: most of a thigh
  const auto first = std::find(
      bones.label.begin(), bones.label.begin() + static_cast<std::ptrdiff_t>(bones.count), label);
  if (first == bones.label.begin() + static_cast<std::ptrdiff_t>(bones.count)) return 0;
  const Eigen::Vector3f root = bones.start[first - bones.label.begin()];
  const auto point = [&](std::int32_t pixel) {
    return lift(rays, pixel % image.cols, pixel / image.cols, image.source_depth[pixel]);
  };
  const auto is_gone = [&](std::int32_t pixel) {
    return image.kind[pixel] == PixelKind::kNone && image.removal[pixel] == Removal::kRemoved &&
           (point(pixel) - root).squaredNorm() < kLap * kLap;
  };
  std::int64_t given = 0;
  for (std::int64_t i = 0; i < points.count; ++i) {
    if (!is_gone(points.pixel[i])) continue;
    std::size_t count = 0;
    std::int64_t beside_body = 0, beside_others = 0;
    const auto add = [&](std::int32_t pixel) {
      image.removal[pixel] = Removal::kExamined;
      stack[count++] = pixel;
    };
    add(points.pixel[i]);
    for (std::size_t next = 0; next < count; ++next) {
      for_each_neighbor(stack[next], image, [&](std::int32_t beside) {
        if (beside >= 0 && is_gone(beside)) {
          add(beside);
        } else if (beside >= 0 && image.kind[beside] == PixelKind::kBody) {
          ++beside_body;
        } else if (beside < 0 || image.kind[beside] != PixelKind::kNone ||
                   image.removal[beside] != Removal::kExamined) {
          ++beside_others;
        }
      });
    }
    if (beside_body < beside_others) continue;
    for (std::size_t k = 0; k < count; ++k) {
      const std::int32_t pixel = stack[k];
      draw_measured(pixel, image.source_depth[pixel],
                    nearest_other_skin(point(pixel), bones, label).label, image);
    }
    given += static_cast<std::int64_t>(count);
  }
  return given;
}

std::int64_t fill_from_limb(const PersonPoints& points, Limb limb, const BoneSegments& bones,
                            const Mirror& mirror, double reach, const PhantomImage& image) {
  const BoneSet is_intact = limb_bones(opposite(limb));
  const Eigen::Matrix3f linear = mirror.linear.cast<float>();
  const Eigen::Vector3f offset = mirror.offset.cast<float>();
  std::int64_t filled = 0;
  for (std::int64_t i = 0; i < points.count; ++i) {
    const std::int32_t pixel = points.pixel[i];
    if (points.label[i] != limb_label(limb) || image.kind[pixel] != PixelKind::kNone) continue;
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    const NearestSkin nearest = nearest_skin(linear * p + offset, bones,
                                             [&](std::uint8_t label) { return is_intact[label]; });
    if (!(nearest.distance <= static_cast<float>(reach))) continue;
    draw_measured(pixel, points.z[i], kMirroredJoints[nearest.label], image, PixelKind::kFilled);
    ++filled;
  }
  return filled;
}

void mirror_limb(const PersonPoints& points, Limb intact, double radius, double flesh,
                 const PixelRays& rays, const Mirror& mirror, const PhantomImage& image,
                 std::vector<MirroredPoint>& mirrored) {
  mirrored.clear();
  const BoneSet is_intact = limb_bones(intact);
  const auto most = static_cast<float>(radius * radius);
  const auto most_skin = static_cast<float>(flesh);
  const Surface surface(rays, image);
  const LimbMirror to_other_side(mirror);
  // A mirrored surface faces the camera if the surface faces the mirrored camera.
  const Eigen::Vector3f mirrored_camera = mirror.offset.cast<float>();
  for (std::int64_t i = 0; i < points.count; ++i) {
    if (!is_intact[points.label[i]] || !(points.squared_distance[i] <= most)) continue;
    if (!(points.skin_distance[i] <= most_skin)) continue;
    MirroredPoint& point = mirrored.emplace_back(to_other_side(points, i));
    const std::int64_t u = points.pixel[i] % image.cols, v = points.pixel[i] / image.cols;
    const Eigen::Vector3f normal = surface.normal(u, v);
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    point.faces_camera = !(normal.dot(p) * normal.dot(p - mirrored_camera) < 0.0F);
  }
}

bool is_spine_or_hip(std::uint8_t bone) {
  const auto joint = static_cast<Joint>(bone);
  return is_spine_bone(bone) || joint == Joint::kHipLeft || joint == Joint::kHipRight;
}

BoneSet bones_behind(Limb limb) {
  BoneSet behind{};
  for (std::uint8_t bone = 0; bone < kNumJoints; ++bone) behind[bone] = is_spine_or_hip(bone);
  for (const Limb leg : {Limb::kLeftLeg, Limb::kRightLeg}) {
    if (is_arm(limb)) behind[limb_label(leg)] = true;
  }
  return behind;
}

void mirror_around_root(const PersonPoints& points, const Eigen::Vector3f& root, double radius,
                        const BodyFrame& frame, const Mirror& mirror, const BoneSet& behind,
                        const PhantomImage& image, std::vector<MirroredPoint>& mirrored) {
  mirrored.clear();
  const auto most = static_cast<float>(radius * radius);
  const Eigen::Vector3f n = frame.n.cast<float>(), origin = frame.origin.cast<float>();
  const bool positive = n.dot(root - origin) > 0.0F;
  const LimbMirror to_other_side(mirror);
  for (std::int64_t i = 0; i < points.count; ++i) {
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    const bool is_near = (p - root).squaredNorm() <= most;
    if (!is_near && !behind[points.label[i]]) continue;
    if ((n.dot(p - origin) > 0.0F) != positive) continue;
    if (image.kind[points.pixel[i]] != PixelKind::kBody) continue;
    mirrored.push_back(to_other_side(points, i));
    mirrored.back().only_removed = !is_near;
  }
}

namespace {

/// May a point of the phantom be drawn at a pixel? Points that face the camera hide all that is
/// behind them. Points that face away hide no point of the phantom that faces the camera, but a
/// limb of which only such points are known hides the body behind it; for this it has to be before
/// the body by more than the noise, unlike the back of a limb that lies on the body.
bool may_draw(const MirroredPoint& point, PixelKind kind, std::int32_t pixel, Limb affected,
              const PhantomImage& image) {
  constexpr float kClear = 0.02F;  // metres: a depth step of a Kinect V1
  const PixelKind there = image.kind[pixel];
  if (there == PixelKind::kNone) return true;
  const float before = barrier(pixel, affected, image) - point.z;
  if (kind == PixelKind::kPhantom) return before > 0.0F;
  return there == PixelKind::kBody ? before > kClear : there == kind && before > 0.0F;
}

}  // namespace

DrawnPhantom write_phantom(const std::vector<MirroredPoint>& mirrored, Limb affected,
                           const PixelProjector& projector, const PhantomImage& image) {
  PixelBounds bounds;
  std::int64_t num_outside = 0;
  const auto write = [&](const MirroredPoint& point, PixelKind kind) {
    const std::int32_t pixel = projector.pixel(point.x, point.y, point.z);
    num_outside += pixel < 0;
    if (pixel < 0 || !may_draw(point, kind, pixel, affected, image)) return;
    draw(point, pixel, kind, image);
    bounds.add(pixel % image.cols, pixel / image.cols);
  };
  for (const MirroredPoint& point : mirrored) {
    if (point.faces_camera) write(point, PixelKind::kPhantom);
  }
  for (const MirroredPoint& point : mirrored) {
    if (!point.faces_camera) write(point, PixelKind::kAway);
  }
  return {bounds.box(), num_outside};
}

PixelBox write_root(const std::vector<MirroredPoint>& mirrored, const PixelProjector& projector,
                    const PhantomImage& image) {
  PixelBounds bounds;
  for (const MirroredPoint& point : mirrored) {
    const std::int32_t pixel = projector.pixel(point.x, point.y, point.z);
    if (pixel < 0) continue;
    const PixelKind there = image.kind[pixel];
    const bool nearer = there == PixelKind::kRootFilled && point.z < image.depth[pixel];
    if (there != PixelKind::kNone && !nearer) continue;
    if (point.only_removed && image.removal[pixel] != Removal::kRemoved) continue;
    draw(point, pixel, PixelKind::kRootFilled, image);
    bounds.add(pixel % image.cols, pixel / image.cols);
  }
  return bounds.box();
}

namespace {

/// Draws the line between two mirrored points without its ends, where may_draw() allows it.
void draw_between(const MirroredPoint& a, const MirroredPoint& b, Limb affected,
                  const PixelProjector& projector, const PhantomImage& image, PixelBounds& bounds) {
  constexpr std::int64_t kReach = 6;  // pixels; wider gaps are parts that the camera did not see
  const std::int32_t from = projector.pixel(a.x, a.y, a.z), to = projector.pixel(b.x, b.y, b.z);
  if (from < 0 || to < 0) return;
  const std::int64_t steps = std::max(std::abs(from % image.cols - to % image.cols),
                                      std::abs(from / image.cols - to / image.cols));
  if (steps > kReach) return;
  for (std::int64_t k = 1; k < steps; ++k) {
    const float t = static_cast<float>(k) / static_cast<float>(steps);
    const auto mix = [t](float x, float y) { return x + t * (y - x); };
    MirroredPoint point = 2 * k <= steps ? a : b;
    point.x = mix(a.x, b.x), point.y = mix(a.y, b.y), point.z = mix(a.z, b.z);
    const std::int32_t pixel = projector.pixel(point.x, point.y, point.z);
    if (pixel < 0 || !may_draw(point, PixelKind::kBridged, pixel, affected, image)) continue;
    draw(point, pixel, PixelKind::kBridged, image);
    bounds.add(pixel % image.cols, pixel / image.cols);
  }
}

}  // namespace

PixelBox bridge_gaps(const std::vector<MirroredPoint>& mirrored, Limb affected,
                     const PixelProjector& projector, const PhantomImage& image,
                     std::vector<std::int32_t>& scratch) {
  // Stale entries of the scratch fail `mirrored[i].source == pixel`.
  for (std::size_t i = 0; i < mirrored.size(); ++i) {
    scratch[mirrored[i].source] = static_cast<std::int32_t>(i);
  }
  const auto of_source = [&](std::int64_t pixel) -> const MirroredPoint* {
    if (pixel >= image.rows * image.cols) return nullptr;
    const std::size_t i = scratch[pixel];
    return i < mirrored.size() && mirrored[i].source == pixel ? &mirrored[i] : nullptr;
  };
  PixelBounds bounds;
  for (const MirroredPoint& point : mirrored) {
    const bool last_column = (point.source + 1) % image.cols == 0;
    for (const std::int64_t step : {std::int64_t{1}, image.cols}) {
      const MirroredPoint* next =
          step == 1 && last_column ? nullptr : of_source(point.source + step);
      if (next == nullptr || next->faces_camera != point.faces_camera) continue;
      if (!(std::abs(next->source_depth - point.source_depth) < kSameSurface)) continue;
      draw_between(point, *next, affected, projector, image, bounds);
    }
  }
  return bounds.box();
}

namespace {

/// Two opposite neighbours of an empty pixel.
struct Pair {
  std::int64_t a, b;
  bool present;  ///< Both are drawn.
};

/// Source and label for a pixel between a pair; its pixel and depth are not set.
HoleFill filled_from(const Pair& pair, const PhantomImage& image) {
  // If only one of the two shows the phantom, the other's source is no part of the limb.
  const bool a_is = is_phantom(image.kind[pair.a]), b_is = is_phantom(image.kind[pair.b]);
  const std::int64_t a = a_is ? pair.a : pair.b, b = b_is ? pair.b : pair.a;
  const auto middle = [](std::int32_t x, std::int32_t y) { return (x + y + 1) / 2; };
  HoleFill fill{};
  fill.row = middle(image.source[2 * a], image.source[2 * b]);
  fill.col = middle(image.source[2 * a + 1], image.source[2 * b + 1]);
  fill.source_depth = 0.5F * (image.source_depth[a] + image.source_depth[b]);
  fill.label = image.label[a];
  return fill;
}

float mean_depth(const std::array<std::int64_t, 4>& pixels, const PhantomImage& image) {
  float sum = 0.0F, count = 0.0F;
  for (const std::int64_t pixel : pixels) {
    if (image.kind[pixel] == PixelKind::kNone) continue;
    sum += image.depth[pixel];
    count += 1.0F;
  }
  return sum / count;
}

}  // namespace

std::int64_t fill_holes(const PixelBox& box, const PixelRays& rays, const PhantomImage& image,
                        std::vector<HoleFill>& fills, PixelKind kind) {
  fills.clear();
  const std::int64_t u0 = std::max<std::int64_t>(box.u0, 1);
  const std::int64_t v0 = std::max<std::int64_t>(box.v0, 1);
  const std::int64_t u1 = std::min(box.u0 + box.width, image.cols - 1);
  const std::int64_t v1 = std::min(box.v0 + box.height, image.rows - 1);
  const auto is_there = [&](std::int64_t p) { return image.kind[p] != PixelKind::kNone; };
  const auto has_phantom = [&](const Pair& pair) {
    return pair.present && (is_phantom(image.kind[pair.a]) || is_phantom(image.kind[pair.b]));
  };
  const auto pair_around = [&](std::int64_t p, std::int64_t step) {
    return Pair{p - step, p + step, is_there(p - step) && is_there(p + step)};
  };
  // Neighbours within two pixels.
  const auto wider_pair = [&](std::int64_t p, std::int64_t step) {
    const std::int64_t a = is_there(p - step) ? p - step : p - 2 * step;
    const std::int64_t b = is_there(p + step) ? p + step : p + 2 * step;
    return Pair{a, b, is_there(a) && is_there(b)};
  };
  for (std::int64_t v = v0; v < v1; ++v) {
    for (std::int64_t u = u0; u < u1; ++u) {
      const std::int64_t p = v * image.cols + u;
      if (is_there(p) || !has_ray(rays, u, v)) continue;
      Pair beside = pair_around(p, 1), above = pair_around(p, image.cols);
      if (!has_phantom(beside) && !has_phantom(above)) {
        if (u < 2 || v < 2 || u + 2 >= image.cols || v + 2 >= image.rows) continue;
        beside = wider_pair(p, 1);
        if (!beside.present) continue;
        above = wider_pair(p, image.cols);
        if (!above.present || !(has_phantom(beside) || has_phantom(above))) continue;
      }
      HoleFill fill = filled_from(has_phantom(beside) ? beside : above, image);
      fill.pixel = static_cast<std::int32_t>(p);
      fill.depth = mean_depth({beside.a, beside.b, above.a, above.b}, image);
      fills.push_back(fill);
    }
  }
  for (const HoleFill& fill : fills) draw(fill, kind, image);
  return static_cast<std::int64_t>(fills.size());
}

void list_phantom(const PixelBox& box, const PhantomImage& image,
                  std::vector<std::int32_t>& pixels) {
  pixels.clear();
  for (std::int64_t v = box.v0; v < box.v0 + box.height; ++v) {
    for (std::int64_t u = box.u0; u < box.u0 + box.width; ++u) {
      const std::int64_t p = v * image.cols + u;
      if (is_phantom(image.kind[p])) pixels.push_back(static_cast<std::int32_t>(p));
    }
  }
}

PixelBox fill_remembered(const std::vector<std::int32_t>& before, const PixelRays& rays,
                         const PhantomImage& image, std::vector<HoleFill>& fills) {
  constexpr int kLeast = 3;  // of eight: a pixel beside a straight border has three
  fills.clear();
  PixelBounds bounds;
  for (const std::int32_t pixel : before) {
    const std::int64_t u = pixel % image.cols, v = pixel / image.cols;
    if (image.kind[pixel] != PixelKind::kNone || !has_ray(rays, u, v)) continue;
    if (u < 1 || v < 1 || u + 1 >= image.cols || v + 1 >= image.rows) continue;
    std::array<std::int64_t, 8> around{};
    std::size_t count = 0;
    float nearest = std::numeric_limits<float>::max();
    for (std::int64_t dv = -1; dv <= 1; ++dv) {
      for (std::int64_t du = -1; du <= 1; ++du) {
        const std::int64_t p = pixel + dv * image.cols + du;
        if (!is_phantom(image.kind[p])) continue;
        around[count++] = p;
        nearest = std::min(nearest, image.depth[p]);
      }
    }
    if (count < kLeast) continue;
    HoleFill fill{};
    float sum = 0.0F, used = 0.0F;
    for (std::size_t k = 0; k < count; ++k) {
      const std::int64_t p = around[k];
      if (!(image.depth[p] < nearest + kSameSurface)) continue;
      if (used == 0.0F) {
        fill.row = image.source[2 * p];
        fill.col = image.source[2 * p + 1];
        fill.source_depth = image.source_depth[p];
        fill.label = image.label[p];
      }
      sum += image.depth[p];
      used += 1.0F;
    }
    fill.pixel = pixel;
    fill.depth = sum / used;
    fills.push_back(fill);
    bounds.add(u, v);
  }
  for (const HoleFill& fill : fills) draw(fill, PixelKind::kFilled, image);
  return bounds.box();
}

}  // namespace manip3d
