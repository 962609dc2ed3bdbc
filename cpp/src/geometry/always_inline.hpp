#pragma once

/// Small functions in loops over pixels and lanes must be inlined; otherwise the loops are not
/// vectorized.
#define MANIP3D_INLINE [[gnu::always_inline]] inline
