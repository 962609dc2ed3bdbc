// The cross-modal check on arbitrary scans, disparity maps, pictures, cameras and options: an
// InputError, or maps, regions and suspected points that are consistent and do not depend on the
// order of points.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "checks.hpp"
#include "manip3d/authenticate/cross_modal.hpp"
#include "scan_from_bytes.hpp"

namespace {

using namespace manip3d;
using fuzzing::require;
using fuzzing::run;

CrossModalOptions take_options(fuzzing::Bytes& bytes) {
  CrossModalOptions options;
  options.azimuth_step = 2.0;
  options.elevation_step = 2.0;
  const auto changed = bytes.take<std::uint16_t>();
  int bit = 0;
  using Options = CrossModalOptions;
  for (double Options::* const field :
       {&Options::azimuth_step, &Options::elevation_step, &Options::half_azimuth, &Options::lowest,
        &Options::highest, &Options::min_range, &Options::max_range, &Options::tolerance,
        &Options::dark_level, &Options::dark_weight, &Options::min_added_area,
        &Options::min_missing_area, &Options::heading}) {
    if ((changed >> bit++ & 1) != 0) options.*field = fuzzing::take_number(bytes);
  }
  options.min_cells = bytes.take<std::int8_t>();
  // Maps of millions of cells are tested elsewhere.
  if (std::abs(options.azimuth_step) < 0.125) options.azimuth_step = 0.125;
  if (std::abs(options.elevation_step) < 0.125) options.elevation_step = 0.125;
  return options;
}

StereoView take_camera(fuzzing::Bytes& bytes) {
  StereoView camera{20.0, 15.5, 7.5, 0.5, Eigen::Matrix4d::Identity()};
  camera.lidar_from_camera << 0, 0, 1, 0.27, -1, 0, 0, 0, 0, -1, 0, -0.08, 0, 0, 0, 1;
  const auto changed = bytes.take<std::uint8_t>();
  if ((changed & 1) != 0) camera.focal = fuzzing::take_number(bytes);
  if ((changed & 2) != 0) camera.baseline = fuzzing::take_number(bytes);
  if ((changed & 4) != 0) camera.center_u = fuzzing::take_number(bytes);
  if ((changed & 8) != 0) {
    for (double& x : camera.lidar_from_camera.reshaped()) x = fuzzing::take_number(bytes);
  }
  return camera;
}

void check_regions(const CrossModalResult& found, const CrossModalOptions& options) {
  std::int64_t marked[2] = {0, 0}, counted[2] = {0, 0};
  for (std::size_t cell = 0; cell < found.mask.size(); ++cell) {
    require(found.mask[cell] >= -1 && found.mask[cell] <= 1 && found.judged[cell] <= 1);
    if (found.mask[cell] != 0) {
      require(found.judged[cell] == 1);
      ++marked[found.mask[cell] > 0 ? 1 : 0];
    }
  }
  for (std::size_t k = 0; k < found.components.size(); ++k) {
    const CrossModalComponent& each = found.components[k];
    counted[each.added ? 1 : 0] += each.cells;
    require(each.cells >= options.min_cells && each.empty <= each.cells);
    require(each.dark <= each.empty && !(each.added && each.empty > 0));
    require(each.behind >= 0 && each.behind <= each.cells - each.empty);
    require(each.behind == 0 || !each.added);
    require(each.evidence >= (each.added ? options.min_added_area : options.min_missing_area));
    require(each.evidence <= each.area * (1.0 + 1e-9));
    require((each.lower.array() <= each.upper.array()).all());
    require(k == 0 || found.components[k - 1].area >= each.area);
  }
  require(marked[0] == counted[0] && marked[1] == counted[1]);
}

void check(const PointCloud& scan, const DisparityView& disparity, const StereoView& camera,
           const CrossModalOptions& options) {
  const CrossModalResult found = compare_cross_modal(scan, disparity, camera, options);
  const auto cells = static_cast<std::size_t>(found.rows * found.columns);
  require(found.mask.size() == cells && found.judged.size() == cells);
  require(found.lidar.size() == cells && found.stereo.size() == cells);
  require(found.difference.size() == cells);
  check_regions(found, options);
  require(found.suspected.size() == found.suspected_component.size());
  require(std::is_sorted(found.suspected.begin(), found.suspected.end()));
  require(found.judged_points <= scan.points.rows());
  for (std::size_t i = 0; i < found.suspected.size(); ++i) {
    require(found.suspected[i] >= 0 && found.suspected[i] < scan.points.rows());
    const std::int32_t k = found.suspected_component[i];
    require(k >= 0 && k < static_cast<std::int64_t>(found.components.size()));
    const CrossModalComponent& region = found.components[k];
    const Eigen::Vector3d point = scan.points.row(found.suspected[i]).transpose().cast<double>();
    require(region.added);
    if (options.heading != 0.0) continue;  // with a heading, the box has other axes
    require((point.array() >= region.lower.array()).all() &&
            (point.array() <= region.upper.array()).all());
  }
  PointCloud turned = scan;
  turned.points = scan.points.colwise().reverse().eval();
  const CrossModalResult again = compare_cross_modal(turned, disparity, camera, options);
  require(again.mask == found.mask && again.judged_points == found.judged_points);
  require(again.suspected.size() == found.suspected.size());
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  fuzzing::Bytes bytes(data, std::min<std::size_t>(size, 8192));
  const CrossModalOptions options = take_options(bytes);
  const StereoView camera = take_camera(bytes);
  const auto style = bytes.take<std::uint8_t>();
  const PointCloud scan = fuzzing::take_scan(bytes);
  const std::int64_t width = 1 + bytes.take<std::uint8_t>() % 48;
  const std::int64_t height = 1 + bytes.take<std::uint8_t>() % 24;
  std::vector<float> disparity(static_cast<std::size_t>(width * height));
  std::vector<std::uint8_t> grey(disparity.size());
  const float everywhere = 0.125F * static_cast<float>(bytes.take<std::int8_t>());
  for (std::size_t i = 0; i < disparity.size(); ++i) {
    if ((style & 3) == 0) {
      disparity[i] = everywhere;
    } else if ((style & 3) == 1) {
      disparity[i] = bytes.take<float>();
    } else {
      disparity[i] = 0.125F * static_cast<float>(bytes.take<std::int8_t>());
    }
    grey[i] = static_cast<std::uint8_t>(style + i);
  }
  const DisparityView view{disparity.data(), height, width,
                           (style & 4) != 0 ? grey.data() : nullptr};
  run([&] { check(scan, view, camera, options); });
  return 0;
}
