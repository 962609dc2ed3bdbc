#include "manip3d/forge/composite.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "forge/texture_sampler.hpp"
#include "forge/triangle_pixels.hpp"
#include "geometry/buckets.hpp"
#include "geometry/constants.hpp"
#include "geometry/lanes.hpp"
#include "geometry/lens.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/depth_step.hpp"
#include "manip3d/geometry/range_image.hpp"

namespace manip3d {
namespace {

/// Projects points into an image after a rigid motion, in single precision; distorted cameras use
/// project().
class Projector {
 public:
  explicit Projector(const Intrinsics& camera)
      : Projector(camera, Eigen::Matrix3d::Identity(), Eigen::Vector3d::Zero()) {}
  explicit Projector(const Registration& r) : Projector(r.color, r.rotation, r.translation) {}

  /// @param vertices  (n, 3)
  [[nodiscard]] std::vector<Drawn> operator()(const float* vertices, std::int64_t count) const {
    std::vector<Drawn> at(count);
    std::int64_t i = 0;
    for (; i + 4 <= count; i += 4) draw4(vertices + 3 * i, &at[i]);
    if (i < count) {
      std::array<float, 12> last{};
      std::array<Drawn, 4> drawn;
      std::copy(vertices + 3 * i, vertices + 3 * count, last.begin());
      draw4(last.data(), drawn.data());
      std::copy_n(drawn.begin(), count - i, at.begin() + i);
    }
    return at;
  }

 private:
  void draw4(const float* v, Drawn* at) const {
    const Float4 x{v[0], v[3], v[6], v[9]}, y{v[1], v[4], v[7], v[10]}, z{v[2], v[5], v[8], v[11]};
    const auto moved = [&](int row) {
      const Eigen::RowVector3f r = rotation_.row(row);
      return r[0] * x + (r[1] * y + r[2] * z) + translation_[row];
    };
    const Float4 px = moved(0), py = moved(1), pz = moved(2);
    constexpr float kNearest = 0.01F;  // metres; nearer, a pixel does not determine a place
    const unsigned is_before = true_lanes(pz > kNearest);
    const Float4 us = fx_ * px / pz + cx_, vs = fy_ * py / pz + cy_;
    for (int i = 0; i < 4; ++i) {
      if ((is_before >> i & 1U) == 0) continue;
      at[i] = {us[i], vs[i], pz[i]};
      if (!distorted_) continue;
      const Eigen::Vector2d place = project(camera_, Eigen::Vector3d(px[i], py[i], pz[i]));
      at[i].u = static_cast<float>(place.x());
      at[i].v = static_cast<float>(place.y());
    }
  }

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

/// Depth buffer of a box of an image.
struct DepthBuffer {
  PixelBox box;
  /// Depths in the box, and 3 more, so that four can be read from each place.
  std::vector<float> z;

  DepthBuffer() = default;
  explicit DepthBuffer(const PixelBox& where) { clear(where); }

  void clear(const PixelBox& where) {
    box = where;
    z.assign(box.width * box.height + 3, kInfinityF);
  }

  [[nodiscard]] std::int64_t index(std::int64_t u, std::int64_t v) const {
    return (v - box.v0) * box.width + u - box.u0;
  }
  bool nearer(std::int64_t i, float depth) {
    if (!(depth < z[i])) return false;
    z[i] = depth;
    return true;
  }
  /// Stores the depths of those of four pixels that are inside a triangle and nearer than the
  /// stored ones. Returns which these are.
  Int4 nearer(std::int64_t i, Int4 inside, Float4 depths) {
    const Float4 before = load4(&z[i]);
    const Int4 is_nearer = inside & (depths < before);
    store4(&z[i], is_nearer ? depths : before);
    return is_nearer;
  }
};

bool is_hidden(const SceneView& scene, std::int64_t pixel, float z) {
  const std::uint16_t behind = scene.depth[pixel];
  return behind != 0 && static_cast<float>(behind) < 1000.0F * z;
}

/// Fills gaps of one pixel between two pixels of one surface, with their mean depth.
/// @param image  depth buffer of the size of the scene's image
void fill_pinholes(DepthBuffer& image, std::vector<std::int64_t>& filled, float focal) {
  const DepthStep step({}, focal);
  const std::int64_t rows = image.box.height, cols = image.box.width;
  const auto between = [&](std::int64_t one, std::int64_t other) {
    const auto [near, far] = std::minmax(image.z[one], image.z[other]);
    return far < kInfinityF && step.connects(near, far) ? 0.5F * (near + far) : kInfinityF;
  };
  const std::size_t begin = filled.size();
  std::vector<float> values;
  for (std::int64_t v = 0; v < rows; ++v) {
    for (std::int64_t u = 0; u < cols; ++u) {
      const std::int64_t p = v * cols + u;
      if (image.z[p] < kInfinityF) continue;
      const float along = u > 0 && u + 1 < cols ? between(p - 1, p + 1) : kInfinityF;
      const float down = v > 0 && v + 1 < rows ? between(p - cols, p + cols) : kInfinityF;
      const float z = std::min(along, down);
      if (z < kInfinityF) {
        filled.push_back(p);
        values.push_back(z);
      }
    }
  }
  for (std::size_t i = 0; i < values.size(); ++i) image.z[filled[begin + i]] = values[i];
}

/// The index of the pixel at a place in an image; -1: outside.
std::int64_t pixel_at(const Drawn& place, std::int64_t rows, std::int64_t cols) {
  if (!(place.u > -0.5F && place.v > -0.5F && place.u < static_cast<float>(cols) - 0.5F &&
        place.v < static_cast<float>(rows) - 0.5F)) {
    return -1;
  }
  return static_cast<std::int64_t>(place.v + 0.5F) * cols +
         static_cast<std::int64_t>(place.u + 0.5F);
}

/// Draws the person alone, as vertices, in the depth image.
DepthBuffer draw_points(const PersonSurface& person, const SceneView& scene,
                        const std::vector<Drawn>& at, bool fills,
                        std::vector<std::int64_t>& filled) {
  DepthBuffer image({0, 0, scene.cols, scene.rows});
  for (const Drawn& vertex : at) {
    const std::int64_t pixel = pixel_at(vertex, scene.rows, scene.cols);
    if (pixel >= 0) image.nearer(pixel, vertex.z);
  }
  if (fills && !person.in_place) {
    // Twice, because the first pass fills the neighbours of the pixels where a row and a column
    // without points cross.
    for (int pass = 0; pass < 2; ++pass) {
      fill_pinholes(image, filled, static_cast<float>(scene.camera.fx));
    }
  }
  return image;
}

DepthBuffer draw_faces(const PersonSurface& person, const std::vector<Drawn>& at,
                       const PixelBox& box) {
  DepthBuffer image(box);
  std::vector<float> inverse(at.size());  // inverse depth, which is linear in the image
  for (std::size_t i = 0; i < at.size(); ++i) inverse[i] = 1.0F / at[i].z;
  const DrawBounds bounds(box);
  for (std::int64_t f = 0; f < person.num_faces; ++f) {
    const std::int32_t* face = person.faces + 3 * f;
    const float ia = inverse[face[0]], ib = inverse[face[1]], ic = inverse[face[2]];
    for_each_pixel(at[face[0]], at[face[1]], at[face[2]], bounds,
                   [&](std::int32_t u, std::int32_t v, const FourPixels& four) {
                     image.nearer(image.index(u, v), four.inside, 1.0F / four.mix(ia, ib, ic));
                   });
  }
  return image;
}

/// Writes depth and ground truth: the person wherever the scene is not nearer.
void put_before(const DepthBuffer& person, const SceneView& scene, const CompositeBuffers& out) {
  constexpr float kFarthest = 65.535F;
  std::copy_n(scene.depth, scene.rows * scene.cols, out.depth);
  std::fill_n(out.mask, scene.rows * scene.cols, std::uint8_t{0});
  const PixelBox& box = person.box;
  for (std::int64_t v = box.v0; v < box.v0 + box.height; ++v) {
    for (std::int64_t u = box.u0; u < box.u0 + box.width; ++u) {
      const std::int64_t i = v * scene.cols + u;
      const float z = person.z[person.index(u, v)];
      if (!(z <= kFarthest) || is_hidden(scene, i, z)) continue;
      out.mask[i] = 1;
      out.depth[i] = static_cast<std::uint16_t>(1000.0F * z + 0.5F);
    }
  }
}

/// Marks the pixels of a box that a person covers; used to fade the person's edges.
class Coverage {
 public:
  explicit Coverage(const PixelBox& box)
      : cols_(box.width),
        rows_(box.height),
        covered_(static_cast<std::size_t>(cols_ * rows_), std::uint8_t{0}) {}

  /// @param i  Number of a pixel, as DepthBuffer::index() gives it.
  void add(std::int64_t i) { covered_[i] = 1; }
  /// Adds the rows from `row` on, given by the depths of a band of the box.
  void add_rows(std::int64_t row, const DepthBuffer& band) {
    std::uint8_t* covered = covered_.data() + row * cols_;
    const float* z = band.z.data();
    const std::int64_t size = band.box.height * cols_;
    for (std::int64_t i = 0; i < size; ++i) covered[i] = z[i] < kInfinityF ? 1 : 0;
  }

  /// For each covered pixel, counts the covered pixels in the square of side 2 radius + 1 around
  /// it, row by row from the first one on. Rows must be added `radius` ahead.
  class Shares {
   public:
    Shares(const Coverage& of, int radius)
        : of_(of),
          radius_(radius),
          size_(static_cast<std::uint8_t>(2 * radius + 1)),
          column_(static_cast<std::size_t>(of.cols_ + 2 * radius), std::uint8_t{0}) {}

    /// Calls `use(u, share)` for the covered pixels of the next row whose square is not fully
    /// covered.
    template <typename Use>
    void next_row(const Use& use) {
      for (; added_ < std::min(row_ + radius_ + 1, of_.rows_); ++added_) add_row<1>(added_);
      if (row_ - radius_ - 1 >= 0) add_row<-1>(row_ - radius_ - 1);
      const std::uint8_t* covered = of_.covered_.data() + row_ * of_.cols_;
      const std::uint8_t* column = column_.data() + radius_;
      ++row_;
      std::int64_t gap = -1;  // first column from u - radius on that is not full; -1: unknown
      for (std::int64_t u = 0; u < of_.cols_; ++u) {
        if (covered[u] == 0) {
          u = next_other(covered, u, of_.cols_, 0) - 1;
          continue;
        }
        if (gap < u - radius_) gap = next_other(column, u - radius_, of_.cols_ + radius_, size_);
        if (gap > u + radius_) {  // fully covered, as most of a person is: skip ahead
          u = gap - radius_ - 1;
          continue;
        }
        std::int32_t sum = 0;
        for (std::int64_t k = u - radius_; k <= u + radius_; ++k) sum += column[k];
        use(u, sum);
      }
    }

   private:
    template <int kSign>
    void add_row(std::int64_t v) {
      const std::uint8_t* row = of_.covered_.data() + v * of_.cols_;
      std::uint8_t* column = column_.data() + radius_;
      for (std::int64_t u = 0; u < of_.cols_; ++u) {
        column[u] = static_cast<std::uint8_t>(column[u] + kSign * row[u]);
      }
    }
    /// Index of the first byte from `begin` on that is not `value`, or `end`.
    static std::int64_t next_other(const std::uint8_t* bytes, std::int64_t begin, std::int64_t end,
                                   std::uint8_t value) {
      const std::uint64_t eight = 0x0101'0101'0101'0101U * value;
      for (std::uint64_t word; begin + 8 <= end; begin += 8) {
        std::memcpy(&word, bytes + begin, sizeof word);
        if (word != eight) break;
      }
      while (begin < end && bytes[begin] == value) ++begin;
      return begin;
    }

    const Coverage& of_;
    std::int64_t radius_, row_ = 0, added_ = 0;
    std::uint8_t size_;
    /// Covered pixels of each column in the rows around, with `radius` empty columns on each side.
    std::vector<std::uint8_t> column_;
  };

 private:
  std::int64_t cols_, rows_;
  std::vector<std::uint8_t> covered_;
};

/// Paints a person on a copy of the scene's colour image.
class ColorPainter {
 public:
  ColorPainter(const SceneView& scene, std::uint8_t* out) : scene_(scene.color), out_(out) {}

  void copy_rows(std::int64_t begin, std::int64_t end) {
    const std::int64_t stride = 3 * scene_.cols;
    std::copy_n(scene_.pixels + begin * stride, (end - begin) * stride, out_ + begin * stride);
  }
  /// @param rgb  R + 2^8 G + 2^16 B.
  void paint(std::int64_t u, std::int64_t v, std::uint32_t rgb) {
    std::uint8_t* pixel = out_ + 3 * (v * scene_.cols + u);
    pixel[0] = static_cast<std::uint8_t>(rgb);
    pixel[1] = static_cast<std::uint8_t>(rgb >> 8);
    pixel[2] = static_cast<std::uint8_t>(rgb >> 16);
  }
  [[nodiscard]] const std::uint8_t* painted(std::int64_t u, std::int64_t v) const {
    return out_ + 3 * (v * scene_.cols + u);
  }
  /// Blends a painted pixel with the scene.
  /// @param own  Number of pixels of the person in a square of `side` around the pixel.
  void fade(std::int64_t u, std::int64_t v, std::int32_t own, std::int32_t side) {
    const std::int64_t first = 3 * (v * scene_.cols + u);
    std::uint8_t* pixel = out_ + first;
    const std::uint8_t* behind = scene_.pixels + first;
    const auto weight = static_cast<float>(own), whole = static_cast<float>(side * side);
    const auto channels = [](const std::uint8_t* of) {
      return Float4{static_cast<float>(of[0]), static_cast<float>(of[1]),
                    static_cast<float>(of[2])};
    };
    // Sums are whole numbers below 2^23, and no quotient is rounded up to the next whole number.
    const auto half = static_cast<float>(side * side / 2);
    const Float4 sum = weight * channels(pixel) + (whole - weight) * channels(behind) + half;
    const Int4 rgb = __builtin_convertvector(sum / whole, Int4);
    for (int k = 0; k < 3; ++k) pixel[k] = static_cast<std::uint8_t>(rgb[k]);
  }

 private:
  ColorView scene_;
  std::uint8_t* out_;
};

bool is_finite(const Drawn& place) { return std::abs(place.u) + std::abs(place.v) < kInfinityF; }

/// The smallest box of an image that contains the vertices.
PixelBox box_around(const std::vector<Drawn>& at, std::int64_t cols, std::int64_t rows) {
  float u0 = kInfinityF, v0 = kInfinityF, u1 = -kInfinityF, v1 = -kInfinityF;
  for (const Drawn& d : at) {
    if (!is_finite(d)) continue;
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

/// Position of each vertex's colour in the person's colour image.
std::vector<Drawn> texels_of(const PersonSurface& person) {
  if (person.registration) {
    return Projector(*person.registration)(person.seen, person.num_vertices);
  }
  std::vector<Drawn> texels(person.num_vertices);
  for (std::size_t i = 0; i < texels.size(); ++i) {
    texels[i] = {static_cast<float>(person.pixels[2 * i]),
                 static_cast<float>(person.pixels[2 * i + 1]), 1.0F};
  }
  return texels;
}

/// 1 for each vertex that the scene does not hide in its depth image, else 0.
std::vector<std::uint8_t> shown_vertices(const SceneView& scene,
                                         const std::vector<Drawn>& in_depth) {
  std::vector<std::uint8_t> shown(in_depth.size(), 1);
  for (std::size_t i = 0; i < in_depth.size(); ++i) {
    const std::int64_t pixel = pixel_at(in_depth[i], scene.rows, scene.cols);
    if (pixel >= 0 && is_hidden(scene, pixel, in_depth[i].z)) shown[i] = 0;
  }
  return shown;
}

/// For each pixel of a box, the position in the person's image that it shows.
struct TexelBuffer {
  explicit TexelBuffer(std::size_t size)
      : u(std::make_unique_for_overwrite<float[]>(size)),
        v(std::make_unique_for_overwrite<float[]>(size)) {}

  void keep(std::int64_t i, Int4 which, Float4 us, Float4 vs) {
    store4(&u[i], which ? us : load4(&u[i]));
    store4(&v[i], which ? vs : load4(&v[i]));
  }

  std::unique_ptr<float[]> u, v;  ///< Set where something was drawn.
};

/// Draws the person's triangles in the scene's colour image, in bands of rows: the buffers of a
/// band stay in the processor's cache until it is painted.
class TexelDrawer {
 public:
  TexelDrawer(const PersonSurface& person, const SceneView& scene, const std::vector<Drawn>& at,
              const std::vector<Drawn>& in_depth, const PixelBox& box)
      : person_(person),
        box_(box),
        at_(at),
        texels_(texels_of(person)),
        shown_(shown_vertices(scene, in_depth)),
        faces_(faces_by_band()),
        shows_(static_cast<std::size_t>(box.width * kRows) + 3) {}

  [[nodiscard]] std::int32_t num_bands() const {
    return static_cast<std::int32_t>((box_.height + kRows - 1) / kRows);
  }
  void draw(std::int32_t band) {
    const std::int64_t first = band * kRows;
    drawn_.clear({box_.u0, box_.v0 + first, box_.width, std::min(kRows, box_.height - first)});
    const DrawBounds bounds(drawn_.box);
    for (const std::int32_t face : faces_[band]) draw_face(person_.faces + 3 * face, bounds);
  }
  /// Depths of the last band that was drawn.
  [[nodiscard]] const DepthBuffer& drawn() const { return drawn_; }
  [[nodiscard]] const TexelBuffer& shows() const { return shows_; }

 private:
  static constexpr std::int64_t kRows = 32;
  static constexpr std::int32_t kNone = -1;

  /// The band of each vertex, or the nearest one if the vertex is outside of the box. kNone if the
  /// vertex is not in the image or has no colour: its triangles are not drawn.
  [[nodiscard]] std::vector<std::int32_t> bands_of_vertices() const {
    std::vector<std::int32_t> band(at_.size(), kNone);
    if (box_.empty()) return band;
    const DrawBounds bounds(box_);
    for (std::size_t i = 0; i < at_.size(); ++i) {
      if (!is_finite(at_[i]) || !is_finite(texels_[i])) continue;
      const float row = std::clamp(at_[i].v, bounds.top, bounds.bottom) - bounds.top;
      band[i] = static_cast<std::int32_t>(row) / static_cast<std::int32_t>(kRows);
    }
    return band;
  }
  /// The triangles that reach into each band.
  [[nodiscard]] Buckets<std::int32_t> faces_by_band() const {
    const std::vector<std::int32_t> band = bands_of_vertices();
    return {num_bands(), [&](const auto& put) {
              for (std::int32_t f = 0; f < static_cast<std::int32_t>(person_.num_faces); ++f) {
                const std::int32_t* face = person_.faces + 3 * std::int64_t{f};
                const std::int32_t i = face[0], j = face[1], k = face[2];
                const auto [first, last] = std::minmax({band[i], band[j], band[k]});
                if (first == kNone || shown_[i] + shown_[j] + shown_[k] == 0) continue;
                for (std::int32_t b = first; b <= last; ++b) put(b, f);
              }
            }};
  }

  void draw_face(const std::int32_t* face, const DrawBounds& bounds) {
    const std::int32_t i = face[0], j = face[1], k = face[2];
    const int num_shown = shown_[i] + shown_[j] + shown_[k];
    // Copies, because the compiler must assume that writes to the buffers change references.
    const Drawn a = at_[i], b = at_[j], c = at_[k];
    const Drawn ta = texels_[i], tb = texels_[j], tc = texels_[k];
    const auto shown_a = static_cast<float>(shown_[i]), shown_b = static_cast<float>(shown_[j]),
               shown_c = static_cast<float>(shown_[k]);
    for_each_pixel(a, b, c, bounds, [&](std::int32_t u, std::int32_t v, const FourPixels& four) {
      // Triangles have a few pixels only, so that depth and texture are taken as linear within one.
      const Float4 texel_u = four.mix(ta.u, tb.u, tc.u), texel_v = four.mix(ta.v, tb.v, tc.v);
      Int4 inside = four.inside;
      if (num_shown < 3) inside &= four.mix(shown_a, shown_b, shown_c) >= 0.5F;
      const std::int64_t pixel = drawn_.index(u, v);
      const Int4 nearer = drawn_.nearer(pixel, inside, four.mix(a.z, b.z, c.z));
      shows_.keep(pixel, nearer, texel_u, texel_v);
    });
  }

  const PersonSurface& person_;
  PixelBox box_;
  const std::vector<Drawn>& at_;
  std::vector<Drawn> texels_;
  std::vector<std::uint8_t> shown_;
  Buckets<std::int32_t> faces_;
  DepthBuffer drawn_;
  TexelBuffer shows_;
};

/// Colours the pixels of a row of the scene's image in which the person was drawn.
void paint_row(const DepthBuffer& drawn, const TexelBuffer& shows, std::int64_t v,
               const TextureSampler& sample, ColorPainter& painter) {
  const std::int64_t end = drawn.box.u0 + drawn.box.width;
  for (std::int64_t u = drawn.box.u0; u < end; u += 4) {
    const std::int64_t i = drawn.index(u, v);
    unsigned is_drawn = true_lanes(load4(&drawn.z[i]) < kInfinityF);
    if (u + 4 > end) is_drawn &= (1U << (end - u)) - 1;
    if (is_drawn == 0) continue;
    const auto places = sample.places(load4(&shows.u[i]), load4(&shows.v[i]));
    sample.fetch_below(places[0]);
    for (int lane = 0; lane < 4; ++lane) {
      if ((is_drawn >> lane & 1U) != 0) painter.paint(u + lane, v, sample.packed(places[lane]));
    }
  }
}

/// Writes the scene's image with the person in a box of it. Each row is copied, painted and faded
/// while it is in the cache.
void paint_faces(const PersonSurface& person, const SceneView& scene, const std::vector<Drawn>& at,
                 const std::vector<Drawn>& in_depth, const PixelBox& box, int blend,
                 ColorPainter& painter) {
  TexelDrawer drawer(person, scene, at, in_depth, box);
  Coverage coverage(box);
  Coverage::Shares shares(coverage, blend);
  const TextureSampler sample(person.color);
  const std::int64_t bottom = box.v0 + box.height;
  std::int64_t faded = box.v0;
  painter.copy_rows(0, box.v0);
  for (std::int32_t band = 0; band < drawer.num_bands(); ++band) {
    drawer.draw(band);
    const PixelBox& rows = drawer.drawn().box;
    const std::int64_t end = rows.v0 + rows.height;
    coverage.add_rows(rows.v0 - box.v0, drawer.drawn());
    for (std::int64_t v = rows.v0; v < end; ++v) {
      painter.copy_rows(v, v + 1);
      paint_row(drawer.drawn(), drawer.shows(), v, sample, painter);
    }
    for (; faded < (end < bottom ? end - blend : bottom); ++faded) {
      shares.next_row([&](std::int64_t u, std::int32_t share) {
        painter.fade(box.u0 + u, faded, share, 2 * blend + 1);
      });
    }
  }
  painter.copy_rows(bottom, scene.color.rows);
}

/// Paints one pixel per vertex. Filled pinholes get the mean colour of their coloured neighbours.
void paint_points(const PersonSurface& person, const SceneView& scene, const std::vector<Drawn>& at,
                  const std::vector<std::int64_t>& filled, const std::uint8_t* mask, int blend,
                  ColorPainter& painter) {
  painter.copy_rows(0, scene.color.rows);
  const std::vector<Drawn> texels = texels_of(person);
  const TextureSampler sample(person.color);
  DepthBuffer image({0, 0, scene.cols, scene.rows});
  Coverage coverage(image.box);
  for (std::size_t i = 0; i < at.size(); ++i) {
    const std::int64_t pixel = pixel_at(at[i], scene.rows, scene.cols);
    if (pixel < 0 || mask[pixel] == 0 || !image.nearer(pixel, at[i].z)) continue;
    if (!is_finite(texels[i])) continue;
    coverage.add(pixel);
    painter.paint(pixel % scene.cols, pixel / scene.cols, sample.packed(texels[i].u, texels[i].v));
  }
  for (const std::int64_t pixel : filled) {
    if (mask[pixel] == 0) continue;
    std::array<std::int32_t, 3> sum{};
    std::int32_t count = 0;
    const std::int64_t u = pixel % scene.cols, v = pixel / scene.cols;
    const auto add = [&](std::int64_t next_u, std::int64_t next_v) {
      if (!(image.z[next_v * scene.cols + next_u] < kInfinityF)) return;
      for (std::size_t k = 0; k < 3; ++k) sum[k] += painter.painted(next_u, next_v)[k];
      ++count;
    };
    if (u > 0) add(u - 1, v);
    if (v > 0) add(u, v - 1);
    if (u + 1 < scene.cols) add(u + 1, v);
    if (v + 1 < scene.rows) add(u, v + 1);
    if (count == 0) continue;
    coverage.add(pixel);
    painter.paint(u, v,
                  static_cast<std::uint32_t>(sum[0] / count + ((sum[1] / count) << 8) +
                                             ((sum[2] / count) << 16)));
    image.z[pixel] = 0.0F;  // marks the pixel as coloured, for pinholes that are filled after it
  }
  Coverage::Shares shares(coverage, blend);
  for (std::int64_t v = 0; v < scene.rows; ++v) {
    shares.next_row(
        [&](std::int64_t u, std::int32_t share) { painter.fade(u, v, share, 2 * blend + 1); });
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
  std::vector<Drawn> at = Projector(scene.camera)(person.vertices, person.num_vertices);
  if (person.in_place) {
    for (std::size_t i = 0; i < at.size(); ++i) {
      at[i].u = static_cast<float>(person.pixels[2 * i]);
      at[i].v = static_cast<float>(person.pixels[2 * i + 1]);
    }
  }
  std::vector<std::int64_t> filled;
  const bool as_points = options.surface == CompositeSurface::kPoints || person.in_place;
  put_before(as_points ? draw_points(person, scene, at, options.fill_pinholes, filled)
                       : draw_faces(person, at, box_around(at, scene.cols, scene.rows)),
             scene, out);
  if (scene.color.pixels == nullptr || out.color == nullptr) return;
  ColorPainter painter(scene, out.color);
  if (options.surface == CompositeSurface::kPoints && !scene.registration) {
    paint_points(person, scene, at, filled, out.mask, options.blend, painter);
    return;
  }
  const std::vector<Drawn> in_color =
      scene.registration ? Projector(*scene.registration)(person.vertices, person.num_vertices)
                         : at;
  const PixelBox box = box_around(in_color, scene.color.cols, scene.color.rows);
  paint_faces(person, scene, in_color, at, box, options.blend, painter);
}

}  // namespace manip3d
