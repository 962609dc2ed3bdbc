#include "manip3d/modify/clothing.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <optional>

#include "manip3d/modify/joint_smoother.hpp"
#include "manip3d/modify/key_person.hpp"
#include "modify/phantom_image.hpp"

namespace manip3d {
namespace {

constexpr int kSteps = 16;                   // samples along and across the trunk
constexpr int kMinSamples = 48;              // of 256; fewer may be of an arm or of an edge
constexpr float kHalfWidth = 0.11F;          // metres
constexpr float kLow = 0.2F, kHigh = 0.85F;  // shares of the spine's length from its base
// The front of a trunk lies between these distances, in metres, in front of and behind the spine.
// Arms are farther in front.
constexpr float kBefore = 0.22F, kBehind = 0.05F;

/// 0 up to `none`, 1 from `all` on, and linear between them.
float ramp(float value, float none, float all) {
  return std::clamp((value - none) / (all - none), 0.0F, 1.0F);
}

/// Hue as a number from 0 to kNumHues; `high` - `low` must not be 0.
float hue_of(float r, float g, float b, float high, float low) {
  constexpr auto kThird = static_cast<float>(kNumHues) / 3.0F;
  const float unit = kThird / (2.0F * (high - low));
  float hue = 2.0F * kThird + (r - g) * unit;  // if blue is the largest
  if (high == r) {
    hue = (g - b) * unit;
  } else if (high == g) {
    hue = kThird + (b - r) * unit;
  }
  return hue < 0.0F ? hue + static_cast<float>(kNumHues) : hue;
}

void add_color(const std::uint8_t* rgb, ClothingColors& colors) {
  const float r = rgb[0], g = rgb[1], b = rgb[2];
  const float high = std::max({r, g, b}), low = std::min({r, g, b});
  const float saturation = high > 0.0F ? (high - low) / high : 0.0F;
  const float hued = ramp(saturation, 0.15F, 0.35F) * ramp(high, 25.0F, 60.0F);
  if (hued > 0.0F) {
    const float hue = hue_of(r, g, b, high, low);
    const auto first = static_cast<std::size_t>(hue);
    const float second_share = hue - static_cast<float>(first);
    colors.shares[first % kNumHues] += hued * (1.0F - second_share);
    colors.shares[(first + 1) % kNumHues] += hued * second_share;
  }
  constexpr float kBlack = 40.0F, kGrey = 120.0F, kWhite = 200.0F;
  const float shade = ramp(high, kBlack, kGrey) + ramp(high, kGrey, kWhite);  // 0 to 2
  const std::size_t darker = shade < 1.0F ? 0 : 1;
  const float lighter_share = shade - static_cast<float>(darker);
  colors.shares[kNumHues + darker] += (1.0F - hued) * (1.0F - lighter_share);
  colors.shares[kNumHues + darker + 1] += (1.0F - hued) * lighter_share;
}

/// R, G, B of the colour image at a point of a depth pixel; null outside the image.
const std::uint8_t* color_at(const ColoredScene& scene, std::int32_t pixel,
                             const Eigen::Vector3d& point) {
  if (scene.registration == nullptr) return scene.color.pixels + std::int64_t{3} * pixel;
  const Registration& to_color = *scene.registration;
  const Eigen::Vector2d at =
      project(to_color.color, to_color.rotation * point + to_color.translation);
  const double column = std::round(at.x()), row = std::round(at.y());
  const bool inside = column >= 0.0 && row >= 0.0 &&
                      column < static_cast<double>(scene.color.cols) &&
                      row < static_cast<double>(scene.color.rows);
  if (!inside) return nullptr;
  const auto u = static_cast<std::int64_t>(column), v = static_cast<std::int64_t>(row);
  return scene.color.pixels + 3 * (v * scene.color.cols + u);
}

}  // namespace

bool ClothingColors::is_known() const {
  return std::ranges::any_of(shares, [](float share) { return share > 0.0F; });
}

double difference(const ClothingColors& a, const ClothingColors& b) {
  if (!a.is_known() || !b.is_known()) return 0.0;
  double alike = 0.0;
  for (std::size_t i = 0; i < a.shares.size(); ++i) {
    alike += std::sqrt(static_cast<double>(a.shares[i]) * static_cast<double>(b.shares[i]));
  }
  return std::sqrt(std::max(0.0, 1.0 - alike));
}

ClothingColors clothing_colors(const Skeleton& person, const ColoredScene& scene) {
  ClothingColors colors;
  const auto base = spine_base(person);
  if (!base || scene.color.pixels == nullptr) return colors;
  if (!is_usable(person, Joint::kSpineShoulder)) return colors;
  const Eigen::Vector3f spine = person[Joint::kSpineShoulder] - *base;
  const Eigen::Vector3f across = spine.cross(Eigen::Vector3f::UnitZ()).normalized();
  if (!(across.norm() > 0.5F)) return colors;  // the spine points to the camera
  const PixelProjector projector(*scene.camera, *scene.rays);
  int count = 0;
  for (int i = 0; i < kSteps; ++i) {
    const float up = kLow + (kHigh - kLow) * (static_cast<float>(i) + 0.5F) / kSteps;
    for (int j = 0; j < kSteps; ++j) {
      const float aside = kHalfWidth * ((2.0F * static_cast<float>(j) + 1.0F) / kSteps - 1.0F);
      const Eigen::Vector3f p = *base + up * spine + aside * across;
      const std::int32_t pixel = projector.pixel(p.x(), p.y(), p.z());
      if (pixel < 0) continue;
      const float z = scene.depth.at(pixel);
      if (!(z > p.z() - kBefore && z < p.z() + kBehind)) continue;
      const bool has_index = scene.body_index != nullptr && person.body != kNoBody;
      if (has_index && scene.body_index[pixel] != person.body) continue;
      const auto* rgb = color_at(scene, pixel, (p * (z / p.z())).cast<double>());
      if (rgb == nullptr) continue;
      add_color(rgb, colors);
      ++count;
    }
  }
  if (count < kMinSamples) return {};
  for (float& share : colors.shares) share /= static_cast<float>(count);
  return colors;
}

}  // namespace manip3d
