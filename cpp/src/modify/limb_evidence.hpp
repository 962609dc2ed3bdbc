#pragma once

#include <cstdint>

#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"
#include "modify/phantom_image.hpp"

namespace manip3d {

/// May the person have a limb where the tracker sees it?
///
/// A tracker that was made for whole people invents the joints of a limb that is not there, and
/// says that it sees them. The depth image refutes a tracked joint if the camera looks through it:
/// nothing of the person is at its depth, and nothing at all is nearer. A bone that is much longer
/// than that of the other limb is refuted too. One refuted joint refutes the limb. `body_index` may
/// be null: then whatever is at a joint's depth counts as the person.
bool may_have_limb(const Skeleton& person, Limb limb, const DepthView& depth,
                   const std::uint8_t* body_index, const PixelProjector& projector);

}  // namespace manip3d
