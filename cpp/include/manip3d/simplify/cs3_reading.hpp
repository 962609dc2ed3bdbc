#pragma once

#include <cstdint>

namespace manip3d {

/// Choices open in the text. The defaults are the reading that manip3d keeps; the others are here
/// to show how much depends on it.
struct Cs3Reading {
  /// Second differences of A.
  enum class Stencil : std::uint8_t {
    kGradientOfGradient,  ///< Central differences, applied twice: (A(u+2) - 2 A(u) + A(u-2)) / 4.
    kCompact,             ///< A(u+1) - 2 A(u) + A(u-1).
    kForward,             ///< A(u+2) - 2 A(u+1) + A(u).
    kSobel,               ///< kCompact, smoothed by (1, 2, 1) across.
  };
  /// A(u) where the next pixel to the right or below is not valid.
  enum class BesideInvalid : std::uint8_t {
    kBackward,  ///< The difference to the pixel before; 0 where that is not valid either.
    kZero,      ///< 0, as a program does that fills invalid pixels with zeros.
    kUnknown,   ///< Unknown, and so is the importance around it: the least.
  };
  /// The side of a blocked square is 2 Rd + 1 for Rd rounded so.
  enum class Rounding : std::uint8_t { kDown, kNearest, kUp };

  Stencil stencil = Stencil::kGradientOfGradient;
  BesideInvalid beside_invalid = BesideInvalid::kBackward;
  Rounding rounding = Rounding::kDown;
  double outliers = 0.0;  ///< This share of the pixels may lie above Omega_max.

  bool operator==(const Cs3Reading&) const = default;
};

}  // namespace manip3d
