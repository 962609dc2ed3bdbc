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

/// @throws InputError  an option out of range.
void check_options(const PersonMaskOptions& options);

/// The pixels of one person as points, tile by tile of 8 x 8 pixels. Memory is kept for reuse.
struct PersonPoints {
  std::int64_t rows = 0, cols = 0;  ///< Shape of the image.
  std::int64_t count = 0;
  std::vector<float> x, y, z;            ///< Camera frame, metres.
  std::vector<std::int32_t> pixel;       ///< v * cols + u.
  std::vector<std::uint8_t> label;       ///< Nearest bone, 1 to 24; 0: there is no bone.
  std::vector<float> squared_distance;   ///< To that bone itself; infinite if there is none.
  std::vector<float> skin_distance;      ///< To its skin: negative within.
  std::vector<std::int32_t> tile_start;  ///< First point of each tile, then `count`.
  PixelBox box;                          ///< Around all pixels.
  std::vector<std::uint8_t> mask;        ///< Pixels of the image, in rows of whole tiles.
  /// Makes room for all pixels of an image, so that no memory is asked for later.
  void resize(std::int64_t num_rows, std::int64_t num_cols);
  /// Room for points is made when they are counted.
  void set_shape(std::int64_t num_rows, std::int64_t num_cols);
  void make_room(std::int64_t num_points);
};

/// Collects the pixels of a person. With a body index (as RgbdFrame::body_index, or null) those of
/// its number; if the skeleton has none, those of any body within the depths of the joints;
/// without a body index all within these depths.
/// @throws InputError  sizes of depth and rays differ; an option out of range.
void find_person(const DepthView& depth, const std::uint8_t* body_index, const Skeleton& skeleton,
                 const PixelRays& rays, const PersonMaskOptions& options, PersonPoints& points);

/// Each point gets the label of the bone whose skin is nearest: the lower one if two are as near.
///
/// With Q the point of the bone nearest to P, r the bone's radius there, e = |P - Q| - r the
/// distance to the skin, and s the standard deviation of what girths differ by among people (a
/// tenth of r) and joints are off (s_0 = 1 cm), the least max(e s_0 / s, e - 3 (s - s_0)) counts:
/// standard deviations, but from three of them on metres, as a joint is wrong then, and not a
/// girth. 1 / s and s are taken to be linear between a bone's ends. A bone without length is a
/// point; none tapers by more than its length. The same bits on every CPU.
///
/// Without radii this is Voronoi segmentation (dissertation eq. 4.1). With the projection t clamped
/// to [0, 1], eq. 4.1's three cases are one: |P - (P_c + t (P_r - P_c))|. Bones that cannot be
/// nearest to any point of a tile are passed over.
void segment_bones(const BoneSegments& bones, PersonPoints& points);

}  // namespace manip3d
