#pragma once

#include <cstddef>
#include <filesystem>

#include "manip3d/files/descriptor.hpp"

/// @file
/// Files that are written completely or not at all.
namespace manip3d {

/// Writes a file under a temporary name in the same folder and renames it at `commit()`.
///
/// Until `commit()` returns, the target is the complete old file. Without a commit (an exception, a
/// full disk) the temporary file is removed by the destructor; after a kill, the next write to its
/// folder removes it. `commit()` syncs the file, renames it and syncs the folder. If the target is
/// a symbolic link, the file that it names is replaced. A target that is not a regular file (a
/// pipe) is written in place. The mode of a replaced file is kept.
/// @throws std::filesystem::filesystem_error  (with the target's path) the operating system
///                                            refused.
class AtomicFile {
 public:
  explicit AtomicFile(const std::filesystem::path& target);
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;
  ~AtomicFile();

  /// Appends `size` bytes.
  void write(const char* data, std::size_t size);
  /// Syncs the bytes written so far, so that a full disk is an error before `commit()`.
  void sync();
  /// Renames the file to the target. Nothing can be written afterwards.
  /// @param sync  false: the file is complete after a crash of this process, but perhaps not after
  ///              a power failure.
  void commit(bool sync = true);
  /// Like `commit()`, unless a file has the target's name already. Returns false in this case: the
  /// file that is there is unchanged, and the temporary one stays until the destructor.
  bool commit_new();
  /// Removes the target again after `commit_new()`. Until the destructor, the target is locked
  /// (flock), by which other processes can see that this may happen.
  void withdraw();
  /// Path of the content before `commit()`; empty: the target is written in place.
  [[nodiscard]] const std::filesystem::path& temporary() const { return temporary_; }

 private:
  void close(bool sync);
  void sync_folder() const;
  [[noreturn]] void refuse(const char* action) const;

  std::filesystem::path requested_;  ///< The target as the caller named it, for messages.
  std::filesystem::path target_;
  std::filesystem::path temporary_;  ///< Empty: the target is written in place.
  bool is_synced_ = false;           ///< Nothing was written since `sync()`.
  bool is_withdrawable_ = false;     ///< The target is the file of `commit_new()`.
  Descriptor file_;                  ///< Locked; see Temporary.
  Descriptor lock_;                  ///< Holds the lock while `file_` is closed.
};

}  // namespace manip3d
