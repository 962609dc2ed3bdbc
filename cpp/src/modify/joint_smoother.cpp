#include "manip3d/modify/joint_smoother.hpp"

#include <algorithm>

#include "modify/check_option.hpp"

namespace manip3d {
bool is_usable(const Skeleton& skeleton, Joint joint) {
  constexpr float kFarthest = 100.0F;
  const Eigen::Vector3f& p = skeleton[joint];
  return skeleton.state(joint) != TrackingState::kNotTracked && p.allFinite() &&
         p.cwiseAbs().maxCoeff() <= kFarthest && !p.isZero(0.0F);
}

JointSmoother::JointSmoother(const JointSmootherOptions& options) : options_(options) {
  constexpr double kMost = 1e6;
  if (!(options.smoothing >= 0.0 && options.smoothing < 1.0)) {
    throw InputError("smoothing: expected at least 0 and below 1, got " +
                     number_text(options.smoothing));
  }
  check_up_to("correction", options.correction, 1.0);
  check_up_to("prediction", options.prediction, kMost);
  check_up_to("jitter_radius", options.jitter_radius, kMost);
  check_up_to("max_deviation", options.max_deviation, kMost);
}

Eigen::Vector3d JointSmoother::smooth(const Eigen::Vector3d& raw, double tolerance,
                                      State& state) const {
  const State before = state;
  const double jitter = tolerance * options_.jitter_radius;
  if (before.frames == 0) {
    state.filtered = raw;
    state.trend.setZero();
  } else {
    if (before.frames == 1) {
      state.filtered = 0.5 * (raw + before.raw);
    } else {
      const double step = (raw - before.filtered).norm();
      Eigen::Vector3d damped = raw;
      if (step < jitter) damped = before.filtered + (step / jitter) * (raw - before.filtered);
      state.filtered = (1.0 - options_.smoothing) * damped +
                       options_.smoothing * (before.filtered + before.trend);
    }
    state.trend = options_.correction * (state.filtered - before.filtered) +
                  (1.0 - options_.correction) * before.trend;
  }
  state.raw = raw;
  state.frames = std::min(before.frames + 1, 2);
  const Eigen::Vector3d off = state.filtered + options_.prediction * state.trend - raw;
  const double deviation = off.norm(), most = tolerance * options_.max_deviation;
  return deviation > most ? Eigen::Vector3d(raw + (most / deviation) * off)
                          : Eigen::Vector3d(raw + off);
}

Skeleton JointSmoother::add(const Skeleton& raw) {
  Skeleton smoothed = raw;
  for (std::size_t i = 0; i < kNumJoints; ++i) {
    if (!is_usable(raw, static_cast<Joint>(i))) {
      joints_[i] = {};
      smoothed.positions[i].setZero();
      smoothed.states[i] = TrackingState::kNotTracked;
      continue;
    }
    const double tolerance = raw.states[i] == TrackingState::kInferred ? 2.0 : 1.0;
    smoothed.positions[i] =
        smooth(raw.positions[i].cast<double>(), tolerance, joints_[i]).cast<float>();
  }
  return smoothed;
}

}  // namespace manip3d
