#pragma once

#include <Eigen/Core>
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
/// are as near; then whoever has its id. Once lost for `patience`, the body nearest to where it was
/// last seen, within `reach`.
class KeyPerson {
 public:
  /// @throws InputError  an option that is not >= 0.
  explicit KeyPerson(const KeyPersonOptions& options = {});
  /// Which of the people it is; none while it is lost. Times grow.
  std::optional<std::size_t> find(std::span<const Skeleton> people, const Intrinsics& camera,
                                  double time_s);
  /// Seconds since it was last seen; infinite if nobody ever was.
  [[nodiscard]] double lost_for(double time_s) const;
  void reset() { seen_ = false; }

 private:
  KeyPersonOptions options_;
  bool seen_ = false;
  std::int64_t id_ = 0;
  double last_seen_ = 0.0;
  Eigen::Vector3f position_ = Eigen::Vector3f::Zero();
};

}  // namespace manip3d
