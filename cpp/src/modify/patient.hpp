#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/clothing.hpp"
#include "manip3d/modify/joint_smoother.hpp"
#include "manip3d/modify/key_person.hpp"
#include "manip3d/modify/mirror.hpp"
#include "manip3d/modify/phantom_pipeline.hpp"
#include "modify/feet_ahead.hpp"

namespace manip3d {

/// The patient in one frame.
struct PatientFrame {
  /// Smoothed. If it is not in this frame: as last seen. No value: nobody.
  std::optional<Skeleton> person;
  Skeleton raw;          ///< From the tracker, before smoothing; only if `is_here`.
  bool is_here = false;  ///< Whether the tracker reported it in this frame.
  bool is_new = false;   ///< May be another person than before: forget everything that was learnt.
};

/// Tracks the patient's skeleton from frame to frame: which of the people it is (KeyPerson), its
/// smoothed joints, and which of its sides is the left one.
class Patient {
 public:
  explicit Patient(const PhantomOptions& options);

  /// @param rays   Rays of the input's camera.
  /// @param frame  Axes of the body known before this frame; null: left and right are those of the
  ///               tracker.
  PatientFrame find(const PhantomInput& input, const PixelRays& rays, const BodyFrame* frame,
                    double time_s);
  void select(std::int64_t id) { key_person_.select(id); }
  /// Whether any person has been seen since the last reset.
  [[nodiscard]] bool has_been_seen() const { return has_been_seen_; }
  /// Whether the feet point backwards according to the sides of the tracker, as in a mirrored
  /// image.
  [[nodiscard]] bool has_feet_backwards() const { return feet_.point_backwards(); }
  void reset();

 private:
  void look_at_clothes(const PhantomInput& input, const PixelRays& rays);
  void start(std::optional<std::int64_t> id);
  bool keep_sides(Skeleton& reported, const BodyFrame* frame, double time_s);
  [[nodiscard]] double patience_for_sides() const;
  [[nodiscard]] bool is_at_same_place(const Skeleton& reported) const;
  [[nodiscard]] Skeleton smoothed(const Skeleton& reported);

  Limb affected_;
  bool smooths_;
  double most_lost_;  ///< Seconds after which a patient who is not in view is forgotten.
  KeyPerson key_person_;
  JointSmoother smoother_;
  std::vector<ClothingColors> clothes_;  ///< Clothes of the people in a frame.

  bool has_been_seen_ = false;
  std::optional<std::int64_t> id_;
  std::optional<Skeleton> person_;
  double sides_kept_since_;   ///< Time of the last frame in which the tracker's sides agreed.
  double sides_known_since_;  ///< Time since which the body's left is known.
  FeetAhead feet_;            ///< With the sides as corrected.
};

/// Whether all tracked joints are farther away than any camera sees, as when millimetres were taken
/// for metres.
bool is_in_another_unit(const Skeleton& skeleton);

}  // namespace manip3d
