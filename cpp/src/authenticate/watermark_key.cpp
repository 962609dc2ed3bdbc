#include "manip3d/authenticate/watermark_key.hpp"

#include <fcntl.h>
#include <sodium.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <string_view>
#include <system_error>

#include "authenticate/little_endian.hpp"
#include "manip3d/error.hpp"
#include "manip3d/files/descriptor.hpp"
#include "manip3d/files/temporary.hpp"

namespace manip3d {
namespace fs = std::filesystem;
namespace {

constexpr std::string_view kKeyMagic = "m3d-key1";
constexpr std::uint8_t kRootKey = 1;
// Offsets of the fields of the file.
constexpr std::size_t kKind = 8, kId = 16, kCreated = 32, kExpires = 40, kKey = 48, kChecksum = 80;

[[noreturn]] void refuse(const char* action, const fs::path& path) {
  throw fs::filesystem_error(action, path, std::error_code(errno, std::generic_category()));
}

void checksum(std::span<const std::uint8_t> bytes, std::uint8_t* hash) {
  crypto_generichash_state state;
  crypto_generichash_init(&state, nullptr, 0, 32);
  crypto_generichash_update(&state, bytes.data(), bytes.size());
  crypto_generichash_final(&state, hash, 32);
  sodium_memzero(&state, sizeof state);  // the state contains the bytes
}

// Renames a temporary file unless the name is taken.
void name_without_replacing(const fs::path& temporary, const fs::path& path) {
  if (::renameat2(AT_FDCWD, temporary.c_str(), AT_FDCWD, path.c_str(), RENAME_NOREPLACE) == 0) {
    return;
  }
  // the file system does not support RENAME_NOREPLACE
  const bool unknown = errno == EINVAL || errno == ENOSYS;
  if (unknown && ::link(temporary.c_str(), path.c_str()) == 0) {
    ::unlink(temporary.c_str());
    return;
  }
  const int why = errno;
  ::unlink(temporary.c_str());
  errno = why;
  refuse("cannot create the key file", path);
}

void write_all(const Descriptor& file, std::span<const std::uint8_t> bytes, const fs::path& path) {
  while (!bytes.empty()) {
    const ssize_t written = ::write(file.get(), bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) refuse("cannot write", path);
    bytes = bytes.subspan(written);
  }
}

void check_private(const Descriptor& file, const fs::path& path) {
  struct ::stat status{};
  if (::fstat(file.get(), &status) != 0) refuse("cannot look at", path);
  if (!S_ISREG(status.st_mode)) {
    throw InputError("key: expected a regular file, got a folder, pipe or device: " +
                     path.string());
  }
  if ((status.st_mode & 077U) != 0) {
    std::array<char, 8> mode{};
    std::snprintf(mode.data(), mode.size(), "%04o", status.st_mode & 07777U);
    throw InputError("key: expected a file that only its owner can read (mode 0600), got mode " +
                     std::string(mode.data()) + ": " + path.string());
  }
  if (status.st_uid != ::geteuid() && status.st_uid != 0) {
    throw InputError("key: expected a file of the user who reads it, got one of somebody else: " +
                     path.string());
  }
}

SecretBytes read_file(const fs::path& path) {
  const Descriptor file(::open(path.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC));
  if (!file.is_open()) refuse("cannot open", path);
  check_private(file, path);
  SecretBytes bytes(WatermarkKey::kFileSize + 1);  // one byte more, to detect a longer file
  std::size_t size = 0;
  while (size < bytes.size()) {
    const ssize_t got = ::read(file.get(), bytes.data() + size, bytes.size() - size);
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) refuse("cannot read", path);
    if (got == 0) break;
    size += static_cast<std::size_t>(got);
  }
  if (size != WatermarkKey::kFileSize) {
    throw FormatError::at_byte(static_cast<std::int64_t>(std::min(size, WatermarkKey::kFileSize)),
                               "expected a key file of 112 bytes, got " +
                                   std::string(size > WatermarkKey::kFileSize ? "more" : "less"))
        .in_file(path.string());
  }
  SecretBytes whole(WatermarkKey::kFileSize);
  std::copy_n(bytes.data(), whole.size(), whole.data());
  return whole;
}

}  // namespace

SecretBytes::SecretBytes(std::size_t size) : size_(size) {
  if (sodium_init() < 0) throw Error("libsodium cannot be started");
  bytes_.reset(static_cast<std::uint8_t*>(sodium_malloc(size)));
  if (bytes_ == nullptr) throw Error("no memory for a key");
}

void SecretBytes::Free::operator()(std::uint8_t* bytes) const noexcept { sodium_free(bytes); }

void WatermarkKey::create(const fs::path& path, std::int64_t created_ns, std::int64_t expires_ns) {
  if (expires_ns != 0 && expires_ns <= created_ns) {
    throw InputError("expires_ns: expected 0 or a time after created_ns, got " +
                     std::to_string(expires_ns));
  }
  SecretBytes bytes(kFileSize);
  std::memset(bytes.data(), 0, bytes.size());
  std::copy(kKeyMagic.begin(), kKeyMagic.end(), bytes.data());
  bytes.data()[kKind] = kRootKey;
  randombytes_buf(bytes.data() + kId, sizeof(WatermarkId));
  store(created_ns, bytes.data() + kCreated);
  store(expires_ns, bytes.data() + kExpires);
  randombytes_buf(bytes.data() + kKey, kKeySize);
  checksum(bytes.span().first(kChecksum), bytes.data() + kChecksum);
  const fs::path folder = path.has_parent_path() ? path.parent_path() : fs::path(".");
  try {
    const Temporary made = make_temporary(folder, TemporaryKind::kFile, 0600U);
    try {
      write_all(made.lock, bytes.span(), path);
      if (::fsync(made.lock.get()) != 0) refuse("cannot sync", path);
    } catch (...) {
      ::unlink(made.path.c_str());
      throw;
    }
    name_without_replacing(made.path, path);
  } catch (const fs::filesystem_error&) {
    throw;
  } catch (const std::system_error& error) {
    throw fs::filesystem_error("cannot create a temporary file beside it", path, error.code());
  }
  const Descriptor opened(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (opened.is_open()) static_cast<void>(::fsync(opened.get()));
}

WatermarkKey::WatermarkKey(const fs::path& path) {
  const SecretBytes bytes = read_file(path);
  try {
    parse(bytes.span());
  } catch (const FormatError& error) {
    throw error.in_file(path.string());
  }
}

WatermarkKey::WatermarkKey(const SecretBytes& file) { parse(file.span()); }

void WatermarkKey::parse(std::span<const std::uint8_t> bytes) {
  if (bytes.size() != kFileSize || !std::equal(kKeyMagic.begin(), kKeyMagic.end(), bytes.begin())) {
    throw FormatError::at_byte(0, "expected a key file, which begins with m3d-key1");
  }
  std::array<std::uint8_t, 32> expected{};
  checksum(bytes.first(kChecksum), expected.data());
  const bool whole = sodium_memcmp(expected.data(), bytes.data() + kChecksum, 32) == 0;
  sodium_memzero(expected.data(), expected.size());
  if (!whole) throw FormatError::at_byte(kChecksum, "the checksum of the key file does not hold");
  const bool plain = std::all_of(bytes.begin() + kKind + 1, bytes.begin() + kId,
                                 [](std::uint8_t byte) { return byte == 0; });
  if (bytes[kKind] != kRootKey || !plain) {
    throw FormatError::at_byte(kKind, "expected a key of kind 1, got another kind");
  }
  std::copy_n(bytes.data() + kId, id_.size(), id_.begin());
  created_ns_ = load<std::int64_t>(bytes.data() + kCreated);
  expires_ns_ = load<std::int64_t>(bytes.data() + kExpires);
  if (expires_ns_ != 0 && expires_ns_ <= created_ns_) {
    throw FormatError::at_byte(kExpires, "the key expires before it was made");
  }
  key_ = SecretBytes(kKeySize);
  std::copy_n(bytes.data() + kKey, kKeySize, key_.data());
}

const SecretBytes& WatermarkKey::secret() const {
  if (!is_open()) throw Error("the key is closed");
  return key_;
}

void WatermarkKey::close() { key_ = SecretBytes(); }

}  // namespace manip3d
