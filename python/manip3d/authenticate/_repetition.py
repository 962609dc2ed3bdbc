"""Find parts of depth images that never change while others do: still backgrounds and people."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.texts import counted
from manip3d.authenticate._stream_frames import MIN_PAIRS, whole_pairs
from manip3d.authenticate._stream_verdict import StreamReport
from manip3d.rgbd import RgbdFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Mask = NDArray[np.bool_]

_REGION = 32  # pixels
_MIN_VALID = 200  # measured pixels of a region that is judged
_MIN_MEASURED = 0.01  # share of the pixels; frames with fewer are empty, and alike by nature
_LONG_RUN = 5  # frames; a camera that skips one or two is no evidence
_MIN_AGAIN = 3  # frames; of measured depths not even one would come again by chance
_MIN_REGIONS = 4  # of 1024 pixels, that are judged, and that never change
_ONE_DEPTH = 0.95  # share of a region's measured pixels; a constant, no surface that was measured
_SMALL_REGION = 8  # pixels; fits into the trunk of a person who is 4 m away
_MIN_SMALL_VALID = 48  # of 64 pixels, measured in all frames
_MIN_SMALL_REGIONS = 16  # as many pixels as one of the large regions has
_ROUGH = 0.5  # share of neighbouring pixels with different depths; less is a surface of few depths
_MAX_CHANCE = 0.01  # expected number of small regions that never change by chance
_MIN_NOISE = 0.5  # steps of the depth image; depths with less noise repeat by nature


def judge_repetition(frames: Sequence[RgbdFrame]) -> tuple[StreamReport, Mask]:
    """Whether a part of the image never changes while another does, and masks of moving pixels."""
    shape = frames[0].depth.shape
    nothing = np.zeros((0, *shape), np.bool_)
    pairs = whole_pairs(frames)
    if len(pairs) < MIN_PAIRS:
        return StreamReport(
            "repetition", "undecidable", "too few frames follow each other"
        ), nothing
    changed = np.zeros(shape, np.bool_)
    always = np.ones(shape, np.bool_)  # measured in all frames
    valid = np.full(_by_region(always).shape, np.iinfo(np.int64).max)
    for a, b in pairs:
        changed |= a.depth != b.depth
        both = (a.depth > 0) & (b.depth > 0)
        always &= both
        valid = np.minimum(valid, _by_region(both))
    looked_at = valid >= _MIN_VALID
    if looked_at.sum() < _MIN_REGIONS:
        return StreamReport(
            "repetition", "undecidable", "too few pixels are measured in all frames"
        ), nothing
    if not changed.any():
        return StreamReport("repetition", "processed", "all frames are the same", 1.0), nothing
    depth = pairs[0][0].depth
    looked_at &= ~_has_one_depth(depth)
    frozen = looked_at & (_by_region(changed) == 0)
    is_background = frozen.sum() >= _MIN_REGIONS and frozen.sum() >= 0.05 * looked_at.sum()
    small = _count_small_frozen(depth, changed, always & _is_noisy(pairs, depth))
    share = float((always & ~changed).sum() / max(1, always.sum()))
    if not is_background and small < _MIN_SMALL_REGIONS:
        return _repeated_frames(frames, share), nothing
    # No evidence of an edit by itself: codecs and temporal filters repeat depths that hardly
    # change.
    reason = f"{share:.0%} of the measured image never changes in {len(pairs)} pairs of frames"
    masks = _unfrozen(frames) if is_background else nothing
    return StreamReport("repetition", "processed", reason, share), masks


def _count_small_frozen(depth: NDArray[np.uint16], changed: Mask, judged: Mask) -> int:
    """Count the small regions that never change.

    A frozen person before a background that changes fills few large regions. Coarse depths of far
    surfaces repeat by nature: surfaces of few depths are not judged. None are counted either if so
    many pixels of the other regions never change that whole regions would by chance.
    """
    num_judged = _by_region(judged, _SMALL_REGION)
    looked_at = (num_judged >= _MIN_SMALL_VALID) & _is_rough(depth, judged)
    still = _by_region(judged & ~changed, _SMALL_REGION)
    frozen = looked_at & (_by_region(changed, _SMALL_REGION) == 0)
    others = looked_at & ~frozen
    chance = float(still[others].sum() / num_judged[others].sum()) if others.any() else 1.0
    if looked_at.sum() * chance**_MIN_SMALL_VALID > _MAX_CHANCE:
        return 0
    return int(frozen.sum())


def _is_noisy(pairs: Sequence[tuple[RgbdFrame, RgbdFrame]], depth: NDArray[np.uint16]) -> Mask:
    """Whether the noise of each pixel is large enough to change its depth by a step.

    Noise grows with the square of the depth, so that near surfaces repeat by nature. Its size is
    that of the usual change of the pixels that change.
    """
    levels = np.unique(depth[depth > 0]).astype(np.float64)
    changes = [change for pair in pairs if (change := _usual_change(*pair)) > 0.0]
    if len(levels) < 2 or not changes:
        return np.zeros(depth.shape, np.bool_)
    noise = np.median(changes) * depth.astype(np.float64) ** 2
    return np.asarray(noise >= _MIN_NOISE * np.diff(levels).min())


def _usual_change(a: RgbdFrame, b: RgbdFrame) -> float:
    """Median change of the measured pixels that change, by the square of depth; 0: none change."""
    changes = (a.depth > 0) & (b.depth > 0) & (a.depth != b.depth)
    if not changes.any():
        return 0.0
    before, after = (frame.depth[changes].astype(np.float64) for frame in (a, b))
    return float(np.median(np.abs(after - before) / before**2))


def _is_rough(depth: NDArray[np.uint16], measured: Mask) -> Mask:
    """Whether neighbouring pixels of each small region mostly have different depths."""
    pairs = np.zeros(depth.shape, np.bool_)
    pairs[:, 1:] = measured[:, 1:] & measured[:, :-1]
    differ = pairs.copy()
    differ[:, 1:] &= depth[:, 1:] != depth[:, :-1]
    num_pairs = _by_region(pairs, _SMALL_REGION)
    return np.asarray(_by_region(differ, _SMALL_REGION) >= _ROUGH * num_pairs)


def _repeated_frames(frames: Sequence[RgbdFrame], share: float) -> StreamReport:
    """Report on frames that are the same as others to the bit, while no part of them is frozen.

    ``share`` of the measured pixels never change.

    A rate that was raised shows each frame equally often. Longer runs, and frames that come again
    after others, are a frozen or looped recording.
    """
    whole = [frame for frame in frames if np.mean(frame.depth > 0) >= _MIN_MEASURED]
    first_of: dict[bytes, int] = {}
    firsts = [first_of.setdefault(_hash_of(frame), place) for place, frame in enumerate(whole)]
    begins = [k for k in range(len(firsts)) if k == 0 or firsts[k] != firsts[k - 1]]
    lengths = np.diff([*begins, len(firsts)])
    usual = float(np.median(lengths)) if len(lengths) else 1.0
    again = [begin for begin in begins if firsts[begin] < begin]
    told = []
    if len(again) >= _MIN_AGAIN:
        one, other = whole[firsts[again[0]]].number, whole[again[0]].number
        told.append(
            f"{len(again)} frames come again after others, frame {one} as frame {other} first"
        )
    for begin, length in zip(begins, lengths, strict=True):
        if length >= _LONG_RUN and length > 2.0 * usual:
            last = whole[begin + length - 1].number
            told.append(f"frames {whole[begin].number} to {last} are the same")
    if told:
        more = f"; {counted(len(told) - 3, 'more run')} of the same frames" if len(told) > 3 else ""
        reason = "; ".join(told[:3]) + more
        return StreamReport("repetition", "processed", reason, share)
    num_same = len(firsts) - len(begins)
    reason = "depth changes everywhere"
    if share >= 0.005:  # 1 %, rounded
        reason = f"{share:.0%} of the measured pixels never change, which alone is no evidence"
    if num_same:
        reason += f", but {num_same} of {len(firsts)} frames are the same as the frame before"
    return StreamReport("repetition", "no_trace", reason, share)


def _hash_of(frame: RgbdFrame) -> bytes:
    return hashlib.blake2b(np.ascontiguousarray(frame.depth).data, digest_size=16).digest()


def _by_region(mask: Mask, side: int = _REGION) -> NDArray[np.int64]:
    """Number of pixels of a mask in each region."""
    return np.asarray(_regions(mask, side).sum(axis=2), np.int64)


def _regions(image: NDArray[Any], side: int = _REGION) -> NDArray[Any]:
    """Pixels of each region, (rows, columns, side * side); those beyond the border are 0."""
    height, width = (-(-length // side) * side for length in image.shape)
    padded = np.zeros((height, width), image.dtype)
    padded[: image.shape[0], : image.shape[1]] = image
    blocks = padded.reshape(height // side, side, width // side, side)
    return blocks.swapaxes(1, 2).reshape(*blocks.shape[::2], side**2)


def _has_one_depth(depth: NDArray[np.uint16]) -> Mask:
    """Whether almost all measured pixels of each region have the same depth."""
    regions = np.sort(_regions(depth), axis=2)
    num_missing = (regions == 0).sum(axis=2, keepdims=True)
    # a depth that most measured pixels have is their median
    place = (num_missing + regions.shape[2]) // 2
    middle = np.take_along_axis(regions, np.minimum(place, regions.shape[2] - 1), axis=2)
    num_equal = (regions == middle).sum(axis=2)
    return np.asarray(num_equal >= _ONE_DEPTH * (regions.shape[2] - num_missing[..., 0]))


def _unfrozen(frames: Sequence[RgbdFrame]) -> Mask:
    """Measured pixels whose depth is not the one that their place has in most frames."""
    depths = np.stack([frame.depth for frame in frames])
    middle = np.sort(depths, axis=0)[len(depths) // 2]  # the value of most frames is the median
    usual = (depths == middle).mean(axis=0) >= 0.6
    return np.asarray((depths > 0) & ~(usual & (depths == middle)))
