#include <cstdio>
#include <span>
#include <string_view>

#include "manip3d/error.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/io/mesh_file.hpp"
#include "manip3d/metrics/metro.hpp"

// Reads a mesh, measures it, and catches the error of a damaged one.
int main() {
  constexpr std::string_view kSquare = "v 0 0 0\nv 3 0 0\nv 3 4 0\nv 0 4 0\nf 1 2 3 4\n";
  const auto read = [](std::string_view text) {
    return manip3d::read_mesh(std::as_bytes(std::span(text)), manip3d::MeshFormat::kObj).mesh;
  };
  const manip3d::TriangleMesh mesh = read(kSquare);
  const manip3d::MetroResult found = manip3d::metro(mesh, mesh);
  bool is_refused = false;
  try {
    read("f 1 2 9\n");
  } catch (const manip3d::FormatError& error) {
    is_refused = error.position().line == 1;
  }
  std::printf("%s: %d faces, diagonal %g\n", MANIP3D_VERSION, static_cast<int>(mesh.faces.rows()),
              found.diagonal);
  return mesh.faces.rows() == 2 && found.diagonal == 5.0 && is_refused ? 0 : 1;
}
