#pragma once

#include "io/output.hpp"
#include "manip3d/files/byte_source.hpp"
#include "manip3d/io/point_file.hpp"

/// @file
/// Readers and writers of the formats of point files; point_file.cpp dispatches to them.
namespace manip3d {

/// Bytes that a point takes in memory at least: floats x, y, z, intensity.
constexpr std::int64_t kPointMemory = 16;

PointTable read_kitti(ByteSource& source, const Progress& progress);
void write_kitti(Output& output, const PointTableView& table);
PointTable read_nuscenes(ByteSource& source, const Progress& progress);
void write_nuscenes(Output& output, const PointTableView& table);

PointTable read_pcd(ByteSource& source, const Progress& progress);
void write_pcd(Output& output, const PointTableView& table);

PointTable read_ply_points(ByteSource& source, const Progress& progress);
void write_ply_points(Output& output, const PointTableView& table);

PointTable read_3dtk(ByteSource& source, const Progress& progress);
void write_3dtk(Output& output, const PointTableView& table);

PointTable read_text_points(ByteSource& source, const Progress& progress);
void write_text_points(Output& output, const PointTableView& table);

}  // namespace manip3d
