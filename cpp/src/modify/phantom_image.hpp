#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/range_image.hpp"
#include "manip3d/modify/phantom_pipeline.hpp"

/// @file
/// The person with one limb taken away and the mirrored other one drawn in: dissertation section
/// 4.3.1, and 4.7.1 for legs.
namespace manip3d {

/// Two pixels whose depths differ by less show one surface; also the reach of a limb's own skin.
inline constexpr float kSameSurface = 0.05F;  // metres

/// Is it a bone of the spine below the neck, or one to a hip?
bool is_trunk(std::uint8_t bone);

/// The fate of a person's pixel when the limb is taken out.
enum class Removal : std::uint8_t {
  kNone,
  kRemoved,       ///< Taken out, as a part of the limb.
  kPassedOver,    ///< Looked at, and left.
  kPerhapsCloth,  ///< Passes the weak test of loose cloth.
  kSurelyCloth    ///< Passes the strong one too.
};

/// Borrowed images of one size, row by row.
struct PhantomImage {
  std::int64_t rows = 0, cols = 0;
  float* depth = nullptr;         ///< Metres; 0: nothing.
  std::uint8_t* label = nullptr;  ///< Bone; 0: none. Phantom pixels have the affected limb's.
  PixelKind* kind = nullptr;
  std::int32_t* source = nullptr;  ///< (rows, cols, 2) row i, column j of the texture; or -1, -1.
  float* source_depth = nullptr;   ///< Depth of the point that is seen there, metres.
  Removal* removal = nullptr;
};

/// The inverse of PixelRays, to the nearest pixel.
class PixelProjector {
 public:
  /// `rays` are those of the camera, and borrowed.
  PixelProjector(const Intrinsics& camera, const PixelRays& rays);
  /// v * width + u, or -1 where the image does not reach.
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

/// Calls use(pixel) for those above, below and beside a pixel, with -1 beyond the border.
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

/// Takes out the points of a limb: those of its label within `radius` of its bone and `flesh` of
/// its skin. How many.
std::int64_t remove_limb(const PersonPoints& points, Limb limb, double radius, double flesh,
                         const PhantomImage& image);

/// Takes out what the removal leaves of a limb where it hangs on nothing but what was taken out: a
/// hand 20 cm from where the tracker says it is. Pixels that are side by side within 5 cm of depth
/// hang together. `stack` has rows * cols numbers. How many.
std::int64_t remove_rest(const PersonPoints& points, Limb limb, const PhantomImage& image,
                         std::vector<std::int32_t>& stack);

/// Draws holes again, as the body: connected pixels that were taken out within 40 cm of a leg's
/// root, show nothing now, and have the body along half of their border or more. Unlike
/// give_back(), it goes by the shape of the hole, not by the distance to a bone. Returns the number
/// of pixels.
std::int64_t give_back_holes(const PersonPoints& points, Limb limb, const BoneSegments& bones,
                             const PixelRays& rays, const PhantomImage& image,
                             std::vector<std::int32_t>& stack);

/// Draws single points again, as the body: those of the limb that was taken out, where nothing is
/// drawn now, within `reach` of the skin of a bone that is not the limb's. The lap between two
/// thighs belongs to either. Returns the number of points.
std::int64_t give_back(const PersonPoints& points, Limb limb, const BoneSegments& bones,
                       double reach, const PhantomImage& image);

/// Draws points of the limb that was taken out as the phantom's, where nothing is drawn now: those
/// within `reach` of the skin that the intact limb's bones have on the other side of the plane. A
/// camera that sees the inner side of one leg sees the outer side of the other, so that the
/// mirrored points leave open a strip of the very limb whose place they take. `mirror` is a
/// reflection. Returns the number of points.
std::int64_t fill_from_limb(const PersonPoints& points, Limb limb, const BoneSegments& bones,
                            const Mirror& mirror, double reach, const PhantomImage& image);

/// Gives points of a leg that lie beyond the plane of symmetry to the nearest bone of the other
/// leg. A tracker may put the joints of one seated leg into the flesh of the other, which would
/// then be taken out. What is nearest to a bone that is itself across by more than its radius
/// stays: legs may be crossed. If the leg is there, all stays unless it has so many points more
/// than the other one: where only the plane is off, each leg has its own. Returns the number of
/// points.
/// @param given  memory for as many numbers as there are points.
std::int64_t keep_to_side(Limb leg, bool is_there, const BoneSegments& bones,
                          const BodyFrame& frame, PersonPoints& points, const PhantomImage& image,
                          std::vector<std::int32_t>& given);

struct MirroredPoint {
  float x, y, z;        ///< Mirrored.
  float source_depth;   ///< Depth of the point itself,
  std::int32_t source;  ///< and its pixel.
  std::uint8_t label;   ///< Bone on the mirrored side.
  bool faces_camera;    ///< False if mirroring turned its surface away.
  bool only_removed;    ///< Drawn only where something was taken out.
};

/// Mirrors the points of the intact limb that are within `radius` of its bones and `flesh` of their
/// skins. Their normals are
/// those of the depth around them in `image`.
void mirror_limb(const PersonPoints& points, Limb intact, double radius, double flesh,
                 const PixelRays& rays, const Mirror& mirror, const PhantomImage& image,
                 std::vector<MirroredPoint>& mirrored);

using BoneSet = std::array<bool, kNumJoints>;

/// Bones of the body that a limb may hide: the trunk, and an arm the thighs on which its hand lies.
BoneSet bones_behind(Limb limb);

/// Mirrors what is left of the body on the root's side of the plane n, within `radius` of it, and
/// beyond it of the bones `behind`, to be drawn only where something was taken out.
void mirror_around_root(const PersonPoints& points, const Eigen::Vector3f& root, double radius,
                        const BodyFrame& frame, const Mirror& mirror, const BoneSet& behind,
                        const PhantomImage& image, std::vector<MirroredPoint>& mirrored);

/// Draws mirrored points into the pixels nearest to their projections: those that face the camera
/// where nothing is nearer, then the others where there is nothing or the body is 2 cm behind. What
/// is left of the limb itself (a stump) counts as nearer up to 5 cm behind. Returns the box of what
/// was drawn.
PixelBox write_phantom(const std::vector<MirroredPoint>& mirrored, Limb affected,
                       const PixelProjector& projector, const PhantomImage& image);

/// Draws mirrored points where there is nothing. Returns the box of what was drawn.
PixelBox write_root(const std::vector<MirroredPoint>& mirrored, const PixelProjector& projector,
                    const PhantomImage& image);

/// Where mirroring pulls neighbours of one surface apart, by up to 6 pixels, draws the straight
/// line between them in the pixels that show nothing, or the body 2 cm behind: their source is the
/// nearer one's. Mirroring a grazing surface into a frontal one leaves gaps that the filling of
/// holes, which looks one pixel to either side, cannot close. `mirrored` as written before;
/// `scratch` has rows * cols numbers. Returns the box of what was drawn.
PixelBox bridge_gaps(const std::vector<MirroredPoint>& mirrored, Limb affected,
                     const PixelProjector& projector, const PhantomImage& image,
                     std::vector<std::int32_t>& scratch);

struct HoleFill {
  std::int32_t pixel;
  float depth, source_depth;
  std::int32_t row, col;  ///< Source.
  std::uint8_t label;
};

/// Fills empty pixels of the box that have something to the left and right or above and below, or,
/// within two pixels, on all four sides (a hole of 2 x 2 pixels has no pixel with opposite
/// neighbours), and the phantom in one such pair: depth is the mean of the neighbours there are,
/// all as they were before; the source is the mean of the pair's, the phantom's if only one is of
/// it. How many. Pixels without a ray stay empty. Filled ones become of the kind. `fills` is
/// scratch memory.
std::int64_t fill_holes(const PixelBox& box, const PixelRays& rays, const PhantomImage& image,
                        std::vector<HoleFill>& fills, PixelKind kind = PixelKind::kFilled);

/// Lists the pixels of the box that show the phantom. `pixels` keeps its memory.
void list_phantom(const PixelBox& box, const PhantomImage& image,
                  std::vector<std::int32_t>& pixels);

/// Fills empty pixels that showed the phantom in the frame before and have three or more of their
/// eight neighbours in it now: its border is ragged by a pixel, elsewhere in each frame. Depth is
/// the mean of the neighbours on the nearest surface; texture and label are those of the first
/// of them. `fills` is scratch memory. Returns the box of what was filled.
PixelBox fill_remembered(const std::vector<std::int32_t>& before, const PixelRays& rays,
                         const PhantomImage& image, std::vector<HoleFill>& fills);

}  // namespace manip3d
