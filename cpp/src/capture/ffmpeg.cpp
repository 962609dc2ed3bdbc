#include "capture/ffmpeg.hpp"

#include <dlfcn.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <iterator>
#include <new>
#include <vector>

#include "manip3d/capture/mkv.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kMaxRowPadding = 64;  // of FFmpeg's frames

// FFmpeg's encoder makes 4 of images up to 1080p, 24 at most unasked.
constexpr int kMaxSlices = 64;

// The latest first. Each was read off its headers and tried with the libraries themselves.
constexpr FfmpegLayout kLayouts[] = {
    {62, 62, 60, 104, 192, 8, 16, 32, 80, 88, 72, 76},
    {61, 61, 59, 104, 192, 8, 16, 32, 80, 88, 72, 76},
    {60, 60, 58, 72, 176, 8, 16, 32, 80, 88, 56, 60},
    {59, 59, 57, 72, 176, 0, 208, 16, 64, 72, 56, 60},
};

constexpr FfmpegLayout kHeaders = {
    LIBAVFORMAT_VERSION_MAJOR,
    LIBAVCODEC_VERSION_MAJOR,
    LIBAVUTIL_VERSION_MAJOR,
    offsetof(AVFormatContext, duration),
    offsetof(AVFormatContext, metadata),
    offsetof(AVStream, index),
    offsetof(AVStream, codecpar),
    offsetof(AVStream, time_base),
    offsetof(AVStream, metadata),
    offsetof(AVStream, avg_frame_rate),
    offsetof(AVCodecParameters, width),
    offsetof(AVCodecParameters, height),
};
static_assert(std::ranges::find(kLayouts, kHeaders) != std::end(kLayouts),
              "FFmpeg's headers are of a version that is not known here");

#define MANIP3D_AT(type, name, place) static_assert(offsetof(type, name) == (place))
MANIP3D_AT(AVIOContext, buffer, 8);
MANIP3D_AT(AVFormatContext, pb, 32);
MANIP3D_AT(AVFormatContext, nb_streams, 44);
MANIP3D_AT(AVFormatContext, streams, 48);
MANIP3D_AT(AVCodecParameters, codec_type, 0);
MANIP3D_AT(AVCodecParameters, codec_id, 4);
MANIP3D_AT(AVCodecParameters, codec_tag, 8);
MANIP3D_AT(AVCodecParameters, extradata, 16);
MANIP3D_AT(AVCodecParameters, extradata_size, 24);
MANIP3D_AT(AVCodecContext, codec_id, 24);
MANIP3D_AT(AVPacket, pts, 8);
MANIP3D_AT(AVPacket, dts, 16);
MANIP3D_AT(AVPacket, data, 24);
MANIP3D_AT(AVPacket, size, 32);
MANIP3D_AT(AVPacket, stream_index, 36);
MANIP3D_AT(AVPacket, flags, 40);
MANIP3D_AT(AVPacket, duration, 64);
MANIP3D_AT(AVFrame, data, 0);
MANIP3D_AT(AVFrame, linesize, 64);
MANIP3D_AT(AVFrame, width, 104);
MANIP3D_AT(AVFrame, height, 108);
MANIP3D_AT(AVFrame, format, 116);
MANIP3D_AT(AVDictionaryEntry, value, 8);
#undef MANIP3D_AT
static_assert(AV_CODEC_ID_NONE == 0 && AV_CODEC_ID_MJPEG == 7 && AV_CODEC_ID_FFV1 == 33 &&
              AV_CODEC_ID_SUBRIP == 0x17011 && AV_PIX_FMT_GRAY8 == 8 && AV_PIX_FMT_GRAY16LE == 30 &&
              AV_PIX_FMT_BGR0 == 121 && AVMEDIA_TYPE_VIDEO == 0 && AVMEDIA_TYPE_SUBTITLE == 3 &&
              AVMEDIA_TYPE_ATTACHMENT == 4 && AV_PKT_FLAG_KEY == 1 && AVSEEK_FLAG_BACKWARD == 1 &&
              AVSEEK_SIZE == 0x10000 && AVSEEK_FORCE == 0x20000 && AV_EF_CRCCHECK == 1 &&
              AV_EF_EXPLODE == 8 && AV_INPUT_BUFFER_PADDING_SIZE == 64);

/// What the loader calls a library: in a folder its path there, also under a name that auditwheel
/// gave it (libavutil-0123abcd.so.60.26.102); empty: it is not there.
std::string library_name(const std::filesystem::path& folder, const std::string& name, int major) {
  const std::string suffix = ".so." + std::to_string(major);
  if (folder.empty()) return name + suffix;
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator(folder, ignored)) {
    const std::string file = entry.path().filename().string();
    const bool is_of_version = (file + ".").find(suffix + ".") != std::string::npos;
    if (file.starts_with(name) && is_of_version) return entry.path().string();
  }
  return "";
}

void* open_library(const std::filesystem::path& folder, const std::string& name, int major) {
  const std::string found = library_name(folder, name, major);
  return found.empty() ? nullptr : ::dlopen(found.c_str(), RTLD_NOW | RTLD_LOCAL);
}

template <typename Function>
bool find_function(void* library, const char* name, Function& function) {
  function = reinterpret_cast<Function>(::dlsym(library, name));
  return function != nullptr;
}

/// Takes the libraries of this version out of the folder (empty: where the system has them).
bool load(const std::filesystem::path& folder, const FfmpegLayout& layout, Ffmpeg& functions) {
  void* avutil = open_library(folder, "libavutil", layout.avutil);
  void* avcodec = open_library(folder, "libavcodec", layout.avcodec);
  void* avformat = open_library(folder, "libavformat", layout.avformat);
  if (avutil == nullptr || avcodec == nullptr || avformat == nullptr) return false;
  bool is_whole = true;
#define MANIP3D_FIND(name) is_whole = find_function(library, #name, functions.name) && is_whole;
  void* library = avformat;
  MANIP3D_AVFORMAT_FUNCTIONS(MANIP3D_FIND)
  library = avcodec;
  MANIP3D_AVCODEC_FUNCTIONS(MANIP3D_FIND)
  library = avutil;
  MANIP3D_AVUTIL_FUNCTIONS(MANIP3D_FIND)
#undef MANIP3D_FIND
  functions.layout = layout;
  const auto is = [](unsigned version, int major) {
    return AV_VERSION_MAJOR(version) == static_cast<unsigned>(major);
  };
  return is_whole && is(functions.avformat_version(), layout.avformat) &&
         is(functions.avcodec_version(), layout.avcodec) &&
         is(functions.avutil_version(), layout.avutil);
}

std::vector<std::filesystem::path> places_to_look() {
  if (const char* only = std::getenv("MANIP3D_FFMPEG")) return {only};
  if (ffmpeg_folder().empty()) return {""};
  return {"", ffmpeg_folder()};
}

struct Loaded {
  Ffmpeg functions;
  std::string absence;
};

Loaded load() {
  Loaded loaded;
  std::string looked_in;
  for (const std::filesystem::path& folder : places_to_look()) {
    for (const FfmpegLayout& layout : kLayouts) {
      if (!load(folder, layout, loaded.functions)) continue;
      loaded.functions.av_log_set_level(AV_LOG_QUIET);
      return loaded;
    }
    if (!folder.empty()) looked_in += ", not in " + folder.string();
  }
  loaded.absence = "FFmpeg 5 to 8 (libavformat.so.59 to 62) cannot be loaded" + looked_in;
  return loaded;
}

const Loaded& loaded() {
  static const Loaded once = load();
  return once;
}

AVPixelFormat pixel_format(PixelKind kind) {
  if (kind == PixelKind::kGray8) return AV_PIX_FMT_GRAY8;
  return kind == PixelKind::kGray16 ? AV_PIX_FMT_GRAY16LE : AV_PIX_FMT_BGR0;
}

void check(int code) {
  if (code < 0) throw DeviceError("FFV1: " + ffmpeg_error(code));
}

/// By name: the fields lie elsewhere in each version.
void set_option(AVCodecContext& codec, const char* name, std::int64_t value) {
  check(ffmpeg().av_opt_set_int(&codec, name, value, AV_OPT_SEARCH_CHILDREN));
}

CodecPtr new_codec(const AVCodec* codec, PixelKind kind, ImageSize size) {
  const Ffmpeg& ff = ffmpeg();
  CodecPtr context(allocated(ff.avcodec_alloc_context3(codec)));
  check(ff.av_opt_set_image_size(context.get(), "video_size", static_cast<int>(size.cols),
                                 static_cast<int>(size.rows), 0));
  check(ff.av_opt_set_pixel_fmt(context.get(), "pixel_format", pixel_format(kind), 0));
  set_option(*context, "threads", 1);
  return context;
}

const AVCodec* ffv1(const AVCodec* codec) {
  if (codec == nullptr) throw DeviceError("FFmpeg was built without FFV1");
  return codec;
}

void rgb_to_bgr0(const std::uint8_t* rgb, std::uint8_t* bgr0, std::int64_t count) {
  for (std::int64_t i = 0; i < count; ++i, rgb += 3, bgr0 += 4) {
    bgr0[0] = rgb[2];
    bgr0[1] = rgb[1];
    bgr0[2] = rgb[0];
    bgr0[3] = 0;
  }
}

void bgr0_to_rgb(const std::uint8_t* bgr0, std::uint8_t* rgb, std::int64_t count) {
  for (std::int64_t i = 0; i < count; ++i, rgb += 3, bgr0 += 4) {
    rgb[0] = bgr0[2];
    rgb[1] = bgr0[1];
    rgb[2] = bgr0[0];
  }
}

/// How many slices a packet has if each ends with so many bytes, of which the first three are its
/// length (RFC 9043, section 4.9).
int count_slices(std::span<const std::byte> packet, std::size_t footer) {
  int count = 0;
  while (packet.size() > footer && count <= kMaxSlices) {
    const std::byte* end = packet.data() + packet.size() - footer;
    const std::size_t length = std::to_integer<std::size_t>(end[0]) << 16 |
                               std::to_integer<std::size_t>(end[1]) << 8 |
                               std::to_integer<std::size_t>(end[2]);
    if (length + footer > packet.size()) break;
    packet = packet.first(packet.size() - length - footer);
    ++count;
  }
  return count;
}

std::int64_t row_bytes(PixelKind kind, std::int64_t cols) {
  if (kind == PixelKind::kGray8) return cols;
  return kind == PixelKind::kGray16 ? 2 * cols : 3 * cols;
}

}  // namespace

const std::string& ffmpeg_absence() { return loaded().absence; }

const Ffmpeg& ffmpeg() {
  if (!loaded().absence.empty()) {
    throw DeviceError("mkv: " + loaded().absence + " (" + kMkvCure + ")");
  }
  return loaded().functions;
}

ImageSize size_of(const AVCodecParameters& images) {
  const FfmpegLayout& layout = ffmpeg().layout;
  return {field<int>(images, layout.height), field<int>(images, layout.width)};
}

void set_size(AVCodecParameters& images, ImageSize size) {
  const FfmpegLayout& layout = ffmpeg().layout;
  field<int>(images, layout.height) = static_cast<int>(size.rows);
  field<int>(images, layout.width) = static_cast<int>(size.cols);
}

std::string ffmpeg_error(int code) {
  char text[AV_ERROR_MAX_STRING_SIZE] = {};
  ffmpeg().av_strerror(code, text, sizeof(text));
  return text;
}

PacketPtr new_packet() { return PacketPtr(allocated(ffmpeg().av_packet_alloc())); }

std::span<const std::byte> bytes_of(const AVPacket& packet) {
  return std::as_bytes(std::span(packet.data, static_cast<std::size_t>(packet.size)));
}

std::string sha256(std::span<const std::byte> bytes) {
  const Ffmpeg& ff = ffmpeg();
  AVSHA* hash = allocated(ff.av_sha_alloc());
  std::uint8_t digest[32];
  ff.av_sha_init(hash, 256);
  ff.av_sha_update(hash, reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size());
  ff.av_sha_final(hash, digest);
  ff.av_free(hash);
  std::string text;
  for (const std::uint8_t byte : digest) {
    text += "0123456789abcdef"[byte >> 4];
    text += "0123456789abcdef"[byte & 15];
  }
  return text;
}

int ffv1_version(std::span<const std::byte> header) {
  if (header.size() < 2) return 0;
  std::size_t next = 0;
  const auto byte = [&] {
    return next < header.size() ? std::to_integer<unsigned>(header[next++]) : 0U;
  };
  // RFC 9043, section 3.8.1. Each bit of the first number has a state of its own, which is still
  // at its first value: one half.
  unsigned low = byte() << 8;
  low |= byte();
  unsigned range = 0xff00;
  const auto bit = [&] {
    const unsigned one = range * 128 >> 8;
    range -= one;
    const bool is_set = low >= range;
    if (is_set) {
      low -= range;
      range = one;
    }
    if (range < 0x100) {
      range <<= 8;
      low = (low << 8) + byte();
    }
    return is_set;
  };
  if (bit()) return 0;
  int digits = 0;
  while (digits < 8 && bit()) ++digits;
  int version = 1;
  while (digits-- > 0) version = 2 * version + (bit() ? 1 : 0);
  return version;
}

Ffv1Encoder::Ffv1Encoder(PixelKind kind, ImageSize size)
    : kind_(kind),
      size_(size),
      frame_(allocated(ffmpeg().av_frame_alloc())),
      packet_(new_packet()) {
  const Ffmpeg& ff = ffmpeg();
  if (size.rows < 4 || size.cols < 4) {
    throw InputError("image: expected at least 4 x 4 pixels for FFV1, got " +
                     std::to_string(size.cols) + " x " + std::to_string(size.rows));
  }
  const AVCodec* encoder = ffv1(ff.avcodec_find_encoder(AV_CODEC_ID_FFV1));
  codec_ = new_codec(encoder, kind, size);
  check(ff.av_opt_set_q(codec_.get(), "time_base", {1, 1000}, 0));
  set_option(*codec_, "g", 1);  // damage to one frame stays there
  set_option(*codec_, "level", 3);
  set_option(*codec_, "slicecrc", 1);
  set_option(*codec_, "coder", 1);
  check(ff.avcodec_open2(codec_.get(), encoder, nullptr));
  frame_->format = pixel_format(kind);
  frame_->width = static_cast<int>(size.cols);
  frame_->height = static_cast<int>(size.rows);
}

AVPacket& Ffv1Encoder::encode(const void* pixels) {
  const Ffmpeg& ff = ffmpeg();
  const auto [rows, cols] = size_;
  std::vector<std::uint8_t> four;
  const auto* first = static_cast<const std::uint8_t*>(pixels);
  if (kind_ == PixelKind::kRgb) {
    four.resize(static_cast<std::size_t>(4 * rows * cols));
    rgb_to_bgr0(first, four.data(), rows * cols);
    first = four.data();
  }
  // Borrowed for this call: FFmpeg copies frames that hold no reference, and never writes them.
  frame_->data[0] = const_cast<std::uint8_t*>(first);
  frame_->linesize[0] =
      static_cast<int>(kind_ == PixelKind::kRgb ? 4 * cols : row_bytes(kind_, cols));
  check(ff.avcodec_send_frame(codec_.get(), frame_.get()));
  check(ff.avcodec_receive_packet(codec_.get(), packet_.get()));
  return *packet_;
}

Ffv1Decoder::Ffv1Decoder(const AVCodecParameters& stream, PixelKind kind, ImageSize size)
    : kind_(kind), size_(size), frame_(allocated(ffmpeg().av_frame_alloc())) {
  const Ffmpeg& ff = ffmpeg();
  if (stream.codec_id != AV_CODEC_ID_FFV1) {
    throw FormatError(std::string("expected FFV1, got ") + ff.avcodec_get_name(stream.codec_id),
                      {});
  }
  if (const ImageSize has = size_of(stream); has.cols != size.cols || has.rows != size.rows) {
    throw FormatError("expected " + std::to_string(size.cols) + " x " + std::to_string(size.rows) +
                          " pixels, as in the calibration, got " + std::to_string(has.cols) +
                          " x " + std::to_string(has.rows),
                      {});
  }
  // In version 2, an experiment, nothing bounds the slices but the header.
  const auto header_size = static_cast<std::size_t>(std::max(stream.extradata_size, 0));
  if (ffv1_version(std::as_bytes(std::span(stream.extradata, header_size))) == 2) {
    throw FormatError("expected FFV1 of another version than 2", {});
  }
  const AVCodec* decoder = ffv1(ff.avcodec_find_decoder(AV_CODEC_ID_FFV1));
  codec_ = new_codec(decoder, kind, size);
  int code = ff.avcodec_parameters_to_context(codec_.get(), &stream);
  set_option(*codec_, "max_pixels", size.rows * (size.cols + kMaxRowPadding));
  set_option(*codec_, "err_detect", AV_EF_CRCCHECK | AV_EF_EXPLODE);
  if (code >= 0) code = ff.avcodec_open2(codec_.get(), decoder, nullptr);
  if (code < 0) throw FormatError("FFV1 header: " + ffmpeg_error(code), {});
}

void Ffv1Decoder::decode(const AVPacket& packet, void* pixels) {
  const Ffmpeg& ff = ffmpeg();
  // With and without CRCs: only the header, which is not read here, says which.
  if (std::max(count_slices(bytes_of(packet), 8), count_slices(bytes_of(packet), 3)) > kMaxSlices) {
    throw FormatError("FFV1: expected at most " + std::to_string(kMaxSlices) + " slices", {});
  }
  int code = ff.avcodec_send_packet(codec_.get(), &packet);
  if (code >= 0) code = ff.avcodec_receive_frame(codec_.get(), frame_.get());
  if (code < 0) throw FormatError("FFV1: " + ffmpeg_error(code), {});
  if (frame_->format != pixel_format(kind_) || frame_->width != size_.cols ||
      frame_->height != size_.rows) {
    throw FormatError("FFV1: the image has other pixels than the stream's header says", {});
  }
  auto* to = static_cast<std::uint8_t*>(pixels);
  const std::int64_t bytes = row_bytes(kind_, size_.cols);
  for (std::int64_t v = 0; v < size_.rows; ++v, to += bytes) {
    const std::uint8_t* from = frame_->data[0] + v * frame_->linesize[0];
    if (kind_ == PixelKind::kRgb) {
      bgr0_to_rgb(from, to, size_.cols);
    } else {
      std::memcpy(to, from, static_cast<std::size_t>(bytes));
    }
  }
}

}  // namespace manip3d
