#include "fuzz_points.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  manip3d::fuzz_points(data, size, manip3d::PointFormat::kCsv);
  return 0;
}
