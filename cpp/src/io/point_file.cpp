#include "manip3d/io/point_file.hpp"

#include <algorithm>
#include <memory>

#include "io/point_formats.hpp"
#include "manip3d/error.hpp"
#include "parse/letters.hpp"

namespace manip3d {
namespace fs = std::filesystem;
namespace {

struct PointFileFormat {
  PointFormat format;
  const char* name;
  const char* suffix;
  PointTable (*read)(ByteSource&, const Progress&);
  void (*write)(Output&, const PointTableView&);
};

// A new format needs one line here. A suffix that ends in another one must come before it.
constexpr PointFileFormat kPointFormats[] = {
    {PointFormat::kNuScenes, "nuscenes", ".pcd.bin", read_nuscenes, write_nuscenes},
    {PointFormat::kKitti, "kitti", ".bin", read_kitti, write_kitti},
    {PointFormat::kPcd, "pcd", ".pcd", read_pcd, write_pcd},
    {PointFormat::kPly, "ply", ".ply", read_ply_points, write_ply_points},
    {PointFormat::k3dtk, "3dtk", ".3d", read_3dtk, write_3dtk},
    {PointFormat::kXyz, "xyz", ".xyz", read_text_points, write_text_points},
    {PointFormat::kXyzi, "xyzi", ".xyzi", read_text_points, write_text_points},
    {PointFormat::kXyzn, "xyzn", ".xyzn", read_text_points, write_text_points},
    {PointFormat::kXyzrgb, "xyzrgb", ".xyzrgb", read_text_points, write_text_points},
    {PointFormat::kAsc, "asc", ".asc", read_text_points, write_text_points},
    {PointFormat::kPts, "pts", ".pts", read_text_points, write_text_points},
    {PointFormat::kTxt, "txt", ".txt", read_text_points, write_text_points},
    {PointFormat::kCsv, "csv", ".csv", read_text_points, write_text_points},
};

const PointFileFormat& format_of(const fs::path& path) {
  const std::string name = lower_case(without_compression_suffix(path).filename().string());
  for (const PointFileFormat& f : kPointFormats) {
    // A hidden file with the name ".pcd" has no suffix.
    if (name.ends_with(f.suffix) && name != f.suffix) return f;
  }
  std::string suffixes;
  for (const PointFileFormat& f : kPointFormats) suffixes += std::string(f.suffix) + " ";
  throw InputError("path: expected a point file (" + suffixes +
                   "then .gz or .xz if wanted), got '" + path.string() + "'");
}

// Checks the memory of points: rows of three bytes become points of sixteen.
void check_memory(const PointTable& table, const ByteSource& source) {
  constexpr std::uint64_t kMaxExpansion = 100;
  const auto memory = static_cast<std::uint64_t>(table.num_points * kPointMemory);
  if (source.expansion_allowed() || memory <= kFreeExpansion) return;
  if (memory / kMaxExpansion <= source.stored_size()) return;
  throw FormatError("compressed data make points more than " + std::to_string(kMaxExpansion) +
                        " times as large; set max_bytes to read them",
                    {});
}

}  // namespace

std::int64_t PointField::num_bytes() const {
  constexpr std::int64_t kSizes[] = {1, 1, 2, 2, 4, 4, 8, 8, 4, 8};
  return kSizes[static_cast<int>(type)] * count;
}

std::int64_t row_bytes(const std::vector<PointField>& fields) {
  std::int64_t bytes = 0;
  for (const PointField& field : fields) bytes += field.num_bytes();
  return bytes;
}

std::string header_value(const PointHeader& header, std::string_view key) {
  for (const auto& [name, value] : header) {
    if (name == key) return value;
  }
  return "";
}

PointTable read_points(const fs::path& path, const ReadPointsOptions& options,
                       const Progress& progress) {
  const PointFileFormat& format = format_of(path);
  try {
    const auto source = decompressed(file_source(path), compression_of(path), options.max_bytes);
    PointTable table = format.read(*source, progress);
    table.format = format.format;
    check_memory(table, *source);
    return table;
  } catch (const FormatError& error) {
    throw error.in_file(path.string());
  }
}

PointTable read_points(std::span<const std::byte> data, PointFormat format,
                       const ReadPointsOptions& options, const Progress& progress) {
  const auto source = decompressed(memory_source(data), Compression::kNone, options.max_bytes);
  const auto* entry = std::find_if(std::begin(kPointFormats), std::end(kPointFormats),
                                   [&](const PointFileFormat& f) { return f.format == format; });
  PointTable table = entry->read(*source, progress);
  table.format = format;
  return table;
}

void write_points(const fs::path& path, const PointTableView& table, const Progress& progress) {
  const PointFileFormat& format = format_of(path);
  if (static_cast<std::int64_t>(table.rows.size()) != table.num_points * row_bytes(table.fields)) {
    throw InputError("rows: expected " + std::to_string(table.num_points) + " of " +
                     std::to_string(row_bytes(table.fields)) + " bytes, got " +
                     std::to_string(table.rows.size()) + " bytes");
  }
  Output output(path, compression_of(path), progress);
  format.write(output, table);
  output.commit();
}

std::vector<std::string> point_suffixes() {
  std::vector<std::string> suffixes;
  for (const PointFileFormat& f : kPointFormats) suffixes.emplace_back(f.suffix);
  return suffixes;
}

const char* point_format_name(PointFormat format) {
  const auto* entry = std::find_if(std::begin(kPointFormats), std::end(kPointFormats),
                                   [&](const PointFileFormat& f) { return f.format == format; });
  return entry->name;
}

}  // namespace manip3d
