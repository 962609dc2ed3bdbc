"""The unit and the range of depth images: what was read of one, and words on several of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from manip3d._util.texts import counted
from manip3d.io import describe_unit
from manip3d.rgbd import NO_MEASUREMENT

if TYPE_CHECKING:
    from manip3d.camera import Intrinsics
    from manip3d.io import DepthReading

NO_CAMERA = (
    "an organised cloud whose points are not those of a camera's pixels: faces across depth steps "
    "stay without a max_edge"
)
COMMON_GUESS = "guess:"
"""Prefix of a unit that was guessed for several images, so that each of them says so."""


@dataclass(frozen=True)
class DepthFound:
    """Unit and range of a depth image.

    Attributes
    ----------
    unit : str
        The unit that was used; empty if the file was not read.
    is_guess : bool
        Whether it was guessed from the numbers.
    doubt : str
        Reason to doubt it; empty if there is none.
    near, far : float or None
        Smallest and largest measurement in metres; None without a measurement.
    num_marked : int
        Same as for `manip3d.io.DepthReading`.
    size : str
        Width and height of the image in pixels; empty for clouds, whose points show their camera.
    camera : str
        Focal lengths and principal point, as in ``--intrinsics``; empty for clouds.
    """

    unit: str = ""
    is_guess: bool = False
    doubt: str = ""
    near: float | None = None
    far: float | None = None
    num_marked: int = 0
    size: str = ""
    camera: str = ""

    @staticmethod
    def of(reading: DepthReading, doubt: str, camera: Intrinsics | None = None) -> DepthFound:
        """Return what was read of an image, without ``camera`` of a cloud.

        ``doubt`` is that of `read_frame`.
        """
        near, far = reading.range_m or (None, None)
        size = numbers = ""
        if camera is not None:
            size = f"{camera.width} x {camera.height}"
            numbers = ",".join(f"{n:.10g}" for n in (camera.fx, camera.fy, camera.cx, camera.cy))
        return DepthFound(
            reading.unit, reading.guessed, doubt, near, far, reading.num_marked, size, numbers
        )


def size_warning(found: Sequence[DepthFound]) -> str:
    """Return words on images of several sizes with the same numbers of a camera; else nothing."""
    sizes = dict.fromkeys(each.size for each in found if each.size)
    if len(sizes) < 2 or len({each.camera for each in found if each.size}) >= len(sizes):
        return ""
    return (
        f"; warning: images of {len(sizes)} sizes ({', '.join(sizes)} pixels) have the same "
        "numbers of a camera, which can only be those of one size"
    )


def sentence_of_images(found: Sequence[DepthFound]) -> str:
    """Return one sentence on several images: range, unit, whether it is a guess, and doubts."""
    images = counted(len(found), "depth image", separator=",")
    measured = [each for each in found if each.near is not None and each.far is not None]
    if not measured:
        return f"{images}, no measured pixel"
    near = min(each.near for each in measured if each.near is not None)
    far = max(each.far for each in measured if each.far is not None)
    units = Counter(each.unit for each in measured).most_common()
    named = [f"{unit} ({describe_unit(unit)})" for unit, _ in units]
    if len(units) > 1:
        named = [f"{words} in {number:,}" for words, (_, number) in zip(named, units, strict=True)]
    words = f"{images}, depth {near:.2f} to {far:.2f} m, unit {', '.join(named)}"
    if any(each.is_guess for each in measured):
        words += ", guessed"
    doubts = [each.doubt for each in measured if each.doubt]
    if doubts:
        of_some = f" for {len(doubts):,} of them" if len(measured) > 1 else ""
        words += f"; warning{of_some}: {doubts[0]}"
    if marked := sum(each.num_marked for each in found):
        words += f"; {marked:,} pixels of {NO_MEASUREMENT} taken as not measured"
    return words
