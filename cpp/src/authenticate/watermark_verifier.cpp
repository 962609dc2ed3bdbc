#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <string_view>
#include <utility>

#include "authenticate/canonical_order.hpp"
#include "authenticate/lattice_samples.hpp"
#include "authenticate/little_endian.hpp"
#include "authenticate/watermark_record.hpp"
#include "authenticate/watermark_suite.hpp"
#include "authenticate/watermark_tiles.hpp"
#include "authenticate/watermark_verdict.hpp"
#include "manip3d/authenticate/watermark.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr std::size_t kMaxSessions = 4096;  // sessions that a verifier remembers
constexpr std::int64_t kNever = std::numeric_limits<std::int64_t>::min();
constexpr std::uint64_t kNoLater = std::numeric_limits<std::uint64_t>::max();

// Bytes of a verifier's state before the earlier sessions: magic, flags, session, frame and tag of
// the last frame, two times.
constexpr std::size_t kFixedState = 8 + 2 + 16 + 8 + 32 + 16;

// Number of frames between two frames of a session.
std::int64_t num_between(std::uint64_t before, std::uint64_t after) {
  constexpr std::uint64_t kMost = std::numeric_limits<std::int64_t>::max();
  return static_cast<std::int64_t>(std::min(after - before - 1, kMost));
}

// Has the scan a zero with a sign, in its coordinates or intensities?
bool has_negative_zero(const PointsView& points) {
  const auto is_one = [](float value) { return value == 0.0F && std::signbit(value); };
  const float* xyz = points.points.data();
  if (std::any_of(xyz, xyz + 3 * points.num_points(), is_one)) return true;
  if (!points.has_intensity()) return false;
  const float* shine = points.intensity.data();
  return std::any_of(shine, shine + points.num_points(), is_one);
}

std::ptrdiff_t num_changed(const WatermarkFinding& finding) {
  return std::ranges::count(finding.tiles, WatermarkTile::kChanged);
}

}  // namespace

struct WatermarkVerifier::State {
  // A root key, from which the keys of its sessions are derived.
  struct Root {
    WatermarkId id;
    SecretBytes secret;
    std::optional<std::int64_t> until_ns;  // the key signed nothing from this time on
  };
  std::vector<Root> roots;       // the newest key first; empty: the verifier is closed
  SessionKeys keys;              // keys of the session of the last record
  std::size_t root_of_keys = 0;  // index of the root of `keys`
  SliceTable slices{36};
  LatticeSamples found;
  std::vector<std::uint16_t> slice_of;
  CanonicalOrder order;
  TiledSamples tiled;
  std::vector<std::uint8_t> stream;

  // A session that the stream has left, and the number of its last frame. A session that has ended
  // has `kNoLater`. Others may go on: a frame of another session may have been put into the stream.
  struct Past {
    WatermarkId session;
    std::uint64_t frame;
  };

  // State of the chain of frames.
  bool has_frame = false;
  bool had_end = false;
  std::size_t root = 0;  // index of the root key of the last frame
  WatermarkId session{};
  std::uint64_t frame = 0;
  WatermarkTag tag{};
  std::vector<Past> past;           // earlier sessions, the one left first comes first
  std::int64_t latest_ns = kNever;  // latest time that a frame of the stream stated
  // `latest_ns` when the last of `past` was dropped for want of room; kNever: none was
  std::int64_t forgotten_ns = kNever;

  void add(const WatermarkKey& key, std::optional<std::int64_t> until_ns);
  void check_open() const;
  // Derives the keys of the session in these bytes of a record; false: none of the keys made it.
  bool find_key(std::span<const std::uint8_t> bytes);
  // Reads a record that one of the keys made and the policy accepts; `keys` are then those of its
  // session. Returns the reason if there is no such record, else an empty string.
  std::string open_record(std::span<const std::uint8_t> bytes, const WatermarkPolicy& policy,
                          WatermarkRecord& record);
  // Finds where in the stream the record's frame is.
  void find_place(const WatermarkRecord& record, WatermarkFinding& finding) const;
  // Makes the record's frame the last one of the chain.
  void go_on(const WatermarkHeader& header, const WatermarkTag& frame_tag);
  // Sorts the points into the tiles of the header, as `tiled`.
  void arrange(const PointsView& points, ExactView exact, const WatermarkHeader& header,
               ZeroSigns signs);
  // Finds the tiles whose points are not those that were signed; without tags, only by their number
  // and the lattice. Returns whether all points lie on the lattice of the embedding.
  bool check_tiles(const WatermarkRecord& record, std::span<const WatermarkTag> tags,
                   WatermarkFinding& finding) const;
  // Finds the points of unchanged tiles that carry a wrong bit. Returns whether there are none.
  bool check_bits(WatermarkEmbedding embedding, std::span<const WatermarkTag> tags,
                  WatermarkFinding& finding);
  void check_content(const PointsView& points, ExactView exact, std::span<const std::uint8_t> bytes,
                     const WatermarkRecord& record, std::uint32_t num_dropped, ZeroSigns signs,
                     WatermarkFinding& finding);
  [[nodiscard]] WatermarkTag state_tag(std::size_t number,
                                       std::span<const std::uint8_t> bytes) const;
};

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
  // Before the tag over the raw bytes is checked, only the two ids that determine the keys are
  // read.
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
  // the last root is tried first, because its keys are derived already
  const std::size_t last = root_of_keys;
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
  s.latest_ns = s.forgotten_ns = kNever;
}

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
  const WatermarkFinding opened = finding;
  s.check_content(points, exact, bytes, record, num_dropped, ZeroSigns::kIgnored, finding);
  if (finding.content != WatermarkContent::kIntact && has_negative_zero(points)) {
    // An early record may have bound the signs of zeros. Then exactly the signed bits verify.
    WatermarkFinding strict = opened;
    s.check_content(points, exact, bytes, record, num_dropped, ZeroSigns::kBound, strict);
    const bool is_intact = strict.content == WatermarkContent::kIntact;
    if (is_intact || num_changed(strict) < num_changed(finding)) finding = std::move(strict);
  }
  if (picture) {
    const WatermarkTag seen = tag_of_picture(s.keys.image(), *picture);
    finding.picture_changed = !equal_in_constant_time(seen, record.header.context);
    if (finding.picture_changed) finding.content = WatermarkContent::kTampered;
  }
  s.find_place(record, finding);
  finding.freshness = freshness_of(policy, record.header, now_ns);
  conclude(policy, now_ns, finding);
  // The record is genuine, even if the points were changed: later frames must come after this one.
  if (finding.order != WatermarkPlace::kReplay) s.go_on(record.header, frame_tag_of(bytes));
  return finding;
}

void WatermarkVerifier::State::arrange(const PointsView& points, ExactView exact,
                                       const WatermarkHeader& header, ZeroSigns signs) {
  if (static_cast<int>(header.tile_of.size()) != slices.size()) {
    slices = SliceTable(static_cast<int>(header.tile_of.size()));
  }
  if (header.is_exact) {
    sample_exact(points, {exact, header.units_per_m, header.offset}, ExactUse::kVerify, slices,
                 found, slice_of, signs);
  } else {
    sample_for_verification(points, header.embedding, header.units_per_m, slices, found, slice_of,
                            signs);
  }
  order.sort(found.samples, found.marks, slice_of, header.tile_of, header.num_tiles,
             order_of(header.embedding), tiled);
}

bool WatermarkVerifier::State::check_tiles(const WatermarkRecord& record,
                                           std::span<const WatermarkTag> tags,
                                           WatermarkFinding& finding) const {
  finding.tiles.assign(record.tags.size(), WatermarkTile::kIntact);
  bool all_on_lattice = true;
  for (std::size_t t = 0; t < record.tags.size(); ++t) {
    bool off_lattice = false;
    for (std::size_t i = tiled.begins[t]; i < tiled.begins[t + 1]; ++i) {
      off_lattice = off_lattice || (tiled.marks[i] & kOffLattice) != 0;
    }
    const bool same_count = tiled.begins[t + 1] - tiled.begins[t] == record.counts[t];
    const bool same_tag =
        tags.empty() || equal_in_constant_time(std::span(tags[t]).first(16), record.tags[t]);
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
                                             std::uint32_t num_dropped, ZeroSigns signs,
                                             WatermarkFinding& finding) {
  const WatermarkHeader& header = record.header;
  arrange(points, exact, header, signs);
  finding.tile_of_row.resize(slice_of.size());
  for (std::size_t i = 0; i < slice_of.size(); ++i) {
    finding.tile_of_row[i] = header.tile_of[slice_of[i]];
  }
  const bool same_drops = header.num_dropped == num_dropped;
  if (header.has_intensity && !points.has_intensity()) {
    // The tags bind the intensities, so that nothing proves the coordinates. Numbers of points and
    // the lattice can still prove a change.
    const bool all_on_lattice = check_tiles(record, {}, finding);
    if (!all_on_lattice || !same_drops || num_changed(finding) > 0) {
      finding.content = WatermarkContent::kTampered;
    } else {
      finding.content = WatermarkContent::kUnverifiable;
      finding.tiles.clear();
      finding.tile_of_row.clear();
    }
    return;
  }
  const std::vector<std::uint8_t> head = header_bytes(header);
  const std::vector<WatermarkTag> tags = tags_of_tiles(keys, head, tiled);
  const bool all_on_lattice = check_tiles(record, tags, finding);
  const bool bits_hold = check_bits(header.embedding, tags, finding);
  const WatermarkTag whole = tag_of_record(keys, "m3d-frame", body_of(bytes), tags);
  const bool frame_holds = equal_in_constant_time(whole, frame_tag_of(bytes));
  // A scan without intensities may come back with intensities of 0, because formats such as KITTI's
  // write these. Other intensities change the tags.
  const bool is_intact = frame_holds && bits_hold && all_on_lattice && same_drops;
  finding.content = is_intact ? WatermarkContent::kIntact : WatermarkContent::kTampered;
}

void WatermarkVerifier::State::find_place(const WatermarkRecord& record,
                                          WatermarkFinding& finding) const {
  const WatermarkHeader& header = record.header;
  finding.order = WatermarkPlace::kUnknown;
  // The stream never returns to an older key: otherwise a thief of an old key could begin sessions,
  // or even name the current one.
  finding.is_of_older_key = has_frame && root_of_keys > root;
  const auto left = std::ranges::find(past, header.session, &Past::session);
  if (finding.is_of_older_key || (left != past.end() && header.frame <= left->frame)) {
    finding.order = WatermarkPlace::kReplay;
  } else if (left != past.end()) {
    // Frames of another session came between: also the next frame of the chain may be played late.
    finding.order = WatermarkPlace::kGap;
    finding.gap = num_between(left->frame, header.frame);
  } else if (!has_frame || header.session != session || root_of_keys != root) {
    // A session may begin if no frame was seen before, or after the last frame of the previous
    // session. What states no later time than sessions that were forgotten may be a replay of one.
    const bool is_new = forgotten_ns == kNever || header.time_ns > forgotten_ns;
    if (header.is_genesis && (!has_frame || had_end)) {
      if (is_new) finding.order = WatermarkPlace::kInOrder;
    } else if (has_frame) {
      finding.order = WatermarkPlace::kGap;
    }
  } else if (header.frame <= frame) {
    finding.order = WatermarkPlace::kReplay;
  } else if (header.frame > frame + 1) {
    finding.order = WatermarkPlace::kGap;
    finding.gap = num_between(frame, header.frame);
  } else if (equal_in_constant_time(record.previous, tag)) {
    finding.order = WatermarkPlace::kInOrder;
  }
}

void WatermarkVerifier::State::go_on(const WatermarkHeader& header, const WatermarkTag& frame_tag) {
  if (has_frame && header.session != session) {
    std::erase_if(past, [&](const Past& left) { return left.session == header.session; });
    if (past.size() == kMaxSessions) {
      past.erase(past.begin());
      forgotten_ns = latest_ns;
    }
    past.push_back({session, had_end ? kNoLater : frame});
  }
  has_frame = true;
  had_end = header.is_end;
  root = root_of_keys;
  session = header.session;
  frame = header.frame;
  tag = frame_tag;
  latest_ns = std::max(latest_ns, header.time_ns);
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
  bytes.reserve(kFixedState + 32 + 24 * s.past.size());
  const auto put = [&](std::span<const std::uint8_t> more) {
    // push_back, because GCC 12 warns of an insert
    for (const std::uint8_t byte : more) bytes.push_back(byte);
  };
  const auto put_number = [&](std::uint64_t value) {
    std::array<std::uint8_t, 8> number;
    store(value, number.data());
    put(number);
  };
  put(bytes_of("m3d-vs03"));
  put(std::array<std::uint8_t, 2>{s.has_frame, s.had_end});
  put(s.session);
  put_number(s.frame);
  put(s.tag);
  put_number(static_cast<std::uint64_t>(s.latest_ns));
  put_number(static_cast<std::uint64_t>(s.forgotten_ns));
  for (const State::Past& left : s.past) {
    put(left.session);
    put_number(left.frame);
  }
  put(s.state_tag(s.root, bytes));
  return bytes;
}

void WatermarkVerifier::restore(std::span<const std::uint8_t> state) {
  State& s = *state_;
  s.check_open();
  constexpr std::size_t kTag = 32;
  const auto is_of = [&](std::string_view version) {
    return std::ranges::equal(state.first(std::min<std::size_t>(state.size(), 8)),
                              bytes_of(version));
  };
  // States of the first version do not state the last frames of earlier sessions: all frames of
  // these sessions are replays. Those of the first two state no times.
  const bool is_first = is_of("m3d-vs01"), has_times = !is_first && !is_of("m3d-vs02");
  const std::size_t fixed = kFixedState - (has_times ? 0 : 16);
  const std::size_t step = is_first ? 16 : 24;
  const bool possible = state.size() >= fixed + kTag && (state.size() - fixed - kTag) % step == 0 &&
                        state.size() <= fixed + kTag + step * kMaxSessions;
  // The state was authenticated with the key of the last frame, which is found by trying all keys.
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
  s.past.resize((state.size() - fixed - kTag) / step);
  for (std::size_t i = 0; i < s.past.size(); ++i) {
    const std::uint8_t* place = state.data() + fixed + step * i;
    std::copy_n(place, 16, s.past[i].session.begin());
    s.past[i].frame = is_first ? kNoLater : load<std::uint64_t>(place + 16);
  }
  s.latest_ns = s.forgotten_ns = kNever;
  if (has_times) {
    s.latest_ns = load<std::int64_t>(state.data() + 66);
    s.forgotten_ns = load<std::int64_t>(state.data() + 74);
  } else if (s.past.size() == kMaxSessions) {
    s.latest_ns = s.forgotten_ns = std::numeric_limits<std::int64_t>::max();
  }
}

}  // namespace manip3d
