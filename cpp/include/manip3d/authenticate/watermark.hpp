#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "manip3d/authenticate/watermark_key.hpp"
#include "manip3d/authenticate/watermark_picture.hpp"
#include "manip3d/geometry/point_cloud.hpp"

/// @file
/// A keyed watermark for LiDAR scans (dissertation section 7.3, bound to the content by a key).
///
/// The watermark protects a scan from the embedder to the verifier. Forgery in front of the sensor
/// is not detected: it is signed as genuine. The key is symmetric, so that every verifier could
/// forge.
namespace manip3d {

/// Embedding of the bits of the watermark in a scan.
enum class WatermarkEmbedding : std::uint8_t {
  /// The points carry no bits and stay unchanged to the bit; the record alone binds them.
  kDetached = 0,
  kLbm = 1,  ///< Lowest bits of x, y and z as whole numbers of 1 / units_per_m metres.
  kQim = 2,  ///< z at a quarter (bit 0) or three quarters (bit 1) of a cell of 2.5 mm.
};

/// Merge partner of a slice with too few points.
enum class WatermarkMerge : std::uint8_t {
  kAdjacent,  ///< Merge a slice with its smaller neighbour in azimuth.
  kPaper,     ///< Merge the two smallest slices, wherever they are.
};

/// Fields of a record except the tags; see `WatermarkRecord` for the bytes.
struct WatermarkHeader {
  std::uint8_t suite = 1;
  WatermarkEmbedding embedding = WatermarkEmbedding::kLbm;
  std::uint8_t carrier = 0;  ///< 0: a file beside the scan; 1: inside an image.
  bool is_genesis = false;   ///< The first frame of its session.
  bool is_end = false;       ///< The last frame of its session.
  bool has_context = false;
  WatermarkId sensor{};
  WatermarkId session{};
  std::uint64_t frame = 0;
  std::int64_t time_ns = 0;
  /// Units of the coordinate grid per metre; 0: samples are the bits of float32 coordinates.
  std::uint32_t units_per_m = 1000;
  std::array<std::int64_t, 3> offset{};  ///< Units: origin of the samples in the coordinates.
  bool is_exact = false;                 ///< Samples are made from float64 coordinates.
  /// Units of intensity; 0: samples are the bits of the float32 values.
  std::uint32_t units_per_intensity = 0;
  bool has_intensity = false;
  std::uint32_t num_dropped = 0;       ///< Points of the file without coordinates.
  std::vector<std::uint16_t> tile_of;  ///< Tile of each slice.
  std::uint16_t num_tiles = 0;
  /// Hash of other data that was recorded together with the scan.
  std::array<std::uint8_t, 32> context{};
};

/// A watermark record, little-endian and without padding.
///
/// header | num_tiles x (count u32, tag 16) | frame tag of the previous frame 32 | record tag 32 |
/// frame tag 32, where the header is "m3d-wm01", suite u8, embedding u8, carrier u8, flags u8 (1
/// genesis, 2 end, 8 context), sensor 16, session 16, frame u64, time_ns i64, units_per_m u32,
/// offset 3 x i64, units_per_intensity u32, fields u16 (1 intensity, 2 float64), slices u16, tiles
/// u16, dropped u32, slices x u16 merge map, context 32.
///
/// With keys of the session (watermark_suite.hpp), tag_i = BLAKE2b(K_tile, "m3d-tile" | header | i
/// u32 | count u32 | samples of 16 bytes), frame tag = BLAKE2b(K_frame, "m3d-frame" | record |
/// tag_0 | tag_1 ...), and record tag = BLAKE2b(K_frame, "m3d-record" | record | frame tag). The
/// record tag serves to distinguish a changed record from changed points.
struct WatermarkRecord {
  static constexpr std::size_t kMaxSize = 16384;
  static constexpr std::size_t kFixedSize = 102;  ///< Bytes of the header before the merge map.

  WatermarkHeader header;
  std::vector<std::uint32_t> counts;
  std::vector<std::array<std::uint8_t, 16>> tags;
  std::array<std::uint8_t, 32> previous{};

  /// @throws FormatError  the bytes are no record of suite 1, or a damaged one.
  static WatermarkRecord parse(std::span<const std::uint8_t> bytes);
};

struct WatermarkOptions {
  WatermarkEmbedding embedding = WatermarkEmbedding::kLbm;
  int slices = 36;
  int least_points = 1000;  ///< Fewest points of a tile; smaller slices are merged.
  WatermarkMerge merge = WatermarkMerge::kAdjacent;
  bool round = false;  ///< Round points onto the grid; false: points off the grid are an error.
  std::uint32_t units_per_m = 1000;  ///< Steps of the grid per metre, 1 to 1000000; QIM: 1000.
};

/// Coordinates in float64, (N, 3), row by row; empty: the float32 points are exact.
using ExactView = std::span<const double>;
using ExactPoints = Rows<double, 3>;

/// Returns row numbers in the order that embedder and verifier derive from the points, tile by
/// tile. This is the first step of embedding, with tiles of `least_points`. The embedder merges
/// more slices if a tile would carry too few bits.
/// @throws InputError  no points, values that are not finite, points off the grid, an option out of
///                     range.
std::vector<std::int32_t> watermark_order(const PointsView& points,
                                          const WatermarkOptions& options = {});

/// Settings of one frame.
struct WatermarkFrame {
  std::int64_t time_ns = 0;
  std::uint32_t num_dropped = 0;
  bool is_end = false;
  std::optional<std::array<std::uint8_t, 32>> context;
  /// Units: origin of float64 coordinates; float32 coordinates: 0.
  std::array<std::int64_t, 3> offset{};
  /// Picture that carries the record. It then is the context, and `context` must be empty.
  std::optional<PictureView> picture;
};

struct WatermarkedScan {
  Points points;      ///< The points in their input order; empty if they did not change.
  ExactPoints exact;  ///< The points if the input was in float64; `points` then is empty.
  std::vector<std::uint8_t> record;
  /// Samples of the picture with the record; empty without a picture.
  std::vector<std::uint8_t> picture;
  std::uint64_t frame = 0;
  int num_tiles = 0;
};

/// Embeds watermarks into the frames of one session, which begins with this object.
class WatermarkEmbedder {
 public:
  /// @throws Error  the key is closed.
  /// @throws InputError  an option is out of range.
  WatermarkEmbedder(const WatermarkKey& key, const WatermarkId& sensor,
                    const WatermarkOptions& options = {});
  /// Overload with a given session, for tests with known answers; never use a session twice.
  WatermarkEmbedder(const WatermarkKey& key, const WatermarkId& sensor, const WatermarkId& session,
                    const WatermarkOptions& options);
  /// Returns an embedder that continues a session after the frame of this record, for example after
  /// a program was stopped.
  /// @throws FormatError  no record, a damaged one, or one of another key or sensor.
  /// @throws InputError  the session has ended, or has another embedding or grid than the options.
  static WatermarkEmbedder after(std::span<const std::uint8_t> record, const WatermarkKey& key,
                                 const WatermarkId& sensor, const WatermarkOptions& options = {});
  WatermarkEmbedder(WatermarkEmbedder&&) noexcept;
  WatermarkEmbedder& operator=(WatermarkEmbedder&&) noexcept;
  ~WatermarkEmbedder();

  /// Embeds the watermark of one frame.
  ///
  /// The largest move of a point is sqrt(3) units with LBM, 15/8 units (of 1 mm) with QIM, and 0
  /// with a detached record; rounding onto the grid adds sqrt(3)/2 units.
  /// @param exact  Coordinates in float64, with LBM only: they carry the bits, and `points` is read
  ///               for its intensities only. A coordinate within 2^-13 units of the grid counts as
  ///               on it.
  /// @throws InputError  values that are not finite, points off the grid, a picture that
  ///                     cannot carry the record.
  /// @throws Error  the embedder is closed, or the session has ended.
  WatermarkedScan embed(const PointsView& points, const WatermarkFrame& frame = {},
                        ExactView exact = {});

  [[nodiscard]] const WatermarkId& session() const;
  /// Wipes the keys. May be called twice.
  void close();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Policy of a verifier. The record must comply with it and cannot change it.
struct WatermarkPolicy {
  std::vector<WatermarkEmbedding> embeddings = {WatermarkEmbedding::kDetached,
                                                WatermarkEmbedding::kLbm, WatermarkEmbedding::kQim};
  std::vector<std::uint8_t> carriers = {0, 1};
  std::vector<WatermarkId> sensors;   ///< Accepted sensors; empty: any.
  std::vector<WatermarkId> sessions;  ///< Accepted sessions; empty: any.
  /// Accepted coordinate grids of embeddings that carry bits; empty: any.
  std::vector<std::uint32_t> units_per_m;
  std::int64_t max_points = 10'000'000;
  bool any_order = false;  ///< Accept a frame whose place in the stream is unknown.
  /// Largest age or lead of a frame against the verifier's clock, ns; 0: any.
  std::int64_t max_age_ns = 0;
  /// Required hash of the context; empty: any.
  std::optional<std::array<std::uint8_t, 32>> context;
};

enum class WatermarkContent : std::uint8_t { kIntact, kTampered, kUnverifiable };
enum class WatermarkPlace : std::uint8_t { kUnknown, kInOrder, kGap, kReplay };
enum class WatermarkFreshness : std::uint8_t { kUnknown, kFresh, kStale };
enum class WatermarkTile : std::uint8_t {
  kIntact,
  kBits,  ///< The content is intact; carrier bits differ at WatermarkFinding::rows.
  /// The content differs. The points are not listed, because a list would help a forger.
  kChanged,
};
enum class WatermarkVerdict : std::uint8_t { kAuthentic, kTampered, kUnverifiable };

struct WatermarkFinding {
  WatermarkVerdict verdict = WatermarkVerdict::kUnverifiable;
  std::string reason;
  WatermarkContent content = WatermarkContent::kUnverifiable;
  WatermarkPlace order = WatermarkPlace::kUnknown;
  std::int64_t gap = 0;  ///< Number of frames that are missing before this one.
  WatermarkFreshness freshness = WatermarkFreshness::kUnknown;
  /// Fields of the record; empty if the record's own tag is wrong.
  std::optional<WatermarkHeader> header;
  std::optional<WatermarkId> key;  ///< The key that made the record; empty if `header` is empty.
  /// The record is of an older key than an earlier frame of the stream.
  bool is_of_older_key = false;
  bool picture_changed = false;  ///< The picture differs from the one that the record binds.
  std::vector<WatermarkTile> tiles;
  /// Row numbers of the points of which only carrier bits differ, ascending.
  std::vector<std::int32_t> rows;
  /// (N,) tile of each point; empty if no points were compared with the record.
  std::vector<std::uint16_t> tile_of_row;
};

/// Verifies the frames of a stream in order. Its state is the chain of frames.
///
/// A record does not name its key: the verifier finds the key with which the record's own tag is
/// correct. Records are refused if they state a time at which their key had expired or had been
/// replaced. The embedder states the time, so that a thief of an old key can state an earlier one;
/// but in a stream that has continued with a newer key, frames of the old key count as replays.
///
/// If a frame of another session comes before the session has ended, it is a gap, and the stream
/// continues with that session. The session that was left may continue later, which is a gap, too.
/// Frames of a session that has ended, and frames up to the last one that was seen of a session
/// that was left, are replays. The last 4096 sessions that were left are remembered. Once more were
/// left, a session that is not among them can only begin at a later time than the frames that were
/// seen until then state; otherwise the place of its first frame is unknown.
class WatermarkVerifier {
 public:
  /// @throws Error  the key is closed.
  explicit WatermarkVerifier(const WatermarkKey& key);
  WatermarkVerifier(WatermarkVerifier&&) noexcept;
  WatermarkVerifier& operator=(WatermarkVerifier&&) noexcept;
  ~WatermarkVerifier();

  /// Adds a key that was replaced before the keys given so far.
  /// @param replaced_ns  The key signed nothing from this time on; nanoseconds since 1970, any
  ///                     number.
  /// @throws InputError  the verifier has this key already.
  /// @throws Error  the key or the verifier is closed.
  void add_older_key(const WatermarkKey& key, std::int64_t replaced_ns);

  /// Verifies one frame.
  /// @param num_dropped  Points of the file without coordinates.
  /// @param now_ns       Nanoseconds since 1970.
  /// @param picture      The picture that carried the record; empty: the record came from
  ///                     elsewhere.
  /// @throws InputError  values are not finite.
  /// @throws Error  the verifier is closed.
  WatermarkFinding verify(const PointsView& points, std::span<const std::uint8_t> record,
                          const WatermarkPolicy& policy, std::uint32_t num_dropped = 0,
                          std::int64_t now_ns = 0, ExactView exact = {},
                          const std::optional<PictureView>& picture = std::nullopt);

  /// Returns the state of the chain, authenticated with the key of its last frame. Another verifier
  /// can continue with it.
  [[nodiscard]] std::vector<std::uint8_t> state() const;
  /// Continues from a state that state() returned.
  /// @throws FormatError  the state is damaged, or of a key that the verifier does not have.
  void restore(std::span<const std::uint8_t> state);
  /// Forgets the frames of the stream.
  void reset();
  /// Wipes the keys. May be called twice.
  void close();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace manip3d
