// Arbitrary changes of a picture with a record, and arbitrary bits in place of the record: only the
// signed picture is accepted.
#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <vector>

#include "checks.hpp"
#include "manip3d/authenticate/watermark.hpp"

namespace {

using namespace manip3d;
using fuzzing::require;
using Samples = std::vector<std::uint8_t>;

PictureView view_of(const Samples& samples) {
  return {samples, 32, static_cast<std::uint32_t>(samples.size() / 32), 1};
}

WatermarkKey fresh_key() {
  const auto path = std::filesystem::temp_directory_path() / "manip3d-fuzz-picture.key";
  std::filesystem::remove(path);
  WatermarkKey::create(path, 1);
  WatermarkKey made(path);
  std::filesystem::remove(path);
  return made;
}

// A scan, its picture with the record, and their verifier.
struct Signed {
  WatermarkKey key = fresh_key();
  PointCloud cloud;
  WatermarkedScan sent;
  WatermarkVerifier verifier{key};
  WatermarkPolicy policy;

  Signed() {
    cloud.points.resize(40, 3);
    for (Eigen::Index row = 0; row < 40; ++row) {
      const auto value = static_cast<float>(row);
      cloud.points.row(row) << value - 20.0F, 3.0F - value, 0.125F * value;
    }
    const Samples plain(kCarrierSamples + 32, 77);
    WatermarkFrame frame;
    frame.picture = view_of(plain);
    sent = WatermarkEmbedder(key, WatermarkId{}).embed(cloud, frame);
    cloud.points = sent.points;
    policy.any_order = true;
  }

  bool accepts(const Samples& samples, std::span<const std::uint8_t> record) {
    verifier.reset();
    return verifier.verify(cloud, record, policy, 0, 0, {}, view_of(samples)).verdict ==
           WatermarkVerdict::kAuthentic;
  }
};

std::optional<Samples> record_or_nothing(const Samples& samples) {
  try {
    return record_in(view_of(samples));
  } catch (const FormatError& error) {
    require(!error.reason().empty());
    return std::nullopt;
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static Signed known;
  Samples samples = known.sent.picture;
  for (std::size_t i = 0; i + 2 < size; i += 3) {
    samples[(data[i] + 256U * data[i + 1]) % samples.size()] ^= data[i + 2];
  }
  if (const auto record = record_or_nothing(samples)) {
    require(known.accepts(samples, *record) == (samples == known.sent.picture));
  }
  // The input itself in place of the record.
  Samples others = without_record(view_of(known.sent.picture));
  for (std::size_t i = 0; i < std::min(8 * size, kCarrierSamples); ++i) {
    others[i] = static_cast<std::uint8_t>(others[i] | ((data[i / 8] >> (i % 8)) & 1));
  }
  if (const auto record = record_or_nothing(others)) {
    require(record->size() <= kMaxCarried);
    const std::size_t shared = std::min(size, record->size());
    require(std::equal(data, data + shared, record->begin()));
    require(!known.accepts(others, *record) || others == known.sent.picture);
  }
  return 0;
}
