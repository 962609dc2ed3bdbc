#include "manip3d/capture/velodyne.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <iterator>
#include <numbers>
#include <numeric>
#include <utility>

#include "manip3d/error.hpp"
#include "manip3d/geometry/angles.hpp"

namespace manip3d {
namespace {

constexpr std::size_t kBlocks = 12;
constexpr std::size_t kFirings = 32;  // per block
constexpr std::size_t kBlockBytes = 100;
constexpr std::size_t kPositionPacketBytes = 512;
constexpr std::uint32_t kTurnTicks = 36000;  // units of 0.01 degrees in a turn
constexpr std::uint32_t kUpperFlag = 0xEEFF;
constexpr std::uint32_t kLowerFlag = 0xDDFF;
// Flags of the lasers 64 to 95 and 96 to 127 of a VLS-128, and its product byte.
constexpr std::uint32_t kThirdFlag = 0xCCFF, kFourthFlag = 0xBBFF;
constexpr std::uint8_t kVls128Byte = 0xA1;
constexpr std::uint32_t kHour = 3'600'000'000;  // microseconds per hour
// A VLP-16 turns 0.8 degrees from column to column at 20 turns per second. More than 2 degrees are
// a gap.
constexpr std::uint32_t kLargestTurn = 200;
// A delayed packet is few packets late: two packets of a VLP-16 span 20 degrees at 20 turns per
// second.
constexpr std::uint32_t kLargestReturn = 2000;
// Seconds; larger steps of the time are pauses, or are made by setting the clock.
constexpr double kLongestDelay = 1.0;
// Half of the blocks of an HDL-64E are lower ones, and none of other products. A packet with a
// number in between is damaged, and belongs to the nearer of both.
constexpr std::ptrdiff_t kFewestLower = kBlocks / 4;
// Packets of an HDL-64E without a step of the time after which its time counts as one: old
// firmware sends its status in these bytes.
constexpr std::int64_t kSteadyPackets = 100;
// Half a turn takes 25 ms or more: within less time, the scanner cannot have left a narrow field of
// view and come back to it.
constexpr double kShortestHalfTurn = 0.02;
constexpr double kHourSeconds = 3600.0;
// Frames for which an azimuth without a block is one whose packets were lost, not one outside of a
// field of view that was changed while the sensor runs.
constexpr std::int64_t kRemembered = 10;

enum ReturnMode : std::uint8_t { kModeStrongest = 0x37, kModeLast = 0x38, kModeDual = 0x39 };

struct Product {
  VelodyneModel model;
  const char* name;
  std::uint8_t byte;  // factory byte of the product; 0: packets do not contain it
  std::size_t num_lasers;
  double column_time_s;  // time between blocks of the same return, seconds
  double range_unit_m;
};
constexpr Product kProducts[] = {
    {VelodyneModel::kHdl64e, "hdl64e", 0x00, 64, 0.0, 0.002},
    {VelodyneModel::kHdl32e, "hdl32e", 0x21, 32, 46.080e-6, 0.002},
    {VelodyneModel::kVlp16, "vlp16", 0x22, 16, 110.592e-6, 0.002},
    {VelodyneModel::kVlp32c, "vlp32c", 0x28, 32, 55.296e-6, 0.004},
    {VelodyneModel::kVlp16HiRes, "vlp16-hires", 0x24, 16, 110.592e-6, 0.002},
};

const Product& product(VelodyneModel model) { return kProducts[static_cast<int>(model)]; }

// Time of each firing after the beginning of its block, seconds. VLP-16: two rounds of 16 lasers;
// VLP-32C: two lasers at a time. The times of the HDL-64E are unknown.
double firing_delay(VelodyneModel model, std::size_t firing) {
  const auto n = static_cast<double>(firing);
  switch (model) {
    case VelodyneModel::kHdl64e:
      return 0.0;
    case VelodyneModel::kHdl32e:
      return 1.152e-6 * n;
    case VelodyneModel::kVlp16:
    case VelodyneModel::kVlp16HiRes:
      return firing < 16 ? 2.304e-6 * n : 55.296e-6 + 2.304e-6 * (n - 16.0);
    case VelodyneModel::kVlp32c:
      return 2.304e-6 * static_cast<double>(firing / 2);
  }
  return 0.0;
}

// Elevation by firing, degrees (User's manual HDL-32E, appendix on packets).
constexpr std::array<double, 32> kHdl32eElevation = {
    -30.67, -9.33,  -29.33, -8.00,  -28.00, -6.67,  -26.67, -5.33,  -25.33, -4.00,  -24.00,
    -2.67,  -22.67, -1.33,  -21.33, 0.00,   -20.00, 1.33,   -18.67, 2.67,   -17.33, 4.00,
    -16.00, 5.33,   -14.67, 6.67,   -13.33, 8.00,   -12.00, 9.33,   -10.67, 10.67};
// VLP-16: tables of vertical angles by laser, degrees, and of vertical corrections, millimetres.
constexpr std::array<double, 16> kVlp16Elevation = {
    -15.0, 1.0, -13.0, 3.0, -11.0, 5.0, -9.0, 7.0, -7.0, 9.0, -5.0, 11.0, -3.0, 13.0, -1.0, 15.0};
constexpr std::array<double, 16> kVlp16Vertical = {11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1,
                                                   5.1,  -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2};
// Puck Hi-Res: the same tables.
constexpr std::array<double, 16> kHiResElevation = {-10.0, 0.67, -8.67, 2.0, -7.33, 3.33,
                                                    -6.0,  4.67, -4.67, 6.0, -3.33, 7.33,
                                                    -2.0,  8.67, -0.67, 10.0};
constexpr std::array<double, 16> kHiResVertical = {7.4, -0.9, 6.5, -1.8, 5.5, -2.7, 4.6, -3.7,
                                                   3.7, -4.6, 2.7, -5.5, 1.8, -6.5, 0.9, -7.4};
// VLP-32C: tables of elevation angles and azimuth offsets by laser, degrees.
constexpr std::array<double, 32> kVlp32cElevation = {
    -25.0,  -1.0,   -1.667, -15.639, -11.31, 0.0,    -0.667, -8.843, -7.254, 0.333,  -0.333,
    -6.148, -5.333, 1.333,  0.667,   -4.0,   -4.667, 1.667,  1.0,    -3.667, -3.333, 3.333,
    2.333,  -2.667, -3.0,   7.0,     4.667,  -2.333, -2.0,   15.0,   10.333, -1.333};
constexpr std::array<double, 32> kVlp32cAzimuth = {
    1.4, -4.2, 1.4, -1.4, 1.4, -1.4, 4.2, -1.4, 1.4, -4.2, 1.4, -1.4, 4.2, -1.4, 4.2, -1.4,
    1.4, -4.2, 1.4, -4.2, 4.2, -1.4, 1.4, -1.4, 1.4, -1.4, 1.4, -4.2, 4.2, -1.4, 1.4, -1.4};

// Sine and cosine of every hundredth of a degree, computed in long double, because glibc has one
// version of these functions for all CPUs.
const std::vector<SinCos>& turn_table() {
  static const std::vector<SinCos> table = [] {
    std::vector<SinCos> values(kTurnTicks + 1);
    for (std::size_t i = 0; i < values.size(); ++i) {
      const long double angle =
          static_cast<long double>(i) * std::numbers::pi_v<long double> / (kTurnTicks / 2);
      values[i] = {static_cast<double>(std::sin(angle)), static_cast<double>(std::cos(angle))};
    }
    return values;
  }();
  return table;
}

SinCos sin_cos_deg(double degrees) {
  const long double angle =
      static_cast<long double>(degrees) * std::numbers::pi_v<long double> / 180.0L;
  return {static_cast<double>(std::sin(angle)), static_cast<double>(std::cos(angle))};
}

// Sine and cosine of an azimuth in [0, 36000) hundredths of a degree: the table's entry, rotated by
// the remainder. This is below 0.01 degrees, so that a series of second order is exact to 1e-12.
SinCos sin_cos_centideg(double azimuth) {
  const auto whole = static_cast<std::size_t>(azimuth);
  const SinCos& base = turn_table()[whole];
  const double rest =
      (azimuth - static_cast<double>(whole)) * (std::numbers::pi / (kTurnTicks / 2));
  const double cos = 1.0 - 0.5 * rest * rest;
  return {base.sin * cos + base.cos * rest, base.cos * cos - base.sin * rest};
}

double wrapped(double azimuth) {
  if (azimuth < 0.0) return azimuth + kTurnTicks;
  return azimuth >= kTurnTicks ? azimuth - kTurnTicks : azimuth;
}

std::uint32_t forward(std::uint32_t from, std::uint32_t to) {
  return (to + kTurnTicks - from) % kTurnTicks;
}

std::uint32_t read16(std::span<const std::byte> bytes, std::size_t at) {
  return std::to_integer<std::uint32_t>(bytes[at]) | std::to_integer<std::uint32_t>(bytes[at + 1])
                                                         << 8;
}

std::uint32_t read32(std::span<const std::byte> bytes, std::size_t at) {
  return read16(bytes, at) | read16(bytes, at + 2) << 16;
}

std::ptrdiff_t count_flags(std::span<const std::byte> payload, std::uint32_t flag) {
  std::ptrdiff_t count = 0;
  for (std::size_t b = 0; b < kBlocks; ++b) count += read16(payload, b * kBlockBytes) == flag;
  return count;
}

// Points for which memory is reserved: twice a turn of an HDL-64E with two returns.
constexpr std::size_t kMaxReserved = 500'000;

// Calls `f(column, values per point)` for every column of points.
template <typename F>
void for_each_column(VelodyneFrame& frame, F f) {
  f(frame.points, std::size_t{3});
  f(frame.intensity, std::size_t{1});
  f(frame.ring, std::size_t{1});
  f(frame.laser, std::size_t{1});
  f(frame.return_type, std::size_t{1});
  f(frame.azimuth, std::size_t{1});
  f(frame.range, std::size_t{1});
  f(frame.time, std::size_t{1});
}

// Sets a correction of z alone, split into offsets along the beam and perpendicular to it.
void raise(LaserCalibration& laser, double height) {
  const auto [sin, cos] = sin_cos_deg(laser.elevation_deg);
  laser.range_offset_m = height * sin;
  laser.vertical_offset_m = height * cos;
}

bool finite(const LaserCalibration& c) {
  return std::isfinite(c.elevation_deg + c.azimuth_offset_deg + c.range_offset_m +
                       c.range_offset_x_m + c.range_offset_y_m + c.vertical_offset_m +
                       c.horizontal_offset_m) &&
         std::fabs(c.azimuth_offset_deg) <= 180.0;
}

}  // namespace

bool is_velodyne_data(std::span<const std::byte> payload) {
  return payload.size() == kVelodynePacketBytes &&
         count_flags(payload, kUpperFlag) + count_flags(payload, kLowerFlag) > 0;
}

const char* velodyne_model_name(VelodyneModel model) { return product(model).name; }

std::optional<VelodyneModel> velodyne_model_of_name(const std::string& name) {
  for (const Product& p : kProducts) {
    if (name == p.name) return p.model;
  }
  return std::nullopt;
}

VelodyneCalibration factory_calibration(VelodyneModel model) {
  VelodyneCalibration calibration;
  calibration.range_unit_m = product(model).range_unit_m;
  calibration.lasers.resize(product(model).num_lasers);
  for (std::size_t i = 0; i < calibration.lasers.size(); ++i) {
    LaserCalibration& laser = calibration.lasers[i];
    switch (model) {
      case VelodyneModel::kHdl64e:
        throw InputError(
            "calibration: an HDL-64E needs the file of its own sensor (db.xml or YAML)");
      case VelodyneModel::kHdl32e:
        laser.elevation_deg = kHdl32eElevation[i];
        break;
      case VelodyneModel::kVlp16:
        laser.elevation_deg = kVlp16Elevation[i];
        raise(laser, kVlp16Vertical[i] / 1000.0);
        break;
      case VelodyneModel::kVlp32c:
        laser.elevation_deg = kVlp32cElevation[i];
        laser.azimuth_offset_deg = kVlp32cAzimuth[i];
        break;
      case VelodyneModel::kVlp16HiRes:
        laser.elevation_deg = kHiResElevation[i];
        raise(laser, kHiResVertical[i] / 1000.0);
        break;
    }
  }
  return calibration;
}

struct VelodyneDecoder::Block {
  bool is_good = false;
  bool is_lower = false;      // lasers 32 to 63 of the HDL-64E
  std::uint32_t azimuth = 0;  // 0.01 degrees
  double turn = 0.0;          // rotation until the next column, 0.01 degrees
  double time = 0.0;          // seconds after the beginning of the packet
  ReturnType type = ReturnType::kUnknown;
  std::size_t twin = kBlocks;  // block with the other return of the same firings; kBlocks: none
};

struct VelodyneDecoder::Packet {
  std::array<Block, kBlocks> blocks;
  std::optional<std::int64_t> time_ns;
  double sensor_time = 0.0;  // seconds after the hour
  double span = 0.0;  // seconds until the next packet; 0: unknown, because a block is bad or a gap
};

VelodyneDecoder::VelodyneDecoder(VelodyneOptions options) : options_(std::move(options)) {
  if (!(options_.cut_azimuth_deg >= 0.0 && options_.cut_azimuth_deg < 360.0)) {
    throw InputError("cut_azimuth: expected degrees in [0, 360), got " +
                     number_text(options_.cut_azimuth_deg));
  }
  if (!(options_.min_range_m >= 0.0 && options_.max_range_m > options_.min_range_m)) {
    throw InputError("min_range, max_range: expected 0 <= min_range < max_range, got " +
                     number_text(options_.min_range_m) + " and " +
                     number_text(options_.max_range_m));
  }
  if (!(options_.max_points_per_frame > 0)) {
    throw InputError("max_points_per_frame: expected > 0, got " +
                     std::to_string(options_.max_points_per_frame));
  }
  if (!(options_.calibration.range_unit_m > 0.0 && options_.calibration.range_unit_m < 1.0) ||
      !std::all_of(options_.calibration.lasers.begin(), options_.calibration.lasers.end(),
                   finite)) {
    throw InputError(
        "calibration: expected finite numbers, azimuth offsets within 180 degrees and a range unit "
        "in (0, 1) metres");
  }
  cut_ = static_cast<std::uint32_t>(options_.cut_azimuth_deg * 100.0 + 0.5) % kTurnTicks;
  reset();
}

void VelodyneDecoder::reset() {
  counters_ = {};
  model_.reset();
  last_azimuth_.reset();
  last_payload_.clear();
  is_open_ = false;
  last_span_ = turn_ = 0.0;
  steady_packets_ = 0;
  measured_.fill(-kRemembered);
  covered_ = field_ = 0;
  frame_ = {};
  ended_.clear();
  if (options_.model) set_model(*options_.model);
}

void VelodyneDecoder::set_model(VelodyneModel model) {
  const bool has_own = !options_.calibration.lasers.empty();
  const VelodyneCalibration calibration =
      has_own ? options_.calibration : factory_calibration(model);
  const std::size_t num_lasers = product(model).num_lasers;
  if (calibration.lasers.size() != num_lasers) {
    throw InputError("calibration: expected " + std::to_string(num_lasers) + " lasers for " +
                     product(model).name + ", got " + std::to_string(calibration.lasers.size()));
  }
  range_unit_ = calibration.range_unit_m;
  std::vector<std::size_t> order(num_lasers);
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    const double high = calibration.lasers[a].elevation_deg;
    const double low = calibration.lasers[b].elevation_deg;
    return high > low || (high == low && a < b);
  });
  lasers_.resize(num_lasers);
  for (std::size_t rank = 0; rank < num_lasers; ++rank) {
    const LaserCalibration& c = calibration.lasers[order[rank]];
    const SinCos elevation = sin_cos_deg(c.elevation_deg);
    lasers_[order[rank]] = {elevation.sin,
                            elevation.cos,
                            100.0 * c.azimuth_offset_deg,
                            c.range_offset_m,
                            c.range_offset_x_m,
                            c.range_offset_y_m,
                            c.vertical_offset_m,
                            c.horizontal_offset_m,
                            c.has_two_points,
                            static_cast<std::uint8_t>(rank)};
  }
  column_time_ = product(model).column_time_s;
  delay_.resize(kFirings);
  fraction_.resize(kFirings);
  for (std::size_t i = 0; i < kFirings; ++i) {
    delay_[i] = firing_delay(model, i);
    const bool turns = options_.interpolate_azimuth && column_time_ > 0.0;
    fraction_[i] = turns ? delay_[i] / column_time_ : 0.0;
  }
  model_ = model;
}

// Finds the model that sent a packet; empty: it cannot be decoded, and is counted.
std::optional<VelodyneModel> VelodyneDecoder::identify(std::span<const std::byte> payload) {
  const std::ptrdiff_t num_lower = count_flags(payload, kLowerFlag);
  const auto byte = std::to_integer<std::uint8_t>(payload[kVelodynePacketBytes - 1]);
  if ((count_flags(payload, kThirdFlag) > 0 && count_flags(payload, kFourthFlag) > 0) ||
      (num_lower == 0 && !model_ && byte == kVls128Byte && is_velodyne_data(payload))) {
    if (counters_.packets == 0) {
      throw FormatError(
          "packets of a Velodyne VLS-128 (Alpha Prime), which is not read; HDL-64E, HDL-32E, "
          "VLP-16, Puck Hi-Res and VLP-32C are",
          {});
    }
    ++counters_.other_product;
    return std::nullopt;
  }
  // The last two bytes of an HDL-64E packet cycle through its status and name no product.
  const bool is_hdl64e =
      num_lower >= kFewestLower || (num_lower > 0 && model_ == VelodyneModel::kHdl64e);
  const auto* known = std::find_if(std::begin(kProducts), std::end(kProducts), [&](const auto& p) {
    return is_hdl64e ? p.model == VelodyneModel::kHdl64e : p.byte != 0 && p.byte == byte;
  });
  if (known == std::end(kProducts)) {
    ++counters_.unknown_product;
    return std::nullopt;
  }
  if (model_ && *model_ != known->model) {
    ++counters_.other_product;
    return std::nullopt;
  }
  return known->model;
}

// Reads the blocks' headers and the time. An impossible time is replaced by that at which the
// packet was due.
void VelodyneDecoder::read_packet(std::span<const std::byte> payload, VelodyneModel model,
                                  Packet& packet) {
  const bool is_hdl64e = model == VelodyneModel::kHdl64e;
  for (std::size_t b = 0; b < kBlocks; ++b) {
    Block& block = packet.blocks[b];
    const std::uint32_t flag = read16(payload, b * kBlockBytes);
    block.azimuth = read16(payload, b * kBlockBytes + 2);
    block.is_lower = flag == kLowerFlag;
    const bool good_flag = flag == kUpperFlag || (is_hdl64e && block.is_lower);
    block.is_good = good_flag && block.azimuth < kTurnTicks;
    if (!good_flag) {
      ++counters_.bad_block_flag;
    } else if (!block.is_good) {
      ++counters_.bad_azimuth;
    }
  }
  const std::uint32_t microseconds = read32(payload, kBlocks * kBlockBytes);
  packet.sensor_time = 1e-6 * static_cast<double>(microseconds);
  if (microseconds < kHour) return;
  ++counters_.bad_time;
  if (last_azimuth_) packet.sensor_time = std::fmod(last_time_ + last_span_, kHourSeconds);
}

// Finds which return each block contains, and which block contains the other one. VLP and HDL-32E
// send the last return, then the strongest one; if this is the last one, too, VLP-16 and VLP-32C
// send the second-strongest return in its place, without saying so. The HDL-64E sends upper and
// lower block of one return, then of the other; dual returns are recognised by their equal
// azimuths.
void VelodyneDecoder::read_returns(Packet& packet, std::span<const std::byte> payload) {
  auto& blocks = packet.blocks;
  const auto mode = std::to_integer<std::uint8_t>(payload[kVelodynePacketBytes - 2]);
  const bool is_hdl64e = model_ == VelodyneModel::kHdl64e;
  const bool is_dual = is_hdl64e ? has_equal_azimuths(packet) : mode == kModeDual;
  const std::size_t step = is_hdl64e ? 2 : 1;  // from a block to its twin
  for (std::size_t b = 0; b < kBlocks; ++b) {
    Block& block = blocks[b];
    const bool is_second = is_dual && (b / step) % 2 == 1;
    if (is_dual) {
      block.twin = is_second ? b - step : b + step;
      block.type = is_second == is_hdl64e ? ReturnType::kLast : ReturnType::kStrongest;
    } else if (!is_hdl64e) {
      block.type = mode == kModeStrongest ? ReturnType::kStrongest : ReturnType::kLast;
    }
    const std::size_t column = is_dual ? b / 2 : b;
    block.time = column_time_ * static_cast<double>(column);
  }
  if (column_time_ > 0.0) measure_turns(packet, is_dual ? 2 : 1);
}

// Do each four blocks of a packet of an HDL-64E have one azimuth, as with two returns?
bool VelodyneDecoder::has_equal_azimuths(const Packet& packet) {
  const auto& blocks = packet.blocks;
  for (std::size_t b = 0; b < kBlocks; ++b) {
    if (blocks[b].azimuth != blocks[b - b % 4].azimuth) return false;
  }
  return true;
}

// Measures how far the scanner turns during each block, and how long the packet takes. `next` is
// the distance to the block of the next column. The last valid rotation is used if a block is bad
// or the packet ends.
void VelodyneDecoder::measure_turns(Packet& packet, std::size_t next) {
  auto& blocks = packet.blocks;
  bool is_even = true;
  for (std::size_t b = 0; b < kBlocks; ++b) {
    if (b + next < kBlocks) {
      const bool are_good = blocks[b].is_good && blocks[b + next].is_good;
      const std::uint32_t turn = forward(blocks[b].azimuth, blocks[b + next].azimuth);
      if (are_good && turn <= kLargestTurn) {
        turn_ = turn;
      } else {
        is_even = false;
      }
    }
    blocks[b].turn = turn_;
  }
  const bool has_time = packet.sensor_time < kHourSeconds;
  if (is_even && has_time) packet.span = column_time_ * static_cast<double>(kBlocks / next);
}

// Were there blocks at all azimuths (0.01 degrees) from the first one on, in the last frames?
bool VelodyneDecoder::was_measured(std::uint32_t from, std::uint32_t length) const {
  const std::size_t first = from / 100;
  const std::size_t count = std::min<std::size_t>(length / 100 + 1, measured_.size());
  for (std::size_t i = 0; i < count; ++i) {
    if (counters_.frames - measured_[(first + i) % measured_.size()] >= kRemembered) return false;
  }
  return true;
}

// Seconds from the foremost block's packet to this one; negative: it was sent before that one.
double VelodyneDecoder::elapsed_until(const Packet& packet) const {
  return std::remainder(packet.sensor_time - last_time_, kHourSeconds);
}

// Counts the packets that were lost before this one. One that comes late was not lost; a time
// before the last one alone does not show that, because the clock may have been set.
void VelodyneDecoder::count_lost(const Packet& packet) {
  if (!(last_span_ > 0.0) || packet.sensor_time >= kHourSeconds) return;
  const double elapsed = elapsed_until(packet);
  const auto& first = *std::ranges::find_if(packet.blocks, &Block::is_good);
  if (elapsed < 0.0 && is_behind(forward(*last_azimuth_, first.azimuth), packet) &&
      counters_.lost_packets > 0) {
    --counters_.lost_packets;
  }
  if (!(elapsed > 1.5 * last_span_ && elapsed < kLongestDelay)) return;
  const double swept = turn_ * (elapsed - last_span_) / column_time_;
  if (was_measured(*last_azimuth_, static_cast<std::uint32_t>(swept))) {
    counters_.lost_packets += std::llround(elapsed / last_span_) - 1;
  }
}

void VelodyneDecoder::decode(std::span<const std::byte> payload,
                             std::optional<std::int64_t> time_ns) {
  if (payload.size() == kPositionPacketBytes) {
    ++counters_.position_packets;
    return;
  }
  if (payload.size() != kVelodynePacketBytes) {
    ++counters_.bad_length;
    return;
  }
  const std::optional<VelodyneModel> model = identify(payload);
  if (!model) return;
  const auto mode = std::to_integer<std::uint8_t>(payload[kVelodynePacketBytes - 2]);
  const bool says_mode = model != VelodyneModel::kHdl64e;
  if (says_mode && mode != kModeStrongest && mode != kModeLast && mode != kModeDual) {
    ++counters_.unknown_return_mode;
    return;
  }
  if (std::ranges::equal(payload, last_payload_)) {
    ++counters_.repeated_packets;
    return;
  }
  last_payload_.assign(payload.begin(), payload.end());
  Packet packet;
  packet.time_ns = time_ns;
  read_packet(payload, *model, packet);
  // Another device's payload may end in the bytes of a product; without a good block it must not
  // determine the model.
  if (std::ranges::none_of(packet.blocks, &Block::is_good)) return;
  if (!model_) set_model(*model);
  ++counters_.packets;
  read_returns(packet, payload);
  count_lost(packet);
  if (is_after_step(packet)) break_turn();
  bool is_first = true;
  for (std::size_t b = 0; b < kBlocks; ++b) {
    if (!packet.blocks[b].is_good) continue;
    advance(packet.blocks[b].azimuth, packet, is_first);
    is_first = false;
    decode_block(packet, b, payload);
  }
}

// Did the sensor pause before this packet, or was its clock set? Counts the packets without that.
bool VelodyneDecoder::is_after_step(const Packet& packet) {
  if (!last_azimuth_) return false;
  const bool is_step = std::fabs(elapsed_until(packet)) > kLongestDelay;
  const std::int64_t steady = std::exchange(steady_packets_, is_step ? 0 : steady_packets_ + 1);
  return is_step && (model_ != VelodyneModel::kHdl64e || steady >= kSteadyPackets);
}

// Ends the frame in progress where it is: blocks before and after a step of the time are no turn.
void VelodyneDecoder::break_turn() {
  if (is_open_) end_frame(false);
  last_azimuth_.reset();
}

// Does a step of the azimuth (0.01 degrees, forward) lead to a block that was fired before the last
// one, because packets arrived out of order? A scanner with a limited field of view makes long
// steps forward, too.
bool VelodyneDecoder::is_behind(std::uint32_t step, const Packet& packet) const {
  if (step < kTurnTicks / 2) return false;
  const double elapsed = elapsed_until(packet);
  if (elapsed < 0.0 && elapsed > -kLongestDelay) return true;
  return kTurnTicks - step <= kLargestReturn && elapsed < kShortestHalfTurn;
}

// Ends the frame if the azimuth passes the cut. A block that is behind the last one does not end
// it, and is not where the next step begins: otherwise that step could pass the cut again.
void VelodyneDecoder::advance(std::uint32_t azimuth, const Packet& packet, bool is_first) {
  bool at_cut = false, is_late = false;
  if (last_azimuth_) {
    const std::uint32_t step = forward(*last_azimuth_, azimuth);
    is_late = is_behind(step, packet);
    if (is_late) {
      ++counters_.backward_azimuth;
    } else {
      at_cut = forward(cut_, azimuth) < forward(cut_, *last_azimuth_);
      if (step <= kLargestTurn) covered_ += step;
    }
  }
  if (!is_late) {
    last_azimuth_ = azimuth;
    last_time_ = packet.sensor_time;
    last_span_ = packet.span;
    measured_[azimuth / 100] = counters_.frames;
  }
  const bool is_overlong = frame_.num_points() >= options_.max_points_per_frame;
  if (is_open_ && is_overlong) ++counters_.overlong_frames;
  if (is_open_ && (at_cut || is_overlong)) end_frame(at_cut);
  if (is_open_) {
    frame_.packets += is_first ? 1 : 0;
  } else {
    begin_frame(packet, at_cut);
  }
}

void VelodyneDecoder::begin_frame(const Packet& packet, bool at_cut) {
  frame_ = {};
  frame_.model = *model_;
  frame_.packets = 1;
  frame_.time_ns = packet.time_ns;
  frame_.sensor_time = packet.sensor_time;
  frame_time_ = packet.sensor_time;
  for_each_column(
      frame_, [this](auto& column, std::size_t width) { column.reserve(width * capacity_hint_); });
  is_open_ = true;
  began_at_cut_ = at_cut;
}

void VelodyneDecoder::end_frame(bool at_cut) {
  frame_.is_complete = began_at_cut_ && at_cut && 2 * covered_ >= field_;
  // It shrinks by a tenth per frame, for a field of view that is changed while the sensor runs.
  field_ = std::max(covered_, field_ - field_ / 10);
  covered_ = 0;
  // Frames have similar sizes; a much smaller frame returns the memory that was reserved for it.
  const std::size_t size = frame_.num_points();
  if (size < capacity_hint_ / 2) {
    for_each_column(frame_, [](auto& column, std::size_t) { column.shrink_to_fit(); });
  }
  capacity_hint_ = std::min(size + size / 16, kMaxReserved);
  ++counters_.frames;
  ended_.push_back(std::move(frame_));
  frame_ = {};
  is_open_ = false;
}

void VelodyneDecoder::decode_block(const Packet& packet, std::size_t index,
                                   std::span<const std::byte> payload) {
  const Block& block = packet.blocks[index];
  const bool has_twin = block.twin < kBlocks && packet.blocks[block.twin].is_good &&
                        packet.blocks[block.twin].is_lower == block.is_lower;
  const std::size_t base = index * kBlockBytes + 4;
  const std::size_t twin_base = has_twin ? block.twin * kBlockBytes + 4 : base;
  // An hour may begin within the frame, and its first packet may come before the last of the old
  // one.
  const double packet_time = std::remainder(packet.sensor_time - frame_time_, kHourSeconds);
  for (std::size_t i = 0; i < kFirings; ++i) {
    const std::size_t at = base + 3 * i;
    const std::uint32_t raw_range = read16(payload, at);
    if (raw_range == 0) {
      ++counters_.no_return;
      continue;
    }
    ReturnType type = block.type;
    const auto reflectivity = std::to_integer<std::uint8_t>(payload[at + 2]);
    if (has_twin) {
      const std::size_t other = twin_base + 3 * i;
      const bool equal =
          read16(payload, other) == raw_range && payload[other + 2] == payload[at + 2];
      if (equal && block.twin < index) {
        ++counters_.duplicates;
        continue;
      }
      if (equal) type = ReturnType::kBoth;
    }
    std::size_t number = block.is_lower ? kFirings + i : i;
    if (number >= lasers_.size()) number -= lasers_.size();  // second round of the VLP-16
    const double turned = static_cast<double>(block.azimuth) + block.turn * fraction_[i];
    add_point(lasers_[number], static_cast<std::uint8_t>(number), turned, raw_range, reflectivity,
              type, packet_time + block.time + delay_[i]);
  }
}

// Computes and adds a point (HDL-64E S2 manual, appendix on the conversion of raw data): range
// offsets that are known at two distances are interpolated along x and along y; the laser's offsets
// are perpendicular to its beam.
void VelodyneDecoder::add_point(const Laser& laser, std::uint8_t number, double azimuth,
                                std::uint32_t raw_range, std::uint8_t reflectivity, ReturnType type,
                                double time) {
  const double range = range_unit_ * static_cast<double>(raw_range);
  if (!(range >= options_.min_range_m && range <= options_.max_range_m)) {
    ++counters_.out_of_range;
    return;
  }
  const double pointed = wrapped(azimuth + laser.azimuth_offset);
  const auto [sin, cos] = sin_cos_centideg(pointed);
  const double corrected = range + laser.range_offset;
  const double lift = laser.vertical_offset * laser.sin_elevation;
  double range_x = corrected;  // x to the right, y forward, as in the manual
  double range_y = corrected;
  if (laser.has_two_points) {
    const double flat = corrected * laser.cos_elevation - lift;
    const double x = std::fabs(flat * sin - laser.horizontal_offset * cos);
    const double y = std::fabs(flat * cos + laser.horizontal_offset * sin);
    range_x = range + (laser.range_offset - laser.range_offset_x) * (x - 2.4) / (25.04 - 2.4) +
              laser.range_offset_x;
    range_y = range + (laser.range_offset - laser.range_offset_y) * (y - 1.93) / (25.04 - 1.93) +
              laser.range_offset_y;
  }
  const double right = (range_x * laser.cos_elevation - lift) * sin - laser.horizontal_offset * cos;
  const double ahead = (range_y * laser.cos_elevation - lift) * cos + laser.horizontal_offset * sin;
  const double up = range_y * laser.sin_elevation + laser.vertical_offset * laser.cos_elevation;
  const float xyz[3] = {static_cast<float>(ahead), static_cast<float>(-right),
                        static_cast<float>(up)};
  frame_.points.insert(frame_.points.end(), std::begin(xyz), std::end(xyz));
  frame_.intensity.push_back(static_cast<float>(reflectivity));
  frame_.ring.push_back(laser.ring);
  frame_.laser.push_back(number);
  frame_.return_type.push_back(static_cast<std::uint8_t>(type));
  const auto degrees = static_cast<float>(0.01 * pointed);
  frame_.azimuth.push_back(degrees < 360.0F ? degrees : 0.0F);
  frame_.range.push_back(static_cast<float>(range));
  frame_.time.push_back(static_cast<float>(time));
  ++counters_.points;
}

bool VelodyneDecoder::take(VelodyneFrame& frame) {
  if (ended_.empty()) return false;
  frame = std::move(ended_.front());
  ended_.pop_front();
  return true;
}

void VelodyneDecoder::flush() {
  if (is_open_) end_frame(false);
}

}  // namespace manip3d
