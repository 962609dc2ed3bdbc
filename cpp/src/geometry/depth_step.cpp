#include "manip3d/geometry/depth_step.hpp"

#include <cmath>
#include <string>

#include "manip3d/error.hpp"

namespace manip3d {

DepthStep::DepthStep(const DepthStepOptions& options, double focal) {
  const auto check = [](const char* name, double value) {
    if (!(value >= 0.0 && std::isfinite(value))) {
      throw InputError(std::string(name) + ": expected a finite number >= 0, got " +
                       number_text(value));
    }
  };
  check("noise_at_1_m", options.noise_at_1_m);
  check("max_step", options.max_step);
  if (!(focal > 0.0)) {
    throw InputError("focal: expected > 0, got " + number_text(focal));
  }
  if (options.max_step > 0.0) {
    fixed_ = static_cast<float>(options.max_step);
    return;
  }
  constexpr double kTan78 = 4.704630109478454;
  slope_ = static_cast<float>(kTan78 / focal);
  noise_ = static_cast<float>(3.0 * options.noise_at_1_m);
}

}  // namespace manip3d
