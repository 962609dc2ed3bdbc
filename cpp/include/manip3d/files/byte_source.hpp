#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>

/// @file
/// Streams of bytes for readers: a file or memory, decompressed while it is read.
namespace manip3d {

/// Compressed input is refused if it expands to more than kFreeExpansion bytes at a ratio above
/// kMaxExpansion, unless the caller sets `max_bytes`. (1 MiB of .xz can hold 7 GB.)
constexpr std::uint64_t kFreeExpansion = std::uint64_t{64} << 20;
constexpr std::uint64_t kMaxExpansion = 200;

/// A stream of bytes that is read once, in order.
class ByteSource {
 public:
  virtual ~ByteSource() = default;

  /// Reads up to `size` bytes; returns their number, 0 at the end.
  /// @throws FormatError  (at the uncompressed byte) compressed data are damaged or too large.
  /// @throws std::filesystem::filesystem_error  the operating system refused.
  virtual std::size_t read(char* data, std::size_t size) = 0;

  /// Upper bound of the bytes still to come; empty for compressed data and pipes.
  [[nodiscard]] virtual std::optional<std::uint64_t> remaining() const = 0;

  /// Stored (compressed) bytes that were consumed so far, and their total (0: unknown).
  [[nodiscard]] virtual std::uint64_t stored_bytes() const = 0;
  [[nodiscard]] virtual std::uint64_t stored_size() const = 0;
  /// Did the caller set `max_bytes`, which replaces the limits on compressed data?
  [[nodiscard]] virtual bool expansion_allowed() const { return true; }
};

enum class Compression : std::uint8_t { kNone, kGzip, kXz };

enum class SpecialFiles : std::uint8_t { kRefused, kAllowed };

/// Opens a regular file. Pipes and devices, which may be endless, must be allowed by `special`.
/// @throws InputError  the path has a NUL character, at which the operating system would cut it.
/// @throws FormatError  the path is a pipe, socket or device.
/// @throws std::filesystem::filesystem_error  the operating system refused.
std::unique_ptr<ByteSource> file_source(const std::filesystem::path& path,
                                        SpecialFiles special = SpecialFiles::kRefused);

/// Checks that a path has no NUL character.
/// @throws InputError  it has one.
void check_no_nul(const std::filesystem::path& path);
/// A source that borrows `data`.
std::unique_ptr<ByteSource> memory_source(std::span<const std::byte> data);

/// Decompresses gzip and xz, also of several members. They are recognised by their first bytes, or
/// required by `expected`; all other data are passed on unchanged.
/// @param max_bytes  Limit of uncompressed bytes; 0: kFreeExpansion and kMaxExpansion.
/// @throws FormatError  `expected` is a compression that the bytes do not have.
std::unique_ptr<ByteSource> decompressed(std::unique_ptr<ByteSource> stored,
                                         Compression expected = Compression::kNone,
                                         std::uint64_t max_bytes = 0);

/// The compression by the last suffix: `.gz`, `.xz` or neither.
Compression compression_of(const std::filesystem::path& path);
/// The path without a `.gz` or `.xz` suffix.
std::filesystem::path without_compression_suffix(const std::filesystem::path& path);

}  // namespace manip3d
