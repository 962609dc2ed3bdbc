#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>
#include <vector>

#include "capture/image_frames.hpp"
#include "capture/image_names.hpp"
#include "manip3d/error.hpp"

// The first byte chooses how the others are read: c, as a calibration.json; f, as a line of
// frames.jsonl; n, as names of images, one a line; otherwise as a list of a TUM sequence. The
// result must be cameras that pass check_intrinsics, names that stay in their folder, frames in
// ascending order, and pairs that share no image; or a FormatError with a reason.
namespace manip3d {
namespace {

void check_inside(const std::filesystem::path& path) {
  for (const auto& part : path) {
    if (part == "..") std::abort();
  }
  if (path.is_absolute()) std::abort();
}

void calibration(std::string_view text) {
  const auto found = parse_calibration(text);
  check_intrinsics(found->depth);
  const float* rays = found->depth.ray_table;
  const auto size = static_cast<std::size_t>(2 * found->depth.width * found->depth.height);
  if (rays != nullptr && (rays != found->ray_table.data() || found->ray_table.size() != size)) {
    std::abort();
  }
  if (found->registration) check_registration(*found->registration);
}

void frame_line(std::string_view text) {
  FrameFiles files;
  parse_frame_line(text, 1, "folder", files);
  for (const ImageFile* image : {&files.depth, &files.body_index, &files.color}) {
    check_inside(image->path);
  }
  for (const Skeleton& skeleton : files.skeletons) {
    for (const TrackingState state : skeleton.states) {
      if (state > TrackingState::kTracked) std::abort();
    }
  }
}

void check_partners(const std::vector<std::int64_t>& partners, std::size_t num_others) {
  std::vector<bool> is_taken(num_others);
  for (const std::int64_t partner : partners) {
    if (partner < 0) continue;
    if (partner >= std::ssize(is_taken) || is_taken[partner]) std::abort();
    is_taken[partner] = true;
  }
}

void image_names(std::string_view text) {
  std::vector<std::string> names;
  while (!text.empty()) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    names.emplace_back(text.substr(0, end));
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  for (const bool decimals : {false, true}) {
    const auto is_before = [decimals](const std::string& a, const std::string& b) {
      return comes_before(a, b, decimals);
    };
    std::ranges::sort(names, is_before);
    for (std::size_t i = 1; i < names.size(); ++i) {
      if (is_before(names[i], names[i - 1])) std::abort();
    }
  }
  for (const std::string& name : names) {
    if (time_in_name(name, ImageKind::kDepth).value_or(0) < 0) std::abort();
  }
  const std::vector<std::int64_t> indices = frame_indices(names);
  for (std::size_t i = 0; i < indices.size(); ++i) {
    if (i == 0 ? indices[0] != 0 : indices[i] <= indices[i - 1]) std::abort();
  }
  const std::vector<std::string> depth(names.begin(), names.begin() + std::ssize(names) / 2);
  const std::vector<std::string> color(names.begin() + std::ssize(names) / 2, names.end());
  check_partners(pair_by_name(depth, color), color.size());
}

void tum_list(std::string_view text) {
  const std::vector<TimedFile> files =
      parse_tum_list(text, [](const std::string& name) { return name.size() % 2 == 0; }).files;
  for (std::size_t i = 0; i < files.size(); ++i) {
    check_inside(files[i].name);
    if (i > 0 && files[i].time_ns < files[i - 1].time_ns) std::abort();
  }
  const std::vector<TimedFile> first(files.begin(), files.begin() + std::ssize(files) / 2);
  const std::vector<TimedFile> rest(files.begin() + std::ssize(files) / 2, files.end());
  check_partners(associate(first, rest, 20'000'000), rest.size());
}

}  // namespace
}  // namespace manip3d

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string_view text(reinterpret_cast<const char*>(data) + 1, size - 1);
  try {
    if (data[0] == 'c') {
      manip3d::calibration(text);
    } else if (data[0] == 'f') {
      manip3d::frame_line(text);
    } else if (data[0] == 'n') {
      manip3d::image_names(text);
    } else {
      manip3d::tum_list(text);
    }
  } catch (const manip3d::FormatError& error) {
    if (error.reason().empty()) std::abort();
  }
  return 0;
}
