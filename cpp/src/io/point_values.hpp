#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "io/output.hpp"
#include "manip3d/io/point_file.hpp"
#include "parse/input_buffer.hpp"

namespace manip3d {

/// Reads `table.num_points` lines with one value per field and appends them to `table.rows`. Empty
/// lines are skipped. Floating-point values may be NaN or infinite; integers must fit their type.
/// `columns` names the fields in the message for lines with too many values.
void read_text_rows(InputBuffer& input, PointTable& table, const char* columns);

/// Writes a row as a line of text.
void write_text(Output& output, const std::vector<PointField>& fields, const char* row,
                std::string_view separator = " ");

/// Appends `num_rows` rows of `row_size` bytes. Memory grows with the bytes that are really there.
void read_rows(InputBuffer& input, std::int64_t num_rows, std::int64_t row_size,
               std::vector<char>& bytes);

/// Reverses the byte order of all values in the rows.
void swap_rows(const std::vector<PointField>& fields, std::vector<char>& bytes);

/// Bytes of a value.
std::int64_t value_bytes(FieldType type);

}  // namespace manip3d
