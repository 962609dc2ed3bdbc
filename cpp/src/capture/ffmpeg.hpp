#pragma once

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/opt.h>
#include <libavutil/sha.h>
}

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <type_traits>

#include "capture/jpeg.hpp"

namespace manip3d {

// clang-format off
#define MANIP3D_AVFORMAT_FUNCTIONS(X)                                                        \
  X(av_find_input_format) X(av_read_frame) X(av_seek_frame) X(av_write_frame)                \
  X(av_write_trailer) X(avformat_alloc_context) X(avformat_alloc_output_context2)            \
  X(avformat_close_input) X(avformat_free_context) X(avformat_new_stream)                    \
  X(avformat_open_input) X(avformat_version) X(avformat_write_header)                        \
  X(avio_alloc_context) X(avio_context_free) X(avio_flush)
#define MANIP3D_AVCODEC_FUNCTIONS(X)                                                         \
  X(av_packet_alloc) X(av_packet_free) X(av_packet_unref) X(avcodec_alloc_context3)          \
  X(avcodec_find_decoder) X(avcodec_find_encoder) X(avcodec_free_context)                    \
  X(avcodec_get_name) X(avcodec_open2) X(avcodec_parameters_from_context)                    \
  X(avcodec_parameters_to_context) X(avcodec_receive_frame) X(avcodec_receive_packet)        \
  X(avcodec_send_frame) X(avcodec_send_packet) X(avcodec_version)
#define MANIP3D_AVUTIL_FUNCTIONS(X)                                                          \
  X(av_dict_free) X(av_dict_get) X(av_dict_set) X(av_frame_alloc) X(av_frame_free)           \
  X(av_free) X(av_log_set_level) X(av_malloc) X(av_mallocz) X(av_opt_set)                    \
  X(av_opt_set_image_size) X(av_opt_set_int) X(av_opt_set_pixel_fmt) X(av_opt_set_q)         \
  X(av_rescale_q) X(av_sha_alloc) X(av_sha_final) X(av_sha_init) X(av_sha_update)            \
  X(av_strerror) X(avutil_version)
// clang-format on

/// Where the fields lie that moved from one major version of FFmpeg to another. The others that are
/// used here lie in the same place in all of them, and so do the values of enumerators and flags:
/// ffmpeg.cpp asserts both of the headers it is compiled with.
struct FfmpegLayout {
  int avformat, avcodec, avutil;                 ///< The major versions that belong together.
  std::size_t format_duration, format_metadata;  ///< In AVFormatContext.
  std::size_t stream_index, stream_codecpar, stream_time_base, stream_metadata, stream_rate;
  std::size_t width, height;  ///< In AVCodecParameters.

  bool operator==(const FfmpegLayout&) const = default;
};

/// FFmpeg's functions under their own names. They are looked up when the first is needed: linked,
/// they would bring 130 libraries and more time to load than the rest of the package takes, and
/// only the version that was there when this was built would do.
struct Ffmpeg {
  FfmpegLayout layout{};
#define MANIP3D_POINTER(name) decltype(&::name) name = nullptr;
  MANIP3D_AVFORMAT_FUNCTIONS(MANIP3D_POINTER)
  MANIP3D_AVCODEC_FUNCTIONS(MANIP3D_POINTER)
  MANIP3D_AVUTIL_FUNCTIONS(MANIP3D_POINTER)
#undef MANIP3D_POINTER
};

/// What keeps FFmpeg's libraries from being loaded; empty: nothing.
const std::string& ffmpeg_absence();

/// Quiet: what FFmpeg has to say about a file is thrown or counted.
/// @throws DeviceError  as ffmpeg_absence().
const Ffmpeg& ffmpeg();

/// The field of a structure at one of the places in FfmpegLayout.
template <typename Field, typename Struct>
auto& field(Struct& object, std::size_t place) {
  constexpr bool kConst = std::is_const_v<Struct>;
  auto* bytes = reinterpret_cast<std::conditional_t<kConst, const std::byte, std::byte>*>(&object);
  return *reinterpret_cast<std::conditional_t<kConst, const Field, Field>*>(bytes + place);
}

ImageSize size_of(const AVCodecParameters& images);
void set_size(AVCodecParameters& images, ImageSize size);

/// What FFmpeg calls an error code.
std::string ffmpeg_error(int code);

/// The result of a function that fails only for want of memory.
template <typename T>
T* allocated(T* pointer) {
  if (pointer == nullptr) throw std::bad_alloc();
  return pointer;
}

struct PacketDeleter {
  void operator()(AVPacket* packet) const { ffmpeg().av_packet_free(&packet); }
};
struct FrameDeleter {
  void operator()(AVFrame* frame) const { ffmpeg().av_frame_free(&frame); }
};
struct CodecDeleter {
  void operator()(AVCodecContext* codec) const { ffmpeg().avcodec_free_context(&codec); }
};
using PacketPtr = std::unique_ptr<AVPacket, PacketDeleter>;
using FramePtr = std::unique_ptr<AVFrame, FrameDeleter>;
using CodecPtr = std::unique_ptr<AVCodecContext, CodecDeleter>;

PacketPtr new_packet();
std::span<const std::byte> bytes_of(const AVPacket& packet);

/// SHA-256 as 64 hexadecimal digits.
std::string sha256(std::span<const std::byte> bytes);

/// The pixels that are stored losslessly, as they lie in memory.
enum class PixelKind : std::uint8_t { kGray8, kGray16, kRgb };

/// The version at the start of an FFV1 stream's header; 0: there is no header (versions 0 and 1).
int ffv1_version(std::span<const std::byte> header);

/// Lossless images by FFV1 version 3 (RFC 9043): each frame by itself, each slice with its CRC.
class Ffv1Encoder {
 public:
  /// @throws InputError  fewer than 4 rows or columns: FFmpeg (6; 5.1 to 8 below 3) stores zeros.
  Ffv1Encoder(PixelKind kind, ImageSize size);

  /// For the header of the stream.
  [[nodiscard]] const AVCodecContext& codec() const { return *codec_; }
  /// @param pixels  (rows, cols), or (rows, cols, 3) R, G, B.
  /// @return  valid until the next call.
  AVPacket& encode(const void* pixels);

 private:
  PixelKind kind_;
  ImageSize size_;
  CodecPtr codec_;
  FramePtr frame_;
  PacketPtr packet_;
};

/// Memory is bounded: FFmpeg takes up to 1.5 MB for each slice of an image, however few its bytes.
class Ffv1Decoder {
 public:
  /// @throws FormatError  the stream's header is damaged, of version 2, or of other pixels.
  Ffv1Decoder(const AVCodecParameters& stream, PixelKind kind, ImageSize size);

  /// @param pixels  (rows, cols), or (rows, cols, 3) R, G, B.
  /// @throws FormatError  damaged, of more slices than writers make, or of other pixels.
  void decode(const AVPacket& packet, void* pixels);

 private:
  PixelKind kind_;
  ImageSize size_;
  CodecPtr codec_;
  FramePtr frame_;
};

}  // namespace manip3d
