#include "io/mesh_builder.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <string>
#include <utility>

#include "io/leave_out_nan.hpp"
#include "io/warnings.hpp"
#include "manip3d/io/corner_colors.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kMaxFaces = std::numeric_limits<std::int32_t>::max() / 3;

std::string place(const FormatError::Position& position) {
  return position.line ? "line " + std::to_string(*position.line)
                       : "byte " + std::to_string(position.byte_offset.value_or(0));
}

/// Whether colours are 0 to 255, as some programs write them, instead of the usual 0 to 1. Values a
/// little above 1 are overexposed or rounded; a file of bytes has larger or only whole ones.
bool are_bytes(const Rows<float, 3>& values) {
  float largest = 0.0F;
  bool is_whole = true;
  for (Eigen::Index i = 0; i < values.size(); ++i) {
    const float value = values.data()[i];
    if (std::isnan(value)) continue;  // a vertex without colour
    largest = std::max(largest, value);
    is_whole = is_whole && value == std::floor(value);
  }
  return largest > 2.0F || (largest > 1.0F && is_whole);
}

}  // namespace

void MeshBuilder::add_polygon(std::span<const Corner> corners, std::int32_t material,
                              const FormatError::Position& position) {
  if (corners.size() < 3) {
    if (num_short_++ == 0) first_short_ = position;
    last_face_ = faces_.size();
    return;
  }
  const std::int64_t first = faces_.size();
  last_face_ = first;
  const auto num_corners = static_cast<std::int64_t>(corners.size());
  if (first + num_corners - 2 > kMaxFaces) {
    throw FormatError("more than " + std::to_string(kMaxFaces) + " triangles", position);
  }
  bool known = true;
  for (const Corner& c : corners) {
    known = known && c.vertex < vertices.size() && c.texcoord < texcoords.size() &&
            c.normal < normals.size();
  }
  if (!known) forward_.push_back({first, position});
  if (num_corners > 3) {
    polygons_.push_back({first, corners_.size(), num_corners});
    for (const Corner& c : corners) {
      std::int32_t* row = corners_.append(input_);
      row[0] = c.vertex;
      row[1] = c.texcoord;
      row[2] = c.normal;
    }
  }
  // A fan of triangles reserves the rows until the positions of all corners are known.
  for (std::size_t i = 2; i < corners.size(); ++i) {
    add_triangle(corners[0], corners[i - 1], corners[i]);
  }
  if (material != kNone || !face_material_.empty()) {
    face_material_.fill(first, kNone, input_);
    face_material_.fill(faces_.size(), material, input_);
  }
  ++num_polygons_;
}

void MeshBuilder::set_texture(std::int64_t face, const std::int32_t* texcoords_of_corners,
                              std::int32_t material) {
  face_texcoords_.fill(face + 1, kNone, input_);
  std::copy_n(texcoords_of_corners, 3, face_texcoords_.row(face));
  if (material == kNone) return;
  face_material_.fill(face + 1, kNone, input_);
  *face_material_.row(face) = material;
}

void MeshBuilder::color_faces(std::int64_t begin, std::int64_t end, std::int32_t rgb) {
  face_colors_.fill(begin, kNone, input_);
  face_colors_.fill(end, rgb, input_);
}

void MeshBuilder::recolor_faces(std::int64_t begin, std::int64_t end, std::int32_t rgb) {
  for (std::int64_t face = begin; face < end; ++face) *face_colors_.row(face) = rgb;
}

void MeshBuilder::add_triangle(const Corner& a, const Corner& b, const Corner& c) {
  const std::int64_t face = faces_.size();
  const auto put = [](std::int32_t* row, std::int32_t i, std::int32_t j, std::int32_t k) {
    row[0] = i;
    row[1] = j;
    row[2] = k;
  };
  put(faces_.append(input_), a.vertex, b.vertex, c.vertex);
  if (std::max({a.texcoord, b.texcoord, c.texcoord}) != kNone || !face_texcoords_.empty()) {
    face_texcoords_.fill(face, kNone, input_);
    put(face_texcoords_.append(input_), a.texcoord, b.texcoord, c.texcoord);
  }
  if (std::max({a.normal, b.normal, c.normal}) != kNone || !face_normals_.empty()) {
    face_normals_.fill(face, kNone, input_);
    put(face_normals_.append(input_), a.normal, b.normal, c.normal);
  }
}

MeshBuilder::Complete MeshBuilder::check_forward_references() const {
  Complete complete;
  const auto has_rows = [](const GrowingTable<Faces>& table, std::int64_t face, std::int64_t rows) {
    return face >= table.size() || *std::max_element(table.row(face), table.row(face) + 3) < rows;
  };
  for (std::size_t i = 0; i < forward_.size(); ++i) {
    // Each corner of a polygon is in a row of its fan.
    const std::int64_t first = forward_[i].face;
    const auto polygon =
        std::lower_bound(polygons_.begin(), polygons_.end(), first,
                         [](const Polygon& p, std::int64_t face) { return p.first_face < face; });
    const bool larger = polygon != polygons_.end() && polygon->first_face == first;
    const std::int64_t last = first + (larger ? polygon->num_corners - 2 : 1);
    for (std::int64_t face = first; face < last; ++face) {
      if (!has_rows(faces_, face, vertices.size())) {
        const std::int32_t* row = faces_.row(face);
        throw FormatError("vertex index: expected " + std::to_string(first_index_) + " to " +
                              std::to_string(vertices.size() - 1 + first_index_) + ", got " +
                              std::to_string(*std::max_element(row, row + 3) + first_index_),
                          forward_[i].position);
      }
      complete.texcoords &= has_rows(face_texcoords_, face, texcoords.size());
      complete.normals &= has_rows(face_normals_, face, normals.size());
    }
  }
  return complete;
}

void MeshBuilder::add_not_finite(char coordinate, const FormatError::Position& position) {
  const bool is_line = position.line.has_value();
  const std::int64_t place = is_line ? *position.line : position.byte_offset.value_or(0);
  not_finite_.push_back(
      {place, static_cast<std::int32_t>(vertices.size() - 1), coordinate, is_line});
}

void MeshBuilder::check_positions() const {
  if (!not_finite_.empty()) refuse(not_finite_.front());
}

void MeshBuilder::refuse(const NotFinite& vertex) {
  const std::string reason = std::string(1, vertex.coordinate) + ": expected a finite number";
  if (vertex.is_line) throw FormatError::at_line(vertex.place, reason);
  throw FormatError::at_byte(vertex.place, reason);
}

void MeshBuilder::leave_out_not_finite(ReadResult& result) {
  if (not_finite_.empty()) return;
  std::vector<bool> is_used(vertices.size());
  // The triangles of a polygon have all of its corners.
  const std::span<std::int32_t> corners(faces_.row(0), 3 * faces_.size());
  for (const std::int32_t vertex : corners) is_used[vertex] = true;
  std::vector<bool> is_left_out(vertices.size());
  for (const NotFinite& each : not_finite_) {
    if (is_used[each.vertex]) refuse(each);
    is_left_out[each.vertex] = true;
  }
  std::vector<std::int32_t> new_index(vertices.size());
  std::int32_t kept = 0;
  for (std::size_t i = 0; i < new_index.size(); ++i) new_index[i] = is_left_out[i] ? kept : kept++;
  const auto is_kept = [&](std::int64_t i) { return !is_left_out[i]; };
  vertices.keep(is_kept);
  colors.keep(is_kept);
  for (std::int32_t& vertex : corners) vertex = new_index[vertex];
  for (std::int64_t i = 0; i < corners_.size(); ++i) *corners_.row(i) = new_index[*corners_.row(i)];
  warn(result.warnings,
       std::to_string(not_finite_.size()) +
           " vertices without a finite position, which no face uses, are left out");
}

void MeshBuilder::cut_polygons() {
  PolygonTriangulator triangulator;
  std::vector<Eigen::Vector3d> positions;
  for (const Polygon& polygon : polygons_) {
    positions.clear();
    for (std::int64_t c = 0; c < polygon.num_corners; ++c) {
      const std::int32_t vertex = corners_.row(polygon.first_corner + c)[0];
      positions.emplace_back(Eigen::Map<const Eigen::Vector3d>(vertices.row(vertex)));
    }
    std::int64_t face = polygon.first_face;
    for (const auto& triangle : triangulator.triangulate(positions)) {
      for (std::int64_t k = 0; k < 3; ++k) {
        const std::int32_t* corner = corners_.row(polygon.first_corner + triangle[k]);
        faces_.row(face)[k] = corner[0];
        if (!face_texcoords_.empty()) face_texcoords_.row(face)[k] = corner[1];
        if (!face_normals_.empty()) face_normals_.row(face)[k] = corner[2];
      }
      ++face;
    }
  }
}

Colors MeshBuilder::take_colors() {
  if (colors.empty()) return {};
  colors.fill(vertices.size(), std::numeric_limits<float>::quiet_NaN(), input_);
  const Rows<float, 3> values = colors.take();
  const float scale = are_bytes(values) ? 1.0F : 255.0F;
  Colors bytes(values.rows(), 3);
  for (Eigen::Index i = 0; i < values.size(); ++i) {
    const float value = std::isnan(values.data()[i]) ? 255.0F : scale * values.data()[i];
    bytes.data()[i] = static_cast<std::uint8_t>(std::lround(std::clamp(value, 0.0F, 255.0F)));
  }
  return bytes;
}

void MeshBuilder::use_face_colors(ReadResult& result) {
  if (face_colors_.empty()) return;
  TriangleMesh& mesh = result.mesh;
  if (mesh.colors.rows() > 0 || mesh.face_material.rows() > 0) {
    const char* others = mesh.colors.rows() > 0 ? "vertices" : "materials";
    warn(result.warnings,
         std::string("colors of faces are left out: there are those of ") + others);
    return;
  }
  face_colors_.fill(mesh.faces.rows(), kNone, input_);
  const Faces of_corners = face_colors_.take().replicate<1, 3>();
  const MeshView::Map<Faces> corner_colors(of_corners.data(), of_corners.rows(), 3);
  SurfaceColors found =
      surface_colors(mesh, static_cast<std::int32_t>(mesh.materials.size()), corner_colors);
  mesh.colors = std::move(found.colors);
  mesh.face_material = std::move(found.face_material);
  std::ranges::move(found.materials, std::back_inserter(mesh.materials));
  if (!found.warning.empty()) warn(result.warnings, found.warning);
}

void MeshBuilder::warn_of_losses(ReadResult& result) {
  result.num_skipped += num_short_;
  if (num_short_ > 0) {
    warn(result.warnings, std::to_string(num_short_) +
                              " faces of fewer than 3 corners are left out, the first at " +
                              place(first_short_));
  }
}

void MeshBuilder::finish(ReadResult& result) {
  warn_of_losses(result);
  const Complete complete = check_forward_references();
  constexpr const char* kMissing = " are left out: faces name some that the file does not hold";
  if (!complete.texcoords) {
    warn(result.warnings, std::string("texture coordinates") + kMissing);
    face_texcoords_.take();
    texcoords.take();
  }
  if (!complete.normals) {
    warn(result.warnings, std::string("normals") + kMissing);
    face_normals_.take();
    normals.take();
  }
  // Adds rows for faces that were read after the last one with the attribute.
  if (!face_texcoords_.empty()) face_texcoords_.fill(faces_.size(), kNone, input_);
  if (!face_normals_.empty()) face_normals_.fill(faces_.size(), kNone, input_);
  if (!face_material_.empty()) face_material_.fill(faces_.size(), kNone, input_);
  leave_out_not_finite(result);
  cut_polygons();
  if (may_have_nan) {
    leave_out_nan(texcoords.row(0), texcoords.size(), 2, face_texcoords_.row(0),
                  face_texcoords_.size(), "texture coordinates", result.warnings);
    leave_out_nan(normals.row(0), normals.size(), 3, face_normals_.row(0), face_normals_.size(),
                  "normals", result.warnings);
  }
  result.num_polygons = num_polygons_;
  TriangleMesh& mesh = result.mesh;
  mesh.colors = take_colors();
  mesh.vertices = vertices.take();
  mesh.texcoords = texcoords.take();
  mesh.normals = normals.take();
  mesh.faces = faces_.take();
  mesh.face_texcoords = face_texcoords_.take();
  mesh.face_normals = face_normals_.take();
  mesh.face_material = face_material_.take();
  use_face_colors(result);
}

}  // namespace manip3d
