#pragma once

#include <cstdint>
#include <optional>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/color_image.hpp"

/// @file
/// Compositing of a person into another scene: depth and colour images of a forged stream
/// (dissertation section 5.1.2).
namespace manip3d {

enum class CompositeSurface : std::uint8_t {
  kMesh,   ///< Draw triangles.
  kPoints  ///< Draw vertices, as published, and fill the pinholes between them.
};

struct CompositeOptions {
  CompositeSurface surface = CompositeSurface::kMesh;
  /// Fill gaps of drawn points from their 4-neighbours. The silhouette does not grow.
  bool fill_pinholes = true;
  /// Colour pixels over which the person's edge is blended with the scene; 0: none.
  int blend = 1;
};

/// A person's surface with the source of its colours; borrowed.
struct PersonSurface {
  std::int64_t num_vertices = 0, num_faces = 0;
  /// (n, 3), metres: position in the scene, in its camera's frame.
  const float* vertices = nullptr;
  const std::int32_t* faces = nullptr;  ///< (m, 3)
  /// (n, 3), metres: position in the person's recording, which gives the colours.
  const float* seen = nullptr;
  /// (n, 2): column and row of the vertex in the person's recording.
  const std::int32_t* pixels = nullptr;
  ColorView color;  ///< Colour image of the person's recording; without pixels: none.
  /// Colour camera; empty: the colour image has the depth image's pixels.
  std::optional<Registration> registration;
  /// True: the person stays where the same camera recorded them, so that depths go to the same
  /// pixels.
  bool in_place = false;
};

/// The scene behind the person; borrowed.
struct SceneView {
  std::int64_t rows = 0, cols = 0;
  const std::uint16_t* depth = nullptr;  ///< Millimetres; 0: no measurement.
  Intrinsics camera;
  ColorView color;  ///< Without pixels: no colour image.
  /// Colour camera; empty: the colour image has the depth image's pixels.
  std::optional<Registration> registration;
};

/// Caller-owned images of the sizes of the scene's.
struct CompositeBuffers {
  std::uint16_t* depth = nullptr;
  std::uint8_t* mask = nullptr;   ///< Ground truth: 1 if the depth is the person's, else 0.
  std::uint8_t* color = nullptr;  ///< Null if the scene has no colour.
};

/// Draws the person into the scene. The nearer surface wins; if the scene has no measurement at a
/// pixel, the person does. The colour image is drawn from the view of the colour camera, with the
/// person's own colours; parts of the person that the scene hides in the depth image are hidden in
/// it too. Cameras with a ray table are projected by their lens model, unless the person is in
/// place. The result has the same bits on every CPU.
/// @throws InputError  sizes differ, an index is out of range, the scene has colours and the person
///                     has none, or blend is not in [0, 64].
void composite(const PersonSurface& person, const SceneView& scene, const CompositeOptions& options,
               const CompositeBuffers& out);

}  // namespace manip3d
