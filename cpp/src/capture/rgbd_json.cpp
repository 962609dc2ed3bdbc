#include "capture/rgbd_json.hpp"

#include <cmath>
#include <cstring>
#include <limits>
#include <span>

#include "geometry/constants.hpp"
#include "manip3d/capture/recorder.hpp"
#include "parse/base64.hpp"

namespace manip3d {
namespace {

using Json = JsonPlace::Json;

// --- numbers ------------------------------------------------------------------------------------

Json exact(double value) {
  if (std::isfinite(value)) return value;
  if (std::isnan(value)) return "nan";
  return value > 0.0 ? "inf" : "-inf";
}

double exact(const JsonPlace& place) {
  if (!place.is_text()) return place.number();
  const std::string& word = place.text();
  if (word == "inf") return kInfinity;
  if (word == "-inf") return -kInfinity;
  if (word != "nan") place.fail("expected a number, \"nan\", \"inf\" or \"-inf\"");
  return std::numeric_limits<double>::quiet_NaN();
}

template <typename T>
Json exact_list(const T* values, std::size_t count) {
  Json list = Json::array();
  for (std::size_t i = 0; i < count; ++i) list.push_back(exact(static_cast<double>(values[i])));
  return list;
}

template <typename T>
void read_list(const JsonPlace& place, T* values, std::int64_t count) {
  if (place.size() != count) place.fail("expected " + std::to_string(count) + " numbers");
  for (std::int64_t i = 0; i < count; ++i) values[i] = static_cast<T>(exact(place.item(i)));
}

// --- cameras ------------------------------------------------------------------------------------

Json camera_to_json(const Intrinsics& camera) {
  Json json = {{"width", camera.width}, {"height", camera.height}, {"fx", camera.fx},
               {"fy", camera.fy},       {"cx", camera.cx},         {"cy", camera.cy}};
  json["distortion"] = exact_list(camera.distortion.data(), camera.distortion.size());
  json["mirrored"] = camera.mirrored;
  return json;
}

Intrinsics camera_from_json(const JsonPlace& place) {
  Intrinsics camera;
  camera.width = place.member("width").integer(1, kMaxImageSide);
  camera.height = place.member("height").integer(1, kMaxImageSide);
  camera.fx = place.member("fx").number();
  camera.fy = place.member("fy").number();
  camera.cx = place.member("cx").number();
  camera.cy = place.member("cy").number();
  if (const auto k = place.find("distortion")) read_list(*k, camera.distortion.data(), 5);
  if (const auto mirrored = place.find("mirrored")) camera.mirrored = mirrored->boolean();
  return camera;
}

std::vector<float> rays_from_json(const JsonPlace& place, const Intrinsics& camera) {
  const std::vector<std::byte> bytes = decode_base64(place, place.text());
  const std::size_t expected = 2 * camera.width * camera.height;
  if (bytes.size() != expected * sizeof(float)) {
    place.fail("expected two floats for each of " + std::to_string(camera.width) + " x " +
               std::to_string(camera.height) + " pixels, got " + std::to_string(bytes.size()) +
               " bytes");
  }
  std::vector<float> rays(expected);
  std::memcpy(rays.data(), bytes.data(), bytes.size());
  return rays;
}

Registration registration_from_json(const JsonPlace& place) {
  Registration registration;
  registration.color = camera_from_json(place.member("colour"));
  Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rotation;
  read_list(place.member("rotation"), rotation.data(), 9);
  registration.rotation = rotation;
  read_list(place.member("translation"), registration.translation.data(), 3);
  return registration;
}

// --- skeletons ----------------------------------------------------------------------------------

Json skeleton_to_json(const Skeleton& skeleton) {
  Json positions = Json::array(), orientations = Json::array(), states = Json::array();
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    for (const float x : skeleton.positions[joint]) positions.push_back(exact(x));
    for (const float q : skeleton.orientations[joint]) orientations.push_back(exact(q));
    states.push_back(static_cast<int>(skeleton.states[joint]));
  }
  return {{"id", skeleton.id},
          {"body", skeleton.body},
          {"positions", std::move(positions)},
          {"orientations", std::move(orientations)},
          {"states", std::move(states)}};
}

Skeleton skeleton_from_json(const JsonPlace& place) {
  Skeleton skeleton;
  constexpr std::int64_t kMaxNumber = std::numeric_limits<std::int64_t>::max();
  skeleton.id = place.member("id").integer(std::numeric_limits<std::int64_t>::min(), kMaxNumber);
  skeleton.body = static_cast<std::uint8_t>(place.member("body").integer(0, kNoBody));
  static_assert(sizeof(skeleton.positions) == 3 * kNumJoints * sizeof(float));
  static_assert(sizeof(skeleton.orientations) == 4 * kNumJoints * sizeof(float));
  read_list(place.member("positions"), skeleton.positions[0].data(), 3 * kNumJoints);
  read_list(place.member("orientations"), skeleton.orientations[0].data(), 4 * kNumJoints);
  const JsonPlace states = place.member("states");
  if (states.size() != kNumJoints) states.fail("expected 25 numbers");
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    skeleton.states[joint] =
        static_cast<TrackingState>(states.item(static_cast<std::int64_t>(joint)).integer(0, 2));
  }
  return skeleton;
}

}  // namespace

Json calibration_to_json(const RgbdCalibration& calibration) {
  Json json = {{"depth", camera_to_json(calibration.depth)}};
  if (calibration.depth.ray_table != nullptr) {
    const auto size =
        static_cast<std::size_t>(2 * calibration.depth.width * calibration.depth.height);
    json["depth"]["rays"] =
        encode_base64(std::as_bytes(std::span(calibration.depth.ray_table, size)));
  }
  if (const auto& registration = calibration.registration) {
    const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rotation = registration->rotation;
    json["registration"] = {{"colour", camera_to_json(registration->color)},
                            {"rotation", exact_list(rotation.data(), 9)},
                            {"translation", exact_list(registration->translation.data(), 3)}};
  }
  return json;
}

std::shared_ptr<RgbdCalibration> calibration_from_json(const JsonPlace& place) {
  auto calibration = std::make_shared<RgbdCalibration>();
  const JsonPlace depth = place.member("depth");
  calibration->depth = camera_from_json(depth);
  if (const auto rays = depth.find("rays")) {
    calibration->ray_table = rays_from_json(*rays, calibration->depth);
    calibration->depth.ray_table = calibration->ray_table.data();
  }
  try {
    check_intrinsics(calibration->depth, "depth");
    if (const auto registration = place.find("registration")) {
      calibration->registration = registration_from_json(*registration);
      check_registration(*calibration->registration);
    }
  } catch (const InputError& error) {
    place.fail(error.what());
  }
  return calibration;
}

Json skeletons_to_json(const std::vector<Skeleton>& skeletons) {
  Json list = Json::array();
  for (const Skeleton& skeleton : skeletons) list.push_back(skeleton_to_json(skeleton));
  return list;
}

void skeletons_from_json(const JsonPlace& place, std::vector<Skeleton>& skeletons) {
  if (place.size() > static_cast<std::int64_t>(kMaxSkeletons)) {
    place.fail("expected at most 64 skeletons");
  }
  skeletons.clear();
  for (std::int64_t i = 0; i < place.size(); ++i) {
    skeletons.push_back(skeleton_from_json(place.item(i)));
  }
}

}  // namespace manip3d
