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
/// The watermark protects a scan from the embedder to the verifier. What was injected in front of
/// the sensor is signed as genuine. The key is symmetric: whoever verifies could forge.
namespace manip3d {

/// How a scan carries its bits.
enum class WatermarkEmbedding : std::uint8_t {
  kDetached = 0,  ///< Not at all: the points stay as they are, to the bit; only the record binds.
  kLbm = 1,       ///< Lowest bits of x, y and z as whole numbers of 1 / units_per_m metres.
  kQim = 2,       ///< z at a quarter (bit 0) or three quarters (bit 1) of a cell of 2.5 mm.
};

/// Which slice a slice with too few points is merged with.
enum class WatermarkMerge : std::uint8_t {
  kAdjacent,  ///< Merge a slice with its smaller neighbour in azimuth.
  kPaper,     ///< Merge the two smallest slices, wherever they are.
};

/// Fields of a record besides the tags; see `WatermarkRecord` for its bytes.
struct WatermarkHeader {
  std::uint8_t suite = 1;
  WatermarkEmbedding embedding = WatermarkEmbedding::kLbm;
  std::uint8_t carrier = 0;  ///< 0: a file beside the scan; 1: inside an image.
  bool is_genesis = false;   ///< The first frame of its session.
  bool is_end = false;       ///< The last one.
  bool has_context = false;
  WatermarkId sensor{};
  WatermarkId session{};
  std::uint64_t frame = 0;
  std::int64_t time_ns = 0;
  std::uint32_t units_per_m = 1000;       ///< 0: the bits of the float32 coordinates.
  std::array<std::int64_t, 3> offset{};   ///< Units from the coordinates' zero to the samples' one.
  bool is_exact = false;                  ///< Samples are of float64 coordinates.
  std::uint32_t units_per_intensity = 0;  ///< 0: the bits of the float32 values.
  bool has_intensity = false;
  std::uint32_t num_dropped = 0;       ///< Points of the file without coordinates.
  std::vector<std::uint16_t> tile_of;  ///< Tile of each slice.
  std::uint16_t num_tiles = 0;
  std::array<std::uint8_t, 32> context{};  ///< Hash of what was recorded beside the scan.
};

/// A record: little-endian, without gaps.
///
/// header | num_tiles x (count u32, tag 16) | tag of the previous frame 32 | record tag 32 |
/// frame tag 32, where the header is "m3d-wm01", suite u8, embedding u8, carrier u8, flags u8
/// (1 genesis, 2 end, 8 context), sensor 16, session 16, frame u64, time_ns i64, units_per_m u32,
/// offset 3 x i64, units_per_intensity u32, fields u16 (1 intensity, 2 float64), slices u16, tiles
/// u16, dropped u32, slices x u16 merge map, context 32. With keys of the session
/// (watermark_suite.hpp), tag_i = BLAKE2b(K_tile, "m3d-tile" | header | i u32 | count u32 | samples
/// of 16 bytes), frame tag = BLAKE2b(K_frame, "m3d-frame" | record | tag_0 | tag_1 ...), and, so
/// that a changed record is told from changed points, record tag = BLAKE2b(K_frame, "m3d-record" |
/// record | frame tag).
struct WatermarkRecord {
  static constexpr std::size_t kMaxSize = 16384;
  static constexpr std::size_t kFixedSize = 102;  ///< Bytes of the header before the merge map.

  WatermarkHeader header;
  std::vector<std::uint32_t> counts;
  std::vector<std::array<std::uint8_t, 16>> tags;
  std::array<std::uint8_t, 32> previous{};

  /// @throws FormatError  the bytes are not a record of suite 1, or damaged.
  static WatermarkRecord parse(std::span<const std::uint8_t> bytes);
};

struct WatermarkOptions {
  WatermarkEmbedding embedding = WatermarkEmbedding::kLbm;
  int slices = 36;
  int least_points = 1000;  ///< Fewest points of a tile; smaller slices are merged.
  WatermarkMerge merge = WatermarkMerge::kAdjacent;
  bool round = false;                ///< Move points that are not on the grid onto it.
  std::uint32_t units_per_m = 1000;  ///< Steps of the grid a metre, 1 to 1000000; QIM: 1000.
};

/// Coordinates that need float64, (N, 3), row by row; empty: the points say all.
using ExactView = std::span<const double>;
using ExactPoints = Rows<double, 3>;

/// Rows in the order that embedder and verifier derive from the points, tile by tile: the first
/// step of embedding by itself, with the tiles that `least_points` gives. The embedder merges more
/// slices where a tile would carry too few bits.
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
  std::array<std::int64_t, 3> offset{};  ///< Origin of float64 coordinates, units; else 0.
  /// Picture that is to carry the record; it is the context then, and no other may be given.
  std::optional<PictureView> picture;
};

struct WatermarkedScan {
  Points points;      ///< The rows that came, in their order; empty where nothing was to change.
  ExactPoints exact;  ///< The rows if coordinates in float64 came; `points` is empty then.
  std::vector<std::uint8_t> record;
  std::vector<std::uint8_t> picture;  ///< Samples of the picture with the record, if one came.
  std::uint64_t frame = 0;
  int num_tiles = 0;
};

/// Embeds watermarks into the frames of one session, which begins with the object.
class WatermarkEmbedder {
 public:
  /// @throws Error  the key is closed.
  /// @throws InputError  an option out of range.
  WatermarkEmbedder(const WatermarkKey& key, const WatermarkId& sensor,
                    const WatermarkOptions& options = {});
  /// Overload with a given session, for known answers; a session must never be used twice.
  WatermarkEmbedder(const WatermarkKey& key, const WatermarkId& sensor, const WatermarkId& session,
                    const WatermarkOptions& options);
  /// One that goes on with a session after the frame of this record, as after a run that stopped.
  /// @throws FormatError  not a record, a damaged one, or one of another key or sensor.
  /// @throws InputError  its session has ended, or has another embedding or grid than the options.
  static WatermarkEmbedder after(std::span<const std::uint8_t> record, const WatermarkKey& key,
                                 const WatermarkId& sensor, const WatermarkOptions& options = {});
  WatermarkEmbedder(WatermarkEmbedder&&) noexcept;
  WatermarkEmbedder& operator=(WatermarkEmbedder&&) noexcept;
  ~WatermarkEmbedder();

  /// The largest move of a point is sqrt(3) units for LBM, 15/8 units for QIM (of 1 mm), or
  /// nothing (detached), and sqrt(3)/2 units more where points are rounded onto the grid.
  /// @param exact  Coordinates in float64, for LBM: they carry the bits, and `points` is not looked
  ///               at but for its intensities. One within 2^-13 units of a point of the grid is it.
  /// @throws InputError  values that are not finite, points off the grid, a picture that
  ///                     cannot carry the record.
  /// @throws Error  closed, or the session has ended.
  WatermarkedScan embed(const PointsView& points, const WatermarkFrame& frame = {},
                        ExactView exact = {});

  [[nodiscard]] const WatermarkId& session() const;
  /// Wipes the keys; may be called twice.
  void close();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Policy of a verifier: the record is compared with it, never obeyed.
struct WatermarkPolicy {
  std::vector<WatermarkEmbedding> embeddings = {WatermarkEmbedding::kDetached,
                                                WatermarkEmbedding::kLbm, WatermarkEmbedding::kQim};
  std::vector<std::uint8_t> carriers = {0, 1};
  std::vector<WatermarkId> sensors;        ///< Empty: any.
  std::vector<WatermarkId> sessions;       ///< Empty: any.
  std::vector<std::uint32_t> units_per_m;  ///< Accepted grids that carry bits; empty: any.
  std::int64_t max_points = 10'000'000;
  bool any_order = false;       ///< Accept a frame whose place in the stream is not known.
  std::int64_t max_age_ns = 0;  ///< 0: frames of any age.
  std::optional<std::array<std::uint8_t, 32>> context;  ///< Expected hash of what is beside.
};

enum class WatermarkContent : std::uint8_t { kIntact, kTampered, kUnverifiable };
enum class WatermarkPlace : std::uint8_t { kUnknown, kInOrder, kGap, kReplay };
enum class WatermarkFreshness : std::uint8_t { kUnknown, kFresh, kStale };
enum class WatermarkTile : std::uint8_t {
  kIntact,
  kBits,     ///< The content holds; carrier bits differ in the points listed.
  kChanged,  ///< The content differs; nothing more is said (a list would help a forger).
};
enum class WatermarkVerdict : std::uint8_t { kAuthentic, kTampered, kUnverifiable };

struct WatermarkFinding {
  WatermarkVerdict verdict = WatermarkVerdict::kUnverifiable;
  std::string reason;
  WatermarkContent content = WatermarkContent::kUnverifiable;
  WatermarkPlace order = WatermarkPlace::kUnknown;
  std::int64_t gap = 0;  ///< Frames that are missing before this one.
  WatermarkFreshness freshness = WatermarkFreshness::kUnknown;
  /// Fields of a record whose own tag holds; of another one nothing is told.
  std::optional<WatermarkHeader> header;
  std::optional<WatermarkId> key;  ///< The key that made the record, where `header` is known.
  bool is_of_older_key = false;    ///< The stream had gone on to a newer key before.
  bool picture_changed = false;    ///< The picture is not the one that the record binds.
  std::vector<WatermarkTile> tiles;
  std::vector<std::int32_t> rows;          ///< Points of which only carrier bits differ, ascending.
  std::vector<std::uint16_t> tile_of_row;  ///< (N,) Where the record's header is known.
};

/// Verifies the frames of a stream one after the other, with the chain of frames as its state.
///
/// A record names no key: its own tag tells which key made it. Records are refused that state a
/// time at which their key had expired or had been replaced. The time is what the embedder says, so
/// that a thief of an old key can state an earlier one; in a stream that has gone on to a newer key
/// his frames are replays all the same.
class WatermarkVerifier {
 public:
  /// @throws Error  the key is closed.
  explicit WatermarkVerifier(const WatermarkKey& key);
  WatermarkVerifier(WatermarkVerifier&&) noexcept;
  WatermarkVerifier& operator=(WatermarkVerifier&&) noexcept;
  ~WatermarkVerifier();

  /// Takes a key that those given so far have replaced.
  /// @param replaced_ns  From then on it has signed nothing; nanoseconds since 1970, any number.
  /// @throws InputError  the verifier has this key already.
  /// @throws Error  the key or the verifier is closed.
  void add_older_key(const WatermarkKey& key, std::int64_t replaced_ns);

  /// @param num_dropped  Points of the file without coordinates.
  /// @param now_ns       Nanoseconds since 1970.
  /// @param picture      The one that carried the record, if one did.
  /// @throws InputError  values that are not finite.
  /// @throws Error  closed.
  WatermarkFinding verify(const PointsView& points, std::span<const std::uint8_t> record,
                          const WatermarkPolicy& policy, std::uint32_t num_dropped = 0,
                          std::int64_t now_ns = 0, ExactView exact = {},
                          const std::optional<PictureView>& picture = std::nullopt);

  /// The chain's state, authenticated with the key of its last frame: for a verifier that goes on
  /// later.
  [[nodiscard]] std::vector<std::uint8_t> state() const;
  /// @throws FormatError  damaged, or of a key that the verifier does not have.
  void restore(std::span<const std::uint8_t> state);
  /// Forgets the frames seen.
  void reset();
  /// Wipes the keys; may be called twice.
  void close();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace manip3d
