#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/geometry/range_image.hpp"
#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/body_bones.hpp"

namespace manip3d {

struct PersonMaskOptions {
  double near = 0.3, far = 8.0;  ///< Metres; nothing outside is anybody.
  /// Without a body index: the person lies within so much of the depths of its joints, metres.
  double margin = 0.35;
};

/// The pixels of one person as points, tile by tile of 8 x 8 pixels. Memory is kept for reuse.
struct PersonPoints {
  std::int64_t rows = 0, cols = 0;  ///< Of the image.
  std::int64_t count = 0;
  std::vector<float> x, y, z;            ///< Camera frame, metres.
  std::vector<std::int32_t> pixel;       ///< v * cols + u.
  std::vector<std::uint8_t> label;       ///< Nearest bone, 1 to 24; 0: there is no bone.
  std::vector<float> squared_distance;   ///< To that bone itself; infinite if there is none.
  std::vector<std::int32_t> tile_start;  ///< First point of each tile, then `count`.
  PixelBox box;                          ///< Around all pixels.
  std::vector<std::uint8_t> mask;        ///< Of one row of tiles, while they are collected.
  /// Makes room for an image of so many pixels.
  void resize(std::int64_t num_rows, std::int64_t num_cols);
};

/// Collects the pixels of a person. With a body index (as RgbdFrame::body_index, or null) those of
/// its number; if the skeleton has none, those of any body within the depths of the joints;
/// without a body index all within these depths.
/// @throws InputError  sizes of depth and rays differ; an option out of range.
void find_person(const DepthView& depth, const std::uint8_t* body_index, const Skeleton& skeleton,
                 const PixelRays& rays, const PersonMaskOptions& options, PersonPoints& points);

/// Each point gets the label of the bone whose skin is nearest, in standard deviations: the least
/// (|P - Q| - r) / s, with Q the point of the bone nearest to P, r the bone's radius there, and s
/// of what girths differ by among people (a tenth) and joints are off (1 cm), 1 / s linear between
/// the bone's ends. The lower label if two are as near. The same bits on every CPU. A bone without
/// length is a point; none tapers by more than its length.
///
/// Without radii this is Voronoi segmentation (dissertation eq. 4.1). With the projection t clamped
/// to [0, 1], eq. 4.1's three cases are one: |P - (P_c + t (P_r - P_c))|. Bones that cannot be
/// nearest to any point of a tile are passed over.
void segment_bones(const BoneSegments& bones, PersonPoints& points);

}  // namespace manip3d
