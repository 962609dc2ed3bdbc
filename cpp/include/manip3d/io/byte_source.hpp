#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>

/// @file
/// Streams of bytes that readers pull from: a file or memory, decompressed on the fly.
namespace manip3d {

/// Compressed input is refused past this many bytes of output at a ratio above
/// `kMaxExpansion` (1 MiB of .xz can hold 7 GB), unless the caller sets `max_bytes`.
constexpr std::uint64_t kFreeExpansion = std::uint64_t{64} << 20;
constexpr std::uint64_t kMaxExpansion = 200;

/// Bytes pulled in order, at most once.
class ByteSource {
 public:
  virtual ~ByteSource() = default;

  /// Fills up to `size` bytes and says how many; 0 at the end.
  /// @throws FormatError  damaged or too much compressed data, at the uncompressed byte.
  /// @throws std::filesystem::filesystem_error  the operating system refused.
  virtual std::size_t read(char* data, std::size_t size) = 0;

  /// Upper bound on the bytes still to come; none for compressed data and pipes.
  [[nodiscard]] virtual std::optional<std::uint64_t> remaining() const = 0;

  /// Stored (compressed) bytes consumed so far, and in all (0: unknown).
  [[nodiscard]] virtual std::uint64_t stored_bytes() const = 0;
  [[nodiscard]] virtual std::uint64_t stored_size() const = 0;
  /// Whether the caller set `max_bytes`, and with it lifted the limits on compressed data.
  [[nodiscard]] virtual bool expansion_allowed() const { return true; }
};

enum class Compression : std::uint8_t { kNone, kGzip, kXz };

enum class SpecialFiles : std::uint8_t { kRefused, kAllowed };

/// Reads a regular file; a pipe or a device, which may go on for ever, only where it is allowed.
/// @throws InputError  the path has a NUL character, where the operating system would cut it off.
/// @throws FormatError  a pipe, socket or device.
/// @throws std::filesystem::filesystem_error
std::unique_ptr<ByteSource> file_source(const std::filesystem::path& path,
                                        SpecialFiles special = SpecialFiles::kRefused);

/// @throws InputError  the path has a NUL character.
void check_no_nul(const std::filesystem::path& path);
/// Borrows `data`.
std::unique_ptr<ByteSource> memory_source(std::span<const std::byte> data);

/// Decompresses gzip and xz (several members too), recognised by their first bytes or demanded by
/// `expected`; passes anything else on.
/// @param max_bytes  0: the limit of `kMaxExpansion`; else the most uncompressed bytes to give.
/// @throws FormatError  `expected` says compressed and the bytes are not.
std::unique_ptr<ByteSource> decompressed(std::unique_ptr<ByteSource> stored,
                                         Compression expected = Compression::kNone,
                                         std::uint64_t max_bytes = 0);

/// Compression by the last suffix: `.gz`, `.xz` or neither.
Compression compression_of(const std::filesystem::path& path);
/// The path without a `.gz` or `.xz` suffix.
std::filesystem::path without_compression_suffix(const std::filesystem::path& path);

}  // namespace manip3d
