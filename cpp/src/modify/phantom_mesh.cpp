#include "modify/phantom_mesh.hpp"

#include <algorithm>
#include <array>
#include <cstring>
#include <string>

#include "geometry/cell_cut.hpp"
#include "geometry/constants.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/grid_mesh.hpp"
#include "modify/ray_at.hpp"

namespace manip3d {
namespace {

/// registered_texcoord() with the matrices of an undistorted camera multiplied in advance.
class ColorCamera {
 public:
  explicit ColorCamera(const Registration& registration)
      : registration_(registration),
        width_(static_cast<double>(registration.color.width)),
        height_(static_cast<double>(registration.color.height)) {
    const Intrinsics& k = registration.color;
    for (const double coefficient : k.distortion) distorted_ |= coefficient != 0.0;
    const double fx = k.mirrored ? -k.fx : k.fx;
    Eigen::Matrix3d camera;
    camera << fx, 0.0, k.cx, 0.0, k.fy, k.cy, 0.0, 0.0, 1.0;
    rotation_ = camera * registration.rotation;
    translation_ = camera * registration.translation;
  }

  [[nodiscard]] std::array<float, 2> uv(float x, float y, float z) const {
    if (distorted_) return registered_texcoord({x, y, z}, registration_);
    const double a = x, b = y, c = z;
    const auto row = [&](int i) {
      return rotation_(i, 0) * a + rotation_(i, 1) * b + rotation_(i, 2) * c + translation_(i);
    };
    const double w = row(2);
    if (!(w > 0.0)) return {kNanF, kNanF};
    return seen_texcoord(row(0) / w, row(1) / w, width_, height_);
  }

 private:
  const Registration& registration_;
  double width_, height_;
  bool distorted_ = false;
  Eigen::Matrix3d rotation_;
  Eigen::Vector3d translation_;
};

class MeshWriter {
 public:
  MeshWriter(const PhantomImage& image, const std::vector<std::int32_t>& vertex_of,
             std::int64_t num_points, const PhantomMeshOptions& options,
             const DepthMeshBuffers& out, bool flips)
      : image_(image),
        vertex_of_(vertex_of),
        out_(out),
        max_step_(static_cast<float>(options.max_depth_step)),
        keeps_seams_(options.texturing == Texturing::kSource),
        flips_(flips),
        size_{num_points, 0} {}

  /// Triangulates the cells between a row of pixels and the next row.
  void cut_row(std::int64_t first, std::int64_t last) {
    constexpr std::int64_t kWord = 8;  // pixels; they enclose one cell fewer
    for (std::int64_t pixel = first; pixel < last;) {
      const PixelKind* above = image_.kind + pixel;
      const PixelKind* below = above + image_.cols;
      if (pixel + kWord <= last + 1 && word_of(above) == 0 && word_of(below) == 0) {
        pixel += kWord - 1;
        continue;
      }
      if (!cut_body(pixel)) cut(pixel);
      ++pixel;
    }
  }

  [[nodiscard]] PhantomMeshSize size() const { return size_; }

 private:
  static std::uint64_t word_of(const PixelKind* kinds) {
    std::uint64_t word;
    std::memcpy(&word, kinds, sizeof word);
    return word;
  }

  /// Triangulates a cell of body pixels without a step as cut() would, only faster; returns false
  /// for other cells. Most cells are of this kind.
  bool cut_body(std::int64_t pixel) {
    const std::int64_t below = pixel + image_.cols;
    const auto is_body = [&](std::int64_t p) { return image_.kind[p] == PixelKind::kBody; };
    if (!is_body(pixel) || !is_body(pixel + 1) || !is_body(below) || !is_body(below + 1)) {
      return false;
    }
    const float* z = image_.depth;
    const auto [a, b] = std::minmax(z[pixel], z[pixel + 1]);
    const auto [c, d] = std::minmax(z[below], z[below + 1]);
    if (!(std::max(b, d) - std::min(a, c) <= max_step_)) return false;
    const std::int64_t beside = flips_ ? pixel + 1 : below, across = below + 1;
    const std::int64_t other = flips_ ? below : pixel + 1;
    const std::int32_t v0 = vertex_of_[pixel], v1 = vertex_of_[beside], v2 = vertex_of_[across],
                       v3 = vertex_of_[other];
    const bool from_0 = squared_distance(pixel, across) <= squared_distance(beside, other);
    const std::array<std::int32_t, 6> corners =
        from_0 ? std::array{v0, v1, v2, v0, v2, v3} : std::array{v1, v2, v3, v1, v3, v0};
    std::copy_n(corners.begin(), 6, out_.faces + 3 * size_.num_faces);
    size_.num_faces += 2;
    return true;
  }

  /// Triangulates the cell below and right of a pixel.
  void cut(std::int64_t pixel) {
    const auto corner = cell_corners(pixel, image_.cols, flips_);
    unsigned valid = 0;
    for (int i = 0; i < 4; ++i) {
      valid |= (image_.kind[corner[i]] != PixelKind::kNone ? 1U : 0U) << i;
    }
    if (valid == 0) return;
    const CellCut cut =
        cut_cell(valid, [&](int i, int j) { return squared_distance(corner[i], corner[j]); });
    for (const auto& [i, j, k] : cell_triangles(cut)) keep({corner[i], corner[j], corner[k]});
  }

  [[nodiscard]] const float* point(std::int64_t pixel) const {
    return out_.vertices + 3 * std::int64_t{vertex_of_[pixel]};
  }
  [[nodiscard]] float squared_distance(std::int64_t a, std::int64_t b) const {
    const float* p = point(a);
    const float* q = point(b);
    const float x = p[0] - q[0], y = p[1] - q[1], z = p[2] - q[2];
    return x * x + y * y + z * z;
  }

  void keep(const std::array<std::int64_t, 3>& corner) {
    const auto [least, most] =
        std::minmax({image_.depth[corner[0]], image_.depth[corner[1]], image_.depth[corner[2]]});
    if (!(most - least <= max_step_)) return;
    std::array<std::int32_t, 3> vertex{};
    std::int64_t phantom = -1;
    bool body = false;
    for (std::size_t i = 0; i < 3; ++i) {
      vertex[i] = vertex_of_[corner[i]];
      if (image_.kind[corner[i]] == PixelKind::kBody) {
        body = true;
      } else if (phantom < 0) {
        phantom = corner[i];
      }
    }
    if (keeps_seams_ && body && phantom >= 0 && !split_seam(corner, phantom, vertex)) return;
    std::copy_n(vertex.begin(), 3, out_.faces + 3 * size_.num_faces++);
  }

  /// Replaces the vertices at the body's corners by new ones with the phantom's texture; returns
  /// false if there is no capacity.
  bool split_seam(const std::array<std::int64_t, 3>& corner, std::int64_t phantom,
                  std::array<std::int32_t, 3>& vertex) {
    const std::int64_t texture = vertex_of_[phantom];
    for (std::size_t i = 0; i < 3; ++i) {
      if (image_.kind[corner[i]] != PixelKind::kBody) continue;
      if (size_.num_vertices == out_.capacity) return false;
      const std::int64_t from = vertex[i], to = size_.num_vertices++;
      std::copy_n(out_.vertices + 3 * from, 3, out_.vertices + 3 * to);
      std::copy_n(out_.pixels + 2 * from, 2, out_.pixels + 2 * to);
      std::copy_n(out_.texcoords + 2 * texture, 2, out_.texcoords + 2 * to);
      vertex[i] = static_cast<std::int32_t>(to);
    }
    return true;
  }

  const PhantomImage& image_;
  const std::vector<std::int32_t>& vertex_of_;
  const DepthMeshBuffers& out_;
  float max_step_;
  bool keeps_seams_, flips_;
  PhantomMeshSize size_;
};

/// Writes texture coordinates of the first `num_points` vertices (in [0, 1] within the image, v up)
/// for a colour image with the pixels of the depth image.
void write_image_texcoords(const PhantomImage& image, std::int64_t num_points, bool by_source,
                           const DepthMeshBuffers& out) {
  const auto width = static_cast<double>(image.cols), height = static_cast<double>(image.rows);
  for (std::int64_t i = 0; i < num_points; ++i) {
    std::int64_t u = out.pixels[2 * i], v = out.pixels[2 * i + 1];
    if (by_source) {
      const std::int32_t* source = image.source + 2 * (v * image.cols + u);
      v = source[0];
      u = source[1];
    }
    const auto uv = grid_texcoord(static_cast<double>(u), static_cast<double>(v), width, height);
    std::copy_n(uv.begin(), 2, out.texcoords + 2 * i);
  }
}

/// Writes texture coordinates of the first `num_points` vertices (in [0, 1] within the image, v up)
/// for the image of a colour camera; NaN where the camera cannot see the vertex.
void write_color_texcoords(const PhantomImage& image, const PixelRays& rays,
                           std::int64_t num_points, const Registration& registration,
                           bool by_source, const DepthMeshBuffers& out) {
  const ColorCamera camera(registration);
  for (std::int64_t i = 0; i < num_points; ++i) {
    const float* p = out.vertices + 3 * i;
    std::array<float, 3> point = {p[0], p[1], p[2]};
    const std::int64_t pixel = out.pixels[2 * i + 1] * image.cols + out.pixels[2 * i];
    if (by_source && image.kind[pixel] != PixelKind::kBody) {
      const std::int64_t v = image.source[2 * pixel], u = image.source[2 * pixel + 1];
      const Eigen::Vector3f seen = lift(rays, u, v, image.source_depth[pixel]);
      point = {seen.x(), seen.y(), seen.z()};
    }
    const auto uv = camera.uv(point[0], point[1], point[2]);
    std::copy_n(uv.begin(), 2, out.texcoords + 2 * i);
  }
}

}  // namespace

std::int64_t write_points(const PhantomImage& image, const PixelBox& box, const PixelRays& rays,
                          const DepthMeshBuffers& out, std::vector<std::int32_t>& vertex_of) {
  std::int64_t count = 0;
  for (std::int64_t v = box.v0; v < box.v0 + box.height; ++v) {
    for (std::int64_t u = box.u0; u < box.u0 + box.width; ++u) {
      const std::int64_t pixel = v * image.cols + u;
      if (image.kind[pixel] == PixelKind::kNone) continue;
      if (count == out.capacity) {
        throw InputError("buffers: expected room for every pixel of person and phantom, got " +
                         std::to_string(out.capacity) + " vertices");
      }
      const Eigen::Vector3f point = lift(rays, u, v, image.depth[pixel]);
      std::copy_n(point.data(), 3, out.vertices + 3 * count);
      out.pixels[2 * count] = static_cast<std::int32_t>(u);
      out.pixels[2 * count + 1] = static_cast<std::int32_t>(v);
      vertex_of[pixel] = static_cast<std::int32_t>(count++);
    }
  }
  return count;
}

PhantomMeshSize write_mesh(const PhantomImage& image, const PixelBox& box, const PixelRays& rays,
                           std::int64_t num_points, const std::vector<std::int32_t>& vertex_of,
                           const Registration* registration, const PhantomMeshOptions& options,
                           const DepthMeshBuffers& out) {
  const bool by_source = options.texturing == Texturing::kSource;
  if (registration == nullptr) {
    write_image_texcoords(image, num_points, by_source, out);
  } else {
    write_color_texcoords(image, rays, num_points, *registration, by_source, out);
  }
  MeshWriter writer(image, vertex_of, num_points, options, out, rays.flips());
  for (std::int64_t v = box.v0; v + 1 < box.v0 + box.height; ++v) {
    const std::int64_t first = v * image.cols + box.u0;
    writer.cut_row(first, first + box.width - 1);
  }
  return writer.size();
}

}  // namespace manip3d
