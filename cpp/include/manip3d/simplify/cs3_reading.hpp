#pragma once

#include <cstdint>

namespace manip3d {

/// Choices that the text leaves open. The defaults are the reading that manip3d uses; the others
/// show how much the results depend on them.
struct Cs3Reading {
  /// Second differences of A.
  enum class Stencil : std::uint8_t {
    kGradientOfGradient,  ///< Central differences, applied twice: (A(u+2) - 2 A(u) + A(u-2)) / 4.
    kCompact,             ///< A(u+1) - 2 A(u) + A(u-1).
    kForward,             ///< A(u+2) - 2 A(u+1) + A(u).
    kSobel,               ///< kCompact, smoothed by (1, 2, 1) in the other direction.
  };
  /// A(u) if the next pixel to the right or below is not valid.
  enum class BesideInvalid : std::uint8_t {
    kBackward,  ///< The difference to the previous pixel; 0 if that is not valid either.
    kZero,      ///< 0, as computed by a program that fills invalid pixels with zeros.
    kUnknown,   ///< Unknown; the importance of the pixels around it is then the lowest.
  };
  /// Rounding of Rd before the side 2 Rd + 1 of the blocked square is computed.
  enum class Rounding : std::uint8_t { kDown, kNearest, kUp };

  Stencil stencil = Stencil::kGradientOfGradient;
  BesideInvalid beside_invalid = BesideInvalid::kBackward;
  Rounding rounding = Rounding::kDown;
  double outliers = 0.0;  ///< Share of the pixels that may lie above Omega_max.

  bool operator==(const Cs3Reading&) const = default;
};

}  // namespace manip3d
