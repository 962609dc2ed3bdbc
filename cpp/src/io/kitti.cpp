#include <cmath>
#include <cstring>

#include "io/point_formats.hpp"
#include "parse/input_buffer.hpp"

namespace manip3d {
namespace {

constexpr std::size_t kRowBytes = 4 * sizeof(float);
constexpr std::size_t kBlockRows = std::size_t{1} << 14;

const std::vector<PointField>& kitti_fields() {
  static const std::vector<PointField> fields{{"x"}, {"y"}, {"z"}, {"intensity"}};
  return fields;
}

void check_finite(std::string_view block, std::int64_t offset) {
  for (std::size_t at = 0; at < block.size(); at += sizeof(float)) {
    float value = 0.0F;
    std::memcpy(&value, block.data() + at, sizeof(value));
    if (std::isfinite(value)) continue;
    throw FormatError::at_byte(offset + static_cast<std::int64_t>(at),
                               "expected a finite number, got " + std::to_string(value));
  }
}

}  // namespace

PointTable read_kitti(ByteSource& source, const Progress& progress) {
  InputBuffer input(source, progress);
  PointTable table;
  table.format = PointFormat::kKitti;
  table.fields = kitti_fields();
  if (const auto size = input.remaining()) table.rows.reserve(*size);
  while (!input.at_end()) {
    const std::size_t available = input.peek(kBlockRows * kRowBytes).size();
    if (available < kRowBytes) {
      throw FormatError::at_byte(input.offset() + static_cast<std::int64_t>(available),
                                 "file ends within a point: expected a multiple of 16 bytes");
    }
    const std::size_t size = available - available % kRowBytes;
    const std::int64_t offset = input.offset();
    const std::string_view block(input.bytes(size, "a point"), size);
    check_finite(block, offset);
    table.rows.insert(table.rows.end(), block.begin(), block.end());
  }
  table.num_points = static_cast<std::int64_t>(table.rows.size() / kRowBytes);
  return table;
}

void write_kitti(Output& output, const PointTableView& table) {
  bool fits = table.fields.size() == kitti_fields().size();
  for (std::size_t i = 0; fits && i < table.fields.size(); ++i) {
    const PointField& wanted = kitti_fields()[i];
    const PointField& field = table.fields[i];
    fits = field.name == wanted.name && field.type == wanted.type && field.count == wanted.count;
  }
  if (!fits) throw InputError("fields: KITTI's .bin holds float x, y, z, intensity and no others");
  check_finite({table.rows.data(), table.rows.size()}, 0);
  output.text({table.rows.data(), table.rows.size()});
}

}  // namespace manip3d
