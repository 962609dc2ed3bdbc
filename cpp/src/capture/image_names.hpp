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
/// with a point between them (`1700000000.25`) where has_decimals() says so. The rules are those of
/// `by_number` in python/manip3d/_util/paths.py and of `colors_of_frames` in
/// python/manip3d/simplify/_depth_sets.py.
namespace manip3d {

/// Whether numbers with a point, in the names of one list, are decimals, as times are.
///
/// Otherwise the point is between two whole numbers: 1.9, 1.10, 1.11 are frames of a take. Decimals
/// are as fine as times: one has five digits before its point or three after it. All have as many
/// digits after the point, or none has a 0 at its end, as programs write 1.5 for 1.50.
bool has_decimals(const std::vector<std::string>& names);

/// Returns names of one list with blanks for the points between digits, unless it has_decimals().
std::vector<std::string> with_whole_numbers(std::vector<std::string> names);

/// Whether the name of a file comes before that of another one.
///
/// Digits are compared by the value of their run, so that 2 is before 10, and come before other
/// characters; 01 is before 1. If their list has `decimals`, a name that is a decimal number
/// (`0.25.png`) is compared by its value: its digits after the point are a fraction. Names have
/// their suffixes.
bool comes_before(std::string_view a, std::string_view b, bool decimals);

/// Returns a decimal number (digits, optionally a point and more digits) times 10^`places`, without
/// the digits that are then left after the point. Empty: the text is no such number, or the result
/// does not fit 64 bits.
std::optional<std::int64_t> scaled_decimal(std::string_view text, int places);

/// The kind of an image, for which some names have a word: `depth_1`; `color_1`, `colour_1`,
/// `rgb_1`.
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
/// Lost frames leave gaps if the last numbers that change from name to name are frame numbers:
/// whole, below 1e9 and ascending, with differences that are multiples of the smallest one, and
/// most equal to it. Otherwise the indices are those in the list.
std::vector<std::int64_t> frame_indices(const std::vector<std::string>& names);

/// Pairs depth and colour images, which are in the order of their names, by name or by order.
/// Returns for each depth image the index of its colour image, or -1.
///
/// Names agree if they are the same; or else without the words for their kinds, with numbers
/// compared by value; or else if they have the same numbers. The frame number is the last number
/// that changes from name to name.
///
/// 1. If all depth images have a colour image whose name agrees, these are pairs, unless two
///    counters may have numbered them: both lists lack no number and begin with the same one, and
///    there are more than ten colour images for nine depth images.
/// 2. Lists of equal length are paired by order if no names agree; if at most one in ten does, and
///    the numbers are no frame numbers, but milliseconds, say; or if both lists are counted without
///    gaps, from the same number, or one from 0, the other from 1. The count may also be the first
///    number that changes, before a time.
/// 3. If two thirds of the depth images have a colour image whose name agrees, these are pairs, and
///    the others have none, because frames were lost. Lists without gaps have lost none, and may
///    be numbered differently: then nine of ten are needed, and lists of equal length must both
///    have gaps.
/// @throws FormatError  none of these holds.
std::vector<std::int64_t> pair_by_name(const std::vector<std::string>& depth_names,
                                       const std::vector<std::string>& color_names);

}  // namespace manip3d
