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
#include "manip3d/files/descriptor.hpp"

/// @file
/// Matroska files through the codec library, with what the library leaves to its callers: exact
/// errors of the file system, data that are in the file when `flush` returns, and a file that ends
/// with a complete cluster after an error.
namespace manip3d {

/// A file for the callbacks of the codec library.
class MatroskaFile {
 public:
  MatroskaFile(std::filesystem::path path, int flags);
  MatroskaFile(const MatroskaFile&) = delete;
  MatroskaFile& operator=(const MatroskaFile&) = delete;

  [[nodiscard]] MkvFile functions();
  /// @throws std::filesystem::filesystem_error  a callback had an error.
  void check(const char* action) const;
  [[noreturn]] void refuse(const char* action) const;  ///< Throws the error of errno.

  const std::filesystem::path path;
  Descriptor descriptor;
  std::int64_t end = 0;
  int error = 0;  ///< The first errno of a callback.
};

class MatroskaWriter {
 public:
  /// An existing file is not changed before `start`.
  /// @throws std::filesystem::filesystem_error  for example, the file exists and `overwrite` is
  ///                                            false.
  /// @throws InputError  the file is open in another reader or recorder.
  MatroskaWriter(const std::filesystem::path& path, bool overwrite);

  /// Adds a track; returns its number. Call `start` after the last one. FFV1 stores images below 4
  /// x 4 pixels as zeros (FFmpeg 6; 5.1 to 8 below 3 x 3).
  int add(const MkvTrack& track);
  void start();

  /// @param image  Layout as for MkvCodec.
  /// @return  Valid until the next call.
  std::span<const std::byte> encode(int track, const void* image);
  /// @param time_ms  Must grow from one flush to the next.
  void write(int track, std::span<const std::byte> bytes, std::int64_t time_ms);
  /// Ends the cluster and hands it to the operating system. If that fails, the file is cut off at
  /// the end of the previous flush, and the writer refuses all further calls with the same error.
  void flush();
  /// Writes the index, syncs and closes the file.
  void finish();
  /// Closes the file unchanged; only before `start`.
  void leave();
  [[nodiscard]] std::int64_t size() const { return file_.end; }

 private:
  int check(int code);

  MatroskaFile file_;
  RecordingLock lock_;
  std::unique_ptr<MkvWriter, void (*)(MkvWriter*)> writer_;
  std::int64_t whole_ = 0;  // number of bytes in complete clusters
};

/// A packet that owns its memory.
struct MatroskaPacket {
  int track = -1;
  std::int64_t time_us = 0;  ///< Within kMaxTime, so that differences do not overflow.
  std::vector<std::byte> bytes;

  static constexpr std::int64_t kMaxTime = std::int64_t{1} << 61;
};

/// Reads the file as far as it is intact. Memory is bounded by what FFmpeg allocates for elements
/// of a file of this length.
class MatroskaReader {
 public:
  /// @throws FormatError  no Matroska file.
  /// @throws std::filesystem::filesystem_error
  explicit MatroskaReader(const std::filesystem::path& path);

  [[nodiscard]] const MkvTrack& track(int number) const { return tracks_.at(number); }
  /// The number of the track with this title and kind; empty: there is none.
  [[nodiscard]] std::optional<int> find(std::string_view title, MkvKind kind) const;
  /// The attached file with this name.
  /// @throws FormatError  there is none.
  [[nodiscard]] const MkvTrack& attachment(const std::string& name) const;
  /// The value of a tag of the whole file; empty: there is none.
  [[nodiscard]] std::string tag(const char* name) const;
  /// Microseconds: end of the last packet; 0: unknown, because the writer was stopped early.
  [[nodiscard]] std::int64_t duration_us() const;

  /// Opens the decoder of an FFV1 track.
  /// @throws FormatError  the track's header is damaged, or of version 2; or the pixels are of
  ///                      another kind.
  void open_decoder(int track, MkvPixels pixels, ImageSize size);
  /// @param image  Layout as for MkvCodec.
  /// @throws FormatError  a damaged packet, one with more slices than writers make, or other
  ///                      pixels.
  void decode(int track, std::span<const std::byte> packet, void* image);

  /// Reads the next packet of any track; returns false at the end, or if the rest is damaged.
  /// @throws std::filesystem::filesystem_error
  bool next(MatroskaPacket& packet);
  /// Continues at the packet at a position in a track's index, or at the last one if there are
  /// fewer. Returns their number; 0: there is no index, because the file was not finished.
  /// @throws std::filesystem::filesystem_error
  int seek(int track, int entry);
  /// Allows others to record over the file.
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
