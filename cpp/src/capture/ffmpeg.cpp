#include "capture/ffmpeg.hpp"

#include <dlfcn.h>

#include <algorithm>
#include <cstring>
#include <new>

#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kMaxRowPadding = 64;  // of FFmpeg's frames

constexpr int kMaxSlices =
    64;  // FFmpeg's encoder makes 4 of images up to 1080p, 24 at most unasked

struct Loaded {
  Ffmpeg functions;
  std::string absence;
};

// The headers' version and no other: structures differ from one to the next.
void* open_library(const char* name, std::string& absence) {
  void* library = ::dlopen(name, RTLD_NOW | RTLD_LOCAL);
  if (library == nullptr && absence.empty()) {
    absence = std::string("FFmpeg's ") + name + " cannot be loaded: " + ::dlerror();
  }
  return library;
}

template <typename Function>
void find_function(void* library, const char* name, Function& function, std::string& absence) {
  if (library != nullptr) function = reinterpret_cast<Function>(::dlsym(library, name));
  if (function == nullptr && absence.empty()) absence = std::string("FFmpeg has no ") + name;
}

Loaded load() {
  Loaded loaded;
#define MANIP3D_FIND(name) find_function(library, #name, loaded.functions.name, loaded.absence);
  void* library =
      open_library("libavformat.so." AV_STRINGIFY(LIBAVFORMAT_VERSION_MAJOR), loaded.absence);
  MANIP3D_AVFORMAT_FUNCTIONS(MANIP3D_FIND)
  library = open_library("libavcodec.so." AV_STRINGIFY(LIBAVCODEC_VERSION_MAJOR), loaded.absence);
  MANIP3D_AVCODEC_FUNCTIONS(MANIP3D_FIND)
  library = open_library("libavutil.so." AV_STRINGIFY(LIBAVUTIL_VERSION_MAJOR), loaded.absence);
  MANIP3D_AVUTIL_FUNCTIONS(MANIP3D_FIND)
#undef MANIP3D_FIND
  if (loaded.absence.empty()) loaded.functions.av_log_set_level(AV_LOG_QUIET);
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

CodecPtr new_codec(const AVCodec* codec, PixelKind kind, ImageSize size) {
  CodecPtr context(allocated(ffmpeg().avcodec_alloc_context3(codec)));
  context->width = static_cast<int>(size.cols);
  context->height = static_cast<int>(size.rows);
  context->pix_fmt = pixel_format(kind);
  context->thread_count = 1;
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
  if (!loaded().absence.empty()) throw DeviceError(loaded().absence);
  return loaded().functions;
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
    : kind_(kind), frame_(allocated(ffmpeg().av_frame_alloc())), packet_(new_packet()) {
  const Ffmpeg& ff = ffmpeg();
  if (size.rows < 3 || size.cols < 3) {
    throw InputError("image: expected at least 3 x 3 pixels for FFV1, got " +
                     std::to_string(size.cols) + " x " + std::to_string(size.rows));
  }
  const AVCodec* encoder = ffv1(ff.avcodec_find_encoder(AV_CODEC_ID_FFV1));
  codec_ = new_codec(encoder, kind, size);
  codec_->time_base = {1, 1000};
  codec_->gop_size = 1;  // damage to one frame stays there
  codec_->level = 3;
  ff.av_opt_set_int(codec_->priv_data, "slicecrc", 1, 0);
  ff.av_opt_set_int(codec_->priv_data, "coder", 1, 0);
  const int code = ff.avcodec_open2(codec_.get(), encoder, nullptr);
  if (code < 0) throw DeviceError("FFV1: " + ffmpeg_error(code));
  frame_->format = codec_->pix_fmt;
  frame_->width = codec_->width;
  frame_->height = codec_->height;
}

AVPacket& Ffv1Encoder::encode(const void* pixels) {
  const Ffmpeg& ff = ffmpeg();
  const std::int64_t cols = codec_->width, rows = codec_->height;
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
  int code = ff.avcodec_send_frame(codec_.get(), frame_.get());
  if (code >= 0) code = ff.avcodec_receive_packet(codec_.get(), packet_.get());
  if (code < 0) throw DeviceError("FFV1: " + ffmpeg_error(code));
  return *packet_;
}

Ffv1Decoder::Ffv1Decoder(const AVCodecParameters& stream, PixelKind kind, ImageSize size)
    : kind_(kind), size_(size), frame_(allocated(ffmpeg().av_frame_alloc())) {
  const Ffmpeg& ff = ffmpeg();
  if (stream.codec_id != AV_CODEC_ID_FFV1) {
    throw FormatError(std::string("expected FFV1, got ") + ff.avcodec_get_name(stream.codec_id),
                      {});
  }
  if (stream.width != size.cols || stream.height != size.rows) {
    throw FormatError("expected " + std::to_string(size.cols) + " x " + std::to_string(size.rows) +
                          " pixels, as in the calibration, got " + std::to_string(stream.width) +
                          " x " + std::to_string(stream.height),
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
  codec_->max_pixels = size.rows * (size.cols + kMaxRowPadding);
  codec_->err_recognition = AV_EF_CRCCHECK | AV_EF_EXPLODE;
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
