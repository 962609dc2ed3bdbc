#include "capture/recording_lock.hpp"

#include <fcntl.h>
#include <sys/file.h>

#include <cerrno>
#include <system_error>

#include "manip3d/error.hpp"

namespace manip3d {

RecordingLock::RecordingLock(const std::filesystem::path& path, For purpose)
    : descriptor_(::open(path.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC)) {
  if (!descriptor_.is_open()) {
    throw std::filesystem::filesystem_error("cannot open", path,
                                            std::error_code(errno, std::generic_category()));
  }
  const int how = purpose == For::kReading ? LOCK_SH : LOCK_EX;
  if (::flock(descriptor_.get(), how | LOCK_NB) == 0) return;
  if (purpose == For::kReading || errno != EWOULDBLOCK) return;
  throw InputError("path: expected a recording that nobody has open, got " + path.string() +
                   ", which is being read or recorded");
}

void RecordingLock::hold() { static_cast<void>(::flock(descriptor_.get(), LOCK_SH | LOCK_NB)); }

void RecordingLock::release() { static_cast<void>(::flock(descriptor_.get(), LOCK_UN)); }

}  // namespace manip3d
