#include "io/output.hpp"

#include <lzma.h>
#include <zlib.h>

#include <new>
#include <utility>
#include <vector>

namespace manip3d {

// Compresses bytes with liblzma or zlib and writes them to the file. The output does not depend on
// the time.
class Output::Encoder {
 public:
  explicit Encoder(Compression compression) : out_(kBlock) {
    if (compression == Compression::kXz) {
      // Level 3 is five times as fast as the default, and the result is a tenth larger for meshes.
      if (lzma_easy_encoder(&xz_, 3, LZMA_CHECK_CRC64) != LZMA_OK) throw std::bad_alloc();
    } else {
      constexpr int kGzipHeader = 16, kMemoryLevel = 8;  // the values of gzip
      if (deflateInit2(&gzip_, Z_DEFAULT_COMPRESSION, Z_DEFLATED, MAX_WBITS + kGzipHeader,
                       kMemoryLevel, Z_DEFAULT_STRATEGY) != Z_OK) {
        throw std::bad_alloc();
      }
      is_gzip_ = true;
    }
  }
  Encoder(const Encoder&) = delete;
  Encoder& operator=(const Encoder&) = delete;
  ~Encoder() {
    lzma_end(&xz_);
    if (is_gzip_) deflateEnd(&gzip_);
  }

  void encode(std::string& data, bool last, AtomicFile& file) {
    bool more = true;
    while (more) {
      more = is_gzip_ ? gzip(data, last) : xz(data, last);
      file.write(out_.data(), out_size_);
    }
    gzip_started_ = xz_started_ = false;
  }

 private:
  bool gzip(std::string& data, bool last) {
    if (!gzip_started_) {
      gzip_.next_in = reinterpret_cast<Bytef*>(data.data());
      gzip_.avail_in = static_cast<uInt>(data.size());
      gzip_started_ = true;
    }
    gzip_.next_out = reinterpret_cast<Bytef*>(out_.data());
    gzip_.avail_out = static_cast<uInt>(out_.size());
    const int status = deflate(&gzip_, last ? Z_FINISH : Z_NO_FLUSH);
    out_size_ = out_.size() - gzip_.avail_out;
    return last ? status != Z_STREAM_END : gzip_.avail_in > 0;
  }

  bool xz(const std::string& data, bool last) {
    if (!xz_started_) {
      xz_.next_in = reinterpret_cast<const std::uint8_t*>(data.data());
      xz_.avail_in = data.size();
      xz_started_ = true;
    }
    xz_.next_out = reinterpret_cast<std::uint8_t*>(out_.data());
    xz_.avail_out = out_.size();
    const lzma_ret status = lzma_code(&xz_, last ? LZMA_FINISH : LZMA_RUN);
    if (status == LZMA_MEM_ERROR) throw std::bad_alloc();
    out_size_ = out_.size() - xz_.avail_out;
    return last ? status != LZMA_STREAM_END : xz_.avail_in > 0;
  }

  lzma_stream xz_ = LZMA_STREAM_INIT;
  z_stream gzip_{};
  bool is_gzip_ = false;
  bool gzip_started_ = false, xz_started_ = false;
  std::vector<char> out_;
  std::size_t out_size_ = 0;
};

Output::Output(const std::filesystem::path& path, Compression compression, Progress progress)
    : file_(path), is_in_place_(file_.temporary().empty()), progress_(std::move(progress)) {
  if (compression != Compression::kNone) encoder_ = std::make_unique<Encoder>(compression);
  buffer_.reserve(kBlock + kBlock / 4);
}

Output::~Output() {
  if (file_.temporary().empty()) return;  // the file has its name already, or is written in place
  for (const auto& companion : companions_) companion->withdraw();
}

void Output::flush() {
  if (encoder_) {
    encoder_->encode(buffer_, false, file_);
  } else {
    file_.write(buffer_.data(), buffer_.size());
  }
  buffer_.clear();
  if (progress_) progress_(0.0);  // the total is not known here, but the callback may cancel
}

void Output::finish() {
  if (is_finished_) return;
  if (encoder_) {
    encoder_->encode(buffer_, true, file_);
    buffer_.clear();
  } else {
    flush();
  }
  file_.sync();
  is_finished_ = true;
}

void Output::commit() {
  finish();
  file_.commit();
}

}  // namespace manip3d
