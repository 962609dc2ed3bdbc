#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

#include "capture/jpeg.hpp"

/// @file
/// Uncompressed colour images of an Azure Kinect's recordings.
namespace manip3d {

/// NV12: luma of all pixels, then U and V of each 2 x 2 pixels. YUY2: luma, U, luma and V of each
/// two pixels. BGRA: the fourth byte is not used. Rows are stored from top to bottom.
enum class RawColor { kNv12, kYuy2, kBgra };

/// The layout with this codec identifier of Video for Windows; empty: it is another one.
std::optional<RawColor> raw_color_of(std::uint32_t four_cc);

/// Converts an image to R, G, B. Luma is from 16 to 235, by ITU-R BT.601, as in the Azure Kinect's
/// SDK.
/// @throws FormatError  an image of another length, or of YUV with an odd side.
void decode_raw_color(RawColor layout, std::span<const std::byte> image, ImageSize size,
                      std::uint8_t* rgb);

}  // namespace manip3d
