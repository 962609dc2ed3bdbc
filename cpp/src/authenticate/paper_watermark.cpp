#include "manip3d/authenticate/paper_watermark.hpp"

#include <algorithm>
#include <array>
#include <string>
#include <utility>

#include "authenticate/canonical_order.hpp"
#include "authenticate/lattice_samples.hpp"
#include "authenticate/little_endian.hpp"
#include "authenticate/watermark_suite.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr double kCellQuarters = 1600.0;  // quarters of the step of 2.5 mm, per metre

void check(const PaperOptions& options, std::span<const std::uint8_t> blocks) {
  if (options.block_bits < 1 || options.block_bits > 1'000'000) {
    throw InputError("block_bits: expected 1 to 1000000, got " +
                     std::to_string(options.block_bits));
  }
  const auto expected =
      static_cast<std::size_t>(options.slices) * static_cast<std::size_t>(options.block_bits);
  if (blocks.size() != expected) {
    throw InputError("blocks: expected slices x block_bits values, got " +
                     std::to_string(blocks.size()));
  }
  if (std::any_of(blocks.begin(), blocks.end(), [](std::uint8_t bit) { return bit > 1; })) {
    throw InputError("blocks: expected zeros and ones");
  }
}

WatermarkEmbedding keyed_kind(PaperEmbedding embedding) {
  return embedding == PaperEmbedding::kLbm ? WatermarkEmbedding::kLbm : WatermarkEmbedding::kQim;
}

WatermarkOrder order_of(PaperEmbedding embedding) {
  return embedding == PaperEmbedding::kQimPrinted ? WatermarkOrder::kColumnsFirst
                                                  : WatermarkOrder::kHeightFirst;
}

// Does the order of two points depend on what embedding changes? Such points carry their bits in
// ascending order.
bool are_tied(const WatermarkSample& a, const WatermarkSample& b, PaperEmbedding embedding) {
  if (embedding != PaperEmbedding::kQimPrinted) return a == b;
  return a.x == b.x && a.y == b.y && a.intensity == b.intensity;
}

// Calls `use(begin, end)` for each run of tied points of a tile.
template <typename Use>
void for_each_tie(const TiledSamples& tiled, std::size_t tile, PaperEmbedding embedding,
                  const Use& use) {
  const std::size_t end = tiled.begins[tile + 1];
  for (std::size_t begin = tiled.begins[tile]; begin < end;) {
    std::size_t run = begin + 1;
    while (run < end && are_tied(tiled.samples[begin], tiled.samples[run], embedding)) ++run;
    if (run > begin + 1) use(begin, run);
    begin = run;
  }
}

// Assigns a block to each tile, and a bit of the block to each of its points.
class Assignment {
 public:
  explicit Assignment(const PaperOptions& options) : options_(options) {
    TagHash hash;
    std::array<std::uint8_t, 8> number;
    store(options.key_2, number.data());
    hash.update("m3d-paper-key2");
    hash.update(number);
    key_ = hash.finish();
    block_of_ =
        keyed_permutation(key_, nonce(0xFFFFFFFFU, 0), static_cast<std::uint32_t>(options.slices));
  }

  // Finds the indices in `blocks` of the bits of `count` points. Each group of M points carries the
  // whole block in an order of its own, and the last group a part of it.
  void places(std::size_t tile, std::size_t count, std::vector<std::uint32_t>& found) const {
    const auto size = static_cast<std::uint32_t>(options_.block_bits);
    const std::uint32_t first = block_of_[tile] * size;
    found.clear();
    for (std::uint32_t group = 0; found.size() < count; ++group) {
      for (const std::uint32_t bit :
           keyed_permutation(key_, nonce(static_cast<std::uint32_t>(tile), group), size)) {
        if (found.size() == count) break;
        found.push_back(first + bit);
      }
    }
  }

 private:
  [[nodiscard]] std::array<std::uint8_t, 12> nonce(std::uint32_t tile, std::uint32_t group) const {
    std::array<std::uint8_t, 12> bytes;
    store(options_.frame, bytes.data());
    store(tile, bytes.data() + 4);
    store(group, bytes.data() + 8);
    return bytes;
  }

  PaperOptions options_;
  WatermarkTag key_;
  std::vector<std::uint32_t> block_of_;
};

// The bits of a tile's points; those of tied points are in ascending order.
void expected_bits(const TiledSamples& tiled, std::size_t tile, PaperEmbedding embedding,
                   std::span<const std::uint8_t> blocks, const std::vector<std::uint32_t>& places,
                   std::vector<std::uint8_t>& bits) {
  bits.clear();
  for (const std::uint32_t place : places) bits.push_back(blocks[place]);
  for_each_tie(tiled, tile, embedding, [&](std::size_t begin, std::size_t end) {
    const auto at = [&](std::size_t i) {
      return bits.begin() + static_cast<std::ptrdiff_t>(i - tiled.begins[tile]);
    };
    std::sort(at(begin), at(end));
  });
}

// Equations 7.1 to 7.3: the quantised z in quarters of the step (2.5 mm) for z in units of 1 mm.
std::int64_t printed_quantizer(std::int64_t z, std::uint8_t bit) {
  const std::int64_t twice = 8 * z + 10;
  const std::int64_t n = (twice - ((twice % 20) + 20) % 20) / 20;  // floor(z / step + 1/2)
  if (bit == 1) return 4 * n;
  return 8 * z < 20 * n ? 4 * n - 2 : 4 * n + 2;
}

// Samples a received scan. For kQimPrinted, z is then in quarters of the step; points off the grid
// are rounded.
void sample_received(const PointsView& points, PaperEmbedding embedding, const SliceTable& slices,
                     LatticeSamples& found, std::vector<std::uint16_t>& slice_of) {
  sample_for_verification(points, keyed_kind(embedding), 1000, slices, found, slice_of);
  if (embedding != PaperEmbedding::kQimPrinted) return;
  for (std::size_t i = 0; i < found.samples.size(); ++i) {
    found.samples[i].z = 4 * found.samples[i].z + (found.marks[i] & 3);
  }
}

std::uint8_t bit_of(std::uint8_t mark, PaperEmbedding embedding) {
  const int rest = mark & 7;
  if (embedding == PaperEmbedding::kLbm) return rest == 7 ? 1 : rest == 0 ? 0 : 2;  // 2: neither
  if (embedding == PaperEmbedding::kQimCell) return rest >= 2 ? 1 : 0;
  // 1 at whole steps; 0 half a step beside them and at the quarters between
  return rest == 0 ? 1 : 0;
}

// Memory that is kept from frame to frame. At ten frames per second, returning it to the system
// after each frame and faulting it in again page by page took a third of the time.
struct PaperScratch {
  LatticeSamples found;
  std::vector<std::uint16_t> slice_of;
  CanonicalOrder order;
  TiledSamples tiled;
};

PaperScratch& scratch_of_thread() {
  thread_local PaperScratch scratch;
  return scratch;
}

}  // namespace

PaperMarked embed_paper(const PointsView& points, std::span<const std::uint8_t> blocks,
                        const PaperOptions& options) {
  check_points(points);
  const SliceTable slices(options.slices);
  check(options, blocks);
  if (points.num_points() == 0) throw InputError("points: expected at least one, got none");
  const bool printed = options.embedding == PaperEmbedding::kQimPrinted;
  auto& [found, slice_of, order, tiled] = scratch_of_thread();
  WatermarkOptions sampling;
  sampling.embedding = keyed_kind(options.embedding);
  sample_for_embedding(points, sampling, slices, found, slice_of);
  if (printed) {
    for (std::size_t i = 0; i < found.samples.size(); ++i) {
      const double z = points.points(static_cast<Eigen::Index>(i), 2);
      found.samples[i].z = static_cast<std::int32_t>(nearest_unit(z));
    }
  }
  PaperMarked result;
  const std::vector<std::uint32_t> counts = count_slices(slice_of, options.slices);
  PaperMetadata& metadata = result.metadata;
  metadata.tile_of =
      merge_slices(counts, static_cast<std::uint32_t>(options.block_bits), options.merge);
  const int num_tiles = 1 + *std::max_element(metadata.tile_of.begin(), metadata.tile_of.end());
  order.sort(found.samples, {}, slice_of, metadata.tile_of, num_tiles, order_of(options.embedding),
             tiled);

  result.points.resize(points.num_points(), 3);
  const Assignment assignment(options);
  std::vector<std::uint32_t> places;
  std::vector<std::uint8_t> bits;
  for (std::size_t t = 0; t + 1 < tiled.begins.size(); ++t) {
    const std::size_t begin = tiled.begins[t], size = tiled.begins[t + 1] - begin;
    metadata.counts.push_back(static_cast<std::uint32_t>(size));
    assignment.places(t, size, places);
    expected_bits(tiled, t, options.embedding, blocks, places, bits);
    for (std::size_t j = 0; j < size; ++j) found.marks[tiled.rows[begin + j]] = bits[j];
  }
  write_samples(found, keyed_kind(options.embedding), 1000, result.points.data());
  if (options.embedding == PaperEmbedding::kLbm) return result;
  for (std::size_t i = 0; i < found.samples.size(); ++i) {
    const WatermarkSample& sample = found.samples[i];
    float& z = result.points.data()[3 * i + 2];
    if (printed) {
      z = static_cast<float>(static_cast<double>(printed_quantizer(sample.z, found.marks[i])) /
                             kCellQuarters);
    } else if (is_no_return(sample)) {  // here all points carry bits, also those at the origin
      z = static_cast<float>((found.marks[i] != 0 ? 3.0 : 1.0) / kCellQuarters);
    }
  }
  return result;
}

PaperComparison compare_paper(const PointsView& points, std::span<const std::uint8_t> blocks,
                              const PaperMetadata& metadata, const PaperOptions& options) {
  check_points(points);
  const SliceTable slices(options.slices);
  check(options, blocks);
  const std::size_t num_tiles = metadata.counts.size();
  const bool fits = metadata.tile_of.size() == static_cast<std::size_t>(options.slices) &&
                    num_tiles >= 1 && num_tiles <= metadata.tile_of.size() &&
                    std::all_of(metadata.tile_of.begin(), metadata.tile_of.end(),
                                [&](std::uint16_t tile) { return tile < num_tiles; });
  if (!fits) throw InputError("metadata: expected a tile of each slice, and a count of each tile");
  auto& [found, slice_of, order, tiled] = scratch_of_thread();
  sample_received(points, options.embedding, slices, found, slice_of);
  order.sort(found.samples, found.marks, slice_of, metadata.tile_of, static_cast<int>(num_tiles),
             order_of(options.embedding), tiled);

  PaperComparison result;
  const Assignment assignment(options);
  std::vector<std::uint32_t> places;
  std::vector<std::uint8_t> expected;
  std::vector<std::pair<std::uint8_t, std::uint32_t>> read;  // bit and row
  std::vector<std::uint8_t> and_read(blocks.size()), and_expected(blocks.size());
  for (std::size_t t = 0; t < num_tiles; ++t) {
    const std::size_t begin = tiled.begins[t], size = tiled.begins[t + 1] - begin;
    assignment.places(t, size, places);
    expected_bits(tiled, t, options.embedding, blocks, places, expected);
    read.clear();
    for (std::size_t j = 0; j < size; ++j) {
      read.emplace_back(bit_of(tiled.marks[begin + j], options.embedding), tiled.rows[begin + j]);
    }
    for_each_tie(tiled, t, options.embedding, [&](std::size_t first, std::size_t last) {
      std::sort(read.begin() + static_cast<std::ptrdiff_t>(first - begin),
                read.begin() + static_cast<std::ptrdiff_t>(last - begin));
    });
    for (const std::uint32_t place : places) and_read[place] = and_expected[place] = 1;
    std::int64_t mismatches = 0;
    for (std::size_t j = 0; j < size; ++j) {
      and_read[places[j]] &= read[j].first;
      and_expected[places[j]] &= expected[j];
      if (read[j].first == expected[j]) continue;
      ++mismatches;
      result.rows.push_back(static_cast<std::int32_t>(read[j].second));
    }
    // The first group has each bit of the block once; later groups repeat them.
    const auto once = places.begin() + static_cast<std::ptrdiff_t>(std::min<std::size_t>(
                                           size, static_cast<std::size_t>(options.block_bits)));
    result.and_mismatches.push_back(std::count_if(places.begin(), once, [&](std::uint32_t place) {
      return and_read[place] != and_expected[place];
    }));
    result.mismatches.push_back(mismatches);
    result.counts.push_back(static_cast<std::uint32_t>(size));
  }
  std::sort(result.rows.begin(), result.rows.end());
  return result;
}

}  // namespace manip3d
