#include "fuzz_reader.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  manip3d::fuzz_reader(data, size, manip3d::MeshFormat::kPly);
  return 0;
}
