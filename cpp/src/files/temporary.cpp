#include "manip3d/files/temporary.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <optional>
#include <string>
#include <system_error>

namespace manip3d {
namespace fs = std::filesystem;
namespace {

// The search for files of dead writers ends after this many missing names in a row. Concurrent
// writers take higher numbers, and the gaps that they leave are shorter than this.
constexpr int kGap = 16;

// Folder within a temporary folder: replace_folder keeps the old target in it, under its name,
// while no folder has the target's name.
constexpr const char* kReplaced = "old";

fs::path name_of(const fs::path& folder, int number) {
  return folder / (".manip3d-" + std::to_string(number));
}

[[noreturn]] void refuse(const char* action) {
  throw std::system_error(errno, std::generic_category(), action);
}

Descriptor open_folder(const fs::path& path) {
  return Descriptor(::open(path.c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC));
}

// Is the descriptor's file still the one with this name?
bool is_there(const fs::path& path, const Descriptor& file) {
  struct ::stat mine{}, named{};
  return ::fstat(file.get(), &mine) == 0 && ::lstat(path.c_str(), &named) == 0 &&
         mine.st_ino == named.st_ino && mine.st_dev == named.st_dev;
}

// Creates the file or folder; none: the name is taken.
std::optional<Descriptor> create(const fs::path& path, TemporaryKind kind, unsigned mode) {
  if (kind == TemporaryKind::kFile) {
    Descriptor file(::open(path.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, mode));
    if (file.is_open()) return file;
  } else if (::mkdir(path.c_str(), mode) == 0) {
    Descriptor folder = open_folder(path);
    if (folder.is_open()) return folder;
    if (errno == ENOENT) return std::nullopt;  // another writer removed it before it was locked
  }
  if (errno != EEXIST) refuse("cannot write into its folder");
  return std::nullopt;
}

// Locks a file that this process has just created at `path`. Returns false if another writer took
// it for a file of a dead process before it was locked, and removed it.
bool lock_new(const fs::path& path, const Descriptor& file) {
  while (::flock(file.get(), LOCK_EX) != 0) {
    // a file system without locks, on which nobody removes the file
    if (errno != EINTR) return true;
  }
  return is_there(path, file);
}

Descriptor open_existing(const fs::path& path) {
  constexpr int kFlags = O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC;
  Descriptor file(::open(path.c_str(), O_RDWR | kFlags));
  if (file.is_open() || errno == ENOENT) return file;
  return Descriptor(::open(path.c_str(), O_RDONLY | kFlags));  // a folder or a read-only file
}

bool is_named(const fs::path& path) {
  return fs::symlink_status(path).type() != fs::file_type::not_found;
}

// Gives a target back its old name if its writer died before the new folder had the name.
// @throws fs::filesystem_error  the operating system refused.
void restore_replaced(const fs::path& temporary) {
  const fs::path kept = temporary / kReplaced;
  if (!fs::is_directory(fs::symlink_status(kept))) return;
  for (const fs::directory_entry& old : fs::directory_iterator(kept)) {
    const fs::path target = temporary.parent_path() / old.path().filename();
    if (!is_named(target)) fs::rename(old.path(), target);
  }
}

enum class Found : std::uint8_t { kNothing, kAlive, kDead };

// Finds out whether a writer that is alive holds the lock of the temporary file at `path`; if not,
// restores what the dead writer was replacing, and removes the file.
Found reap(const fs::path& path) {
  const Descriptor file = open_existing(path);
  if (!file.is_open()) return errno == ENOENT ? Found::kNothing : Found::kAlive;
  struct ::stat status{};
  if (::fstat(file.get(), &status) != 0) return Found::kAlive;
  if (!S_ISREG(status.st_mode) && !S_ISDIR(status.st_mode)) return Found::kAlive;
  if (::flock(file.get(), LOCK_EX | LOCK_NB) != 0 || !is_there(path, file)) return Found::kAlive;
  try {
    restore_replaced(path);
    fs::remove_all(path);
  } catch (const fs::filesystem_error&) {
    return Found::kAlive;
  }
  return Found::kDead;
}

void reap_from(const fs::path& folder, int number) {
  for (int missing = 0; missing < kGap; ++number) {
    missing = reap(name_of(folder, number)) == Found::kNothing ? missing + 1 : 0;
  }
}

}  // namespace

Temporary make_temporary(const fs::path& folder, TemporaryKind kind, unsigned mode) {
  for (int number = 0;;) {
    const fs::path path = name_of(folder, number);
    std::optional<Descriptor> made = create(path, kind, mode);
    if (!made) {
      if (reap(path) == Found::kAlive) ++number;
    } else if (lock_new(path, *made)) {
      reap_from(folder, number + 1);
      return {path, std::move(*made)};
    }
  }
}

void replace_folder(const fs::path& made, const fs::path& target) {
  const auto rename = [&](const fs::path& from, const fs::path& to, unsigned flags) {
    return ::renameat2(AT_FDCWD, from.c_str(), AT_FDCWD, to.c_str(), flags) == 0;
  };
  if (rename(made, target, RENAME_NOREPLACE)) return;
  if (errno == EEXIST && rename(made, target, RENAME_EXCHANGE)) return;
  if (errno == EINVAL || errno == ENOSYS) {  // the file system cannot exchange names
    const fs::path kept = made.parent_path() / kReplaced;
    const fs::path old = kept / target.filename();
    std::error_code failed;
    fs::create_directory(kept, failed);
    const bool is_moved = rename(target, old, 0);
    if ((is_moved || errno == ENOENT) && rename(made, target, 0)) return;
    const int reason = errno;
    if (is_moved) rename(old, target, 0);
    errno = reason;
  }
  throw fs::filesystem_error("cannot rename", target,
                             std::error_code(errno, std::generic_category()));
}

}  // namespace manip3d
