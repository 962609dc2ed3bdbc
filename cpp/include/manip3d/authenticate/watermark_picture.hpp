#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

/// @file
/// A picture that was taken together with a scan and carries its record: in the lowest bits of its
/// first samples.
namespace manip3d {

/// A borrowed picture with 8 bits per sample, row by row without gaps: grey, or red, green and blue
/// interleaved.
struct PictureView {
  std::span<const std::uint8_t> samples;  ///< (height, width, channels)
  std::uint32_t height = 0, width = 0;
  std::uint32_t channels = 1;  ///< 1 or 3.
};

/// Number of samples at the beginning of a picture that carry the record in their lowest bits. The
/// lowest bit of each byte comes first, and zeros follow the record.
constexpr std::size_t kCarrierSamples = 16384;
/// Bytes of the longest record in a picture.
constexpr std::size_t kMaxCarried = kCarrierSamples / 8;

/// Checks that a picture can carry a record. Every function here that takes a picture calls it.
/// @throws InputError  neither one nor three channels, a number of samples that contradicts the
///                     shape, or fewer than `kCarrierSamples`.
void check_picture(const PictureView& picture);

/// Returns the samples with the carrier bits cleared, which embedder and verifier both see. The
/// record binds these.
/// @throws InputError  as `check_picture`.
std::vector<std::uint8_t> without_record(const PictureView& picture);

/// Returns the samples with a record in the carrier bits.
/// @throws InputError  as `check_picture`; the record has more than `kMaxCarried` bytes.
std::vector<std::uint8_t> with_record(const PictureView& picture,
                                      std::span<const std::uint8_t> record);

/// Returns the bytes of the record in a picture. Their number follows from the numbers of slices
/// and tiles that the record states. Nothing is authenticated here.
/// @throws InputError  as `check_picture`.
/// @throws FormatError  there is no record, it would be longer than the carrier, or bits behind it
///                      are set.
std::vector<std::uint8_t> record_in(const PictureView& picture);

}  // namespace manip3d
