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
  /// Seconds after which the nearest newcomer replaces a lost person.
  double patience = 1.0;
  double reach = 0.5;    ///< Metres from the last known place within which a newcomer is accepted.
  double forget = 10.0;  ///< Seconds without the person after which the choice starts again.
};

/// Position of the base of the spine. If it is not tracked, because the hips are outside the image,
/// it is extrapolated from the lowest tracked joint of the spine. No value if no joint of the spine
/// is tracked.
std::optional<Eigen::Vector3f> spine_base(const Skeleton& person);

/// Tracks one of the people in view (dissertation section 4.7.1: the key person).
///
/// The first choice is the person whose base of the spine projects nearest to the image centre (the
/// lower id of two equally near ones). After that the key person is the one with the same id,
/// unless that one jumped away while somebody else stands at the key person's last place: trackers
/// swap ids. A person with a new id at that place is taken for the key person.
///
/// When the key person is lost, a newcomer of the same size takes its place: at once if alone in
/// view, after 0.3 seconds if all others in view are known; after `patience` the newcomer nearest
/// to the last place, within `reach`. People who were seen together with the key person are known.
/// A known person is taken only after being out of view for `forget` seconds, unless select()
/// chooses it.
///
/// Clothes, where visible, overrule place and id. If the person with the id wears other colours
/// than the key person did, the only person nearby with the key person's colours is taken instead;
/// without such a person nobody is, if the one with the id is far from the last place. A newcomer
/// in other colours is not taken.
class KeyPerson {
 public:
  /// @throws InputError  an option that is not >= 0.
  explicit KeyPerson(const KeyPersonOptions& options = {});
  /// Return the index of the key person in `people`; no value while it is lost. Times must
  /// increase.
  /// @param clothes  Clothes of the people, in the same order; empty: unknown.
  /// @throws InputError  numbers of clothes and people differ.
  std::optional<std::size_t> find(std::span<const Skeleton> people, const Intrinsics& camera,
                                  double time_s, std::span<const ClothingColors> clothes = {});
  /// Makes the person of this id the key person as soon as it is in view.
  void select(std::int64_t id) { selected_ = id; }
  /// Seconds since the key person was last seen; infinite if it never was.
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
  double trunk_length_ = 0.0;  ///< Mean, metres; 0: unknown.
  ClothingColors clothes_;     ///< Mean of the key person's clothes.
  /// Clothes in this frame; valid during a call of find().
  std::span<const ClothingColors> seen_clothes_;
  std::array<Other, 16>
      others_{};  ///< People seen together with it; the one seen longest ago is replaced.
  std::size_t num_others_ = 0;
};

}  // namespace manip3d
