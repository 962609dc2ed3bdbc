// Decoders of KHR_meshopt_compression, appendix A (bit streams) and appendix B (filters), and of
// the earlier EXT_meshopt_compression, which has neither version 1 of attributes nor colours.
#include "io/meshopt_codec.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <string>
#include <type_traits>

#include "manip3d/error.hpp"

namespace manip3d {
namespace {

using Stream = std::span<const std::byte>;
using Decoded = std::vector<std::byte>;

/// Reads a stream from its beginning to the beginning of its tail.
class MeshoptCursor {
 public:
  MeshoptCursor(Stream stream, std::int64_t tail_bytes) : stream_(stream) {
    end_ = static_cast<std::int64_t>(stream.size()) - tail_bytes;
    if (end_ < 1) fail("the stream is shorter than its head and tail");
  }

  [[noreturn]] void fail(const std::string& reason) const {
    throw FormatError::at_byte(at_, reason);
  }

  Stream take(std::int64_t size) {
    if (size > end_ - at_) fail("the stream ends within its data");
    const Stream bytes = stream_.subspan(at_, size);
    at_ += size;
    return bytes;
  }

  unsigned byte() { return std::to_integer<unsigned>(take(1)[0]); }

  /// Reads LEB128 of at most five bytes; bits beyond 32 are ignored.
  std::uint32_t varint() {
    std::uint32_t value = 0;
    for (int shift = 0; shift < 35; shift += 7) {
      const unsigned part = byte();
      value |= static_cast<std::uint32_t>(part & 0x7FU) << shift;
      if ((part & 0x80U) == 0) return value;
    }
    fail("a number of more than five bytes");
  }

  void check_end() const {
    if (at_ != end_) fail(std::to_string(end_ - at_) + " bytes are left over before the tail");
  }

 private:
  Stream stream_;
  std::int64_t at_ = 0;
  std::int64_t end_ = 0;
};

template <typename T>
T load_little(const std::byte* data) {  // little endian, like all supported machines
  T value;
  std::memcpy(&value, data, sizeof(T));
  return value;
}

template <typename T>
void store_little(T value, std::byte* data) {
  std::memcpy(data, &value, sizeof(T));
}

/// Decodes signed differences, which are stored as 0, -1, 1, -2, ...
template <typename T>
T undo_zigzag(T value) {
  return static_cast<T>((value & 1U) != 0 ? ~(value >> 1U) : value >> 1U);
}

// --- Mode 0: attributes ------------------------------------------------------------------

constexpr std::int64_t kGroup = 16;  ///< Elements whose differences have a common number of bits.

/// Reads the differences of one byte position in 16 elements, with `bits` bits each. The largest
/// value means that a whole byte follows after the group. One-bit values begin at the lowest bit,
/// others at the highest.
void read_group(MeshoptCursor& cursor, int bits, std::uint8_t* out) {
  if (bits == 0) {
    std::fill_n(out, kGroup, std::uint8_t{0});
    return;
  }
  const Stream packed = cursor.take(kGroup * bits / 8);
  if (bits == 8) {
    std::memcpy(out, packed.data(), kGroup);
    return;
  }
  const int per_byte = 8 / bits;
  const unsigned escape = (1U << bits) - 1;
  for (int i = 0; i < kGroup; ++i) {
    const int place = i % per_byte;
    const int shift = bits == 1 ? place : (per_byte - 1 - place) * bits;
    const unsigned value = (std::to_integer<unsigned>(packed[i / per_byte]) >> shift) & escape;
    out[i] = static_cast<std::uint8_t>(value == escape ? cursor.byte() : value);
  }
}

class AttributeDecoder {
 public:
  AttributeDecoder(Stream stream, const MeshoptLayout& layout)
      : layout_(layout),
        version_(stream.empty() ? 0 : std::to_integer<int>(stream[0]) & 0x0F),
        tail_(layout.stride + (version_ == 0 ? 0 : layout.stride / 4)),
        cursor_(stream, std::max<std::int64_t>(tail_, version_ == 0 ? 32 : 24)) {
    const Stream tail = stream.last(tail_);
    if (const unsigned head = cursor_.byte(); head != 0xA0 && head != 0xA1) {
      cursor_.fail("expected attributes (160 or 161) in the first byte, got " +
                   std::to_string(head));
    }
    previous_.assign(tail.begin(), tail.begin() + layout.stride);
    if (version_ == 0) {
      channels_.assign(layout.stride / 4, 0);
      return;
    }
    for (const std::byte mode : tail.subspan(layout.stride)) {
      channels_.push_back(std::to_integer<unsigned>(mode));
      const unsigned kind = channels_.back() & 0x0FU;
      if (kind > 2 || (kind < 2 && channels_.back() != kind)) {
        cursor_.fail("unknown channel mode " + std::to_string(channels_.back()) + " in the tail");
      }
    }
  }

  Decoded decode() {
    Decoded decoded(layout_.count * layout_.stride);
    const std::int64_t block = std::min<std::int64_t>((8192 / layout_.stride) & ~15, 256);
    for (std::int64_t first = 0; first < layout_.count; first += block) {
      const std::int64_t num_elements = std::min(block, layout_.count - first);
      read_differences(num_elements);
      std::byte* out = decoded.data() + first * layout_.stride;
      for (std::size_t c = 0; c < channels_.size(); ++c) add_channel(c, num_elements, out);
    }
    cursor_.check_end();
    return decoded;
  }

 private:
  /// Fills `differences_` with the differences of a block: for each byte position those of all
  /// elements.
  void read_differences(std::int64_t num_elements) {
    const std::int64_t num_groups = (num_elements + kGroup - 1) / kGroup;
    padded_ = num_groups * kGroup;
    differences_.assign(layout_.stride * padded_, 0);
    const Stream controls = cursor_.take(version_ == 0 ? 0 : layout_.stride / 4);
    for (std::int64_t k = 0; k < layout_.stride; ++k) {
      std::uint8_t* out = differences_.data() + k * padded_;
      if (version_ == 0) {
        read_groups(num_groups, {0, 2, 4, 8}, out);
        continue;
      }
      switch ((std::to_integer<unsigned>(controls[k / 4]) >> (k % 4 * 2)) & 3U) {
        case 0:
          read_groups(num_groups, {0, 1, 2, 4}, out);
          break;
        case 1:
          read_groups(num_groups, {1, 2, 4, 8}, out);
          break;
        case 2:
          break;  // all are zero
        default:
          std::memcpy(out, cursor_.take(num_elements).data(), num_elements);
      }
    }
  }

  void read_groups(std::int64_t num_groups, const std::array<int, 4>& bits, std::uint8_t* out) {
    const Stream heads = cursor_.take((num_groups + 3) / 4);
    for (std::int64_t g = 0; g < num_groups; ++g) {
      const unsigned head = (std::to_integer<unsigned>(heads[g / 4]) >> (g % 4 * 2)) & 3U;
      read_group(cursor_, bits[head], out + g * kGroup);
    }
  }

  /// Sums the differences of four byte positions; `previous_` keeps the last element.
  void add_channel(std::size_t channel, std::int64_t num_elements, std::byte* out) {
    const std::uint8_t* differences =
        differences_.data() + static_cast<std::int64_t>(channel) * 4 * padded_;
    std::byte* const last = previous_.data() + channel * 4;
    out += channel * 4;
    for (std::int64_t i = 0; i < num_elements; ++i, out += layout_.stride) {
      const std::array<std::uint8_t, 4> d = {differences[i], differences[padded_ + i],
                                             differences[2 * padded_ + i],
                                             differences[3 * padded_ + i]};
      add_difference(channels_[channel], d.data(), last);
      std::memcpy(out, last, 4);
    }
  }

  static void add_difference(unsigned mode, const std::uint8_t* difference, std::byte* value) {
    const auto* bytes = reinterpret_cast<const std::byte*>(difference);
    if (mode == 0) {
      add_zigzag<std::uint8_t>(bytes, value);
    } else if (mode == 1) {
      add_zigzag<std::uint16_t>(bytes, value);
    } else {
      const auto turned = std::rotr(load_little<std::uint32_t>(bytes), static_cast<int>(mode >> 4));
      store_little(load_little<std::uint32_t>(value) ^ turned, value);
    }
  }

  template <typename T>
  static void add_zigzag(const std::byte* difference, std::byte* value) {
    for (std::size_t k = 0; k < 4; k += sizeof(T)) {
      const T sum =
          static_cast<T>(load_little<T>(value + k) + undo_zigzag(load_little<T>(difference + k)));
      store_little(sum, value + k);
    }
  }

  MeshoptLayout layout_;
  int version_;
  std::int64_t tail_;
  MeshoptCursor cursor_;
  Decoded previous_;
  std::vector<unsigned> channels_;  ///< Mode of each four bytes; the high bits are a rotation.
  std::vector<std::uint8_t> differences_;
  std::int64_t padded_ = 0;
};

// --- Mode 1: triangles -------------------------------------------------------------------

/// The last 16 entries; index 0 is the newest.
template <typename T>
class MeshoptFifo {
 public:
  void push(const T& entry) { entries_[num_pushed_++ % entries_.size()] = entry; }

  [[nodiscard]] const T& at(std::size_t age, const MeshoptCursor& cursor) const {
    if (age >= std::min(num_pushed_, entries_.size())) {
      cursor.fail("refers to an edge or a vertex before the first");
    }
    return entries_[(num_pushed_ - 1 - age) % entries_.size()];
  }

 private:
  std::array<T, 16> entries_ = {};
  std::size_t num_pushed_ = 0;
};

class TriangleDecoder {
 public:
  TriangleDecoder(Stream stream, const MeshoptLayout& layout)
      : cursor_(stream, kTail), layout_(layout), table_(stream.last(kTail)) {
    if (const unsigned head = cursor_.byte(); head != 0xE1) {
      cursor_.fail("expected triangles (225) in the first byte, got " + std::to_string(head));
    }
    codes_ = cursor_.take(layout.count / 3);
  }

  Decoded decode() {
    Decoded decoded(layout_.count * layout_.stride);
    std::byte* out = decoded.data();
    for (const std::byte code : codes_) {
      for (const std::uint32_t corner : triangle(std::to_integer<unsigned>(code))) {
        std::memcpy(out, &corner, layout_.stride);  // with a stride of two, the two lower bytes
        out += layout_.stride;
      }
    }
    cursor_.check_end();
    return decoded;
  }

 private:
  static constexpr std::int64_t kTail = 16;
  struct Edge {
    std::uint32_t a, b;
  };
  using Triangle = std::array<std::uint32_t, 3>;

  Triangle triangle(unsigned code) {
    if (code < 0xF0) return beside_edge(code >> 4U, code & 0x0FU);
    if (code < 0xFE) return from_code(next_++, tabled(code & 0x0FU));
    const unsigned corners = cursor_.byte();
    if (corners == 0) next_ = 0;
    return from_code(code == 0xFE ? next_++ : explicit_index(), corners);
  }

  [[nodiscard]] unsigned tabled(unsigned entry) const {
    const auto corners = std::to_integer<unsigned>(table_[entry]);
    if (corners >> 4U == 0x0F || (corners & 0x0FU) == 0x0F) {
      cursor_.fail("the table in the tail has an entry of " + std::to_string(corners));
    }
    return corners;
  }

  /// Decodes a triangle that shares an edge with a recent one.
  Triangle beside_edge(unsigned age, unsigned how) {
    const Edge edge = edges_.at(age, cursor_);
    std::uint32_t c = 0;
    if (how == 0) {
      c = next_++;
    } else if (how < 0x0D) {
      c = vertices_.at(how, cursor_);
    } else if (how < 0x0F) {
      c = last_ += how == 0x0D ? ~std::uint32_t{0} : 1U;
    } else {
      c = explicit_index();
    }
    edges_.push({c, edge.b});
    edges_.push({edge.a, c});
    if (how == 0 || how >= 0x0D) vertices_.push(c);
    return {edge.a, edge.b, c};
  }

  /// Decodes a triangle whose second and third corners are encoded in the two halves of `corners`.
  Triangle from_code(std::uint32_t a, unsigned corners) {
    const unsigned second = corners >> 4U, third = corners & 0x0FU;
    const std::uint32_t b = corner(second);
    const std::uint32_t c = corner(third);
    vertices_.push(a);
    if (second == 0 || second == 0x0F) vertices_.push(b);
    if (third == 0 || third == 0x0F) vertices_.push(c);
    edges_.push({b, a});
    edges_.push({c, b});
    edges_.push({a, c});
    return {a, b, c};
  }

  std::uint32_t corner(unsigned how) {
    if (how == 0) return next_++;
    return how == 0x0F ? explicit_index() : vertices_.at(how - 1, cursor_);
  }

  std::uint32_t explicit_index() { return last_ += undo_zigzag(cursor_.varint()); }

  MeshoptCursor cursor_;
  MeshoptLayout layout_;
  Stream table_;
  Stream codes_;
  std::uint32_t next_ = 0;  ///< The first index that no triangle has used so far.
  std::uint32_t last_ = 0;  ///< The last index that was encoded explicitly.
  MeshoptFifo<Edge> edges_;
  MeshoptFifo<std::uint32_t> vertices_;
};

// --- Mode 2: indices ---------------------------------------------------------------------

Decoded decode_indices(Stream stream, const MeshoptLayout& layout) {
  constexpr std::int64_t kTail = 4;
  MeshoptCursor cursor(stream, kTail);
  if (const unsigned head = cursor.byte(); head != 0xD1) {
    cursor.fail("expected indices (209) in the first byte, got " + std::to_string(head));
  }
  Decoded decoded(layout.count * layout.stride);
  std::array<std::uint32_t, 2> last = {0, 0};
  for (std::int64_t i = 0; i < layout.count; ++i) {
    const std::uint32_t code = cursor.varint();
    std::uint32_t& index = last[code & 1U];
    index += undo_zigzag(code >> 1U);
    std::memcpy(decoded.data() + i * layout.stride, &index, layout.stride);
  }
  cursor.check_end();
  return decoded;
}

// --- Filters -----------------------------------------------------------------------------

[[noreturn]] void refuse_element(std::int64_t element, const std::string& reason) {
  throw FormatError("element " + std::to_string(element) + ": " + reason, {});
}

/// Scales a value of [-1, 1] or [0, 1] to the whole range of T. Damaged streams have values outside
/// of these ranges.
template <typename T>
T as_normalized(float value) {
  constexpr float kLowest = std::is_signed_v<T> ? -1.0F : 0.0F;
  return static_cast<T>(std::round(std::clamp(value, kLowest, 1.0F) *
                                   static_cast<float>(std::numeric_limits<T>::max())));
}

/// Calls `change(element, components)` for all elements of four components of type T.
template <typename T, typename Change>
void change_fours(Decoded& data, const Change& change) {
  const auto num_elements = static_cast<std::int64_t>(data.size() / (4 * sizeof(T)));
  for (std::int64_t i = 0; i < num_elements; ++i) {
    std::array<T, 4> values;
    std::memcpy(values.data(), data.data() + i * static_cast<std::int64_t>(sizeof(values)),
                sizeof(values));
    change(i, values);
    std::memcpy(data.data() + i * static_cast<std::int64_t>(sizeof(values)), values.data(),
                sizeof(values));
  }
}

/// Decodes unit vectors that were folded onto an octahedron. The third component is 1.0 in their
/// units.
template <typename T>
void undo_octahedral(Decoded& data) {
  change_fours<T>(data, [](std::int64_t element, std::array<T, 4>& values) {
    const auto one = static_cast<float>(values[2]);
    if (!(one > 0.0F)) refuse_element(element, "its third component stands for no 1.0");
    float x = static_cast<float>(values[0]) / one;
    float y = static_cast<float>(values[1]) / one;
    const float z = 1.0F - std::abs(x) - std::abs(y);
    const float fold = std::min(z, 0.0F);
    x -= std::copysign(fold, x);
    y -= std::copysign(fold, y);
    const float length = std::sqrt(x * x + y * y + z * z);
    values = {as_normalized<T>(x / length), as_normalized<T>(y / length),
              as_normalized<T>(z / length), values[3]};
  });
}

/// Decodes unit quaternions without their largest component. The fourth number is 1.0 in their
/// units, with the position of the largest component in its lowest two bits.
void undo_quaternion(Decoded& data) {
  change_fours<std::int16_t>(data, [](std::int64_t element, std::array<std::int16_t, 4>& values) {
    if (values[3] < 0) refuse_element(element, "its fourth component stands for no 1.0");
    const int largest = values[3] & 3;
    const float scale = std::sqrt(0.5F) / static_cast<float>(values[3] | 3);
    const float x = static_cast<float>(values[0]) * scale;
    const float y = static_cast<float>(values[1]) * scale;
    const float z = static_cast<float>(values[2]) * scale;
    const float w = std::sqrt(std::max(0.0F, 1.0F - x * x - y * y - z * z));
    values[(largest + 1) % 4] = as_normalized<std::int16_t>(x);
    values[(largest + 2) % 4] = as_normalized<std::int16_t>(y);
    values[(largest + 3) % 4] = as_normalized<std::int16_t>(z);
    values[largest] = as_normalized<std::int16_t>(w);
  });
}

/// Decodes floats: an integer of 24 bits times a power of two with 8 bits, both signed.
void undo_exponential(Decoded& data) {
  for (std::size_t at = 0; at < data.size(); at += 4) {
    const auto packed = load_little<std::int32_t>(data.data() + at);
    const int mantissa = static_cast<std::int32_t>(static_cast<std::uint32_t>(packed) << 8U) >> 8;
    store_little(std::ldexp(static_cast<float>(mantissa), packed >> 24), data.data() + at);
  }
}

/// Decodes luma and chroma. The highest set bit of the fourth component determines the number of
/// bits.
template <typename T>
void undo_color(Decoded& data) {
  using Signed = std::make_signed_t<T>;
  change_fours<T>(data, [](std::int64_t element, std::array<T, 4>& values) {
    if (values[3] == 0) refuse_element(element, "its fourth component has no highest bit");
    const int bits = std::bit_width(values[3]);
    const int one = (1 << bits) - 1;
    const int luma = values[0];
    const int orange = static_cast<Signed>(values[1]), green = static_cast<Signed>(values[2]);
    const int alpha = values[3] & (one >> 1);
    const auto stored = [one](int value) {
      return as_normalized<T>(static_cast<float>(value) / static_cast<float>(one));
    };
    values = {stored(luma + orange - green), stored(luma + green), stored(luma - orange - green),
              stored(2 * alpha + (alpha & 1))};
  });
}

void undo_filter(Decoded& data, const MeshoptLayout& layout) {
  switch (layout.filter) {
    case MeshoptFilter::kNone:
      return;
    case MeshoptFilter::kOctahedral:
      return layout.stride == 4 ? undo_octahedral<std::int8_t>(data)
                                : undo_octahedral<std::int16_t>(data);
    case MeshoptFilter::kQuaternion:
      return undo_quaternion(data);
    case MeshoptFilter::kExponential:
      return undo_exponential(data);
    case MeshoptFilter::kColor:
      return layout.stride == 4 ? undo_color<std::uint8_t>(data) : undo_color<std::uint16_t>(data);
  }
}

/// Checks that the layout fits the filter. Filters need elements of four components with one or two
/// bytes, quaternions with two; the exponential filter needs components of four bytes.
void check_filter(const MeshoptLayout& layout) {
  const bool is_four = layout.stride == 4, is_eight = layout.stride == 8;
  const bool is_free =
      layout.filter == MeshoptFilter::kNone || layout.filter == MeshoptFilter::kExponential;
  const bool fits = layout.filter == MeshoptFilter::kQuaternion ? is_eight : is_four || is_eight;
  if (layout.mode != MeshoptMode::kAttributes && layout.filter != MeshoptFilter::kNone) {
    throw FormatError("indices have no filter", {});
  }
  if (!is_free && !fits) {
    throw FormatError(
        "the filter is not for elements of " + std::to_string(layout.stride) + " bytes", {});
  }
}

void check_layout(const MeshoptLayout& layout) {
  const auto refuse = [](const std::string& reason) { throw FormatError(reason, {}); };
  if (layout.mode == MeshoptMode::kAttributes) {
    if (layout.stride < 4 || layout.stride > 256 || layout.stride % 4 != 0) {
      refuse("expected a byteStride of 4 to 256 that is a multiple of 4, got " +
             std::to_string(layout.stride));
    }
  } else if (layout.stride != 2 && layout.stride != 4) {
    refuse("expected a byteStride of 2 or 4 for indices, got " + std::to_string(layout.stride));
  }
  if (layout.mode == MeshoptMode::kTriangles && layout.count % 3 != 0) {
    refuse("expected a count that is a multiple of 3, got " + std::to_string(layout.count));
  }
  check_filter(layout);
}

}  // namespace

std::vector<std::byte> decode_meshopt(std::span<const std::byte> stream,
                                      const MeshoptLayout& layout) {
  check_layout(layout);
  switch (layout.mode) {
    case MeshoptMode::kTriangles:
      return TriangleDecoder(stream, layout).decode();
    case MeshoptMode::kIndices:
      return decode_indices(stream, layout);
    case MeshoptMode::kAttributes:
      break;
  }
  Decoded decoded = AttributeDecoder(stream, layout).decode();
  undo_filter(decoded, layout);
  return decoded;
}

}  // namespace manip3d
