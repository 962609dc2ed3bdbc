"""Was somebody put into this RGB-D stream? Frozen backgrounds, cut-out silhouettes, depth noise."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, pairwise
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.options import reporting
from manip3d.authenticate._verdict import Calibration, Power, Processing, Verdict
from manip3d.errors import InputError
from manip3d.rgbd import RgbdFrame, check_frames, numbered

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d._util.options import Progress
    from manip3d.camera import Intrinsics

    Mask = NDArray[np.bool_]
    Depth = NDArray[np.uint16]

SHARP = 0.6
"""Share of sharp rows on the less sharp side of a silhouette from which on it is cut out. Clean
frames on which it was fixed reach 0.42, forged ones with the person in place begin at 0.66."""

BLENDED = 0.5
"""Share of a silhouette's rows from which on it is blended into what is behind: on neither side a
gap, nor a step from one pixel to the next. 123 clean frames of four cameras of structured light
reach 0.03; images made smaller by averaging have 0.42 to 0.77, people who were blended in over a
pixel or more medians of 0.53 to 1."""

MOST_FRAMES = 60
"""Frames of a stream that are judged, spread over it in pairs."""

_REGION = 32  # pixels
_LEAST_PAIRS = 5
_LEAST_VALID = 200  # pixels of a region that is looked at
_LEAST_REGIONS = 4  # of 1024 pixels, that are looked at or never change
_NO_GAP = 1  # pixels; one may be missing by chance
_RUN = 5  # frames; one sharp silhouette is chance
_LEAST_ROWS = 40  # of a silhouette that is judged
_LEAST_NOISE = 0.5  # mm at 1 m: rendered images have less
_LEAST_SPECKLES = 2e-4  # share of pixels; cameras lose 3e-4 and more, renderings 1.4e-4 at most
_MOST_TINY = 5e-4  # share of pixels nearer than any camera measures
_MOST_OFF_CENTRE = 0.1  # of the image's side
_AZURE_NARROW = {(640, 576), (320, 288)}
"""Images of the Azure Kinect's narrow field of view: a part of the sensor, not about its middle."""
_MOST_OFF_CENTRE_AZURE = 0.15  # that of the recorded device is 0.11 off
_LEAST_VIEW_DEG = 50.0  # along the longer side; the narrowest camera of the data sees 57
_RIM = 3  # pixels of one surface on each side of a sharp step
_KEPT = 0.5  # share of sharp rims; a filter that keeps what is missing has 0.65 to 0.69
_KEPT_MORE = 1.7  # times the middle's share; such a filter has 2.1 and more, what was cut out 1.45
_ALIKE = 0.05  # rims and middles whose shares differ by less are of pictures that are shown again
_WIDE = 18  # pixels of a row whose middle is beyond its rims
_LEAST_WIDE = 0.2  # of the rows: fewer are a narrow thing before something else
_RELIEF = 0.25  # share of the depth: then a camera's shadow is several pixels wide
_SIZES = {
    (160, 120), (320, 240), (640, 480), (512, 424), (1280, 720), (848, 480), (640, 360),
    (480, 270), (424, 240), (1280, 800), (640, 400), (640, 576), (320, 288), (512, 512),
    (1024, 1024), (1280, 1024), (1280, 960), (1920, 1080), (2048, 1536), (3840, 2160),
}  # fmt: skip
_TIME_OF_FLIGHT = {(512, 424), (640, 576), (320, 288), (512, 512), (1024, 1024)}
"""Images of the Kinect V2 and the Azure Kinect, which mix depths at silhouettes: filling what is
missing beside them makes none sharp."""
_WIDE_GAP = 0.02  # of the image's width: 12 of 640 pixels
_LEAST_WIDE_GAPS = 0.02  # of the gaps; cameras have 0.11 and more, filled images next to none

CALIBRATION = Calibration(
    "the turning person, the red kitchen of 7-Scenes and simulated people before a Kinect V2",
    125,
    0,
    "structured light and time of flight; a few cameras of each; other people's compositors may "
    "draw softer silhouettes",
)
"""Origin of `SHARP`: clean frames, not those of `POWER`."""

_STREAMS = "8 simulated people of other seeds, 8 of UTD-MHAD before the turning person's wall"
_KITCHEN = "8 people of UTD-MHAD in the red kitchen of 7-Scenes"
POWER: Mapping[str, Power] = ReadOnlyMapping(
    {
        "still background": Power(32, 32, source=_STREAMS),
        "running background": Power(32, 32, source=_STREAMS),
        "still background, full of near things": Power(6, 16, source=_KITCHEN),
        "running background, moving camera": Power(10, 16, source=_KITCHEN),
    }
)
"""Forged streams of `manip3d.forge.stream`, both types, that are found; from ``figure-5.8``. It
cuts people out from one pixel to the next; those whose silhouettes are blended are not found. The
other 10 before a still frame of the kitchen, all of which repeats, are ``processed``."""


@checked
def depth_noise(
    depth: NDArray[np.uint16], *, region: int = 32, sigma: float = 1.1
) -> NDArray[np.float64]:
    """Compute the mean of abs(I - G I) in each square region of a depth image (section 5.2.1).

    Parameters
    ----------
    depth : (H, W) uint16, millimetres
        Pixels without a measurement count as depth 0: those that come and go are most of it.
    region : int, pixels
        Side of the regions; the last ones may be smaller.
    sigma : float, pixels
        Standard deviation of the 5 x 5 Gaussian G; 1.1 is OpenCV's for that size.

    Returns
    -------
    (rows, cols) float64, millimetres
        IFN of the frame is their mean.

    Raises
    ------
    InputError
        Another shape or dtype, or an option out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import depth_noise
    >>> depth = np.full((64, 64), 2000, np.uint16)
    >>> depth[:32, :32] += np.random.default_rng(0).integers(0, 9, (32, 32), np.uint16)
    >>> depth_noise(depth).round(1).tolist()
    [[2.0, 0.0], [0.0, 0.0]]
    """
    image = np.ascontiguousarray(depth)
    if image.ndim != 2 or image.dtype != np.uint16:
        raise InputError(f"depth: expected uint16 (H, W), got {image.dtype} {image.shape}")
    options = _core.DepthNoiseOptions()
    options.region, options.sigma = region, sigma
    means = _core.depth_noise(image, options)
    return np.asarray(means.reshape(-(-image.shape[0] // region), -1))


@checked
def inter_frame_noise(frames: Iterable[RgbdFrame]) -> NDArray[np.float64]:
    """Return 2 abs(IFN_t - IFN_t+1) / (IFN_t + IFN_t+1) of each pair of neighbouring frames.

    Parameters
    ----------
    frames : iterable of RgbdFrame

    Returns
    -------
    (T - 1,) float64
        0 where both frames have no noise at all.

    Raises
    ------
    InputError
        ``frames`` holds something else, or depth images that are not uint16.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, RgbdCalibration, RgbdFrame
    >>> from manip3d.authenticate import inter_frame_noise
    >>> camera = RgbdCalibration(Intrinsics(fx=60, fy=60, cx=31.5, cy=31.5, width=64, height=64))
    >>> still = np.full((64, 64), 2000, np.uint16)
    >>> rough = still + np.random.default_rng(0).integers(0, 9, (64, 64), np.uint16)
    >>> frames = [RgbdFrame(depth, camera) for depth in (rough, rough, still)]
    >>> inter_frame_noise(frames).round(3).tolist()
    [0.0, 2.0]
    """
    some = list(frames)
    check_frames("frames", some)
    noise = np.array([depth_noise(frame.depth).mean() for frame in some])
    return _relative_change(noise)


def _relative_change(noise: NDArray[np.float64]) -> NDArray[np.float64]:
    total = noise[:-1] + noise[1:]
    return np.asarray(2.0 * np.abs(np.diff(noise)) / np.where(total > 0, total, 1.0))


@dataclass(frozen=True)
class StreamRegion:
    """A place in the image with evidence of an edit.

    Attributes
    ----------
    frame : int
        Number of the frame.
    box : (int, int, int, int)
        First column, first row, width and height.
    share : float
        Share of sharp rows on the less sharp side of the silhouette; 1 before a frozen background.
    """

    frame: int
    box: tuple[int, int, int, int]
    share: float


@dataclass(frozen=True)
class StreamReport:
    """Report of one detector on a stream.

    Attributes
    ----------
    name : 'repetition', 'silhouettes' or 'noise'
    verdict : 'no_trace', 'tampered', 'processed' or 'undecidable'
    reason : str
    score : float or None
        The detector's own measure, larger is more suspicious; of ``noise`` smaller.
    """

    name: str
    verdict: Verdict
    reason: str
    score: float | None = None


@dataclass(frozen=True, eq=False)
class StreamInspection:
    """Result of `inspect_stream`.

    Attributes
    ----------
    verdict : 'no_trace', 'tampered', 'processed' or 'undecidable'
    reason : str
    score : float or None
        Suspicion of cut-out silhouettes, larger is worse; None: there is none to judge.
    p_value : None
        No probability is stated.
    regions : tuple of StreamRegion
        Where something was inserted, frame by frame.
    masks : (T, H, W) bool
        Pixels of what was inserted, of the frames in ``numbers``; empty without evidence.
    numbers : (T,) int64
        Numbers of the frames that were judged; their places in the stream where all numbers are the
        same.
    processing : tuple of Processing
        What was done to all images.
    detectors : tuple of StreamReport
    noise : (N - 1,) float64
        Inter-frame noise of the judged pairs, as published.
    power : mapping of str to Power
        Share of forged streams found, by kind, as measured on streams that fixed no threshold.
    calibration : Calibration
    """

    verdict: Verdict
    reason: str
    score: float | None
    regions: tuple[StreamRegion, ...] = ()
    masks: Mask = field(default_factory=lambda: np.zeros((0, 0, 0), np.bool_), repr=False)
    numbers: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64), repr=False)
    processing: tuple[Processing, ...] = ()
    detectors: tuple[StreamReport, ...] = ()
    noise: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0), repr=False)
    power: Mapping[str, Power] = field(default_factory=lambda: POWER, repr=False)
    calibration: Calibration = CALIBRATION
    p_value: None = None

    def record(self) -> dict[str, Any]:
        """Return the result as JSON values, without the masks."""
        return {
            "verdict": self.verdict,
            "reason": self.reason,
            "score": self.score,
            "p_value": self.p_value,
            "frames": len(self.numbers),
            "median_inter_frame_noise": float(np.median(self.noise)) if len(self.noise) else None,
            "processing": [vars(step) for step in self.processing],
            "regions": [vars(region) for region in self.regions],
            "detectors": [vars(report) for report in self.detectors],
            "power": {k: {**vars(p), "share": p.share} for k, p in self.power.items()},
            "calibration": vars(self.calibration),
        }


@checked
def inspect_stream(frames: Iterable[RgbdFrame], *, progress: Progress = None) -> StreamInspection:
    """Judge whether somebody was put into an RGB-D stream, by its depth images.

    Parameters
    ----------
    frames : iterable of RgbdFrame
        Consecutive frames of one camera. Of a sequence up to 60 are judged, in runs of 6 spread
        over it; of an iterator the first 60, which the reason says where there were more.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    StreamInspection

    Raises
    ------
    InputError
        There is no frame; frames differ in size.

    Notes
    -----
    ``repetition``: a camera's depth is never the same twice; regions of 32 pixels without any
    change over all pairs beside regions that change are a still background.
    ``silhouettes``: where a person stands before a background, structured light casts a shadow
    without measurements on one side, and time of flight mixes the light of both surfaces. A
    silhouette that is sharp on both sides, from one pixel to the next, was cut out; the sharpest
    five judged frames in a row decide, since a part of a stream may be forged. ``noise``: the
    published inter-frame noise, as a number without a verdict. Rendered images (no noise, no
    speckles without a measurement), images without silhouettes and streams of few frames are
    ``undecidable``; images of unusual size, rounded, doubled or lossily coded ones, and those of
    which a part repeats exactly behind a camera's own silhouettes, are ``processed``: codecs and
    filters over time do that, too. So are those whose silhouettes are sharp because what a camera
    misses beside them keeps the depth of the frame before, as RealSense's filter over time does
    before a moving camera, and because no wide gap is left in the image: large holes were filled.
    Of time-of-flight cameras, recognised by the size of their images, the latter is not evidence.
    Where silhouettes have neither a step nor a gap on both sides, as blended ones and those of time
    of flight have, streams of other cameras are ``undecidable``; a person who was blended into a
    stream of time of flight leaves no trace. No verdict says that a stream is authentic.

    An image that was cut to the size of some camera is recognised by the field of view that its
    calibration leaves, if that is below 50 degrees. One that was made smaller by leaving pixels
    out, with a calibration that was scaled alike, cannot be distinguished from that of a smaller
    camera.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, RgbdCalibration, RgbdFrame, authenticate
    >>> camera = RgbdCalibration(Intrinsics(fx=60, fy=60, cx=31.5, cy=31.5, width=64, height=64))
    >>> still = RgbdFrame(np.full((64, 64), 2000, np.uint16), camera)
    >>> found = authenticate.inspect_stream([still] * 3)
    >>> found.verdict, found.reason
    ('processed', 'cropped: no camera is known to give 64 x 64 pixels')
    """
    some, has_more = _judged(frames)
    if not some:
        raise InputError("frames: expected one at least, got none")
    if any(frame.depth.shape != some[0].depth.shape for frame in some):
        raise InputError("frames: expected images of one size")
    with reporting(progress, "inspect") as report:
        told = report or (lambda _: None)
        noise = _relative_change(np.array([depth_noise(f.depth).mean() for f in some]))
        told(0.4)
        processing = _processing(some)
        frozen, frozen_masks = _repetition(some)
        told(0.6)
        edges = _silhouettes(some)
        told(1.0)
    found = _concluded(some, noise, processing, (frozen, frozen_masks), edges)
    if not has_more:
        return found
    return replace(found, reason=f"{found.reason}; of the first {MOST_FRAMES} frames, not the rest")


def _concluded(
    some: Sequence[RgbdFrame],
    noise: NDArray[np.float64],
    processing: tuple[Processing, ...],
    repetition: tuple[StreamReport, Mask],
    silhouettes: tuple[StreamReport, tuple[StreamRegion, ...], Mask],
) -> StreamInspection:
    """The verdict on frames by what each detector says."""
    frozen, frozen_masks = repetition
    edges, edge_regions, edge_masks = silhouettes
    median = float(np.median(noise)) if len(noise) else None
    published = StreamReport(
        "noise", "undecidable", "the published measure is reported without a threshold", median
    )
    reports = (frozen, edges, published)
    numbers = np.array([frame.number for frame in some], np.int64)
    base: dict[str, Any] = {"numbers": numbers, "detectors": reports, "noise": noise}
    if processing:
        why = "; ".join(f"{step.kind}: {step.detail}" for step in processing)
        if edges.verdict == "tampered":
            why += f"; {edges.reason}, or made sharp by this processing"
        return StreamInspection("processed", why, edges.score, processing=processing, **base)
    if frozen.verdict == "undecidable":
        return StreamInspection("undecidable", frozen.reason, edges.score, **base)
    if edges.verdict == "processed":
        step = Processing("filtered", edges.reason)
        return StreamInspection("processed", edges.reason, edges.score, processing=(step,), **base)
    if len(frozen_masks) and edges.score is not None and edges.score >= SHARP:
        if edges.verdict == "tampered":  # somebody who keeps still repeats depths, too
            frozen_masks = frozen_masks | edge_masks
        regions = tuple(
            StreamRegion(frame.number, _box(mask), 1.0)
            for frame, mask in zip(some, frozen_masks, strict=True)
            if mask.any()
        )
        why = f"{frozen.reason}, and silhouettes before it are cut out"
        return StreamInspection("tampered", why, edges.score, regions, frozen_masks, **base)
    if edges.verdict == "tampered":
        return StreamInspection(
            "tampered", edges.reason, edges.score, edge_regions, edge_masks, **base
        )
    if frozen.verdict == "processed":
        return StreamInspection("processed", frozen.reason, edges.score, **base)
    return StreamInspection(edges.verdict, edges.reason, edges.score, **base)


@checked
def judged_frames(frames: Iterable[RgbdFrame]) -> list[RgbdFrame]:
    """Return the frames of a stream that `inspect_stream` judges.

    All of up to `MOST_FRAMES`; of more, runs of six spread over a sequence or a recording that
    knows its length, of which no others are kept in memory; the first ones of other iterables. A
    recording whose file does not tell its length is gone through once before.

    Parameters
    ----------
    frames : iterable of RgbdFrame
        Also a recording or a camera that `manip3d.capture.open_rgbd` opened.

    Returns
    -------
    list of RgbdFrame

    Raises
    ------
    InputError
        Something is not a frame.

    Examples
    --------
    >>> from manip3d import authenticate, simulate
    >>> body = simulate.BodySimulator(seed=0, color="none")
    >>> len(authenticate.judged_frames(body.frame(n / 30) for n in range(3)))
    3
    """
    return _judged(frames)[0]


def _length_of(frames: Iterable[RgbdFrame]) -> int | None:
    """Return the number of frames; None if they can be gone through only once, or never end."""
    if isinstance(frames, Sequence):
        return len(frames)
    length: int | None = getattr(frames, "num_frames", None)
    if length is None and isinstance(frames, _Recording) and frames.has_known_end:
        length = sum(1 for _ in frames)
        frames.start()
    return length


@runtime_checkable
class _Recording(Protocol):
    has_known_end: bool

    def start(self) -> None: ...
    def __iter__(self) -> Iterator[RgbdFrame]: ...


def _judged(frames: Iterable[RgbdFrame]) -> tuple[list[RgbdFrame], bool]:
    """Return the frames that are judged, and whether they are the first ones of more.

    Frames that nobody numbered get the numbers of their places in the stream.
    """
    length = _length_of(frames)
    has_more = False
    places: Sequence[int] = range(MOST_FRAMES)
    if length is None:
        iterator = iter(frames)
        some = list(islice(iterator, MOST_FRAMES))
        has_more = len(some) == MOST_FRAMES and next(iterator, None) is not None
    elif length <= MOST_FRAMES:
        some = list(frames)
    else:
        run = 6
        starts = np.linspace(0, length - run, MOST_FRAMES // run).astype(int)
        places = sorted({int(start) + i for start in starts for i in range(run)})
        wanted = frozenset(places)
        some = [frame for number, frame in enumerate(frames) if number in wanted]
    check_frames("frames", some)
    return numbered(some, places), has_more


def _box(mask: Mask) -> tuple[int, int, int, int]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    u, v = int(columns[0]), int(rows[0])
    return u, v, int(columns[-1]) - u + 1, int(rows[-1]) - v + 1


# --- Processing -------------------------------------------------------------------------------


def _processing(frames: Sequence[RgbdFrame]) -> tuple[Processing, ...]:
    """Processing that all images went through."""
    found = []
    height, width = frames[0].depth.shape
    if (width, height) not in _SIZES and (height, width) not in _SIZES:
        detail = f"no camera is known to give {width} x {height} pixels"
        found.append(Processing("cropped", detail))
    camera = frames[0].calibration.depth
    off = max(abs(camera.cx / width - 0.5), abs(camera.cy / height - 0.5))
    is_azure = not _AZURE_NARROW.isdisjoint({(width, height), (height, width)})
    if not found and off > (_MOST_OFF_CENTRE_AZURE if is_azure else _MOST_OFF_CENTRE):
        detail = f"the optical axis meets the image {off:.0%} of its side beside the middle"
        found.append(Processing("cropped", detail))
    view = _field_of_view(camera)
    if not found and view < _LEAST_VIEW_DEG:
        detail = f"it shows {view:.0f} degrees of the scene, less than any known depth camera"
        found.append(Processing("cropped", detail))
    some = frames[:: max(1, len(frames) // 6)]
    values = np.unique(np.concatenate([np.unique(frame.depth) for frame in some]))
    values = values[values > 0]
    step = int(np.gcd.reduce(values)) if len(values) > 2 else 1
    if step > 1:
        found.append(Processing("rounded", f"all depths are multiples of {step} mm"))
    tiny = np.mean([np.mean((f.depth > 0) & (f.depth < _LEAST_DEPTH)) for f in some])
    if tiny > _MOST_TINY:
        detail = f"{tiny:.2%} of the pixels are nearer than {_LEAST_DEPTH} mm: holes were smeared"
        found.append(Processing("lossily coded", detail))
    if _is_held(frames):
        detail = f"no pixel changes by less than {_SMALL} mm from frame to frame, and many by more"
        found.append(Processing("filtered", detail))
    lost, gained, num_pairs = _lost_and_gained(frames)
    if num_pairs >= _LEAST_PAIRS and gained > _LEAST_GAINED and lost < _LEAST_LOST * gained:
        detail = f"{gained:.2%} of the pixels appear from frame to frame, {lost:.2%} disappear"
        found.append(Processing("filtered", f"{detail}: missing ones kept their depth"))
    doubled = max(float(np.mean([_doubled(image) for image in pair])) for pair in zip(
        *((f.depth, f.depth.T) for f in some), strict=True
    ))  # fmt: skip
    if doubled > _MOST_DOUBLED:
        found.append(Processing("resampled", f"{doubled:.0%} of neighbouring lines are the same"))
    return tuple(found)


def _following(frames: Sequence[RgbdFrame]) -> list[tuple[RgbdFrame, RgbdFrame]]:
    """Pairs of frames that follow each other by their numbers; where few do, all neighbours."""
    pairs = list(pairwise(frames))
    numbered = [(a, b) for a, b in pairs if b.number == a.number + 1]
    return numbered if len(numbered) >= _LEAST_PAIRS else pairs


def _field_of_view(camera: Intrinsics) -> float:
    """Degrees that a camera sees along the longer side of its image."""
    sides = ((camera.width, camera.fx), (camera.height, camera.fy))
    side, focal = max(sides, key=lambda each: each[0])
    return math.degrees(2.0 * math.atan(0.5 * side / abs(focal)))  # fy of renderings may be < 0


def _is_held(frames: Sequence[RgbdFrame]) -> bool:
    """Whether pixels keep their value until they change by much, as filters against flicker do.

    Where neighbours on a surface differ by little, so do a camera's pixels from frame to frame.
    """
    pairs = [(a.depth, b.depth) for a, b in _following(frames)]
    over_time = np.array([_changes(a, b) for a, b in pairs[:: max(1, len(pairs) // 6)]])
    in_space = np.array([_changes(f.depth[:, 1:], f.depth[:, :-1]) for f in frames[::10]])
    if not len(over_time):
        return False
    (small, all_), (small_beside, all_beside) = over_time.sum(axis=0), in_space.sum(axis=0)
    is_much = all_ >= _LEAST_CHANGED * over_time.shape[0] * frames[0].depth.size
    return bool(is_much and small < 0.02 * all_ and small_beside > 0.2 * all_beside)


def _changes(one: Depth, other: Depth) -> tuple[int, int]:
    """How many pixels differ by less than `_SMALL`, and by less than ten times as much."""
    change = np.abs(one.astype(np.int32) - other)[(one > 0) & (other > 0)]
    change = change[(change > 0) & (change < 10 * _SMALL)]
    return int((change < _SMALL).sum()), len(change)


def _lost_and_gained(frames: Sequence[RgbdFrame]) -> tuple[float, float, int]:
    """Shares of pixels that disappear and appear from a frame to the next, over so many pairs.

    A camera loses as many as it gains, but for those at the edge of what it sees.
    """
    shares = np.array([_changed_shares(a, b) for a, b in _whole_pairs(frames)]).reshape(-1, 2)
    lost, gained = shares.mean(axis=0) if len(shares) else (0.0, 0.0)
    return float(lost), float(gained), len(shares)


def _changed_shares(before: RgbdFrame, after: RgbdFrame) -> tuple[float, float]:
    """Shares of the pixels whose measurement disappears, and appears."""
    a, b = before.depth > 0, after.depth > 0
    return float(np.mean(a & ~b)), float(np.mean(~a & b))


def _whole_pairs(frames: Sequence[RgbdFrame]) -> list[tuple[RgbdFrame, RgbdFrame]]:
    """Pairs of `_following` without frames that are empty in whole or in large part.

    Those are of a camera that begins or fails.
    """
    return [(a, b) for a, b in _following(frames) if max(_changed_shares(a, b)) < _MOST_EMPTIED]


_MOST_EMPTIED = 0.1  # of the pixels; a camera moved by hand has 0.04, such a filter 0.06 at most
_LEAST_LOST = 0.2  # of what is gained; clean recordings of five pairs and more have 0.65 at least
_LEAST_GAINED = 2e-4  # of the pixels
_SMALL = 15  # mm
_LEAST_CHANGED = 0.001  # of the pixels, from frame to frame
_LEAST_DEPTH = 150  # mm; no depth camera measures nearer
_MOST_DOUBLED = 0.2


def _doubled(image: Depth) -> float:
    """Share of neighbouring rows with relief that are the same wherever both are measured."""
    above, below = image[:-1], image[1:]
    both = (above > 0) & (below > 0)
    num_both = both.sum(axis=1)
    differ = (both & (above != below)).sum(axis=1)
    relief = (both[:, 1:] & both[:, :-1] & (np.diff(above.astype(np.int32), axis=1) != 0)).sum(1)
    told = (num_both > 50) & (relief > 20)
    same = told & (differ <= 0.01 * num_both)
    return float(same.sum() / max(1, told.sum()))


# --- Repetition -------------------------------------------------------------------------------


def _repetition(frames: Sequence[RgbdFrame]) -> tuple[StreamReport, Mask]:
    """Whether a part of the image never changes while another does, and what does."""
    shape = frames[0].depth.shape
    nothing = np.zeros((0, *shape), np.bool_)
    pairs = _whole_pairs(frames)
    if len(pairs) < _LEAST_PAIRS:
        return StreamReport(
            "repetition", "undecidable", "too few frames follow each other"
        ), nothing
    changes = np.zeros(tuple(-(-side // _REGION) for side in shape), np.int64)
    valid = np.full(changes.shape, np.iinfo(np.int64).max)
    for a, b in pairs:
        changes += _by_region(a.depth != b.depth)
        valid = np.minimum(valid, _by_region((a.depth > 0) & (b.depth > 0)))
    looked_at = valid >= _LEAST_VALID
    if looked_at.sum() < _LEAST_REGIONS:
        return StreamReport(
            "repetition", "undecidable", "too few pixels are measured in all frames"
        ), nothing
    frozen = looked_at & (changes == 0)
    moving = (changes > 0).sum()
    share = float(frozen.sum() / max(1, looked_at.sum()))
    if frozen.sum() >= _LEAST_REGIONS and share >= 0.05 and moving == 0:
        return StreamReport("repetition", "processed", "all frames are the same", share), nothing
    if frozen.sum() < _LEAST_REGIONS or share < 0.05:
        return StreamReport("repetition", "no_trace", "depth changes everywhere", share), nothing
    # By itself no evidence of an edit: codecs and filters over time repeat what hardly changes.
    reason = f"{share:.0%} of the image never changes in {len(pairs)} pairs of frames"
    return StreamReport("repetition", "processed", reason, share), _unfrozen(frames)


def _by_region(mask: Mask) -> NDArray[np.int64]:
    """Pixels of a mask in each region."""
    height, width = (-(-side // _REGION) * _REGION for side in mask.shape)
    padded = np.zeros((height, width), np.bool_)
    padded[: mask.shape[0], : mask.shape[1]] = mask
    blocks = padded.reshape(height // _REGION, _REGION, width // _REGION, _REGION)
    return np.asarray(blocks.sum(axis=(1, 3)), np.int64)


def _unfrozen(frames: Sequence[RgbdFrame]) -> Mask:
    """Measured pixels that do not show the value that their place shows in most frames."""
    depths = np.stack([frame.depth for frame in frames])
    middle = np.sort(depths, axis=0)[len(depths) // 2]  # a value of most frames is the median
    usual = (depths == middle).mean(axis=0) >= 0.6
    return np.asarray((depths > 0) & ~(usual & (depths == middle)))


# --- Silhouettes ------------------------------------------------------------------------------


def _silhouettes(
    frames: Sequence[RgbdFrame],
) -> tuple[StreamReport, tuple[StreamRegion, ...], Mask]:
    """Judge whether foreground objects were cut out of other recordings, and where they are.

    Also returned are the regions and the masks, one for each frame, of what was cut out.
    """
    found = [_cut_out(frame) for frame in frames]
    best = [max((object_.share for object_ in objects), default=None) for objects in found]
    told = [share for share in best if share is not None]
    nothing = np.zeros((0, *frames[0].depth.shape), np.bool_)
    # Few frames show silhouettes where somebody is there for a while only.
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
    if (wide := _wide_gaps(frames)) is not None and wide < _LEAST_WIDE_GAPS:
        why = f"silhouettes are sharp, but {wide:.1%} of the gaps within rows are wide: large ones"
        why += " were filled, and whether somebody was cut out cannot be told"
        return StreamReport("silhouettes", "processed", why, score), (), nothing
    regions, masks = _cut_regions(frames, found)
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
            edges = np.zeros((height, width + 1), np.int32)  # 1 where a span begins, -1 at its end
            np.add.at(edges, (cut.spans[:, 0], cut.spans[:, 1]), 1)
            np.add.at(edges, (cut.spans[:, 0], cut.spans[:, 2]), -1)
            inside = np.cumsum(edges, axis=1)[:, :-1] > 0
            mask |= inside & (frame.depth > 0)
            regions.append(StreamRegion(frame.number, _box(inside), cut.share))
    return tuple(regions), masks


def _sharpest_run(best: Sequence[float | None]) -> tuple[float, int, int]:
    """Largest median of five frames that follow each other, and the first and the last of them.

    A forgery may last for a part of a stream only. Of a stream without five such frames it is the
    median of all.
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
    """Return what `_sharpest_run` does, of runs that show a silhouette in each frame."""
    starts = range(len(best) - _RUN + 1)
    runs = [(start, [s for s in best[start : start + _RUN] if s is not None]) for start in starts]
    whole = [(float(np.median(run)), start) for start, run in runs if len(run) == _RUN]
    score, start = max(whole, default=(0.0, 0))
    return score, start, start + _RUN - 1


def _blended(frames: Sequence[RgbdFrame], found: Sequence[Sequence[_Cut]]) -> float:
    """Share of blended rows of the most blended things, as `_sharpest_run`; 0: such mix by nature.

    Time of flight mixes the light of both surfaces at silhouettes. Structured light and stereo
    measure one of them or nothing, and see a part of what is behind not at all.
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
    """Things that stand before what is beside them, with how sharp their less sharp side is."""
    options = _core.SilhouetteOptions()
    options.min_relief = _RELIEF
    depth = np.ascontiguousarray(frame.depth)
    spans = _core.silhouette_spans(depth, frame.calibration.depth.fx, options)
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
        for i in np.flatnonzero(rows >= _LEAST_ROWS)
    ]


def _repeated_rims(
    frames: Sequence[RgbdFrame], found: Sequence[Sequence[_Cut]]
) -> tuple[float, float | None]:
    """Shares of rows of sharp things whose rims (the side with more), and whose middles, repeat.

    The middle is None where no row is wide enough to have one.

    Where the camera's shadow moves over a thing, a filter that keeps what is missing now leaves the
    thing's rim as it was in the frame before, but not its middle. Somebody who was cut out has a
    rim of their own in each frame; of a picture that is shown twice the middle repeats, too.
    """
    rims, repeated = np.zeros(3), np.zeros(3)
    things = {id(frame): objects for frame, objects in zip(frames, found, strict=True)}
    for before, frame in _following(frames):
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
    return float(max(left, right)), float(middle) if rims[2] > _LEAST_WIDE * rims[
        :2
    ].max() else None


def _rendered(frames: Sequence[RgbdFrame]) -> str | None:
    """Why images cannot be a camera's own; None: they can."""
    speckles = float(np.mean([_speckles(frame.depth) for frame in frames]))
    if speckles < _LEAST_SPECKLES:
        return "hardly a pixel within a surface is missing: rendered, or filled afterwards"
    noise = float(np.mean([_roughness(frame.depth) for frame in frames]))
    if noise < _LEAST_NOISE:
        return "depth has no noise: rendered or smoothed"
    return None


def _wide_gaps(frames: Sequence[RgbdFrame]) -> float | None:
    """Share of the gaps between measured pixels of a row that are wide; None: no shadows expected.

    Beside what stands before a background structured light and stereo leave wide ones.
    """
    height, width = frames[0].depth.shape
    if _is_time_of_flight(frames[0].depth):
        return None
    widths = np.concatenate(
        [end - begin for _, begin, end in map(_gaps, (f.depth for f in frames))]
    )
    return float(np.mean(widths >= _WIDE_GAP * max(width, height))) if len(widths) else 0.0


def _is_time_of_flight(depth: Depth) -> bool:
    """Whether an image has the size of those of a time-of-flight camera, upright or turned."""
    height, width = depth.shape
    return not _TIME_OF_FLIGHT.isdisjoint({(width, height), (height, width)})


def _gaps(depth: Depth) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Rows of missing pixels between measured ones, first columns and those behind the last."""
    missing = np.pad(depth == 0, ((0, 0), (1, 1)))
    edges = np.diff(missing.astype(np.int8), axis=1)
    row, begin = np.nonzero(edges == 1)
    end = np.nonzero(edges == -1)[1]
    inner = (begin > 0) & (end < depth.shape[1])
    return row[inner], begin[inner], end[inner]


def _speckles(depth: Depth) -> float:
    """Share of pixels at which up to four in a row have no measurement within one surface."""
    row, begin, end = _gaps(depth)
    short = end - begin <= 4
    row, begin, end = row[short], begin[short], end[short]
    before, after = (depth[row, column].astype(np.int64) for column in (begin - 1, end))
    return float((np.abs(before - after) < 0.02 * before).sum() / depth.size)


def _roughness(depth: Depth) -> float:
    """Mean second difference along rows within surfaces, millimetres at 1 m."""
    z = depth.astype(np.float64)
    a, b, c = z[:, :-2], z[:, 1:-1], z[:, 2:]
    near = 0.02 * b
    inside = (np.minimum(np.minimum(a, b), c) > 0) & (np.abs(a - b) < near) & (np.abs(c - b) < near)
    if not inside.any():
        return 0.0
    return float((np.abs(a + c - 2.0 * b)[inside] / (b[inside] / 1000.0) ** 2).mean())
