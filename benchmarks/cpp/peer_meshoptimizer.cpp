/// meshoptimizer: subset (positions alone), with attributes, and with attributes and update of
/// positions (optimal placement). The error limit is off, so that only the target stops it.
#include <meshoptimizer.h>

#include <Eigen/Geometry>
#include <array>
#include <limits>
#include <map>
#include <vector>

#include "peer.hpp"

namespace {

using manip3d::TriangleMesh;
using Index = Eigen::Index;
using FloatRows = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

constexpr float kNoErrorLimit = std::numeric_limits<float>::max();
// The library's examples take 0.5 to 1 for a component of the normal, more for texture coordinates.
constexpr float kNormalWeight = 0.5F;
constexpr float kTexcoordWeight = 1.0F;

/// A mesh the way graphics processors take it: one vertex per position, material and texture
/// coordinate.
struct VertexBuffer {
  std::vector<std::int32_t> vertex;    ///< Row of the input's vertices.
  std::vector<std::int32_t> texcoord;  ///< Row of the input's texture coordinates, or -1.
  std::vector<std::int32_t> material;
  std::vector<unsigned int> indices;
  FloatRows positions;

  [[nodiscard]] std::size_t size() const { return vertex.size(); }
};

VertexBuffer vertex_buffer(const TriangleMesh& mesh, bool with_attributes) {
  using Key = std::array<double, 5>;  // vertex, material, has texture coordinates, u, v
  std::map<Key, unsigned int> known;
  VertexBuffer buffer;
  for (Index f = 0; f < mesh.faces.rows(); ++f) {
    const std::int32_t material = mesh.face_material.rows() > 0 ? mesh.face_material(f) : -1;
    const bool textured =
        mesh.face_texcoords.rows() > 0 && mesh.face_texcoords.row(f).minCoeff() >= 0;
    for (int c = 0; c < 3; ++c) {
      const std::int32_t v = mesh.faces(f, c);
      const std::int32_t t = textured ? mesh.face_texcoords(f, c) : -1;
      Key key{static_cast<double>(v), 0, 0, 0, 0};
      if (with_attributes) {
        key[1] = material;
        if (textured) key = {key[0], key[1], 1, mesh.texcoords(t, 0), mesh.texcoords(t, 1)};
      }
      const auto [entry, is_new] =
          known.try_emplace(key, static_cast<unsigned int>(buffer.vertex.size()));
      if (is_new) {
        buffer.vertex.push_back(v);
        buffer.texcoord.push_back(with_attributes ? t : -1);
        buffer.material.push_back(material);
      }
      buffer.indices.push_back(entry->second);
    }
  }
  buffer.positions = mesh.vertices(buffer.vertex, Eigen::all).cast<float>();
  return buffer;
}

/// Area-weighted vertex normals and, where the mesh has any, texture coordinates.
FloatRows attributes_of(const TriangleMesh& mesh, const VertexBuffer& buffer) {
  Eigen::MatrixX3d normals = Eigen::MatrixX3d::Zero(mesh.vertices.rows(), 3);
  for (const auto& f : mesh.faces.rowwise()) {
    const Eigen::Vector3d p = mesh.vertices.row(f(0)), q = mesh.vertices.row(f(1)),
                          r = mesh.vertices.row(f(2));
    const Eigen::RowVector3d area = (q - p).cross(r - p);
    for (int c = 0; c < 3; ++c) normals.row(f(c)) += area;
  }
  normals.rowwise().normalize();
  const bool textured = mesh.texcoords.rows() > 0;
  FloatRows attributes = FloatRows::Zero(static_cast<Index>(buffer.size()), textured ? 5 : 3);
  for (std::size_t i = 0; i < buffer.size(); ++i) {
    auto row = attributes.row(static_cast<Index>(i));
    row.head<3>() = normals.row(buffer.vertex[i]).cast<float>();
    if (buffer.texcoord[i] >= 0)
      row.tail<2>() = mesh.texcoords.row(buffer.texcoord[i]).cast<float>();
  }
  return attributes;
}

std::vector<float> weights_of(const FloatRows& attributes) {
  std::vector<float> weights(static_cast<std::size_t>(attributes.cols()), kNormalWeight);
  for (std::size_t i = 3; i < weights.size(); ++i) weights[i] = kTexcoordWeight;
  return weights;
}

/// The mesh that the index buffer is left with; `updated`: positions are the buffer's.
TriangleMesh to_mesh(const TriangleMesh& input, const VertexBuffer& buffer, bool with_attributes,
                     const FloatRows* updated_attributes) {
  TriangleMesh mesh;
  std::vector<std::int32_t> output(buffer.size(), -1);
  std::vector<std::int32_t> used;
  mesh.faces.resize(static_cast<Index>(buffer.indices.size() / 3), 3);
  for (std::size_t i = 0; i < buffer.indices.size(); ++i) {
    std::int32_t& row = output[buffer.indices[i]];
    if (row < 0) {
      row = static_cast<std::int32_t>(used.size());
      used.push_back(static_cast<std::int32_t>(buffer.indices[i]));
    }
    mesh.faces(static_cast<Index>(i / 3), static_cast<Index>(i % 3)) = row;
  }
  mesh.vertices.resize(static_cast<Index>(used.size()), 3);
  for (std::size_t i = 0; i < used.size(); ++i) {
    const auto row = static_cast<Index>(i);
    if (updated_attributes != nullptr) {
      mesh.vertices.row(row) = buffer.positions.row(used[i]).cast<double>();
    } else {
      mesh.vertices.row(row) = input.vertices.row(buffer.vertex[static_cast<std::size_t>(used[i])]);
    }
  }
  if (!with_attributes) return mesh;
  if (input.face_material.rows() > 0) {
    mesh.face_material.resize(mesh.faces.rows());
    for (Index f = 0; f < mesh.faces.rows(); ++f) {
      mesh.face_material(f) = buffer.material[buffer.indices[static_cast<std::size_t>(3 * f)]];
    }
  }
  if (input.texcoords.rows() == 0) return mesh;
  mesh.texcoords.setZero(mesh.vertices.rows(), 2);
  mesh.face_texcoords = mesh.faces;
  for (std::size_t i = 0; i < used.size(); ++i) {
    const std::int32_t t = buffer.texcoord[static_cast<std::size_t>(used[i])];
    if (t < 0) continue;
    if (updated_attributes != nullptr) {
      mesh.texcoords.row(static_cast<Index>(i)) =
          updated_attributes->row(used[i]).tail<2>().cast<double>();
    } else {
      mesh.texcoords.row(static_cast<Index>(i)) = input.texcoords.row(t);
    }
  }
  for (Index f = 0; f < mesh.faces.rows(); ++f) {
    for (int c = 0; c < 3; ++c) {
      const unsigned int wedge = buffer.indices[static_cast<std::size_t>(3 * f + c)];
      if (buffer.texcoord[wedge] < 0) mesh.face_texcoords(f, c) = -1;
    }
  }
  return mesh;
}

constexpr std::size_t kPositionStride = 3 * sizeof(float);

TriangleMesh subset(const TriangleMesh& input, std::int64_t target, peers::Cost& cost) {
  VertexBuffer buffer = vertex_buffer(input, false);
  std::vector<unsigned int> out(buffer.indices.size());
  cost = peers::measure([&] {
    out.resize(meshopt_simplify(out.data(), buffer.indices.data(), buffer.indices.size(),
                                buffer.positions.data(), buffer.size(), kPositionStride,
                                static_cast<std::size_t>(3 * target), kNoErrorLimit));
  });
  buffer.indices = std::move(out);
  return to_mesh(input, buffer, false, nullptr);
}

TriangleMesh with_attributes(const TriangleMesh& input, std::int64_t target, peers::Cost& cost) {
  VertexBuffer buffer = vertex_buffer(input, true);
  const FloatRows attributes = attributes_of(input, buffer);
  const std::vector<float> weights = weights_of(attributes);
  std::vector<unsigned int> out(buffer.indices.size());
  cost = peers::measure([&] {
    out.resize(meshopt_simplifyWithAttributes(
        out.data(), buffer.indices.data(), buffer.indices.size(), buffer.positions.data(),
        buffer.size(), kPositionStride, attributes.data(), weights.size() * sizeof(float),
        weights.data(), weights.size(), nullptr, static_cast<std::size_t>(3 * target),
        kNoErrorLimit));
  });
  buffer.indices = std::move(out);
  return to_mesh(input, buffer, true, nullptr);
}

TriangleMesh with_update(const TriangleMesh& input, std::int64_t target, peers::Cost& cost) {
  VertexBuffer buffer = vertex_buffer(input, true);
  FloatRows attributes = attributes_of(input, buffer);
  const std::vector<float> weights = weights_of(attributes);
  cost = peers::measure([&] {
    buffer.indices.resize(meshopt_simplifyWithUpdate(
        buffer.indices.data(), buffer.indices.size(), buffer.positions.data(), buffer.size(),
        kPositionStride, attributes.data(), weights.size() * sizeof(float), weights.data(),
        weights.size(), nullptr, static_cast<std::size_t>(3 * target), kNoErrorLimit));
  });
  return to_mesh(input, buffer, true, &attributes);
}

peers::Method find_method(const std::string& name) {
  if (name == "subset") return subset;
  if (name == "attributes") return with_attributes;
  if (name == "update") return with_update;
  return {};
}

}  // namespace

int main(int argc, char** argv) { return peers::peer_main(argc, argv, find_method); }
