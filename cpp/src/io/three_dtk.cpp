#include <string>

#include "io/point_formats.hpp"
#include "io/point_values.hpp"
#include "parse/input_buffer.hpp"
#include "parse/line_cursor.hpp"

namespace manip3d {

// Reads a point per line: x, y, z, and further columns if the first point has them (reflectance,
// ...).
PointTable read_3dtk(ByteSource& source, const Progress& progress) {
  constexpr std::size_t kMaxColumns = 64;
  InputBuffer input(source, progress);
  PointTable table;
  std::string_view line;
  while (input.next_line(line)) {
    LineCursor cursor(line, input.line());
    if (cursor.at_end()) continue;
    std::size_t columns = 0;
    for (; !cursor.at_end(); ++columns) {
      if (columns == kMaxColumns) input.fail_at_line("more than 64 numbers");
      const double value = cursor.number("a coordinate");
      const auto* raw = reinterpret_cast<const char*>(&value);
      table.rows.insert(table.rows.end(), raw, raw + sizeof(value));
    }
    if (table.fields.empty()) {
      table.fields = {
          {"x", FieldType::kDouble}, {"y", FieldType::kDouble}, {"z", FieldType::kDouble}};
      for (std::size_t i = 3; i < columns; ++i) {
        table.fields.push_back({std::string("c").append(std::to_string(i)), FieldType::kDouble});
      }
    }
    if (columns < 3 || columns != table.fields.size()) {
      input.fail_at_line("expected " + std::to_string(table.fields.size()) + " numbers, got " +
                         std::to_string(columns));
    }
    ++table.num_points;
    if (table.num_points % 4096 == 0) input.check_expansion(table.rows.size());
  }
  if (table.fields.empty()) {
    table.fields = {
        {"x", FieldType::kDouble}, {"y", FieldType::kDouble}, {"z", FieldType::kDouble}};
  }
  return table;
}

void write_3dtk(Output& output, const PointTableView& table) {
  for (const PointField& field : table.fields) {
    if (field.type != FieldType::kDouble || field.count != 1) {
      throw InputError("fields: 3DTK's .3d holds doubles, got '" + field.name + "'");
    }
  }
  const std::int64_t row_size = row_bytes(table.fields);
  for (std::int64_t i = 0; i < table.num_points; ++i) {
    write_text(output, table.fields, table.rows.data() + i * row_size);
  }
}

}  // namespace manip3d
