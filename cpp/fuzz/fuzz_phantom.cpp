// The phantom limb with arbitrary skeletons, depth images, cameras and times: an InputError, or
// images and a mesh of finite numbers, with indices in range.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "checks.hpp"
#include "manip3d/error.hpp"
#include "manip3d/modify/phantom_pipeline.hpp"
#include "mesh_from_bytes.hpp"

namespace {

using namespace manip3d;
using fuzzing::require;

constexpr std::int64_t kCols = 40, kRows = 36;
constexpr std::size_t kSize = kCols * kRows;

struct Images {
  std::array<float, kSize> depth;
  std::array<float, 3 * kSize> vertices;
  std::array<float, 2 * kSize> texcoords;
  std::array<std::uint8_t, kSize> label;
  std::array<PixelKind, kSize> kind;
  std::array<std::int32_t, 2 * kSize> source, pixels;
  std::array<std::int32_t, 6 * kSize> faces;
};

Skeleton take_skeleton(fuzzing::Bytes& bytes) {
  Skeleton s;
  const auto style = bytes.take<std::uint8_t>();
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    for (int i = 0; i < 3; ++i) {
      s.positions[joint][i] = (style & 1) != 0
                                  ? bytes.take<float>()
                                  : 0.02F * bytes.take<std::int8_t>() + (i == 2 ? 2.0F : 0.0F);
    }
    s.states[joint] =
        static_cast<TrackingState>((style & 2) != 0 ? bytes.take<std::uint8_t>() % 3 : 2);
    if ((style & 4) != 0) {
      for (float& q : s.orientations[joint]) q = bytes.take<float>();
    }
  }
  s.id = bytes.take<std::uint8_t>() % 3;
  s.body = (style & 8) != 0 ? 0xff : bytes.take<std::uint8_t>() % 2;
  return s;
}

PhantomOptions take_options(fuzzing::Bytes& bytes) {
  PhantomOptions options;
  const auto choice = bytes.take<std::uint16_t>();
  options.affected = static_cast<Limb>(choice % 4);
  options.mode = static_cast<MirrorMode>(choice / 4 % 3);
  options.smooths = choice / 12 % 2 == 0;
  options.keep_residual = choice / 24 % 2 == 0;
  options.mesh.texturing = static_cast<Texturing>(choice / 48 % 2);
  options.segmentation = choice % 5 == 0 ? BoneRule::kPaper : BoneRule::kSkin;
  options.least_visible = 0.01 * (choice / 96 % 100);
  if (choice % 31 == 0) options.arm_radius = bytes.take<float>();
  if (choice % 29 == 0) options.mask.margin = bytes.take<float>();
  return options;
}

void check(const PhantomReport& report, const Images& out) {
  const auto vertices = report.mesh.num_vertices;
  require(vertices >= report.num_points && vertices <= static_cast<std::int64_t>(kSize));
  for (std::size_t i = 0; i < 3 * static_cast<std::size_t>(vertices); ++i) {
    require(std::isfinite(out.vertices[i]));
  }
  for (std::int64_t i = 0; i < 3 * report.mesh.num_faces; ++i) {
    const std::int32_t vertex = out.faces[i];
    require(vertex >= 0 && vertex < vertices);
  }
  for (std::size_t i = 0; i < kSize; ++i) {
    const bool shows = out.kind[i] != PixelKind::kNone;
    require(shows == (out.depth[i] > 0.0F) && out.label[i] < kNumJoints);
    const std::int32_t row = out.source[2 * i], col = out.source[2 * i + 1];
    require(shows ? row >= 0 && row < kRows && col >= 0 && col < kCols : row == -1 && col == -1);
  }
  require(report.opacity >= 0.0 && report.opacity <= 1.0);
  for (const Eigen::Vector3f& p : report.skeleton.positions) require(p.allFinite());
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  fuzzing::Bytes bytes(data, std::min<std::size_t>(size, 8192));
  static Images out;
  static std::array<std::uint16_t, kSize> millimetres;
  static std::array<float, kSize> metres;
  static std::array<std::uint8_t, kSize> body_index;
  static std::array<float, 2 * kSize> rays;
  try {
    PhantomPipeline pipeline(take_options(bytes));
    const int frames = 1 + bytes.take<std::uint8_t>() % 4;
    std::int64_t time_ns = 0;
    for (int k = 0; k < frames; ++k) {
      const auto style = bytes.take<std::uint8_t>();
      PhantomInput input;
      input.camera = {
          kCols,   kRows,           35.0, (style & 1) != 0 ? -35.0 : 35.0, 19.5, 17.5, {},
          nullptr, (style & 2) != 0};
      Registration registration;
      registration.color = {64, 48, 50.0, 50.0, 30.0, 20.0, {}, nullptr, false};
      if ((style & 4) != 0) input.registration = &registration;
      if ((style & 48) == 16) input.camera.distortion[0] = bytes.take<float>();
      std::vector<Skeleton> people;
      const int count = bytes.take<std::uint8_t>() % 3;
      for (int i = 0; i < count; ++i) people.push_back(take_skeleton(bytes));
      input.people = people;
      time_ns += static_cast<std::int64_t>(bytes.take<std::int16_t>()) * 1'000'000;
      input.time_ns = time_ns;
      const auto pattern = bytes.take<std::uint8_t>();
      for (std::size_t i = 0; i < kSize; ++i) {
        const bool wild = (pattern & 1) != 0;
        const auto near_two = static_cast<std::uint16_t>(1900 + (i * pattern) % 200);
        millimetres[i] = wild ? bytes.take<std::uint16_t>() : near_two;
        metres[i] = wild ? bytes.take<float>() : 0.001F * near_two;
        body_index[i] = static_cast<std::uint8_t>((i * pattern) % 5 == 0 ? 0xff : i / 700);
        if ((style & 48) == 32) {
          rays[2 * i] = (static_cast<float>(i % kCols) - 19.5F) / 35.0F;
          rays[2 * i + 1] = wild ? bytes.take<float>() : static_cast<float>(i / kCols) / 35.0F;
        }
      }
      if ((style & 48) == 32 && !input.camera.mirrored) input.camera.ray_table = rays.data();
      input.depth = {kRows, kCols, (style & 64) != 0 ? millimetres.data() : nullptr,
                     (style & 64) != 0 ? nullptr : metres.data()};
      if ((style & 128) != 0) input.body_index = body_index.data();
      const PhantomReport report =
          pipeline.process(input, {out.depth.data(),
                                   out.label.data(),
                                   out.kind.data(),
                                   out.source.data(),
                                   {kSize, out.vertices.data(), out.pixels.data(),
                                    out.texcoords.data(), out.faces.data()}});
      if (report.state != PhantomState::kLate) check(report, out);
    }
  } catch (const InputError&) {
  }
  return 0;
}
