#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/range_image.hpp"
#include "manip3d/modify/phantom_pipeline.hpp"

/// @file
/// Images of the person in which one limb is replaced by the mirror image of the other one:
/// dissertation section 4.3.1, and 4.7.1 for legs.
namespace manip3d {

/// Two neighbouring pixels whose depths differ by less are on one surface.
inline constexpr float kSameSurface = 0.05F;  // metres

/// Whether a bone belongs to the spine below the neck or leads to a hip.
bool is_spine_or_hip(std::uint8_t bone);

/// The outcome for a person's pixel when the limb was removed.
enum class Removal : std::uint8_t {
  kNone,
  kRemoved,       ///< Removed as part of the limb.
  kExamined,      ///< Examined; it is kept unless its kind is kNone.
  kPerhapsCloth,  ///< Passes the weak test of loose cloth.
  kSurelyCloth    ///< Passes the strong test as well.
};

/// Borrowed images of one size, row by row.
struct PhantomImage {
  std::int64_t rows = 0, cols = 0;
  float* depth = nullptr;  ///< Metres; 0: nothing.
  /// Bone; 0: none. Pixels of the phantom have labels of the affected limb.
  std::uint8_t* label = nullptr;
  PixelKind* kind = nullptr;
  std::int32_t* source = nullptr;  ///< (rows, cols, 2) row i, column j of the texture; or -1, -1.
  float* source_depth = nullptr;   ///< Measured depth at the source pixel, metres.
  Removal* removal = nullptr;
};

/// The inverse of PixelRays: projects points to the nearest pixel.
class PixelProjector {
 public:
  /// `rays` must be those of the camera, and are borrowed.
  PixelProjector(const Intrinsics& camera, const PixelRays& rays);
  /// v * width + u; -1 outside the image.
  [[nodiscard]] std::int32_t pixel(float x, float y, float z) const;

 private:
  const PixelRays* rays_;
  float fx_, fy_, cx_, cy_;
  std::int32_t width_, height_;
};

/// Empties the images and draws the person.
void draw_person(const PersonPoints& points, const PhantomImage& image);

/// Removes a pixel: empties it and marks it as removed.
void take_out(std::int32_t pixel, const PhantomImage& image);

/// Calls use(pixel) for the four neighbours of a pixel; -1 stands for one outside the image.
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

/// Removes the points of a limb: those with its label within `radius` of its bone and `flesh` of
/// its skin. Returns their number.
std::int64_t remove_limb(const PersonPoints& points, Limb limb, double radius, double flesh,
                         const PhantomImage& image);

/// Removes the rest of a limb if it is connected only to removed pixels, like a hand 20 cm from its
/// place according to the tracker. Neighbouring pixels are connected if their depths differ by less
/// than 5 cm. `stack` must have room for rows * cols numbers. Returns the number of removed pixels.
std::int64_t remove_rest(const PersonPoints& points, Limb limb, const PhantomImage& image,
                         std::vector<std::int32_t>& stack);

/// Restores holes in the body: connected removed pixels within 40 cm of a leg's root that show
/// nothing, if at least half of their border is body. Unlike give_back(), the shape of the hole
/// decides and not the distance to a bone. Returns the number of pixels.
std::int64_t give_back_holes(const PersonPoints& points, Limb limb, const BoneSegments& bones,
                             const PixelRays& rays, const PhantomImage& image,
                             std::vector<std::int32_t>& stack);

/// Restores single points of the body: points of the removed limb, where the image is empty, within
/// `reach` of the skin of a bone of another part. (The lap between two thighs may belong to
/// either.) Returns the number of points.
std::int64_t give_back(const PersonPoints& points, Limb limb, const BoneSegments& bones,
                       double reach, const PhantomImage& image);

/// Draws points of the removed limb as parts of the phantom where the image is empty: those whose
/// mirror images are within `reach` of the skin of the intact limb. A camera that sees the inner
/// side of one leg sees the outer side of the other, so that mirrored points leave a strip of the
/// phantom empty at which the removed limb was measured. `mirror` must be a reflection. Returns the
/// number of points.
std::int64_t fill_from_limb(const PersonPoints& points, Limb limb, const BoneSegments& bones,
                            const Mirror& mirror, double reach, const PhantomImage& image);

/// Assigns points of a leg that lie beyond the plane of symmetry to the nearest bone of the other
/// leg. A tracker may place the joints of one seated leg inside the other leg, whose points would
/// then be removed. Points keep their label if the nearest place of their bone is itself beyond the
/// plane by more than its radius, because legs may be crossed. If the leg is present, nothing
/// changes unless it has at least that many points more than the other leg: with equal numbers,
/// each leg has its own points and the plane is wrong. Returns the number of points.
/// @param given  Memory for as many numbers as there are points.
std::int64_t keep_to_side(Limb leg, bool is_there, const BoneSegments& bones,
                          const BodyFrame& frame, PersonPoints& points, const PhantomImage& image,
                          std::vector<std::int32_t>& given);

struct MirroredPoint {
  float x, y, z;        ///< Mirrored.
  float source_depth;   ///< Depth of the point before mirroring, metres.
  std::int32_t source;  ///< Pixel of that point.
  std::uint8_t label;   ///< Bone on the mirrored side.
  bool faces_camera;    ///< False if mirroring turned its surface away from the camera.
  bool only_removed;    ///< Drawn only at removed pixels.
};

/// Mirrors the points of the intact limb that are within `radius` of its bones and `flesh` of their
/// skins. Their normals come from the depths around them in `image`. `mirror` must be its own
/// inverse, because `mirror.offset` is taken as the place that is mirrored to the camera.
void mirror_limb(const PersonPoints& points, Limb intact, double radius, double flesh,
                 const PixelRays& rays, const Mirror& mirror, const PhantomImage& image,
                 std::vector<MirroredPoint>& mirrored);

using BoneSet = std::array<bool, kNumJoints>;

/// Bones that a limb may hide: those of the trunk, and for an arm also the thighs, on which its
/// hand may lie.
BoneSet bones_behind(Limb limb);

/// Mirrors points of the body on the root's side of the plane: those within `radius` of the root
/// and those of the bones `behind`. Farther than `radius` from the root, they are drawn only at
/// removed pixels.
void mirror_around_root(const PersonPoints& points, const Eigen::Vector3f& root, double radius,
                        const BodyFrame& frame, const Mirror& mirror, const BoneSet& behind,
                        const PhantomImage& image, std::vector<MirroredPoint>& mirrored);

struct DrawnPhantom {
  PixelBox box;                  ///< Box of the drawn pixels.
  std::int64_t num_outside = 0;  ///< Mirrored points outside the image.
};

/// Draws mirrored points into the pixels nearest to their projections: first points that face the
/// camera, where nothing is nearer, then the others, where the pixel is empty or the body is at
/// least 2 cm behind. Remaining pixels of the limb itself (a stump) count as 5 cm nearer than they
/// are.
DrawnPhantom write_phantom(const std::vector<MirroredPoint>& mirrored, Limb affected,
                           const PixelProjector& projector, const PhantomImage& image);

/// Draws mirrored points into empty pixels. Returns the box of the drawn pixels.
PixelBox write_root(const std::vector<MirroredPoint>& mirrored, const PixelProjector& projector,
                    const PhantomImage& image);

/// Closes gaps of up to 6 pixels that mirroring opens between neighbouring points of one surface.
/// Draws the straight line between the two points into pixels that are empty or whose body is at
/// least 2 cm behind; their source is that of the nearer end. Mirroring a grazing surface into a
/// frontal one leaves gaps that fill_holes(), which looks at most two pixels to either side, cannot
/// close. `mirrored` as passed to write_phantom(); `scratch` must have room for rows * cols
/// numbers. Returns the box of the drawn pixels.
PixelBox bridge_gaps(const std::vector<MirroredPoint>& mirrored, Limb affected,
                     const PixelProjector& projector, const PhantomImage& image,
                     std::vector<std::int32_t>& scratch);

struct HoleFill {
  std::int32_t pixel;
  float depth, source_depth;
  std::int32_t row, col;  ///< Source.
  std::uint8_t label;
};

/// Fills empty pixels of the box between two opposite neighbours that are not empty, of which at
/// least one shows the phantom. If neither pair of direct neighbours qualifies, pixels with
/// neighbours within two pixels on all four sides are filled as well, because a hole of 2 x 2
/// pixels has no opposite direct neighbours. The depth is the mean of the neighbours before
/// filling. The source is the mean of the pair's sources; if only one of the pair is of the
/// phantom, it is that one's. Pixels without a ray stay empty. Filled pixels get `kind`. `fills` is
/// scratch memory. Returns the number of filled pixels.
std::int64_t fill_holes(const PixelBox& box, const PixelRays& rays, const PhantomImage& image,
                        std::vector<HoleFill>& fills, PixelKind kind = PixelKind::kFilled);

/// Lists the pixels of the box that show the phantom. `pixels` keeps its memory.
void list_phantom(const PixelBox& box, const PhantomImage& image,
                  std::vector<std::int32_t>& pixels);

/// Fills empty pixels that showed the phantom in the previous frame and have at least three of
/// their eight neighbours in the current phantom, because its border is ragged by a pixel and
/// changes from frame to frame. The depth is the mean of the neighbours on the nearest surface;
/// texture and label are those of the first of them. `fills` is scratch memory. Returns the box of
/// the filled pixels.
PixelBox fill_remembered(const std::vector<std::int32_t>& before, const PixelRays& rays,
                         const PhantomImage& image, std::vector<HoleFill>& fills);

}  // namespace manip3d
