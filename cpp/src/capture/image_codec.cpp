#include "capture/image_codec.hpp"

#include <png.h>

#include <algorithm>
#include <bit>
#include <csetjmp>
#include <cstdio>
#include <cstring>
#include <string>

#include "capture/jpeg.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/camera.hpp"

// libpng reports errors by longjmp: no object with a destructor may be created between `guarded`
// and calls that may fail.
namespace manip3d {
namespace {

using Bytes = std::vector<std::byte>;
using ByteSpan = std::span<const std::byte>;

constexpr std::size_t kMaxPngChunk = 8 << 20;

void check_size(std::int64_t rows, std::int64_t cols, std::int64_t max_pixels) {
  if (rows > 0 && cols > 0 && rows <= kMaxImageSide && cols <= kMaxImageSide &&
      rows * cols <= max_pixels) {
    return;
  }
  throw FormatError("expected an image of 1 to " + std::to_string(max_pixels) + " pixels, got " +
                        std::to_string(cols) + " x " + std::to_string(rows),
                    {});
}

// --- PNG ----------------------------------------------------------------------------------------

struct PngMessage {
  char text[128] = "";
};

[[noreturn]] void on_png_error(png_structp png, png_const_charp text) {
  auto* message = static_cast<PngMessage*>(png_get_error_ptr(png));
  std::snprintf(message->text, sizeof(message->text), "%s", text);
  std::longjmp(png_jmpbuf(png), 1);
}

void on_png_warning(png_structp, png_const_charp) {}  // ignored; for example, about colour profiles

class PngReader {
 public:
  explicit PngReader(ByteSpan data) : left_(data) {
    png_ = png_create_read_struct(PNG_LIBPNG_VER_STRING, &message_, on_png_error, on_png_warning);
    if (png_ == nullptr) throw std::bad_alloc();
    info_ = png_create_info_struct(png_);
    if (info_ == nullptr) {
      png_destroy_read_struct(&png_, nullptr, nullptr);
      throw std::bad_alloc();
    }
  }
  PngReader(const PngReader&) = delete;
  PngReader& operator=(const PngReader&) = delete;
  ~PngReader() { png_destroy_read_struct(&png_, &info_, nullptr); }

  void read_header(std::int64_t max_pixels) {
    guarded([this] {
      png_set_read_fn(png_, &left_, take);
      png_set_user_limits(png_, kMaxImageSide, kMaxImageSide);
      png_set_chunk_malloc_max(png_, kMaxPngChunk);
      png_read_info(png_, info_);
    });
    check_size(rows(), cols(), max_pixels);
  }

  /// Reads the pixels, `pixel_bytes` each, after `transforms` has set their conversion.
  template <typename Transforms>
  void read_pixels(void* pixels, std::size_t pixel_bytes, const Transforms& transforms) {
    const std::size_t stride = static_cast<std::size_t>(cols()) * pixel_bytes;
    std::vector<png_bytep> lines(rows());
    for (std::size_t v = 0; v < lines.size(); ++v) {
      lines[v] = static_cast<png_bytep>(pixels) + v * stride;
    }
    guarded([&] {
      transforms(png_);
      png_set_interlace_handling(png_);
      png_read_update_info(png_, info_);
      if (png_get_rowbytes(png_, info_) != stride) png_error(png_, "an unknown kind of pixels");
      png_read_image(png_, lines.data());
      png_read_end(png_, nullptr);  // checks the CRCs of the rest
    });
  }

  [[nodiscard]] std::int64_t rows() const { return png_get_image_height(png_, info_); }
  [[nodiscard]] std::int64_t cols() const { return png_get_image_width(png_, info_); }
  [[nodiscard]] int bit_depth() const { return png_get_bit_depth(png_, info_); }
  [[nodiscard]] bool is_grey() const {
    return png_get_color_type(png_, info_) == PNG_COLOR_TYPE_GRAY;
  }

 private:
  static void take(png_structp png, png_bytep to, std::size_t size) {
    auto* left = static_cast<ByteSpan*>(png_get_io_ptr(png));
    if (size > left->size()) png_error(png, "the file ends too early");
    std::memcpy(to, left->data(), size);
    *left = left->subspan(size);
  }

  template <typename Steps>
  void guarded(const Steps& steps) {
    if (setjmp(png_jmpbuf(png_)) != 0) {
      throw FormatError(std::string("damaged PNG: ") + message_.text, {});
    }
    steps();
  }

  PngMessage message_;
  ByteSpan left_;
  png_structp png_ = nullptr;
  png_infop info_ = nullptr;
};

DecodedImage<std::uint8_t> decode_png_rgb(ByteSpan data, std::int64_t max_pixels) {
  PngReader png(data);
  png.read_header(max_pixels);
  DecodedImage<std::uint8_t> image{png.rows(), png.cols(), {}};
  image.pixels.resize(3 * image.rows * image.cols);
  png.read_pixels(image.pixels.data(), 3, [](png_structp reader) {
    png_set_expand(reader);
    png_set_scale_16(reader);
    png_set_gray_to_rgb(reader);
    png_set_strip_alpha(reader);
  });
  return image;
}

[[noreturn]] void refuse_kind(const char* expected, const PngReader& png) {
  throw FormatError(std::string("expected a grey PNG of ") + expected + ", got " +
                        (png.is_grey() ? "grey" : "colour") + " of " +
                        std::to_string(png.bit_depth()) + " bits",
                    {});
}

class PngWriter {
 public:
  PngWriter() {
    png_ = png_create_write_struct(PNG_LIBPNG_VER_STRING, &message_, on_png_error, on_png_warning);
    if (png_ == nullptr) throw std::bad_alloc();
    info_ = png_create_info_struct(png_);
    if (info_ == nullptr) {
      png_destroy_write_struct(&png_, nullptr);
      throw std::bad_alloc();
    }
  }
  PngWriter(const PngWriter&) = delete;
  PngWriter& operator=(const PngWriter&) = delete;
  ~PngWriter() { png_destroy_write_struct(&png_, &info_); }

  Bytes encode(const void* pixels, std::int64_t rows, std::int64_t cols, int bit_depth,
               int channels) {
    const std::size_t stride = cols * channels * bit_depth / 8;
    const auto* first = static_cast<png_const_bytep>(pixels);
    if (setjmp(png_jmpbuf(png_)) != 0) throw Error(std::string("PNG: ") + message_.text);
    png_set_write_fn(png_, &out_, append, nullptr);
    png_set_compression_level(png_, 1);
    png_set_filter(png_, PNG_FILTER_TYPE_BASE, PNG_FILTER_UP);
    png_set_IHDR(png_, info_, static_cast<png_uint_32>(cols), static_cast<png_uint_32>(rows),
                 bit_depth, channels == 1 ? PNG_COLOR_TYPE_GRAY : PNG_COLOR_TYPE_RGB,
                 PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    png_write_info(png_, info_);
    if (bit_depth == 16 && std::endian::native == std::endian::little) png_set_swap(png_);
    for (std::int64_t v = 0; v < rows; ++v) {
      png_write_row(png_, first + static_cast<std::size_t>(v) * stride);
    }
    png_write_end(png_, info_);
    return std::move(out_);
  }

 private:
  static void append(png_structp png, png_bytep data, std::size_t size) {
    auto* out = static_cast<Bytes*>(png_get_io_ptr(png));
    const auto* bytes = reinterpret_cast<const std::byte*>(data);
    try {
      out->insert(out->end(), bytes, bytes + size);
    } catch (const std::bad_alloc&) {
      png_error(png, "out of memory");
    }
  }

  PngMessage message_;
  Bytes out_;
  png_structp png_ = nullptr;
  png_infop info_ = nullptr;
};

DecodedImage<std::uint8_t> decode_jpeg(ByteSpan data, std::int64_t max_pixels) {
  JpegDecoder decoder;
  const ImageSize size = decoder.size(data);
  check_size(size.rows, size.cols, max_pixels);
  DecodedImage<std::uint8_t> image{size.rows, size.cols, {}};
  image.pixels.resize(3 * size.rows * size.cols);
  decoder.decode(data, size, image.pixels.data());
  return image;
}

bool begins_with(ByteSpan data, std::initializer_list<int> bytes) {
  return data.size() >= bytes.size() &&
         std::equal(bytes.begin(), bytes.end(), data.begin(), [](int expected, std::byte got) {
           return expected == std::to_integer<int>(got);
         });
}

}  // namespace

DecodedImage<std::uint16_t> decode_depth(ByteSpan data, std::int64_t max_pixels) {
  PngReader png(data);
  png.read_header(max_pixels);
  if (!png.is_grey() || png.bit_depth() < 8) refuse_kind("16 or 8 bits", png);
  const bool is_narrow = png.bit_depth() == 8;
  DecodedImage<std::uint16_t> image{png.rows(), png.cols(), {}};
  image.pixels.resize(image.rows * image.cols);
  png.read_pixels(image.pixels.data(), 2, [](png_structp reader) {
    png_set_expand_16(reader);
    png_set_strip_alpha(reader);  // a value that is said to be transparent is a depth like others
    if (std::endian::native == std::endian::little) png_set_swap(reader);
  });
  if (is_narrow) {  // because widening multiplied the values by 257
    for (std::uint16_t& value : image.pixels) value = static_cast<std::uint16_t>(value & 0xff);
    image.has_8_bits = true;
  }
  return image;
}

DecodedImage<std::uint8_t> decode_grey(ByteSpan data, std::int64_t max_pixels) {
  PngReader png(data);
  png.read_header(max_pixels);
  if (!png.is_grey() || png.bit_depth() != 8) refuse_kind("8 bits", png);
  DecodedImage<std::uint8_t> image{png.rows(), png.cols(), {}};
  image.pixels.resize(image.rows * image.cols);
  png.read_pixels(image.pixels.data(), 1, [](png_structp) {});
  return image;
}

DecodedImage<std::uint8_t> decode_rgb(ByteSpan data, std::int64_t max_pixels) {
  if (begins_with(data, {0x89, 'P', 'N', 'G'})) return decode_png_rgb(data, max_pixels);
  if (begins_with(data, {0xff, 0xd8})) return decode_jpeg(data, max_pixels);
  throw FormatError::at_byte(0, "expected a PNG or a JPEG");
}

Bytes encode_png(std::span<const std::uint16_t> grey, std::int64_t cols) {
  return PngWriter().encode(grey.data(), std::ssize(grey) / cols, cols, 16, 1);
}

Bytes encode_png(std::span<const std::uint8_t> pixels, std::int64_t cols, int channels) {
  return PngWriter().encode(pixels.data(), std::ssize(pixels) / (cols * channels), cols, 8,
                            channels);
}

}  // namespace manip3d
