#include "capture/azure_calibration.hpp"

#include <Eigen/LU>
#include <array>
#include <cmath>
#include <string>

#include "geometry/constants.hpp"
#include "geometry/small_solvers.hpp"

namespace manip3d {
namespace {

constexpr double kUsualRadius = 1.7;  // the SDK's default, which applies if the calibration has 0

/// The lens: maps rays to distorted rays, both in units of the focal length, by OpenCV's rational
/// model.
struct Lens {
  std::array<double, 6> k{};
  double p1 = 0.0, p2 = 0.0;
  double max_radius = 0.0;  ///< Largest length of a ray: beyond it the model does not hold.

  [[nodiscard]] Eigen::Vector2d distort(const Eigen::Vector2d& ray, Eigen::Matrix2d& slope) const {
    const double x = ray.x(), y = ray.y(), r2 = ray.squaredNorm();
    const double over = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]));
    const double under = 1.0 + r2 * (k[3] + r2 * (k[4] + r2 * k[5]));
    const double radial = over / under;
    const double d_over = k[0] + r2 * (2.0 * k[1] + r2 * 3.0 * k[2]);
    const double d_under = k[3] + r2 * (2.0 * k[4] + r2 * 3.0 * k[5]);
    const double d_radial = (d_over - radial * d_under) / under;  // derivative by r2
    slope = radial * Eigen::Matrix2d::Identity() + 2.0 * d_radial * ray * ray.transpose();
    slope(0, 0) += 2.0 * p1 * y + 6.0 * p2 * x;
    slope(0, 1) += 2.0 * p1 * x + 2.0 * p2 * y;
    slope(1, 0) += 2.0 * p1 * x + 2.0 * p2 * y;
    slope(1, 1) += 2.0 * p2 * x + 6.0 * p1 * y;
    return radial * ray + Eigen::Vector2d(2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                                          2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y));
  }

  /// The inverse of distort() by Newton's method; none if it does not converge or the model does
  /// not hold.
  [[nodiscard]] std::optional<Eigen::Vector2d> undistort(const Eigen::Vector2d& distorted) const {
    constexpr int kMaxSteps = 20;
    constexpr double kSettled = 1e-10;
    Eigen::Vector2d ray = distorted;
    Eigen::Matrix2d slope;
    for (int i = 0; i < kMaxSteps; ++i) {
      const Eigen::Vector2d error = distort(ray, slope) - distorted;
      if (error.squaredNorm() < kSettled * kSettled) {
        return ray.norm() <= max_radius ? std::optional(ray) : std::nullopt;
      }
      ray -= slope.inverse() * error;
    }
    return std::nullopt;
  }
};

/// A camera as stored: in units of the width and height of the whole sensor.
struct StoredCamera {
  double cx = 0.0, cy = 0.0, fx = 0.0, fy = 0.0;
  Lens lens;
  Eigen::Matrix3d rotation;  // from the rig
  Eigen::Vector3d translation;
};

template <typename Values>
void read_numbers(const JsonPlace& place, std::int64_t count, Values&& values) {
  if (place.size() != count) place.fail("expected " + std::to_string(count) + " numbers");
  for (std::int64_t i = 0; i < count; ++i) values[i] = place.item(i).number();
}

StoredCamera read_camera(const JsonPlace& cameras, const std::string& location) {
  for (std::int64_t i = 0; i < cameras.size(); ++i) {
    const JsonPlace place = cameras.item(i);
    if (place.member("Location").text() != location) continue;
    const JsonPlace intrinsics = place.member("Intrinsics");
    const std::string& model = intrinsics.member("ModelType").text();
    if (model != "CALIBRATION_LensDistortionModelBrownConrady") {
      intrinsics.fail("expected the model BrownConrady, got " + model);
    }
    std::array<double, 14> p{};  // cx cy fx fy k1-k6 codx cody p2 p1
    read_numbers(intrinsics.member("ModelParameters"), 14, p);
    if (p[10] != 0.0 || p[11] != 0.0) intrinsics.fail("expected the centre of distortion 0, 0");
    StoredCamera camera{p[0], p[1], p[2], p[3], {}, {}, {}};
    camera.lens = {{p[4], p[5], p[6], p[7], p[8], p[9]}, p[13], p[12], 0.0};
    const double radius = place.member("MetricRadius").number();
    camera.lens.max_radius = radius > 0.0 ? radius : kUsualRadius;
    Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rotation;
    read_numbers(place.member("Rt").member("Rotation"), 9, rotation.data());
    read_numbers(place.member("Rt").member("Translation"), 3, camera.translation.data());
    camera.rotation = rotation;
    return camera;
  }
  cameras.fail("expected a camera " + location);
}

/// Scales the stored camera's image to `width` x `height`, then crops `left` and `top` pixels.
Intrinsics crop(const StoredCamera& stored, double width, double height, double left, double top,
                ImageSize size) {
  Intrinsics camera;
  camera.width = size.cols;
  camera.height = size.rows;
  camera.fx = stored.fx * width;
  camera.fy = stored.fy * height;
  camera.cx = stored.cx * width - left - 0.5;  // because our pixel centres are integers
  camera.cy = stored.cy * height - top - 0.5;
  return camera;
}

Intrinsics depth_camera(const StoredCamera& stored, ImageSize size, const JsonPlace& place) {
  struct Mode {
    ImageSize size;
    double side, left, top;
  };
  constexpr Mode kModes[] = {{{576, 640}, 1024, 192, 180},
                             {{288, 320}, 512, 96, 90},
                             {{512, 512}, 512, 0, 0},
                             {{1024, 1024}, 1024, 0, 0}};
  for (const Mode& mode : kModes) {
    if (mode.size.rows == size.rows && mode.size.cols == size.cols) {
      return crop(stored, mode.side, mode.side, mode.left, mode.top, size);
    }
  }
  place.fail("depth images of " + std::to_string(size.cols) + " x " + std::to_string(size.rows) +
             " pixels: not a mode of the Azure Kinect");
}

/// All colour modes show the sensor's whole width; the sensor's aspect ratio is 4 : 3.
Intrinsics color_camera(const StoredCamera& stored, ImageSize size) {
  const auto width = static_cast<double>(size.cols), height = width * 3.0 / 4.0;
  return crop(stored, width, height, 0.0, (height - static_cast<double>(size.rows)) / 2.0, size);
}

Eigen::Vector2d normalized(const Intrinsics& camera, double u, double v) {
  return {(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy};
}

[[noreturn]] void refuse_lens(const std::string& camera) {
  throw InputError(camera + ": the model of its lens holds for less than half of the image");
}

/// @throws InputError  the lens model does not hold for half of the image or more.
std::vector<float> ray_table(const Intrinsics& camera, const Lens& lens) {
  std::vector<float> rays;
  rays.reserve(2 * camera.width * camera.height);
  std::size_t known = 0;
  for (std::int64_t v = 0; v < camera.height; ++v) {
    for (std::int64_t u = 0; u < camera.width; ++u) {
      const auto ray =
          lens.undistort(normalized(camera, static_cast<double>(u), static_cast<double>(v)));
      rays.push_back(ray ? static_cast<float>(ray->x()) : kNanF);
      rays.push_back(ray ? static_cast<float>(ray->y()) : kNanF);
      known += ray ? 1 : 0;
    }
  }
  if (4 * known < rays.size()) refuse_lens("depth");
  return rays;
}

/// Fits Brown's k1, k2, p1, p2, k3 to the lens at a grid of the image's pixels.
/// @throws InputError  the lens model does not hold for half of the image or more.
std::array<double, 5> brown_fit(const Intrinsics& camera, const Lens& lens) {
  constexpr int kAcross = 32, kDown = 24;
  std::vector<Eigen::Matrix<double, 1, 5>> rows;
  std::vector<double> rest;
  for (int i = 0; i < kAcross * kDown; ++i) {
    const double u = static_cast<double>((camera.width - 1) * (i % kAcross)) / (kAcross - 1);
    const double v = static_cast<double>((camera.height - 1) * (i / kAcross)) / (kDown - 1);
    const Eigen::Vector2d seen = normalized(camera, u, v);
    const auto ray = lens.undistort(seen);
    if (!ray) continue;
    const double x = ray->x(), y = ray->y(), r2 = ray->squaredNorm();
    rows.push_back({x * r2, x * r2 * r2, 2.0 * x * y, r2 + 2.0 * x * x, x * r2 * r2 * r2});
    rows.push_back({y * r2, y * r2 * r2, r2 + 2.0 * y * y, 2.0 * x * y, y * r2 * r2 * r2});
    rest.push_back(seen.x() - x);
    rest.push_back(seen.y() - y);
  }
  if (rest.size() < std::size_t{kAcross * kDown}) refuse_lens("colour");  // two rows per pixel
  Eigen::MatrixXd a(static_cast<Eigen::Index>(rows.size()), 5);
  for (std::size_t i = 0; i < rows.size(); ++i) a.row(static_cast<Eigen::Index>(i)) = rows[i];
  const Eigen::Map<const Eigen::VectorXd> b(rest.data(), a.rows());
  constexpr double kPrecision = 1e-12;
  const Eigen::VectorXd k = least_squares(a, b, kPrecision).solution;
  return {k[0], k[1], k[2], k[3], k[4]};
}

}  // namespace

std::shared_ptr<RgbdCalibration> azure_calibration(const JsonPlace& place, ImageSize depth_size,
                                                   const std::optional<ImageSize>& color_size) {
  const JsonPlace cameras = place.member("CalibrationInformation").member("Cameras");
  const StoredCamera depth = read_camera(cameras, "CALIBRATION_CameraLocationD0");
  auto calibration = std::make_shared<RgbdCalibration>();
  calibration->depth = depth_camera(depth, depth_size, cameras);
  try {
    check_intrinsics(calibration->depth, "depth");
    calibration->ray_table = ray_table(calibration->depth, depth.lens);
    calibration->depth.ray_table = calibration->ray_table.data();
    if (!color_size) return calibration;
    const StoredCamera color = read_camera(cameras, "CALIBRATION_CameraLocationPV0");
    Registration registration;
    registration.color = color_camera(color, *color_size);
    check_intrinsics(registration.color, "color");
    registration.color.distortion = brown_fit(registration.color, color.lens);
    registration.rotation = color.rotation * depth.rotation.transpose();
    registration.translation = color.translation - registration.rotation * depth.translation;
    check_registration(registration);
    calibration->registration = registration;
  } catch (const InputError& error) {
    cameras.fail(error.what());
  }
  return calibration;
}

}  // namespace manip3d
