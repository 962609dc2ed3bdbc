#include "capture/matroska.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <limits>
#include <system_error>
#include <utility>

#include "manip3d/error.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;

constexpr int kBufferBytes = 1 << 16;
constexpr unsigned kMaxStreams = 64;  // recordings have five

[[noreturn]] void refuse_file(const char* action, const fs::path& path, int error) {
  throw fs::filesystem_error(action, path, std::error_code(error, std::generic_category()));
}

int write_file(void* opaque, std::uint8_t* data, int size) {
  MatroskaFile& file = *static_cast<MatroskaFile*>(opaque);
  // After an error nothing may follow: the header would tell of an index that is not there.
  for (int done = 0; done < size && file.error == 0;) {
    const ssize_t written = ::pwrite(file.descriptor, data + done,
                                     static_cast<std::size_t>(size - done), file.position);
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) {
      file.error = errno;
      break;
    }
    done += static_cast<int>(written);
    file.position += written;
    file.end = std::max(file.end, file.position);
  }
  return file.error == 0 ? size : AVERROR(file.error);
}

int read_file(void* opaque, std::uint8_t* data, int size) {
  MatroskaFile& file = *static_cast<MatroskaFile*>(opaque);
  ssize_t got = 0;
  do {
    got = ::pread(file.descriptor, data, static_cast<std::size_t>(size), file.position);
  } while (got < 0 && errno == EINTR);
  if (got < 0) file.error = errno;
  if (got < 0) return AVERROR(file.error);
  file.position += got;
  return got == 0 ? AVERROR_EOF : static_cast<int>(got);
}

std::int64_t seek_file(void* opaque, std::int64_t offset, int origin) {
  MatroskaFile& file = *static_cast<MatroskaFile*>(opaque);
  if ((origin & AVSEEK_SIZE) != 0) return file.end;
  origin &= ~AVSEEK_FORCE;
  if (origin != SEEK_SET && origin != SEEK_CUR && origin != SEEK_END) return AVERROR(EINVAL);
  const std::int64_t from = origin == SEEK_CUR ? file.position : origin == SEEK_END ? file.end : 0;
  const bool fits = offset <= std::numeric_limits<std::int64_t>::max() - from;
  if (!fits || from + offset < 0) return AVERROR(EINVAL);
  return file.position = from + offset;
}

AVIOContext* new_io(MatroskaFile& file, bool writes) {
  const Ffmpeg& ff = ffmpeg();
  auto* buffer = static_cast<unsigned char*>(allocated(ff.av_malloc(kBufferBytes)));
  return allocated(ff.avio_alloc_context(buffer, kBufferBytes, writes ? 1 : 0, &file,
                                         writes ? nullptr : read_file,
                                         writes ? write_file : nullptr, seek_file));
}

void free_io(AVIOContext*& io) {
  if (io == nullptr) return;
  ffmpeg().av_free(io->buffer);
  ffmpeg().avio_context_free(&io);
}

AVCodecParameters& parameters_of(const AVStream& stream) {
  return *field<AVCodecParameters*>(stream, ffmpeg().layout.stream_codecpar);
}

AVRational& time_base_of(AVStream& stream) {
  return field<AVRational>(stream, ffmpeg().layout.stream_time_base);
}

AVDictionary*& tags_of(AVStream& stream) {
  return field<AVDictionary*>(stream, ffmpeg().layout.stream_metadata);
}

int index_of(const AVStream& stream) { return field<int>(stream, ffmpeg().layout.stream_index); }

std::string value_of(const AVDictionary* tags, const char* name) {
  const AVDictionaryEntry* entry = ffmpeg().av_dict_get(tags, name, nullptr, 0);
  return entry == nullptr ? "" : entry->value;
}

}  // namespace

// --- writing ------------------------------------------------------------------------------------

MatroskaWriter::MatroskaWriter(const fs::path& path, bool overwrite)
    : path_(path), packet_(new_packet()) {
  const int how = O_WRONLY | O_CLOEXEC | O_CREAT | (overwrite ? O_TRUNC : O_EXCL);
  file_.descriptor = ::open(path.c_str(), how, 0666);
  if (file_.descriptor < 0) refuse_file("cannot create", path, errno);
  const Ffmpeg& ff = ffmpeg();
  io_ = new_io(file_, true);
  check(ff.avformat_alloc_output_context2(&format_, nullptr, "matroska", nullptr), "cannot write");
  format_->pb = io_;
  // No random numbers, no date.
  check(ff.av_opt_set(format_, "fflags", "+bitexact", 0), "cannot write");
}

MatroskaWriter::~MatroskaWriter() {
  if (format_ != nullptr) ffmpeg().avformat_free_context(format_);
  free_io(io_);
  if (file_.descriptor >= 0) ::close(file_.descriptor);
}

AVStream& MatroskaWriter::add_stream(AVMediaType type, AVCodecID codec, const char* title) {
  AVStream* stream = allocated(ffmpeg().avformat_new_stream(format_, nullptr));
  parameters_of(*stream).codec_type = type;
  parameters_of(*stream).codec_id = codec;
  time_base_of(*stream) = {1, 1000};
  check(ffmpeg().av_dict_set(&tags_of(*stream), "title", title, 0), "cannot write");
  return *stream;
}

int MatroskaWriter::add_video(const AVCodecContext& codec, const char* title) {
  AVStream& stream = add_stream(AVMEDIA_TYPE_VIDEO, codec.codec_id, title);
  check(ffmpeg().avcodec_parameters_from_context(&parameters_of(stream), &codec), "cannot write");
  return index_of(stream);
}

int MatroskaWriter::add_jpeg(ImageSize size, const char* title) {
  AVStream& stream = add_stream(AVMEDIA_TYPE_VIDEO, AV_CODEC_ID_MJPEG, title);
  set_size(parameters_of(stream), size);
  return index_of(stream);
}

int MatroskaWriter::add_text(const char* title) {
  return index_of(add_stream(AVMEDIA_TYPE_SUBTITLE, AV_CODEC_ID_SUBRIP, title));
}

void MatroskaWriter::add_attachment(const char* name, const std::string& description,
                                    const std::string& text) {
  const Ffmpeg& ff = ffmpeg();
  AVStream& stream = add_stream(AVMEDIA_TYPE_ATTACHMENT, AV_CODEC_ID_NONE, description.c_str());
  check(ff.av_dict_set(&tags_of(stream), "filename", name, 0), "cannot write");
  check(ff.av_dict_set(&tags_of(stream), "mimetype", "application/json", 0), "cannot write");
  AVCodecParameters& parameters = parameters_of(stream);
  parameters.extradata = static_cast<std::uint8_t*>(
      allocated(ff.av_mallocz(text.size() + AV_INPUT_BUFFER_PADDING_SIZE)));
  parameters.extradata_size = static_cast<int>(text.size());
  std::memcpy(parameters.extradata, text.data(), text.size());
}

void MatroskaWriter::start() {
  check(ffmpeg().avformat_write_header(format_, nullptr), "cannot write");
  flush();
}

void MatroskaWriter::write(int track, std::span<const std::byte> bytes, std::int64_t time_ms) {
  // Borrowed for this call: FFmpeg does not change packets that hold no reference.
  packet_->data = const_cast<std::uint8_t*>(reinterpret_cast<const std::uint8_t*>(bytes.data()));
  packet_->size = static_cast<int>(bytes.size());
  packet_->stream_index = track;
  packet_->flags = AV_PKT_FLAG_KEY;
  packet_->pts = packet_->dts = time_ms;
  packet_->duration = 1;  // so that even a single frame lasts (MatroskaReader::duration_ms)
  check(ffmpeg().av_write_frame(format_, packet_.get()), "cannot write");
}

void MatroskaWriter::flush() {
  check(ffmpeg().av_write_frame(format_, nullptr), "cannot write");
  ffmpeg().avio_flush(io_);
  check(0, "cannot write");
  whole_ = file_.end;
}

void MatroskaWriter::finish() {
  if (file_.descriptor < 0) return;
  const int code = file_.error == 0 ? ffmpeg().av_write_trailer(format_) : 0;
  if (file_.error == 0) ffmpeg().avio_flush(io_);
  check(code, "cannot write");
  if (::fsync(file_.descriptor) != 0) refuse_file("cannot sync", path_, errno);
  if (::close(std::exchange(file_.descriptor, -1)) != 0) refuse_file("cannot close", path_, errno);
}

void MatroskaWriter::check(int code, const char* action) {
  if (file_.error != 0) {
    // What cannot be cut off is passed over by readers: it is no whole cluster.
    static_cast<void>(::ftruncate(file_.descriptor, whole_));
    refuse_file(action, path_, file_.error);
  }
  if (code < 0) throw DeviceError(path_.string() + ": " + action + ": " + ffmpeg_error(code));
}

// --- reading ------------------------------------------------------------------------------------

MatroskaReader::MatroskaReader(const fs::path& path) : path_(path) {
  try {
    open();
  } catch (...) {
    close();
    throw;
  }
}

MatroskaReader::~MatroskaReader() { close(); }

void MatroskaReader::open() {
  const Ffmpeg& ff = ffmpeg();
  file_.descriptor = ::open(path_.c_str(), O_RDONLY | O_CLOEXEC);
  struct ::stat status{};
  if (file_.descriptor < 0 || ::fstat(file_.descriptor, &status) != 0) {
    refuse_file("cannot open", path_, errno);
  }
  file_.end = status.st_size;
  io_ = new_io(file_, false);
  format_ = allocated(ff.avformat_alloc_context());
  format_->pb = io_;
  int code = ff.av_opt_set(format_, "fflags", "+nofillin+noparse", 0);
  if (code >= 0) code = ff.av_opt_set_int(format_, "max_streams", kMaxStreams, 0);
  if (code < 0) throw DeviceError(ffmpeg_error(code));
  code = ff.avformat_open_input(&format_, "", ff.av_find_input_format("matroska"), nullptr);
  if (file_.error != 0) refuse_file("cannot read", path_, file_.error);
  if (code < 0) {
    throw FormatError::at_byte(0, "expected a Matroska file: " + ffmpeg_error(code));
  }
}

void MatroskaReader::close() {
  if (format_ != nullptr) ffmpeg().avformat_close_input(&format_);
  free_io(io_);
  if (file_.descriptor >= 0) ::close(std::exchange(file_.descriptor, -1));
}

std::optional<int> MatroskaReader::find(const char* title, AVMediaType type) const {
  for (AVStream* stream : streams()) {
    if (parameters_of(*stream).codec_type == type && value_of(tags_of(*stream), "title") == title) {
      return index_of(*stream);
    }
  }
  return std::nullopt;
}

MatroskaReader::Attachment MatroskaReader::attachment(const char* name) const {
  for (AVStream* stream : streams()) {
    const AVCodecParameters& data = parameters_of(*stream);
    if (data.codec_type != AVMEDIA_TYPE_ATTACHMENT ||
        value_of(tags_of(*stream), "filename") != name) {
      continue;
    }
    const auto* text = reinterpret_cast<const char*>(data.extradata);
    return {{text, static_cast<std::size_t>(data.extradata_size)},
            value_of(tags_of(*stream), "title")};
  }
  throw FormatError(std::string("expected an attached ") + name, {});
}

const AVCodecParameters& MatroskaReader::parameters(int track) const {
  return parameters_of(stream(track));
}

AVRational MatroskaReader::frame_rate(int track) const {
  return field<AVRational>(stream(track), ffmpeg().layout.stream_rate);
}

std::string MatroskaReader::tag(const char* name) const {
  return value_of(field<AVDictionary*>(*format_, ffmpeg().layout.format_metadata), name);
}

std::int64_t MatroskaReader::time_ns(const AVPacket& packet) const {
  constexpr std::int64_t kMost = std::int64_t{1} << 61;  // differences fit
  const std::int64_t time = ffmpeg().av_rescale_q(
      packet.pts, time_base_of(stream(packet.stream_index)), {1, 1'000'000'000});
  return std::clamp(time, -kMost, kMost);
}

std::int64_t MatroskaReader::duration_ms() const {
  const auto duration = field<std::int64_t>(*format_, ffmpeg().layout.format_duration);
  return std::max<std::int64_t>(duration, 0) / (AV_TIME_BASE / 1000);
}

bool MatroskaReader::next(AVPacket& packet) {
  ffmpeg().av_packet_unref(&packet);
  const int code = ffmpeg().av_read_frame(format_, &packet);
  if (file_.error != 0) refuse_file("cannot read", path_, file_.error);
  // The one time of a block; tracks of Video for Windows' codecs have it under the other name.
  if (code >= 0 && packet.pts == AV_NOPTS_VALUE) packet.pts = packet.dts;
  return code >= 0;
}

bool MatroskaReader::seek_last(int track) {
  constexpr std::int64_t kEnd = std::numeric_limits<std::int64_t>::max();
  const int code = ffmpeg().av_seek_frame(format_, track, kEnd, AVSEEK_FLAG_BACKWARD);
  if (file_.error != 0) refuse_file("cannot read", path_, file_.error);
  return code >= 0;
}

}  // namespace manip3d
