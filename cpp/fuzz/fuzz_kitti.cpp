#include "fuzz_points.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  manip3d::fuzz_points(data, size, manip3d::PointFormat::kKitti);
  manip3d::fuzz_points(data, size, manip3d::PointFormat::kNuScenes);
  return 0;
}
