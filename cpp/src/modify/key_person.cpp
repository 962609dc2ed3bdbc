#include "manip3d/modify/key_person.hpp"

#include <limits>
#include <string>
#include <utility>

#include "manip3d/error.hpp"
#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

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

std::optional<std::size_t> KeyPerson::find(std::span<const Skeleton> people,
                                           const Intrinsics& camera, double time_s) {
  std::optional<std::size_t> found;
  const double lost = lost_for(time_s);
  if (lost >= options_.forget) {
    found = most_central(people, camera);
  } else {
    for (std::size_t i = 0; i < people.size() && !found; ++i) {
      if (people[i].id == id_ && is_usable(people[i], Joint::kSpineBase)) found = i;
    }
    if (!found && lost >= options_.patience) {
      found = cheapest(people, options_.reach * options_.reach, [&](const Eigen::Vector3f& p) {
        return (p - position_).cast<double>().squaredNorm();
      });
    }
  }
  if (found) {
    seen_ = true;
    id_ = people[*found].id;
    last_seen_ = time_s;
    position_ = people[*found][Joint::kSpineBase];
  }
  return found;
}

}  // namespace manip3d
