#pragma once

#include <cstddef>
#include <span>

/// @file
/// Checks of FFV1 streams (RFC 9043) before they are decoded, because FFmpeg allocates up to 1.5 MB
/// for each slice of an image, however few bytes it has.
namespace manip3d {

/// The version in the header of an FFV1 stream; 0: there is no header (versions 0 and 1).
int ffv1_version(std::span<const std::byte> header);

/// Limit of slices. FFmpeg's encoder makes 4 slices of images up to 1080p, and 24 at most by
/// default.
inline constexpr int kMaxFfv1Slices = 64;
/// Counts the slices of an image, with and without CRCs, and returns the larger number: only the
/// header, which is not read here, says which is right. Counting stops beyond kMaxFfv1Slices.
int count_ffv1_slices(std::span<const std::byte> packet);

}  // namespace manip3d
