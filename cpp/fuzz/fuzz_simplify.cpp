// Edge collapse of arbitrary meshes with all methods: an InputError, or a valid mesh and a correct
// record.
#include <cstdint>
#include <cstdlib>

#include "checks.hpp"
#include "manip3d/error.hpp"
#include "manip3d/simplify/clean.hpp"
#include "manip3d/simplify/qem.hpp"
#include "mesh_from_bytes.hpp"

namespace {

using namespace manip3d;
using fuzzing::require;

template <typename Enum>
Enum pick(fuzzing::Bytes& bytes, int count) {
  return static_cast<Enum>(bytes.take<std::uint8_t>() % count);
}

QemOptions take_options(fuzzing::Bytes& bytes) {
  QemOptions options;
  options.boundary = pick<BoundaryTerm>(bytes, 4);
  options.curvature = pick<BoundaryCurvature>(bytes, 2);
  options.texture = pick<TextureTerm>(bytes, 5);
  options.complex_vertices = pick<ComplexVertices>(bytes, 2);
  options.link_condition = pick<LinkCondition>(bytes, 3);
  options.target_faces = bytes.take<std::uint8_t>() % 32;
  if (bytes.take<std::uint8_t>() % 4 == 0) options.quality_threshold = 0.3;
  if (bytes.take<std::uint8_t>() % 4 == 0) options.max_error = bytes.take<std::uint8_t>() / 64.0;
  return options;
}

void check(const MeshView& input, const QemOptions& options, const QemResult& result) {
  check_mesh(result.mesh);
  require(result.mesh.faces.rows() <= input.num_faces());
  require(result.kept.size() == static_cast<std::size_t>(result.mesh.vertices.rows()));
  require(result.max_error <= options.max_error);
  if (result.stop == CollapseStop::kTargetReached) {
    require(result.mesh.faces.rows() <= options.target_faces);
  }
  if (result.stop == CollapseStop::kRefused) return;
  const QemResult replayed =
      replay_collapses(input, options, result.collapses, options.target_faces);
  require(replayed.mesh.faces == result.mesh.faces);
  require(replayed.mesh.face_texcoords == result.mesh.face_texcoords);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  fuzzing::Bytes bytes(data, size);
  const QemOptions options = take_options(bytes);
  const bool weld = bytes.take<std::uint8_t>() % 2 == 0;
  const TriangleMesh mesh = fuzzing::take_mesh(bytes);
  try {
    const TriangleMesh cleaned = clean(mesh, {weld, Duplicates::kAny}).mesh;
    check(cleaned, options, simplify_qem(cleaned, options));
    check(mesh, options, simplify_qem(mesh, options));
  } catch (const InputError&) {
  }
  return 0;
}
