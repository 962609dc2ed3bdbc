"""Distinguish silhouettes that a depth camera measures from those of objects that were cut out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d.authenticate._filter_traces import filter_trace
from manip3d.authenticate._passages import RELIEF, passages
from manip3d.authenticate._stream_frames import following
from manip3d.authenticate._stream_verdict import StreamRegion, StreamReport, box_of
from manip3d.authenticate._verdict import Verdict
from manip3d.camera import Intrinsics
from manip3d.rgbd import RgbdCalibration, RgbdFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Mask = NDArray[np.bool_]
    Depth = NDArray[np.uint16]

SHARP = 0.6
"""Least share of sharp rows on the less sharp side of the silhouette of an object that was cut out.
It is at most 0.42 in the clean frames on which the limit was chosen, and at least 0.66 in forged
frames with a person."""

BLENDED = 0.5
"""Least share of blended rows of a silhouette that is blended into its background. A row is blended
if it has neither a gap nor a step from one pixel to the next on either side. The share is at most
0.03 in 123 clean frames of four cameras with structured light, 0.42 to 0.77 in images that were
made smaller by averaging, and has medians of 0.53 to 1 for people who were blended in over a pixel
or more."""

_NO_GAP = 1  # pixels; one pixel may be missing by chance
_RUN = 5  # frames; a single sharp silhouette may be chance
_MIN_ROWS = 40  # rows of a silhouette that is judged
_MIN_NOISE = 0.5  # mm at 1 m: rendered images have less
MIN_SPECKLES = 2e-4  # share of pixels; cameras lose 3e-4 and more, renderings 1.4e-4 at most
_RIM = 3  # pixels of one surface on each side of a sharp step
_KEPT = 0.5  # share of sharp rims; filters that fill in old depths have 0.65 to 0.69
_KEPT_MORE = 1.7  # times the middle's share; these filters have 2.1 or more, cut-outs 1.45
_ALIKE = 0.05  # largest difference of the shares of rims and middles in repeated images
_WIDE = 18  # pixels; least width of a row whose middle does not overlap its rims
_MIN_WIDE = 0.2  # least share of wide rows; with fewer the object is narrow

_ALL_SHARP = 0.9
"""Least share of sharp passages between other surfaces than the accused object's, of images in
which everything is sharp. It was chosen on random rendered scenes of spheres, with the noise and
the missing pixels of a camera, and adjusted on more of them, with seeds up to 4500; in scenes of
other seeds the share is at least 0.95. It is at most 0.83 in forged streams before other objects
that simulated and recorded cameras of time of flight saw (people of UTD-MHAD, waving), on which it
was chosen, too."""

_FILLED_SHARP = 0.8
"""Least share of sharp passages between other surfaces, of images of structured light and stereo
whose wide gaps were filled: some gaps remain. Without a filter about half of the passages are
sharp, those on the side without a shadow. It was chosen before the recordings with filled gaps were
looked at, but kept partly because of how they came out, so that they do not test it."""

_MIN_ELSEWHERE = 0.05
"""Least number of these passages, per row of the accused object. It is at most 0.01 for waving and
simulated people before a wall alone, and mostly 0.1 and more in the same rendered scenes."""

_BESIDE_MM = 300
_AROUND_MM, _BEFORE_MM, _BEHIND_MM = 1200, 800, 250
"""Surfaces that may be parts of the same person as the accused object: those above or below it, up
to 0.3 m to the left or right, and those within 1.2 m in the image, from 0.8 m before it to 0.25 m
behind it, because arms are stretched forwards. These lengths follow from the size of people and
have no measurement of their own; `_ALL_SHARP` and `_MIN_ELSEWHERE` were measured with them."""

_TIME_OF_FLIGHT = {
    (512, 424), (640, 576), (320, 288), (512, 512), (1024, 1024), (1024, 768), (256, 192),
    (224, 172),
}  # fmt: skip
"""Image sizes of the Kinect V2, the Azure Kinect, the RealSense L515, Apple's LiDAR (ARKit) and
PMD's cameras, which mix depths at silhouettes. Filling gaps beside such silhouettes does not make
them sharp."""

_WIDE_GAP = 0.02  # share of the longer side: 12 of 640 pixels
_MIN_WIDE_GAPS = 0.02  # share of the gaps; at least 0.11 for cameras, almost 0 in filled images

_COPIED = 0.25
"""Least share of equal depths beside missing pixels, on three of their four sides, as a part of
those that differ seven pixels farther inside. It is -0.04 on the turning person and at most 0.06 on
forged streams before its wall (UTD-MHAD's subjects 1, 4 and 5), on which it was chosen, and 0.62
once the turning person's holes are filled one pixel deep from their four neighbours. On the other
subjects it is at most 0.09."""

_COPIED_ALONG, _NOT_ALIKE = 0.99, 0.95
"""Least share of equal depths on one side of missing pixels, and the largest farther inside, of
filters that fill along rows or columns: all of the depths that they leave there are copies."""

_ALONE = 1e-3
"""Least number of missing pixels that stand alone, per gap within rows. It is 9e-3 on the turning
person, 8e-3 and more on the same forged streams, and 0 once small holes are filled."""

_MIN_RIMS, _MIN_GAPS = 200, 2000  # fewer are no evidence
_INNER = 7  # pixels; filters that fill deeper leave no gap beside most silhouettes
_MAX_FILLED = 12  # frames that are looked at for filled holes


def judge_silhouettes(
    frames: Sequence[RgbdFrame],
) -> tuple[StreamReport, tuple[StreamRegion, ...], Mask]:
    """Judge whether foreground objects were cut out of other recordings, and where they are.

    Returned are the report, the regions of cut-out objects, and a mask of them for each frame.

    Structured light and stereo leave their shadows along the rows of the sensor. Images higher than
    wide are of a camera that was mounted upright, so that they are judged along their columns.
    """
    height, width = frames[0].depth.shape
    if height <= width:
        return _judged_along_rows(frames)
    report, regions, masks = _judged_along_rows([_turned(frame) for frame in frames])
    turned = tuple(replace(each, box=_turned_box(each.box)) for each in regions)
    return report, turned, np.ascontiguousarray(masks.transpose(0, 2, 1))


def _turned(frame: RgbdFrame) -> RgbdFrame:
    """The depth image with rows and columns exchanged."""
    camera = frame.calibration.depth
    turned = Intrinsics(
        camera.height, camera.width, abs(camera.fy), camera.fx, camera.cy, camera.cx
    )
    depth = np.ascontiguousarray(frame.depth.T)
    return RgbdFrame(depth, RgbdCalibration(turned), time_ns=frame.time_ns, number=frame.number)


def _turned_box(box: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    u, v, width, height = box
    return v, u, height, width


def _judged_along_rows(
    frames: Sequence[RgbdFrame],
) -> tuple[StreamReport, tuple[StreamRegion, ...], Mask]:
    """Return the report on silhouettes that cross rows of pixels, and the regions of a cut-out.

    Sharp silhouettes accuse only if nothing else can have made them: a renderer, a filter that
    repeats or fills pixels, and surfaces without a shadow are asked one after the other.
    """
    found = [_cut_out(frame) for frame in frames]
    best = [max((object_.share for object_ in objects), default=None) for objects in found]
    told = [share for share in best if share is not None]
    nothing = np.zeros((0, *frames[0].depth.shape), np.bool_)
    # If an object is visible for a short time only, few frames show silhouettes.
    is_seen = 2 * len(told) >= len(frames)
    score, first, last = _sharpest_run(best) if is_seen else _sharpest_whole_run(best)
    if not is_seen and score < SHARP:
        why = "too few silhouettes before a background to judge by"
        return StreamReport("silhouettes", "undecidable", why), (), nothing
    if (doubt := _rendered(frames)) is not None:
        return StreamReport("silhouettes", "undecidable", doubt, score), (), nothing
    if score < SHARP:
        if (blended := _blended(frames, found)) >= BLENDED:
            why = (
                f"silhouettes pass into what is behind them without a gap in {blended:.0%} of their"
                " rows. Only time-of-flight cameras measure them so, and none of this image size is"
                " known: whether somebody was cut out and blended in cannot be told"
            )
            return StreamReport("silhouettes", "undecidable", why, score), (), nothing
        one = "the one frame that was judged"
        judged = one if len(frames) == 1 else f"{len(frames)} frames that were judged"
        why = f"silhouettes are as soft as a camera's in {judged}"
        return StreamReport("silhouettes", "no_trace", why, score), (), nothing
    rim, middle = _repeated_rims(frames, found)
    if rim >= _KEPT:
        why = f"silhouettes are sharp, but {rim:.0%} of their rims repeat the frame before"
        cannot = "whether somebody was cut out cannot be told"
        if middle is None:
            why += f", and nothing is wide enough to tell rims from what is between: {cannot}"
            return StreamReport("silhouettes", "undecidable", why), (), nothing
        why += f", and {middle:.0%} of what is between"
        if rim >= _KEPT_MORE * middle:
            why += f": missing pixels kept their depth, and {cannot}"
            return StreamReport("silhouettes", "processed", why, score), (), nothing
        if _KEPT_MORE * middle > 1.0 and 1.0 - middle > _KEPT_MORE * (1.0 - rim) + _ALIKE:
            why += f", too many to tell a filter from pictures that are shown again: {cannot}"
            return StreamReport("silhouettes", "undecidable", why), (), nothing
    if (unsure := _without_shadows(frames, found)) is not None:
        verdict, why = unsure
        return StreamReport("silhouettes", verdict, why, score), (), nothing
    regions, masks = _cut_regions(frames, found)
    if (trace := _filled(frames) or filter_trace(frames, masks)) is not None:
        why = f"silhouettes are sharp, but {trace}, and whether somebody was cut out cannot be told"
        return StreamReport("silhouettes", "processed", why, score), (), nothing
    why = f"silhouettes are sharp on both sides in {score:.0%} of their rows: cut out"
    if (first, last) != (0, len(frames) - 1):
        why += f" in frames {frames[first].number} to {frames[last].number} most of all"
    return StreamReport("silhouettes", "tampered", why, score), regions, masks


def _cut_regions(
    frames: Sequence[RgbdFrame], found: Sequence[Sequence[_Cut]]
) -> tuple[tuple[StreamRegion, ...], Mask]:
    """Return the regions of sharp objects, and a mask of their measured pixels for each frame."""
    height, width = frames[0].depth.shape
    masks = np.zeros((len(frames), height, width), np.bool_)
    regions = []
    for frame, objects, mask in zip(frames, found, masks, strict=True):
        for cut in objects:
            if cut.share < SHARP:
                continue
            inside = _inside(cut.spans, (height, width))
            mask |= inside & (frame.depth > 0)
            regions.append(StreamRegion(frame.number, box_of(inside), cut.share))
    return tuple(regions), masks


def _inside(spans: NDArray[np.int32], shape: tuple[int, int]) -> Mask:
    """Pixels of an image that lie within any of the spans."""
    height, width = shape
    # 1 where a span begins, -1 behind its end
    edges = np.zeros((height, width + 1), np.int32)
    np.add.at(edges, (spans[:, 0], spans[:, 1]), 1)
    np.add.at(edges, (spans[:, 0], spans[:, 2]), -1)
    return np.asarray(np.cumsum(edges, axis=1)[:, :-1] > 0)


def _sharpest_run(best: Sequence[float | None]) -> tuple[float, int, int]:
    """Largest median share of five successive frames, and the first and the last of these.

    A forgery may cover only a part of a stream. Without five such frames, it is the median of all.
    """
    shares = np.array([np.nan if share is None else share for share in best])
    found = (float(np.median(shares[~np.isnan(shares)])), 0, len(shares) - 1)
    for start in range(len(shares) - _RUN + 1):
        run = shares[start : start + _RUN]
        told = run[~np.isnan(run)]
        if 2 * len(told) > _RUN and float(np.median(told)) > found[0]:
            found = (float(np.median(told)), start, start + _RUN - 1)
    return found


def _sharpest_whole_run(best: Sequence[float | None]) -> tuple[float, int, int]:
    """Like `_sharpest_run`, but only with runs that show a silhouette in each frame."""
    starts = range(len(best) - _RUN + 1)
    runs = [(start, [s for s in best[start : start + _RUN] if s is not None]) for start in starts]
    whole = [(float(np.median(run)), start) for start, run in runs if len(run) == _RUN]
    score, start = max(whole, default=(0.0, 0))
    return score, start, start + _RUN - 1


def _blended(frames: Sequence[RgbdFrame], found: Sequence[Sequence[_Cut]]) -> float:
    """Share of blended rows of the most blended objects in `_sharpest_run`; 0 for time of flight.

    Time-of-flight cameras mix the light of both surfaces at silhouettes. Structured light and
    stereo measure one of them or nothing, and cannot see a part of the background.
    """
    best = [max((thing.blended for thing in things), default=None) for things in found]
    if _is_time_of_flight(frames[0].depth) or all(share is None for share in best):
        return 0.0
    return _sharpest_run(best)[0]


@dataclass(frozen=True, eq=False)
class _Cut:
    share: float
    blended: float
    spans: NDArray[np.int32]


def _cut_out(frame: RgbdFrame) -> list[_Cut]:
    """Foreground objects with the share of sharp rows on their less sharp side."""
    depth = np.ascontiguousarray(frame.depth)
    spans = _core.silhouette_spans(depth, frame.calibration.depth.fx, RELIEF)
    if not len(spans):
        return []
    _, which = np.unique(spans[:, 3], return_inverse=True)
    rows = np.bincount(which)
    left, right = (np.bincount(which, weights=spans[:, side]) / rows for side in (6, 7))
    share = np.minimum(left, right)
    mixes = (spans[:, 4:6].max(axis=1) <= _NO_GAP) & ~spans[:, 6:8].any(axis=1)
    blended = np.bincount(which, weights=mixes) / rows
    return [
        _Cut(float(share[i]), float(blended[i]), spans[which == i])
        for i in np.flatnonzero(rows >= _MIN_ROWS)
    ]


def _repeated_rims(
    frames: Sequence[RgbdFrame], found: Sequence[Sequence[_Cut]]
) -> tuple[float, float | None]:
    """Shares of rows of sharp objects whose rims, and whose middles, equal the previous frame.

    For rims it is the larger share of both sides. The middle's share is None if too few rows are
    wide enough.

    Where the camera's shadow moves over an object, a filter that fills missing pixels with their
    previous depth repeats the object's rim, but not its middle. A person who was cut out has a new
    rim in each frame. If an image is shown twice, the middle repeats, too.
    """
    rims, repeated = np.zeros(3), np.zeros(3)
    things = {id(frame): objects for frame, objects in zip(frames, found, strict=True)}
    for before, frame in following(frames):
        same = (frame.depth == before.depth) & (frame.depth > 0)
        for cut in things[id(frame)]:
            if cut.share < SHARP:
                continue
            row, first, end = cut.spans[:, 0], cut.spans[:, 1], cut.spans[:, 2]
            starts = (first, end - _RIM, (first + end - _RIM) // 2)
            counted = (cut.spans[:, 6] > 0, cut.spans[:, 7] > 0, end - first >= _WIDE)
            for place, (start, is_counted) in enumerate(zip(starts, counted, strict=True)):
                column = start[is_counted, None] + np.arange(_RIM)
                is_same = same[row[is_counted, None], column].all(axis=1)
                rims[place] += len(is_same)
                repeated[place] += np.count_nonzero(is_same)
    left, right, middle = repeated / np.maximum(rims, 1)
    return float(max(left, right)), float(middle) if rims[2] > _MIN_WIDE * rims[:2].max() else None


def _rendered(frames: Sequence[RgbdFrame]) -> str | None:
    """Reason why images are not from a camera; None: they may be."""
    speckles = float(np.mean([speckles_in(frame.depth) for frame in frames]))
    if speckles < MIN_SPECKLES:
        return "hardly a pixel within a surface is missing: rendered, or filled afterwards"
    noise = float(np.mean([_roughness(frame.depth) for frame in frames]))
    if noise < _MIN_NOISE:
        return "depth has no noise: rendered or smoothed"
    return None


def _without_shadows(
    frames: Sequence[RgbdFrame], found: Sequence[Sequence[_Cut]]
) -> tuple[Verdict, str] | None:
    """Verdict on sharp silhouettes in images without a camera's shadows, with its reason.

    None: there is a sign of a camera, or for time of flight no sign against one. Structured light
    and stereo leave wide gaps beside foreground objects, but a room without such objects has none.
    """
    elsewhere = _sharp_elsewhere(frames, found)
    cannot = "whether somebody was cut out cannot be told"
    if _is_time_of_flight(frames[0].depth):
        if elsewhere is None or elsewhere < _ALL_SHARP:
            return None
        why = f"silhouettes are sharp, but so are {elsewhere:.0%} of the other steps in depth"
        why += ": the images were rendered or filtered, or other objects were inserted, too"
        return "undecidable", f"{why}, and {cannot}"
    if (wide := _wide_gaps(frames)) >= _MIN_WIDE_GAPS:
        return None
    why = f"silhouettes are sharp, but {wide:.1%} of the gaps within rows are wide"
    if elsewhere is not None and elsewhere >= _FILLED_SHARP:
        why += f", and {elsewhere:.0%} of the other steps in depth are sharp, too"
        return "processed", f"{why}: large ones were filled, and {cannot}"
    why += ": large ones were filled, or nothing in this scene casts a wide shadow"
    return "undecidable", f"{why}, and {cannot}"


def _wide_gaps(frames: Sequence[RgbdFrame]) -> float:
    """Share of wide gaps among the gaps within rows."""
    height, width = frames[0].depth.shape
    widths = np.concatenate(
        [end - begin for _, begin, end in map(_gaps, (f.depth for f in frames))]
    )
    return float(np.mean(widths >= _WIDE_GAP * max(width, height))) if len(widths) else 0.0


def _sharp_elsewhere(frames: Sequence[RgbdFrame], found: Sequence[Sequence[_Cut]]) -> float | None:
    """Share of sharp passages between other surfaces than the accused object's; None: few are seen.

    The accused object is the largest sharp one of each frame. A passage over a single missing pixel
    is not counted, because the pixel may be missing by chance.
    """
    step = max(1, len(frames) // _MAX_FILLED)
    sharp, total, rows = 0, 0, 0
    for frame, objects in zip(frames[::step], found[::step], strict=True):
        row, last, first = passages(frame.depth)
        is_counted = (first != last + 2) | (frame.depth[row, last + 1] > 0)
        accused = [cut.spans for cut in objects if cut.share >= SHARP]
        if accused:
            spans = max(accused, key=len)
            rows += len(spans)
            is_counted &= ~_may_be_of(spans, frame, (row, last, first))
        sharp += int(np.count_nonzero(is_counted & (first == last + 1)))
        total += int(np.count_nonzero(is_counted))
    return sharp / total if total >= max(_MIN_ELSEWHERE * rows, _MIN_ROWS) else None


def _may_be_of(
    spans: NDArray[np.int32], frame: RgbdFrame, passage: tuple[NDArray[np.intp], ...]
) -> Mask:
    """Whether passages may belong to the object of these spans, or to other parts of a person.

    Hands and legs may be objects of their own, or none.
    """
    row, last, first = passage
    depth = frame.depth.astype(np.int64)
    height, width = depth.shape
    # Pixels in the middle may be missing; the first and the last one of each span are measured.
    own = float(np.median(depth[_inside(spans, (height, width)) & (depth > 0)]))
    per_mm = abs(frame.calibration.depth.fx) / own
    left, right = spans[:, 1].min(), spans[:, 2].max()
    # distances in pixels from the object's columns and rows; at most 0 within them
    across = np.maximum(left - first, last - right)
    along = np.maximum(spans[0, 0] - row, row - spans[-1, 0])
    is_around = np.maximum(across, along) <= _AROUND_MM * per_mm
    nearer = np.minimum(depth[row, last], depth[row, first])
    is_as_far = (nearer > own - _BEFORE_MM) & (nearer < own + _BEHIND_MM)
    return np.asarray((across <= _BESIDE_MM * per_mm) | (is_around & is_as_far))


def _filled(frames: Sequence[RgbdFrame]) -> str | None:
    """Describe the sign that a filter filled missing pixels, which makes silhouettes sharp.

    Filters that copy depths into holes, a few pixels deep, make the pixels beside what is left of
    the holes equal. Those that fill small holes only leave no missing pixel alone. Means and
    medians of many neighbours copy nothing: `filter_trace` recognises them. None: no sign.
    """
    some = [frame.depth for frame in frames[:: max(1, len(frames) // _MAX_FILLED)]]
    sides = np.sum(
        [[_equal_beside_holes(each) for each in (d, d[:, ::-1], d.T, d.T[:, ::-1])] for d in some],
        axis=0,
    )
    num_rims = np.maximum(sides[:, 2], 1)
    beside, within = sides[:, 0] / num_rims, sides[:, 1] / num_rims
    excess = (beside - within) / np.maximum(1.0 - within, 0.05)
    # The side that shadows have beside objects may have none: filters that take the farthest depth
    # fill it from the background, on the other side.
    if sides[:, 2].min() >= _MIN_RIMS and np.sort(excess)[1] >= _COPIED:
        share = np.sort(beside)[1]
        return f"{share:.0%} of the depths beside missing pixels, on three sides, are copies"
    one_side = (sides[:, 2] >= _MIN_RIMS) & (beside >= _COPIED_ALONG) & (within <= _NOT_ALIKE)
    if one_side.any():
        return (
            f"{beside[one_side].max():.0%} of the depths on one side of missing pixels are copies"
        )
    num_gaps = sum(len(_gaps(depth)[0]) for depth in some)
    if num_gaps >= _MIN_GAPS and sum(map(_num_alone, some)) < _ALONE * num_gaps:
        return "hardly a missing pixel stands alone: small holes were filled"
    return None


def _equal_beside_holes(depth: Depth) -> tuple[int, int, int]:
    """Count runs of nine measured pixels behind two missing ones.

    Returned are the runs that begin with two equal depths, those with two equal ones seven pixels
    later, and all. A missing pixel that stands alone may have been lost after holes were filled.
    """
    measured = depth > 0
    missing = ~measured[:, :-1] & ~measured[:, 1:]
    depth, measured = depth[:, 1:], measured[:, 1:]
    end = depth.shape[1] - _INNER - 2
    is_run = missing[:, :end]
    for k in range(1, _INNER + 3):
        is_run = is_run & measured[:, k : end + k]
    beside = depth[:, 1 : end + 1] == depth[:, 2 : end + 2]
    within = depth[:, _INNER + 1 : end + _INNER + 1] == depth[:, _INNER + 2 : end + _INNER + 2]
    return int((is_run & beside).sum()), int((is_run & within).sum()), int(is_run.sum())


def _num_alone(depth: Depth) -> int:
    """Number of missing pixels whose eight neighbours are measured, without those at the border."""
    missing = depth == 0
    height, width = missing.shape
    around = np.zeros((height - 2, width - 2), np.bool_)
    for v, u in np.ndindex(3, 3):
        if (v, u) != (1, 1):
            around |= missing[v : v + height - 2, u : u + width - 2]
    return int((missing[1:-1, 1:-1] & ~around).sum())


def _is_time_of_flight(depth: Depth) -> bool:
    """Whether an image has the size of a time-of-flight camera's images, upright or turned."""
    height, width = depth.shape
    return not _TIME_OF_FLIGHT.isdisjoint({(width, height), (height, width)})


def _gaps(depth: Depth) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Runs of missing pixels between measured pixels: row, first column, column after the last."""
    missing = np.pad(depth == 0, ((0, 0), (1, 1)))
    edges = np.diff(missing.astype(np.int8), axis=1)
    row, begin = np.nonzero(edges == 1)
    end = np.nonzero(edges == -1)[1]
    inner = (begin > 0) & (end < depth.shape[1])
    return row[inner], begin[inner], end[inner]


def speckles_in(depth: Depth) -> float:
    """Number of gaps of at most four pixels within one surface, divided by the number of pixels.

    Parameters
    ----------
    depth : (H, W) uint16
        0 is no measurement.
    """
    row, begin, end = _gaps(depth)
    short = end - begin <= 4
    row, begin, end = row[short], begin[short], end[short]
    before, after = (depth[row, column].astype(np.int64) for column in (begin - 1, end))
    return float((np.abs(before - after) < 0.02 * before).sum() / depth.size)


def _roughness(depth: Depth) -> float:
    """Mean absolute second difference along rows within surfaces, scaled to millimetres at 1 m."""
    z = depth.astype(np.float64)
    a, b, c = z[:, :-2], z[:, 1:-1], z[:, 2:]
    near = 0.02 * b
    inside = (np.minimum(np.minimum(a, b), c) > 0) & (np.abs(a - b) < near) & (np.abs(c - b) < near)
    if not inside.any():
        return 0.0
    return float((np.abs(a + c - 2.0 * b)[inside] / (b[inside] / 1000.0) ** 2).mean())
