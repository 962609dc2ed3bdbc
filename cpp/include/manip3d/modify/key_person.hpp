#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/clothing.hpp"

namespace manip3d {

struct KeyPersonOptions {
  double patience = 1.0;  ///< Seconds before a lost person is looked for under another id.
  double reach = 0.5;     ///< Metres from where it was last seen.
  double forget = 10.0;   ///< Seconds before the choice is made as if for the first time.
};

/// Position of the base of the spine. If it was not tracked, because the hips are out of the
/// picture, it is extrapolated from the lowest joint of the spine that was; none: there is none.
std::optional<Eigen::Vector3f> spine_base(const Skeleton& person);

/// Holds on to one of the people in view (dissertation section 4.7.1: the key person).
///
/// At first the one whose spine's base projects nearest to the image centre, by the lower id if two
/// are as near; then whoever has its id, unless it jumped away while somebody else stands where it
/// was a moment ago: trackers swap ids. Somebody new at that place has a new id. Once lost, a
/// newcomer of the same size is the key person: at once when alone in view, after 0.3 seconds
/// beside people who are known; after `patience` the newcomer nearest to where it was last seen,
/// within `reach`. People who were seen beside it are known, and never taken, until nobody has seen
/// them for `forget`: who of them is the key person after all has to be selected.
///
/// Clothes, where they are seen, speak for place and id: who has the id and wears other colours
/// than the key person did is passed over for the only one nearby who wears its colours, or for
/// nobody if that person stands far from where it was; a newcomer in other colours is not taken.
class KeyPerson {
 public:
  /// @throws InputError  an option that is not >= 0.
  explicit KeyPerson(const KeyPersonOptions& options = {});
  /// Which of the people it is; none while it is lost. Times grow.
  /// @param clothes  those of the people, in their order; empty: not known.
  /// @throws InputError  not as many clothes as people.
  std::optional<std::size_t> find(std::span<const Skeleton> people, const Intrinsics& camera,
                                  double time_s, std::span<const ClothingColors> clothes = {});
  /// Takes the person of an id as soon as it is in view.
  void select(std::int64_t id) { selected_ = id; }
  /// Seconds since it was last seen; infinite if nobody ever was.
  [[nodiscard]] double lost_for(double time_s) const;
  void reset();

 private:
  struct Other {
    std::int64_t id = 0;
    double last_seen = 0.0;
  };
  [[nodiscard]] std::optional<std::size_t> with_id(std::span<const Skeleton> people,
                                                   std::int64_t id) const;
  [[nodiscard]] std::optional<std::size_t> nearby(std::span<const Skeleton> people, double within,
                                                  double time_s) const;
  [[nodiscard]] std::optional<std::size_t> followed(std::span<const Skeleton> people,
                                                    double time_s) const;
  [[nodiscard]] std::optional<std::size_t> newcomer(std::span<const Skeleton> people,
                                                    double time_s) const;
  [[nodiscard]] std::optional<std::size_t> most_central(std::span<const Skeleton> people,
                                                        const Intrinsics& camera,
                                                        double time_s) const;
  [[nodiscard]] std::optional<std::size_t> in_its_clothes(std::span<const Skeleton> people,
                                                          double within) const;
  [[nodiscard]] double clothes_differ(std::size_t person) const;
  [[nodiscard]] bool wears_other_clothes(std::size_t person) const;
  [[nodiscard]] bool has_same_size(const Skeleton& person) const;
  [[nodiscard]] bool is_other(std::int64_t id, double time_s) const;
  void see_others(std::span<const Skeleton> people, double time_s);
  void remember(const Skeleton& person, double time_s);
  [[nodiscard]] bool is_surely_the_same(std::span<const Skeleton> people, std::size_t person,
                                        double time_s) const;
  void remember_clothes(std::size_t person, bool is_surely_the_same);

  KeyPersonOptions options_;
  bool seen_ = false;
  std::int64_t id_ = 0;
  std::optional<std::int64_t> selected_;
  double last_seen_ = 0.0;
  Eigen::Vector3f position_ = Eigen::Vector3f::Zero();
  double trunk_length_ = 0.0;                     ///< Mean, metres; 0: not known.
  ClothingColors clothes_;                        ///< Mean of the key person's.
  std::span<const ClothingColors> seen_clothes_;  ///< Clothes in this frame; for a call of find().
  std::array<Other, 16>
      others_{};  ///< People seen beside it; who was seen longest ago is replaced.
  std::size_t num_others_ = 0;
};

}  // namespace manip3d
