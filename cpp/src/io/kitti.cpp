#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "geometry/median.hpp"
#include "io/point_formats.hpp"
#include "manip3d/error.hpp"
#include "parse/input_buffer.hpp"

namespace manip3d {
namespace {

constexpr std::size_t kBlockBytes = std::size_t{1} << 18;

constexpr std::size_t kKittiColumns = 4;
constexpr std::size_t kNuScenesColumns = 5;

// The first `columns` of x, y, z, intensity, column_5, column_6, ...
std::vector<PointField> kitti_fields(std::size_t columns = kKittiColumns) {
  constexpr std::array<const char*, kKittiColumns> kNames = {"x", "y", "z", "intensity"};
  std::vector<PointField> fields;
  for (std::size_t i = 0; i < columns; ++i) {
    fields.push_back({i < kNames.size() ? kNames.at(i) : "column_" + std::to_string(i + 1)});
  }
  return fields;
}

std::vector<PointField> nuscenes_fields() { return {{"x"}, {"y"}, {"z"}, {"intensity"}, {"ring"}}; }

// The number of columns is estimated from this many windows of floats, spread over the file.
constexpr std::size_t kWindows = 8;
constexpr std::size_t kWindow = 2048;

// The median absolute difference between floats that are `apart` floats apart.
double median_difference(std::string_view floats, std::size_t apart) {
  const std::size_t count = floats.size() / sizeof(float);
  std::vector<double> differences;
  differences.reserve(kWindows * kWindow);
  for (std::size_t window = 0; window < kWindows; ++window) {
    const std::size_t first = window * (count - kWindow) / (kWindows - 1);
    std::array<float, kWindow> values{};
    std::memcpy(values.data(), floats.data() + first * sizeof(float), sizeof(values));
    for (std::size_t i = apart; i < kWindow; ++i) {
      const double difference = std::abs(double{values.at(i)} - double{values.at(i - apart)});
      if (std::isnan(difference)) continue;  // rows without coordinates tell nothing
      differences.push_back(std::isfinite(difference) ? difference
                                                      : std::numeric_limits<double>::max());
    }
  }
  if (differences.empty()) return std::numeric_limits<double>::max();
  return median(std::span(differences));
}

// Estimates the number of floats per row from their values: those of one column differ less from
// each other than those of different columns. Scans of several scanners were written with 3 to 7
// columns, in order or shuffled: the ratio of the median of the true columns to that of a wrong
// expected number was 0.9 at most, and the ratio of other numbers to a true expected one was 1.1 at
// least. Between columns of noise it is 1 to within 2 %. Columns of a row can resemble others of
// the next row by chance, but hardly those of the row after it too; therefore differences over two
// rows are also used.
std::size_t columns_by_content(std::string_view floats, std::size_t expected) {
  constexpr double kClearlyLess = 0.95;
  constexpr double kLess = 0.8;  // so that a multiple of the true number is not chosen
  if (floats.size() < 2 * kWindow * sizeof(float)) return expected;
  const double as_expected =
      std::min(median_difference(floats, expected), median_difference(floats, 2 * expected));
  double least = std::numeric_limits<double>::max();
  std::size_t best = expected;
  for (std::size_t columns = 3; columns <= 7; ++columns) {
    const double found = columns == expected ? as_expected
                                             : std::max(median_difference(floats, columns),
                                                        median_difference(floats, 2 * columns));
    if (found >= (columns % best == 0 ? kLess : 1.0) * least) continue;
    least = found;
    best = columns;
  }
  return least < kClearlyLess * as_expected ? best : expected;
}

// Counts rows with a value that is not finite. These are damage, or the file has other columns,
// except for rows without a return: programs write NaN as all three of their coordinates.
class FiniteRows {
 public:
  // @param may_lack_returns  Whether rows without a return are accepted.
  FiniteRows(const std::vector<PointField>& fields, bool may_lack_returns)
      : fields_(fields), may_lack_returns_(may_lack_returns) {}

  // @param block  Complete rows, the first of which begins at byte `offset` of the file.
  void check(std::string_view block, std::int64_t offset) {
    const std::size_t row = fields_.size() * sizeof(float);
    for (std::size_t start = 0; start < block.size(); start += row, ++rows_) {
      if (may_lack_returns_ && has_no_return(block.data() + start)) continue;
      for (std::size_t at = 0; at < fields_.size(); ++at) {
        float value = 0.0F;
        std::memcpy(&value, block.data() + start + at * sizeof(value), sizeof(value));
        if (std::isfinite(value)) continue;
        if (bad_rows_++ == 0) {
          first_byte_ = offset + static_cast<std::int64_t>(start + at * sizeof(value));
          first_ = fields_[at].name + " of row " + std::to_string(rows_) +
                   ": expected a finite number, got " + number_text(value);
        }
        break;
      }
    }
  }

  // @throws FormatError  a row was not finite.
  void finish() const {
    if (bad_rows_ == 0) return;
    throw FormatError::at_byte(
        first_byte_, first_ + "; " + std::to_string(bad_rows_) + " of " + std::to_string(rows_) +
                         " points have such a number. Write the file without them");
  }

 private:
  static bool has_no_return(const char* row) {
    std::array<float, 3> place{};
    std::memcpy(place.data(), row, sizeof(place));
    return std::ranges::all_of(place, [](float value) { return std::isnan(value); });
  }

  const std::vector<PointField>& fields_;
  bool may_lack_returns_;
  std::int64_t rows_ = 0;
  std::int64_t bad_rows_ = 0;
  std::int64_t first_byte_ = 0;
  std::string first_;
};

std::vector<char> all_bytes(InputBuffer& input) {
  std::vector<char> bytes;
  if (const auto size = input.remaining()) bytes.reserve(*size);
  while (!input.at_end()) {
    const std::size_t size = input.peek(kBlockBytes).size();
    const std::string_view block(input.bytes(size, "points"), size);
    bytes.insert(bytes.end(), block.begin(), block.end());
  }
  return bytes;
}

// A table of rows of floats without a header. They are finite except in rows without a return.
PointTable table_of(std::vector<char> bytes, PointFormat format, std::vector<PointField> fields) {
  const std::size_t row = row_bytes(fields);
  PointTable table;
  table.format = format;
  table.fields = std::move(fields);
  table.rows = std::move(bytes);
  const std::size_t whole = table.rows.size() - table.rows.size() % row;
  FiniteRows finite(table.fields, true);
  finite.check({table.rows.data(), whole}, 0);
  if (whole != table.rows.size()) {
    throw FormatError::at_byte(
        static_cast<std::int64_t>(table.rows.size()),
        "file ends within a point: expected a multiple of " + std::to_string(row) + " bytes");
  }
  finite.finish();
  table.num_points = static_cast<std::int64_t>(whole / row);
  return table;
}

void write_rows(Output& output, const PointTableView& table,
                const std::vector<PointField>& expected, const char* message) {
  bool fits = table.fields.size() == expected.size();
  for (std::size_t i = 0; fits && i < table.fields.size(); ++i) {
    const PointField& wanted = expected[i];
    const PointField& field = table.fields[i];
    fits = field.name == wanted.name && field.type == wanted.type && field.count == wanted.count;
  }
  if (!fits) throw InputError(message);
  FiniteRows finite(expected, false);
  finite.check({table.rows.data(), table.rows.size()}, 0);
  finite.finish();
  output.text({table.rows.data(), table.rows.size()});
}

}  // namespace

PointTable read_kitti(ByteSource& source, const Progress& progress) {
  InputBuffer input(source, progress);
  std::vector<char> bytes = all_bytes(input);
  const std::size_t columns = columns_by_content({bytes.data(), bytes.size()}, kKittiColumns);
  return table_of(std::move(bytes), PointFormat::kKitti, kitti_fields(columns));
}

void write_kitti(Output& output, const PointTableView& table) {
  const std::size_t columns = table.fields.size() < 3 ? kKittiColumns : table.fields.size();
  const std::string_view rows(table.rows.data(), table.rows.size());
  if (columns != kKittiColumns && columns_by_content(rows, kKittiColumns) != columns) {
    throw InputError("fields: the values do not tell a reader of .bin that each point has " +
                     std::to_string(columns) +
                     " floats instead of 4. Write x, y, z, intensity only, or a .ply or .pcd");
  }
  write_rows(output, table, kitti_fields(columns),
             "fields: KITTI's .bin holds float x, y, z, intensity, column_5, ... and no others");
}

PointTable read_nuscenes(ByteSource& source, const Progress& progress) {
  InputBuffer input(source, progress);
  std::vector<char> bytes = all_bytes(input);
  const std::size_t columns = columns_by_content({bytes.data(), bytes.size()}, kNuScenesColumns);
  if (columns != kNuScenesColumns) {
    throw FormatError("rows look like " + std::to_string(columns) +
                          " floats each; a .pcd.bin has 5 (x, y, z, intensity, ring). A .bin may "
                          "have another number: rename the file",
                      {});
  }
  return table_of(std::move(bytes), PointFormat::kNuScenes, nuscenes_fields());
}

void write_nuscenes(Output& output, const PointTableView& table) {
  write_rows(output, table, nuscenes_fields(),
             "fields: nuScenes' .pcd.bin holds float x, y, z, intensity, ring and no others");
}

}  // namespace manip3d
