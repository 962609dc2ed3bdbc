#include "manip3d/modify/key_person.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "geometry/constants.hpp"
#include "manip3d/error.hpp"
#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kNobody = std::numeric_limits<std::int64_t>::min();

/// From the base of the spine to the shoulders, metres; 0: not seen.
double trunk_length(const Skeleton& person) {
  if (!is_usable(person, Joint::kSpineBase) || !is_usable(person, Joint::kSpineShoulder)) return 0;
  return (person[Joint::kSpineShoulder] - person[Joint::kSpineBase]).cast<double>().norm();
}

/// The person of least cost below `most`, by the lower id if two cost the same.
template <typename Cost>
std::optional<std::size_t> cheapest(std::span<const Skeleton> people, double most,
                                    const Cost& cost) {
  std::optional<std::size_t> best;
  double least = most;
  for (std::size_t i = 0; i < people.size(); ++i) {
    if (!is_usable(people[i], Joint::kSpineBase)) continue;
    const double value = cost(people[i][Joint::kSpineBase]);
    if (value < least || (best && value == least && people[i].id < people[*best].id)) {
      least = value;
      best = i;
    }
  }
  return best;
}

std::optional<std::size_t> most_central(std::span<const Skeleton> people,
                                        const Intrinsics& camera) {
  const Eigen::Vector2d centre(0.5 * static_cast<double>(camera.width - 1),
                               0.5 * static_cast<double>(camera.height - 1));
  return cheapest(people, kInfinity, [&](const Eigen::Vector3f& p) {
    return (project(camera, p.cast<double>()) - centre).squaredNorm();  // NaN behind the camera
  });
}

}  // namespace

KeyPerson::KeyPerson(const KeyPersonOptions& options) : options_(options) {
  for (const auto& [name, value] : {std::pair{"patience", options.patience},
                                    {"reach", options.reach},
                                    {"forget", options.forget}}) {
    if (!(value >= 0.0)) {
      throw InputError(std::string(name) + ": expected >= 0, got " + std::to_string(value));
    }
  }
}

double KeyPerson::lost_for(double time_s) const { return seen_ ? time_s - last_seen_ : kInfinity; }

void KeyPerson::reset() {
  seen_ = false;
  selected_.reset();
  trunk_length_ = 0.0;
  num_others_ = 0;
}

bool KeyPerson::is_other(std::int64_t id) const {
  const auto end = others_.begin() + std::min(num_others_, others_.size());
  return std::find(others_.begin(), end, id) != end;
}

std::optional<std::size_t> KeyPerson::with_id(std::span<const Skeleton> people,
                                              std::int64_t id) const {
  for (std::size_t i = 0; i < people.size(); ++i) {
    if (people[i].id == id && is_usable(people[i], Joint::kSpineBase)) return i;
  }
  return std::nullopt;
}

std::optional<std::size_t> KeyPerson::nearby(std::span<const Skeleton> people,
                                             double within) const {
  return cheapest(people, within * within, [&](const Eigen::Vector3f& p) {
    return (p - position_).cast<double>().squaredNorm();
  });
}

/// By id, or by place where ids were swapped or renewed from one frame to the next.
std::optional<std::size_t> KeyPerson::followed(std::span<const Skeleton> people,
                                               double lost) const {
  constexpr double kMoment = 0.3;              // seconds for which a place tells a person
  constexpr double kNear = 0.15, kFar = 0.30;  // metres
  constexpr double kWalk = 1.5, kRun = 3.0;    // metres a second
  const auto mine = with_id(people, id_);
  if (lost > kMoment) return mine;
  const auto there = nearby(people, kNear + kWalk * lost);
  if (!there) return mine;
  if (!mine) return is_other(people[*there].id) ? std::nullopt : there;
  const double jump = (people[*mine][Joint::kSpineBase] - position_).cast<double>().norm();
  return jump > kFar + kRun * lost ? there : mine;
}

/// A newcomer of the same size, without anybody else in view.
std::optional<std::size_t> KeyPerson::alone(std::span<const Skeleton> people) const {
  constexpr double kSameSize = 0.25;
  if (people.size() != 1 || is_other(people[0].id)) return std::nullopt;
  if (!is_usable(people[0], Joint::kSpineBase)) return std::nullopt;
  const double length = trunk_length(people[0]);
  const bool comparable = length > 0.0 && trunk_length_ > 0.0;
  if (comparable && std::abs(length / trunk_length_ - 1.0) > kSameSize) return std::nullopt;
  return 0;
}

std::optional<std::size_t> KeyPerson::find(std::span<const Skeleton> people,
                                           const Intrinsics& camera, double time_s) {
  std::optional<std::size_t> found;
  const double lost = lost_for(time_s);
  if (selected_) found = with_id(people, *selected_);
  if (found) {
    reset();
  } else if (lost >= options_.forget) {
    found = most_central(people, camera);
  } else {
    found = followed(people, lost);
    if (!found) found = alone(people);
    if (!found && lost >= options_.patience) found = nearby(people, options_.reach);
  }
  if (found) remember(people, *found, time_s);
  return found;
}

void KeyPerson::remember(std::span<const Skeleton> people, std::size_t found, double time_s) {
  seen_ = true;
  id_ = people[found].id;
  last_seen_ = time_s;
  position_ = people[found][Joint::kSpineBase];
  constexpr double kMemory = 0.95;  // of the length, from frame to frame
  const double length = trunk_length(people[found]);
  if (length > 0.0) {
    trunk_length_ =
        trunk_length_ > 0.0 ? kMemory * trunk_length_ + (1.0 - kMemory) * length : length;
  }
  std::replace(others_.begin(), others_.end(), id_, kNobody);
  for (std::size_t i = 0; i < people.size(); ++i) {
    if (i == found || is_other(people[i].id)) continue;
    others_[num_others_++ % others_.size()] = people[i].id;
  }
}

}  // namespace manip3d
