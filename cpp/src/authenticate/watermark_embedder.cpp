#include <algorithm>
#include <array>
#include <limits>
#include <optional>
#include <utility>

#include "authenticate/canonical_order.hpp"
#include "authenticate/lattice_samples.hpp"
#include "authenticate/little_endian.hpp"
#include "authenticate/watermark_record.hpp"
#include "authenticate/watermark_suite.hpp"
#include "authenticate/watermark_tiles.hpp"
#include "manip3d/authenticate/watermark.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

// Fewest carrier bits of a tile, with identical points counted once because they cannot be
// distinguished. Random bits are correct for 80 identical points with a probability of 0.089.
constexpr std::uint32_t kMinEffective = 128;

// The number of slices is checked by SliceTable.
void check_options(const WatermarkOptions& options) {
  if (options.least_points < 1) {
    throw InputError("least_points: expected 1 or more, got " +
                     std::to_string(options.least_points));
  }
  if (options.units_per_m < 1 || options.units_per_m > kMaxUnitsPerMetre) {
    throw InputError("units_per_m: expected 1 to 1000000, got " +
                     std::to_string(options.units_per_m));
  }
  if (options.embedding == WatermarkEmbedding::kQim && options.units_per_m != 1000) {
    throw InputError("units_per_m: expected 1000 with QIM, whose cells are 2.5 mm, got " +
                     std::to_string(options.units_per_m));
  }
}

// Number of points of the tile that carry bits, identical ones counted once.
std::uint32_t effective_bits(const TiledSamples& tiled, std::size_t tile) {
  std::uint32_t bits = 0;
  for (std::size_t i = tiled.begins[tile]; i < tiled.begins[tile + 1]; ++i) {
    const bool repeats = i > tiled.begins[tile] && tiled.samples[i] == tiled.samples[i - 1];
    bits += !repeats && !is_no_return(tiled.samples[i]);
  }
  return bits;
}

// The offset of a scan without points is not used.
void check_frame(const WatermarkFrame& frame, const PointsView& points, bool is_exact) {
  if (frame.picture && frame.context) {
    throw InputError("picture: expected no other context beside it");
  }
  for (const std::int64_t offset : frame.offset) {
    if (offset != 0 && !is_exact && points.num_points() > 0) {
      throw InputError("offset: expected 0 for coordinates in float32");
    }
    if (!(offset >= -kFarthestUnit && offset <= kFarthestUnit)) {
      throw InputError("offset: expected at most 2^37 units from zero");
    }
  }
}

}  // namespace

std::vector<std::int32_t> watermark_order(const PointsView& points,
                                          const WatermarkOptions& options) {
  check_points(points);
  check_options(options);
  if (points.num_points() == 0) throw InputError("points: expected at least one, got none");
  const SliceTable slices(options.slices);
  LatticeSamples found;
  std::vector<std::uint16_t> slice_of;
  sample_for_embedding(points, options, slices, found, slice_of);
  const std::vector<std::uint32_t> counts = count_slices(slice_of, slices.size());
  const std::vector<std::uint16_t> tile_of =
      merge_slices(counts, static_cast<std::uint32_t>(options.least_points), options.merge);
  TiledSamples tiled;
  CanonicalOrder().sort(found.samples, {}, slice_of, tile_of,
                        1 + *std::max_element(tile_of.begin(), tile_of.end()),
                        order_of(options.embedding), tiled);
  return {tiled.rows.begin(), tiled.rows.end()};
}

struct WatermarkEmbedder::State {
  WatermarkOptions options;
  WatermarkHeader header;
  SessionKeys keys;
  SliceTable slices;
  bool is_closed = false, has_ended = false;
  WatermarkTag previous{};
  LatticeSamples found;
  std::vector<std::uint16_t> slice_of;
  CanonicalOrder order;
  TiledSamples tiled;
  std::vector<std::uint8_t> stream;

  State(const WatermarkKey& key, const WatermarkId& sensor, const WatermarkId& session,
        const WatermarkOptions& chosen)
      : options(chosen), keys(key.secret(), sensor, session), slices(chosen.slices) {
    check_options(chosen);
    header.embedding = chosen.embedding;
    header.sensor = sensor;
    header.session = session;
    header.units_per_m = chosen.embedding == WatermarkEmbedding::kDetached ? 0 : chosen.units_per_m;
  }

  // Samples the points, or their float64 coordinates, into `found` and `slice_of`.
  void sample(const PointsView& points, const ExactGrid& grid) {
    if (!header.is_exact) {
      sample_for_embedding(points, options, slices, found, slice_of);
      return;
    }
    if (header.embedding != WatermarkEmbedding::kLbm) {
      throw InputError("exact: expected coordinates in float64 with LBM only");
    }
    sample_exact(points, grid, options.round ? ExactUse::kRound : ExactUse::kEmbed, slices, found,
                 slice_of);
  }

  // Sets the fields of the header for this frame.
  void describe(const PointsView& points, const WatermarkFrame& frame, bool is_exact) {
    header.is_exact = is_exact;
    header.offset = is_exact ? frame.offset : std::array<std::int64_t, 3>{};
    header.is_genesis = header.frame == 0;
    header.is_end = frame.is_end;
    header.carrier = frame.picture ? kInPicture : kBeside;
    header.has_context = frame.context.has_value() || frame.picture.has_value();
    header.context = frame.picture ? tag_of_picture(keys.image(), *frame.picture)
                                   : frame.context.value_or(std::array<std::uint8_t, 32>{});
    header.time_ns = frame.time_ns;
    header.num_dropped = frame.num_dropped;
    header.has_intensity = points.has_intensity();
  }

  // Merges slices until each tile has at least kMinEffective bits or there is only one tile.
  // Sorts the points into the tiles, as `tiled`.
  void make_tiles() {
    const std::vector<std::uint32_t> counts = count_slices(slice_of, slices.size());
    const bool carries = header.embedding != WatermarkEmbedding::kDetached;
    // `least` grows by a factor of four: few sorts are needed, and tiles become little larger than
    // necessary.
    for (std::uint64_t least = static_cast<std::uint64_t>(options.least_points);; least *= 4) {
      const auto bounded = static_cast<std::uint32_t>(
          std::min<std::uint64_t>(least, std::numeric_limits<std::uint32_t>::max()));
      header.tile_of = merge_slices(counts, bounded, options.merge);
      header.num_tiles = static_cast<std::uint16_t>(
          1 + *std::max_element(header.tile_of.begin(), header.tile_of.end()));
      order.sort(found.samples, {}, slice_of, header.tile_of, header.num_tiles,
                 order_of(header.embedding), tiled);
      bool enough = true;
      for (std::size_t t = 0; carries && t < header.num_tiles; ++t) {
        enough = enough && effective_bits(tiled, t) >= kMinEffective;
      }
      if (enough || header.num_tiles == 1) return;
    }
  }

  // Gives each point the bit that it will carry.
  void choose_bits(std::span<const WatermarkTag> tags) {
    for (std::size_t t = 0; t < tags.size(); ++t) {
      for_each_bit(keys, tags[t], tiled, t, stream, [&](std::size_t place, std::uint8_t bit) {
        found.marks[tiled.rows[place]] = bit;
      });
    }
  }

  [[nodiscard]] std::vector<std::uint8_t> make_record(std::span<const std::uint8_t> head,
                                                      const std::vector<WatermarkTag>& tags) const {
    std::vector<std::uint8_t> record(head.begin(), head.end());
    for (std::size_t t = 0; t < tags.size(); ++t) {
      std::array<std::uint8_t, 4> count;
      store(tiled.begins[t + 1] - tiled.begins[t], count.data());
      record.insert(record.end(), count.begin(), count.end());
      record.insert(record.end(), tags[t].begin(), tags[t].begin() + 16);
    }
    record.insert(record.end(), previous.begin(), previous.end());
    const WatermarkTag whole = tag_of_record(keys, "m3d-frame", record, tags);
    const WatermarkTag own = tag_of_record(keys, "m3d-record", record, {whole});
    record.insert(record.end(), own.begin(), own.end());
    record.insert(record.end(), whole.begin(), whole.end());
    return record;
  }

  // Advances to the next frame. This is the last step of embedding, so that a frame that is
  // refused, or fails for lack of memory, leaves no gap in the chain.
  void go_on(std::span<const std::uint8_t> record) noexcept {
    previous = frame_tag_of(record);
    has_ended = header.is_end;
    ++header.frame;
  }
};

WatermarkEmbedder::WatermarkEmbedder(const WatermarkKey& key, const WatermarkId& sensor,
                                     const WatermarkOptions& options) {
  WatermarkId session;
  if (sodium_init() < 0) throw Error("libsodium cannot be started");
  randombytes_buf(session.data(), session.size());
  state_ = std::make_unique<State>(key, sensor, session, options);
}

WatermarkEmbedder::WatermarkEmbedder(const WatermarkKey& key, const WatermarkId& sensor,
                                     const WatermarkId& session, const WatermarkOptions& options)
    : state_(std::make_unique<State>(key, sensor, session, options)) {}

WatermarkEmbedder WatermarkEmbedder::after(std::span<const std::uint8_t> bytes,
                                           const WatermarkKey& key, const WatermarkId& sensor,
                                           const WatermarkOptions& options) {
  const WatermarkHeader last = WatermarkRecord::parse(bytes).header;
  WatermarkEmbedder embedder(key, sensor, last.session, options);
  State& s = *embedder.state_;
  if (!own_tag_holds(s.keys, bytes)) {
    throw FormatError("the record is damaged, or of another key or sensor", {});
  }
  if (last.embedding != s.header.embedding || last.units_per_m != s.header.units_per_m) {
    throw InputError("record: expected one of the same embedding and grid");
  }
  if (last.is_end) throw InputError("record: its session has ended with this frame");
  s.previous = frame_tag_of(bytes);
  s.header.frame = last.frame + 1;
  return embedder;
}

WatermarkEmbedder::WatermarkEmbedder(WatermarkEmbedder&&) noexcept = default;
WatermarkEmbedder& WatermarkEmbedder::operator=(WatermarkEmbedder&&) noexcept = default;
WatermarkEmbedder::~WatermarkEmbedder() = default;

const WatermarkId& WatermarkEmbedder::session() const { return state_->header.session; }

void WatermarkEmbedder::close() {
  state_->keys.close();
  state_->is_closed = true;
}

WatermarkedScan WatermarkEmbedder::embed(const PointsView& points, const WatermarkFrame& frame,
                                         ExactView exact) {
  State& s = *state_;
  if (s.is_closed) throw Error("the watermarker is closed");
  if (s.has_ended) throw Error("the session has ended with its last frame");
  check_points(points);
  check_exact(points, exact);
  check_frame(frame, points, !exact.empty());
  const WatermarkHeader& header = s.header;
  s.describe(points, frame, !exact.empty());
  const ExactGrid grid{exact, header.units_per_m, frame.offset};
  s.sample(points, grid);
  s.make_tiles();
  if (frame.picture && record_size(header.tile_of.size(), header.num_tiles) > kMaxCarried) {
    throw InputError("picture: expected a record of at most " + std::to_string(kMaxCarried) +
                     " bytes, got " + std::to_string(header.num_tiles) + " tiles of " +
                     std::to_string(header.tile_of.size()) + " slices");
  }
  const std::vector<std::uint8_t> head = header_bytes(header);
  const std::vector<WatermarkTag> tags = tags_of_tiles(s.keys, head, s.tiled);
  WatermarkedScan result;
  if (header.embedding != WatermarkEmbedding::kDetached) {
    s.choose_bits(tags);
    if (header.is_exact) {
      result.exact.resize(points.num_points(), 3);
      write_exact(s.found, grid, result.exact.data());
    } else {
      result.points.resize(points.num_points(), 3);
      write_samples(s.found, header.embedding, header.units_per_m, result.points.data());
    }
  }
  result.record = s.make_record(head, tags);
  if (frame.picture) result.picture = with_record(*frame.picture, result.record);
  result.frame = header.frame;
  result.num_tiles = header.num_tiles;
  s.go_on(result.record);
  return result;
}

}  // namespace manip3d
