// Arbitrary bytes as a record, as a key file, as a verifier's state, and as a record with a scan: a
// typed error or a verdict, which is `authentic` only for the embedded data.
#include <algorithm>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <span>
#include <vector>

#include "checks.hpp"
#include "manip3d/authenticate/watermark.hpp"

namespace {

using namespace manip3d;
using fuzzing::require;

template <typename Call>
void expect_format_error(const Call& call) {
  try {
    call();
  } catch (const FormatError& error) {
    require(!error.reason().empty());
  }
}

PointCloud small_scan() {
  PointCloud cloud;
  cloud.points.resize(40, 3);
  for (Eigen::Index row = 0; row < 40; ++row) {
    const auto value = static_cast<float>(row);
    cloud.points.row(row) << value - 20.0F, 3.0F - value, 0.125F * value;
  }
  return cloud;
}

// A key, a scan with its record, and the same scan in float64 with coordinates of a national grid.
struct Known {
  WatermarkKey key;
  PointCloud cloud = small_scan();
  WatermarkedScan sent, sent_exact;

  static WatermarkKey make() {
    SecretBytes file(WatermarkKey::kFileSize);
    const auto path = std::filesystem::temp_directory_path() / "manip3d-fuzz.key";
    std::filesystem::remove(path);
    WatermarkKey::create(path, 1);
    WatermarkKey made(path);
    std::filesystem::remove(path);
    return made;
  }

  Known() : key(make()) {
    WatermarkEmbedder embedder(key, WatermarkId{});
    ExactPoints exact = cloud.points.cast<double>();
    exact.rowwise() += Eigen::RowVector3d(456'789.0, 5'428'123.0, 112.0);
    WatermarkFrame frame;
    frame.offset = {456'789'000, 5'428'123'000, 112'000};
    WatermarkEmbedder other(key, WatermarkId{});
    sent_exact = other.embed(cloud, frame, {exact.data(), static_cast<std::size_t>(exact.size())});
    sent = embedder.embed(cloud);
    cloud.points = sent.points;
  }
};

void check_record(std::span<const std::uint8_t> bytes) {
  expect_format_error([&] {
    const WatermarkRecord record = WatermarkRecord::parse(bytes);
    require(record.header.num_tiles >= 1);
    require(record.counts.size() == record.header.num_tiles);
    require(record.tags.size() == record.header.num_tiles);
    for (const std::uint16_t tile : record.header.tile_of) require(tile < record.header.num_tiles);
    require(record.header.units_per_m <= 1'000'000);
    for (const std::int64_t offset : record.header.offset) {
      require(offset == 0 || (record.header.is_exact && offset >= -(std::int64_t{1} << 37) &&
                              offset <= std::int64_t{1} << 37));
    }
  });
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static Known known;
  const std::span bytes(data, size);
  check_record(bytes);
  if (size >= 1 && size <= 4096) {
    SecretBytes file(size);
    std::copy(bytes.begin(), bytes.end(), file.data());
    expect_format_error([&] { require(WatermarkKey(file).is_open()); });
  }
  WatermarkVerifier verifier(known.key);
  expect_format_error([&] { verifier.restore(bytes); });
  WatermarkPolicy policy;
  policy.any_order = true;
  const bool same =
      std::equal(bytes.begin(), bytes.end(), known.sent.record.begin(), known.sent.record.end());
  require((verifier.verify(known.cloud, bytes, policy).verdict == WatermarkVerdict::kAuthentic) ==
          same);
  // The record, with some bytes changed by the input.
  std::vector<std::uint8_t> record = known.sent.record;
  for (std::size_t i = 0; i + 2 < size && i < 96; i += 3) {
    record[(data[i] + 256U * data[i + 1]) % record.size()] ^= data[i + 2];
  }
  check_record(record);
  const auto finding = verifier.verify(known.cloud, record, policy);
  require((finding.verdict == WatermarkVerdict::kAuthentic) == (record == known.sent.record));
  // Arbitrary float64 coordinates with the record of others.
  ExactPoints exact = known.sent_exact.exact;
  for (std::size_t i = 0; i + 9 <= size && i < 90; i += 9) {
    std::memcpy(exact.data() + data[i] % exact.size(), data + i + 1, sizeof(double));
  }
  try {
    WatermarkVerifier another(known.key);
    const auto found = another.verify(known.cloud, known.sent_exact.record, policy, 0, 0,
                                      {exact.data(), static_cast<std::size_t>(exact.size())});
    const double moved = (exact - known.sent_exact.exact).cwiseAbs().maxCoeff();
    require(found.verdict != WatermarkVerdict::kAuthentic || moved < 2e-7);
  } catch (const InputError&) {
    require(!exact.allFinite());
  }
  return 0;
}
