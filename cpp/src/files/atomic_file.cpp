#include "manip3d/files/atomic_file.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <system_error>
#include <utility>

#include "manip3d/files/byte_source.hpp"
#include "manip3d/files/temporary.hpp"

namespace manip3d {
namespace fs = std::filesystem;
namespace {

constexpr int kMaxLinks = 40;  // the kernel's limit of symbolic links in a path

// Follows links, even if the last one points to a file that does not exist yet.
fs::path follow_links(fs::path path) {
  std::error_code ignored;
  for (int i = 0; i < kMaxLinks && fs::is_symlink(fs::symlink_status(path, ignored)); ++i) {
    const fs::path next = fs::read_symlink(path, ignored);
    if (ignored) break;
    path = next.is_absolute() ? next : path.parent_path() / next;
  }
  return path;
}

fs::path folder_of(const fs::path& file) {
  return file.has_parent_path() ? file.parent_path() : fs::path(".");
}

// Renames a file. Returns false if this is refused; EEXIST: another file has the new name.
bool rename_to_new(const fs::path& from, const fs::path& to) {
  if (::renameat2(AT_FDCWD, from.c_str(), AT_FDCWD, to.c_str(), RENAME_NOREPLACE) == 0) return true;
  if (errno != EINVAL && errno != ENOSYS) return false;
  // The file system (NFS, for one) has no such renames: an empty file claims the name.
  const Descriptor claim(::open(to.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600));
  if (!claim.is_open()) return false;
  if (::rename(from.c_str(), to.c_str()) == 0) return true;
  const int reason = errno;
  ::unlink(to.c_str());
  errno = reason;
  return false;
}

}  // namespace

AtomicFile::AtomicFile(const fs::path& target) : requested_(target), target_(follow_links(target)) {
  check_no_nul(target);
  struct ::stat status{};
  const bool exists = ::stat(target_.c_str(), &status) == 0;
  if (exists && !S_ISREG(status.st_mode)) {
    file_ = Descriptor(::open(target_.c_str(), O_WRONLY | O_CLOEXEC));
    if (!file_.is_open()) refuse("cannot open");
    return;
  }
  try {
    // The temporary file is private from the beginning, because the replaced file may be.
    Temporary made =
        make_temporary(folder_of(target_), TemporaryKind::kFile, exists ? 0600U : 0666U);
    temporary_ = std::move(made.path);
    file_ = std::move(made.lock);
  } catch (const std::system_error& error) {
    throw fs::filesystem_error("cannot create a temporary file beside it", requested_,
                               error.code());
  }
  // File systems without modes (FAT) refuse this, which is ignored because the content matters
  // more.
  if (exists) static_cast<void>(::fchmod(file_.get(), status.st_mode & 07777U));
}

AtomicFile::~AtomicFile() {
  if (!temporary_.empty()) ::unlink(temporary_.c_str());  // while it is still locked
}

void AtomicFile::write(const char* data, std::size_t size) {
  is_synced_ = false;
  while (size > 0) {
    const ssize_t written = ::write(file_.get(), data, size);
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) refuse("cannot write");
    data += written;
    size -= static_cast<std::size_t>(written);
  }
}

void AtomicFile::sync() {
  if (is_synced_ || temporary_.empty()) return;
  if (::fsync(file_.get()) != 0) refuse("cannot sync");
  is_synced_ = true;
}

void AtomicFile::commit(bool sync) {
  close(sync);
  if (temporary_.empty()) return;
  if (::rename(temporary_.c_str(), target_.c_str()) != 0) refuse("cannot rename");
  temporary_.clear();
  if (sync) sync_folder();
}

bool AtomicFile::commit_new() {
  close(true);
  if (temporary_.empty()) return true;
  if (!rename_to_new(temporary_, target_)) {
    if (errno == EEXIST) return false;
    refuse("cannot rename");
  }
  temporary_.clear();
  is_withdrawable_ = true;
  sync_folder();
  return true;
}

void AtomicFile::withdraw() {
  if (is_withdrawable_) ::unlink(target_.c_str());
  is_withdrawable_ = false;
}

void AtomicFile::close(bool sync) {
  if (sync) this->sync();
  // Closing reports late errors. The duplicate keeps the lock until the file has its name.
  if (!temporary_.empty()) {
    lock_ = Descriptor(::fcntl(file_.get(), F_DUPFD_CLOEXEC, 0));
    if (!lock_.is_open()) refuse("cannot close");
  }
  if (::close(file_.release()) != 0) refuse("cannot close");
}

void AtomicFile::sync_folder() const {
  const Descriptor folder(::open(folder_of(target_).c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!folder.is_open()) return;  // no permission to list it, but the rename is done
  // Some network file systems cannot sync a folder and say so with EINVAL.
  if (::fsync(folder.get()) != 0 && errno != EINVAL) refuse("cannot sync the folder of");
}

void AtomicFile::refuse(const char* action) const {
  throw fs::filesystem_error(action, requested_, std::error_code(errno, std::generic_category()));
}

}  // namespace manip3d
