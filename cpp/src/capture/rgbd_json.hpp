#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "manip3d/geometry/rgbd_frame.hpp"
#include "parse/json_place.hpp"

/// @file
/// What recordings keep beside the images, as JSON. Numbers are exact: floats are written with as
/// many digits as a double needs; what JSON cannot say is "nan", "inf" or "-inf".
namespace manip3d {

/// {"depth": CAMERA, "registration": {"colour": CAMERA, "rotation": [9], "translation": [3]}} with
/// CAMERA {"width", "height", "fx", "fy", "cx", "cy", "distortion": [5], "mirrored", "rays"}.
/// `rays` is the ray table, float32 little endian in base64; it and `registration` may be absent.
JsonPlace::Json calibration_to_json(const RgbdCalibration& calibration);

/// Cameras are read as stored, and may be mirrored (see unmirrored()).
/// @throws FormatError  with what stands where.
std::shared_ptr<RgbdCalibration> calibration_from_json(const JsonPlace& place);

/// [{"id", "body", "positions": [75], "orientations": [100], "states": [25]}]
JsonPlace::Json skeletons_to_json(const std::vector<Skeleton>& skeletons);

/// @throws FormatError  with what stands where.
void skeletons_from_json(const JsonPlace& place, std::vector<Skeleton>& skeletons);

}  // namespace manip3d
