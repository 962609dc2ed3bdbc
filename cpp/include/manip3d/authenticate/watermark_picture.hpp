#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

/// @file
/// A picture of the same moment as carrier of a scan's record: the lowest bits of its first
/// samples.
namespace manip3d {

/// A borrowed picture of 8 bits a sample, row by row without gaps: grey, or red, green and blue in
/// turn.
struct PictureView {
  std::span<const std::uint8_t> samples;  ///< (height, width, channels)
  std::uint32_t height = 0, width = 0;
  std::uint32_t channels = 1;  ///< 1 or 3.
};

/// How many of a picture's first samples carry a record in their lowest bits: the lowest bit of
/// each byte comes first, and zeros follow the record.
constexpr std::size_t kCarrierSamples = 16384;
constexpr std::size_t kMostCarried = kCarrierSamples / 8;  ///< Bytes of a record in a picture.

/// Checks that a picture can carry a record; every function here that takes a picture calls it.
/// @throws InputError  neither one nor three channels, another number of samples than its shape
///                     has, or fewer than `kCarrierSamples`.
void check_picture(const PictureView& picture);

/// The samples with the carrier's bits cleared: what a record binds, and what both ends see.
/// @throws InputError  as `check_picture`.
std::vector<std::uint8_t> without_record(const PictureView& picture);

/// The samples with a record in place of the carrier's bits.
/// @throws InputError  as `check_picture`; a record of more than `kMostCarried` bytes.
std::vector<std::uint8_t> with_record(const PictureView& picture,
                                      std::span<const std::uint8_t> record);

/// The bytes of the record that a picture carries. Their number follows from the slices and tiles
/// that the record itself states; nothing here is authenticated.
/// @throws InputError  as `check_picture`.
/// @throws FormatError  there is no record, it would be longer than the carrier, or bits behind it
///                      are set.
std::vector<std::uint8_t> record_in(const PictureView& picture);

}  // namespace manip3d
