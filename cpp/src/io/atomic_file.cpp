#include "manip3d/io/atomic_file.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <string>
#include <system_error>

namespace manip3d {
namespace fs = std::filesystem;
namespace {

constexpr int kMaxLinks = 40;  // as the kernel's limit on symbolic links in one path

// Follows links even when the last one points to a file that does not exist yet.
fs::path follow_links(fs::path path) {
  std::error_code ignored;
  for (int i = 0; i < kMaxLinks && fs::is_symlink(fs::symlink_status(path, ignored)); ++i) {
    const fs::path next = fs::read_symlink(path, ignored);
    if (ignored) break;
    path = next.is_absolute() ? next : path.parent_path() / next;
  }
  return path;
}

// What open() would give a new file; reading the mask means setting it.
mode_t new_file_mode(const struct ::stat* existing) {
  if (existing != nullptr) return existing->st_mode & 07777U;
  const mode_t mask = ::umask(0);
  ::umask(mask);
  return 0666U & ~mask;
}

}  // namespace

AtomicFile::AtomicFile(const fs::path& target) : requested_(target), target_(follow_links(target)) {
  struct ::stat status{};
  const bool exists = ::stat(target_.c_str(), &status) == 0;
  if (exists && !S_ISREG(status.st_mode)) {
    descriptor_ = ::open(target_.c_str(), O_WRONLY | O_CLOEXEC);
    if (descriptor_ < 0) refuse("cannot open");
    return;
  }
  std::string name = (target_.parent_path() / ".manip3d-XXXXXX").string();
  descriptor_ = ::mkostemp(name.data(), O_CLOEXEC);
  if (descriptor_ < 0) refuse("cannot create a temporary file beside it");
  temporary_ = name;
  // A file system without modes (FAT) refuses; the content matters more.
  static_cast<void>(::fchmod(descriptor_, new_file_mode(exists ? &status : nullptr)));
}

AtomicFile::~AtomicFile() {
  if (descriptor_ >= 0) ::close(descriptor_);
  if (!temporary_.empty()) ::unlink(temporary_.c_str());
}

void AtomicFile::write(const char* data, std::size_t size) {
  while (size > 0) {
    const ssize_t written = ::write(descriptor_, data, size);
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) refuse("cannot write");
    data += written;
    size -= static_cast<std::size_t>(written);
  }
}

void AtomicFile::commit(bool sync) {
  const bool in_place = temporary_.empty();
  if (sync && !in_place && ::fsync(descriptor_) != 0) refuse("cannot sync");
  const int descriptor = descriptor_;
  descriptor_ = -1;
  if (::close(descriptor) != 0) refuse("cannot close");
  if (in_place) return;
  if (::rename(temporary_.c_str(), target_.c_str()) != 0) refuse("cannot rename");
  temporary_.clear();
  if (!sync) return;
  const fs::path folder = target_.parent_path().empty() ? fs::path(".") : target_.parent_path();
  const int folder_descriptor = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (folder_descriptor < 0) return;  // no permission to list it: the rename itself is done
  const int result = ::fsync(folder_descriptor);
  const int error = errno;
  ::close(folder_descriptor);
  errno = error;
  // Some network file systems cannot sync a folder and say so with EINVAL.
  if (result != 0 && error != EINVAL) refuse("cannot sync the folder of");
}

void AtomicFile::refuse(const char* action) const {
  throw fs::filesystem_error(action, requested_, std::error_code(errno, std::generic_category()));
}

}  // namespace manip3d
