#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "capture/image_frames.hpp"
#include "manip3d/error.hpp"

// The first byte chooses how the others are read: c, as a calibration.json; f, as a line of
// frames.jsonl; otherwise as a list of a TUM sequence. The result must be cameras that pass
// check_intrinsics and names that stay in their folder, or a FormatError with a reason.
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

void tum_list(std::string_view text) {
  const std::vector<TimedFile> files =
      parse_tum_list(text, [](const std::string& name) { return name.size() % 2 == 0; }).files;
  for (std::size_t i = 0; i < files.size(); ++i) {
    check_inside(files[i].name);
    if (i > 0 && files[i].time_ns < files[i - 1].time_ns) std::abort();
  }
  const std::vector<TimedFile> first(files.begin(), files.begin() + std::ssize(files) / 2);
  const std::vector<TimedFile> rest(files.begin() + std::ssize(files) / 2, files.end());
  std::vector<bool> is_taken(rest.size());
  for (const std::int64_t partner : associate(first, rest, 20'000'000)) {
    if (partner < 0) continue;
    if (partner >= std::ssize(rest) || is_taken[partner]) std::abort();
    is_taken[partner] = true;
  }
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
    } else {
      manip3d::tum_list(text);
    }
  } catch (const manip3d::FormatError& error) {
    if (error.reason().empty()) std::abort();
  }
  return 0;
}
