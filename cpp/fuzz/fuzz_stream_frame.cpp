// Arbitrary meshes and colours as a message of the live session: an InputError, or a message that
// contains all its sections and the indices of the mesh.
#include <algorithm>
#include <cstring>
#include <vector>

#include "checks.hpp"
#include "manip3d/serve/stream_frame.hpp"
#include "mesh_from_bytes.hpp"

namespace {

using namespace manip3d;
using fuzzing::require;

std::uint32_t number_at(const std::vector<std::byte>& message, std::size_t at) {
  std::uint32_t value = 0;
  std::memcpy(&value, message.data() + at, sizeof(value));
  return value;
}

std::size_t section(std::size_t& at, std::size_t bytes) {
  const std::size_t start = (at + 3) / 4 * 4;
  at = start + bytes;
  return start;
}

void check(const std::vector<std::byte>& message, const StreamFrame& frame) {
  const std::size_t n = number_at(message, 32);
  const std::size_t body = number_at(message, 36), phantom = number_at(message, 40);
  require(n == frame.phantoms.size() && 3 * (body + phantom) == frame.faces.size());
  std::size_t at = 88;
  section(at, 6 * n);
  section(at, 4 * n);
  // 16 bits, because there are few vertices
  const std::size_t faces = section(at, 6 * (body + phantom));
  section(at, number_at(message, 72));
  if ((number_at(message, 12) & 2U) == 0) section(at, number_at(message, 76));
  const std::size_t status = section(at, number_at(message, 80));
  require(at == message.size());
  require(std::memcmp(message.data() + status, frame.status.data(), frame.status.size()) == 0);
  for (std::size_t i = 0; i < frame.faces.size(); ++i) {
    std::uint16_t index = 0;
    std::memcpy(&index, message.data() + faces + 2 * i, sizeof(index));
    require(index < n);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  fuzzing::Bytes bytes(data, std::min<std::size_t>(size, 4096));
  const std::size_t n = bytes.take<std::uint8_t>(), f = bytes.take<std::uint8_t>();
  const auto style = bytes.take<std::uint8_t>();
  std::vector<float> vertices(3 * n), texcoords(2 * n);
  std::vector<std::uint8_t> phantoms(n);
  std::vector<std::int32_t> faces(3 * f);
  for (float& x : vertices) {
    x = (style & 1) != 0 ? bytes.take<float>() : 0.01F * bytes.take<std::int8_t>();
  }
  for (float& x : texcoords) {
    x = (style & 2) != 0 ? bytes.take<float>() : bytes.take<std::uint8_t>() / 255.0F;
  }
  for (std::uint8_t& mark : phantoms) mark = bytes.take<std::uint8_t>() % 2;
  for (std::int32_t& index : faces) {
    const auto raw = bytes.take<std::uint8_t>();
    index = (style & 4) != 0 || n == 0 ? raw - 2 : static_cast<std::int32_t>(raw % n);
  }
  const std::int64_t rows = 1 + bytes.take<std::uint8_t>() % 40;
  const std::int64_t cols = 1 + bytes.take<std::uint8_t>() % 40;
  const std::vector<std::uint8_t> pixels(static_cast<std::size_t>(3 * rows * cols), style);
  const std::vector<std::uint8_t> other = pixels;
  StreamFrame frame;
  frame.vertices = vertices;
  frame.texcoords = texcoords;
  frame.phantoms = phantoms;
  frame.faces = faces;
  if ((style & 8) != 0) frame.color = {pixels.data(), rows, cols};
  if ((style & 16) != 0) frame.phantom_color = {other.data(), rows, cols};
  if ((style & 32) != 0) frame.opacity = bytes.take<float>();
  if ((style & 64) != 0) frame.jpeg_quality = bytes.take<std::int8_t>();
  frame.status = "{}";
  fuzzing::run([&] { check(encode_stream_frame(frame), frame); });
  return 0;
}
