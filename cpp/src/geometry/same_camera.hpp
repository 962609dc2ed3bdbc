#pragma once

#include "manip3d/geometry/camera.hpp"

namespace manip3d {

/// Whether two cameras have the same parameters and the same ray table (by address).
inline bool same_camera(const Intrinsics& a, const Intrinsics& b) {
  return a.width == b.width && a.height == b.height && a.fx == b.fx && a.fy == b.fy &&
         a.cx == b.cx && a.cy == b.cy && a.distortion == b.distortion &&
         a.ray_table == b.ray_table && a.mirrored == b.mirrored;
}

}  // namespace manip3d
