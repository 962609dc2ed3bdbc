"""Find still backgrounds: parts of depth images that never change while other parts do."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

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


def judge_repetition(frames: Sequence[RgbdFrame]) -> tuple[StreamReport, Mask]:
    """Whether a part of the image never changes while another does, and masks of moving pixels."""
    shape = frames[0].depth.shape
    nothing = np.zeros((0, *shape), np.bool_)
    pairs = whole_pairs(frames)
    if len(pairs) < MIN_PAIRS:
        return StreamReport(
            "repetition", "undecidable", "too few frames follow each other"
        ), nothing
    changes = np.zeros(tuple(-(-side // _REGION) for side in shape), np.int64)
    valid = np.full(changes.shape, np.iinfo(np.int64).max)
    for a, b in pairs:
        changes += _by_region(a.depth != b.depth)
        valid = np.minimum(valid, _by_region((a.depth > 0) & (b.depth > 0)))
    looked_at = valid >= _MIN_VALID
    if looked_at.sum() < _MIN_REGIONS:
        return StreamReport(
            "repetition", "undecidable", "too few pixels are measured in all frames"
        ), nothing
    moving = (changes > 0).sum()
    if moving == 0:
        return StreamReport("repetition", "processed", "all frames are the same", 1.0), nothing
    looked_at &= ~_has_one_depth(pairs[0][0].depth)
    frozen = looked_at & (changes == 0)
    share = float(frozen.sum() / max(1, looked_at.sum()))
    if frozen.sum() < _MIN_REGIONS or share < 0.05:
        return _repeated_frames(frames, share), nothing
    # No evidence of an edit by itself: codecs and temporal filters repeat depths that hardly
    # change.
    reason = f"{share:.0%} of the image never changes in {len(pairs)} pairs of frames"
    return StreamReport("repetition", "processed", reason, share), _unfrozen(frames)


def _repeated_frames(frames: Sequence[RgbdFrame], share: float) -> StreamReport:
    """Report on frames that are the same as others to the bit, while depth changes everywhere.

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
    for begin, length in zip(begins, lengths, strict=True):
        if length >= _LONG_RUN and length > 2.0 * usual:
            last = whole[begin + length - 1].number
            told.append(f"frames {whole[begin].number} to {last} are the same")
    if len(again) >= _MIN_AGAIN:
        one, other = whole[firsts[again[0]]].number, whole[again[0]].number
        told.append(
            f"{len(again)} frames come again after others, frame {one} as frame {other} first"
        )
    if told:
        more = f"; {len(told) - 3} more runs of the same frames" if len(told) > 3 else ""
        reason = "; ".join(told[:3]) + more
        return StreamReport("repetition", "processed", reason, share)
    num_same = len(firsts) - len(begins)
    reason = "depth changes everywhere"
    if num_same:
        reason += f", but {num_same} of {len(firsts)} frames are the same as the frame before"
    return StreamReport("repetition", "no_trace", reason, share)


def _hash_of(frame: RgbdFrame) -> bytes:
    return hashlib.blake2b(np.ascontiguousarray(frame.depth).data, digest_size=16).digest()


def _by_region(mask: Mask) -> NDArray[np.int64]:
    """Number of pixels of a mask in each region."""
    return np.asarray(_regions(mask).sum(axis=2), np.int64)


def _regions(image: NDArray[Any]) -> NDArray[Any]:
    """Pixels of each region, (rows, columns, 1024); those beyond the border are 0."""
    height, width = (-(-side // _REGION) * _REGION for side in image.shape)
    padded = np.zeros((height, width), image.dtype)
    padded[: image.shape[0], : image.shape[1]] = image
    blocks = padded.reshape(height // _REGION, _REGION, width // _REGION, _REGION)
    return blocks.swapaxes(1, 2).reshape(*blocks.shape[::2], _REGION**2)


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
