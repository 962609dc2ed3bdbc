#include <cmath>
#include <cstring>

#include "io/point_formats.hpp"
#include "parse/input_buffer.hpp"

namespace manip3d {
namespace {

constexpr std::size_t kBlockRows = std::size_t{1} << 14;

std::vector<PointField> kitti_fields() { return {{"x"}, {"y"}, {"z"}, {"intensity"}}; }

std::vector<PointField> nuscenes_fields() { return {{"x"}, {"y"}, {"z"}, {"intensity"}, {"ring"}}; }

void check_finite(std::string_view block, std::int64_t offset) {
  for (std::size_t at = 0; at < block.size(); at += sizeof(float)) {
    float value = 0.0F;
    std::memcpy(&value, block.data() + at, sizeof(value));
    if (std::isfinite(value)) continue;
    throw FormatError::at_byte(offset + static_cast<std::int64_t>(at),
                               "expected a finite number, got " + std::to_string(value));
  }
}

// Rows of finite floats, without a header.
PointTable read_rows(ByteSource& source, PointFormat format, std::vector<PointField> fields,
                     const Progress& progress) {
  const auto row = static_cast<std::size_t>(row_bytes(fields));
  InputBuffer input(source, progress);
  PointTable table;
  table.format = format;
  table.fields = std::move(fields);
  if (const auto size = input.remaining()) table.rows.reserve(*size);
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
    check_finite(block, offset);
    table.rows.insert(table.rows.end(), block.begin(), block.end());
  }
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
  check_finite({table.rows.data(), table.rows.size()}, 0);
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
