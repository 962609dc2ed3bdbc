#include "ffmpeg.hpp"

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/opt.h>
}

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <limits>
#include <memory>
#include <new>

namespace manip3d {
namespace {

constexpr int kBufferBytes = 1 << 16;
constexpr int kMaxStreams = 64;     // recordings have five streams
constexpr int kMaxRowPadding = 64;  // bytes of padding in the rows of FFmpeg's frames
constexpr AVRational kMicroseconds = {1, 1'000'000};
constexpr AVRational kMilliseconds = {1, 1'000};  // unit of times in the file

struct Freed {
  void operator()(AVPacket* packet) const { av_packet_free(&packet); }
  void operator()(AVFrame* frame) const { av_frame_free(&frame); }
  void operator()(AVCodecContext* codec) const { avcodec_free_context(&codec); }
  void operator()(AVFormatContext* format) const {
    format->iformat != nullptr ? avformat_close_input(&format) : avformat_free_context(format);
  }
};
using PacketPtr = std::unique_ptr<AVPacket, Freed>;
using FramePtr = std::unique_ptr<AVFrame, Freed>;
using CodecPtr = std::unique_ptr<AVCodecContext, Freed>;
using FormatPtr = std::unique_ptr<AVFormatContext, Freed>;

/// Copies a codec's header into an AVCodecContext or AVCodecParameters.
template <typename Stream>
int copy(MkvBytes header, Stream& stream) {
  if (header.size == 0) return 0;
  stream.extradata =
      static_cast<std::uint8_t*>(av_mallocz(header.size + AV_INPUT_BUFFER_PADDING_SIZE));
  if (stream.extradata == nullptr) return AVERROR(ENOMEM);
  stream.extradata_size = static_cast<int>(header.size);
  std::memcpy(stream.extradata, header.data, header.size);
  return 0;
}

// --- images -------------------------------------------------------------------------------------

AVPixelFormat pixel_format(MkvPixels pixels) {
  if (pixels == MkvPixels::kGray8) return AV_PIX_FMT_GRAY8;
  return pixels == MkvPixels::kGray16 ? AV_PIX_FMT_GRAY16LE : AV_PIX_FMT_BGR0;
}

/// Rows of an image, which has no padding, or of an FFmpeg frame.
template <typename Byte>
struct Rows {
  Byte* first;
  std::ptrdiff_t stride;
  int pixel_bytes;
};

void copy_rows(Rows<const std::uint8_t> from, Rows<std::uint8_t> to, int width, int height) {
  for (int v = 0; v < height; ++v, from.first += from.stride, to.first += to.stride) {
    if (from.pixel_bytes == to.pixel_bytes) {
      std::memcpy(to.first, from.first, static_cast<std::size_t>(width * to.pixel_bytes));
      continue;
    }
    // converts between R, G, B and B, G, R, 0 in either direction
    const std::uint8_t* rgb = from.first;
    std::uint8_t* bgr = to.first;
    for (int u = 0; u < width; ++u, rgb += from.pixel_bytes, bgr += to.pixel_bytes) {
      bgr[0] = rgb[2];
      bgr[1] = rgb[1];
      bgr[2] = rgb[0];
    }
  }
}

/// A codec of images with its frame and packet.
struct Images {
  MkvPixels pixels;
  CodecPtr codec;
  FramePtr frame{av_frame_alloc()};
  PacketPtr packet{av_packet_alloc()};

  Images(const AVCodec* ffv1, MkvPixels pixels_, int width, int height)
      : pixels(pixels_), codec(avcodec_alloc_context3(ffv1)) {
    if (!codec) return;
    // no log output, since the caller gets the error code
    codec->log_level_offset = AV_LOG_MAX_OFFSET;
    codec->pix_fmt = pixel_format(pixels);
    codec->width = width;
    codec->height = height;
    codec->thread_count = 1;
  }

  [[nodiscard]] bool is_whole() const { return codec && frame && packet; }
  template <typename Byte>
  [[nodiscard]] Rows<Byte> rows(Byte* image) const {
    const int bytes = pixels == MkvPixels::kGray8 ? 1 : pixels == MkvPixels::kGray16 ? 2 : 3;
    return {image, std::ptrdiff_t{bytes} * frame->width, bytes};
  }
  template <typename Byte>
  [[nodiscard]] Rows<Byte> frame_rows() const {
    const int bytes = pixels == MkvPixels::kGray8 ? 1 : pixels == MkvPixels::kGray16 ? 2 : 4;
    return {frame->data[0], frame->linesize[0], bytes};
  }
};
using ImagesPtr = std::unique_ptr<Images>;

int open_encoder(Images& images) {
  AVCodecContext& codec = *images.codec;
  codec.time_base = kMilliseconds;
  codec.gop_size = 1;  // so that damage is limited to one image
  codec.level = 3;
  int code = av_opt_set_int(&codec, "slicecrc", 1, AV_OPT_SEARCH_CHILDREN);
  if (code >= 0) code = av_opt_set_int(&codec, "coder", 1, AV_OPT_SEARCH_CHILDREN);
  if (code >= 0) code = avcodec_open2(&codec, nullptr, nullptr);
  images.frame->format = codec.pix_fmt;
  images.frame->width = codec.width;
  images.frame->height = codec.height;
  return code < 0 ? code : av_frame_get_buffer(images.frame.get(), 0);
}

// --- the file -----------------------------------------------------------------------------------

/// The caller's file for FFmpeg's callbacks.
struct Io {
  MkvFile file;
  std::int64_t position = 0;
  /// Whether FFmpeg may know the size of the file. A reader may not: FFmpeg would print a line for
  /// each element that the end of the file cuts, without a context whose logging could be off.
  bool has_size = false;
  AVIOContext* context = nullptr;

  Io(const MkvFile& of) : file(of) {}
  Io(const Io&) = delete;
  Io& operator=(const Io&) = delete;
  ~Io() {
    if (context != nullptr) av_freep(&context->buffer);
    avio_context_free(&context);
  }
  int open(bool writes);
};

int advance(Io& io, int done) {
  io.position += std::max(done, 0);
  return done;
}

int read_file(void* opaque, std::uint8_t* data, int size) {
  Io& io = *static_cast<Io*>(opaque);
  const int got = advance(io, io.file.read(io.file.self, io.position, data, size));
  return got == 0 ? AVERROR_EOF : got;
}

#if LIBAVFORMAT_VERSION_MAJOR < 61
using Written = std::uint8_t;
#else
using Written = const std::uint8_t;
#endif

int write_file(void* opaque, Written* data, int size) {
  Io& io = *static_cast<Io*>(opaque);
  return advance(io, io.file.write(io.file.self, io.position, data, size));
}

std::int64_t seek_file(void* opaque, std::int64_t offset, int origin) {
  Io& io = *static_cast<Io*>(opaque);
  if (!io.has_size && ((origin & AVSEEK_SIZE) != 0 || origin == SEEK_END)) return AVERROR(ENOSYS);
  const std::int64_t end = io.file.size(io.file.self);
  if ((origin & AVSEEK_SIZE) != 0) return end;
  origin &= ~AVSEEK_FORCE;
  if (origin != SEEK_SET && origin != SEEK_CUR && origin != SEEK_END) return AVERROR(EINVAL);
  const std::int64_t from = origin == SEEK_CUR ? io.position : origin == SEEK_END ? end : 0;
  const bool fits = offset <= std::numeric_limits<std::int64_t>::max() - from;
  if (!fits || from + offset < 0) return AVERROR(EINVAL);
  return io.position = from + offset;
}

int Io::open(bool writes) {
  auto* buffer = static_cast<unsigned char*>(av_malloc(kBufferBytes));
  if (buffer == nullptr) return AVERROR(ENOMEM);
  has_size = writes;
  context =
      avio_alloc_context(buffer, kBufferBytes, writes ? 1 : 0, this, writes ? nullptr : read_file,
                         writes ? write_file : nullptr, seek_file);
  if (context == nullptr) av_free(buffer);
  return context == nullptr ? AVERROR(ENOMEM) : 0;
}

}  // namespace

struct MkvWriter {
  Io io;
  FormatPtr format{};
  PacketPtr packet{av_packet_alloc()};
  ImagesPtr images[kMaxStreams]{};
};

struct MkvReader {
  Io io;
  FormatPtr format{};
  PacketPtr packet{av_packet_alloc()};
  ImagesPtr images[kMaxStreams]{};
};

namespace {

// --- the library --------------------------------------------------------------------------------

const char* missing() {
  if (avcodec_find_encoder(AV_CODEC_ID_FFV1) == nullptr) return "the encoder of FFV1";
  if (avcodec_find_decoder(AV_CODEC_ID_FFV1) == nullptr) return "the decoder of FFV1";
  if (av_guess_format("matroska", nullptr, nullptr) == nullptr) return "the muxer of Matroska";
  if (av_find_input_format("matroska") == nullptr) return "the demuxer of Matroska";
  return "";
}

void describe(int code, char* text, std::size_t size) { av_strerror(code, text, size); }

template <typename Object>
void close(Object* object) {
  delete object;
}

// --- writing ------------------------------------------------------------------------------------

int open_writer(const MkvFile* file, MkvWriter** writer) {
  std::unique_ptr<MkvWriter> made(new (std::nothrow) MkvWriter{*file});
  if (!made || !made->packet) return AVERROR(ENOMEM);
  AVFormatContext* format = nullptr;
  int code = made->io.open(true);
  if (code >= 0) code = avformat_alloc_output_context2(&format, nullptr, "matroska", nullptr);
  if (code < 0) return code;
  made->format.reset(format);
  format->pb = made->io.context;
  format->flags |= AVFMT_FLAG_BITEXACT;  // no random numbers and no date in the file
  *writer = made.release();
  return 0;
}

/// Opens the encoder of a track and stores its header in `parameters`.
int add_images(const MkvTrack& track, ImagesPtr& images, AVCodecParameters& parameters) {
  const AVCodec* ffv1 = avcodec_find_encoder(AV_CODEC_ID_FFV1);
  images.reset(new (std::nothrow) Images(ffv1, track.pixels, track.width, track.height));
  if (!images || !images->is_whole()) return AVERROR(ENOMEM);
  const int code = open_encoder(*images);
  return code < 0 ? code : avcodec_parameters_from_context(&parameters, images->codec.get());
}

int add_track(MkvWriter* writer, const MkvTrack* track) {
  AVStream* stream = avformat_new_stream(writer->format.get(), nullptr);
  if (stream == nullptr || stream->index >= kMaxStreams) return AVERROR(ENOMEM);
  AVCodecParameters& to = *stream->codecpar;
  to.width = track->width;
  to.height = track->height;
  stream->time_base = kMilliseconds;
  int code = copy(track->data, to);
  if (track->kind == MkvKind::kText) {
    to.codec_type = AVMEDIA_TYPE_SUBTITLE;
    to.codec_id = AV_CODEC_ID_SUBRIP;
  } else if (track->kind == MkvKind::kAttachment) {
    to.codec_type = AVMEDIA_TYPE_ATTACHMENT;
    if (code >= 0) code = av_dict_set(&stream->metadata, "filename", track->file_name, 0);
    if (code >= 0) code = av_dict_set(&stream->metadata, "mimetype", "application/json", 0);
  } else if (track->format == MkvFormat::kMjpeg) {
    to.codec_type = AVMEDIA_TYPE_VIDEO;
    to.codec_id = AV_CODEC_ID_MJPEG;
  } else if (code >= 0) {
    code = add_images(*track, writer->images[stream->index], to);
  }
  if (code >= 0) code = av_dict_set(&stream->metadata, "title", track->title, 0);
  return code < 0 ? code : stream->index;
}

int encode(MkvWriter* writer, int track, const void* image, MkvBytes* packet) {
  Images& images = *writer->images[track];
  AVFrame& frame = *images.frame;
  int code = av_frame_make_writable(&frame);
  if (code < 0) return code;
  copy_rows(images.rows(static_cast<const std::uint8_t*>(image)), images.frame_rows<std::uint8_t>(),
            frame.width, frame.height);
  code = avcodec_send_frame(images.codec.get(), &frame);
  if (code >= 0) code = avcodec_receive_packet(images.codec.get(), images.packet.get());
  *packet = {images.packet->data, static_cast<std::size_t>(images.packet->size)};
  return code;
}

int flush(MkvWriter* writer) {
  const int code = av_write_frame(writer->format.get(), nullptr);
  avio_flush(writer->io.context);
  return code;
}

int start(MkvWriter* writer) {
  const int code = avformat_write_header(writer->format.get(), nullptr);
  return code < 0 ? code : flush(writer);
}

int write(MkvWriter* writer, const MkvPacket* from) {
  // The data are borrowed for this call: FFmpeg does not change packets without a reference.
  AVPacket& packet = *writer->packet;
  packet.data = const_cast<std::uint8_t*>(from->bytes.data);
  packet.size = static_cast<int>(from->bytes.size);
  packet.stream_index = from->track;
  packet.flags = AV_PKT_FLAG_KEY;
  packet.pts = packet.dts = from->time_us / 1000;
  // milliseconds; not 0, so that the file has a duration even with a single image
  packet.duration = 1;
  return av_write_frame(writer->format.get(), &packet);
}

int finish(MkvWriter* writer) {
  const int code = av_write_trailer(writer->format.get());
  avio_flush(writer->io.context);
  return code;
}

// --- reading ------------------------------------------------------------------------------------

/// The class of demuxers with logging off: log_level_offset_offset refers to a field that demuxers
/// do not use. Errors in a file are thrown or counted by the caller, and not printed. (A callback
/// for FFmpeg's log would be that of the whole process, and silence its other users.)
const AVClass* quiet_class() {
  struct Class {
    AVClass fields;
    char of_later_versions[256];  // fields of later FFmpeg versions; 0: absent
  };
  static const Class quiet = [] {
    Class copy{*avformat_get_class(), {}};
    copy.fields.log_level_offset_offset = offsetof(AVFormatContext, metadata_header_padding);
    return copy;
  }();
  return &quiet.fields;
}

int open_reader(const MkvFile* file, MkvReader** reader) {
  std::unique_ptr<MkvReader> made(new (std::nothrow) MkvReader{*file});
  if (!made || !made->packet) return AVERROR(ENOMEM);
  int code = made->io.open(false);
  if (code < 0) return code;
  AVFormatContext* format = avformat_alloc_context();
  if (format == nullptr) return AVERROR(ENOMEM);
  format->av_class = quiet_class();
  format->metadata_header_padding = AV_LOG_MAX_OFFSET;
  format->pb = made->io.context;
  format->flags |= AVFMT_FLAG_NOFILLIN | AVFMT_FLAG_NOPARSE;
  format->max_streams = kMaxStreams;
  code = avformat_open_input(&format, "", av_find_input_format("matroska"), nullptr);
  if (code < 0) return code;  // the context was freed by the failed call
  made->format.reset(format);
  *reader = made.release();
  return 0;
}

const char* value_of(const AVDictionary* tags, const char* name) {
  const AVDictionaryEntry* entry = av_dict_get(tags, name, nullptr, 0);
  return entry == nullptr ? "" : entry->value;
}

MkvKind kind_of(AVMediaType type) {
  if (type == AVMEDIA_TYPE_VIDEO) return MkvKind::kVideo;
  if (type == AVMEDIA_TYPE_SUBTITLE) return MkvKind::kText;
  return type == AVMEDIA_TYPE_ATTACHMENT ? MkvKind::kAttachment : MkvKind::kOther;
}

MkvFormat format_of(AVCodecID codec) {
  if (codec == AV_CODEC_ID_FFV1) return MkvFormat::kFfv1;
  return codec == AV_CODEC_ID_MJPEG ? MkvFormat::kMjpeg : MkvFormat::kOther;
}

int track(MkvReader* reader, int number, MkvTrack* track) {
  const AVFormatContext& format = *reader->format;
  if (number < 0 || static_cast<unsigned>(number) >= format.nb_streams) return 0;
  const AVStream& stream = *format.streams[number];
  const AVCodecParameters& parameters = *stream.codecpar;
  const AVRational rate = stream.avg_frame_rate;
  track->kind = kind_of(parameters.codec_type);
  track->format = format_of(parameters.codec_id);
  track->width = parameters.width;
  track->height = parameters.height;
  track->four_cc = parameters.codec_tag;
  track->period_ns =
      rate.num > 0 && rate.den > 0 ? std::int64_t{1'000'000'000} * rate.den / rate.num : 0;
  track->data = {parameters.extradata,
                 static_cast<std::size_t>(std::max(parameters.extradata_size, 0))};
  track->title = value_of(stream.metadata, "title");
  track->file_name = value_of(stream.metadata, "filename");
  track->format_name = avcodec_get_name(parameters.codec_id);
  return 1;
}

const char* tag(MkvReader* reader, const char* name) {
  return value_of(reader->format->metadata, name);
}

std::int64_t duration_us(MkvReader* reader) {
  return std::max<std::int64_t>(reader->format->duration, 0);
}

int next(MkvReader* reader, MkvPacket* to) {
  AVPacket& packet = *reader->packet;
  av_packet_unref(&packet);
  const int code = av_read_frame(reader->format.get(), &packet);
  if (code < 0) return code;
  // A block has one time. Tracks with codecs of Video for Windows store it as dts.
  const std::int64_t time = packet.pts == AV_NOPTS_VALUE ? packet.dts : packet.pts;
  const AVRational unit = reader->format->streams[packet.stream_index]->time_base;
  *to = {packet.stream_index,
         av_rescale_q(time, unit, kMicroseconds),
         {packet.data, static_cast<std::size_t>(packet.size)}};
  return 0;
}

int seek(MkvReader* reader, int track, int entry) {
  constexpr std::int64_t kEnd = std::numeric_limits<std::int64_t>::max();
  AVFormatContext* format = reader->format.get();
  AVStream* stream = format->streams[track];
  // The first seek reads the index; positions of packets are known afterwards.
  int code = av_seek_frame(format, track, kEnd, AVSEEK_FLAG_BACKWARD);
  const int entries = avformat_index_get_entries_count(stream);
  if (code < 0 || entry >= entries - 1) return code < 0 ? code : entries;
  const AVIndexEntry* at = avformat_index_get_entry(stream, std::max(entry, 0));
  code = av_seek_frame(format, track, at->timestamp, AVSEEK_FLAG_BACKWARD);
  return code < 0 ? code : entries;
}

int open_decoder(MkvReader* reader, int track, MkvPixels pixels) {
  const AVCodec* ffv1 = avcodec_find_decoder(AV_CODEC_ID_FFV1);
  const AVCodecParameters& from = *reader->format->streams[track]->codecpar;
  ImagesPtr& images = reader->images[track];
  images.reset(new (std::nothrow) Images(ffv1, pixels, from.width, from.height));
  if (!images || !images->is_whole()) return AVERROR(ENOMEM);
  AVCodecContext& codec = *images->codec;
  codec.max_pixels = std::int64_t{from.height} * (std::int64_t{from.width} + kMaxRowPadding);
  codec.err_recognition = AV_EF_CRCCHECK | AV_EF_EXPLODE;
  const int code =
      copy({from.extradata, static_cast<std::size_t>(std::max(from.extradata_size, 0))}, codec);
  return code < 0 ? code : avcodec_open2(&codec, nullptr, nullptr);
}

int decode(MkvReader* reader, int track, MkvBytes bytes, void* image) {
  const AVCodecParameters& stream = *reader->format->streams[track]->codecpar;
  Images& images = *reader->images[track];
  // The data are borrowed for this call: FFmpeg copies packets without a reference.
  AVPacket& packet = *images.packet;
  packet.data = const_cast<std::uint8_t*>(bytes.data);
  packet.size = static_cast<int>(bytes.size);
  int code = avcodec_send_packet(images.codec.get(), &packet);
  if (code >= 0) code = avcodec_receive_frame(images.codec.get(), images.frame.get());
  if (code < 0) return code;
  const AVFrame& frame = *images.frame;
  if (frame.format != pixel_format(images.pixels) || frame.width != stream.width ||
      frame.height != stream.height) {
    return AVERROR_INPUT_CHANGED;
  }
  copy_rows(images.frame_rows<const std::uint8_t>(), images.rows(static_cast<std::uint8_t*>(image)),
            frame.width, frame.height);
  return 0;
}

}  // namespace

const MkvCodec& ffmpeg_mkv_codec() {
  static constexpr MkvCodec kCodec = {kMkvVersion,
                                      sizeof(MkvCodec),
                                      missing,
                                      describe,
                                      open_writer,
                                      add_track,
                                      start,
                                      encode,
                                      write,
                                      flush,
                                      finish,
                                      close<MkvWriter>,
                                      open_reader,
                                      track,
                                      tag,
                                      duration_us,
                                      next,
                                      seek,
                                      open_decoder,
                                      decode,
                                      close<MkvReader>};
  return kCodec;
}

}  // namespace manip3d
