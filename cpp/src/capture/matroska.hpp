#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "capture/ffmpeg.hpp"

/// @file
/// Matroska files by FFmpeg, and what it leaves to its callers: exact errors of the file system,
/// data that are in the file when `flush` returns, and an end that is whole after an error.
namespace manip3d {

/// A file as FFmpeg's callbacks know it.
struct MatroskaFile {
  int descriptor = -1;
  std::int64_t position = 0, end = 0;
  int error = 0;  ///< The first errno.
};

class MatroskaWriter {
 public:
  /// @throws std::filesystem::filesystem_error  it exists (unless `overwrite`), and the like.
  MatroskaWriter(const std::filesystem::path& path, bool overwrite);
  MatroskaWriter(const MatroskaWriter&) = delete;
  MatroskaWriter& operator=(const MatroskaWriter&) = delete;
  ~MatroskaWriter();  ///< Without `finish`, what a killed process leaves.

  /// Tracks, in their order; then `start`. Their numbers are for `write`.
  int add_video(const AVCodecContext& codec, const char* title);
  int add_jpeg(ImageSize size, const char* title);
  int add_text(const char* title);
  void add_attachment(const char* name, const std::string& description, const std::string& text);
  void start();

  /// @param time_ms  Grows from one flush to the next.
  void write(int track, std::span<const std::byte> bytes, std::int64_t time_ms);
  /// Ends the cluster and hands it to the operating system. When that refuses, the file ends where
  /// it did after the flush before, and the writer refuses all that follows in the same way.
  void flush();
  /// Writes the index, syncs and closes the file.
  void finish();
  [[nodiscard]] std::int64_t size() const { return file_.end; }

 private:
  AVStream& add_stream(AVMediaType type, AVCodecID codec, const char* title);
  void check(int code, const char* action);

  std::filesystem::path path_;
  MatroskaFile file_;
  std::int64_t whole_ = 0;  // the bytes that hold whole clusters
  AVIOContext* io_ = nullptr;
  AVFormatContext* format_ = nullptr;
  PacketPtr packet_;
};

class MatroskaReader {
 public:
  /// @throws FormatError  no Matroska file.
  /// @throws std::filesystem::filesystem_error
  explicit MatroskaReader(const std::filesystem::path& path);
  MatroskaReader(const MatroskaReader&) = delete;
  MatroskaReader& operator=(const MatroskaReader&) = delete;
  ~MatroskaReader();

  [[nodiscard]] const AVCodecParameters& parameters(int track) const;
  [[nodiscard]] AVRational frame_rate(int track) const;  ///< 0 / 1: the file does not say.
  /// The number of a track by its title and kind; none: there is no such track.
  [[nodiscard]] std::optional<int> find(const char* title, AVMediaType type) const;
  /// The attached file of this name, as long as this reader lives. @throws FormatError  none.
  struct Attachment {
    std::string_view text;
    std::string description;
  };
  [[nodiscard]] Attachment attachment(const char* name) const;
  /// The value of a tag of the whole file, or empty.
  [[nodiscard]] std::string tag(const char* name) const;
  /// When a packet's image was taken.
  [[nodiscard]] std::int64_t time_ns(const AVPacket& packet) const;
  /// When the last packet ends, milliseconds; 0: the writer was stopped before it could say so.
  [[nodiscard]] std::int64_t duration_ms() const;

  /// The next packet of any track; false at the end, or where the rest cannot be made sense of.
  /// @throws std::filesystem::filesystem_error
  bool next(AVPacket& packet);
  /// Goes on at the last packet of a track that the index of a finished file knows; false: there is
  /// no index. @throws std::filesystem::filesystem_error
  bool seek_last(int track);

 private:
  void open();
  void close();
  [[nodiscard]] std::span<AVStream* const> streams() const {
    return {format_->streams, format_->nb_streams};
  }
  [[nodiscard]] AVStream& stream(int track) const {
    return *streams()[static_cast<std::size_t>(track)];
  }

  std::filesystem::path path_;
  MatroskaFile file_;
  AVIOContext* io_ = nullptr;
  AVFormatContext* format_ = nullptr;
};

}  // namespace manip3d
