"""Inspect RGB-D streams for inserted people: still backgrounds, cut-out silhouettes, noise."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._util.arrays import as_array
from manip3d._util.checked import checked
from manip3d._util.options import reporting
from manip3d.authenticate._repetition import judge_repetition
from manip3d.authenticate._silhouettes import SHARP, judge_silhouettes
from manip3d.authenticate._stream_frames import MAX_FRAMES, frames_to_judge
from manip3d.authenticate._stream_marks import without_marks
from manip3d.authenticate._stream_processing import processing_of
from manip3d.authenticate._stream_verdict import (
    StreamInspection,
    StreamRegion,
    StreamReport,
    box_of,
)
from manip3d.authenticate._verdict import NO_POWER, Processing
from manip3d.errors import InputError
from manip3d.rgbd import RgbdFrame, check_frames

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d._util.options import Progress

    Mask = NDArray[np.bool_]

_MAX_REGION = 16384  # pixels, as in the kernel


@checked
def depth_noise(
    depth: NDArray[np.uint16], *, region: int = 32, sigma: float = 1.1
) -> NDArray[np.float64]:
    """Compute the mean of abs(I - G I) in each square region of a depth image (section 5.2.1).

    Parameters
    ----------
    depth : (H, W) uint16, millimetres
        Depth image; pixels without a measurement count as depth 0, and contribute most of the
        noise.
    region : int, pixels
        Side of the regions; the last region of a row or column may be smaller.
    sigma : float, pixels
        Standard deviation of the 5 x 5 Gaussian G; 1.1 is OpenCV's value for that size.

    Returns
    -------
    (rows, cols) float64, millimetres
        Mean of each region; the IFN of a frame is their mean.

    Raises
    ------
    InputError
        ``depth`` has another shape or dtype, or an option is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import depth_noise
    >>> depth = np.full((64, 64), 2000, np.uint16)
    >>> depth[:32, :32] += np.random.default_rng(0).integers(0, 9, (32, 32), np.uint16)
    >>> depth_noise(depth).round(1).tolist()
    [[2.0, 0.0], [0.0, 0.0]]
    """
    image = np.ascontiguousarray(as_array(depth, "depth"))
    if image.ndim != 2 or image.dtype != np.uint16:
        raise InputError(f"depth: expected uint16 (H, W), got {image.dtype} {image.shape}")
    if not 2 <= region <= _MAX_REGION:
        raise InputError(f"region: expected 2 to {_MAX_REGION}, got {region}")
    options = _core.DepthNoiseOptions()
    options.region, options.sigma = region, sigma
    means = _core.depth_noise(image, options)
    return np.asarray(means.reshape(-(-image.shape[0] // region), -1))


@checked
def inter_frame_noise(frames: Iterable[RgbdFrame]) -> NDArray[np.float64]:
    """Return 2 abs(IFN_t - IFN_t+1) / (IFN_t + IFN_t+1) for each pair of neighbouring frames.

    Parameters
    ----------
    frames : iterable of RgbdFrame
        Frames of a stream.

    Returns
    -------
    (T - 1,) float64
        Relative change of the noise IFN (`depth_noise`); 0 if both frames have no noise.

    Raises
    ------
    InputError
        ``frames`` holds an item of another type, or depth images that are not uint16.

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


@checked
def inspect_stream(frames: Iterable[RgbdFrame], *, progress: Progress = None) -> StreamInspection:
    """Judge from the depth images whether a person was inserted into an RGB-D stream.

    Parameters
    ----------
    frames : iterable of RgbdFrame
        Consecutive frames of one camera. Up to 60 frames are judged: of a sequence, runs of 6
        spread over it; of an iterator the first 60, and the reason states if there are more.
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
    Pixels of 65535, which many cameras store for "no measurement", count as not measured. So do
    pixels of another constant, such as 10000, if at least 2 % of all pixels have it, and hardly any
    depth is larger, or smaller by less than 5 %; the reason then states it.

    There are three detectors. ``repetition``: a camera never measures exactly the same depths
    twice. Regions of 32 pixels that never change over all pairs of frames, while other regions
    change, are a still background; regions with a single depth do not count. Sixteen or more
    regions of 8 pixels that never change are a smaller still part, such as a frozen person, and
    make a stream ``processed``; those whose neighbouring pixels mostly have equal depths do not
    count, as on far surfaces of coarse depths, nor do near surfaces whose noise, which grows with
    the square of the depth, is below half a step of the depth image, nor any regions if the share
    of pixels of the others that never change lets 0.01 be expected by chance. ``silhouettes``:
    beside a person before a background, structured light leaves a shadow without measurements on
    one side, and time of flight mixes the light of both surfaces. A person whose silhouette is
    sharp on both sides, from one pixel to the next, was cut out. The five successive judged frames
    with the sharpest silhouettes decide, since only a part of a stream may be forged. Images higher
    than wide are of a camera that was mounted upright, and are judged along their columns.
    ``noise``: the published inter-frame noise, without a verdict.

    Whole frames that are the same for long, or come again after others, make a stream
    ``processed``: it was frozen or looped. Frames that are all shown equally often, as after a
    change of the rate, are only stated in the reason of ``repetition``.

    Rendered images (without noise or speckles), images without silhouettes and streams of few
    frames are ``undecidable``. Images of unusual size, rounded, resampled or lossily coded images,
    and images of which a part repeats exactly behind a camera's own silhouettes, are ``processed``,
    because codecs and temporal filters cause that as well. Images are also ``processed`` if
    silhouettes are sharp because missing pixels beside them keep the depth of the previous frame,
    as RealSense's temporal filter does with a moving camera, if no wide gap is left in the image
    although there are other steps in depth, and these are sharp, too, because large holes were
    filled, or if holes were filled a few pixels deep: depths beside what is left of them are
    copies, or no missing pixel stands alone. A filter of the whole image also shows away from the
    sharp silhouettes: after medians of measured pixels, minima and the like, no strip of measured
    pixels between holes is one or two pixels wide, and after filters that keep the depth of missing
    pixels, those that appear are not lost again in the next frames. Then the images are
    ``processed``, too; a filter of an inserted person alone does not hide it. Without wide gaps and
    without other steps in depth, as before an empty wall, images are ``undecidable``. For
    time-of-flight cameras, which are recognised by the size of their images, missing wide gaps are
    no evidence; if the other steps in depth are as sharp as the silhouette, their images are
    ``undecidable``: they may be rendered. Several people who were inserted before a bare wall look
    like this: 19 of 20 forged streams of two people of UTD-MHAD, 2 to 3.2 m before a simulated
    camera, are ``undecidable``, and all are ``tampered`` with only one of the two. A rendering with
    noise and missing pixels whose other objects are few, or near the accused one, is accused.

    If silhouettes have neither a step nor a gap on either side, as blended silhouettes and those of
    time of flight, streams of other cameras are ``undecidable``; a person who was blended into a
    time-of-flight stream leaves no trace. No verdict says that a stream is authentic.

    An image that was cropped to the size of another camera is recognised if the field of view of
    its calibration is below 50 degrees. An image that was made smaller by leaving pixels out, with
    a scaled calibration, cannot be distinguished from that of a smaller camera.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, RgbdCalibration, RgbdFrame, authenticate
    >>> camera = RgbdCalibration(Intrinsics(fx=60, fy=60, cx=31.5, cy=31.5, width=64, height=64))
    >>> still = RgbdFrame(np.full((64, 64), 2000, np.uint16), camera)
    >>> found = authenticate.inspect_stream([still] * 3)
    >>> found.verdict, found.reason
    ('processed', 'cropped: 64 x 64 pixels are the size of no known camera: perhaps an unknown one')
    """
    some, has_more = frames_to_judge(frames)
    if not some:
        raise InputError("frames: expected at least one, got none")
    if any(frame.depth.shape != some[0].depth.shape for frame in some):
        raise InputError("frames: expected images of one size")
    some, remark = without_marks(some)
    with reporting(progress, "inspect") as report:
        told = report or (lambda _: None)
        noise = _relative_change(np.array([depth_noise(f.depth).mean() for f in some]))
        told(0.4)
        processing = processing_of(some)
        frozen, frozen_masks = judge_repetition(some)
        told(0.6)
        edges = judge_silhouettes(some)
        told(1.0)
    found = _concluded(some, noise, processing, (frozen, frozen_masks), edges)
    if has_more:
        remark += f"; of the first {MAX_FRAMES} frames, not the rest"
    is_judged = found.verdict in ("no_trace", "tampered")
    power = found.power if is_judged else NO_POWER
    return replace(found, reason=found.reason + remark, power=power)


def _concluded(
    some: Sequence[RgbdFrame],
    noise: NDArray[np.float64],
    processing: tuple[Processing, ...],
    repetition: tuple[StreamReport, Mask],
    silhouettes: tuple[StreamReport, tuple[StreamRegion, ...], Mask],
) -> StreamInspection:
    """The verdict on frames from the reports of all detectors."""
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
    if edges.verdict == "tampered" and len(frozen_masks):
        # a person who keeps still repeats depths, too
        masks = frozen_masks | edge_masks
        regions = tuple(
            StreamRegion(frame.number, box_of(mask), 1.0)
            for frame, mask in zip(some, masks, strict=True)
            if mask.any()
        )
        why = f"{frozen.reason}, and silhouettes before it are cut out"
        return StreamInspection("tampered", why, edges.score, regions, masks, **base)
    if edges.verdict == "tampered":
        return StreamInspection(
            "tampered", edges.reason, edges.score, edge_regions, edge_masks, **base
        )
    # Renderings and images whose holes were filled have sharp silhouettes by nature, and repeat
    # what does not move.
    is_sharp = len(frozen_masks) > 0 and edges.score is not None and edges.score >= SHARP
    if frozen.verdict == "processed" and not is_sharp:
        return StreamInspection("processed", frozen.reason, edges.score, **base)
    return StreamInspection(edges.verdict, edges.reason, edges.score, **base)
