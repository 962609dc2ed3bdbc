#pragma once

#include <cstdint>

/// @file
/// The program's operator new counts (allocations.cpp), for tests of what must not allocate.
namespace manip3d::testing {

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
inline constexpr bool kCountsAllocations = false;  // sanitizers have operators of their own
#else
inline constexpr bool kCountsAllocations = true;
#endif

/// Allocations of all threads so far.
std::int64_t num_allocations();

}  // namespace manip3d::testing
