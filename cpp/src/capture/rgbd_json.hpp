#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "manip3d/geometry/rgbd_frame.hpp"
#include "parse/json_place.hpp"

/// @file
/// JSON of the data that recordings store besides images. Numbers are exact: floats are written
/// with the digits that a double needs; numbers that JSON lacks are "nan", "inf" or "-inf".
namespace manip3d {

/// {"depth": CAMERA, "registration": {"colour": CAMERA, "rotation": [9], "translation": [3]}} with
/// CAMERA {"width", "height", "fx", "fy", "cx", "cy", "distortion": [5], "mirrored", "rays"}.
/// `rays` is the ray table, float32 little endian in base64; it and `registration` may be absent.
JsonPlace::Json calibration_to_json(const RgbdCalibration& calibration);

/// Reads a calibration. Cameras stay as stored, and may be mirrored (see unmirrored()).
/// @throws FormatError  with the value found and its place.
std::shared_ptr<RgbdCalibration> calibration_from_json(const JsonPlace& place);

/// [{"id", "body", "positions": [75], "orientations": [100], "states": [25]}]
JsonPlace::Json skeletons_to_json(const std::vector<Skeleton>& skeletons);

/// @throws FormatError  with the value found and its place.
void skeletons_from_json(const JsonPlace& place, std::vector<Skeleton>& skeletons);

}  // namespace manip3d
