#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "manip3d/geometry/mesh.hpp"

/// @file
/// Code that the programs of this folder share. Each is called as
///   PROGRAM METHOD INPUT TARGET_FACES OUTPUT.ply
/// and prints one line of JSON: {"cpu_s", "wall_s", "base_bytes", "peak_bytes"}, or {"refused"}
/// with the reason why the library cannot take the mesh.
namespace peers {

/// The library cannot take this mesh; no fault of ours.
struct Refusal {
  std::string reason;
};

/// Time and memory of a library's own call, without reading, conversion and writing.
struct Cost {
  double cpu_s = 0.0;
  double wall_s = 0.0;
  long base_bytes = 0;  ///< Resident before the call: program and input.
  long peak_bytes = 0;  ///< Most resident during the call.
};
Cost measure(const std::function<void()>& call);

/// Simplifies `input` to `target_faces` and says what the library's call cost.
using Method = std::function<manip3d::TriangleMesh(const manip3d::TriangleMesh& input,
                                                   std::int64_t target_faces, Cost& cost)>;
/// The method of that name.
using FindMethod = std::function<Method(const std::string& name)>;

int peer_main(int argc, char** argv, const FindMethod& find_method);

}  // namespace peers
