#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/modify/body_bones.hpp"
#include "manip3d/modify/segmentation.hpp"
#include "modify/vertical.hpp"

namespace manip3d {

/// Drops points that are not the person's, where no body index tells that: those of the floor,
/// those far from the skin of every bone, and those that no surface joins to points near a skin.
///
/// @param points  as find_person() collects them; they are labelled by the way.
/// @param bones  of the person, with radii; without any nothing is dropped.
/// @param affected  of the affected limb nothing is asked for beyond its clothes: where it is
///                  missing there are chairs.
/// @param clothes  thickness of these, metres.
/// @param stack  memory, of as many elements as there are pixels.
void drop_surroundings(const DepthView& depth, const BoneSegments& bones, Limb affected,
                       float clothes, const std::optional<FloorPlane>& floor, PersonPoints& points,
                       std::vector<std::int32_t>& stack);

}  // namespace manip3d
