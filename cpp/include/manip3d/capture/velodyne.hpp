#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <span>
#include <string>
#include <vector>

/// @file
/// Data packets of Velodyne's spinning LiDARs.
///
/// A packet is 1206 bytes: 12 blocks of (flag, azimuth in 0.01 degrees, 32 x (range,
/// reflectivity)), a time stamp in microseconds after the hour, and two factory bytes (return mode,
/// product). Sources: User's manuals HDL-64E S2 (63-HDL64ES2), HDL-32E (63-9113), VLP-16 and Puck
/// Hi-Res (63-9243), VLP-32C (63-9325).
namespace manip3d {

constexpr std::size_t kVelodynePacketBytes = 1206;

/// kVlp16HiRes: the Puck Hi-Res, a VLP-16 with 1.33 instead of 2 degrees between lasers.
enum class VelodyneModel : std::uint8_t { kHdl64e, kHdl32e, kVlp16, kVlp32c, kVlp16HiRes };

/// Returns whether a UDP payload is a data packet: it has their length, and the flag of a block.
bool is_velodyne_data(std::span<const std::byte> payload);

/// Returns "hdl64e", ...
const char* velodyne_model_name(VelodyneModel model);
std::optional<VelodyneModel> velodyne_model_of_name(const std::string& name);

/// Direction of a laser and corrections of its ranges, as in the calibration file of the HDL-64E,
/// db.xml (User's manual HDL-64E S2, appendix on calibration).
struct LaserCalibration {
  double elevation_deg = 0.0;       ///< Above the horizontal plane.
  double azimuth_offset_deg = 0.0;  ///< Added to the rotor's azimuth (clockwise from above).
  /// Added to each range. With has_two_points it applies at 25.04 m, and the offset is interpolated
  /// linearly between there and the two near distances below.
  double range_offset_m = 0.0;
  bool has_two_points = false;       ///< True: range_offset_x_m and range_offset_y_m are known.
  double range_offset_x_m = 0.0;     ///< Offset at |x| = 2.4 m; the manual's x is to the right.
  double range_offset_y_m = 0.0;     ///< Offset at |y| = 1.93 m; the manual's y is forward.
  double vertical_offset_m = 0.0;    ///< Shift of the laser upwards, perpendicular to its beam.
  double horizontal_offset_m = 0.0;  ///< Shift of the laser to the left of its beam.
};

struct VelodyneCalibration {
  std::vector<LaserCalibration>
      lasers;  ///< In the order of the packet; HDL-64E: upper block first.
  double range_unit_m = 0.002;
};

/// Returns the tables that the manual prints for all sensors of a model: angles, and the vertical
/// corrections of VLP-16 and Puck Hi-Res. (VeloView and velodyne-decoder also raise the points of
/// HDL-32E and VLP-32C by -29 and -42.4 mm times the tangent of the elevation; the manuals do not.)
/// @throws InputError  HDL-64E: each sensor has its own calibration file.
VelodyneCalibration factory_calibration(VelodyneModel model);

enum class ReturnType : std::uint8_t {
  kUnknown,  ///< The packet does not state it (HDL-64E with one return).
  /// The strongest return. In dual return mode of VLP-16 and VLP-32C, it is the second-strongest
  /// one if the strongest is the last, too; packets do not tell the two cases apart.
  kStrongest,
  kLast,
  kBoth  ///< In dual return mode, the two returns are equal, since only one was detected.
};

struct VelodyneOptions {
  /// Empty: determined by the first packet with a valid block. HDL-64E packets are recognised by
  /// their lower blocks (0xDDFF), at least 3 of 12. The VLS-128 has these, too, with two more kinds
  /// of blocks; it is not read.
  std::optional<VelodyneModel> model;
  VelodyneCalibration calibration;  ///< Without lasers: factory_calibration() of the model.
  /// Degrees in [0, 360): a frame ends where the azimuth passes this angle.
  double cut_azimuth_deg = 0.0;
  /// Interpolate the azimuth by the time of each firing in a block; off: all firings have the
  /// block's azimuth. Blocks of the HDL-64E always have one azimuth, because its calibration
  /// contains the differences.
  bool interpolate_azimuth = true;
  double min_range_m = 0.0;
  double max_range_m = 1000.0;
  /// A frame with more points is ended at any azimuth.
  std::int64_t max_points_per_frame = std::int64_t{1} << 22;
};

/// Counts of packets and firings. Each firing of a good block counts in exactly one of points,
/// no_return, duplicates and out_of_range.
struct VelodyneCounters {
  std::int64_t packets = 0;           ///< Data packets with at least one decoded block.
  std::int64_t position_packets = 0;  ///< Packets of 512 bytes (GPS), which are ignored.
  std::int64_t bad_length = 0;        ///< Packets of any other length.
  std::int64_t unknown_product = 0;   ///< Packets of an unknown model.
  /// Packets of another model than the option or the first packet says. For an HDL-64E, these are
  /// packets without a lower block that name another product.
  std::int64_t other_product = 0;
  std::int64_t unknown_return_mode = 0;  ///< Packets with an unknown return mode.
  /// Packets with a time beyond the hour. They are decoded, with the time at which they were due.
  std::int64_t bad_time = 0;
  std::int64_t bad_block_flag = 0;    ///< Blocks with an unknown flag.
  std::int64_t bad_azimuth = 0;       ///< Blocks with an azimuth of 360 degrees or more.
  std::int64_t backward_azimuth = 0;  ///< Blocks behind an earlier one; they are decoded.
  /// Packets that the scanner must have sent between two others, by their times (see
  /// VelodyneDecoder); those of an HDL-64E, whose rate no manual states, are not counted.
  std::int64_t lost_packets = 0;
  std::int64_t repeated_packets = 0;  ///< Equal to the one before: captured twice. Left out.
  std::int64_t no_return = 0;         ///< Firings with range 0.
  std::int64_t duplicates = 0;        ///< Second ones of two equal returns.
  std::int64_t out_of_range = 0;      ///< Returns outside of min_range_m and max_range_m.
  std::int64_t points = 0;
  std::int64_t frames = 0;
  std::int64_t overlong_frames = 0;  ///< Frames that ended at max_points_per_frame.
};

/// One turn of the sensor. Metres; x forward (azimuth 0), y left, z up.
struct VelodyneFrame {
  std::vector<float> points;              ///< (3 N) x, y, z
  std::vector<float> intensity;           ///< (N) reflectivity as sent, 0 to 255.
  std::vector<std::uint8_t> ring;         ///< 0: the highest laser.
  std::vector<std::uint8_t> laser;        ///< Number of the laser in the packet.
  std::vector<std::uint8_t> return_type;  ///< ReturnType
  std::vector<float> azimuth;             ///< Degrees in [0, 360), clockwise from above.
  std::vector<float> range;  ///< Metres as sent, without the offsets of the calibration.
  std::vector<float> time;   ///< Seconds since the frame's first packet.
  VelodyneModel model = VelodyneModel::kVlp16;
  /// Arrival of the first packet, nanoseconds since 1970, by the receiver's clock; empty: unknown.
  std::optional<std::int64_t> time_ns;
  double sensor_time = 0.0;  ///< Time in the first packet, seconds after the hour.
  std::int64_t packets = 0;
  /// The frame began and ended at the cut, and covers at least half the azimuths of earlier ones.
  bool is_complete = false;

  [[nodiscard]] std::int64_t num_points() const {
    return static_cast<std::int64_t>(intensity.size());
  }
};

/// Decodes packets into frames. Safe for any bytes: a packet is either decoded, to exactly the
/// points that it contains, or refused and counted.
///
/// A scanner sends packets at a fixed rate within its field of view. If a packet comes later, and
/// earlier turns measured all azimuths in between, packets were lost. A step of the time by more
/// than a second is a pause, or the scanner's clock was set: the frame in progress ends there and
/// is incomplete, as is the next one, and no packets are counted. For an HDL-64E, this needs 100
/// packets before it without such a step, because its old firmware sends no time.
class VelodyneDecoder {
 public:
  /// @throws InputError  an option is out of range, or the number of lasers is not the model's.
  explicit VelodyneDecoder(VelodyneOptions options = {});

  /// Adds one UDP payload; `time_ns` as in VelodyneFrame.
  /// @throws InputError   it is the first packet of an HDL-64E, and there is no calibration.
  /// @throws FormatError  it is the first packet, and it is a VLS-128's.
  void decode(std::span<const std::byte> payload, std::optional<std::int64_t> time_ns);
  /// Removes the oldest finished frame; returns false if there is none.
  bool take(VelodyneFrame& frame);
  /// Ends the frame in progress, which is then incomplete.
  void flush();
  /// Resets the decoder: drops all frames, the detected model and the counters.
  void reset();

  [[nodiscard]] const VelodyneCounters& counters() const { return counters_; }
  [[nodiscard]] std::optional<VelodyneModel> model() const { return model_; }

 private:
  struct Laser {  // precomputed for the positions of points
    double sin_elevation, cos_elevation;
    double azimuth_offset;  // 0.01 degrees
    double range_offset, range_offset_x, range_offset_y;
    double vertical_offset, horizontal_offset;
    bool has_two_points;
    std::uint8_t ring;
  };
  struct Block;
  struct Packet;

  std::optional<VelodyneModel> identify(std::span<const std::byte> payload);
  void set_model(VelodyneModel model);
  void read_packet(std::span<const std::byte> payload, VelodyneModel model, Packet& packet);
  void read_returns(Packet& packet, std::span<const std::byte> payload);
  static bool has_equal_azimuths(const Packet& packet);
  void measure_turns(Packet& packet, std::size_t next);
  void decode_block(const Packet& packet, std::size_t index, std::span<const std::byte> payload);
  void advance(std::uint32_t azimuth, const Packet& packet, bool is_first);
  bool is_after_step(const Packet& packet);
  void break_turn();
  [[nodiscard]] double elapsed_until(const Packet& packet) const;
  [[nodiscard]] bool is_behind(std::uint32_t step, const Packet& packet) const;
  void count_lost(const Packet& packet);
  [[nodiscard]] bool was_measured(std::uint32_t from, std::uint32_t length) const;
  void add_point(const Laser& laser, std::uint8_t number, double azimuth, std::uint32_t raw_range,
                 std::uint8_t reflectivity, ReturnType type, double time);
  void begin_frame(const Packet& packet, bool at_cut);
  void end_frame(bool at_cut);

  VelodyneOptions options_;
  VelodyneCounters counters_;
  std::optional<VelodyneModel> model_;
  std::vector<Laser> lasers_;
  std::vector<double> fraction_;  // time of each firing in a block, as a share of the column's time
  std::vector<double> delay_;     // time of each firing in a block, seconds
  double column_time_ = 0.0;      // seconds from block to block
  double turn_ = 0.0;  // last valid step of the azimuth from column to column, 0.01 degrees
  double range_unit_ = 0.002;
  std::uint32_t cut_ = 0;
  std::optional<std::uint32_t> last_azimuth_;  // of the foremost block, 0.01 degrees
  std::vector<std::byte> last_payload_;        // of the packet before, to find repeated ones
  double last_time_ = 0.0;                     // sensor time of that block's packet
  std::int64_t steady_packets_ = 0;            // packets in a row without a step of the time
  double last_span_ = 0.0;  // time until the packet after that one, seconds; 0: unknown
  std::array<std::int64_t, 360> measured_{};  // number of the last frame with a block, by degree
  std::uint32_t covered_ = 0;  // azimuths of the frame in progress without gaps, 0.01 degrees
  std::uint32_t field_ = 0;    // azimuths that earlier frames covered, 0.01 degrees
  bool is_open_ = false;
  bool began_at_cut_ = false;
  double frame_time_ = 0.0;  // sensor time of the frame in progress
  VelodyneFrame frame_;
  std::size_t capacity_hint_ = 0;
  std::deque<VelodyneFrame> ended_;
};

}  // namespace manip3d
