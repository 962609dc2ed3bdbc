#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <random>
#include <utility>
#include <vector>

#include "forge/texture_sampler.hpp"
#include "manip3d/forge/composite.hpp"

namespace manip3d {
namespace {

/// Red grows with the column, green with the row, blue with both.
std::vector<std::uint8_t> ramps(std::int64_t rows, std::int64_t cols) {
  std::vector<std::uint8_t> pixels;
  for (std::int64_t v = 0; v < rows; ++v) {
    for (std::int64_t u = 0; u < cols; ++u) {
      pixels.push_back(static_cast<std::uint8_t>(3 * u));
      pixels.push_back(static_cast<std::uint8_t>(4 * v));
      pixels.push_back(static_cast<std::uint8_t>(u + 2 * v));
    }
  }
  return pixels;
}

Intrinsics camera(std::int64_t width, std::int64_t height) {
  Intrinsics k;
  k.width = width;
  k.height = height;
  k.fx = k.fy = static_cast<double>(width);
  k.cx = 0.5 * static_cast<double>(width - 1);
  k.cy = 0.5 * static_cast<double>(height - 1);
  return k;
}

TEST(TextureSampler, BlendsFourPixelsInWholeNumbers) {
  std::mt19937 random(7);
  std::uniform_int_distribution<int> byte(0, 255);
  for (const auto& [rows, cols] : {std::pair(1, 1), {1, 6}, {6, 1}, {2, 2}, {7, 5}}) {
    std::vector<std::uint8_t> pixels(static_cast<std::size_t>(3 * rows * cols));
    for (std::uint8_t& p : pixels) p = static_cast<std::uint8_t>(byte(random));
    const TextureSampler sample({rows, cols, pixels.data()});
    for (float y = -1.3F; y < static_cast<float>(rows) + 1.0F; y += 0.171F) {
      for (float x = -1.3F; x < static_cast<float>(cols) + 1.0F; x += 0.143F) {
        const float u = std::clamp(x, 0.0F, static_cast<float>(cols - 1));
        const float v = std::clamp(y, 0.0F, static_cast<float>(rows - 1));
        const int u0 = static_cast<int>(u), v0 = static_cast<int>(v);
        const int u1 = std::min(u0 + 1, cols - 1), v1 = std::min(v0 + 1, rows - 1);
        const int fu = static_cast<int>((u - static_cast<float>(u0)) * 256.0F + 0.5F);
        const int fv = static_cast<int>((v - static_cast<float>(v0)) * 256.0F + 0.5F);
        std::uint32_t expected = 0;
        for (int channel = 2; channel >= 0; --channel) {
          const auto at = [&](int row, int col) {
            return pixels[3 * (row * cols + col) + channel];
          };
          const int above = (256 - fu) * at(v0, u0) + fu * at(v0, u1);
          const int under = (256 - fu) * at(v1, u0) + fu * at(v1, u1);
          expected = expected << 8 |
                     static_cast<std::uint32_t>(((256 - fv) * above + fv * under + 0x8000) >> 16);
        }
        ASSERT_EQ(sample.packed(x, y), expected) << rows << "x" << cols << " at " << x << ", " << y;
      }
    }
  }
}

/// Triangles all over an image: some cover several pixels, some none, and some reach beyond the
/// edge.
struct Confetti {
  std::vector<float> vertices;
  std::vector<std::int32_t> faces, pixels;

  Confetti(const Intrinsics& k, int count, float size) {
    std::mt19937 random(3);
    const auto between = [&](float least, float most) {
      return std::uniform_real_distribution<float>(least, most)(random);
    };
    for (int i = 0; i < count; ++i) {
      const float u = between(-4.0F, static_cast<float>(k.width) + 4.0F);
      const float v = between(-4.0F, static_cast<float>(k.height) + 4.0F), z = between(1.0F, 3.0F);
      for (int corner = 0; corner < 3; ++corner) {
        const float cu = u + between(-size, size), cv = v + between(-size, size);
        const float cz = z + between(-0.05F, 0.05F);
        vertices.insert(vertices.end(),
                        {(cu - static_cast<float>(k.cx)) / static_cast<float>(k.fx) * cz,
                         (cv - static_cast<float>(k.cy)) / static_cast<float>(k.fy) * cz, cz});
        faces.push_back(3 * i + corner);
        pixels.insert(pixels.end(), {static_cast<std::int32_t>(cu), static_cast<std::int32_t>(cv)});
      }
    }
  }
};

/// The nearest triangle at a pixel centre, computed in double from the definition of barycentric
/// coordinates.
struct Nearest {
  double z = std::numeric_limits<double>::infinity();
  double texel_u = 0.0, texel_v = 0.0;
  /// No edge passes through the pixel centre, and no other triangle is equally near.
  bool is_clear = true;
};

Nearest nearest_at(const Confetti& person, const Intrinsics& k, int u, int v, bool perspective) {
  Nearest found;
  for (std::size_t f = 0; f + 2 < person.faces.size(); f += 3) {
    std::array<double, 3> x{}, y{}, z{}, w{};
    for (std::size_t i = 0; i < 3; ++i) {
      const float* p = &person.vertices[3 * (f + i)];
      z[i] = p[2];
      x[i] = k.fx * p[0] / z[i] + k.cx;
      y[i] = k.fy * p[1] / z[i] + k.cy;
    }
    const double area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0]);
    for (std::size_t i = 0; i < 3; ++i) {
      const std::size_t j = (i + 1) % 3, l = (i + 2) % 3;
      w[i] = ((x[j] - u) * (y[l] - v) - (y[j] - v) * (x[l] - u)) / area;
    }
    const double least = std::min({w[0], w[1], w[2]});
    if (std::abs(least) < 0.01) found.is_clear = false;
    if (!(least > 0.0)) continue;
    const double depth = perspective ? 1.0 / (w[0] / z[0] + w[1] / z[1] + w[2] / z[2])
                                     : w[0] * z[0] + w[1] * z[1] + w[2] * z[2];
    if (std::abs(depth - found.z) < 1e-3) found.is_clear = false;
    if (!(depth < found.z)) continue;
    found.z = depth;
    found.texel_u = found.texel_v = 0.0;
    for (std::size_t i = 0; i < 3; ++i) {
      found.texel_u += w[i] * person.pixels[2 * (f + i)];
      found.texel_v += w[i] * person.pixels[2 * (f + i) + 1];
    }
  }
  return found;
}

TEST(Composite, DrawsWhatASearchOverAllTrianglesFinds) {
  const Intrinsics k = camera(67, 45);
  for (const float size : {0.7F, 2.5F, 9.0F}) {
    const Confetti person(k, 300, size);
    const std::vector<std::uint16_t> behind(static_cast<std::size_t>(k.width * k.height), 0);
    const std::vector<std::uint8_t> own = ramps(k.height, k.width), grey(own.size(), 200);
    const auto count = static_cast<std::int64_t>(person.vertices.size() / 3);
    const PersonSurface surface{count,
                                count / 3,
                                person.vertices.data(),
                                person.faces.data(),
                                person.vertices.data(),
                                person.pixels.data(),
                                {k.height, k.width, own.data()},
                                std::nullopt};
    const SceneView scene{k.height, k.width, behind.data(), k, {k.height, k.width, grey.data()},
                          {}};
    std::vector<std::uint16_t> depth(behind.size());
    std::vector<std::uint8_t> mask(behind.size()), color(own.size());
    CompositeOptions options;
    options.blend = 0;
    composite(surface, scene, options, {depth.data(), mask.data(), color.data()});
    std::int64_t clear = 0, drawn = 0;
    for (int v = 0; v < k.height; ++v) {
      for (int u = 0; u < k.width; ++u) {
        const auto pixel = static_cast<std::size_t>(v * k.width + u);
        const Nearest in_depth = nearest_at(person, k, u, v, true);
        const Nearest in_color = nearest_at(person, k, u, v, false);
        if (!in_depth.is_clear || !in_color.is_clear) continue;
        ++clear;
        const bool is_drawn = std::isfinite(in_depth.z);
        drawn += is_drawn ? 1 : 0;
        ASSERT_EQ(mask[pixel], is_drawn ? 1 : 0) << u << ", " << v;
        const auto expected = [&](int channel) {
          if (!is_drawn) return 200.0;
          const double x = std::clamp(in_color.texel_u, 0.0, static_cast<double>(k.width - 1));
          const double y = std::clamp(in_color.texel_v, 0.0, static_cast<double>(k.height - 1));
          return channel == 0 ? 3.0 * x : channel == 1 ? 4.0 * y : x + 2.0 * y;
        };
        EXPECT_NEAR(depth[pixel], is_drawn ? 1000.0 * in_depth.z : 0.0, 1.0) << u << ", " << v;
        for (int channel = 0; channel < 3; ++channel) {
          EXPECT_NEAR(color[3 * pixel + static_cast<std::size_t>(channel)], expected(channel), 1.0)
              << u << ", " << v << ", " << channel;
        }
      }
    }
    EXPECT_GT(clear, 1000);
    EXPECT_GT(drawn, 20);
  }
}

/// A faded pixel has as large a share of the person as the square around it.
TEST(Composite, FadesByTheShareOfTheSquareAround) {
  const Intrinsics k = camera(67, 45);
  const Confetti person(k, 60, 6.0F);
  const std::vector<std::uint16_t> behind(static_cast<std::size_t>(k.width * k.height), 0);
  const std::vector<std::uint8_t> white(static_cast<std::size_t>(3 * k.width * k.height), 250);
  const std::vector<std::uint8_t> black(white.size(), 0);
  const auto count = static_cast<std::int64_t>(person.vertices.size() / 3);
  const PersonSurface surface{count,
                              count / 3,
                              person.vertices.data(),
                              person.faces.data(),
                              person.vertices.data(),
                              person.pixels.data(),
                              {k.height, k.width, white.data()},
                              std::nullopt};
  const SceneView scene{k.height, k.width, behind.data(), k, {k.height, k.width, black.data()}, {}};
  std::vector<std::uint16_t> depth(behind.size());
  std::vector<std::uint8_t> mask(behind.size()), sharp(white.size()), faded(white.size());
  CompositeOptions options;
  options.blend = 0;
  composite(surface, scene, options, {depth.data(), mask.data(), sharp.data()});
  for (const int radius : {1, 2, 5, 64}) {
    options.blend = radius;
    composite(surface, scene, options, {depth.data(), mask.data(), faded.data()});
    const int size = 2 * radius + 1;
    for (int v = 0; v < k.height; ++v) {
      for (int u = 0; u < k.width; ++u) {
        int covered = 0;
        for (int y = std::max(v - radius, 0); y <= std::min<int>(v + radius, 44); ++y) {
          for (int x = std::max(u - radius, 0); x <= std::min<int>(u + radius, 66); ++x) {
            covered += sharp[static_cast<std::size_t>(3 * (y * k.width + x))] != 0 ? 1 : 0;
          }
        }
        const auto at = static_cast<std::size_t>(3 * (v * k.width + u));
        const int expected = sharp[at] != 0 ? (250 * covered + size * size / 2) / (size * size) : 0;
        ASSERT_EQ(faded[at], expected) << radius << ": " << u << ", " << v;
      }
    }
  }
}

}  // namespace
}  // namespace manip3d
