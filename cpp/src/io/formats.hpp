#pragma once

#include <filesystem>
#include <set>
#include <string>
#include <system_error>
#include <vector>

#include "io/output.hpp"
#include "manip3d/files/byte_source.hpp"
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
  std::set<std::string>& taken;  ///< Names in its folder that no companion can have.
};

/// Another process wrote a file with the name of a companion meanwhile. `WriteJob::taken` has the
/// name, and writing again chooses another one.
class NameTaken : public std::filesystem::filesystem_error {
 public:
  explicit NameTaken(const std::filesystem::path& path)
      : filesystem_error("cannot create", path, std::make_error_code(std::errc::file_exists)) {}
};

/// Writes a file and its companions, again if another process took the name of a companion.
/// @param write  Called with the file and `WriteJob::taken`.
template <typename Write>
void write_with_companions(const std::filesystem::path& path, Compression compression,
                           const Progress& progress, const Write& write) {
  std::set<std::string> taken;
  while (true) {
    Output output(path, compression, progress);
    try {
      write(output, taken);
    } catch (const NameTaken&) {
      if (output.is_in_place()) throw;  // a pipe has the names already
      continue;
    }
    return output.commit();
  }
}

void write_obj(Output& output, const WriteJob& job);
void write_ply(Output& output, const WriteJob& job);
void write_off(Output& output, const WriteJob& job);
void write_stl(Output& output, const WriteJob& job);
void write_gltf(Output& output, const WriteJob& job);
void write_glb(Output& output, const WriteJob& job);

}  // namespace manip3d
