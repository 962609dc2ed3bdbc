#include "manip3d/forge/composite.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "geometry/lens.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/depth_step.hpp"
#include "manip3d/geometry/range_image.hpp"

namespace manip3d {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

/// A vertex in an image: pixel coordinates and depth; NaN if it is behind the camera.
struct Drawn {
  float u = kNan, v = kNan, z = kNan;
};

/// project() in single precision for cameras without distortion, after a rigid motion.
class Projector {
 public:
  explicit Projector(const Intrinsics& camera)
      : Projector(camera, Eigen::Matrix3d::Identity(), Eigen::Vector3d::Zero()) {}
  explicit Projector(const Registration& r) : Projector(r.color, r.rotation, r.translation) {}

  [[nodiscard]] Drawn operator()(const float* vertex) const {
    const Eigen::Vector3f p = rotation_ * Eigen::Map<const Eigen::Vector3f>(vertex) + translation_;
    constexpr float kNearest = 0.01F;  // metres; nearer, a pixel is no place any more
    if (!(p.z() > kNearest)) return {};
    if (distorted_) {
      const Eigen::Vector2d at = project(camera_, p.cast<double>());
      return {static_cast<float>(at.x()), static_cast<float>(at.y()), p.z()};
    }
    return {fx_ * p.x() / p.z() + cx_, fy_ * p.y() / p.z() + cy_, p.z()};
  }

 private:
  Projector(const Intrinsics& camera, const Eigen::Matrix3d& r, const Eigen::Vector3d& t)
      : camera_(camera), rotation_(r.cast<float>()), translation_(t.cast<float>()) {
    distorted_ = is_distorted(camera);
    fx_ = static_cast<float>(camera.mirrored ? -camera.fx : camera.fx);
    fy_ = static_cast<float>(camera.fy);
    cx_ = static_cast<float>(camera.cx);
    cy_ = static_cast<float>(camera.cy);
  }

  Intrinsics camera_;
  Eigen::Matrix3f rotation_;
  Eigen::Vector3f translation_;
  bool distorted_ = false;
  float fx_, fy_, cx_, cy_;
};

/// Calls `use(u, v, a, b, c)` with the barycentric coordinates of each pixel centre within a
/// triangle, its edges included.
template <typename Use>
void rasterize(const Drawn& a, const Drawn& b, const Drawn& c, std::int64_t rows, std::int64_t cols,
               const Use& use) {
  const float least_u = std::min({a.u, b.u, c.u}), most_u = std::max({a.u, b.u, c.u});
  const float least_v = std::min({a.v, b.v, c.v}), most_v = std::max({a.v, b.v, c.v});
  const auto right = static_cast<float>(cols - 1), bottom = static_cast<float>(rows - 1);
  // Fails on NaN: a corner is behind the camera.
  if (!(most_u >= 0.0F && least_u <= right && most_v >= 0.0F && least_v <= bottom)) return;
  const auto first = [](float least) {  // std::ceil is a call where there is no SSE 4.1
    const auto whole = static_cast<std::int32_t>(std::max(least, 0.0F));
    return whole + (static_cast<float>(whole) < least ? 1 : 0);
  };
  const std::int32_t u0 = first(least_u), v0 = first(least_v);
  const auto u1 = static_cast<std::int32_t>(std::min(most_u, right));
  const auto v1 = static_cast<std::int32_t>(std::min(most_v, bottom));
  if (u0 > u1 || v0 > v1) return;
  const float bu = b.u - a.u, bv = b.v - a.v, cu = c.u - a.u, cv = c.v - a.v;
  const float area = bu * cv - bv * cu;
  if (area == 0.0F || !(std::abs(area) < kInfinity)) return;
  // Barycentric coordinates are linear in the image.
  const float scale = 1.0F / area;
  const float b_du = cv * scale, b_dv = -cu * scale;
  const float c_du = -bv * scale, c_dv = bu * scale;
  constexpr float kEdge = -1e-4F;  // neighbours share their edge whatever rounding says
  for (std::int32_t v = v0; v <= v1; ++v) {
    const float pv = static_cast<float>(v) - a.v;
    const float wb0 = pv * b_dv, wc0 = pv * c_dv;
    for (std::int32_t u = u0; u <= u1; ++u) {
      const float pu = static_cast<float>(u) - a.u;
      const float wb = wb0 + pu * b_du, wc = wc0 + pu * c_du;
      const float wa = 1.0F - wb - wc;
      if (std::min(wa, std::min(wb, wc)) < kEdge) continue;
      use(u, v, wa, wb, wc);
    }
  }
}

/// Where something is drawn in an image, and how far it is.
struct DepthBuffer {
  std::int64_t rows, cols;
  std::vector<float> z;

  DepthBuffer(std::int64_t num_rows, std::int64_t num_cols)
      : rows(num_rows), cols(num_cols), z(static_cast<std::size_t>(rows * cols), kInfinity) {}

  bool nearer(std::int64_t pixel, float depth) {
    if (!(depth < z[pixel])) return false;
    z[pixel] = depth;
    return true;
  }
  /// The pixel of a place, or -1.
  [[nodiscard]] std::int64_t pixel_at(float u, float v) const {
    if (!(u > -0.5F && v > -0.5F && u < static_cast<float>(cols) - 0.5F &&
          v < static_cast<float>(rows) - 0.5F)) {
      return -1;
    }
    return static_cast<std::int64_t>(v + 0.5F) * cols + static_cast<std::int64_t>(u + 0.5F);
  }
};

bool is_hidden(const SceneView& scene, std::int64_t pixel, float z) {
  const std::uint16_t behind = scene.depth[pixel];
  return behind != 0 && static_cast<float>(behind) < 1000.0F * z;
}

void fill_pinholes(DepthBuffer& image, std::vector<std::int64_t>& filled, float focal) {
  const DepthStep step({}, focal);
  const auto between = [&](std::int64_t one, std::int64_t other) {
    const auto [near, far] = std::minmax(image.z[one], image.z[other]);
    return far < kInfinity && step.connects(near, far) ? 0.5F * (near + far) : kInfinity;
  };
  const std::size_t begin = filled.size();
  std::vector<float> values;
  for (std::int64_t v = 0; v < image.rows; ++v) {
    for (std::int64_t u = 0; u < image.cols; ++u) {
      const std::int64_t p = v * image.cols + u;
      if (image.z[p] < kInfinity) continue;
      const float along = u > 0 && u + 1 < image.cols ? between(p - 1, p + 1) : kInfinity;
      const float down =
          v > 0 && v + 1 < image.rows ? between(p - image.cols, p + image.cols) : kInfinity;
      const float z = std::min(along, down);
      if (z < kInfinity) {
        filled.push_back(p);
        values.push_back(z);
      }
    }
  }
  for (std::size_t i = 0; i < values.size(); ++i) image.z[filled[begin + i]] = values[i];
}

/// The person alone as the depth camera sees them.
DepthBuffer draw_depth(const PersonSurface& person, const SceneView& scene,
                       const std::vector<Drawn>& at, const CompositeOptions& options,
                       std::vector<std::int64_t>& filled) {
  DepthBuffer image(scene.rows, scene.cols);
  if (options.surface == CompositeSurface::kPoints || person.in_place) {
    for (const Drawn& vertex : at) {
      const std::int64_t pixel = image.pixel_at(vertex.u, vertex.v);
      if (pixel >= 0) image.nearer(pixel, vertex.z);
    }
    if (options.fill_pinholes && !person.in_place) {
      // Twice: where a row and a column without points cross, the first time fills the neighbours.
      for (int pass = 0; pass < 2; ++pass) {
        fill_pinholes(image, filled, static_cast<float>(scene.camera.fx));
      }
    }
    return image;
  }
  for (std::int64_t f = 0; f < person.num_faces; ++f) {
    const std::int32_t* face = person.faces + 3 * f;
    const Drawn &a = at[face[0]], &b = at[face[1]], &c = at[face[2]];
    const float ia = 1.0F / a.z, ib = 1.0F / b.z, ic = 1.0F / c.z;  // linear in the image
    rasterize(a, b, c, scene.rows, scene.cols,
              [&](std::int32_t u, std::int32_t v, float wa, float wb, float wc) {
                image.nearer(v * scene.cols + u, 1.0F / (wa * ia + wb * ib + wc * ic));
              });
  }
  return image;
}

/// Depth and truth: the scene, and the person where nothing of it is nearer.
/// @param box  All that is drawn lies in it.
void put_before(const DepthBuffer& person, const SceneView& scene, const PixelBox& box,
                const CompositeBuffers& out) {
  constexpr float kFarthest = 65.535F;
  std::copy_n(scene.depth, scene.rows * scene.cols, out.depth);
  std::fill_n(out.mask, scene.rows * scene.cols, std::uint8_t{0});
  for (std::int64_t v = box.v0; v < box.v0 + box.height; ++v) {
    for (std::int64_t u = box.u0; u < box.u0 + box.width; ++u) {
      const std::int64_t i = v * scene.cols + u;
      const float z = person.z[i];
      if (!(z <= kFarthest) || is_hidden(scene, i, z)) continue;
      out.mask[i] = 1;
      out.depth[i] = static_cast<std::uint16_t>(1000.0F * z + 0.5F);
    }
  }
}

using Rgb = std::array<std::uint8_t, 3>;

/// The colour between four pixels; those beyond the image are its edge's.
inline Rgb sample(const ColorView& image, float u, float v) {
  const float x = std::clamp(u, 0.0F, static_cast<float>(image.cols - 1));
  const float y = std::clamp(v, 0.0F, static_cast<float>(image.rows - 1));
  const auto u0 = static_cast<std::int32_t>(x), v0 = static_cast<std::int32_t>(y);
  const std::int64_t right = u0 + 1 < image.cols ? 3 : 0;
  const std::int64_t below = v0 + 1 < image.rows ? 3 * image.cols : 0;
  // Weights in 1/256, so that sums are whole numbers.
  const auto fu = static_cast<std::uint32_t>((x - static_cast<float>(u0)) * 256.0F + 0.5F);
  const auto fv = static_cast<std::uint32_t>((y - static_cast<float>(v0)) * 256.0F + 0.5F);
  const std::uint8_t* top = image.pixels + 3 * (v0 * image.cols + u0);
  const std::uint8_t* bottom = top + below;
  // Red and blue are blended at once, in the two halves of a word.
  const auto red_blue = [](const std::uint8_t* p) { return p[0] | std::uint64_t{p[2]} << 32; };
  const auto blend = [&](std::uint64_t p, std::uint64_t p_right, std::uint64_t q,
                         std::uint64_t q_right, std::uint64_t half) {
    const std::uint64_t above = (256 - fu) * p + fu * p_right;
    const std::uint64_t under = (256 - fu) * q + fu * q_right;
    return ((256 - fv) * above + fv * under + half) >> 16;
  };
  const std::uint64_t rb = blend(red_blue(top), red_blue(top + right), red_blue(bottom),
                                 red_blue(bottom + right), 0x0000'8000'0000'8000);
  const std::uint64_t g = blend(top[1], top[right + 1], bottom[1], bottom[right + 1], 0x8000);
  return {static_cast<std::uint8_t>(rb), static_cast<std::uint8_t>(g),
          static_cast<std::uint8_t>(rb >> 32)};
}

/// The colours of a person whose edges may fade, within a box of the image.
class ColorPainter {
 public:
  ColorPainter(const SceneView& scene, const PixelBox& box, std::uint8_t* out)
      : scene_(scene.color),
        box_(box),
        out_(out),
        covered_(static_cast<std::size_t>(box.width * box.height), 0) {
    std::copy_n(scene_.pixels, 3 * scene_.rows * scene_.cols, out_);
  }

  /// @param u, v  In the box.
  void paint(std::int64_t u, std::int64_t v, const Rgb& rgb) {
    covered_[v * box_.width + u] = 1;
    std::copy_n(rgb.begin(), 3, out_ + 3 * in_image(u, v));
  }
  [[nodiscard]] const std::uint8_t* painted(std::int64_t u, std::int64_t v) const {
    return out_ + 3 * in_image(u, v);
  }

  /// The person's share of a pixel is that of the square of side 2 radius + 1 around it.
  void fade(int radius) {
    if (radius == 0) return;
    const std::int64_t cols = box_.width, rows = box_.height, size = 2 * radius + 1;
    // The covered pixels of each column in the rows around, with `radius` empty columns on each
    // side.
    std::vector<std::int32_t> padded(static_cast<std::size_t>(cols + 2 * radius), 0);
    std::int32_t* column = padded.data() + radius;
    for (std::int64_t v = 0; v < std::min<std::int64_t>(radius, rows); ++v) add_row(v, 1, column);
    for (std::int64_t v = 0; v < rows; ++v) {
      if (v + radius < rows) add_row(v + radius, 1, column);
      if (v - radius - 1 >= 0) add_row(v - radius - 1, -1, column);
      const std::uint8_t* covered = covered_.data() + v * cols;
      const std::int64_t first = std::find(covered, covered + cols, 1) - covered;
      std::int64_t end = cols;
      while (end > first && covered[end - 1] == 0) --end;
      std::int32_t sum = 0;
      for (std::int64_t u = first - radius; u < first + radius && first < end; ++u)
        sum += column[u];
      for (std::int64_t u = first; u < end; ++u) {
        sum += column[u + radius];
        if (covered[u] != 0 && sum < size * size) {
          mix(in_image(u, v), sum, static_cast<std::int32_t>(size * size));
        }
        sum -= column[u - radius];
      }
    }
  }

 private:
  [[nodiscard]] std::int64_t in_image(std::int64_t u, std::int64_t v) const {
    return (box_.v0 + v) * scene_.cols + box_.u0 + u;
  }
  void add_row(std::int64_t v, std::int32_t sign, std::int32_t* column) const {
    const std::uint8_t* row = covered_.data() + v * box_.width;
    for (std::int64_t u = 0; u < box_.width; ++u) column[u] += sign * row[u];
  }
  void mix(std::int64_t pixel, std::int32_t own, std::int32_t whole) {
    for (std::int64_t k = 3 * pixel; k < 3 * pixel + 3; ++k) {
      const std::int32_t sum = own * out_[k] + (whole - own) * scene_.pixels[k];
      out_[k] = static_cast<std::uint8_t>((sum + whole / 2) / whole);
    }
  }

  ColorView scene_;
  PixelBox box_;
  std::uint8_t* out_;
  std::vector<std::uint8_t> covered_;
};

/// The pixels of an image in which the vertices lie.
PixelBox box_around(const std::vector<Drawn>& at, std::int64_t cols, std::int64_t rows) {
  float u0 = kInfinity, v0 = kInfinity, u1 = -kInfinity, v1 = -kInfinity;
  for (const Drawn& d : at) {
    if (!(std::abs(d.u) + std::abs(d.v) < kInfinity)) continue;
    u0 = std::min(u0, d.u);
    u1 = std::max(u1, d.u);
    v0 = std::min(v0, d.v);
    v1 = std::max(v1, d.v);
  }
  const auto pixel = [](float value, std::int64_t size) {
    return static_cast<std::int64_t>(std::clamp(value, 0.0F, static_cast<float>(size)));
  };
  if (!(u0 <= u1)) return {};
  const std::int64_t left = pixel(u0, cols), top = pixel(v0, rows);
  return {left, top, pixel(u1 + 2.0F, cols) - left, pixel(v1 + 2.0F, rows) - top};
}

/// Where each vertex's colour is in the image of the person's frame.
std::vector<Drawn> texels_of(const PersonSurface& person) {
  std::vector<Drawn> texels(static_cast<std::size_t>(person.num_vertices));
  std::optional<Projector> projector;
  if (person.registration) projector.emplace(*person.registration);
  for (std::size_t i = 0; i < texels.size(); ++i) {
    if (projector) {
      texels[i] = (*projector)(person.seen + 3 * i);
    } else {
      texels[i] = {static_cast<float>(person.pixels[2 * i]),
                   static_cast<float>(person.pixels[2 * i + 1]), 1.0F};
    }
  }
  return texels;
}

/// Triangles of the person in a box of the scene's colour image.
void paint_faces(const PersonSurface& person, const SceneView& scene, const std::vector<Drawn>& at,
                 const std::vector<Drawn>& in_depth, const PixelBox& box, ColorPainter& painter) {
  const std::vector<Drawn> texels = texels_of(person);
  std::vector<std::uint8_t> shown(in_depth.size(), 1);
  for (std::size_t i = 0; i < in_depth.size(); ++i) {
    const Drawn& d = in_depth[i];
    const bool inside = d.u > -0.5F && d.v > -0.5F && d.u < static_cast<float>(scene.cols) - 0.5F &&
                        d.v < static_cast<float>(scene.rows) - 0.5F;
    if (!inside) continue;
    const auto pixel =
        static_cast<std::int64_t>(d.v + 0.5F) * scene.cols + static_cast<std::int64_t>(d.u + 0.5F);
    shown[i] = is_hidden(scene, pixel, d.z) ? 0 : 1;
  }
  DepthBuffer image(box.height, box.width);
  for (std::int64_t f = 0; f < person.num_faces; ++f) {
    const std::int32_t i = person.faces[3 * f], j = person.faces[3 * f + 1],
                       k = person.faces[3 * f + 2];
    const int num_shown = shown[i] + shown[j] + shown[k];
    if (num_shown == 0) continue;
    const auto in_box = [&](const Drawn& d) {
      return Drawn{d.u - static_cast<float>(box.u0), d.v - static_cast<float>(box.v0), d.z};
    };
    const Drawn a = in_box(at[i]), b = in_box(at[j]), c = in_box(at[k]);
    const Drawn &ta = texels[i], &tb = texels[j], &tc = texels[k];
    rasterize(a, b, c, image.rows, image.cols,
              [&](std::int32_t pu, std::int32_t pv, float wa, float wb, float wc) {
                if (num_shown < 3) {
                  const float share = wa * static_cast<float>(shown[i]) +
                                      wb * static_cast<float>(shown[j]) +
                                      wc * static_cast<float>(shown[k]);
                  if (share < 0.5F) return;
                }
                // A triangle is a few pixels: depth and texture are linear within it.
                const float u = wa * ta.u + wb * tb.u + wc * tc.u;
                const float v = wa * ta.v + wb * tb.v + wc * tc.v;
                if (!(std::abs(u) + std::abs(v) < kInfinity)) return;
                if (image.nearer(pv * box.width + pu, wa * a.z + wb * b.z + wc * c.z)) {
                  painter.paint(pu, pv, sample(person.color, u, v));
                }
              });
  }
}

/// One colour for each vertex's pixel; pinholes get the mean of the neighbours that have one.
void paint_points(const PersonSurface& person, const SceneView& scene, const std::vector<Drawn>& at,
                  const std::vector<std::int64_t>& filled, const std::uint8_t* mask,
                  ColorPainter& painter) {
  const std::vector<Drawn> texels = texels_of(person);
  DepthBuffer image(scene.rows, scene.cols);
  for (std::size_t i = 0; i < at.size(); ++i) {
    const std::int64_t pixel = image.pixel_at(at[i].u, at[i].v);
    if (pixel < 0 || mask[pixel] == 0 || !image.nearer(pixel, at[i].z)) continue;
    if (!(std::abs(texels[i].u) + std::abs(texels[i].v) < kInfinity)) continue;
    painter.paint(pixel % scene.cols, pixel / scene.cols,
                  sample(person.color, texels[i].u, texels[i].v));
  }
  for (const std::int64_t pixel : filled) {
    if (mask[pixel] == 0) continue;
    std::array<std::int32_t, 3> sum{};
    std::int32_t count = 0;
    const std::int64_t u = pixel % scene.cols, v = pixel / scene.cols;
    const auto add = [&](std::int64_t next_u, std::int64_t next_v) {
      if (!(image.z[next_v * scene.cols + next_u] < kInfinity)) return;
      for (std::size_t k = 0; k < 3; ++k) sum[k] += painter.painted(next_u, next_v)[k];
      ++count;
    };
    if (u > 0) add(u - 1, v);
    if (v > 0) add(u, v - 1);
    if (u + 1 < scene.cols) add(u + 1, v);
    if (v + 1 < scene.rows) add(u, v + 1);
    if (count == 0) continue;
    Rgb rgb;
    for (std::size_t k = 0; k < 3; ++k) rgb[k] = static_cast<std::uint8_t>(sum[k] / count);
    painter.paint(u, v, rgb);
    image.z[pixel] = 0.0F;  // has a colour now, for those that are filled after it
  }
}

void check(const PersonSurface& person, const SceneView& scene, const CompositeOptions& options) {
  check_intrinsics(scene.camera, "camera");
  if (scene.rows != scene.camera.height || scene.cols != scene.camera.width) {
    throw InputError("scene.depth: expected the shape that the camera says");
  }
  if (options.blend < 0 || options.blend > 64) {
    throw InputError("blend: expected 0 to 64, got " + std::to_string(options.blend));
  }
  for (std::int64_t i = 0; i < 3 * person.num_faces; ++i) {
    if (person.faces[i] < 0 || person.faces[i] >= person.num_vertices) {
      throw InputError("faces: expected 0 to " + std::to_string(person.num_vertices - 1) +
                       ", got " + std::to_string(person.faces[i]));
    }
  }
  if (scene.color.pixels != nullptr && person.color.pixels == nullptr) {
    throw InputError("person.color: expected an image, as the scene has one; got none");
  }
  const Intrinsics& lens = scene.registration ? scene.registration->color : scene.camera;
  if (scene.color.pixels != nullptr &&
      (scene.color.rows != lens.height || scene.color.cols != lens.width)) {
    throw InputError("scene.color: expected the shape that the colour camera says");
  }
}

}  // namespace

void composite(const PersonSurface& person, const SceneView& scene, const CompositeOptions& options,
               const CompositeBuffers& out) {
  check(person, scene, options);
  std::vector<Drawn> at(static_cast<std::size_t>(person.num_vertices));
  const Projector depth_camera(scene.camera);
  for (std::size_t i = 0; i < at.size(); ++i) {
    at[i] = depth_camera(person.vertices + 3 * i);
    if (person.in_place) {
      at[i].u = static_cast<float>(person.pixels[2 * i]);
      at[i].v = static_cast<float>(person.pixels[2 * i + 1]);
    }
  }
  std::vector<std::int64_t> filled;
  const DepthBuffer drawn = draw_depth(person, scene, at, options, filled);
  put_before(drawn, scene, box_around(at, scene.cols, scene.rows), out);
  if (scene.color.pixels == nullptr || out.color == nullptr) return;
  const PixelBox whole{0, 0, scene.color.cols, scene.color.rows};
  if (options.surface == CompositeSurface::kPoints && !scene.registration) {
    ColorPainter painter(scene, whole, out.color);
    paint_points(person, scene, at, filled, out.mask, painter);
    painter.fade(options.blend);
    return;
  }
  std::vector<Drawn> in_color(at);
  if (scene.registration) {
    const Projector camera(*scene.registration);
    for (std::size_t i = 0; i < at.size(); ++i) in_color[i] = camera(person.vertices + 3 * i);
  }
  const PixelBox box = box_around(in_color, scene.color.cols, scene.color.rows);
  ColorPainter painter(scene, box, out.color);
  if (!box.empty()) paint_faces(person, scene, in_color, at, box, painter);
  painter.fade(options.blend);
}

}  // namespace manip3d
