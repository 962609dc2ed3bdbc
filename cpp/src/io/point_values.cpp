#include "io/point_values.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <string>
#include <type_traits>

#include "parse/line_cursor.hpp"
#include "parse/number.hpp"

namespace manip3d {
namespace {

// Calls f with a value of the C++ type.
template <typename F>
void with_type(FieldType type, F f) {
  switch (type) {
    case FieldType::kInt8:
      return f(std::int8_t{});
    case FieldType::kUint8:
      return f(std::uint8_t{});
    case FieldType::kInt16:
      return f(std::int16_t{});
    case FieldType::kUint16:
      return f(std::uint16_t{});
    case FieldType::kInt32:
      return f(std::int32_t{});
    case FieldType::kUint32:
      return f(std::uint32_t{});
    case FieldType::kInt64:
      return f(std::int64_t{});
    case FieldType::kUint64:
      return f(std::uint64_t{});
    case FieldType::kFloat:
      return f(float{});
    case FieldType::kDouble:
      return f(double{});
  }
}

template <typename T>
T parsed(std::string_view word, LineCursor& at_word, const PointField& field) {
  T value{};
  const std::string_view text = without_plus(word);
  const char* const end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(text.data(), end, value);
  if constexpr (std::is_floating_point_v<T>) {
    if (error == std::errc::result_out_of_range) return at_word.number(field.name.c_str());
  }
  if (error != std::errc() || stop != end || word.empty()) {
    at_word.fail(field.name.c_str(), std::is_integral_v<T> ? "an integer of its type" : "a number");
  }
  return value;
}

// Reads the values of one field from a line and appends their bytes.
void read_text(LineCursor& cursor, const PointField& field, std::vector<char>& bytes) {
  for (std::int64_t i = 0; i < field.count; ++i) {
    LineCursor at_word = cursor;
    const std::string_view word = cursor.word();
    with_type(field.type, [&]<typename T>(T) {
      T value{};
      if constexpr (std::is_same_v<T, float>) {
        // Rounded from double, as in other readers.
        const double wide = parsed<double>(word, at_word, field);
        if (std::isfinite(wide) && std::fabs(wide) > std::numeric_limits<float>::max()) {
          at_word.fail(field.name.c_str(), "a number that fits a float");
        }
        value = static_cast<float>(wide);
      } else {
        value = parsed<T>(word, at_word, field);
      }
      const auto* raw = reinterpret_cast<const char*>(&value);
      bytes.insert(bytes.end(), raw, raw + sizeof(T));
    });
  }
}

}  // namespace

void read_text_rows(InputBuffer& input, PointTable& table, const char* columns) {
  std::string_view line;
  const auto row_size = static_cast<std::uint64_t>(row_bytes(table.fields));
  for (std::int64_t i = 0; i < table.num_points; ++i) {
    do {
      if (!input.next_line(line)) {
        throw FormatError::at_line(input.line() + 1, "file ends within the points");
      }
    } while (LineCursor(line, 0).rest().empty());
    LineCursor cursor(line, input.line());
    for (const PointField& field : table.fields) read_text(cursor, field, table.rows);
    if (!cursor.rest().empty()) {
      input.fail_at_line(std::string("more values on the line than ") + columns);
    }
    if (i % 4096 == 0) input.check_expansion(static_cast<std::uint64_t>(i) * row_size);
  }
}

void write_text(Output& output, const std::vector<PointField>& fields, const char* row,
                std::string_view separator) {
  bool is_first = true;
  for (const PointField& field : fields) {
    for (std::int64_t i = 0; i < field.count; ++i) {
      with_type(field.type, [&]<typename T>(T value) {
        std::memcpy(&value, row, sizeof(T));
        row += sizeof(T);
        if (!is_first) output.text(separator);
        is_first = false;
        if constexpr (sizeof(T) == 1) {
          output.number(static_cast<int>(value));
        } else {
          output.number(value);
        }
      });
    }
  }
  output.text("\n");
}

void read_rows(InputBuffer& input, std::int64_t num_rows, std::int64_t row_size,
               std::vector<char>& bytes) {
  constexpr std::int64_t kBlock = std::int64_t{1} << 18;
  const std::int64_t block = std::max<std::int64_t>(1, kBlock / row_size);
  while (num_rows > 0) {
    const std::size_t size = std::min(block, num_rows) * row_size;
    const char* data = input.bytes(size, "the points");
    bytes.insert(bytes.end(), data, data + size);
    num_rows -= std::min(block, num_rows);
  }
}

void swap_rows(const std::vector<PointField>& fields, std::vector<char>& bytes) {
  char* at = bytes.data();
  const char* end = at + bytes.size();
  while (at < end) {
    for (const PointField& field : fields) {
      const std::int64_t size = value_bytes(field.type);
      for (std::int64_t i = 0; i < field.count; ++i, at += size) std::reverse(at, at + size);
    }
  }
}

std::int64_t value_bytes(FieldType type) { return PointField{"", type, 1}.num_bytes(); }

}  // namespace manip3d
