#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "manip3d/io/byte_source.hpp"
#include "manip3d/progress.hpp"

/// @file
/// Point files as tables: every field of every point, as the file has it.
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

/// Header of a file beside its points: key, value; in the file's order, keys may repeat.
///
/// PCD: `version`, `width`, `height`, `viewpoint`, `data` (ascii, binary, binary_compressed).
/// PLY: `format` (ascii, binary_little_endian, binary_big_endian), `remark` (a whole line of
/// comment or obj_info), `skipped` (an element that is not points).
/// Text: `names` (the line that names the columns), `count` (the first line is the number of
/// points), `separator` (where it is not a blank).
using PointHeader = std::vector<std::pair<std::string, std::string>>;

/// The first value of a key; empty when there is none.
std::string header_value(const PointHeader& header, std::string_view key);

/// The points of one file, row by row, without gaps between fields, little endian.
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
  /// 0: compressed input is limited by its ratio (byte_source.hpp); else the most uncompressed
  /// bytes to read.
  std::uint64_t max_bytes = 0;
};

/// Reads a point file; `.gz` and `.xz` are decompressed on the fly. The suffix tells the format.
///
/// KITTI's `.bin` has rows of four floats: x, y, z, intensity, all finite; nuScenes' `.pcd.bin` has
/// the ring as a fifth. A `.bin` whose values say that rows have 3, 5, 6 or 7 floats has x, y, z,
/// intensity, column_5, ...; a `.pcd.bin` with another number than 5 is an error. 3DTK's `.3d` has
/// three or more finite numbers a line: x, y, z, and c3, c4, ... as double. PCD may be ascii,
/// binary or binary_compressed. PLY: the element `vertex`, which has no lists and comes first;
/// other elements are left out. Values of these two are as stored, NaN included. Text (`.xyz`,
/// `.asc`, `.pts`, `.txt`, `.csv`) has a point a line, columns between commas, semicolons or
/// blanks, named by a line before them or else x, y, z, intensity (of four and of seven), c3, c4,
/// ...; an empty cell is NaN.
/// @throws FormatError  with the file's name and the line or byte where reading stopped.
/// @throws InputError  unknown suffix.
/// @throws std::filesystem::filesystem_error  missing file and the like.
PointTable read_points(const std::filesystem::path& path, const ReadPointsOptions& options = {},
                       const Progress& progress = {});

/// Reads points from memory, compressed or not.
PointTable read_points(std::span<const std::byte> data, PointFormat format,
                       const ReadPointsOptions& options = {}, const Progress& progress = {});

/// Arrays that write_points borrows.
struct PointTableView {
  std::vector<PointField> fields;
  PointHeader header;
  std::int64_t num_points = 0;
  std::span<const char> rows;
};

/// Writes points in the format that the suffix says (then `.gz` or `.xz`), whole or not at all.
/// @throws InputError  unknown suffix; fields that the format cannot hold.
/// @throws std::filesystem::filesystem_error  the operating system refused.
void write_points(const std::filesystem::path& path, const PointTableView& table,
                  const Progress& progress = {});

/// Suffixes of the formats, with their dots.
std::vector<std::string> point_suffixes();
/// "kitti", ...
const char* point_format_name(PointFormat format);

}  // namespace manip3d
