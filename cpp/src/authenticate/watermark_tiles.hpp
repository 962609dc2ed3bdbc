#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <tuple>
#include <vector>

#include "authenticate/canonical_order.hpp"
#include "authenticate/lattice_samples.hpp"
#include "authenticate/watermark_record.hpp"
#include "authenticate/watermark_suite.hpp"
#include "manip3d/authenticate/watermark.hpp"

/// @file
/// Tags of tiles and records and the carrier bits of points, as computed by both embedder and
/// verifier of a watermark.
namespace manip3d {

/// Values of WatermarkHeader::carrier: a file beside the scan, or a picture.
inline constexpr std::uint8_t kBeside = 0, kInPicture = 1;
inline constexpr std::size_t kTagSize = std::tuple_size_v<WatermarkTag>;

WatermarkOrder order_of(WatermarkEmbedding embedding);

/// @throws InputError  the numbers of rows and points differ; a coordinate is not finite.
void check_exact(const PointsView& points, ExactView exact);

/// tag_i = BLAKE2b(K_tile, "m3d-tile" | header | i | count | samples), for each tile i.
std::vector<WatermarkTag> tags_of_tiles(const SessionKeys& keys,
                                        std::span<const std::uint8_t> header,
                                        const TiledSamples& tiled);

/// BLAKE2b(K_frame, domain | record | full tags).
WatermarkTag tag_of_record(const SessionKeys& keys, std::string_view domain,
                           std::span<const std::uint8_t> record,
                           const std::vector<WatermarkTag>& tags);

// Parts of a record's bytes: the body that its tags authenticate, the record tag (see
// own_tag_holds), and the frame tag.
std::span<const std::uint8_t> body_of(std::span<const std::uint8_t> record);
WatermarkTag frame_tag_of(std::span<const std::uint8_t> record);

/// Did the keys of this session make the record? Checks the record tag.
bool own_tag_holds(const SessionKeys& keys, std::span<const std::uint8_t> record);

/// Calls `use(place, bit)` for each point of a tile; `place` is its position in canonical order.
/// Identical points cannot be distinguished, so that their bits are in ascending order. Points at
/// the origin carry no bit and get 0.
template <typename Use>
void for_each_bit(const SessionKeys& keys, const WatermarkTag& tag, const TiledSamples& tiled,
                  std::size_t tile, std::vector<std::uint8_t>& stream, const Use& use) {
  const std::size_t begin = tiled.begins[tile], end = tiled.begins[tile + 1];
  carrier_bits(keys, tag, end - begin, stream);
  const auto bit = [&](std::size_t place) {
    const std::size_t i = place - begin;
    return static_cast<std::uint8_t>((stream[i / 8] >> (i % 8)) & 1U);
  };
  for (std::size_t place = begin; place < end;) {
    std::size_t run = place + 1;
    while (run < end && tiled.samples[run] == tiled.samples[place]) ++run;
    if (is_no_return(tiled.samples[place])) {
      for (; place < run; ++place) use(place, std::uint8_t{0});
    } else if (run == place + 1) {
      use(place, bit(place));
    } else {
      std::size_t ones = 0;
      for (std::size_t i = place; i < run; ++i) ones += bit(i);
      for (; place < run; ++place) use(place, static_cast<std::uint8_t>(run - place <= ones));
    }
    place = run;
  }
}

}  // namespace manip3d
