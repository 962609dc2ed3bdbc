#pragma once

#include <filesystem>

#include "manip3d/files/descriptor.hpp"

namespace manip3d {

/// A lock (`flock`) on the file or folder of a recording, shared by readers and exclusive for a
/// writer. It ends with its process, and has no effect on file systems without locks.
class RecordingLock {
 public:
  enum class For { kReading, kWriting };

  /// Many may read at once. A reader gets no lock while somebody writes, but is not refused.
  /// @throws InputError  for writing: the recording is open in another reader or writer, in this
  ///                     process or another one.
  /// @throws std::filesystem::filesystem_error  for example, the path does not exist.
  RecordingLock(const std::filesystem::path& path, For purpose);

  void release();
  /// Locks for reading again after `release`.
  void hold();

 private:
  Descriptor descriptor_;
};

}  // namespace manip3d
