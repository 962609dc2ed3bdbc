#include "authenticate/watermark_tiles.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "authenticate/little_endian.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

std::span<const std::uint8_t> bytes_of_samples(std::span<const WatermarkSample> samples) {
  return {reinterpret_cast<const std::uint8_t*>(samples.data()), samples.size_bytes()};
}

WatermarkTag tag_of_tile(const SessionKeys& keys, std::span<const std::uint8_t> header,
                         std::uint32_t tile, std::span<const WatermarkSample> samples) {
  std::array<std::uint8_t, 8> numbers;
  store(tile, numbers.data());
  store(static_cast<std::uint32_t>(samples.size()), numbers.data() + 4);
  TagHash hash(keys.tile());
  hash.update("m3d-tile");
  hash.update(header);
  hash.update(numbers);
  hash.update(bytes_of_samples(samples));
  return hash.finish();
}

std::span<const std::uint8_t> own_tag_of(std::span<const std::uint8_t> record) {
  return record.last(kRecordEnd).first(kTagSize);
}

}  // namespace

WatermarkOrder order_of(WatermarkEmbedding embedding) {
  return embedding == WatermarkEmbedding::kDetached ? WatermarkOrder::kPlain
                                                    : WatermarkOrder::kHeightFirst;
}

void check_exact(const PointsView& points, ExactView exact) {
  if (!exact.empty() && exact.size() != 3 * static_cast<std::size_t>(points.num_points())) {
    throw InputError("exact: expected as many rows as points");
  }
  if (!std::all_of(exact.begin(), exact.end(), [](double x) { return std::isfinite(x); })) {
    throw InputError("exact: expected finite coordinates");
  }
}

std::vector<WatermarkTag> tags_of_tiles(const SessionKeys& keys,
                                        std::span<const std::uint8_t> header,
                                        const TiledSamples& tiled) {
  std::vector<WatermarkTag> tags;
  for (std::size_t t = 0; t + 1 < tiled.begins.size(); ++t) {
    const std::uint32_t begin = tiled.begins[t];
    tags.push_back(
        tag_of_tile(keys, header, static_cast<std::uint32_t>(t),
                    std::span(tiled.samples).subspan(begin, tiled.begins[t + 1] - begin)));
  }
  return tags;
}

WatermarkTag tag_of_record(const SessionKeys& keys, std::string_view domain,
                           std::span<const std::uint8_t> record,
                           const std::vector<WatermarkTag>& tags) {
  TagHash hash(keys.frame());
  hash.update(domain);
  hash.update(record);
  for (const WatermarkTag& tag : tags) hash.update(tag);
  return hash.finish();
}

std::span<const std::uint8_t> body_of(std::span<const std::uint8_t> record) {
  return record.first(record.size() - kRecordEnd);
}

WatermarkTag frame_tag_of(std::span<const std::uint8_t> record) {
  WatermarkTag tag;
  std::copy_n(record.last(kTagSize).begin(), kTagSize, tag.begin());
  return tag;
}

bool own_tag_holds(const SessionKeys& keys, std::span<const std::uint8_t> record) {
  const WatermarkTag own =
      tag_of_record(keys, "m3d-record", body_of(record), {frame_tag_of(record)});
  return equal_in_constant_time(own, own_tag_of(record));
}

}  // namespace manip3d
