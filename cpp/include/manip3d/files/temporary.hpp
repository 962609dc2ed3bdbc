#pragma once

#include <cstdint>
#include <filesystem>

#include "manip3d/files/descriptor.hpp"

/// @file
/// Temporary files beside a target, which are removed later even if their writer is killed.
namespace manip3d {

enum class TemporaryKind : std::uint8_t { kFile, kFolder };

/// A new file or folder `.manip3d-N`, which belongs to the caller while `lock` is open.
struct Temporary {
  std::filesystem::path path;
  Descriptor lock;  ///< The file (open for writing) or folder, locked with flock.
};

/// Makes a temporary file or folder with the lowest free N, and removes those of dead writers,
/// after it has restored what replace_folder was replacing in them. A writer is alive while it
/// holds the lock of its file; all writers of this library take it.
/// @param mode  Permissions of the new file or folder, before the process's umask is applied.
/// @throws std::system_error  the operating system refused.
Temporary make_temporary(const std::filesystem::path& folder, TemporaryKind kind, unsigned mode);

/// Renames a folder to `target`. An existing target becomes a part of the temporary folder, for the
/// caller to remove. This is atomic if the file system can exchange names; otherwise `target` is
/// missing if the process is killed, until the next make_temporary beside it restores the old one.
/// @param made  In a folder of make_temporary beside `target`.
/// @throws std::filesystem::filesystem_error  (with the target's path) the operating system
///                                            refused; an existing target is unchanged.
void replace_folder(const std::filesystem::path& made, const std::filesystem::path& target);

}  // namespace manip3d
