#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>

#include "manip3d/geometry/grid_mesh.hpp"
#include "manip3d/geometry/range_image.hpp"
#include "manip3d/simplify/cs3_reading.hpp"

namespace manip3d {

enum class Cs3Importance : std::uint8_t {
  kLaplacian,     ///< Trace of the Hessian, signed (eq. 3.5).
  kMinCurvature,  ///< |smaller eigenvalue of the Hessian|, the signed minimum (eq. 3.6).
};

enum class Cs3Sampling : std::uint8_t {
  kNonMaximum,       ///< Suppression of non-maxima along the principal directions (eq. 3.7).
  kImportanceOrder,  ///< By decreasing importance; each point blocks a square (eq. 3.8).
};

struct Cs3Options {
  std::int64_t target_points = 0;  ///< n; the result has between 99 % of it and n points.
  Cs3Importance importance = Cs3Importance::kMinCurvature;
  Cs3Sampling sampling = Cs3Sampling::kImportanceOrder;
  /// Multiply Rd by R(u) / R_max (eq. 3.9); only for depth images.
  bool distance_dependent = false;
  /// Triangles with a longer edge are dropped: the check for scenes in section 3.4.
  double max_edge = std::numeric_limits<double>::infinity();
  int num_threads = 0;  ///< 0: all cores.
  Cs3Reading reading;   ///< Readings other than the default are slower.
};

/// Way in which the number of points was reached.
enum class Cs3Reached : std::uint8_t {
  kFactor,  ///< By a factor on Rd_max (on s for kNonMaximum), to within 1 %.
  /// By cutting off at n, because no factor gives so few: points whose Rd rounds to 0 block no
  /// pixel.
  kCut,
  /// By adding the most important remaining points, because every factor gives either fewer or more
  /// than n.
  kContinued,
  kAllPixels,  ///< The image has at most n valid pixels.
};

enum class Cs3Stage : std::uint8_t { kImportance, kOrder, kSampling, kTriangulation, kOutput };
inline constexpr int kNumCs3Stages = 5;
inline constexpr std::array<const char*, kNumCs3Stages> kCs3StageNames = {
    "importance", "order", "sampling", "triangulation", "output"};

struct Cs3Report {
  std::int64_t num_vertices = 0;
  std::int64_t num_faces = 0;
  Cs3Reached reached = Cs3Reached::kFactor;
  double factor = 1.0;  ///< Factor on Rd_max (s) of the result.
  /// Number of points with factor 1, as printed. Not computed if distance_dependent: eq. 3.9 gives
  /// so many points (sixteen times the target on a scene with a far corner) that counting them
  /// takes longer than the whole search.
  std::optional<std::int64_t> literal_count;
  int passes = 0;  ///< Number of samplings in the search for the factor.
  std::array<double, kNumCs3Stages> seconds{};
};

struct Cs3Result {
  DepthMesh mesh;
  Cs3Report report;
};

/// CS3: curvature-sensitive surface simplification of a range image (dissertation, chapter 3).
///
/// V(u) is the vertex map, N(u) its normals by forward differences and A(u) = |N| / (|V12|^2
/// |V13|^2) (eq. 3.1, 3.2). The importance Omega(u) comes from the Hessian of A (eq. 3.3 to 3.6)
/// and is truncated to 14 significant bits; pixels are sorted by it, ties by pixel index. w and h
/// in s = Rd_max = sqrt(w h / n) are the sides of the box around the valid pixels. The chosen
/// points are triangulated by GridDelaunay. A triangle is kept if the pixel nearest to its centroid
/// is valid and no edge is longer than max_edge (section 3.4).
///
/// By the printed rule, a square of radius Rd is 2 Rd + 1 wide, and only about half of n points are
/// chosen. Therefore a factor on Rd_max is searched for which gives n points within 1 %
/// (Cs3Reached).
///
/// The text leaves choices open (Cs3Reading). Of the 144 combinations (`manip3d reproduce
/// readings-3`), the default is the one whose mean errors at 5 % exceed the printed ones of table
/// 3.4 least; it treats no pixels as outliers. Errors in 1e-3 of the diagonal, sampled by area:
///     bun000              0.71, printed 0.629, all readings 0.70 to 1.80
///     happyStandRight_0   0.54, printed 0.663, all readings 0.54 to 1.08
///     dragonStandRight_0  0.90, printed 0.694 for another scan, all readings 0.90 to 1.56
///
/// Points never move, so texture coordinates are exact. The result does not depend on the number of
/// threads. An object keeps its memory from frame to frame: with caller-owned buffers and one
/// thread, it allocates nothing after the largest frame so far.
class Cs3 {
 public:
  Cs3();
  Cs3(Cs3&&) noexcept;
  Cs3& operator=(Cs3&&) noexcept;
  ~Cs3();

  /// @param registration  Registration of the image of the UVs; null: that image has the same
  ///                      pixels.
  /// @param out           Capacity: at least min(target_points, number of pixels). It may be a
  ///                      mapped buffer of a GPU, because it is written in order; vertices are read
  ///                      back only if there is a max_edge.
  /// @throws InputError   an option out of range, as RangeImage::load_row, a capacity too small.
  Cs3Report run(const RangeImage& image, const Cs3Options& options,
                const Registration* registration, const DepthMeshBuffers& out);

 private:
  struct Workspace;
  std::unique_ptr<Workspace> workspace_;
};

/// CS3 of a single image.
Cs3Result simplify_cs3(const RangeImage& image, const Cs3Options& options,
                       const Registration* registration = nullptr);

}  // namespace manip3d
