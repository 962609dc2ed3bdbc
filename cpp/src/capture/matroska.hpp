#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "capture/jpeg.hpp"
#include "capture/recording_lock.hpp"
#include "manip3d/capture/mkv_codec.hpp"
#include "manip3d/io/descriptor.hpp"

/// @file
/// Matroska files through the codec library, and what it leaves to its callers: exact errors of the
/// file system, data that are in the file when `flush` returns, and an end that is whole after an
/// error.
namespace manip3d {

/// A file as the codec library's callbacks know it.
class MatroskaFile {
 public:
  MatroskaFile(std::filesystem::path path, int flags);
  MatroskaFile(const MatroskaFile&) = delete;
  MatroskaFile& operator=(const MatroskaFile&) = delete;

  [[nodiscard]] MkvFile functions();
  /// @throws std::filesystem::filesystem_error  an error of a callback.
  void check(const char* action) const;
  [[noreturn]] void refuse(const char* action) const;  ///< Throws the error of errno.

  const std::filesystem::path path;
  Descriptor descriptor;
  std::int64_t end = 0;
  int error = 0;  ///< The first errno of a callback.
};

class MatroskaWriter {
 public:
  /// A file that exists stays as it is until `start`.
  /// @throws std::filesystem::filesystem_error  it exists (unless `overwrite`), and the like.
  /// @throws InputError  somebody has it open to read or record.
  MatroskaWriter(const std::filesystem::path& path, bool overwrite);

  /// Tracks, in their order; then `start`. Returns the track's number.
  /// FFV1 stores zeros of images below 4 x 4 pixels (FFmpeg 6; 5.1 to 8 below 3).
  int add(const MkvTrack& track);
  void start();

  /// @param image  As MkvCodec has it. @return  valid until the next call.
  std::span<const std::byte> encode(int track, const void* image);
  /// @param time_ms  Grows from one flush to the next.
  void write(int track, std::span<const std::byte> bytes, std::int64_t time_ms);
  /// Ends the cluster and hands it to the operating system. When that refuses, the file ends where
  /// it did after the flush before, and the writer refuses all that follows in the same way.
  void flush();
  /// Writes the index, syncs and closes the file.
  void finish();
  /// Closes the file as it is, where `start` was not called.
  void leave();
  [[nodiscard]] std::int64_t size() const { return file_.end; }

 private:
  int check(int code);

  MatroskaFile file_;
  RecordingLock lock_;
  std::unique_ptr<MkvWriter, void (*)(MkvWriter*)> writer_;
  std::int64_t whole_ = 0;  // the bytes that hold whole clusters
};

/// A packet with its own memory.
struct MatroskaPacket {
  int track = -1;
  std::int64_t time_us = 0;  ///< Within kMaxTime, so that differences fit.
  std::vector<std::byte> bytes;

  static constexpr std::int64_t kMaxTime = std::int64_t{1} << 61;
};

/// Reads as far as the file can be made sense of; memory is bounded by what FFmpeg allocates for
/// elements of a file of this length.
class MatroskaReader {
 public:
  /// @throws FormatError  no Matroska file. @throws std::filesystem::filesystem_error
  explicit MatroskaReader(const std::filesystem::path& path);

  [[nodiscard]] const MkvTrack& track(int number) const { return tracks_.at(number); }
  /// The number of a track by its title and kind; none: there is no such track.
  [[nodiscard]] std::optional<int> find(std::string_view title, MkvKind kind) const;
  /// The attached file of this name. @throws FormatError  none.
  [[nodiscard]] const MkvTrack& attachment(const std::string& name) const;
  /// The value of a tag of the whole file, or empty.
  [[nodiscard]] std::string tag(const char* name) const;
  /// When the last packet ends; 0: the writer was stopped before it could say so.
  [[nodiscard]] std::int64_t duration_us() const;

  /// Decodes images of FFV1 from now on.
  /// @throws FormatError  the track's header is damaged, of version 2, or of other pixels.
  void open_decoder(int track, MkvPixels pixels, ImageSize size);
  /// @param image  As MkvCodec has it.
  /// @throws FormatError  damaged, of more slices than writers make, or of other pixels.
  void decode(int track, std::span<const std::byte> packet, void* image);

  /// The next packet of any track; false at the end, or where the rest cannot be made sense of.
  /// @throws std::filesystem::filesystem_error
  bool next(MatroskaPacket& packet);
  /// Goes on at a packet of a track by its place in the index of a finished file, at most at the
  /// last one; returns how many there are, 0: there is no index.
  /// @throws std::filesystem::filesystem_error
  int seek(int track, int entry);
  /// Lets others record over the file.
  void unlock() { lock_.release(); }
  void lock() { lock_.hold(); }
  [[nodiscard]] const std::filesystem::path& path() const { return file_.path; }

 private:
  MatroskaFile file_;
  RecordingLock lock_;
  std::unique_ptr<MkvReader, void (*)(MkvReader*)> reader_;
  std::vector<MkvTrack> tracks_;
};

}  // namespace manip3d
