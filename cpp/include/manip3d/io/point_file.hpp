#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "manip3d/files/byte_source.hpp"
#include "manip3d/progress.hpp"

/// @file
/// Point files as tables: all fields of all points with the values of the file.
namespace manip3d {

enum class PointFormat : std::uint8_t {
  kKitti,
  kNuScenes,
  kPcd,
  kPly,
  k3dtk,
  kXyz,
  kXyzi,
  kXyzn,
  kXyzrgb,
  kAsc,
  kPts,
  kTxt,
  kCsv
};

enum class FieldType : std::uint8_t {
  kInt8,
  kUint8,
  kInt16,
  kUint16,
  kInt32,
  kUint32,
  kInt64,
  kUint64,
  kFloat,
  kDouble
};

struct PointField {
  std::string name;
  FieldType type = FieldType::kFloat;
  std::int64_t count = 1;  ///< Values per point.

  [[nodiscard]] std::int64_t num_bytes() const;
};

/// Other contents of a file's header: pairs of key and value in the file's order; keys may repeat.
///
/// PCD: `version`, `width`, `height`, `viewpoint`, `data` (ascii, binary, binary_compressed).
/// PLY: `format` (ascii, binary_little_endian, binary_big_endian), `remark` (a complete line of
/// comment or obj_info), `skipped` (an element that is not points).
/// Text: `names` (the line that names the columns), `count` (if the first line is the number of
/// points), `separator` (unless it is a blank).
using PointHeader = std::vector<std::pair<std::string, std::string>>;

/// The first value of a key; empty: the key does not occur.
std::string header_value(const PointHeader& header, std::string_view key);

/// The points of one file, row by row, without padding between fields, little endian.
struct PointTable {
  PointFormat format = PointFormat::kKitti;
  std::vector<PointField> fields;
  PointHeader header;
  std::int64_t num_points = 0;
  std::vector<char> rows;  ///< num_points * row_bytes(fields)
};

/// Bytes of one row of a table with these fields.
std::int64_t row_bytes(const std::vector<PointField>& fields);

struct ReadPointsOptions {
  /// Limit of uncompressed bytes; 0: compressed input is limited by its ratio (byte_source.hpp).
  std::uint64_t max_bytes = 0;
};

/// Reads a point file; `.gz` and `.xz` are decompressed on the fly. The suffix determines the
/// format.
///
/// - KITTI (`.bin`): rows of four finite floats x, y, z, intensity. If the values show that rows
///   have 3, 5, 6 or 7 floats, the columns are x, y, z, intensity, column_5, ... Rows whose x, y
///   and z are all NaN are kept, as those without a return; others that are not finite are an
///   error.
/// - nuScenes (`.pcd.bin`): the ring as a fifth float; another number of columns is an error.
/// - 3DTK (`.3d`): lines of three or more finite numbers, read as double: x, y, z, c3, c4, ...
/// - PCD: ascii, binary or binary_compressed, and PLY: the element `vertex`, which must come first
///   and have no lists; other elements are left out. Values of these two are kept, NaN included.
/// - Text (`.xyz`, `.asc`, `.pts`, `.txt`, `.csv`): a point per line, with commas, semicolons or
///   blanks between columns. A line before the points may name the columns; the default names are
///   x, y, z, intensity (of four or seven columns), c3, c4, ... An empty cell is NaN. Columns are
///   doubles; one of integers of which one is 2^53 or more, as nanoseconds since 1970 are, consists
///   of 64-bit integers, unless it is x, y or z. Integers may be hexadecimal, with 0x in front.
/// @throws FormatError  (with the file's name and the line or byte) the file cannot be read.
/// @throws InputError  an unknown suffix.
/// @throws std::filesystem::filesystem_error  for example, the file does not exist.
PointTable read_points(const std::filesystem::path& path, const ReadPointsOptions& options = {},
                       const Progress& progress = {});

/// Reads points from memory, compressed or not.
PointTable read_points(std::span<const std::byte> data, PointFormat format,
                       const ReadPointsOptions& options = {}, const Progress& progress = {});

/// Borrowed arrays for write_points.
struct PointTableView {
  std::vector<PointField> fields;
  PointHeader header;
  std::int64_t num_points = 0;
  std::span<const char> rows;
};

/// Writes points in the format of the suffix (before `.gz` or `.xz`), completely or not at all.
/// @throws InputError  an unknown suffix, or fields that the format cannot hold.
/// @throws std::filesystem::filesystem_error  the operating system refused.
void write_points(const std::filesystem::path& path, const PointTableView& table,
                  const Progress& progress = {});

/// Suffixes of the formats, with their dots.
std::vector<std::string> point_suffixes();
/// Returns "kitti", ...
const char* point_format_name(PointFormat format);

}  // namespace manip3d
