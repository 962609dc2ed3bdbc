// The measures of two arbitrary meshes: an InputError, or consistent numbers.
#include <cmath>
#include <cstdint>
#include <cstdlib>

#include "checks.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/bvh.hpp"
#include "manip3d/metrics/boundary_gap.hpp"
#include "manip3d/metrics/fmpd.hpp"
#include "manip3d/metrics/metro.hpp"
#include "manip3d/metrics/texture_error.hpp"
#include "mesh_from_bytes.hpp"

namespace {

using namespace manip3d;
using fuzzing::require;

// The mean of equal numbers may exceed them by rounding. The rms may be infinite, because squares
// of distances overflow beyond 1e150 sizes of the original.
void check(const Deviation& d) {
  require(d.mean >= 0.0 && d.mean <= d.max * (1.0 + 1e-9));
  require(d.rms >= 0.0);
  require(d.samples > 0);
}

template <typename Measure>
void run(const Measure& measure) {
  try {
    measure();
  } catch (const InputError&) {
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  fuzzing::Bytes bytes(data, size);
  const TriangleMesh a = fuzzing::take_mesh(bytes);
  const TriangleMesh b = fuzzing::take_mesh(bytes);
  run([&] {
    const MetroResult result = metro(a, b, {.num_threads = 1});
    check(result.forward);
    check(result.backward);
    require(result.diagonal > 0.0);
  });
  run([&] {
    const MetroOptions options{.sampling = Sampling::kArea, .samples = 50, .num_threads = 1};
    const MetroResult result = metro(a, b, options);
    check(result.forward);
    check(result.backward);
  });
  run([&] {
    const TextureError error = texture_error(a, b, {.samples = 50, .num_threads = 1});
    require(error.samples >= 0 && error.skipped >= 0 && error.material_mismatches >= 0);
    require(error.samples + error.skipped + error.material_mismatches >= 50);
    require(error.mean.has_value() == (error.samples > 0));
  });
  run([&] {
    const FmpdResult result = fmpd(a, b, {.num_threads = 1});
    require(result.value >= 0.0 && std::isfinite(result.value));
  });
  run([&] {
    const BoundaryGap gap = boundary_gap(a, b, {.tolerance = 0.1, .num_threads = 1});
    if (gap.forward) check(*gap.forward);
    if (gap.backward) check(*gap.backward);
    require(gap.cracks >= 0 && gap.crack_length >= 0.0);
  });
  run([&] {
    const TriangleBvh bvh(b);
    std::vector<SurfacePoint> all;
    for (Eigen::Index v = 0; v < a.vertices.rows(); ++v) {
      const Eigen::Vector3d query = a.vertices.row(v);
      const SurfacePoint nearest = bvh.closest_point(query);
      bvh.faces_within(query, INFINITY, all);
      require(all.size() == static_cast<std::size_t>(b.faces.rows()));
      require(all[nearest.face].distance == nearest.distance);
      for (const SurfacePoint& other : all) require(other.distance >= nearest.distance);
      require(nearest.barycentric.minCoeff() >= 0.0);
      require(std::abs(nearest.barycentric.sum() - 1.0) < 1e-12);
    }
  });
  return 0;
}
