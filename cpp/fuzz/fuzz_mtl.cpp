#include <cmath>
#include <cstdlib>
#include <span>
#include <string>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/io/mtl.hpp"

// Reads the bytes as a material library: materials with factors in [0, 1] and textures with a path,
// or a FormatError with a line.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace manip3d;
  const std::span<const std::byte> bytes(reinterpret_cast<const std::byte*>(data), size);
  try {
    const auto source = memory_source(bytes);
    std::vector<std::string> warnings;
    for (const Material& m : read_mtl(*source, "m.mtl", warnings)) {
      for (const double value : {m.base_color[0], m.base_color[1], m.base_color[2], m.base_color[3],
                                 m.metallic, m.roughness}) {
        if (!(value >= 0.0 && value <= 1.0)) std::abort();
      }
      for (const auto& [role, texture] : m.textures) {
        if (texture.path.empty()) std::abort();
      }
    }
  } catch (const FormatError& error) {
    if (!error.position().line) std::abort();
  }
  return 0;
}
