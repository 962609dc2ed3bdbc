#pragma once

#include <cstddef>
#include <cstdint>

/// @file
/// The functions by which Matroska recordings use their codec and muxer. They have plain C types
/// only, so that the library that implements them can be built, loaded and replaced independently
/// of manip3d_core. Functions that return an `int` return a negative code if they fail; `describe`
/// returns its text. They throw no exceptions.
namespace manip3d {

/// Version of this interface; to be incremented with each change of this file.
inline constexpr std::uint32_t kMkvVersion = 2;

enum class MkvPixels : std::int32_t { kGray8, kGray16, kRgb };  ///< Layout of pixels in memory.
enum class MkvKind : std::int32_t { kVideo, kText, kAttachment, kOther };
enum class MkvFormat : std::int32_t { kFfv1, kMjpeg, kOther };  ///< Video codec.

struct MkvBytes {
  const std::uint8_t* data;
  std::size_t size;
};

/// A file, given by functions of the caller. They return the number of bytes that were read or
/// written, or a negative errno.
struct MkvFile {
  void* self;
  /// Returns 0 at the end.
  int (*read)(void* self, std::int64_t position, std::uint8_t* data, int size);
  int (*write)(void* self, std::int64_t position, const std::uint8_t* data, int size);
  std::int64_t (*size)(void* self);
};

/// A track of a file. Texts are never null. Fields that do not apply are 0 or empty.
struct MkvTrack {
  MkvKind kind = MkvKind::kOther;
  MkvFormat format = MkvFormat::kOther;
  /// Pixels of FFV1 images; while reading a track, the caller chooses them.
  MkvPixels pixels = MkvPixels::kGray8;
  std::int32_t width = 0, height = 0;  ///< Size of the images.
  /// Codec identifier of Video for Windows, first letter in the lowest byte.
  std::uint32_t four_cc = 0;
  std::int64_t period_ns = 0;  ///< Nanoseconds from image to image; 0: unknown.
  MkvBytes data{};             ///< The codec's header, or the attached file.
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

/// Returned bytes are valid until the next call for the same object, returned tracks until it is
/// closed. Images are arrays (height, width), or (height, width, 3) with R, G, B.
struct MkvCodec {
  std::uint32_t version;  ///< kMkvVersion.
  std::uint32_t size;     ///< sizeof(MkvCodec).

  /// Returns the part that the library was built without; empty: it is complete.
  const char* (*missing)();
  void (*describe)(int code, char* text, std::size_t size);

  /// Writing: add the tracks, start, write, finish. Nothing is written before `start`. FFV1 is of
  /// version 3 (RFC 9043); each image is coded independently, and each slice has a CRC.
  int (*open_writer)(const MkvFile* file, MkvWriter** writer);
  int (*add_track)(MkvWriter* writer, const MkvTrack* track);  ///< Returns the track's number.
  int (*start)(MkvWriter* writer);
  int (*encode)(MkvWriter* writer, int track, const void* image, MkvBytes* packet);
  int (*write)(MkvWriter* writer, const MkvPacket* packet);
  int (*flush)(MkvWriter* writer);   ///< Ends the cluster and writes it to the file.
  int (*finish)(MkvWriter* writer);  ///< Writes the index.
  void (*close_writer)(MkvWriter* writer);

  int (*open_reader)(const MkvFile* file, MkvReader** reader);
  /// 1: the track exists; 0: it does not.
  int (*track)(MkvReader* reader, int number, MkvTrack* track);
  const char* (*tag)(MkvReader* reader, const char* name);  ///< Value of a tag of the file.
  std::int64_t (*duration_us)(MkvReader* reader);           ///< 0: unknown.
  int (*next)(MkvReader* reader, MkvPacket* packet);
  /// Goes to the packet at a position in a track's index, or to the last one if there are fewer.
  /// Returns the number of packets in the index of this file.
  int (*seek)(MkvReader* reader, int track, int entry);
  /// FFV1 of any version, whose CRCs are checked. open_decoder must be called first for the track.
  int (*open_decoder)(MkvReader* reader, int track, MkvPixels pixels);
  int (*decode)(MkvReader* reader, int track, MkvBytes packet, void* image);
  void (*close_reader)(MkvReader* reader);
};

}  // namespace manip3d
