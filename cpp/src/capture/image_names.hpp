#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

/// @file
/// Times and frame numbers in the names of image files, and the order and the pairs that follow.
///
/// Names have no suffix unless stated otherwise. A number in a name is a run of digits, or two runs
/// with a point between them (`1700000000.25`). The rules are those of `by_number` in
/// python/manip3d/_util/paths.py and of `colors_of_frames` in
/// python/manip3d/simplify/_depth_sets.py.
namespace manip3d {

/// Whether the name of a file comes before that of another one.
///
/// Digits are compared by the value of their run, so that 2 is before 10, and come before other
/// characters; 01 is before 1. A name that is a decimal number (`0.25.png`) is compared by its
/// value: its digits after the point are a fraction. Names have their suffixes.
bool comes_before(std::string_view a, std::string_view b);

/// Returns a decimal number (digits, optionally a point and more digits) times 10^`places`, without
/// the digits that are then left after the point. Empty: the text is no such number, or the result
/// does not fit 64 bits.
std::optional<std::int64_t> scaled_decimal(std::string_view text, int places);

/// What an image shows, as some names say: `depth_1`; `color_1`, `colour_1`, `rgb_1`.
enum class ImageKind { kDepth, kColor };

/// Returns the time, in nanoseconds, that a name consists of beside the word for its kind.
///
/// A time has a fraction, or so many digits that it counts milliseconds, microseconds or
/// nanoseconds since 1970; with fewer digits it is in seconds. Empty: the name is no time.
std::optional<std::int64_t> time_in_name(std::string_view name, ImageKind kind);

/// Whether nine of ten names are times; others may lie beside them, such as a preview.
bool are_times(const std::vector<std::optional<std::int64_t>>& times);

/// Returns the index of each frame in its sequence, counted from the first frame of the list.
///
/// Lost frames leave gaps if the last numbers in the names are frame numbers: whole, below 1e9 and
/// ascending, with differences that are multiples of the smallest one, and most equal to it.
/// Otherwise the indices are those in the list.
std::vector<std::int64_t> frame_indices(const std::vector<std::string>& names);

/// Pairs depth and colour images, which are in the order of their names, by name or by order.
/// Returns for each depth image the index of its colour image, or -1.
///
/// Names agree if they are the same without the words for their kinds, with numbers compared by
/// value; or else if they have the same numbers.
///
/// 1. If all depth images have a colour image whose name agrees, these are pairs.
/// 2. Lists of equal length are paired by order if no names agree, or if one list is numbered from
///    0, the other from 1, and neither has gaps.
/// 3. If two thirds of the depth images have a colour image whose name agrees, these are pairs, and
///    the others have none, because frames were lost. Lists without gaps have lost none, and may
///    be numbered differently: then nine of ten are needed, and lists of equal length must both
///    have gaps.
/// @throws FormatError  none of these holds.
std::vector<std::int64_t> pair_by_name(const std::vector<std::string>& depth,
                                       const std::vector<std::string>& color);

}  // namespace manip3d
