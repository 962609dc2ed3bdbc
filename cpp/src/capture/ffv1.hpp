#pragma once

#include <cstddef>
#include <span>

/// @file
/// What has to be known about FFV1 (RFC 9043) before a decoder sees it: FFmpeg takes up to 1.5 MB
/// for each slice of an image, however few its bytes.
namespace manip3d {

/// The version at the start of an FFV1 stream's header; 0: there is no header (versions 0 and 1).
int ffv1_version(std::span<const std::byte> header);

/// FFmpeg's encoder makes 4 slices of images up to 1080p, 24 at most unasked.
inline constexpr int kMaxFfv1Slices = 64;
/// The slices of an image, with or without CRCs, whichever are more: only the header, which is not
/// read here, says which. Counting stops beyond kMaxFfv1Slices.
int count_ffv1_slices(std::span<const std::byte> packet);

}  // namespace manip3d
