#include <string>
#include <utility>

#include "io/ply_header.hpp"
#include "io/point_formats.hpp"
#include "io/point_values.hpp"
#include "parse/input_buffer.hpp"

namespace manip3d {
namespace {

struct TypeOf {
  ply::Type type;
  FieldType field;
  const char* name;
};
constexpr TypeOf kTypes[] = {
    {ply::Type::kInt8, FieldType::kInt8, "char"},
    {ply::Type::kUint8, FieldType::kUint8, "uchar"},
    {ply::Type::kInt16, FieldType::kInt16, "short"},
    {ply::Type::kUint16, FieldType::kUint16, "ushort"},
    {ply::Type::kInt32, FieldType::kInt32, "int"},
    {ply::Type::kUint32, FieldType::kUint32, "uint"},
    {ply::Type::kFloat, FieldType::kFloat, "float"},
    {ply::Type::kDouble, FieldType::kDouble, "double"},
};
constexpr const char* kEncodings[] = {"ascii", "binary_little_endian", "binary_big_endian"};

const ply::Element& points_of(const ply::Header& header) {
  if (header.elements.empty() || header.elements[0].name != "vertex") {
    throw FormatError("expected points: an element vertex that comes first", {});
  }
  const ply::Element& vertex = header.elements[0];
  for (const ply::Property& p : vertex.properties) {
    if (p.is_list) {
      throw FormatError::at_line(vertex.line,
                                 "element vertex: a point has no lists ('" + p.name + "')");
    }
  }
  if (vertex.properties.empty()) throw FormatError::at_line(vertex.line, "no properties");
  return vertex;
}

}  // namespace

PointTable read_ply_points(ByteSource& source, const Progress& progress) {
  InputBuffer input(source, progress);
  const ply::Header header = ply::read_header(input);
  const ply::Element& vertex = points_of(header);
  PointTable table;
  table.num_points = vertex.count;
  for (const ply::Property& p : vertex.properties) {
    table.fields.push_back({p.name, kTypes[static_cast<int>(p.type)].field, 1});
  }
  table.header.emplace_back("format", kEncodings[static_cast<int>(header.encoding)]);
  for (const std::string& remark : header.remarks) table.header.emplace_back("remark", remark);
  for (std::size_t i = 1; i < header.elements.size(); ++i) {
    table.header.emplace_back("skipped", header.elements[i].name);
  }
  const std::int64_t row_size = row_bytes(table.fields);
  const std::int64_t sure = input.checked_claim(
      table.num_points, vertex.least_bytes(header.encoding), "points", {vertex.line, std::nullopt});
  if (header.encoding == ply::Encoding::kAscii) {
    read_text_rows(input, table, "properties");
    return table;
  }
  table.rows.reserve(sure * row_size);
  read_rows(input, table.num_points, row_size, table.rows);
  if (header.encoding == ply::Encoding::kBigEndian) swap_rows(table.fields, table.rows);
  return table;
}

void write_ply_points(Output& output, const PointTableView& table) {
  std::string format = header_value(table.header, "format");
  if (format.empty()) format = kEncodings[1];
  output.text("ply\nformat " + format + " 1.0\n");
  for (const auto& [key, value] : table.header) {
    if (key == "remark") output.text(value + "\n");
  }
  output.text("element vertex " + std::to_string(table.num_points) + "\n");
  for (const PointField& field : table.fields) {
    const char* type = nullptr;
    for (const TypeOf& t : kTypes) {
      if (t.field == field.type) type = t.name;
    }
    const bool fits = type != nullptr && field.count == 1 && !field.name.empty() &&
                      field.name.find_first_of(" \t\r\n") == std::string::npos;
    if (!fits) throw InputError("fields: PLY cannot hold '" + field.name + "'");
    output.text("property " + std::string(type) + " " + field.name + "\n");
  }
  output.text("end_header\n");
  const std::int64_t row_size = row_bytes(table.fields);
  if (format == kEncodings[0]) {
    for (std::int64_t i = 0; i < table.num_points; ++i) {
      write_text(output, table.fields, table.rows.data() + i * row_size);
    }
  } else if (format == kEncodings[2]) {
    std::vector<char> swapped(table.rows.begin(), table.rows.end());
    swap_rows(table.fields, swapped);
    output.text({swapped.data(), swapped.size()});
  } else {
    output.text({table.rows.data(), table.rows.size()});
  }
}

}  // namespace manip3d
