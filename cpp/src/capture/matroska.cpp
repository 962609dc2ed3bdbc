#include "capture/matroska.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <new>
#include <system_error>
#include <utility>

#include "capture/ffv1.hpp"
#include "capture/mkv_library.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;

int read_file(void* self, std::int64_t position, std::uint8_t* data, int size) {
  MatroskaFile& file = *static_cast<MatroskaFile*>(self);
  ssize_t got = 0;
  do {
    got = ::pread(file.descriptor.get(), data, static_cast<std::size_t>(size), position);
  } while (got < 0 && errno == EINTR);
  if (got < 0) file.error = errno;
  return got < 0 ? -file.error : static_cast<int>(got);
}

int write_file(void* self, std::int64_t position, const std::uint8_t* data, int size) {
  MatroskaFile& file = *static_cast<MatroskaFile*>(self);
  // After an error nothing more may be written, or the header would refer to an index that is
  // missing.
  for (int done = 0; done < size && file.error == 0;) {
    const ssize_t written = ::pwrite(file.descriptor.get(), data + done,
                                     static_cast<std::size_t>(size - done), position + done);
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) {
      file.error = errno;
      break;
    }
    done += static_cast<int>(written);
    file.end = std::max(file.end, position + done);
  }
  return file.error == 0 ? size : -file.error;
}

}  // namespace

MatroskaFile::MatroskaFile(fs::path path_, int flags)
    : path(std::move(path_)), descriptor(::open(path.c_str(), flags | O_CLOEXEC, 0666)) {
  if (!descriptor.is_open()) refuse("cannot open");
}

MkvFile MatroskaFile::functions() {
  return {this, read_file, write_file,
          [](void* self) { return static_cast<MatroskaFile*>(self)->end; }};
}

void MatroskaFile::check(const char* action) const {
  if (error == 0) return;
  errno = error;
  refuse(action);
}

void MatroskaFile::refuse(const char* action) const {
  throw fs::filesystem_error(action, path, std::error_code(errno, std::generic_category()));
}

// --- writing ------------------------------------------------------------------------------------

MatroskaWriter::MatroskaWriter(const fs::path& path, bool overwrite)
    : file_((static_cast<void>(mkv_codec()), path), O_WRONLY | O_CREAT | (overwrite ? 0 : O_EXCL)),
      lock_(path, RecordingLock::For::kWriting),
      writer_(nullptr, mkv_codec().close_writer) {
  const MkvFile functions = file_.functions();
  MkvWriter* writer = nullptr;
  check(mkv_codec().open_writer(&functions, &writer));
  writer_.reset(writer);
}

int MatroskaWriter::add(const MkvTrack& track) {
  return check(mkv_codec().add_track(writer_.get(), &track));
}

void MatroskaWriter::start() {
  if (::ftruncate(file_.descriptor.get(), 0) != 0) file_.refuse("cannot write");
  check(mkv_codec().start(writer_.get()));
  whole_ = file_.end;
}

std::span<const std::byte> MatroskaWriter::encode(int track, const void* image) {
  MkvBytes packet{};
  check(mkv_codec().encode(writer_.get(), track, image, &packet));
  return from_mkv(packet);
}

void MatroskaWriter::write(int track, std::span<const std::byte> bytes, std::int64_t time_ms) {
  const MkvPacket packet{track, 1000 * time_ms, to_mkv(bytes)};
  check(mkv_codec().write(writer_.get(), &packet));
}

void MatroskaWriter::flush() {
  check(mkv_codec().flush(writer_.get()));
  whole_ = file_.end;
}

void MatroskaWriter::finish() {
  if (!file_.descriptor.is_open()) return;
  check(file_.error == 0 ? mkv_codec().finish(writer_.get()) : 0);
  if (::fsync(file_.descriptor.get()) != 0) file_.refuse("cannot sync");
  lock_.release();
  if (::close(file_.descriptor.release()) != 0) file_.refuse("cannot close");
}

void MatroskaWriter::leave() {
  lock_.release();
  file_.descriptor = Descriptor();
}

int MatroskaWriter::check(int code) {
  if (file_.error != 0) {
    // If the incomplete part cannot be cut off, readers skip it, because it is not a complete
    // cluster.
    [[maybe_unused]] const int result = ::ftruncate(file_.descriptor.get(), whole_);
    file_.check("cannot write");
  }
  // Memory ran out.
  if (code == -ENOMEM) throw std::bad_alloc();
  if (code < 0) throw DeviceError(file_.path.string() + ": cannot write: " + mkv_error(code));
  return code;
}

// --- reading ------------------------------------------------------------------------------------

MatroskaReader::MatroskaReader(const fs::path& path)
    : file_((static_cast<void>(mkv_codec()), path), O_RDONLY | O_NONBLOCK),
      lock_(path, RecordingLock::For::kReading),
      reader_(nullptr, mkv_codec().close_reader) {
  struct ::stat status{};
  if (::fstat(file_.descriptor.get(), &status) != 0) file_.refuse("cannot open");
  if (!S_ISREG(status.st_mode) && !S_ISDIR(status.st_mode)) {  // folders give an error in `read`
    throw FormatError("expected a regular file", {});
  }
  file_.end = status.st_size;
  const MkvFile functions = file_.functions();
  MkvReader* reader = nullptr;
  const int code = mkv_codec().open_reader(&functions, &reader);
  file_.check("cannot read");
  if (code < 0) throw FormatError::at_byte(0, "expected a Matroska file: " + mkv_error(code));
  reader_.reset(reader);
  for (MkvTrack track; mkv_codec().track(reader, static_cast<int>(tracks_.size()), &track) != 0;) {
    tracks_.push_back(track);
  }
}

std::optional<int> MatroskaReader::find(std::string_view title, MkvKind kind) const {
  const auto found = std::ranges::find_if(
      tracks_, [&](const MkvTrack& track) { return track.kind == kind && track.title == title; });
  if (found == tracks_.end()) return std::nullopt;
  return static_cast<int>(found - tracks_.begin());
}

const MkvTrack& MatroskaReader::attachment(const std::string& name) const {
  const auto found = std::ranges::find_if(tracks_, [&](const MkvTrack& track) {
    return track.kind == MkvKind::kAttachment && track.file_name == name;
  });
  if (found == tracks_.end()) throw FormatError("expected an attached " + name, {});
  return *found;
}

std::string MatroskaReader::tag(const char* name) const {
  return mkv_codec().tag(reader_.get(), name);
}

std::int64_t MatroskaReader::duration_us() const { return mkv_codec().duration_us(reader_.get()); }

void MatroskaReader::open_decoder(int number, MkvPixels pixels, ImageSize size) {
  const MkvTrack& images = track(number);
  if (images.format != MkvFormat::kFfv1) {
    throw FormatError(std::string("expected FFV1, got ") + images.format_name, {});
  }
  if (images.width != size.cols || images.height != size.rows) {
    throw FormatError("expected " + std::to_string(size.cols) + " x " + std::to_string(size.rows) +
                          " pixels, as in the calibration, got " + std::to_string(images.width) +
                          " x " + std::to_string(images.height),
                      {});
  }
  // In version 2, which was experimental, only the header limits the slices.
  if (ffv1_version(from_mkv(images.data)) == 2) {
    throw FormatError("expected FFV1 of another version than 2", {});
  }
  const int code = mkv_codec().open_decoder(reader_.get(), number, pixels);
  if (code < 0) throw FormatError("FFV1 header: " + mkv_error(code), {});
}

void MatroskaReader::decode(int track, std::span<const std::byte> packet, void* image) {
  if (count_ffv1_slices(packet) > kMaxFfv1Slices) {
    throw FormatError("FFV1: expected at most " + std::to_string(kMaxFfv1Slices) + " slices", {});
  }
  const int code = mkv_codec().decode(reader_.get(), track, to_mkv(packet), image);
  if (code < 0) throw FormatError("FFV1: " + mkv_error(code), {});
}

bool MatroskaReader::next(MatroskaPacket& packet) {
  MkvPacket from{};
  const int code = mkv_codec().next(reader_.get(), &from);
  file_.check("cannot read");
  if (code < 0) return false;
  const auto bytes = from_mkv(from.bytes);
  packet.track = from.track;
  packet.time_us = std::clamp(from.time_us, -MatroskaPacket::kMaxTime, MatroskaPacket::kMaxTime);
  packet.bytes.assign(bytes.begin(), bytes.end());
  return true;
}

int MatroskaReader::seek(int track, int entry) {
  const int code = mkv_codec().seek(reader_.get(), track, entry);
  file_.check("cannot read");
  return std::max(code, 0);
}

}  // namespace manip3d
