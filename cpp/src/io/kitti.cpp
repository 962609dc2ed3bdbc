#include <cmath>
#include <cstring>
#include <string>
#include <string_view>
#include <vector>

#include "io/point_formats.hpp"
#include "parse/input_buffer.hpp"

namespace manip3d {
namespace {

constexpr std::size_t kBlockRows = std::size_t{1} << 14;

std::vector<PointField> kitti_fields() { return {{"x"}, {"y"}, {"z"}, {"intensity"}}; }

std::vector<PointField> nuscenes_fields() { return {{"x"}, {"y"}, {"z"}, {"intensity"}, {"ring"}}; }

// Counts rows with a value that is no finite number: damage, since the format has no word for a
// point that was not measured.
class FiniteRows {
 public:
  explicit FiniteRows(const std::vector<PointField>& fields) : fields_(fields) {}

  // @param block  whole rows, the first of which begins at this byte of the file.
  void check(std::string_view block, std::int64_t offset) {
    const std::size_t row = fields_.size() * sizeof(float);
    for (std::size_t start = 0; start < block.size(); start += row, ++rows_) {
      for (std::size_t at = 0; at < fields_.size(); ++at) {
        float value = 0.0F;
        std::memcpy(&value, block.data() + start + at * sizeof(value), sizeof(value));
        if (std::isfinite(value)) continue;
        if (bad_rows_++ == 0) {
          first_byte_ = offset + static_cast<std::int64_t>(start + at * sizeof(value));
          first_ = fields_[at].name + " of row " + std::to_string(rows_) +
                   ": expected a finite number, got " + std::to_string(value);
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
  const std::vector<PointField>& fields_;
  std::int64_t rows_ = 0;
  std::int64_t bad_rows_ = 0;
  std::int64_t first_byte_ = 0;
  std::string first_;
};

// Rows of finite floats, without a header.
PointTable read_rows(ByteSource& source, PointFormat format, std::vector<PointField> fields,
                     const Progress& progress) {
  const auto row = static_cast<std::size_t>(row_bytes(fields));
  InputBuffer input(source, progress);
  PointTable table;
  table.format = format;
  table.fields = std::move(fields);
  if (const auto size = input.remaining()) table.rows.reserve(*size);
  FiniteRows finite(table.fields);
  while (!input.at_end()) {
    const std::size_t available = input.peek(kBlockRows * row).size();
    if (available < row) {
      throw FormatError::at_byte(
          input.offset() + static_cast<std::int64_t>(available),
          "file ends within a point: expected a multiple of " + std::to_string(row) + " bytes");
    }
    const std::size_t size = available - available % row;
    const std::int64_t offset = input.offset();
    const std::string_view block(input.bytes(size, "a point"), size);
    finite.check(block, offset);
    table.rows.insert(table.rows.end(), block.begin(), block.end());
  }
  finite.finish();
  table.num_points = static_cast<std::int64_t>(table.rows.size() / row);
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
  FiniteRows finite(expected);
  finite.check({table.rows.data(), table.rows.size()}, 0);
  finite.finish();
  output.text({table.rows.data(), table.rows.size()});
}

}  // namespace

PointTable read_kitti(ByteSource& source, const Progress& progress) {
  return read_rows(source, PointFormat::kKitti, kitti_fields(), progress);
}

void write_kitti(Output& output, const PointTableView& table) {
  write_rows(output, table, kitti_fields(),
             "fields: KITTI's .bin holds float x, y, z, intensity and no others");
}

PointTable read_nuscenes(ByteSource& source, const Progress& progress) {
  return read_rows(source, PointFormat::kNuScenes, nuscenes_fields(), progress);
}

void write_nuscenes(Output& output, const PointTableView& table) {
  write_rows(output, table, nuscenes_fields(),
             "fields: nuScenes' .pcd.bin holds float x, y, z, intensity, ring and no others");
}

}  // namespace manip3d
