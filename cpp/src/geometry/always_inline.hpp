#pragma once

/// Small functions in loops over pixels and lanes must vanish, or the loops take one at a time.
#define MANIP3D_INLINE [[gnu::always_inline]] inline
