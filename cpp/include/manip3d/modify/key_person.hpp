#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/skeleton.hpp"

namespace manip3d {

struct KeyPersonOptions {
  double patience = 1.0;  ///< Seconds before a lost person is looked for under another id.
  double reach = 0.5;     ///< Metres from where it was last seen.
  double forget = 10.0;   ///< Seconds before the choice is made as if for the first time.
};

/// Holds on to one of the people in view (dissertation section 4.7.1: the key person).
///
/// At first the one whose SpineBase projects nearest to the image centre, by the lower id if two
/// are as near; then whoever has its id, unless it jumped away while somebody else stands where it
/// was a moment ago: trackers swap ids. Somebody new at that place has a new id. Once lost, a
/// newcomer who is alone in view and of the same size is the key person at once; after `patience`
/// the body nearest to where it was last seen, within `reach`.
class KeyPerson {
 public:
  /// @throws InputError  an option that is not >= 0.
  explicit KeyPerson(const KeyPersonOptions& options = {});
  /// Which of the people it is; none while it is lost. Times grow.
  std::optional<std::size_t> find(std::span<const Skeleton> people, const Intrinsics& camera,
                                  double time_s);
  /// Takes the person of an id as soon as it is in view.
  void select(std::int64_t id) { selected_ = id; }
  /// Seconds since it was last seen; infinite if nobody ever was.
  [[nodiscard]] double lost_for(double time_s) const;
  void reset();

 private:
  [[nodiscard]] std::optional<std::size_t> with_id(std::span<const Skeleton> people,
                                                   std::int64_t id) const;
  [[nodiscard]] std::optional<std::size_t> nearby(std::span<const Skeleton> people,
                                                  double within) const;
  [[nodiscard]] std::optional<std::size_t> followed(std::span<const Skeleton> people,
                                                    double lost) const;
  [[nodiscard]] std::optional<std::size_t> alone(std::span<const Skeleton> people) const;
  [[nodiscard]] bool is_other(std::int64_t id) const;
  void remember(std::span<const Skeleton> people, std::size_t found, double time_s);

  KeyPersonOptions options_;
  bool seen_ = false;
  std::int64_t id_ = 0;
  std::optional<std::int64_t> selected_;
  double last_seen_ = 0.0;
  Eigen::Vector3f position_ = Eigen::Vector3f::Zero();
  double trunk_length_ = 0.0;  ///< Mean, metres; 0: not known.
  std::array<std::int64_t, 16>
      others_{};  ///< Ids of people seen beside it; the oldest is replaced.
  std::size_t num_others_ = 0;
};

}  // namespace manip3d
