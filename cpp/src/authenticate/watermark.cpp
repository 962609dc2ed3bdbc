#include "manip3d/authenticate/watermark.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <tuple>
#include <utility>

#include "authenticate/canonical_order.hpp"
#include "authenticate/lattice_samples.hpp"
#include "authenticate/little_endian.hpp"
#include "authenticate/watermark_record.hpp"
#include "authenticate/watermark_suite.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

// Fewest carrier bits of a tile, where identical points, which cannot be told apart, count once.
// Bits at random fit 80 identical points with a probability of 0.089.
constexpr std::uint32_t kLeastEffective = 128;
constexpr std::uint8_t kBeside = 0, kInPicture = 1;  // values of WatermarkHeader::carrier
constexpr std::size_t kMaxSessions = 4096;           // that a verifier remembers
constexpr std::size_t kTagSize = std::tuple_size_v<WatermarkTag>;

// Checks what both ends refuse; SliceTable checks the number of slices.
void check_options(const WatermarkOptions& options) {
  if (options.least_points < 1) {
    throw InputError("least_points: expected 1 or more, got " +
                     std::to_string(options.least_points));
  }
  if (options.units_per_m < 1 || options.units_per_m > kMostUnitsPerMetre) {
    throw InputError("units_per_m: expected 1 to 1000000, got " +
                     std::to_string(options.units_per_m));
  }
  if (options.embedding == WatermarkEmbedding::kQim && options.units_per_m != 1000) {
    throw InputError("units_per_m: expected 1000 with QIM, whose cells are 2.5 mm, got " +
                     std::to_string(options.units_per_m));
  }
}

WatermarkOrder order_of(WatermarkEmbedding embedding) {
  return embedding == WatermarkEmbedding::kDetached ? WatermarkOrder::kPlain
                                                    : WatermarkOrder::kHeightFirst;
}

void check_exact(const PointsView& points, ExactView exact) {
  if (!exact.empty() && exact.size() != 3 * static_cast<std::size_t>(points.num_points())) {
    throw InputError("exact: expected as many rows as points");
  }
  if (!std::all_of(exact.begin(), exact.end(), [](double x) { return std::isfinite(x); })) {
    throw InputError("exact: expected finite coordinates");
  }
}

std::span<const std::uint8_t> bytes_of_samples(std::span<const WatermarkSample> samples) {
  return {reinterpret_cast<const std::uint8_t*>(samples.data()), samples.size_bytes()};
}

// tag_i = BLAKE2b(K_tile, "m3d-tile" | header | i | count | samples)
WatermarkTag tag_of_tile(const SessionKeys& keys, std::span<const std::uint8_t> header,
                         std::uint32_t tile, std::span<const WatermarkSample> samples) {
  std::array<std::uint8_t, 8> numbers;
  store(tile, numbers.data());
  store(static_cast<std::uint32_t>(samples.size()), numbers.data() + 4);
  TagHash hash(keys.tile());
  hash.update("m3d-tile");
  hash.update(header);
  hash.update(numbers);
  hash.update(bytes_of_samples(samples));
  return hash.finish();
}

std::vector<WatermarkTag> tags_of_tiles(const SessionKeys& keys,
                                        std::span<const std::uint8_t> header,
                                        const TiledSamples& tiled) {
  std::vector<WatermarkTag> tags;
  for (std::size_t t = 0; t + 1 < tiled.begins.size(); ++t) {
    const std::uint32_t begin = tiled.begins[t];
    tags.push_back(
        tag_of_tile(keys, header, static_cast<std::uint32_t>(t),
                    std::span(tiled.samples).subspan(begin, tiled.begins[t + 1] - begin)));
  }
  return tags;
}

// BLAKE2b(K_frame, domain | record | full tags)
WatermarkTag tag_of_record(const SessionKeys& keys, std::string_view domain,
                           std::span<const std::uint8_t> record,
                           const std::vector<WatermarkTag>& tags) {
  TagHash hash(keys.frame());
  hash.update(domain);
  hash.update(record);
  for (const WatermarkTag& tag : tags) hash.update(tag);
  return hash.finish();
}

// The parts of a record's bytes: what its tags are computed over, then its own tag, then the tag of
// the frame.
std::span<const std::uint8_t> body_of(std::span<const std::uint8_t> record) {
  return record.first(record.size() - kRecordEnd);
}

std::span<const std::uint8_t> own_tag_of(std::span<const std::uint8_t> record) {
  return record.last(kRecordEnd).first(kTagSize);
}

WatermarkTag frame_tag_of(std::span<const std::uint8_t> record) {
  WatermarkTag tag;
  std::copy_n(record.last(kTagSize).begin(), kTagSize, tag.begin());
  return tag;
}

// Did the keys of this session make the record?
bool own_tag_holds(const SessionKeys& keys, std::span<const std::uint8_t> record) {
  const WatermarkTag own =
      tag_of_record(keys, "m3d-record", body_of(record), {frame_tag_of(record)});
  return equal_in_constant_time(own, own_tag_of(record));
}

// Calls `use(place, bit)` for each point of a tile, where `place` counts the points in the order of
// both ends. Identical points cannot be told apart: their bits come in ascending order. Points at
// the origin carry nothing: their bit is 0.
template <typename Use>
void for_each_bit(const SessionKeys& keys, const WatermarkTag& tag, const TiledSamples& tiled,
                  std::size_t tile, std::vector<std::uint8_t>& stream, const Use& use) {
  const std::size_t begin = tiled.begins[tile], end = tiled.begins[tile + 1];
  carrier_bits(keys, tag, end - begin, stream);
  const auto bit = [&](std::size_t place) {
    const std::size_t i = place - begin;
    return static_cast<std::uint8_t>((stream[i / 8] >> (i % 8)) & 1U);
  };
  for (std::size_t place = begin; place < end;) {
    std::size_t run = place + 1;
    while (run < end && tiled.samples[run] == tiled.samples[place]) ++run;
    if (is_no_return(tiled.samples[place])) {
      for (; place < run; ++place) use(place, std::uint8_t{0});
    } else if (run == place + 1) {
      use(place, bit(place));
    } else {
      std::size_t ones = 0;
      for (std::size_t i = place; i < run; ++i) ones += bit(i);
      for (; place < run; ++place) use(place, static_cast<std::uint8_t>(run - place <= ones));
    }
    place = run;
  }
}

// Points of the tile that carry bits, identical ones counted once.
std::uint32_t effective_bits(const TiledSamples& tiled, std::size_t tile) {
  std::uint32_t bits = 0;
  for (std::size_t i = tiled.begins[tile]; i < tiled.begins[tile + 1]; ++i) {
    const bool repeats = i > tiled.begins[tile] && tiled.samples[i] == tiled.samples[i - 1];
    bits += !repeats && !is_no_return(tiled.samples[i]);
  }
  return bits;
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

// --- Embedding -----------------------------------------------------------------------------------

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

  // Reads the points, or their coordinates in float64, into `found` and `slice_of`.
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

  // Fills the header's fields of this frame.
  void describe(const PointsView& points, const WatermarkFrame& frame, bool is_exact) {
    header.is_exact = is_exact;
    header.offset = frame.offset;
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

  // Merges slices until each tile has at least kLeastEffective bits, or there is one tile. Sorts
  // the points into them, as `tiled`.
  void make_tiles() {
    const std::vector<std::uint32_t> counts = count_slices(slice_of, slices.size());
    const bool carries = header.embedding != WatermarkEmbedding::kDetached;
    // In steps of four: a few merges are enough, and tiles get little larger than they must.
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
        enough = enough && effective_bits(tiled, t) >= kLeastEffective;
      }
      if (enough || header.num_tiles == 1) return;
    }
  }

  // Marks each point with the bit that it is to carry.
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

  // Goes on to the next frame: the last step of embedding, so that a frame that was refused, or for
  // which there was no memory, leaves no gap in the chain.
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

namespace {

void check_frame(const WatermarkFrame& frame, bool is_exact) {
  if (frame.picture && frame.context) {
    throw InputError("picture: expected no other context beside it");
  }
  for (const std::int64_t offset : frame.offset) {
    if (offset != 0 && !is_exact) {
      throw InputError("offset: expected 0 for coordinates in float32");
    }
    if (!(offset >= -kFarthestUnit && offset <= kFarthestUnit)) {
      throw InputError("offset: expected at most 2^37 units from zero");
    }
  }
}

}  // namespace

WatermarkedScan WatermarkEmbedder::embed(const PointsView& points, const WatermarkFrame& frame,
                                         ExactView exact) {
  State& s = *state_;
  if (s.is_closed) throw Error("the watermarker is closed");
  if (s.has_ended) throw Error("the session has ended with its last frame");
  check_points(points);
  check_exact(points, exact);
  check_frame(frame, !exact.empty());
  const WatermarkHeader& header = s.header;
  s.describe(points, frame, !exact.empty());
  const ExactGrid grid{exact, header.units_per_m, frame.offset};
  s.sample(points, grid);
  s.make_tiles();
  if (frame.picture && record_size(header.tile_of.size(), header.num_tiles) > kMostCarried) {
    throw InputError("picture: expected a record of at most 2048 bytes, got " +
                     std::to_string(header.num_tiles) + " tiles of " +
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

// --- Verification --------------------------------------------------------------------------------

struct WatermarkVerifier::State {
  // A key that the keys of its sessions are derived from.
  struct Root {
    WatermarkId id;
    SecretBytes secret;
    std::optional<std::int64_t> until_ns;  // from then on it has signed nothing
  };
  std::vector<Root> roots;       // the newest first; empty: closed
  SessionKeys keys;              // of the session of the last record
  std::size_t root_of_keys = 0;  // index of the root that they were derived from
  SliceTable slices{36};
  LatticeSamples found;
  std::vector<std::uint16_t> slice_of;
  CanonicalOrder order;
  TiledSamples tiled;
  std::vector<std::uint8_t> stream;

  // The chain.
  bool has_frame = false;
  bool had_end = false;
  std::size_t root = 0;  // index of the last frame's key
  WatermarkId session{};
  std::uint64_t frame = 0;
  WatermarkTag tag{};
  std::vector<WatermarkId> past;  // sessions before this one, the oldest first

  void add(const WatermarkKey& key, std::optional<std::int64_t> until_ns);
  void check_open() const;
  // Derives the keys of the session whose record these bytes are; false: no key made it.
  bool find_key(std::span<const std::uint8_t> bytes);
  // Reads a record that a key made and the policy accepts. Returns why there is none; empty: there
  // is one, and `keys` are those of its session.
  std::string open_record(std::span<const std::uint8_t> bytes, const WatermarkPolicy& policy,
                          WatermarkRecord& record);
  // Says where in the stream the record's frame is.
  void find_place(const WatermarkRecord& record, WatermarkFinding& finding) const;
  // Takes the record's frame as the last one.
  void go_on(const WatermarkHeader& header, const WatermarkTag& frame_tag);
  // Sorts the points into the tiles that the header names, as `tiled`.
  void arrange(const PointsView& points, ExactView exact, const WatermarkHeader& header);
  // Finds the tiles that hold other points than those that were signed; whether all points lie on
  // the lattice of the embedding.
  bool check_tiles(const WatermarkRecord& record, std::span<const WatermarkTag> tags,
                   WatermarkFinding& finding) const;
  // Finds the points of unchanged tiles whose embedded bit is wrong; whether there are none.
  bool check_bits(WatermarkEmbedding embedding, std::span<const WatermarkTag> tags,
                  WatermarkFinding& finding);
  void check_content(const PointsView& points, ExactView exact, std::span<const std::uint8_t> bytes,
                     const WatermarkRecord& record, std::uint32_t num_dropped,
                     WatermarkFinding& finding);
  [[nodiscard]] WatermarkTag state_tag(std::size_t number,
                                       std::span<const std::uint8_t> bytes) const;
};

namespace {

template <typename T>
bool contains(const std::vector<T>& values, const T& value) {
  return std::find(values.begin(), values.end(), value) != values.end();
}

// Why the policy does not accept the record; empty: it does.
std::string objection(const WatermarkPolicy& policy, const WatermarkHeader& header) {
  if (!contains(policy.embeddings, header.embedding)) return "the policy refuses this embedding";
  if (!contains(policy.carriers, header.carrier)) return "the policy refuses this carrier";
  if (!policy.sensors.empty() && !contains(policy.sensors, header.sensor)) {
    return "the record is of another sensor than the policy names";
  }
  if (!policy.sessions.empty() && !contains(policy.sessions, header.session)) {
    return "the record is of another session than the policy names";
  }
  const bool carries = header.embedding != WatermarkEmbedding::kDetached;
  if (carries && !policy.units_per_m.empty() && !contains(policy.units_per_m, header.units_per_m)) {
    return "the policy refuses this lattice";
  }
  if (policy.context && !header.has_context) return "the record binds no context";
  if (policy.context && !equal_in_constant_time(*policy.context, header.context)) {
    return "the record belongs to another context";
  }
  return {};
}

WatermarkFreshness freshness_of(const WatermarkPolicy& policy, const WatermarkHeader& header,
                                std::int64_t now_ns) {
  if (policy.max_age_ns <= 0) return WatermarkFreshness::kUnknown;
  const double age = static_cast<double>(now_ns) - static_cast<double>(header.time_ns);
  const auto most = static_cast<double>(policy.max_age_ns);
  return std::abs(age) <= most ? WatermarkFreshness::kFresh : WatermarkFreshness::kStale;
}

// The changes in a frame whose content is tampered with.
std::string reason_of_tampering(const WatermarkFinding& finding) {
  const auto count = [&](WatermarkTile tile) {
    return std::count(finding.tiles.begin(), finding.tiles.end(), tile);
  };
  const auto changed = count(WatermarkTile::kChanged), bits = count(WatermarkTile::kBits);
  const std::string total = " of " + std::to_string(finding.tiles.size()) + " tiles";
  if (changed > 0) {
    return "points of " + std::to_string(changed) + total + " are not those that were signed";
  }
  if (bits > 0) return "carrier bits of " + std::to_string(bits) + total + " were changed";
  if (finding.picture_changed) return "the picture is not the one that was signed";
  return "the scan has other columns or points than were signed";
}

std::string reason_of_gap(std::int64_t missing) {
  if (missing <= 0) return "the content holds, but its session began elsewhere";
  if (missing == 1) return "the content holds, but the frame before it is missing";
  return "the content holds, but " + std::to_string(missing) + " frames before it are missing";
}

// Sets verdict and reason; what is found first here explains what comes after it.
void conclude(const WatermarkPolicy& policy, WatermarkFinding& finding) {
  const auto say = [&](WatermarkVerdict verdict, std::string reason) {
    finding.verdict = verdict;
    finding.reason = std::move(reason);
  };
  using enum WatermarkVerdict;
  if (finding.content == WatermarkContent::kTampered) {
    say(kTampered, reason_of_tampering(finding));
  } else if (finding.is_of_older_key) {
    say(kTampered, "the frame was signed with a key that the stream had replaced");
  } else if (finding.order == WatermarkPlace::kReplay) {
    say(kTampered, "the frame was seen before, or comes after a later one");
  } else if (finding.order == WatermarkPlace::kGap) {
    say(kUnverifiable, reason_of_gap(finding.gap));
  } else if (finding.freshness == WatermarkFreshness::kStale) {
    say(kUnverifiable, "the content holds, but the frame is too old");
  } else if (finding.order == WatermarkPlace::kUnknown && !policy.any_order) {
    say(kUnverifiable, "the content holds, but the frame's place in the stream is not known");
  } else {
    say(kAuthentic, "every point is the one that was signed");
  }
}

}  // namespace

void WatermarkVerifier::State::add(const WatermarkKey& key, std::optional<std::int64_t> until_ns) {
  if (key.expires_ns() != 0) {
    until_ns = until_ns ? std::min(*until_ns, key.expires_ns()) : key.expires_ns();
  }
  Root added{key.id(), SecretBytes(key.secret().size()), until_ns};
  std::copy_n(key.secret().data(), key.secret().size(), added.secret.data());
  roots.push_back(std::move(added));
}

void WatermarkVerifier::State::check_open() const {
  if (roots.empty()) throw Error("the verifier is closed");
}

bool WatermarkVerifier::State::find_key(std::span<const std::uint8_t> bytes) {
  // Only the two ids that choose the keys are read before the tag over the raw bytes holds.
  WatermarkId of_sensor, of_session;
  std::copy_n(bytes.data() + kSensorOffset, of_sensor.size(), of_sensor.begin());
  std::copy_n(bytes.data() + kSessionOffset, of_session.size(), of_session.begin());
  const auto made_it = [&](std::size_t number) {
    if (number != root_of_keys || !keys.is_for(of_sensor, of_session)) {
      keys = SessionKeys(roots[number].secret, of_sensor, of_session);
      root_of_keys = number;
    }
    return own_tag_holds(keys, bytes);
  };
  const std::size_t last = root_of_keys;  // first: its keys are derived already
  if (made_it(last)) return true;
  for (std::size_t number = 0; number < roots.size(); ++number) {
    if (number != last && made_it(number)) return true;
  }
  return false;
}

std::string WatermarkVerifier::State::open_record(std::span<const std::uint8_t> bytes,
                                                  const WatermarkPolicy& policy,
                                                  WatermarkRecord& record) {
  if (bytes.empty()) return "there is no record";
  if (bytes.size() > WatermarkRecord::kMaxSize ||
      bytes.size() < WatermarkRecord::kFixedSize + kRecordEnd) {
    return "the record has no possible length";
  }
  if (!find_key(bytes)) return "the record is damaged or was made with another key";
  try {
    record = WatermarkRecord::parse(bytes);
  } catch (const FormatError& error) {
    return "the record is of another version: " + error.reason();
  }
  if (std::string why = objection(policy, record.header); !why.empty()) return why;
  const std::optional<std::int64_t> until_ns = roots[root_of_keys].until_ns;
  if (until_ns && record.header.time_ns >= *until_ns) {
    return "the record states a time after its key had expired or had been replaced";
  }
  return {};
}

WatermarkVerifier::WatermarkVerifier(const WatermarkKey& key) : state_(std::make_unique<State>()) {
  state_->add(key, std::nullopt);
}

void WatermarkVerifier::add_older_key(const WatermarkKey& key, std::int64_t replaced_ns) {
  State& s = *state_;
  s.check_open();
  for (const State::Root& root : s.roots) {
    if (root.id == key.id()) throw InputError("key: expected one that was not given before");
  }
  s.add(key, replaced_ns);
}

WatermarkVerifier::WatermarkVerifier(WatermarkVerifier&&) noexcept = default;
WatermarkVerifier& WatermarkVerifier::operator=(WatermarkVerifier&&) noexcept = default;
WatermarkVerifier::~WatermarkVerifier() = default;

void WatermarkVerifier::close() {
  state_->keys.close();
  state_->roots.clear();
}

void WatermarkVerifier::reset() {
  State& s = *state_;
  s.has_frame = s.had_end = false;
  s.root = 0;
  s.past.clear();
}

namespace {

// Says what the record binds and the scan does not have; empty: it has all.
std::string missing_part(const WatermarkHeader& header, bool has_picture, bool is_exact) {
  if ((header.carrier == kInPicture) != has_picture) {
    return has_picture ? "the record is not one that a picture carries"
                       : "the record binds the picture that carries it, which is not here";
  }
  if (header.is_exact && !is_exact) {
    return "coordinates were signed in float64, of which the scan has the float32 part only";
  }
  return {};
}

}  // namespace

WatermarkFinding WatermarkVerifier::verify(const PointsView& points,
                                           std::span<const std::uint8_t> bytes,
                                           const WatermarkPolicy& policy, std::uint32_t num_dropped,
                                           std::int64_t now_ns, ExactView exact,
                                           const std::optional<PictureView>& picture) {
  State& s = *state_;
  s.check_open();
  WatermarkFinding finding;
  const auto unverifiable = [&](std::string why) {
    finding.reason = std::move(why);
    return finding;
  };
  check_points(points);
  check_exact(points, exact);
  if (picture) check_picture(*picture);
  if (points.num_points() > policy.max_points) {
    return unverifiable("more points than the policy allows: " +
                        std::to_string(points.num_points()));
  }
  WatermarkRecord record;
  if (std::string why = s.open_record(bytes, policy, record); !why.empty()) {
    return unverifiable(why);
  }
  finding.header = record.header;
  finding.key = s.roots[s.root_of_keys].id;
  const bool is_exact = !exact.empty() || points.num_points() == 0;
  if (std::string why = missing_part(record.header, picture.has_value(), is_exact); !why.empty()) {
    return unverifiable(why);
  }
  s.check_content(points, exact, bytes, record, num_dropped, finding);
  if (picture) {
    const WatermarkTag seen = tag_of_picture(s.keys.image(), *picture);
    finding.picture_changed = !equal_in_constant_time(seen, record.header.context);
    if (finding.picture_changed) finding.content = WatermarkContent::kTampered;
  }
  s.find_place(record, finding);
  finding.freshness = freshness_of(policy, record.header, now_ns);
  conclude(policy, finding);
  // The record is genuine, whatever became of the points: its frame is never new again.
  if (finding.order != WatermarkPlace::kReplay) s.go_on(record.header, frame_tag_of(bytes));
  return finding;
}

void WatermarkVerifier::State::arrange(const PointsView& points, ExactView exact,
                                       const WatermarkHeader& header) {
  if (static_cast<int>(header.tile_of.size()) != slices.size()) {
    slices = SliceTable(static_cast<int>(header.tile_of.size()));
  }
  if (header.is_exact) {
    sample_exact(points, {exact, header.units_per_m, header.offset}, ExactUse::kVerify, slices,
                 found, slice_of);
  } else {
    sample_for_verification(points, header.embedding, header.units_per_m, slices, found, slice_of);
  }
  order.sort(found.samples, found.marks, slice_of, header.tile_of, header.num_tiles,
             order_of(header.embedding), tiled);
}

bool WatermarkVerifier::State::check_tiles(const WatermarkRecord& record,
                                           std::span<const WatermarkTag> tags,
                                           WatermarkFinding& finding) const {
  finding.tiles.assign(tags.size(), WatermarkTile::kIntact);
  bool all_on_lattice = true;
  for (std::size_t t = 0; t < tags.size(); ++t) {
    bool off_lattice = false;
    for (std::size_t i = tiled.begins[t]; i < tiled.begins[t + 1]; ++i) {
      off_lattice = off_lattice || (tiled.marks[i] & kOffLattice) != 0;
    }
    const bool same_count = tiled.begins[t + 1] - tiled.begins[t] == record.counts[t];
    const bool same_tag = equal_in_constant_time(std::span(tags[t]).first(16), record.tags[t]);
    if (!same_count || !same_tag || off_lattice) finding.tiles[t] = WatermarkTile::kChanged;
    all_on_lattice = all_on_lattice && !off_lattice;
  }
  return all_on_lattice;
}

bool WatermarkVerifier::State::check_bits(WatermarkEmbedding embedding,
                                          std::span<const WatermarkTag> tags,
                                          WatermarkFinding& finding) {
  if (embedding == WatermarkEmbedding::kDetached) return true;
  bool bits_hold = true;
  for (std::size_t t = 0; t < tags.size(); ++t) {
    if (finding.tiles[t] == WatermarkTile::kChanged) continue;
    const auto compare = [&](std::size_t place, std::uint8_t bit) {
      if (tiled.marks[place] == mark_of(tiled.samples[place], bit, embedding)) return;
      finding.tiles[t] = WatermarkTile::kBits;
      finding.rows.push_back(static_cast<std::int32_t>(tiled.rows[place]));
    };
    sort_marks_of_equals(tiled, t);
    for_each_bit(keys, tags[t], tiled, t, stream, compare);
    bits_hold = bits_hold && finding.tiles[t] == WatermarkTile::kIntact;
  }
  std::sort(finding.rows.begin(), finding.rows.end());
  return bits_hold;
}

void WatermarkVerifier::State::check_content(const PointsView& points, ExactView exact,
                                             std::span<const std::uint8_t> bytes,
                                             const WatermarkRecord& record,
                                             std::uint32_t num_dropped, WatermarkFinding& finding) {
  const WatermarkHeader& header = record.header;
  arrange(points, exact, header);
  finding.tile_of_row.resize(slice_of.size());
  for (std::size_t i = 0; i < slice_of.size(); ++i) {
    finding.tile_of_row[i] = header.tile_of[slice_of[i]];
  }
  const std::vector<std::uint8_t> head = header_bytes(header);
  const std::vector<WatermarkTag> tags = tags_of_tiles(keys, head, tiled);
  const bool all_on_lattice = check_tiles(record, tags, finding);
  const bool bits_hold = check_bits(header.embedding, tags, finding);
  const WatermarkTag whole = tag_of_record(keys, "m3d-frame", body_of(bytes), tags);
  const bool frame_holds = equal_in_constant_time(whole, frame_tag_of(bytes));
  // Formats such as KITTI's write intensities of 0 where there are none. Others change the tags.
  const bool same_columns = points.has_intensity() || !header.has_intensity;
  const bool same_drops = header.num_dropped == num_dropped;
  const bool is_intact = frame_holds && bits_hold && all_on_lattice && same_columns && same_drops;
  finding.content = is_intact ? WatermarkContent::kIntact : WatermarkContent::kTampered;
}

void WatermarkVerifier::State::find_place(const WatermarkRecord& record,
                                          WatermarkFinding& finding) const {
  const WatermarkHeader& header = record.header;
  finding.order = WatermarkPlace::kUnknown;
  // Keys only go forward: whoever holds an old one could begin sessions, and even name this one.
  finding.is_of_older_key = has_frame && root_of_keys > root;
  if (finding.is_of_older_key || contains(past, header.session)) {
    finding.order = WatermarkPlace::kReplay;
  } else if (!has_frame || header.session != session || root_of_keys != root) {
    // A session may begin where nothing is known before it, or where the last one has ended.
    if (header.is_genesis && (!has_frame || had_end)) {
      finding.order = WatermarkPlace::kInOrder;
    } else if (has_frame) {
      finding.order = WatermarkPlace::kGap;
    }
  } else if (header.frame <= frame) {
    finding.order = WatermarkPlace::kReplay;
  } else if (header.frame > frame + 1) {
    finding.order = WatermarkPlace::kGap;
    const std::uint64_t missing = header.frame - frame - 1;
    finding.gap = static_cast<std::int64_t>(
        std::min<std::uint64_t>(missing, std::numeric_limits<std::int64_t>::max()));
  } else if (equal_in_constant_time(record.previous, tag)) {
    finding.order = WatermarkPlace::kInOrder;
  }
}

void WatermarkVerifier::State::go_on(const WatermarkHeader& header, const WatermarkTag& frame_tag) {
  if (has_frame && header.session != session) {
    if (past.size() == kMaxSessions) past.erase(past.begin());
    past.push_back(session);
  }
  has_frame = true;
  had_end = header.is_end;
  root = root_of_keys;
  session = header.session;
  frame = header.frame;
  tag = frame_tag;
}

WatermarkTag WatermarkVerifier::State::state_tag(std::size_t number,
                                                 std::span<const std::uint8_t> bytes) const {
  TagHash hash(roots[number].secret.span());
  hash.update("m3d-verifier-state");
  hash.update(bytes);
  return hash.finish();
}

std::vector<std::uint8_t> WatermarkVerifier::state() const {
  const State& s = *state_;
  s.check_open();
  std::vector<std::uint8_t> bytes;
  bytes.reserve(98 + 16 * s.past.size());
  const auto put = [&](std::span<const std::uint8_t> more) {
    for (const std::uint8_t byte : more) bytes.push_back(byte);  // GCC 12 warns of an insert
  };
  std::array<std::uint8_t, 8> number;
  store(s.frame, number.data());
  put(bytes_of("m3d-vs01"));
  put(std::array<std::uint8_t, 2>{s.has_frame, s.had_end});
  put(s.session);
  put(number);
  put(s.tag);
  for (const WatermarkId& session : s.past) put(session);
  put(s.state_tag(s.root, bytes));
  return bytes;
}

void WatermarkVerifier::restore(std::span<const std::uint8_t> state) {
  State& s = *state_;
  s.check_open();
  constexpr std::size_t kFixed = 8 + 2 + 16 + 8 + 32, kTag = 32;
  const bool possible = state.size() >= kFixed + kTag && (state.size() - kFixed - kTag) % 16 == 0 &&
                        state.size() <= kFixed + kTag + 16 * kMaxSessions;
  // The key of the last frame has authenticated the state; which one that is, is found by trying.
  std::size_t number = 0;
  const auto made_it = [&](std::size_t key) {
    return equal_in_constant_time(s.state_tag(key, state.first(state.size() - kTag)),
                                  state.last(kTag));
  };
  while (possible && number < s.roots.size() && !made_it(number)) ++number;
  if (!possible || number == s.roots.size()) {
    throw FormatError::at_byte(0, "the state of a verifier is damaged or of another key");
  }
  s.root = number;
  s.has_frame = state[8] != 0;
  s.had_end = state[9] != 0;
  std::copy_n(state.data() + 10, 16, s.session.begin());
  s.frame = load<std::uint64_t>(state.data() + 26);
  std::copy_n(state.data() + 34, 32, s.tag.begin());
  s.past.resize((state.size() - kFixed - kTag) / 16);
  for (std::size_t i = 0; i < s.past.size(); ++i) {
    std::copy_n(state.data() + kFixed + 16 * i, 16, s.past[i].begin());
  }
}

}  // namespace manip3d
