#include "manip3d/simplify/edge_steps.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <string>

#include "manip3d/error.hpp"

namespace manip3d {
namespace {

class StepFinder {
 public:
  StepFinder(const DepthView& image, const EdgeStepRule& rule) : image_(image), rule_(rule) {}

  /// Whether the line between two pixels crosses a step. Both pixels must be in the image.
  [[nodiscard]] bool crosses(const std::array<std::int32_t, 2>& from,
                             const std::array<std::int32_t, 2>& to) const {
    const std::int64_t du = to[0] - from[0], dv = to[1] - from[1];
    const std::int64_t length = std::max(std::abs(du), std::abs(dv));
    const float begin = depth(from[0], from[1]), last = depth(to[0], to[1]);
    // If an end has no measurement, it gets the depth of the last measured pixel before it.
    if (last > 0.0F && !differ(begin, last)) return false;
    bool any = false;
    float before = begin, climbed = 0.0F;
    for (std::int64_t way = 1; way <= length; ++way) {
      const float z = depth(from[0] + along(way, du, length), from[1] + along(way, dv, length));
      if (!(z > 0.0F)) continue;
      if (differ(before, z)) {
        any = true;
        climbed += z - before;
      }
      before = z;
    }
    return any && differ(begin, before) &&
           (!rule_.passing || std::abs(climbed) > 0.5F * std::abs(before - begin));
  }

 private:
  [[nodiscard]] float depth(std::int64_t u, std::int64_t v) const {
    return image_.metres[v * image_.cols + u];
  }
  [[nodiscard]] bool differ(float one, float other) const {
    const double nearest = std::min(one, other);
    const double limit = nearest * std::max(rule_.share, rule_.slope + rule_.noise * nearest);
    return one > 0.0F && double{std::abs(one - other)} > limit;
  }
  /// Pixels from the start of a line after `way` of `length` steps, rounded to the nearest integer,
  /// halves up.
  static std::int64_t along(std::int64_t way, std::int64_t delta, std::int64_t length) {
    const std::int64_t doubled = 2 * way * delta + length, step = 2 * length;
    return doubled / step - (doubled % step < 0 ? 1 : 0);
  }

  const DepthView& image_;
  const EdgeStepRule& rule_;
};

}  // namespace

std::vector<std::uint8_t> faces_across_steps(const DepthView& image,
                                             const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                                             const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
                                             const EdgeStepRule& rule) {
  for (Eigen::Index i = 0; i < pixels.rows(); ++i) {
    const std::int32_t u = pixels(i, 0), v = pixels(i, 1);
    if (u < 0 || v < 0 || u >= image.cols || v >= image.rows) {
      throw InputError("pixels: expected pixels of the image, got (" + std::to_string(u) + ", " +
                       std::to_string(v) + ")");
    }
  }
  const StepFinder steps(image, rule);
  std::vector<std::uint8_t> across(faces.rows(), 0);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int i = 0; i < 3; ++i) {
      const std::int32_t a = faces(f, i), b = faces(f, (i + 1) % 3);
      if (a < 0 || a >= pixels.rows()) {
        throw InputError("faces: index out of range: " + std::to_string(a));
      }
      if (b < 0 || b >= pixels.rows() || across[f] != 0) continue;
      // Starts at the vertex with the lower index, so that both faces at an edge test the same
      // line.
      const std::int32_t from = std::min(a, b), to = std::max(a, b);
      across[f] =
          steps.crosses({pixels(from, 0), pixels(from, 1)}, {pixels(to, 0), pixels(to, 1)}) ? 1 : 0;
    }
  }
  return across;
}

}  // namespace manip3d
