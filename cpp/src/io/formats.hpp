#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "io/output.hpp"
#include "manip3d/io/byte_source.hpp"
#include "manip3d/io/mesh_file.hpp"
#include "manip3d/io/scene_file.hpp"

/// @file
/// Readers and writers of the formats. The table in mesh_file.cpp dispatches to them.
namespace manip3d {

ReadResult read_obj(ByteSource& source, const ReadOptions& options, const Progress& progress);
ReadResult read_ply(ByteSource& source, const ReadOptions& options, const Progress& progress);
ReadResult read_off(ByteSource& source, const ReadOptions& options, const Progress& progress);
ReadResult read_stl(ByteSource& source, const ReadOptions& options, const Progress& progress);
/// Reads .gltf and .glb.
ReadResult read_gltf(ByteSource& source, const ReadOptions& options, const Progress& progress);

Scene read_gltf_scene(ByteSource& source, const ReadOptions& options, const Progress& progress);

/// Arguments of a writer.
struct WriteJob {
  const MeshView& mesh;
  const std::vector<Material>& materials;
  const WriteOptions& options;
  const std::filesystem::path& path;  ///< Path of the file, for formats that need several files.
  std::vector<std::string>& warnings;
};

void write_obj(Output& output, const WriteJob& job);
void write_ply(Output& output, const WriteJob& job);
void write_off(Output& output, const WriteJob& job);
void write_stl(Output& output, const WriteJob& job);
void write_gltf(Output& output, const WriteJob& job);
void write_glb(Output& output, const WriteJob& job);

}  // namespace manip3d
