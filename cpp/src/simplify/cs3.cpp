#include "manip3d/simplify/cs3.hpp"

#include <algorithm>
#include <chrono>
#include <string>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/simplify/grid_delaunay.hpp"
#include "simplify/cs3_sampling.hpp"
#include "simplify/importance_map.hpp"

namespace manip3d {
namespace {

void check(const RangeImage& image, const Cs3Options& options, const DepthMeshBuffers& out) {
  if (options.target_points < 0) {
    throw InputError("target_points: expected >= 0, got " + std::to_string(options.target_points));
  }
  if (!(options.max_edge > 0.0)) {
    throw InputError("max_edge: expected > 0, got " + number_text(options.max_edge));
  }
  if (options.num_threads < 0) {
    throw InputError("num_threads: expected >= 0, got " + std::to_string(options.num_threads));
  }
  if (!(options.reading.outliers >= 0.0 && options.reading.outliers < 1.0)) {
    throw InputError("outliers: expected a share in [0, 1), got " +
                     number_text(options.reading.outliers));
  }
  if (options.distance_dependent && !image.has_depth()) {
    throw InputError("distance_dependent: expected a depth image; a grid of points has no depth");
  }
  const std::int64_t needed = std::min(options.target_points, image.rows() * image.cols());
  if (out.capacity < needed) {
    throw InputError("out: expected room for " + std::to_string(needed) + " vertices, got " +
                     std::to_string(out.capacity));
  }
}

/// Writes the mesh of the chosen slots into the caller's memory.
class MeshWriter {
 public:
  MeshWriter(const RangeImage& image, const ImportanceMap& map, const Cs3Options& options,
             const DepthMeshBuffers& out)
      : image_(image),
        map_(map),
        squared_max_edge_(options.max_edge * options.max_edge),
        out_(out) {}

  void write_vertices(std::span<const Pixel> pixels, const Registration* registration) {
    const auto width = static_cast<double>(image_.cols());
    const auto height = static_cast<double>(image_.rows());
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      const auto u = static_cast<std::int32_t>(pixels[i].u + map_.box.u0);
      const auto v = static_cast<std::int32_t>(pixels[i].v + map_.box.v0);
      const std::array<float, 3> point = image_.point(u, v);
      std::copy(point.begin(), point.end(), out_.vertices + 3 * i);
      out_.pixels[2 * i] = u;
      out_.pixels[2 * i + 1] = v;
      const std::array<float, 2> uv = registration == nullptr
                                          ? grid_texcoord(u, v, width, height)
                                          : registered_texcoord(point, *registration);
      std::copy(uv.begin(), uv.end(), out_.texcoords + 2 * i);
    }
  }

  /// @return  Number of valid triangles, which were written.
  std::int64_t write_faces(const GridDelaunay& delaunay) {
    std::int32_t* next = out_.faces;
    for (std::int32_t t = 0; t < delaunay.num_faces(); ++t) {
      const std::array<std::int32_t, 3> corners = delaunay.triangle(t);
      if (!has_valid_centroid(delaunay.pixels(), corners) || !has_short_edges(corners)) continue;
      // The triangulation is counter-clockwise with rows up.
      *next++ = corners[0];
      *next++ = corners[image_.rows_up() ? 1 : 2];
      *next++ = corners[image_.rows_up() ? 2 : 1];
    }
    return (next - out_.faces) / 3;
  }

 private:
  // "If there is no valid depth measurement at the projected point corresponding to the centroid
  // [the] triangle is considered to be invalid" (section 3.4). The pixel nearest to the centroid is
  // tested; halves are rounded up.
  bool has_valid_centroid(std::span<const Pixel> pixels,
                          const std::array<std::int32_t, 3>& corners) const {
    std::int64_t u = 0, v = 0;
    for (const std::int32_t i : corners) {
      u += pixels[i].u;
      v += pixels[i].v;
    }
    return map_.is_valid(static_cast<Slot>((2 * v + 3) / 6 * map_.stride + (2 * u + 3) / 6));
  }

  bool has_short_edges(const std::array<std::int32_t, 3>& corners) const {
    if (!(squared_max_edge_ < std::numeric_limits<double>::infinity())) return true;
    for (std::size_t i = 0; i < 3; ++i) {
      const float* p = out_.vertices + 3 * std::int64_t{corners[i]};
      const float* q = out_.vertices + 3 * std::int64_t{corners[(i + 1) % 3]};
      double sum = 0.0;
      for (int c = 0; c < 3; ++c) {
        const double difference = double{p[c]} - double{q[c]};
        sum += difference * difference;
      }
      if (!(sum <= squared_max_edge_)) return false;
    }
    return true;
  }

  const RangeImage& image_;
  const ImportanceMap& map_;
  double squared_max_edge_;
  const DepthMeshBuffers& out_;
};

}  // namespace

struct Cs3::Workspace {
  ImportanceMapper mapper;
  ImportanceMap map;
  ImportanceOrder order;
  Cs3Sampler sampler;
  std::vector<Pixel> pixels;  ///< Chosen pixels, relative to the map's box.
  GridDelaunay delaunay;
};

Cs3::Cs3() : workspace_(std::make_unique<Workspace>()) {}
Cs3::Cs3(Cs3&&) noexcept = default;
Cs3& Cs3::operator=(Cs3&&) noexcept = default;
Cs3::~Cs3() = default;

Cs3Report Cs3::run(const RangeImage& image, const Cs3Options& options,
                   const Registration* registration, const DepthMeshBuffers& out) {
  check(image, options, out);
  Workspace& w = *workspace_;
  Cs3Report report;
  auto start = std::chrono::steady_clock::now();
  const auto finish = [&](Cs3Stage stage) {
    const auto now = std::chrono::steady_clock::now();
    report.seconds[static_cast<std::size_t>(stage)] =
        std::chrono::duration<double>(now - start).count();
    start = now;
  };
  w.mapper.compute(image, options, w.map);
  finish(Cs3Stage::kImportance);
  w.order.sort(w.map);
  finish(Cs3Stage::kOrder);
  w.sampler.choose(image, w.map, w.order, options, report);
  finish(Cs3Stage::kSampling);
  w.pixels.clear();
  const std::int64_t most = std::min(options.target_points, image.rows() * image.cols());
  w.pixels.reserve(most);
  for (const Slot slot : w.sampler.slots()) {
    const auto stride = static_cast<Slot>(w.map.stride);
    w.pixels.push_back(
        {static_cast<std::int32_t>(slot % stride), static_cast<std::int32_t>(slot / stride)});
  }
  w.delaunay.reserve(most);
  w.delaunay.triangulate(w.pixels);
  finish(Cs3Stage::kTriangulation);
  MeshWriter writer(image, w.map, options, out);
  writer.write_vertices(w.pixels, registration);
  report.num_vertices = static_cast<std::int64_t>(w.pixels.size());
  report.num_faces = writer.write_faces(w.delaunay);
  finish(Cs3Stage::kOutput);
  return report;
}

Cs3Result simplify_cs3(const RangeImage& image, const Cs3Options& options,
                       const Registration* registration) {
  Cs3Result result;
  DepthMesh& mesh = result.mesh;
  const std::int64_t capacity =
      std::max<std::int64_t>(0, std::min(options.target_points, image.rows() * image.cols()));
  mesh.vertices.resize(capacity, 3);
  mesh.pixels.resize(capacity, 2);
  mesh.texcoords.resize(capacity, 2);
  mesh.faces.resize(2 * capacity, 3);
  result.report = Cs3().run(image, options, registration,
                            {capacity, mesh.vertices.data(), mesh.pixels.data(),
                             mesh.texcoords.data(), mesh.faces.data()});
  mesh.vertices.conservativeResize(result.report.num_vertices, Eigen::NoChange);
  mesh.pixels.conservativeResize(result.report.num_vertices, Eigen::NoChange);
  mesh.texcoords.conservativeResize(result.report.num_vertices, Eigen::NoChange);
  mesh.faces.conservativeResize(result.report.num_faces, Eigen::NoChange);
  return result;
}

}  // namespace manip3d
