#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "io/output.hpp"
#include "manip3d/io/point_file.hpp"
#include "parse/input_buffer.hpp"

namespace manip3d {

/// Reads `table.num_points` lines with a value for each field and appends them to `table.rows`.
/// Empty lines are passed over. Numbers with a fraction may be NaN or infinite; integers must fit
/// their type. `columns` names the fields in the error about a line with too many values.
void read_text_rows(InputBuffer& input, PointTable& table, const char* columns);

/// Writes a row as a line.
void write_text(Output& output, const std::vector<PointField>& fields, const char* row,
                std::string_view separator = " ");

/// Appends `num_rows` rows of `row_size` bytes as they are; grows with what is really there.
void read_rows(InputBuffer& input, std::int64_t num_rows, std::int64_t row_size,
               std::vector<char>& bytes);

/// Turns the byte order of every value of the rows around.
void swap_rows(const std::vector<PointField>& fields, std::vector<char>& bytes);

/// Bytes per value.
std::int64_t value_bytes(FieldType type);

}  // namespace manip3d
