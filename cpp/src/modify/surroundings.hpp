#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/modify/body_bones.hpp"
#include "manip3d/modify/segmentation.hpp"
#include "modify/vertical.hpp"

namespace manip3d {

/// Drop points that do not belong to the person, when there is no body index: points of the floor,
/// points far from the skin of every bone, and points that no surface connects to points near a
/// skin.
///
/// @param points    Points that find_person() collected; they are labelled as a side effect.
/// @param bones     Bones of the person. If they have no radii, nothing is dropped.
/// @param affected  Points of the affected limb are kept only within the thickness of its clothes,
///                  because chairs may be in the place of a missing limb.
/// @param clothes   This thickness, metres.
/// @param stack     Memory for as many elements as there are pixels.
void drop_surroundings(const DepthView& depth, const BoneSegments& bones, Limb affected,
                       float clothes, const std::optional<FloorPlane>& floor, PersonPoints& points,
                       std::vector<std::int32_t>& stack);

}  // namespace manip3d
