#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>

/// @file
/// The secret key of a watermark and its file.
namespace manip3d {

/// Bytes that are kept out of swap and core dumps, and wiped before they are freed.
class SecretBytes {
 public:
  SecretBytes() = default;
  /// @throws Error  the system refused such memory.
  explicit SecretBytes(std::size_t size);

  [[nodiscard]] std::uint8_t* data() { return bytes_.get(); }
  [[nodiscard]] const std::uint8_t* data() const { return bytes_.get(); }
  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] std::span<const std::uint8_t> span() const { return {data(), size_}; }

 private:
  struct Free {
    void operator()(std::uint8_t* bytes) const noexcept;
  };
  std::unique_ptr<std::uint8_t, Free> bytes_;
  std::size_t size_ = 0;
};

/// Identifies a key, a sensor or a session.
using WatermarkId = std::array<std::uint8_t, 16>;

/// The root key of a sensor, read from its file.
///
/// The file, little-endian: "m3d-key1", kind u8 (1), 7 zeros, id 16, created_ns i64, expires_ns
/// i64, key 32, and the BLAKE2b-256 of all these as a checksum: 112 bytes.
class WatermarkKey {
 public:
  static constexpr std::size_t kFileSize = 112;
  static constexpr std::size_t kKeySize = 32;

  /// Draws a new key and writes its file, which only its owner can read. An existing file is never
  /// replaced.
  /// @param expires_ns  Nanoseconds since 1970; 0: never.
  /// @throws InputError  the dates contradict each other.
  /// @throws std::filesystem::filesystem_error  the file exists already, or the system refused.
  static void create(const std::filesystem::path& path, std::int64_t created_ns,
                     std::int64_t expires_ns = 0);

  /// Reads a key file.
  /// @throws InputError  others can read or write the file, or it belongs to another user.
  /// @throws FormatError  it is no key file, or a damaged one.
  /// @throws std::filesystem::filesystem_error  the system refused.
  explicit WatermarkKey(const std::filesystem::path& path);

  /// Reads a key from the bytes of its file.
  /// @throws FormatError  they are not the bytes of a key file.
  explicit WatermarkKey(const SecretBytes& file);

  [[nodiscard]] const WatermarkId& id() const { return id_; }
  [[nodiscard]] std::int64_t created_ns() const { return created_ns_; }
  [[nodiscard]] std::int64_t expires_ns() const { return expires_ns_; }
  [[nodiscard]] bool is_open() const { return key_.size() != 0; }
  /// @throws Error  the key was closed.
  [[nodiscard]] const SecretBytes& secret() const;
  /// Wipes the key. May be called twice.
  void close();

 private:
  void parse(std::span<const std::uint8_t> bytes);

  WatermarkId id_{};
  std::int64_t created_ns_ = 0;
  std::int64_t expires_ns_ = 0;
  SecretBytes key_;
};

}  // namespace manip3d
