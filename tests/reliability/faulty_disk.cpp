// Preloaded into a program: the n-th call that changes something below a folder fails, with the
// error that was asked for, as on a disk that is full or broken.
#include <dlfcn.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

#include <cerrno>
#include <climits>
#include <cstdarg>
#include <cstdio>
#include <cstring>

namespace {

char folder[PATH_MAX] = "";
long calls = 0;    // since arm()
long failing = 0;  // 0: none
int error_number = 0;
bool stays_broken = false;  // all calls from that one on

template <typename Function>
Function* next(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_NEXT, name));
}

bool is_below(const char* path) {
  const size_t length = strlen(folder);
  return length > 0 && strncmp(path, folder, length) == 0;
}

bool is_below(int fd) {
  if (folder[0] == '\0') return false;
  char link[64], path[PATH_MAX];
  snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  const ssize_t length = readlink(link, path, sizeof path - 1);
  if (length <= 0) return false;
  path[length] = '\0';
  return is_below(path);
}

/// Does this call fail?
template <typename Where>
bool fails(Where where) {
  const int before = errno;
  const bool counts = is_below(where);
  errno = before;
  if (!counts) return false;
  ++calls;
  if (calls != failing && !(stays_broken && failing > 0 && calls > failing)) return false;
  errno = error_number;
  return true;
}

}  // namespace

extern "C" {

/// From now on the n-th call below `below` fails; n = 0: none does. Returns the calls since the
/// last time.
long arm(const char* below, long n, int error, int stays) {
  const long counted = calls;
  snprintf(folder, sizeof folder, "%s", below);
  calls = 0, failing = n, error_number = error, stays_broken = stays != 0;
  return counted;
}

#define MANIP3D_OPEN(name)                                                 \
  int name(const char* path, int flags, ...) {                             \
    va_list rest;                                                          \
    va_start(rest, flags);                                                 \
    const mode_t mode = va_arg(rest, mode_t);                              \
    va_end(rest);                                                          \
    if ((flags & (O_CREAT | O_WRONLY | O_RDWR)) && fails(path)) return -1; \
    return next<int(const char*, int, ...)>(#name)(path, flags, mode);     \
  }
MANIP3D_OPEN(open)
MANIP3D_OPEN(open64)

#define MANIP3D_OPENAT(name)                                                    \
  int name(int at, const char* path, int flags, ...) {                          \
    va_list rest;                                                               \
    va_start(rest, flags);                                                      \
    const mode_t mode = va_arg(rest, mode_t);                                   \
    va_end(rest);                                                               \
    const bool changes = (flags & (O_CREAT | O_WRONLY | O_RDWR)) != 0;          \
    if (changes && (path[0] == '/' ? fails(path) : fails(at))) return -1;       \
    return next<int(int, const char*, int, ...)>(#name)(at, path, flags, mode); \
  }
MANIP3D_OPENAT(openat)
MANIP3D_OPENAT(openat64)

ssize_t write(int fd, const void* data, size_t size) {
  if (fails(fd)) return -1;
  return next<ssize_t(int, const void*, size_t)>("write")(fd, data, size);
}
ssize_t writev(int fd, const iovec* parts, int count) {
  if (fails(fd)) return -1;
  return next<ssize_t(int, const iovec*, int)>("writev")(fd, parts, count);
}
ssize_t pwrite(int fd, const void* data, size_t size, off_t at) {
  if (fails(fd)) return -1;
  return next<ssize_t(int, const void*, size_t, off_t)>("pwrite")(fd, data, size, at);
}
ssize_t pwrite64(int fd, const void* data, size_t size, off64_t at) {
  if (fails(fd)) return -1;
  return next<ssize_t(int, const void*, size_t, off64_t)>("pwrite64")(fd, data, size, at);
}
int fsync(int fd) { return fails(fd) ? -1 : next<int(int)>("fsync")(fd); }
int fdatasync(int fd) { return fails(fd) ? -1 : next<int(int)>("fdatasync")(fd); }
int ftruncate(int fd, off_t size) {
  return fails(fd) ? -1 : next<int(int, off_t)>("ftruncate")(fd, size);
}
int ftruncate64(int fd, off64_t size) {
  return fails(fd) ? -1 : next<int(int, off64_t)>("ftruncate64")(fd, size);
}
int fchmod(int fd, mode_t mode) {
  return fails(fd) ? -1 : next<int(int, mode_t)>("fchmod")(fd, mode);
}
int mkdir(const char* path, mode_t mode) {
  return fails(path) ? -1 : next<int(const char*, mode_t)>("mkdir")(path, mode);
}
int rename(const char* from, const char* to) {
  return fails(to) ? -1 : next<int(const char*, const char*)>("rename")(from, to);
}
int renameat(int a, const char* from, int b, const char* to) {
  return fails(to) ? -1 : next<int(int, const char*, int, const char*)>("renameat")(a, from, b, to);
}
int renameat2(int a, const char* from, int b, const char* to, unsigned flags) {
  if (fails(to)) return -1;
  return next<int(int, const char*, int, const char*, unsigned)>("renameat2")(a, from, b, to,
                                                                              flags);
}
int link(const char* from, const char* to) {
  return fails(to) ? -1 : next<int(const char*, const char*)>("link")(from, to);
}
}
