#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/range_image.hpp"
#include "manip3d/modify/phantom_pipeline.hpp"

/// @file
/// Images of the person without one limb and with the mirrored opposite limb: dissertation section
/// 4.3.1, for legs 4.7.1.
namespace manip3d {

/// Neighbouring pixels whose depths differ by less than this (metres) show one surface.
inline constexpr float kSameSurface = 0.05F;

/// Is the bone one of the spine below the neck, or one to a hip?
bool is_trunk(std::uint8_t bone);

/// State of a person's pixel while the limb is removed.
enum class Removal : std::uint8_t {
  kNone,
  kRemoved,       ///< Removed as a part of the limb.
  kPassedOver,    ///< Visited, and not removed so far.
  kPerhapsCloth,  ///< Passes the weak test for loose cloth.
  kSurelyCloth    ///< Passes the strong test for loose cloth, too.
};

/// Borrowed images of one size, row by row.
struct PhantomImage {
  std::int64_t rows = 0, cols = 0;
  float* depth = nullptr;         ///< Metres; 0: nothing.
  std::uint8_t* label = nullptr;  ///< Bone; 0: none. Phantom pixels have the affected limb's.
  PixelKind* kind = nullptr;
  std::int32_t* source = nullptr;  ///< (rows, cols, 2) row i, column j of the texture; or -1, -1.
  float* source_depth = nullptr;   ///< Depth of the measured point at the source, metres.
  Removal* removal = nullptr;
};

/// The inverse of PixelRays: projects points to the nearest pixel.
class PixelProjector {
 public:
  /// @param rays  rays of the camera; borrowed.
  PixelProjector(const Intrinsics& camera, const PixelRays& rays);
  /// Returns v * width + u, or -1 outside of the image.
  [[nodiscard]] std::int32_t pixel(float x, float y, float z) const;

 private:
  const PixelRays* rays_;
  float fx_, fy_, cx_, cy_;
  std::int32_t width_, height_;
};

/// Empties the images and draws the person.
void draw_person(const PersonPoints& points, const PhantomImage& image);

/// Empties a pixel.
void take_out(std::int32_t pixel, const PhantomImage& image);

/// Calls use(neighbour) for the four neighbours of a pixel, with -1 for those beyond the border.
template <typename Use>
void for_each_neighbor(std::int32_t pixel, const PhantomImage& image, const Use& use) {
  const auto cols = static_cast<std::int32_t>(image.cols);
  const auto size = cols * static_cast<std::int32_t>(image.rows);
  const std::int32_t u = pixel % cols;
  use(u > 0 ? pixel - 1 : -1);
  use(u + 1 < cols ? pixel + 1 : -1);
  use(pixel >= cols ? pixel - cols : -1);
  use(pixel + cols < size ? pixel + cols : -1);
}

/// Removes the points of a limb: those with its label, within `radius` of its bone and within
/// `flesh` of its skin (metres).
/// @return  the number of points.
std::int64_t remove_limb(const PersonPoints& points, Limb limb, double radius, double flesh,
                         const PhantomImage& image);

/// Removes remaining points of a limb that are connected to removed points but not to the rest of
/// the body, for example a hand 20 cm from the tracked hand. Neighbouring pixels are connected if
/// their depths differ by less than kSameSurface.
/// @param stack  scratch memory for rows * cols numbers.
/// @return  the number of points.
std::int64_t remove_rest(const PersonPoints& points, Limb limb, const PhantomImage& image,
                         std::vector<std::int32_t>& stack);

/// Restores holes in the body: connected pixels that were removed within 40 cm of a leg's root, are
/// empty now, and have the body along at least half of their border. Unlike give_back(), the shape
/// of the hole decides, not the distance from a bone.
/// @return  the number of pixels.
std::int64_t give_back_holes(const PersonPoints& points, Limb limb, const BoneSegments& bones,
                             const PixelRays& rays, const PhantomImage& image,
                             std::vector<std::int32_t>& stack);

/// Restores single points as the body: points of the removed limb at empty pixels that are within
/// `reach` metres of the skin of another bone. The lap between two thighs belongs to both.
/// @return  the number of points.
std::int64_t give_back(const PersonPoints& points, Limb limb, const BoneSegments& bones,
                       double reach, const PhantomImage& image);

/// Draws points of the removed limb as the phantom at empty pixels, if they are within `reach`
/// metres of the mirrored skin of the intact limb. A camera that sees the inner side of one leg
/// sees the outer side of the other: the mirrored points leave a strip of the phantom open that the
/// removed limb shows.
/// @param mirror  a reflection.
/// @return  the number of points.
std::int64_t fill_from_limb(const PersonPoints& points, Limb limb, const BoneSegments& bones,
                            const Mirror& mirror, double reach, const PhantomImage& image);

/// Relabels points of a leg that lie beyond the plane of symmetry with the nearest bone of the
/// other leg. A tracker may put the joints of one seated leg into the flesh of the other, whose
/// points would then be removed. Points near a bone that is itself beyond the plane by more than
/// its radius keep their label, because legs may be crossed.
/// @param is_there  the person has both legs. Nothing is relabelled then if more points lie beyond
///                  the plane than this leg has more than the other: the plane is wrong, not the
///                  labels.
/// @param given  scratch memory for as many numbers as there are points.
/// @return  the number of points.
std::int64_t keep_to_side(Limb leg, bool is_there, const BoneSegments& bones,
                          const BodyFrame& frame, PersonPoints& points, const PhantomImage& image,
                          std::vector<std::int32_t>& given);

struct MirroredPoint {
  float x, y, z;        ///< Mirrored point, metres.
  float source_depth;   ///< Depth of the original point, metres.
  std::int32_t source;  ///< Pixel of the original point.
  std::uint8_t label;   ///< Bone on the mirrored side.
  bool faces_camera;    ///< False if mirroring turned its surface away.
  bool only_removed;    ///< It may be drawn only at removed pixels.
};

/// Mirrors the points of the intact limb that are within `radius` of its bones and `flesh` of their
/// skins (metres). Whether they face the camera follows from normals of the depth in `image`.
void mirror_limb(const PersonPoints& points, Limb intact, double radius, double flesh,
                 const PixelRays& rays, const Mirror& mirror, const PhantomImage& image,
                 std::vector<MirroredPoint>& mirrored);

using BoneSet = std::array<bool, kNumJoints>;

/// Bones of the body that a limb may hide: the trunk, and for an arm also the legs, on which its
/// hand may lie.
BoneSet bones_behind(Limb limb);

/// Mirrors the remaining body on the root's side of the plane of symmetry: points within `radius`
/// metres of the root, and farther ones with a bone in `behind`, which may be drawn only at removed
/// pixels.
void mirror_around_root(const PersonPoints& points, const Eigen::Vector3f& root, double radius,
                        const BodyFrame& frame, const Mirror& mirror, const BoneSet& behind,
                        const PhantomImage& image, std::vector<MirroredPoint>& mirrored);

/// Draws mirrored points into the pixels nearest to their projections: first those that face the
/// camera, where nothing is nearer, then the others, at empty pixels and where the body is more
/// than 2 cm behind. A remaining part of the limb itself (a stump) also hides points up to 5 cm
/// before it.
/// @return  the box of the drawn pixels.
PixelBox write_phantom(const std::vector<MirroredPoint>& mirrored, Limb affected,
                       const PixelProjector& projector, const PhantomImage& image);

/// Draws mirrored points at empty pixels. Returns the box of the drawn pixels.
PixelBox write_root(const std::vector<MirroredPoint>& mirrored, const PixelProjector& projector,
                    const PhantomImage& image);

/// Bridges gaps of the phantom: if two neighbouring pixels of one surface are up to 6 pixels apart
/// after mirroring, draws the straight line between them, at empty pixels and where the body is
/// more than 2 cm behind. Such gaps appear where a surface that the camera sees at a grazing angle
/// is mirrored to one that it sees from the front; fill_holes() is too short-sighted for them.
/// @param mirrored  as written by write_phantom().
/// @param scratch   memory for rows * cols numbers.
/// @return  the box of the drawn pixels.
PixelBox bridge_gaps(const std::vector<MirroredPoint>& mirrored, Limb affected,
                     const PixelProjector& projector, const PhantomImage& image,
                     std::vector<std::int32_t>& scratch);

struct HoleFill {
  std::int32_t pixel;
  float depth, source_depth;
  std::int32_t row, col;  ///< Source.
  std::uint8_t label;
};

/// Fills empty pixels of the box between two opposite drawn neighbours (left and right, or above
/// and below), at least one of which shows the phantom. If there is no such pair, neighbours within
/// two pixels on all four sides do as well, since a hole of 2 x 2 pixels has no pixel with opposite
/// neighbours. All pixels are filled from the image before the call. Depth is the mean of the drawn
/// neighbours. The source is the mean of the pair's sources, or that of the phantom's pixel if only
/// one of the pair shows the phantom. Pixels without a ray stay empty.
/// @param fills  output: the filled pixels, which get the kind `kind`.
/// @return  the number of filled pixels.
std::int64_t fill_holes(const PixelBox& box, const PixelRays& rays, const PhantomImage& image,
                        std::vector<HoleFill>& fills, PixelKind kind = PixelKind::kFilled);

/// Lists the pixels of the box that show the phantom. `pixels` keeps its memory.
void list_phantom(const PixelBox& box, const PhantomImage& image,
                  std::vector<std::int32_t>& pixels);

/// Fills empty pixels that showed the phantom in the previous frame and have three or more of their
/// eight neighbours in it now. This steadies the border, whose pixels would appear and disappear
/// from frame to frame. Depth is the mean of the neighbours on the nearest surface; texture and
/// label are those of the first of these neighbours.
/// @param fills  output: the filled pixels.
/// @return  the box of the filled pixels.
PixelBox fill_remembered(const std::vector<std::int32_t>& before, const PixelRays& rays,
                         const PhantomImage& image, std::vector<HoleFill>& fills);

}  // namespace manip3d
