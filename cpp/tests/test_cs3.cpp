#include <gtest/gtest.h>

#include <cstdint>
#include <vector>

#include "allocations.hpp"
#include "manip3d/error.hpp"
#include "manip3d/simplify/cs3.hpp"

namespace manip3d {
namespace {

using testing::kCountsAllocations;
using testing::num_allocations;

struct Arrays {
  std::vector<float> vertices, texcoords;
  std::vector<std::int32_t> pixels, faces;

  explicit Arrays(std::size_t capacity)
      : vertices(3 * capacity),
        texcoords(2 * capacity),
        pixels(2 * capacity),
        faces(6 * capacity) {}
  DepthMeshBuffers buffers() {
    return {static_cast<std::int64_t>(pixels.size() / 2), vertices.data(), pixels.data(),
            texcoords.data(), faces.data()};
  }
};

// A person-like shape that sways, with new noise in each frame.
std::vector<std::uint16_t> sway(int frame, std::int64_t width, std::int64_t height) {
  std::vector<std::uint16_t> depth(width * height);
  std::uint32_t noise = 12345U + static_cast<std::uint32_t>(frame);
  for (std::int64_t v = 0; v < height; ++v) {
    for (std::int64_t u = 0; u < width; ++u) {
      noise = noise * 1664525U + 1013904223U;
      const double x = (static_cast<double>(u) - 160.0 - 4.0 * (frame % 7)) / 90.0;
      const double y = (static_cast<double>(v) - 120.0) / 110.0;
      if (x * x + y * y > 1.0) continue;
      depth[v * width + u] =
          static_cast<std::uint16_t>(1500.0 + 300.0 * (x * x + y * y) + (noise >> 30));
    }
  }
  return depth;
}

TEST(Cs3, AllocatesNothingAfterTheTenthFrame) {
  if (!kCountsAllocations) GTEST_SKIP() << "sanitizers allocate in their own way";
  constexpr std::int64_t kWidth = 320, kHeight = 240;
  const PixelRays rays({kWidth, kHeight, 290.0, 290.0, 160.0, 120.0, {}, nullptr, false});
  Registration registration;
  registration.color = {640, 480, 525.0, 525.0, 320.0, 240.0, {}, nullptr, false};
  std::vector<std::vector<std::uint16_t>> frames;
  for (int frame = 0; frame < 30; ++frame) frames.push_back(sway(frame, kWidth, kHeight));
  Arrays out(1000);
  for (const auto sampling : {Cs3Sampling::kImportanceOrder, Cs3Sampling::kNonMaximum}) {
    Cs3 cs3;
    Cs3Options options;
    options.target_points = 1000;
    options.sampling = sampling;
    options.num_threads = 1;
    options.max_edge = 0.1;
    options.distance_dependent = true;
    for (std::size_t frame = 0; frame < frames.size(); ++frame) {
      const std::int64_t before = num_allocations();
      const DepthView depth{kHeight, kWidth, frames[frame].data(), nullptr};
      const Cs3Report report =
          cs3.run(RangeImage(depth, rays), options, &registration, out.buffers());
      if (frame >= 10) {
        EXPECT_EQ(num_allocations(), before) << "frame " << frame;
      }
      EXPECT_LE(report.num_vertices, 1000);
      EXPECT_GE(report.num_vertices, 990);
      EXPECT_GT(report.num_faces, 1000);
    }
  }
}

TEST(Cs3, RefusesTooLittleRoom) {
  const PixelRays rays({8, 6, 10.0, 10.0, 4.0, 3.0, {}, nullptr, false});
  const std::vector<float> depth(48, 1.0F);
  const DepthView view{6, 8, nullptr, depth.data()};
  Arrays out(20);
  Cs3Options options;
  options.target_points = 21;
  EXPECT_THROW(Cs3().run(RangeImage(view, rays), options, nullptr, out.buffers()), InputError);
  options.target_points = 20;
  EXPECT_EQ(Cs3().run(RangeImage(view, rays), options, nullptr, out.buffers()).num_vertices, 20);
}

}  // namespace
}  // namespace manip3d
