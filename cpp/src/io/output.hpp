#pragma once

#include <array>
#include <bit>
#include <charconv>
#include <cstring>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "manip3d/files/atomic_file.hpp"
#include "manip3d/files/byte_source.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Writes text and binary values to an AtomicFile, optionally compressed.
class Output {
 public:
  Output(const std::filesystem::path& path, Compression compression, Progress progress = {});
  Output(const Output&) = delete;
  Output& operator=(const Output&) = delete;
  ~Output();

  void text(std::string_view s) {
    buffer_ += s;
    if (buffer_.size() >= kBlock) flush();
  }
  /// Writes the shortest decimal number that reads back as the same value.
  template <typename Number>
  void number(Number value) {
    std::array<char, 32> digits;
    const auto end = std::to_chars(digits.data(), digits.data() + digits.size(), value).ptr;
    text({digits.data(), static_cast<std::size_t>(end - digits.data())});
  }
  /// Writes the bytes of `value`, little endian.
  template <typename Value>
  void binary(Value value) {
    static_assert(std::endian::native == std::endian::little);
    std::array<char, sizeof(Value)> bytes;
    std::memcpy(bytes.data(), &value, sizeof(Value));
    text({bytes.data(), bytes.size()});
  }

  /// Ends the stream: all bytes are on the disk, under a temporary name. `commit()` calls it.
  void finish();
  /// Ends the stream and renames the file to its target.
  void commit();
  /// Keeps a companion, which stays locked until the destructor. The destructor removes it if this
  /// file was not committed.
  AtomicFile& keep(std::unique_ptr<AtomicFile> companion) {
    return *companions_.emplace_back(std::move(companion));
  }
  /// Whether the target is no regular file, such as a pipe, so that what was written stays.
  [[nodiscard]] bool is_in_place() const { return is_in_place_; }

 private:
  class Encoder;
  static constexpr std::size_t kBlock = std::size_t{1} << 20;
  void flush();

  AtomicFile file_;
  std::unique_ptr<Encoder> encoder_;  ///< Null: no compression.
  std::string buffer_;
  bool is_finished_ = false;
  bool is_in_place_ = false;
  std::vector<std::unique_ptr<AtomicFile>> companions_;
  Progress progress_;
};

}  // namespace manip3d
