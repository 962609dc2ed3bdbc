#pragma once

#include "io/output.hpp"
#include "manip3d/io/byte_source.hpp"
#include "manip3d/io/point_file.hpp"

/// @file
/// One reader and one writer per format of point files; point_file.cpp dispatches to them.
namespace manip3d {

PointTable read_kitti(ByteSource& source, const Progress& progress);
void write_kitti(Output& output, const PointTableView& table);

}  // namespace manip3d
