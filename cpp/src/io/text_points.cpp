#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "io/point_formats.hpp"
#include "io/point_values.hpp"
#include "parse/input_buffer.hpp"
#include "parse/letters.hpp"
#include "parse/line_cursor.hpp"
#include "parse/number.hpp"

namespace manip3d {
namespace {

constexpr std::size_t kMaxCells = 64;
/// Key of the header for a comment that names as many columns as there are, but no x, y and z.
constexpr const char* kUnusedNames = "unused_names";
constexpr double kMissing = std::numeric_limits<double>::quiet_NaN();
/// Below this, 2^53, a double holds every integer.
constexpr double kInexact = 9007199254740992.0;

std::string_view trimmed(std::string_view text) {
  const auto is_outer = [](char c) { return LineCursor::is_blank(c) || c == '"'; };
  while (!text.empty() && is_outer(text.front())) text.remove_prefix(1);
  while (!text.empty() && is_outer(text.back())) text.remove_suffix(1);
  return text;
}

/// Are commas within numbers, with blanks between these, as in "1,5 2,25 3,75"?
bool has_decimal_commas(std::string_view line) {
  if (std::none_of(line.begin(), line.end(), LineCursor::is_blank)) return false;
  for (std::size_t i = line.find(','); i < line.size(); i = line.find(',', i + 1)) {
    if (i == 0 || i + 1 == line.size() || !is_digit(line[i - 1]) || !is_digit(line[i + 1])) {
      return false;
    }
  }
  return true;
}

/// The separator of a line; ' ' means any number of blanks.
char separator_of(std::string_view line) {
  if (line.find(';') != std::string_view::npos) return ';';
  const bool has_comma = line.find(',') != std::string_view::npos;
  return has_comma && !has_decimal_commas(line) ? ',' : ' ';
}

/// Splits a line into cells. Beyond the limit of cells, only a few more are returned, enough to
/// detect the excess.
void split(std::string_view line, char separator, std::vector<std::string_view>& cells) {
  constexpr std::size_t kMaxWanted = kMaxCells + 2;
  cells.clear();
  if (separator == ' ') {
    LineCursor cursor(line, 0);
    for (std::string_view word = cursor.word(); !word.empty() && cells.size() < kMaxWanted;
         word = cursor.word()) {
      cells.push_back(trimmed(word));
    }
    return;
  }
  for (std::size_t begin = 0; begin <= line.size() && cells.size() < kMaxWanted;) {
    const std::size_t end = std::min(line.find(separator, begin), line.size());
    cells.push_back(trimmed(line.substr(begin, end - begin)));
    begin = end + 1;
  }
}

/// Drops an empty cell beyond the expected number, because some writers end each line with a
/// separator.
void drop_last(std::vector<std::string_view>& cells, std::size_t expected) {
  if (!cells.empty() && cells.size() == expected + 1 && cells.back().empty()) cells.pop_back();
}

bool is_hexadecimal(std::string_view text) {
  return text.starts_with("0x") || text.starts_with("0X");
}

/// Parses a decimal integer, or one in hexadecimal after 0x. Returns false if the text is no
/// integer of this type.
template <typename Integer>
bool to_integer(std::string_view text, Integer& value) {
  text = without_plus(text);
  const bool is_hex = is_hexadecimal(text);
  if (is_hex) text.remove_prefix(2);
  if (is_hex && text.starts_with("-")) return false;
  const char* const end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(text.data(), end, value, is_hex ? 16 : 10);
  return error == std::errc() && stop == end;
}

/// Parses a number, NaN and infinity included. A number that is too small for a double is zero; one
/// that is too large is refused. Returns false if the text is no such number.
bool to_number(std::string_view text, double& value) {
  text = without_plus(text);
  if (is_hexadecimal(text)) {
    std::uint64_t whole = 0;
    const bool is_whole = to_integer(text, whole);
    value = static_cast<double>(whole);
    return is_whole;
  }
  const char* const end = text.data() + text.size();
  const auto [stop, error] = to_double(text, value);
  return error == std::errc() && stop == end;
}

/// Parses a number between semicolons or blanks, in which a comma can only be a decimal comma.
bool to_number(std::string_view text, char separator, double& value) {
  if (to_number(text, value)) return true;
  constexpr std::size_t kMaxDigits = 64;
  const std::size_t comma = text.find(',');
  if (separator == ',' || comma == std::string_view::npos || text.size() > kMaxDigits ||
      text.find('.') != std::string_view::npos) {
    return false;
  }
  std::array<char, kMaxDigits> digits{};
  std::copy(text.begin(), text.end(), digits.begin());
  digits[comma] = '.';
  return to_number({digits.data(), text.size()}, value);
}

/// Do cells between commas contain the halves of numbers, as in "1,05,2,25,3,007"? Their second
/// halves are digits only.
bool are_halves(const std::vector<std::string_view>& cells) {
  if (cells.size() < 6 || cells.size() % 2 != 0) return false;
  for (std::size_t i = 1; i < cells.size(); i += 2) {
    if (cells[i].empty() || !std::all_of(cells[i].begin(), cells[i].end(), is_digit)) return false;
  }
  return std::all_of(cells.begin(), cells.end(), [](std::string_view cell) {
    return cell.find_first_of(".eE") == std::string_view::npos;
  });
}

/// Does a second half begin with a zero? Whole numbers do not.
bool has_zero_in_front(const std::vector<std::string_view>& cells) {
  for (std::size_t i = 1; i < cells.size(); i += 2) {
    if (cells[i].size() > 1 && cells[i].front() == '0') return true;
  }
  return false;
}

/// Is it this word alone, or with a unit behind it, as in "x (m)", "x [m]" or "x_m"?
bool is_word(std::string_view name, std::string_view word) {
  if (!name.starts_with(word)) return false;
  const std::string_view unit = trimmed(name.substr(word.size()));
  return unit.empty() || unit.starts_with("(") || unit.starts_with("[") || unit == "_m";
}

/// The name of a column in lower case. x, y and z are also recognised in the spelling of other
/// writers.
std::string column_name(std::string_view text) {
  std::string name = lower_case(text);
  for (int axis = 0; axis < 3; ++axis) {
    // VeloView's names end with the number of the axis
    const std::string number = std::to_string(axis);
    const std::string letter(1, "xyz"[axis]);
    if (is_word(name, letter) || name == "points_m_xyz:" + number || name == "points:" + number) {
      return letter;
    }
  }
  return name;
}

bool has_axes(const std::vector<std::string>& names) {
  const std::array<std::string_view, 3> axes = {"x", "y", "z"};
  return std::all_of(axes.begin(), axes.end(), [&](std::string_view axis) {
    return std::find(names.begin(), names.end(), axis) != names.end();
  });
}

/// Makes x1, y1 and z1 the coordinates where there is no x, y or z: ouster-cli numbers the returns
/// of a pulse, from 1 on.
void take_first_return(std::vector<std::string>& names) {
  for (const std::string& name : names) {
    if (name == "x" || name == "y" || name == "z") return;
  }
  for (std::string& name : names) {
    for (const std::string axis : {"x", "y", "z"}) {
      if (is_word(name, axis + "1")) name = axis;
    }
  }
}

/// Names of columns between separators, if they include x, y and z; else none.
std::vector<std::string> column_names(std::string_view line, char separator) {
  std::vector<std::string_view> cells;
  split(line, separator, cells);
  drop_last(cells, cells.size() - 1);
  // In "# Fields: x y z" the first word is a label.
  if (!cells.empty() && cells.front().ends_with(":")) cells.erase(cells.begin());
  std::vector<std::string> names;
  std::transform(cells.begin(), cells.end(), std::back_inserter(names), column_name);
  // pandas writes no name for the column of row numbers
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (names[i].empty()) names[i] = std::string("c").append(std::to_string(i));
  }
  take_first_return(names);
  return has_axes(names) ? names : std::vector<std::string>();
}

std::string_view without_comment_mark(std::string_view line) {
  while (!line.empty() && (line.front() == '#' || line.front() == '/')) line.remove_prefix(1);
  return line;
}

/// Number of names that a comment separates by commas, semicolons or tabs; 0: it has no such list.
std::size_t count_names(std::string_view comment) {
  const std::string_view line = without_comment_mark(comment);
  const bool has_tabs = line.find('\t') != std::string_view::npos;
  const char separator = has_tabs ? '\t' : separator_of(line);
  if (separator == ' ') return 0;
  std::vector<std::string_view> cells;
  split(line, separator, cells);
  drop_last(cells, cells.size() - 1);
  const auto is_name = [](std::string_view cell) {
    return !cell.empty() && lower_case(cell.front()) >= 'a' && lower_case(cell.front()) <= 'z';
  };
  return std::all_of(cells.begin(), cells.end(), is_name) ? cells.size() : 0;
}

/// Names of columns, if the line names x, y and z; else none. Between tabs, names may contain
/// blanks before units: "X [m]".
std::vector<std::string> column_names(std::string_view line) {
  line = without_comment_mark(line);
  std::vector<std::string> names;
  if (line.find('\t') != std::string_view::npos) names = column_names(line, '\t');
  return names.empty() ? column_names(line, separator_of(line)) : names;
}

/// Default names of columns: x, y, z, then intensity if there are four or seven columns (before
/// red, green and blue, as in Leica's .pts), then c3, c4, ...
std::vector<std::string> usual_names(std::size_t num_columns) {
  std::vector<std::string> names = {"x", "y", "z"};
  if (num_columns == 4 || num_columns == 7) names.emplace_back("intensity");
  while (names.size() < num_columns) {
    names.push_back(std::string("c").append(std::to_string(names.size())));
  }
  return names;
}

/// Reads the lines of one file.
class TextReader {
 public:
  TextReader(ByteSource& source, const Progress& progress) : input_(source, progress) {}

  PointTable read() {
    std::string_view line;
    while (input_.next_line(line)) {
      line = trimmed_line(line);
      if (line.empty() || is_comment(line) || (table_.num_points == 0 && is_head(line))) continue;
      add_point(line);
    }
    if (table_.fields.empty()) set_columns(names_.empty() ? 3 : names_.size());
    if (count_ && *count_ != static_cast<double>(table_.num_points)) {
      input_.fail_at_line("expected as many points as the first line says, got " +
                          std::to_string(table_.num_points));
    }
    return std::move(table_);
  }

 private:
  static std::string_view trimmed_line(std::string_view line) {
    while (!line.empty() && LineCursor::is_blank(line.front())) line.remove_prefix(1);
    while (!line.empty() && LineCursor::is_blank(line.back())) line.remove_suffix(1);
    return line;
  }

  /// Is it a comment? One before the points may name the columns, as CloudCompare's does.
  bool is_comment(std::string_view line) {
    if (!line.starts_with("#") && !line.starts_with("//")) return false;
    if (table_.num_points > 0) return true;
    last_comment_ = line;
    if (names_.empty()) are_from_comment_ = take_names(line);
    return true;
  }

  /// Is it a line before the points, with the names of the columns or the number of points (.pts)?
  bool is_head(std::string_view line) {
    const char separator = separator_of(line);
    split(line, separator, cells_);
    double number = 0.0;
    // If the columns have names, an empty cell is a missing number.
    if (!names_.empty() && !cells_.empty() && cells_.front().empty()) return false;
    if (!cells_.empty() && to_number(cells_.front(), separator, number)) {
      if (cells_.size() > 1 || count_ || !(number >= 0.0)) return false;
      count_ = number;
      table_.header.emplace_back("count", "");
      return true;
    }
    if (are_from_comment_) forget_names();
    if (!names_.empty() || !take_names(line)) {
      input_.fail_at_line("expected numbers, or names of columns with x, y and z");
    }
    return true;
  }

  /// Drops names that turned out to be prose, such as "# x, y and z in metres".
  void forget_names() {
    names_.clear();
    are_from_comment_ = false;
    std::erase_if(table_.header, [](const auto& entry) { return entry.first == "names"; });
  }

  bool take_names(std::string_view line) {
    names_ = column_names(line);
    if (names_.empty()) return false;
    if (names_.size() > kMaxCells) input_.fail_at_line("more than 64 columns");
    table_.header.emplace_back("names", line);
    return true;
  }

  void set_columns(std::size_t num_columns) {
    if (names_.empty()) {
      // The comment may be prose with commas, so that the reader warns and refuses nothing.
      if (num_columns >= 3 && count_names(last_comment_) == num_columns) {
        table_.header.emplace_back(kUnusedNames, last_comment_);
      }
      names_ = usual_names(num_columns);
    }
    for (const std::string& name : names_) {
      table_.fields.push_back({name, FieldType::kDouble});
      can_be_integers_.push_back(name != "x" && name != "y" && name != "z");
    }
  }

  void add_point(std::string_view line) {
    if (table_.fields.empty()) {
      separator_ = separator_of(line);
      if (separator_ != ' ') table_.header.emplace_back("separator", std::string(1, separator_));
    }
    split(line, separator_, cells_);
    if (table_.fields.empty()) {
      if (are_from_comment_) {
        drop_last(cells_, names_.size());
        if (cells_.size() != names_.size()) forget_names();
      }
      drop_last(cells_, names_.empty() ? cells_.size() - 1 : names_.size());
      if (cells_.size() > kMaxCells) input_.fail_at_line("more than 64 numbers");
      set_columns(cells_.size());
    }
    drop_last(cells_, table_.fields.size());
    if (separator_ == ',' &&
        (cells_.size() == 2 * table_.fields.size() || has_zero_in_front(cells_)) &&
        are_halves(cells_)) {
      input_.fail_at_line(
          "commas stand between the columns and within the numbers: write decimal points, or "
          "semicolons between columns");
    }
    if (cells_.size() != table_.fields.size() || cells_.size() < 3) {
      input_.fail_at_line("expected " + std::to_string(table_.fields.size()) + " numbers, got " +
                          std::to_string(cells_.size()));
    }
    for (std::size_t i = 0; i < cells_.size(); ++i) {
      double value = kMissing;
      if (!cells_[i].empty() && !to_number(cells_[i], separator_, value)) fail_at(cells_[i]);
      add_value(i, cells_[i], value);
    }
    ++table_.num_points;
    if (table_.num_points % 4096 == 0) input_.check_expansion(table_.rows.size());
  }

  /// Appends the value of a cell. A column of integers of which one may not be exact as a double,
  /// such as nanoseconds since 1970, becomes one of 64-bit integers.
  void add_value(std::size_t column, std::string_view cell, double value) {
    const FieldType type = table_.fields[column].type;
    if (can_be_integers_[column] && std::fabs(value) < kInexact && value == std::trunc(value)) {
      if (type == FieldType::kDouble) return append(value);
      if (type == FieldType::kInt64) return append(static_cast<std::int64_t>(value));
      if (value >= 0.0) return append(static_cast<std::uint64_t>(value));
    }
    std::int64_t whole = 0;
    if (can_be_integers_[column] && type != FieldType::kUint64 && to_integer(cell, whole)) {
      convert(column, FieldType::kInt64);
      return append(whole);
    }
    std::uint64_t large = 0;
    if (can_be_integers_[column] && to_integer(cell, large) && !has_negative(column)) {
      convert(column, FieldType::kUint64);
      return append(large);
    }
    can_be_integers_[column] = false;
    convert(column, FieldType::kDouble);
    append(value);
  }

  template <typename Value>
  void append(Value value) {
    static_assert(sizeof(Value) == sizeof(double));
    const auto* raw = reinterpret_cast<const char*>(&value);
    table_.rows.insert(table_.rows.end(), raw, raw + sizeof(value));
  }

  /// Calls f with a pointer to each stored value of a column.
  template <typename F>
  void for_values(std::size_t column, F f) {
    const std::size_t row = table_.fields.size() * sizeof(double);
    for (std::size_t i = column * sizeof(double); i + sizeof(double) <= table_.rows.size();
         i += row) {
      f(table_.rows.data() + i);
    }
  }

  template <typename From, typename To>
  void convert_values(std::size_t column) {
    for_values(column, [](char* at) {
      From from{};
      std::memcpy(&from, at, sizeof(from));
      const To to = static_cast<To>(from);
      std::memcpy(at, &to, sizeof(to));
    });
  }

  /// Has a value of a column the sign of negative numbers, which is the first bit of both types?
  bool has_negative(std::size_t column) {
    bool found = false;
    if (table_.fields[column].type == FieldType::kUint64) return found;
    for_values(column, [&](const char* at) { found = found || at[sizeof(double) - 1] < 0; });
    return found;
  }

  /// Stores the values of a column as another type, which must hold them.
  void convert(std::size_t column, FieldType to) {
    FieldType& from = table_.fields[column].type;
    if (from == to) return;
    if (to == FieldType::kInt64) convert_values<double, std::int64_t>(column);
    if (to == FieldType::kUint64 && from == FieldType::kDouble) {
      convert_values<double, std::uint64_t>(column);
    }
    if (to == FieldType::kDouble && from == FieldType::kInt64) {
      convert_values<std::int64_t, double>(column);
    }
    if (to == FieldType::kDouble && from == FieldType::kUint64) {
      convert_values<std::uint64_t, double>(column);
    }
    from = to;
  }

  [[noreturn]] void fail_at(std::string_view cell) {
    LineCursor cursor(cell, input_.line());
    cursor.fail("a column", "a number");
  }

  InputBuffer input_;
  PointTable table_;
  std::vector<std::string> names_;
  bool are_from_comment_ = false;  ///< The names are from a comment, which may be prose.
  std::string last_comment_;       ///< The last comment before the points.
  std::vector<std::string_view> cells_;
  std::vector<bool> can_be_integers_;  ///< Columns of which all values so far are integers.
  char separator_ = ' ';
  std::optional<double> count_;  ///< Number of points that the file states.
};

}  // namespace

// Reads a point per line. Columns are separated by commas, semicolons or blanks; with the latter
// two, numbers may have decimal commas; integers may be hexadecimal (0x). A line before the points,
// a comment or not, may name the columns; "unused_names" of the header is a comment that names
// others than x, y and z.
PointTable read_text_points(ByteSource& source, const Progress& progress) {
  return TextReader(source, progress).read();
}

void write_text_points(Output& output, const PointTableView& table) {
  for (const PointField& field : table.fields) {
    if (field.count != 1) {
      throw InputError("fields: text has one number a column, got '" + field.name + "'");
    }
  }
  const std::string separator = header_value(table.header, "separator");
  for (const auto& [key, value] : table.header) {
    if (key == "names") output.text(value + "\n");
    if (key == "count") output.text(std::to_string(table.num_points) + "\n");
  }
  const std::int64_t row_size = row_bytes(table.fields);
  for (std::int64_t i = 0; i < table.num_points; ++i) {
    write_text(output, table.fields, table.rows.data() + i * row_size,
               separator.empty() ? " " : separator);
  }
}

}  // namespace manip3d
