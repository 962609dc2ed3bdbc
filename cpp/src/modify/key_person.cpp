#include "manip3d/modify/key_person.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "geometry/constants.hpp"
#include "manip3d/error.hpp"
#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {
namespace {

// Seconds after the loss during which a place still identifies a person.
constexpr double kMoment = 0.3;
// Hellinger distances. Two images of the same shirt in different light differ by less than
// kSameClothes, shirts of different colours by more than kOtherClothes; between the two, clothes
// decide nothing.
constexpr double kSameClothes = 0.35, kOtherClothes = 0.6;

/// Distance from the base of the spine to the shoulders, metres; 0: unknown.
double trunk_length(const Skeleton& person) {
  if (!is_usable(person, Joint::kSpineBase) || !is_usable(person, Joint::kSpineShoulder)) return 0;
  return (person[Joint::kSpineShoulder] - person[Joint::kSpineBase]).cast<double>().norm();
}

/// Whether two people may be within a distance of each other. The first joint of the trunk that
/// both have decides; if they have none in common, anybody with a usable joint may be near.
bool may_be_within(const Skeleton& a, const Skeleton& b, double distance) {
  using enum Joint;
  constexpr std::array kTrunk = {kSpineBase, kSpineMid, kSpineShoulder, kNeck,
                                 kHipLeft,   kHipRight, kShoulderLeft,  kShoulderRight};
  for (const Joint joint : kTrunk) {
    if (!is_usable(a, joint) || !is_usable(b, joint)) continue;
    return (a[joint] - b[joint]).cast<double>().norm() < distance;
  }
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    if (is_usable(b, static_cast<Joint>(joint))) return true;
  }
  return false;
}

/// Returns the person with the least cost below `most`; the lower id of two with the same cost.
template <typename Cost>
std::optional<std::size_t> cheapest(std::span<const Skeleton> people, double most,
                                    const Cost& cost) {
  std::optional<std::size_t> best;
  double least = most;
  for (std::size_t i = 0; i < people.size(); ++i) {
    const auto base = spine_base(people[i]);
    if (!base) continue;
    const double value = cost(i, *base);
    if (value < least || (best && value == least && people[i].id < people[*best].id)) {
      least = value;
      best = i;
    }
  }
  return best;
}

}  // namespace

std::optional<Eigen::Vector3f> spine_base(const Skeleton& person) {
  using enum Joint;
  struct Height {
    Joint joint;
    float above;  ///< Height above the base of an adult's spine, metres.
  };
  constexpr std::array kSpine = {Height{kSpineBase, 0.0F}, Height{kSpineMid, 0.31F},
                                 Height{kSpineShoulder, 0.535F}, Height{kNeck, 0.61F}};
  for (std::size_t i = 0; i < kSpine.size(); ++i) {
    if (!is_usable(person, kSpine[i].joint)) continue;
    const Eigen::Vector3f& lowest = person[kSpine[i].joint];
    if (kSpine[i].above == 0.0F) return lowest;
    // Extrapolates along the spine if two of its joints are usable, otherwise straight down (+y).
    Eigen::Vector3f down = Eigen::Vector3f::UnitY();
    for (std::size_t k = i + 1; k < kSpine.size(); ++k) {
      if (!is_usable(person, kSpine[k].joint)) continue;
      const Eigen::Vector3f along = lowest - person[kSpine[k].joint];
      if (along.norm() > 0.05F) down = along.normalized();
      break;
    }
    return lowest + kSpine[i].above * down;
  }
  return std::nullopt;
}

KeyPerson::KeyPerson(const KeyPersonOptions& options) : options_(options) {
  for (const auto& [name, value] : {std::pair{"patience", options.patience},
                                    {"reach", options.reach},
                                    {"forget", options.forget}}) {
    if (!(value >= 0.0)) {
      throw InputError(std::string(name) + ": expected >= 0, got " + number_text(value));
    }
  }
}

double KeyPerson::lost_for(double time_s) const { return seen_ ? time_s - last_seen_ : kInfinity; }

void KeyPerson::reset() {
  seen_ = false;
  selected_.reset();
  trunk_length_ = 0.0;
  clothes_ = {};
  num_others_ = 0;
}

/// Ids are forgotten `forget` seconds after they were last seen, because trackers reuse them.
bool KeyPerson::is_other(std::int64_t id, double time_s) const {
  return std::any_of(others_.begin(), others_.begin() + num_others_, [&](const Other& other) {
    return other.id == id && time_s - other.last_seen < options_.forget;
  });
}

/// Records the people who are seen together with the key person; while it is lost, the known people
/// who are still in view, and a person who has its id but was not taken for it.
void KeyPerson::see_others(std::span<const Skeleton> people, double time_s) {
  const bool is_here = seen_ && last_seen_ == time_s;
  for (const Skeleton& person : people) {
    const auto end = others_.begin() + num_others_;
    const auto known =
        std::find_if(others_.begin(), end, [&](const Other& o) { return o.id == person.id; });
    const bool is_known = known != end && time_s - known->last_seen < options_.forget;
    const bool has_its_id = seen_ && person.id == id_;
    const bool is_refused = !is_here && has_its_id && spine_base(person);
    if (is_here ? has_its_id : !(is_known || is_refused)) continue;
    if (known != end) {
      known->last_seen = time_s;
    } else if (num_others_ < others_.size()) {
      others_[num_others_++] = {person.id, time_s};
    } else {
      *std::ranges::min_element(others_, {}, &Other::last_seen) = {person.id, time_s};
    }
  }
}

std::optional<std::size_t> KeyPerson::with_id(std::span<const Skeleton> people,
                                              std::int64_t id) const {
  for (std::size_t i = 0; i < people.size(); ++i) {
    if (people[i].id == id && spine_base(people[i])) return i;
  }
  return std::nullopt;
}

/// Returns the person nearest to the last place, among people who are not known and do not wear
/// other clothes.
std::optional<std::size_t> KeyPerson::nearby(std::span<const Skeleton> people, double within,
                                             double time_s) const {
  return cheapest(people, within * within, [&](std::size_t i, const Eigen::Vector3f& p) {
    if (is_other(people[i].id, time_s) || wears_other_clothes(i)) return kInfinity;
    return (p - position_).cast<double>().squaredNorm();
  });
}

/// Distance of a person's clothes from the key person's; NaN if one of them is unknown.
double KeyPerson::clothes_differ(std::size_t person) const {
  const bool is_seen = person < seen_clothes_.size() && seen_clothes_[person].is_known();
  if (!is_seen || !clothes_.is_known()) return std::numeric_limits<double>::quiet_NaN();
  return difference(seen_clothes_[person], clothes_);
}

bool KeyPerson::wears_other_clothes(std::size_t person) const {
  return clothes_differ(person) > kOtherClothes;
}

/// Returns the only person within reach who wears the key person's clothes.
std::optional<std::size_t> KeyPerson::in_its_clothes(std::span<const Skeleton> people,
                                                     double within) const {
  std::optional<std::size_t> found;
  for (std::size_t i = 0; i < people.size(); ++i) {
    const auto base = spine_base(people[i]);
    if (!base || !((*base - position_).cast<double>().norm() < within)) continue;
    if (!(clothes_differ(i) < kSameClothes) || !has_same_size(people[i])) continue;
    if (found) return std::nullopt;
    found = i;
  }
  return found;
}

/// Finds the key person by id; by clothes, if the person with the id wears other ones; or by place,
/// if ids were swapped or replaced from one frame to the next. No value if the person with the id
/// is far away and wears other clothes.
std::optional<std::size_t> KeyPerson::followed(std::span<const Skeleton> people,
                                               double time_s) const {
  constexpr double kNear = 0.15, kFar = 0.30;      // metres
  constexpr double kWalk = 1.5, kRun = 3.0;        // metres a second
  const bool is_anothers = is_other(id_, time_s);  // the id now belongs to a known person
  const auto mine = is_anothers ? std::nullopt : with_id(people, id_);
  const double lost = lost_for(time_s), far = kFar + kRun * lost;
  const auto jump = [&](std::size_t person) {
    return (*spine_base(people[person]) - position_).cast<double>().norm();
  };
  if (is_anothers || (mine && wears_other_clothes(*mine))) {
    if (const auto same = in_its_clothes(people, far)) return same;
    if (mine && lost <= kMoment && jump(*mine) > far) return std::nullopt;
  }
  if (lost > kMoment) return mine;
  const double within = kNear + kWalk * lost;
  const auto there = cheapest(people, within * within, [&](std::size_t, const Eigen::Vector3f& p) {
    return (p - position_).cast<double>().squaredNorm();
  });
  if (!there || wears_other_clothes(*there)) return mine;
  if (!mine) return is_other(people[*there].id, time_s) ? std::nullopt : there;
  return jump(*mine) > far ? there : mine;
}

bool KeyPerson::has_same_size(const Skeleton& person) const {
  constexpr double kSameSize = 0.25;
  const double length = trunk_length(person);
  const bool comparable = length > 0.0 && trunk_length_ > 0.0;
  return !comparable || std::abs(length / trunk_length_ - 1.0) <= kSameSize;
}

/// Returns the only person in view who is not known, has the same size and does not wear other
/// clothes. At once only if nobody else is in view, because a person who appears beside others may
/// be anybody.
std::optional<std::size_t> KeyPerson::newcomer(std::span<const Skeleton> people,
                                               double time_s) const {
  if (people.size() > 1 && lost_for(time_s) <= kMoment) return std::nullopt;
  std::optional<std::size_t> found;
  for (std::size_t i = 0; i < people.size(); ++i) {
    if (!spine_base(people[i]) || is_other(people[i].id, time_s)) continue;
    if (wears_other_clothes(i)) continue;
    if (found) return std::nullopt;
    found = i;
  }
  return found && has_same_size(people[*found]) ? found : std::nullopt;
}

std::optional<std::size_t> KeyPerson::most_central(std::span<const Skeleton> people,
                                                   const Intrinsics& camera, double time_s) const {
  const Eigen::Vector2d centre(0.5 * static_cast<double>(camera.width - 1),
                               0.5 * static_cast<double>(camera.height - 1));
  return cheapest(people, kInfinity, [&](std::size_t i, const Eigen::Vector3f& p) {
    if (is_other(people[i].id, time_s)) return kInfinity;
    return (project(camera, p.cast<double>()) - centre).squaredNorm();  // NaN behind the camera
  });
}

std::optional<std::size_t> KeyPerson::find(std::span<const Skeleton> people,
                                           const Intrinsics& camera, double time_s,
                                           std::span<const ClothingColors> clothes) {
  if (!clothes.empty() && clothes.size() != people.size()) {
    throw InputError("clothes: expected one for each of " + std::to_string(people.size()) +
                     " people, got " + std::to_string(clothes.size()));
  }
  seen_clothes_ = clothes;
  std::optional<std::size_t> found;
  const double lost = lost_for(time_s);
  if (selected_) found = with_id(people, *selected_);
  if (found) {
    reset();
  } else if (lost >= options_.forget) {
    found = most_central(people, camera, time_s);
    if (found) {  // It may be somebody else, of another size and in other clothes.
      trunk_length_ = 0.0;
      clothes_ = {};
    }
  } else {
    found = followed(people, time_s);
    if (!found) found = newcomer(people, time_s);
    if (!found && lost >= options_.patience) found = nearby(people, options_.reach, time_s);
  }
  if (found) {
    const bool is_same = is_surely_the_same(people, *found, time_s);
    remember(people[*found], time_s);
    remember_clothes(*found, is_same);
  }
  see_others(people, time_s);
  seen_clothes_ = {};
  return found;
}

void KeyPerson::remember(const Skeleton& person, double time_s) {
  seen_ = true;
  id_ = person.id;
  last_seen_ = time_s;
  position_ = *spine_base(person);
  constexpr double kMemory = 0.95;  // weight of the previous length
  const double length = trunk_length(person);
  if (length > 0.0) {
    trunk_length_ =
        trunk_length_ > 0.0 ? kMemory * trunk_length_ + (1.0 - kMemory) * length : length;
  }
  const auto end = others_.begin() + num_others_;
  const auto known =
      std::find_if(others_.begin(), end, [&](const Other& o) { return o.id == id_; });
  if (known != end) *known = others_[--num_others_];
}

/// Whether a person has the id of the key person, is at its place in the last frame, and nobody is
/// near with whom it could be confused.
bool KeyPerson::is_surely_the_same(std::span<const Skeleton> people, std::size_t person,
                                   double time_s) const {
  constexpr double kNear = 0.15, kAlone = 1.0;  // metres
  constexpr double kWalk = 1.5;                 // metres a second
  const double lost = lost_for(time_s);
  if (people[person].id != id_ || lost > kMoment) return false;
  const Eigen::Vector3f here = *spine_base(people[person]);
  if ((here - position_).cast<double>().norm() > kNear + kWalk * lost) return false;
  for (std::size_t i = 0; i < people.size(); ++i) {
    if (i != person && may_be_within(people[person], people[i], kAlone)) return false;
  }
  return true;
}

/// Updates the running mean of the clothes. Clothes that look quite different, as behind an arm or
/// after putting on a jacket, are learnt ten times more slowly, and only if the wearer is certainly
/// the key person.
void KeyPerson::remember_clothes(std::size_t person, bool is_surely_the_same) {
  if (person >= seen_clothes_.size() || !seen_clothes_[person].is_known()) return;
  if (!clothes_.is_known()) {
    clothes_ = seen_clothes_[person];
    return;
  }
  const bool is_changed = wears_other_clothes(person);
  if (is_changed && !is_surely_the_same) return;
  const float memory = is_changed ? 0.995F : 0.95F;  // weight of the previous mean
  for (std::size_t i = 0; i < clothes_.shares.size(); ++i) {
    clothes_.shares[i] =
        memory * clothes_.shares[i] + (1.0F - memory) * seen_clothes_[person].shares[i];
  }
}

}  // namespace manip3d
