#pragma once

#include <cstddef>
#include <cstdint>

/// @file
/// The functions by which recordings in Matroska reach their codec and muxer. They take plain C
/// types only, so that the library behind them is built, loaded and replaced apart from
/// manip3d_core. Functions that return an `int` return a negative code if they fail, which
/// `describe` puts into words. None of them throws.
namespace manip3d {

/// Grows when anything in this file changes.
inline constexpr std::uint32_t kMkvVersion = 2;

enum class MkvPixels : std::int32_t { kGray8, kGray16, kRgb };  ///< Layout of pixels in memory.
enum class MkvKind : std::int32_t { kVideo, kText, kAttachment, kOther };
enum class MkvFormat : std::int32_t { kFfv1, kMjpeg, kOther };  ///< Video codec.

struct MkvBytes {
  const std::uint8_t* data;
  std::size_t size;
};

/// A file, by functions of the caller that return the number of bytes done or a negative errno.
struct MkvFile {
  void* self;
  int (*read)(void* self, std::int64_t position, std::uint8_t* data, int size);  ///< 0: the end.
  int (*write)(void* self, std::int64_t position, const std::uint8_t* data, int size);
  std::int64_t (*size)(void* self);
};

/// A track of a file. Texts are never null; what does not apply is 0 or empty.
struct MkvTrack {
  MkvKind kind = MkvKind::kOther;
  MkvFormat format = MkvFormat::kOther;
  MkvPixels pixels =
      MkvPixels::kGray8;               ///< FFV1's pixels; for tracks that are read the caller says.
  std::int32_t width = 0, height = 0;  ///< Size of the images.
  std::uint32_t four_cc = 0;           ///< Code of Video for Windows, first letter lowest.
  std::int64_t period_ns = 0;          ///< From image to image; 0: the file does not say.
  MkvBytes data{};                     ///< The codec's header, or the attached file.
  const char* title = "";
  const char* file_name = "";    ///< Name of an attachment.
  const char* format_name = "";  ///< Codec of a track being read.
};

struct MkvPacket {
  std::int32_t track;
  std::int64_t time_us;
  MkvBytes bytes;
};

struct MkvWriter;
struct MkvReader;

/// Bytes that are handed out hold until the next call for the same object, tracks until it is
/// closed. Images lie in memory as (height, width), or (height, width, 3) R, G, B.
struct MkvCodec {
  std::uint32_t version;  ///< kMkvVersion.
  std::uint32_t size;     ///< sizeof(MkvCodec).

  const char* (*missing)();  ///< A part that the library was built without; empty: it has all.
  void (*describe)(int code, char* text, std::size_t size);

  /// Add tracks, start, write, finish. Nothing is written before `start`. FFV1 is of version 3 (RFC
  /// 9043), each image by itself, each slice with its CRC.
  int (*open_writer)(const MkvFile* file, MkvWriter** writer);
  int (*add_track)(MkvWriter* writer, const MkvTrack* track);  ///< Returns its number.
  int (*start)(MkvWriter* writer);
  int (*encode)(MkvWriter* writer, int track, const void* image, MkvBytes* packet);
  int (*write)(MkvWriter* writer, const MkvPacket* packet);
  int (*flush)(MkvWriter* writer);   ///< Ends the cluster and hands it to the file.
  int (*finish)(MkvWriter* writer);  ///< Writes the index.
  void (*close_writer)(MkvWriter* writer);

  int (*open_reader)(const MkvFile* file, MkvReader** reader);
  int (*track)(MkvReader* reader, int number, MkvTrack* track);  ///< 1: it is there; 0: it is not.
  const char* (*tag)(MkvReader* reader, const char* name);       ///< Value of a tag of the file.
  std::int64_t (*duration_us)(MkvReader* reader);                ///< 0: the file does not say.
  int (*next)(MkvReader* reader, MkvPacket* packet);
  /// Goes to a packet of a track by its place in the index, at most to the last one, and returns
  /// how many the index of this file has.
  int (*seek)(MkvReader* reader, int track, int entry);
  /// FFV1 of any version, its CRCs checked; first open_decoder for the track.
  int (*open_decoder)(MkvReader* reader, int track, MkvPixels pixels);
  int (*decode)(MkvReader* reader, int track, MkvBytes packet, void* image);
  void (*close_reader)(MkvReader* reader);
};

}  // namespace manip3d
