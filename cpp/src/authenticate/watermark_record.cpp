#include "authenticate/watermark_record.hpp"

#include <algorithm>

#include "authenticate/little_endian.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr std::uint8_t kGenesis = 1, kEnd = 2, kContext = 8;
constexpr std::uint16_t kIntensity = 1, kExact = 2;
constexpr std::size_t kPerTile = 20;

class Writer {
 public:
  template <typename T>
  void put(T value) {
    const std::size_t at = bytes_.size();
    bytes_.resize(at + sizeof value);
    store(value, bytes_.data() + at);
  }
  template <typename Bytes>
  void put_all(const Bytes& values) {
    bytes_.insert(bytes_.end(), values.begin(), values.end());
  }
  std::vector<std::uint8_t> take() { return std::move(bytes_); }

 private:
  std::vector<std::uint8_t> bytes_;
};

class RecordReader {
 public:
  explicit RecordReader(std::span<const std::uint8_t> bytes) : bytes_(bytes) {}

  template <typename T>
  T get() {
    need(sizeof(T));
    const T value = load<T>(bytes_.data() + at_);
    at_ += sizeof(T);
    return value;
  }
  template <std::size_t kSize>
  void get_all(std::array<std::uint8_t, kSize>& values) {
    need(kSize);
    std::copy_n(bytes_.data() + at_, kSize, values.begin());
    at_ += kSize;
  }
  void need(std::size_t size) const {
    if (bytes_.size() - at_ < size) fail("the record ends too early");
  }
  [[nodiscard]] std::size_t left() const { return bytes_.size() - at_; }
  [[noreturn]] void fail(const std::string& why) const {
    throw FormatError::at_byte(static_cast<std::int64_t>(at_), why);
  }

 private:
  std::span<const std::uint8_t> bytes_;
  std::size_t at_ = 0;
};

// Grid by embedding: a detached record binds bits of floats (0 units), QIM needs cells of 2.5 mm
// (1000 units per metre), LBM states its own grid.
void check_grid(const WatermarkHeader& header, const RecordReader& reader) {
  const std::uint32_t units = header.units_per_m;
  const bool fits = header.embedding == WatermarkEmbedding::kDetached ? units == 0
                    : header.embedding == WatermarkEmbedding::kQim
                        ? units == 1000
                        : units >= 1 && units <= kMaxUnitsPerMetre;
  if (!fits) reader.fail("another lattice than the embedding has");
}

void check_fields(const WatermarkHeader& header, std::uint16_t fields, const RecordReader& reader) {
  if ((fields & ~(kIntensity | kExact)) != 0) reader.fail("fields that nobody knows");
  if (header.is_exact && header.embedding != WatermarkEmbedding::kLbm) {
    reader.fail("coordinates in float64 with another embedding than LBM");
  }
  for (const std::int64_t offset : header.offset) {
    if (offset != 0 && !header.is_exact) reader.fail("an offset of coordinates in float32");
    if (offset < -kFarthestUnit || offset > kFarthestUnit) reader.fail("an offset too far away");
  }
}

// Tiles are numbered in the order of their first slices, without gaps.
void check_merge_map(const WatermarkHeader& header, const RecordReader& reader) {
  std::uint16_t seen = 0;
  for (const std::uint16_t tile : header.tile_of) {
    if (tile > seen || tile >= header.num_tiles) reader.fail("the merge map skips a tile");
    if (tile == seen) ++seen;
  }
  if (seen != header.num_tiles) reader.fail("the merge map has fewer tiles than the record");
}

}  // namespace

std::size_t record_size(std::size_t slices, std::size_t tiles) {
  constexpr std::size_t kContextSize = 32, kPrevious = 32;
  return WatermarkRecord::kFixedSize + 2 * slices + kContextSize + kPerTile * tiles + kPrevious +
         kRecordEnd;
}

std::vector<std::uint8_t> header_bytes(const WatermarkHeader& header) {
  Writer out;
  out.put_all(kRecordMagic);
  out.put(header.suite);
  out.put(static_cast<std::uint8_t>(header.embedding));
  out.put(header.carrier);
  out.put(static_cast<std::uint8_t>((header.is_genesis ? kGenesis : 0) |
                                    (header.is_end ? kEnd : 0) |
                                    (header.has_context ? kContext : 0)));
  out.put_all(header.sensor);
  out.put_all(header.session);
  out.put(header.frame);
  out.put(header.time_ns);
  out.put(header.units_per_m);
  for (const std::int64_t offset : header.offset) out.put(offset);
  out.put(header.units_per_intensity);
  out.put(static_cast<std::uint16_t>((header.has_intensity ? kIntensity : 0) |
                                     (header.is_exact ? kExact : 0)));
  out.put(static_cast<std::uint16_t>(header.tile_of.size()));
  out.put(header.num_tiles);
  out.put(header.num_dropped);
  for (const std::uint16_t tile : header.tile_of) out.put(tile);
  out.put_all(header.context);
  return out.take();
}

WatermarkRecord WatermarkRecord::parse(std::span<const std::uint8_t> bytes) {
  if (bytes.size() > kMaxSize) {
    throw FormatError::at_byte(kMaxSize, "expected a record of at most 16384 bytes");
  }
  RecordReader in(bytes);
  in.need(kRecordMagic.size());
  if (!std::equal(kRecordMagic.begin(), kRecordMagic.end(), bytes.begin())) {
    in.fail("expected a record, which begins with m3d-wm01");
  }
  in.get<std::uint64_t>();
  WatermarkRecord record;
  WatermarkHeader& header = record.header;
  header.suite = in.get<std::uint8_t>();
  if (header.suite != 1) in.fail("expected suite 1, got " + std::to_string(header.suite));
  const auto embedding = in.get<std::uint8_t>();
  if (embedding > static_cast<std::uint8_t>(WatermarkEmbedding::kQim)) {
    in.fail("expected an embedding from 0 to 2, got " + std::to_string(embedding));
  }
  header.embedding = static_cast<WatermarkEmbedding>(embedding);
  header.carrier = in.get<std::uint8_t>();
  if (header.carrier > 1) in.fail("expected carrier 0 or 1");
  const auto flags = in.get<std::uint8_t>();
  if ((flags & ~(kGenesis | kEnd | kContext)) != 0) in.fail("flags that nobody knows");
  header.is_genesis = (flags & kGenesis) != 0;
  header.is_end = (flags & kEnd) != 0;
  header.has_context = (flags & kContext) != 0;
  in.get_all(header.sensor);
  in.get_all(header.session);
  header.frame = in.get<std::uint64_t>();
  header.time_ns = in.get<std::int64_t>();
  header.units_per_m = in.get<std::uint32_t>();
  check_grid(header, in);
  for (std::int64_t& offset : header.offset) offset = in.get<std::int64_t>();
  header.units_per_intensity = in.get<std::uint32_t>();
  if (header.units_per_intensity != 0) in.fail("another lattice of intensities than float32");
  const auto fields = in.get<std::uint16_t>();
  header.has_intensity = (fields & kIntensity) != 0;
  header.is_exact = (fields & kExact) != 0;
  check_fields(header, fields, in);
  const auto slices = in.get<std::uint16_t>();
  header.num_tiles = in.get<std::uint16_t>();
  if (slices < 4 || slices > 360) in.fail("expected 4 to 360 slices");
  header.num_dropped = in.get<std::uint32_t>();
  in.need(std::size_t{2} * slices);
  header.tile_of.resize(slices);
  for (std::uint16_t& tile : header.tile_of) tile = in.get<std::uint16_t>();
  check_merge_map(header, in);
  in.get_all(header.context);
  in.need(kPerTile * header.num_tiles);
  record.counts.resize(header.num_tiles);
  record.tags.resize(header.num_tiles);
  for (std::size_t t = 0; t < header.num_tiles; ++t) {
    record.counts[t] = in.get<std::uint32_t>();
    in.get_all(record.tags[t]);
  }
  in.get_all(record.previous);
  in.need(kRecordEnd);
  if (in.left() != kRecordEnd) in.fail("bytes behind the end of the record");
  return record;
}

}  // namespace manip3d
