#pragma once

#include <cstdint>
#include <filesystem>

#include "manip3d/io/descriptor.hpp"

/// @file
/// Temporary names beside a target, which a killed process cannot leave behind for good.
namespace manip3d {

enum class TemporaryKind : std::uint8_t { kFile, kFolder };

/// A new file or folder `.manip3d-N` that belongs to the caller as long as `lock` is open.
struct Temporary {
  std::filesystem::path path;
  Descriptor lock;  ///< The file (open for writing) or folder, locked with flock.
};

/// Makes the one with the lowest N that is free, and removes those whose writer is dead: of all
/// writers of this library, whoever holds the lock of a name is alive.
/// @param mode  permissions of the new file or folder; the process's mask is applied.
/// @throws std::system_error  the operating system refused.
Temporary make_temporary(const std::filesystem::path& folder, TemporaryKind kind, unsigned mode);

/// Gives a folder the name `target`; what had that name gets the old one of `made`. At once, where
/// the file system can exchange names; elsewhere a kill may leave `target` without a folder.
/// @throws std::filesystem::filesystem_error  the operating system refused, with the target's path.
void replace_folder(const std::filesystem::path& made, const std::filesystem::path& target);

}  // namespace manip3d
