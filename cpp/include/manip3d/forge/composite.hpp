#pragma once

#include <cstdint>
#include <optional>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/color_image.hpp"

/// @file
/// A person put before another scene: depth and colour image of a forged stream (dissertation
/// section 5.1.2).
namespace manip3d {

enum class CompositeSurface : std::uint8_t {
  kMesh,   ///< Triangles are drawn.
  kPoints  ///< Vertices are drawn, as published, and pinholes between them filled.
};

struct CompositeOptions {
  CompositeSurface surface = CompositeSurface::kMesh;
  bool fill_pinholes = true;  ///< Fills gaps of drawn points from 4-neighbours, never outwards.
  int blend = 1;              ///< Colour pixels over which the person's edge fades; 0: none.
};

/// A person's surface and where its colours come from; borrowed.
struct PersonSurface {
  std::int64_t num_vertices = 0, num_faces = 0;
  const float* vertices = nullptr;       ///< (n, 3) where the person is, camera frame of the scene.
  const std::int32_t* faces = nullptr;   ///< (m, 3)
  const float* seen = nullptr;           ///< (n, 3) where the person was seen: gives the colours.
  const std::int32_t* pixels = nullptr;  ///< (n, 2) column and row in which it was seen.
  ColorView color;                       ///< Colour of the person's frame; no pixels: none.
  std::optional<Registration> registration;  ///< None: the colour image has depth's pixels.
  /// The person stands where they were seen by the same camera: depth goes to the same pixels.
  bool in_place = false;
};

/// The scene behind; borrowed.
struct SceneView {
  std::int64_t rows = 0, cols = 0;
  const std::uint16_t* depth = nullptr;  ///< Millimetres; 0: no measurement.
  Intrinsics camera;
  ColorView color;                           ///< Without pixels: none.
  std::optional<Registration> registration;  ///< None: colour has the depth image's pixels.
};

/// Caller-owned images, of the scene's sizes.
struct CompositeBuffers {
  std::uint16_t* depth = nullptr;
  std::uint8_t* mask = nullptr;   ///< 1 where the depth is the person's, else 0: the truth.
  std::uint8_t* color = nullptr;  ///< Null if the scene has no colour.
};

/// Draws the person into the scene: the nearer surface wins, and where the scene has no measurement
/// the person does. The colour image is drawn by the colour camera with the person's own colours;
/// what the scene hides in the depth image is hidden there. Cameras with a ray table are projected
/// by their lens model unless the person is in place. The same bits on every CPU.
/// @throws InputError  sizes differ, an index is out of range, the person has no colours and the
///                     scene has, blend out of [0, 64].
void composite(const PersonSurface& person, const SceneView& scene, const CompositeOptions& options,
               const CompositeBuffers& out);

}  // namespace manip3d
