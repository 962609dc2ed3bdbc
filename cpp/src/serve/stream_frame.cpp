#include "manip3d/serve/stream_frame.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <string>

#include "capture/jpeg.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/grid_mesh.hpp"

namespace manip3d {
namespace {

static_assert(std::endian::native == std::endian::little, "the layout is the memory's");

constexpr std::uint32_t kWideIndices = 1, kSharedImage = 2;
constexpr std::uint16_t kNoColor = 65535;
constexpr float kSteps = 65535.0F, kTexelSteps = 65534.0F;

struct StreamHeader {
  std::array<char, 4> magic{'M', '3', 'D', 'L'};
  std::uint16_t version = kStreamVersion;
  std::uint16_t header_size = sizeof(StreamHeader);
  std::uint32_t sequence = 0, flags = 0;
  std::int64_t time_ns = 0, captured_ns = 0;
  std::uint32_t num_vertices = 0, body_faces = 0, phantom_faces = 0;
  float opacity = 1.0F;
  std::array<float, 3> low{}, step{};
  std::uint32_t body_jpeg = 0, phantom_jpeg = 0, status = 0, reserved = 0;
};
static_assert(sizeof(StreamHeader) == 88);

void check_stream_image(const StreamImage& image, const char* name) {
  if (image.pixels == nullptr) return;
  if (image.rows < 1 || image.cols < 1 || image.rows > kMaxImageSide ||
      image.cols > kMaxImageSide) {
    throw InputError(std::string(name) + ": expected 1 to " + std::to_string(kMaxImageSide) +
                     " pixels a side");
  }
}

void check_stream_frame(const StreamFrame& frame) {
  const std::size_t n = frame.phantoms.size();
  if (frame.vertices.size() != 3 * n) throw InputError("vertices: expected 3 for each vertex");
  if (frame.texcoords.size() != 2 * n) throw InputError("texcoords: expected 2 for each vertex");
  if (n >= 1U << 28 || frame.faces.size() >= 1U << 28) throw InputError("frame: too large");
  if (frame.faces.size() % 3 != 0) throw InputError("faces: expected 3 for each face");
  for (const float x : frame.vertices) {
    if (!std::isfinite(x)) throw InputError("vertices: expected finite numbers");
  }
  for (const std::int32_t i : frame.faces) {
    if (i < 0 || static_cast<std::size_t>(i) >= n) {
      throw InputError("faces: expected indices below " + std::to_string(n) + ", got " +
                       std::to_string(i));
    }
  }
  if (!(frame.opacity >= 0.0F && frame.opacity <= 1.0F)) {
    throw InputError("opacity: expected 0 to 1, got " + number_text(frame.opacity));
  }
  if (frame.jpeg_quality < 1 || frame.jpeg_quality > 100) {
    throw InputError("jpeg_quality: expected 1 to 100, got " + std::to_string(frame.jpeg_quality));
  }
  check_stream_image(frame.color, "color");
  check_stream_image(frame.phantom_color, "phantom_color");
}

/// A message that is built section by section.
class StreamMessage {
 public:
  explicit StreamMessage(std::size_t expected) { bytes_.reserve(expected); }

  /// Appends a section of `count` values, which begins at a multiple of four bytes.
  template <typename T>
  T* section(std::size_t count) {
    const std::size_t start = (bytes_.size() + 3) / 4 * 4;
    bytes_.resize(start + count * sizeof(T));
    return reinterpret_cast<T*>(bytes_.data() + start);
  }

  void add(std::span<const std::byte> content) {
    std::copy(content.begin(), content.end(), section<std::byte>(content.size()));
  }

  std::byte* data() { return bytes_.data(); }
  std::vector<std::byte> take() { return std::move(bytes_); }

 private:
  std::vector<std::byte> bytes_;
};

void quantise_positions(std::span<const float> vertices, StreamHeader& header, std::uint16_t* out) {
  std::array<float, 3> low, high;
  low.fill(std::numeric_limits<float>::infinity());
  high.fill(-std::numeric_limits<float>::infinity());
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    low[i % 3] = std::min(low[i % 3], vertices[i]);
    high[i % 3] = std::max(high[i % 3], vertices[i]);
  }
  if (vertices.empty()) return;
  std::array<double, 3> inverse{};
  for (std::size_t k = 0; k < 3; ++k) {
    // In double, because the extent of floats may exceed the largest float.
    const double extent = static_cast<double>(high[k]) - static_cast<double>(low[k]);
    header.low[k] = low[k];
    header.step[k] = static_cast<float>(extent / kSteps);
    inverse[k] = extent > 0.0 ? kSteps / extent : 0.0;
  }
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    const double off = static_cast<double>(vertices[i]) - static_cast<double>(low[i % 3]);
    out[i] = static_cast<std::uint16_t>(off * inverse[i % 3] + 0.5);
  }
}

/// The region of an image that texture coordinates use: columns and rows [begin, end).
struct TextureRegion {
  // smallest and largest coordinates in the image, v downwards
  std::array<float, 2> low{1.0F, 1.0F}, high{0.0F, 0.0F};
  std::array<std::int64_t, 2> begin{}, end{};

  void include(float u, float v) {
    low = {std::min(low[0], u), std::min(low[1], v)};
    high = {std::max(high[0], u), std::max(high[1], v)};
  }

  /// Computes the region with one pixel more on each side, for interpolation. Returns false if it
  /// is empty.
  bool settle(const StreamImage& image) {
    if (image.pixels == nullptr || low[0] > high[0]) return false;
    const std::array<std::int64_t, 2> size{image.cols, image.rows};
    for (std::size_t k = 0; k < 2; ++k) {
      const auto side = static_cast<float>(size[k]);
      begin[k] =
          std::clamp<std::int64_t>(static_cast<std::int64_t>(low[k] * side) - 1, 0, size[k] - 1);
      end[k] = std::clamp<std::int64_t>(static_cast<std::int64_t>(high[k] * side) + 2, begin[k] + 1,
                                        size[k]);
    }
    return true;
  }

  [[nodiscard]] std::uint16_t quantise(float over_image, std::size_t axis,
                                       std::int64_t size) const {
    const float at = over_image * static_cast<float>(size) - static_cast<float>(begin[axis]);
    const float share = at / static_cast<float>(end[axis] - begin[axis]);
    return static_cast<std::uint16_t>(std::clamp(share, 0.0F, 1.0F) * kTexelSteps + 0.5F);
  }
};

/// The regions of the body's and the phantom's image; one region if both are the same image.
class StreamTextures {
 public:
  explicit StreamTextures(const StreamFrame& frame)
      : images_{frame.color, frame.phantom_color},
        shared_(frame.color.pixels == frame.phantom_color.pixels) {
    for (std::size_t i = 0; i < frame.phantoms.size(); ++i) {
      const float* uv = &frame.texcoords[2 * i];
      if (is_on_image(uv[0], uv[1])) {
        regions_[which(frame.phantoms[i])].include(uv[0], 1.0F - uv[1]);
      }
    }
    for (std::size_t k = 0; k < 2; ++k) used_[k] = regions_[k].settle(images_[k]);
  }

  [[nodiscard]] bool shared() const { return shared_; }

  void write_texcoords(const StreamFrame& frame, std::uint16_t* out) const {
    for (std::size_t i = 0; i < frame.phantoms.size(); ++i) {
      const float* uv = &frame.texcoords[2 * i];
      const std::size_t k = which(frame.phantoms[i]);
      const bool colored = used_[k] && is_on_image(uv[0], uv[1]);
      out[2 * i] = colored ? regions_[k].quantise(uv[0], 0, images_[k].cols) : kNoColor;
      out[2 * i + 1] = colored ? regions_[k].quantise(1.0F - uv[1], 1, images_[k].rows) : kNoColor;
    }
  }

  /// Appends the region of image 0 or 1 as JPEG; returns its number of bytes.
  std::uint32_t write_jpeg(std::size_t k, int quality, StreamMessage& message) const {
    if (!used_[k]) return 0;
    const TextureRegion& region = regions_[k];
    const std::int64_t cols = region.end[0] - region.begin[0],
                       rows = region.end[1] - region.begin[1];
    std::vector<std::uint8_t> pixels(3 * rows * cols);
    for (std::int64_t row = 0; row < rows; ++row) {
      const std::int64_t start = (region.begin[1] + row) * images_[k].cols + region.begin[0];
      std::copy_n(images_[k].pixels + 3 * start, 3 * cols, pixels.data() + 3 * row * cols);
    }
    JpegEncoder encoder(quality);
    const std::span<const std::byte> packet = encoder.encode(pixels.data(), {rows, cols});
    message.add(packet);
    return static_cast<std::uint32_t>(packet.size());
  }

 private:
  [[nodiscard]] std::size_t which(std::uint8_t phantom) const {
    return phantom != 0 && !shared_ ? 1 : 0;
  }

  std::array<StreamImage, 2> images_;
  bool shared_;
  std::array<TextureRegion, 2> regions_;
  std::array<bool, 2> used_{};
};

template <typename Index>
void write_stream_faces(const StreamFrame& frame, StreamHeader& header, Index* out) {
  const auto phantom = [&](std::size_t f) {
    const std::int32_t* face = &frame.faces[f];
    return (frame.phantoms[face[0]] | frame.phantoms[face[1]] | frame.phantoms[face[2]]) != 0;
  };
  for (const bool wanted : {false, true}) {
    std::uint32_t& count = wanted ? header.phantom_faces : header.body_faces;
    for (std::size_t f = 0; f < frame.faces.size(); f += 3) {
      if (phantom(f) != wanted) continue;
      for (std::size_t k = 0; k < 3; ++k) *out++ = static_cast<Index>(frame.faces[f + k]);
      ++count;
    }
  }
}

}  // namespace

std::vector<std::byte> encode_stream_frame(const StreamFrame& frame) {
  check_stream_frame(frame);
  const std::size_t n = frame.phantoms.size();
  StreamHeader header;
  header.sequence = frame.sequence;
  header.time_ns = frame.time_ns;
  header.captured_ns = frame.captured_ns;
  header.num_vertices = static_cast<std::uint32_t>(n);
  header.opacity = frame.opacity;
  header.status = static_cast<std::uint32_t>(frame.status.size());
  const bool wide = n > 65536;
  const StreamTextures textures(frame);
  header.flags = (wide ? kWideIndices : 0U) | (textures.shared() ? kSharedImage : 0U);

  StreamMessage message(sizeof(StreamHeader) + 10 * n + frame.faces.size() * (wide ? 4 : 2) +
                        frame.status.size() + (1U << 17));
  message.section<std::byte>(sizeof(StreamHeader));
  quantise_positions(frame.vertices, header, message.section<std::uint16_t>(3 * n));
  textures.write_texcoords(frame, message.section<std::uint16_t>(2 * n));
  if (wide) {
    write_stream_faces(frame, header, message.section<std::uint32_t>(frame.faces.size()));
  } else {
    write_stream_faces(frame, header, message.section<std::uint16_t>(frame.faces.size()));
  }
  header.body_jpeg = textures.write_jpeg(0, frame.jpeg_quality, message);
  if (!textures.shared()) {
    header.phantom_jpeg = textures.write_jpeg(1, frame.jpeg_quality, message);
  }
  message.add(std::as_bytes(std::span(frame.status)));
  std::memcpy(message.data(), &header, sizeof(header));
  return message.take();
}

}  // namespace manip3d
