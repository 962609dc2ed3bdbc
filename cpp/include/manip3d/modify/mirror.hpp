#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"

namespace manip3d {

/// The person's own axes (dissertation eq. 4.2 for arms, 4.8 for legs): x_s towards the person's
/// left, y_s up the spine, z_s = x_s x y_s; and n = y_s x z_s, which is x_s made orthogonal to
/// the spine. (n, y_s, z_s) are orthonormal; x_s need not be orthogonal to y_s.
struct BodyFrame {
  Eigen::Vector3d origin;  ///< SpineMid for arms, SpineBase for legs.
  Eigen::Vector3d n, x, y, z;
};

/// Return the axes; no value if a joint is not usable, the joints of an axis are within 5 cm of
/// each other, the axes within 6 degrees of each other, or the origin less than 10 cm in front of
/// the camera or behind it.
std::optional<BodyFrame> body_frame(const Skeleton& skeleton, Limb limb);

enum class MirrorMode : std::uint8_t {
  kReflection,  ///< I - 2 n n^T through the origin: an isometry.
  kPaper,       ///< M^-1 diag(-1, 1, 1) M, M's rows x_s, y_s, z_s: oblique, eq. 4.3 to 4.7.
  kImage        ///< Left and right exchanged in the image, about the origin's column: "2d".
};

/// p -> linear p + offset: an involution, so it undoes itself.
struct Mirror {
  Eigen::Matrix3d linear = Eigen::Matrix3d::Identity();
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();
  [[nodiscard]] Eigen::Vector3d operator()(const Eigen::Vector3d& p) const {
    return linear * p + offset;
  }
};

Mirror make_mirror(const BodyFrame& frame, MirrorMode mode);

/// Return the skeleton with the joints of the intact limb mirrored to the other limb. An
/// orientation (w, x, y, z) in the skeleton's frame (n, y_s, z_s) becomes (w, x, -y, -z); states
/// are copied. Other joints do not change.
Skeleton with_mirrored_limb(const Skeleton& skeleton, Limb affected, const BodyFrame& frame,
                            const Mirror& mirror);

}  // namespace manip3d
