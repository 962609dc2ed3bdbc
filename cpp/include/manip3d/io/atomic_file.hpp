#pragma once

#include <cstddef>
#include <filesystem>

#include "manip3d/io/descriptor.hpp"

/// @file
/// Files that appear whole or not at all.
namespace manip3d {

/// Writes a file under a temporary name in the same folder and renames it at `commit()`.
///
/// Until `commit()` returns, the target is the old file, whole; without a commit (an exception, a
/// full disk) the temporary file is removed, and after a kill by the next write to its folder.
/// `commit()` syncs the file, renames it and syncs the folder. A symbolic link is followed; its
/// target is replaced. A target that is not a regular file (a pipe) is written in place.
/// The mode of a replaced file is kept.
/// @throws std::filesystem::filesystem_error  the operating system refused, with the target's path.
class AtomicFile {
 public:
  explicit AtomicFile(const std::filesystem::path& target);
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;
  ~AtomicFile();

  /// Appends `size` bytes.
  void write(const char* data, std::size_t size);
  /// Makes sure that what was written is on the disk: a full one is an error before `commit()`.
  void sync();
  /// Gives the file its name; nothing can be written afterwards.
  /// @param sync  false: the file is whole after a crash of this process, but perhaps not after a
  ///              power failure.
  void commit(bool sync = true);
  /// The path of the content until `commit()`; empty: the target is written in place.
  [[nodiscard]] const std::filesystem::path& temporary() const { return temporary_; }

 private:
  [[noreturn]] void refuse(const char* action) const;

  std::filesystem::path requested_;  ///< As the caller named it, for messages.
  std::filesystem::path target_;
  std::filesystem::path temporary_;  ///< Empty when written in place.
  bool is_synced_ = false;           ///< Nothing was written since `sync()`.
  Descriptor file_;                  ///< Locked: see Temporary.
  Descriptor lock_;                  ///< Holds the lock while `file_` is closed.
};

}  // namespace manip3d
