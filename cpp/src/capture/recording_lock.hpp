#pragma once

#include <filesystem>

#include "manip3d/io/descriptor.hpp"

namespace manip3d {

/// A lock (`flock`) on the file or folder of a recording, which says who reads and who writes it.
/// The lock ends with its process; on file systems without locks it has no effect.
class RecordingLock {
 public:
  enum class For { kReading, kWriting };

  /// Many may read at once. Who reads while somebody writes gets no lock, and is not refused.
  /// @throws InputError  to write: somebody reads or writes it, in this process or another.
  /// @throws std::filesystem::filesystem_error  it is not there, and the like.
  RecordingLock(const std::filesystem::path& path, For purpose);

  void release();
  /// Reads on after `release`.
  void hold();

 private:
  Descriptor descriptor_;
};

}  // namespace manip3d
