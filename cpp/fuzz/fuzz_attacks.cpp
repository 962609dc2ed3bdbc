// Attacks on arbitrary scans: an InputError, or a forgery whose ground truth fits its points.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "checks.hpp"
#include "manip3d/error.hpp"
#include "manip3d/forge/attacks.hpp"
#include "manip3d/forge/insertion.hpp"
#include "manip3d/forge/lattice.hpp"
#include "manip3d/forge/segment.hpp"
#include "scan_from_bytes.hpp"

namespace {

using namespace manip3d;
using fuzzing::require;
using fuzzing::run;

bool rows_of(const std::vector<std::int32_t>& rows, std::int64_t end) {
  return std::is_sorted(rows.begin(), rows.end()) &&
         (rows.empty() || (rows.front() >= 0 && rows.back() < end));
}

// Points that were not changed keep their order and their bits.
void check(const Forgery& forged, const PointCloud& scan) {
  const std::int64_t before = scan.points.rows();
  const std::int64_t after = static_cast<std::int64_t>(forged.points.size()) / 3;
  const auto size = [](const auto& rows) { return static_cast<std::int64_t>(rows.size()); };
  require(after == before - size(forged.removed) + size(forged.added));
  require(forged.intensity.size() == (scan.intensity.rows() > 0 ? after : 0));
  require(rows_of(forged.added, after) && rows_of(forged.moved, after));
  require(rows_of(forged.removed, before) && rows_of(forged.moved_from, before));
  require(forged.moved.size() == forged.moved_from.size());
  std::int64_t row = 0;
  std::size_t removed = 0;
  std::size_t moved = 0;
  for (std::int64_t old = 0; old < before; ++old) {
    if (removed < forged.removed.size() && forged.removed[removed] == old) {
      ++removed;
      continue;
    }
    if (moved < forged.moved.size() && forged.moved[moved] == row) {
      require(forged.moved_from[moved++] == old);
    } else {
      for (int axis = 0; axis < 3; ++axis) {
        require(forged.points[3 * row + axis] == scan.points(old, axis));
      }
    }
    ++row;
  }
  for (std::int64_t i = 0; i < static_cast<std::int64_t>(forged.points.size()); ++i) {
    require(std::isfinite(forged.points[i]));
  }
}

ScanLattice take_lattice(fuzzing::Bytes& bytes) {
  ScanLattice lattice;
  lattice.rings.resize(bytes.take<std::uint8_t>() % 9);
  for (ScanLattice::Ring& ring : lattice.rings) {
    ring.slope = fuzzing::take_number(bytes);
    ring.offset = fuzzing::take_number(bytes);
  }
  lattice.azimuth_step = 0.01 * fuzzing::take_number(bytes);
  const double phase = fuzzing::take_number(bytes);
  for (ScanLattice::Ring& ring : lattice.rings) ring.azimuth = phase;
  return lattice;
}

ObjectPlacement take_placement(fuzzing::Bytes& bytes) {
  ObjectPlacement placement;
  placement.position = fuzzing::take_place(bytes);
  placement.rotation = rotation_about_z(0.1 * bytes.take<std::int8_t>());
  placement.scale = 0.25 + std::abs(fuzzing::take_number(bytes));
  placement.translation =
      bytes.take<std::uint8_t>() % 2 == 0 ? Translation::kCentroid : Translation::kPaper;
  return placement;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  fuzzing::Bytes bytes(data, std::min<std::size_t>(size, 16384));
  const PointCloud scan = fuzzing::take_scan(bytes, 300);
  const PointCloud object = fuzzing::take_scan(bytes, 100);
  const ObjectPlacement placement = take_placement(bytes);
  const OrientedBox box = fuzzing::take_box(bytes);
  const Eigen::Vector3d origin = fuzzing::take_place(bytes);
  Faces faces(bytes.take<std::uint8_t>() % 8, 3);
  for (std::int32_t& v : faces.reshaped<Eigen::RowMajor>()) v = bytes.take<std::uint8_t>() % 101;

  run([&] { check(copy_transform_paste(scan, object, placement, 1), scan); });
  run([&] {
    ResampleOptions options;
    options.spacing = std::abs(fuzzing::take_number(bytes));
    options.method =
        bytes.take<std::uint8_t>() % 2 == 0 ? Resampling::kPoissonDisk : Resampling::kUniform;
    // A spacing far below the object's would need millions of points.
    const double extent =
        object.points.rows() > 0 ? static_cast<double>(object.points.cwiseAbs().maxCoeff()) : 0.0;
    if (!(options.spacing > extent / 20.0)) return;
    require(resample(object, faces, options).allFinite());
  });
  run([&] {
    require(local_spacing(scan, origin, std::abs(fuzzing::take_number(bytes)), 1) >= 0.0);
  });
  run([&] { check(subtract(scan, box, 1), scan); });
  run([&] {
    std::vector<std::int32_t> rows(bytes.take<std::uint8_t>() % 16);
    for (std::int32_t& row : rows) row = bytes.take<std::int16_t>() % 301;
    check(replace_rows(scan, rows, object, 1), scan);
    check(snap_to_lattice(scan, rows, take_lattice(bytes), {}, 1), scan);
  });
  run([&] {
    DeformOptions options;
    options.amplitude = fuzzing::take_number(bytes);
    options.direction =
        bytes.take<std::uint8_t>() % 2 == 0 ? Displacement::kRandom : Displacement::kNormal;
    options.origin = origin;
    check(deform(scan, box, options, 1), scan);
  });
  run([&] {
    Eigen::Matrix4d transform = Eigen::Matrix4d::Identity();
    transform.topLeftCorner<3, 3>() = placement.rotation;
    transform.topRightCorner<3, 1>() = origin;
    check(move_box(scan, box, transform, 1), scan);
  });
  run([&] {
    InsertionOptions options;
    options.origin = origin;
    options.range_noise = std::abs(fuzzing::take_number(bytes));
    if (bytes.take<std::uint8_t>() % 2 == 1) options.lattice = take_lattice(bytes);
    check(insert_occluding(scan, object, faces, placement, options, 1), scan);
  });
  run([&] {
    SegmentOptions options;
    options.origin = origin;
    options.max_range = std::abs(fuzzing::take_number(bytes));
    options.ground_height = fuzzing::take_number(bytes);
    options.ground_slope = fuzzing::take_number(bytes);
    options.tolerance = fuzzing::take_number(bytes);
    options.min_points = bytes.take<std::int8_t>();
    const Segmentation found = segment_objects(scan, options);
    require(static_cast<std::int64_t>(found.labels.size()) == scan.points.rows());
    for (const std::int32_t label : found.labels) {
      require(label >= Segmentation::kOther && label < static_cast<int>(found.boxes.size()));
    }
  });
  return 0;
}
