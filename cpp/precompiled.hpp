// Headers that most files include. In a unity build CMake compiles them once for each target. Each
// file still includes what it uses: other builds have no such header. Ours are those that bindings
// include, too: GCC warns of what stands in them there, here it takes them for others'.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <numeric>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"
