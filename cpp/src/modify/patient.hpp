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
  std::optional<Skeleton> person;  ///< Smoothed; as last seen where it is not here; none: nobody.
  Skeleton raw;                    ///< The tracker's, before smoothing; only if it is here.
  bool is_here = false;            ///< Has the tracker told it in this frame?
  bool is_new = false;  ///< May be somebody else than before: nothing that was learnt holds.
};

/// Follows the patient's skeleton from frame to frame: who of the people it is (KeyPerson), its
/// smoothed joints, and which of its sides is the left one.
class Patient {
 public:
  explicit Patient(const PhantomOptions& options);

  /// @param rays   of the input's camera.
  /// @param frame  axes of the body as known before this frame; null: left and right are the
  ///               tracker's word.
  PatientFrame find(const PhantomInput& input, const PixelRays& rays, const BodyFrame* frame,
                    double time_s);
  void select(std::int64_t id) { key_person_.select(id); }
  /// Has any person ever been seen since the last reset?
  [[nodiscard]] bool has_been_seen() const { return has_been_seen_; }
  /// Do the feet point backwards if the left is where it is told, as in a mirrored image?
  [[nodiscard]] bool has_feet_backwards() const { return feet_.point_backwards(); }
  void reset();

 private:
  void look_at_clothes(const PhantomInput& input, const PixelRays& rays);
  void start(std::optional<std::int64_t> id);
  bool keep_sides(Skeleton& told, const BodyFrame* frame, double time_s);
  [[nodiscard]] double patience_for_sides() const;
  [[nodiscard]] bool is_at_same_place(const Skeleton& told) const;
  [[nodiscard]] Skeleton smoothed(const Skeleton& told);

  Limb affected_;
  bool smooths_;
  double most_lost_;  ///< Seconds after which a patient who is not seen is forgotten.
  KeyPerson key_person_;
  JointSmoother smoother_;
  std::vector<ClothingColors> clothes_;  ///< Memory for those of the people in a frame.

  bool has_been_seen_ = false;
  std::optional<std::int64_t> id_;
  std::optional<Skeleton> person_;
  double sides_kept_since_;   ///< Since when the tracker takes left for right.
  double sides_known_since_;  ///< Since when the body's left is known.
  FeetAhead feet_;            ///< By the sides that are kept.
};

/// Are all tracked joints farther away than any camera sees, as millimetres are that were taken for
/// metres?
bool is_in_another_unit(const Skeleton& skeleton);

}  // namespace manip3d
