#include "manip3d/files/byte_source.hpp"

#include <fcntl.h>
#include <lzma.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string>
#include <string_view>
#include <system_error>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/files/descriptor.hpp"

namespace manip3d {
namespace fs = std::filesystem;
namespace {

constexpr std::size_t kStoredBlock = std::size_t{1} << 16;
// Bytes: xz -9 needs 65 MiB for its dictionary, while a header can claim 4 GiB.
constexpr std::uint64_t kXzMemoryLimit = std::uint64_t{80} << 20;

// Reason of the refusal of a file or text that is larger than the caller allows.
std::string reason_of_limit(std::uint64_t max_bytes) {
  return "expected at most max_bytes = " + std::to_string(max_bytes) + " bytes, got more";
}

class FileSource final : public ByteSource {
 public:
  FileSource(const fs::path& path, SpecialFiles special) : path_(path) {
    check_no_nul(path);
    // Without O_NONBLOCK, opening a pipe waits for its writer.
    const int flags = special == SpecialFiles::kAllowed ? 0 : O_NONBLOCK;
    file_ = Descriptor(::open(path.c_str(), O_RDONLY | O_CLOEXEC | flags));
    if (!file_.is_open()) refuse("cannot open");
    struct ::stat status{};
    if (::fstat(file_.get(), &status) != 0) refuse("cannot inspect");
    if (S_ISREG(status.st_mode)) {
      size_ = static_cast<std::uint64_t>(status.st_size);
    } else if (special == SpecialFiles::kRefused && !S_ISDIR(status.st_mode)) {
      throw FormatError("expected a regular file, got a pipe, socket or device", {})
          .in_file(path.string());
    }
  }

  std::size_t read(char* data, std::size_t size) override {
    ssize_t got = 0;
    do {
      got = ::read(file_.get(), data, size);
    } while (got < 0 && errno == EINTR);
    if (got < 0) refuse("cannot read");
    position_ += static_cast<std::uint64_t>(got);
    return static_cast<std::size_t>(got);
  }

  [[nodiscard]] std::optional<std::uint64_t> remaining() const override {
    if (!size_) return std::nullopt;
    return *size_ > position_ ? *size_ - position_ : 0;
  }
  [[nodiscard]] std::uint64_t stored_bytes() const override { return position_; }
  [[nodiscard]] std::uint64_t stored_size() const override { return size_.value_or(0); }

 private:
  [[noreturn]] void refuse(const char* action) {
    throw fs::filesystem_error(action, path_, std::error_code(errno, std::generic_category()));
  }

  fs::path path_;
  Descriptor file_;
  std::optional<std::uint64_t> size_;  // size of a regular file
  std::uint64_t position_ = 0;
};

class MemorySource final : public ByteSource {
 public:
  explicit MemorySource(std::span<const std::byte> data) : data_(data) {}

  std::size_t read(char* data, std::size_t size) override {
    size = std::min(size, data_.size() - position_);
    if (size > 0) std::memcpy(data, data_.data() + position_, size);
    position_ += size;
    return size;
  }
  [[nodiscard]] std::optional<std::uint64_t> remaining() const override {
    return data_.size() - position_;
  }
  [[nodiscard]] std::uint64_t stored_bytes() const override { return position_; }
  [[nodiscard]] std::uint64_t stored_size() const override { return data_.size(); }

 private:
  std::span<const std::byte> data_;
  std::size_t position_ = 0;
};

// Returns bytes that were read ahead, then the rest.
class PeekedSource final : public ByteSource {
 public:
  PeekedSource(std::string head, std::unique_ptr<ByteSource> rest, std::uint64_t max_bytes)
      : head_(std::move(head)), rest_(std::move(rest)), max_bytes_(max_bytes) {}

  std::size_t read(char* data, std::size_t size) override {
    const std::size_t got = next(data, size);
    total_ += got;
    if (max_bytes_ > 0 && total_ > max_bytes_) {
      throw FormatError::at_byte(static_cast<std::int64_t>(max_bytes_),
                                 reason_of_limit(max_bytes_));
    }
    return got;
  }
  [[nodiscard]] std::optional<std::uint64_t> remaining() const override {
    const auto rest = rest_->remaining();
    return rest ? std::optional(*rest + head_.size() - position_) : std::nullopt;
  }
  [[nodiscard]] std::uint64_t stored_bytes() const override {
    return rest_->stored_bytes() - (head_.size() - position_);
  }
  [[nodiscard]] std::uint64_t stored_size() const override { return rest_->stored_size(); }

 private:
  std::size_t next(char* data, std::size_t size) {
    if (position_ == head_.size()) return rest_->read(data, size);
    size = std::min(size, head_.size() - position_);
    std::memcpy(data, head_.data() + position_, size);
    position_ += size;
    return size;
  }

  std::string head_;
  std::size_t position_ = 0;
  std::unique_ptr<ByteSource> rest_;
  std::uint64_t max_bytes_;
  std::uint64_t total_ = 0;
};

// Common part of gzip and xz: reads blocks of stored bytes, and limits the decompressed bytes.
class DecompressedSource : public ByteSource {
 public:
  DecompressedSource(std::unique_ptr<ByteSource> stored, std::uint64_t max_bytes)
      : stored_(std::move(stored)), max_bytes_(max_bytes), block_(kStoredBlock) {}

  std::size_t read(char* data, std::size_t size) override {
    if (size == 0 || finished_) return 0;
    const std::size_t got = decode(data, size);
    total_ += got;
    check_limit();
    return got;
  }
  [[nodiscard]] std::optional<std::uint64_t> remaining() const override { return std::nullopt; }
  [[nodiscard]] std::uint64_t stored_bytes() const override { return stored_->stored_bytes(); }
  [[nodiscard]] std::uint64_t stored_size() const override { return stored_->stored_size(); }
  [[nodiscard]] bool expansion_allowed() const override { return max_bytes_ > 0; }

 protected:
  // Decodes until there is at least one byte, or the stream has ended.
  virtual std::size_t decode(char* data, std::size_t size) = 0;

  std::span<unsigned char> next_block() {
    const std::size_t got = stored_->read(reinterpret_cast<char*>(block_.data()), block_.size());
    return {block_.data(), got};
  }
  [[noreturn]] void fail(const std::string& reason, std::size_t decoded = 0) const {
    throw FormatError::at_byte(static_cast<std::int64_t>(total_ + decoded), reason);
  }

  bool finished_ = false;

 private:
  void check_limit() const {
    if (max_bytes_ > 0) {
      if (total_ > max_bytes_) fail(reason_of_limit(max_bytes_));
      return;
    }
    if (total_ > kFreeExpansion && total_ / kMaxExpansion > stored_->stored_bytes()) {
      fail("compressed data expand more than " + std::to_string(kMaxExpansion) +
           " times; set max_bytes to read them");
    }
  }

  std::unique_ptr<ByteSource> stored_;
  std::uint64_t max_bytes_;
  std::uint64_t total_ = 0;
  std::vector<unsigned char> block_;
};

class GzipSource final : public DecompressedSource {
 public:
  GzipSource(std::unique_ptr<ByteSource> stored, std::uint64_t max_bytes)
      : DecompressedSource(std::move(stored), max_bytes) {
    constexpr int kGzipOnly = 16;  // added to the window bits: accept gzip only
    if (inflateInit2(&stream_, MAX_WBITS + kGzipOnly) != Z_OK) throw std::bad_alloc();
  }
  GzipSource(const GzipSource&) = delete;
  GzipSource& operator=(const GzipSource&) = delete;
  ~GzipSource() override { inflateEnd(&stream_); }

 private:
  std::size_t decode(char* data, std::size_t size) override {
    const auto want = static_cast<uInt>(std::min<std::size_t>(size, std::size_t{1} << 30));
    stream_.next_out = reinterpret_cast<Bytef*>(data);
    stream_.avail_out = want;
    while (stream_.avail_out == want) {
      if (stream_.avail_in == 0 && !refill()) break;
      if (member_ended_) {  // there are more bytes, so another member
        member_ended_ = false;
        inflateReset(&stream_);
      }
      const int status = inflate(&stream_, Z_NO_FLUSH);
      if (status == Z_MEM_ERROR) throw std::bad_alloc();
      if (status != Z_OK && status != Z_STREAM_END) {
        fail("damaged gzip data", want - stream_.avail_out);
      }
      member_ended_ = status == Z_STREAM_END;
    }
    return want - stream_.avail_out;
  }

  bool refill() {
    const auto block = next_block();
    if (block.empty()) {
      if (!member_ended_) fail("gzip data end early");
      finished_ = true;
      return false;
    }
    stream_.next_in = block.data();
    stream_.avail_in = static_cast<uInt>(block.size());
    return true;
  }

  z_stream stream_{};
  bool member_ended_ = false;
};

class XzSource final : public DecompressedSource {
 public:
  XzSource(std::unique_ptr<ByteSource> stored, std::uint64_t max_bytes)
      : DecompressedSource(std::move(stored), max_bytes) {
    if (lzma_stream_decoder(&stream_, kXzMemoryLimit, LZMA_CONCATENATED) != LZMA_OK) {
      throw std::bad_alloc();
    }
  }
  XzSource(const XzSource&) = delete;
  XzSource& operator=(const XzSource&) = delete;
  ~XzSource() override { lzma_end(&stream_); }

 private:
  std::size_t decode(char* data, std::size_t size) override {
    stream_.next_out = reinterpret_cast<std::uint8_t*>(data);
    stream_.avail_out = size;
    while (stream_.avail_out == size && !finished_) {
      if (stream_.avail_in == 0 && !at_end_) {
        const auto block = next_block();
        at_end_ = block.empty();
        stream_.next_in = block.data();
        stream_.avail_in = block.size();
      }
      const lzma_ret status = lzma_code(&stream_, at_end_ ? LZMA_FINISH : LZMA_RUN);
      check(status, size - stream_.avail_out);
      finished_ = status == LZMA_STREAM_END;
    }
    return size - stream_.avail_out;
  }

  void check(lzma_ret status, std::size_t decoded) const {
    switch (status) {
      case LZMA_OK:
      case LZMA_STREAM_END:
        return;
      case LZMA_MEM_ERROR:
        throw std::bad_alloc();
      case LZMA_BUF_ERROR:
        fail("xz data end early", decoded);
      case LZMA_FORMAT_ERROR:
        fail("expected xz data", decoded);
      case LZMA_MEMLIMIT_ERROR:
        fail("xz dictionary larger than 80 MiB", decoded);
      default:
        fail("damaged xz data", decoded);
    }
  }

  lzma_stream stream_ = LZMA_STREAM_INIT;
  bool at_end_ = false;
};

std::string peek(ByteSource& source, std::size_t size) {
  std::string head(size, '\0');
  std::size_t got = 0;
  while (got < size) {
    const std::size_t more = source.read(head.data() + got, size - got);
    if (more == 0) break;
    got += more;
  }
  head.resize(got);
  return head;
}

}  // namespace

std::unique_ptr<ByteSource> file_source(const fs::path& path, SpecialFiles special) {
  return std::make_unique<FileSource>(path, special);
}

void check_no_nul(const fs::path& path) {
  const std::size_t end = path.native().find('\0');
  if (end == std::string::npos) return;
  throw InputError("path: expected no NUL character, got one after '" +
                   path.native().substr(0, end) + "'");
}

std::unique_ptr<ByteSource> memory_source(std::span<const std::byte> data) {
  return std::make_unique<MemorySource>(data);
}

std::unique_ptr<ByteSource> decompressed(std::unique_ptr<ByteSource> stored, Compression expected,
                                         std::uint64_t max_bytes) {
  using namespace std::string_view_literals;
  constexpr auto kXzMagic =
      "\xFD"
      "7zXZ\0"sv;
  constexpr auto kGzipMagic = "\x1F\x8B\x08"sv;
  std::string head = peek(*stored, kXzMagic.size());
  const bool is_xz = head.starts_with(kXzMagic);
  const bool is_gzip = head.starts_with(kGzipMagic);
  if (expected == Compression::kXz && !is_xz) throw FormatError::at_byte(0, "expected xz data");
  if (expected == Compression::kGzip && !is_gzip) {
    throw FormatError::at_byte(0, "expected gzip data");
  }
  const bool compressed = is_xz || is_gzip;
  auto whole = std::make_unique<PeekedSource>(std::move(head), std::move(stored),
                                              compressed ? 0 : max_bytes);
  if (is_xz) return std::make_unique<XzSource>(std::move(whole), max_bytes);
  if (is_gzip) return std::make_unique<GzipSource>(std::move(whole), max_bytes);
  return whole;
}

Compression compression_of(const fs::path& path) {
  if (path.extension() == ".gz") return Compression::kGzip;
  if (path.extension() == ".xz") return Compression::kXz;
  return Compression::kNone;
}

fs::path without_compression_suffix(const fs::path& path) {
  return compression_of(path) == Compression::kNone ? path : path.parent_path() / path.stem();
}

}  // namespace manip3d
