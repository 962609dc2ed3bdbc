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
  double near = 0.3, far = 8.0;  ///< Metres; pixels outside this range belong to nobody.
  /// Without a body index: metres by which a pixel of the person may lie outside the range of
  /// depths of the joints.
  double margin = 0.35;
};

/// @throws InputError  an option out of range.
void check_options(const PersonMaskOptions& options);

/// The pixels of one person as points, ordered by tiles of 8 x 8 pixels. Memory is kept for reuse.
struct PersonPoints {
  std::int64_t rows = 0, cols = 0;  ///< Shape of the image.
  std::int64_t count = 0;
  std::vector<float> x, y, z;            ///< Camera frame, metres.
  std::vector<std::int32_t> pixel;       ///< v * cols + u.
  std::vector<std::uint8_t> label;       ///< Nearest bone, 1 to 24; 0: none.
  std::vector<float> squared_distance;   ///< To the line of that bone; infinite if there is none.
  std::vector<float> skin_distance;      ///< To the skin of that bone; negative inside.
  std::vector<std::int32_t> tile_start;  ///< First point of each tile, then `count`.
  PixelBox box;                          ///< Bounding box of all pixels.
  /// The person's pixels as a mask of the image, in rows of whole tiles.
  std::vector<std::uint8_t> mask;
  /// Reserves memory for all pixels of an image, so that later calls allocate nothing.
  void resize(std::int64_t num_rows, std::int64_t num_cols);
  /// Sets the shape of the image; make_room() makes room for points once they are counted.
  void set_shape(std::int64_t num_rows, std::int64_t num_cols);
  void make_room(std::int64_t num_points);
};

/// Collect the pixels of a person. With a body index (as RgbdFrame::body_index, or null): the
/// pixels of the skeleton's body number; if the skeleton has no number, the pixels of any body
/// within the depths of the joints. Without a body index: all pixels within these depths.
/// @throws InputError  sizes of depth and rays differ; an option out of range.
void find_person(const DepthView& depth, const std::uint8_t* body_index, const Skeleton& skeleton,
                 const PixelRays& rays, const PersonMaskOptions& options, PersonPoints& points);

/// Label each point with the bone whose skin is nearest; the lower bone if two are equally near.
///
/// Q is the point of the bone nearest to P, r the radius of the bone there, and e = |P - Q| - r the
/// distance to the skin. s is the standard deviation of e: girths differ between people by a tenth
/// of r, and joints are off by s_0 = 1 cm. The bone with the smallest max(e s_0 / s, e - 3 (s -
/// s_0)) is taken. Up to three standard deviations this compares standard deviations, beyond them
/// metres, because such a distance comes from a wrong joint and not from a girth. 1 / s and s are
/// approximated as linear between the ends of a bone. A bone without length is a point; no bone
/// tapers by more than its length. The result has the same bits on every CPU.
///
/// Without radii this is Voronoi segmentation (dissertation eq. 4.1). If the projection t is
/// clamped to [0, 1], the three cases of eq. 4.1 become one: |P - (P_c + t (P_r - P_c))|. Bones
/// that cannot be nearest to any point of a tile are skipped.
void segment_bones(const BoneSegments& bones, PersonPoints& points);

/// The labels of a person's points as an image, in row-major order.
struct LabelImage {
  std::vector<std::uint8_t> labels;  ///< Nearest bone, 1 to 24; 0: none, or not the person.
  std::vector<float> distances;  ///< Metres to the line of that bone; infinite if there is none.
};

LabelImage label_image(const PersonPoints& points);

}  // namespace manip3d
