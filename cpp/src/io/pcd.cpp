#include <algorithm>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include "io/lzf.hpp"
#include "io/point_formats.hpp"
#include "io/point_values.hpp"
#include "parse/input_buffer.hpp"
#include "parse/line_cursor.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kMaxFields = 1024;
constexpr std::int64_t kLongestRow = 1 << 20;

struct PcdHeader {
  std::vector<std::string> names;
  std::vector<std::int64_t> sizes, counts;
  std::vector<char> types;
  std::int64_t width = -1, height = -1, points = -1;
  std::string version, viewpoint = "0 0 0 1 0 0 0", data;
};

class HeaderReader {
 public:
  explicit HeaderReader(InputBuffer& input) : input_(input) {}

  PcdHeader read() {
    std::string_view line;
    while (header_.data.empty()) {
      if (!input_.next_line(line)) {
        throw FormatError::at_line(input_.line() + 1, "file ends within the header");
      }
      LineCursor cursor(line, input_.line());
      if (!cursor.at_end()) entry(cursor);
    }
    check();
    return std::move(header_);
  }

 private:
  void entry(LineCursor& cursor) {
    const std::string_view key = cursor.word();
    if (key == "VERSION") {
      header_.version = cursor.rest();
    } else if (key == "FIELDS" || key == "COLUMNS") {
      each_word(cursor, [&](LineCursor& c) { header_.names.emplace_back(c.word()); });
    } else if (key == "SIZE") {
      each_word(cursor, [&](LineCursor& c) { header_.sizes.push_back(c.integer("SIZE")); });
    } else if (key == "TYPE") {
      each_word(cursor, [&](LineCursor& c) {
        const std::string_view word = c.word();
        header_.types.push_back(word.size() == 1 ? word[0] : '?');
      });
    } else if (key == "COUNT") {
      each_word(cursor, [&](LineCursor& c) { header_.counts.push_back(c.integer("COUNT")); });
    } else if (key == "WIDTH") {
      header_.width = number_of(cursor, "WIDTH");
    } else if (key == "HEIGHT") {
      header_.height = number_of(cursor, "HEIGHT");
    } else if (key == "VIEWPOINT") {
      viewpoint(cursor);
    } else if (key == "POINTS") {
      header_.points = number_of(cursor, "POINTS");
    } else if (key == "DATA") {
      header_.data = cursor.rest();
    } else {
      input_.fail_at_line("unknown entry '" + std::string(key.substr(0, 40)) + "'");
    }
  }

  std::int64_t number_of(LineCursor& cursor, const char* name) {
    const std::int64_t number = cursor.integer(name);
    if (number < 0) {
      input_.fail_at_line(std::string(name) + ": expected at least 0, got " +
                          std::to_string(number));
    }
    return number;
  }

  template <typename F>
  void each_word(LineCursor& cursor, F f) {
    for (std::int64_t i = 0; !cursor.at_end(); ++i) {
      if (i == kMaxFields) input_.fail_at_line("more than 1024 fields");
      f(cursor);
    }
  }

  void viewpoint(LineCursor& cursor) {
    LineCursor numbers = cursor;
    for (int i = 0; i < 7; ++i) numbers.number("VIEWPOINT");
    header_.viewpoint = cursor.rest();
  }

  void check() {
    const std::size_t n = header_.names.size();
    if (header_.counts.empty()) header_.counts.assign(n, 1);
    if (n == 0 || header_.sizes.size() != n || header_.types.size() != n ||
        header_.counts.size() != n) {
      input_.fail_at_line("expected as many SIZE, TYPE and COUNT as FIELDS, and at least one");
    }
    if (header_.data != "ascii" && header_.data != "binary" &&
        header_.data != "binary_compressed") {
      input_.fail_at_line("DATA: expected ascii, binary or binary_compressed");
    }
    constexpr std::int64_t kMost = std::numeric_limits<std::int32_t>::max();
    if (header_.height < 0) header_.height = 1;
    if (header_.width < 0) header_.width = std::max<std::int64_t>(0, header_.points);
    const bool fits = header_.width <= kMost && header_.height <= kMost &&
                      header_.width * header_.height <= kMost;
    if (!fits) input_.fail_at_line("more than 2147483647 points");
    if (header_.points < 0) header_.points = header_.width * header_.height;
    if (header_.points != header_.width * header_.height) {
      input_.fail_at_line(
          "POINTS: expected WIDTH x HEIGHT = " + std::to_string(header_.width * header_.height) +
          ", got " + std::to_string(header_.points));
    }
  }

  InputBuffer& input_;
  PcdHeader header_;
};

FieldType type_of(const InputBuffer& input, char type, std::int64_t size) {
  if (type == 'F' && size == 4) return FieldType::kFloat;
  if (type == 'F' && size == 8) return FieldType::kDouble;
  const bool is_signed = type == 'I';
  if (is_signed || type == 'U') {
    switch (size) {
      case 1:
        return is_signed ? FieldType::kInt8 : FieldType::kUint8;
      case 2:
        return is_signed ? FieldType::kInt16 : FieldType::kUint16;
      case 4:
        return is_signed ? FieldType::kInt32 : FieldType::kUint32;
      case 8:
        return is_signed ? FieldType::kInt64 : FieldType::kUint64;
      default:
        break;
    }
  }
  input.fail_at_line("expected a TYPE of I, U or F and a SIZE that goes with it, got " +
                     std::to_string(size) + " bytes");
}

std::vector<PointField> fields_of(const InputBuffer& input, const PcdHeader& header) {
  std::vector<PointField> fields;
  for (std::size_t i = 0; i < header.names.size(); ++i) {
    const std::int64_t count = header.counts[i];
    if (count < 0 || count > kLongestRow) input.fail_at_line("COUNT: expected 0 to 1048576");
    fields.push_back({header.names[i], type_of(input, header.types[i], header.sizes[i]), count});
  }
  const std::int64_t size = row_bytes(fields);
  if (size < 1 || size > kLongestRow) input.fail_at_line("expected points of 1 to 1048576 bytes");
  return fields;
}

// Reads binary_compressed points: field after field, in one block of LZF.
void read_compressed(InputBuffer& input, PointTable& table) {
  const std::int64_t offset = input.offset();
  std::uint32_t stored = 0, expected = 0;
  const char* head = input.bytes(8, "the sizes of the compressed points");
  std::memcpy(&stored, head, sizeof(stored));
  std::memcpy(&expected, head + 4, sizeof(expected));
  const std::int64_t row_size = row_bytes(table.fields);
  if (static_cast<std::int64_t>(expected) != table.num_points * row_size) {
    throw FormatError::at_byte(offset + 4,
                               "expected " + std::to_string(table.num_points * row_size) +
                                   " uncompressed bytes, got " + std::to_string(expected));
  }
  if (expected == 0) return;
  if (expected / kLzfMostExpansion > stored) {
    throw FormatError::at_byte(
        offset, std::to_string(stored) + " bytes of LZF cannot hold " + std::to_string(expected));
  }
  // Scans are compressed to a tenth at best. A file of zeros would expand by a factor of 88, and
  // its points as floats take several times more.
  constexpr std::int64_t kMaxExpansion = 20;
  const std::int64_t memory = std::max<std::int64_t>(expected, table.num_points * kPointMemory);
  if (memory > static_cast<std::int64_t>(kFreeExpansion) && memory / kMaxExpansion > stored) {
    throw FormatError::at_byte(offset, std::to_string(stored) + " bytes of LZF make " +
                                           std::to_string(table.num_points) +
                                           " points: more than a scan can hold");
  }
  std::vector<char> packed;
  input.checked_claim(stored, 1, "compressed bytes", {std::nullopt, offset});
  read_rows(input, stored, 1, packed);
  input.check_expansion(expected);
  const std::vector<char> columns = lzf_decompress(packed, expected, offset + 8);
  table.rows.resize(expected);
  const char* column = columns.data();
  std::int64_t at = 0;
  for (const PointField& field : table.fields) {
    const std::int64_t size = field.num_bytes();
    for (std::int64_t i = 0; i < table.num_points; ++i, column += size) {
      std::copy_n(column, size, table.rows.data() + i * row_size + at);
    }
    at += size;
  }
}

char type_letter(FieldType type) {
  if (type == FieldType::kFloat || type == FieldType::kDouble) return 'F';
  const bool is_signed = type == FieldType::kInt8 || type == FieldType::kInt16 ||
                         type == FieldType::kInt32 || type == FieldType::kInt64;
  return is_signed ? 'I' : 'U';
}

void write_compressed(Output& output, const PointTableView& table) {
  const std::int64_t row_size = row_bytes(table.fields);
  if (table.rows.size() > std::numeric_limits<std::uint32_t>::max()) {
    throw InputError("points: binary_compressed holds at most 4 GiB");
  }
  std::vector<char> columns;
  columns.reserve(table.rows.size());
  std::int64_t at = 0;
  for (const PointField& field : table.fields) {
    const std::int64_t size = field.num_bytes();
    for (std::int64_t i = 0; i < table.num_points; ++i) {
      const char* value = table.rows.data() + i * row_size + at;
      columns.insert(columns.end(), value, value + size);
    }
    at += size;
  }
  const std::vector<char> packed = lzf_compress(columns);
  output.binary(static_cast<std::uint32_t>(packed.size()));
  output.binary(static_cast<std::uint32_t>(columns.size()));
  output.text({packed.data(), packed.size()});
}

}  // namespace

PointTable read_pcd(ByteSource& source, const Progress& progress) {
  InputBuffer input(source, progress);
  const PcdHeader header = HeaderReader(input).read();
  PointTable table;
  table.fields = fields_of(input, header);
  table.num_points = header.points;
  table.header = {{"version", header.version},
                  {"width", std::to_string(header.width)},
                  {"height", std::to_string(header.height)},
                  {"viewpoint", header.viewpoint},
                  {"data", header.data}};
  const std::int64_t row_size = row_bytes(table.fields);
  if (header.data == "binary_compressed") {
    read_compressed(input, table);
    return table;
  }
  const bool is_ascii = header.data == "ascii";
  const FormatError::Position position{input.line(), std::nullopt};
  const std::int64_t sure =
      input.checked_claim(table.num_points, is_ascii ? 2 : row_size, "points", position);
  if (is_ascii) {
    read_text_rows(input, table, "fields");
  } else {
    table.rows.reserve(sure * row_size);
    read_rows(input, table.num_points, row_size, table.rows);
  }
  return table;
}

void write_pcd(Output& output, const PointTableView& table) {
  const auto or_else = [&](const char* key, const std::string& other) {
    const std::string value = header_value(table.header, key);
    return value.empty() ? other : value;
  };
  const std::string data = or_else("data", "binary");
  std::string names, sizes, types, counts;
  for (const PointField& field : table.fields) {
    if (field.name.empty() || field.name.find_first_of(" \t\r\n#") != std::string::npos) {
      throw InputError("fields: PCD cannot hold the name '" + field.name + "'");
    }
    names += " " + field.name;
    sizes += " " + std::to_string(value_bytes(field.type));
    types += std::string(" ") + type_letter(field.type);
    counts += " " + std::to_string(field.count);
  }
  const std::string num_points = std::to_string(table.num_points);
  output.text("# .PCD v0.7 - Point Cloud Data file format\nVERSION " + or_else("version", "0.7") +
              "\nFIELDS" + names + "\nSIZE" + sizes + "\nTYPE" + types + "\nCOUNT" + counts +
              "\nWIDTH " + or_else("width", num_points) + "\nHEIGHT " + or_else("height", "1") +
              "\nVIEWPOINT " + or_else("viewpoint", "0 0 0 1 0 0 0") + "\nPOINTS " + num_points +
              "\nDATA " + data + "\n");
  if (data == "binary_compressed") {
    write_compressed(output, table);
  } else if (data == "binary") {
    output.text({table.rows.data(), table.rows.size()});
  } else if (data == "ascii") {
    const std::int64_t row_size = row_bytes(table.fields);
    for (std::int64_t i = 0; i < table.num_points; ++i) {
      write_text(output, table.fields, table.rows.data() + i * row_size);
    }
  } else {
    throw InputError("data: expected ascii, binary or binary_compressed, got '" + data + "'");
  }
}

}  // namespace manip3d
