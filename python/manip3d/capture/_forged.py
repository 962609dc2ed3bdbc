"""A source that forges the frames of another one; the forgery can be switched while it runs."""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from manip3d._util.paths import path_of
from manip3d.camera import Registration, same_camera
from manip3d.errors import FormatError, InputError
from manip3d.forge import StreamForger, background_plate
from manip3d.io import read_bvh
from manip3d.io._files import open_regular
from manip3d.modify import skeletons_from_motion
from manip3d.rgbd import RgbdCalibration, RgbdFrame, Skeleton

LEARNED = 30
"""Number of first frames from which the scene behind the person is learnt; they are not forged."""

_RATE = 30.0  # frames per second to which a BVH motion is resampled


@dataclass(frozen=True)
class ForgedPlan:
    """Source and options of an address ``forged:SOURCE#OPTIONS``.

    Attributes
    ----------
    source : str
        Address of the source that is forged.
    kind : int
        Type of the forgery, 1 or 2, see `manip3d.forge.stream`.
    pose, background : str
        Address of the source of the motion (or a BVH file) and of the background; empty: none.
    still : bool
        Whether only the first frame of ``background`` is used.
    move : (float, float, float), metres
        Displacement of the person.
    blend : int, pixels
        Width of the blended seam around the person.
    is_forged : bool
        Whether the first frames are forged.
    period_s : float, seconds
        Time after which real and forged frames alternate; 0: they do not.
    switch : str
        File whose content, ``real`` or ``forged``, selects the frames while the source runs; empty:
        none.
    """

    source: str
    kind: int = 1
    pose: str = ""
    background: str = ""
    still: bool = False
    move: tuple[float, float, float] = (0.0, 0.0, 0.0)
    blend: int = 1
    is_forged: bool = True
    period_s: float = 0.0
    switch: str = ""


def read_plan(uri: str) -> ForgedPlan:
    """Read an address.

    Raises
    ------
    InputError
        The address names no source, or has an unknown option or an invalid value.
    """
    place, mark, text = uri.removeprefix("forged:").rpartition("#")
    source, options = (place, _options(text)) if mark else (text, {})
    if not source:
        raise InputError(f"uri: expected forged:SOURCE or forged:SOURCE#OPTIONS, got {uri!r}")
    values: dict[str, Any] = {}
    for name, value in options.items():
        if name not in _OPTIONS:
            raise InputError(f"{name}: expected one of {', '.join(_OPTIONS)} behind # in {uri!r}")
        expected, read = _OPTIONS[name]
        try:
            values |= read(value)
        except ValueError:
            raise InputError(f"{name}: expected {expected}, got {value!r}") from None
    plan = ForgedPlan(source, **values)
    if (plan.kind == 2) != bool(plan.pose):
        raise InputError("pose: expected a motion for type=2, and for type=2 only")
    return plan


def _options(text: str) -> dict[str, str]:
    """Return the options by name; ``+`` is itself, not a blank as in forms."""
    pairs = (part.partition("=") for part in text.split("&") if part)
    return {unquote(name): unquote(value) for name, _, value in pairs}


def _one_of(words: Mapping[str, Any], text: str) -> Any:
    if text not in words:
        raise ValueError
    return words[text]


def _number(text: str, low: float, high: float) -> float:
    value = float(text)
    if not low <= value <= high:
        raise ValueError
    return value


def _pixels(text: str) -> int:
    _number(text, 0, 64)
    return int(text)


def _shown(text: str) -> dict[str, Any]:
    if text in ("real", "forged"):
        return {"is_forged": text == "forged"}
    return {"is_forged": False, "period_s": _number(text, 0.01, 86_400.0)}


def _moved(text: str) -> dict[str, Any]:
    x, y, z = (_number(part, -100.0, 100.0) for part in text.split(","))
    return {"move": (x, y, z)}


def _read(name: str, read: Callable[[str], Any]) -> Callable[[str], dict[str, Any]]:
    return lambda text: {name: read(text)}


_OPTIONS: dict[str, tuple[str, Callable[[str], dict[str, Any]]]] = {
    "type": ("1 or 2", _read("kind", lambda text: _one_of({"1": 1, "2": 2}, text))),
    "pose": ("a source or a .bvh file", _read("pose", str)),
    "background": ("a source", _read("background", str)),
    "still": ("yes or no", _read("still", lambda t: _one_of({"yes": True, "no": False}, t))),
    "move": ("X,Y,Z in metres", _moved),
    "blend": ("0 to 64 pixels", _read("blend", _pixels)),
    "show": ("real, forged, or seconds after which they alternate", _shown),
    "switch": ("a file", _read("switch", str)),
}


class SwitchedForgery:
    """Frames of another source, real or forged, with the interface of the sources in ``_core``.

    Parameters
    ----------
    plan : ForgedPlan
        Options of the forgery.
    inner : source
        The source whose frames are forged.
    background : sequence of RgbdFrame
        Scene that replaces the one behind the person. Empty: the source's own scene, learnt from
        its first `LEARNED` frames.
    pose : sequence of RgbdFrame or Skeleton, optional
        Motion for forgeries of type 2.
    """

    def __init__(
        self,
        plan: ForgedPlan,
        inner: Any,
        background: Sequence[RgbdFrame],
        pose: Sequence[RgbdFrame | Skeleton] | None,
    ) -> None:
        self.is_forged = plan.is_forged
        self._plan, self._inner, self._pose = plan, inner, pose
        self._switch = Path(path_of(plan.switch, "switch")) if plan.switch else None
        self._lock = threading.RLock()
        self._is_started = False
        self._learns = not background
        self._begin()
        own = inner.calibration
        if background:
            seen = background[0].calibration
            if not same_camera(own.depth, seen.depth) or not _same(
                own.registration, seen.registration
            ):
                raise InputError(
                    "background: expected frames of the source's camera, since frames of two "
                    "cameras make no stream; 'forge stream' takes any"
                )
            self._has_color = all(frame.color is not None for frame in background)
        else:
            self._has_color = own.registration is None
        self._calibration = own if self._has_color else RgbdCalibration(own.depth)
        self._forger = self._forger_before(background) if background else None

    def _begin(self) -> None:
        self._counts = {"real": 0, "forged": 0}
        self._learnt: list[RgbdFrame] = []
        self._began: int | None = None

    def _forger_before(self, background: Sequence[RgbdFrame]) -> StreamForger:
        plan = self._plan
        kept = [self._same_kind(frame) for frame in background]
        return StreamForger(
            kept[0] if plan.still else kept,
            kind=plan.kind,
            pose=self._pose,
            move=plan.move,
            blend=plan.blend,
        )

    def read(self, timeout_ms: int) -> RgbdFrame | bool:
        """Return the next frame; True: none has arrived yet; False: no more frames."""
        with self._lock:
            found = self._inner._source.read(timeout_ms)
            if isinstance(found, bool):
                return found
            frame = self._inner._to_frame(found) if isinstance(found, Mapping) else found
            return self._shown(frame)

    def _shown(self, frame: RgbdFrame) -> RgbdFrame | bool:
        frame = self._same_kind(frame)
        is_forged = self._wanted(frame.time_ns)
        if self._forger is None:
            self._learn(frame)
            is_forged, self._began = False, None
        elif not is_forged:
            self._forger.skip()
        if is_forged:
            assert self._forger is not None
            forged = self._forger.process(frame)
            if forged is None:
                return False
            frame = self._same_kind(forged.frame)
        self._counts["forged" if is_forged else "real"] += 1
        return frame

    def _same_kind(self, frame: RgbdFrame) -> RgbdFrame:
        """Return the frame with the common calibration, without colour if forged ones have none."""
        color = frame.color if self._has_color else None
        return replace(frame, calibration=self._calibration, color=color)

    def _learn(self, frame: RgbdFrame) -> None:
        self._learnt.append(frame)
        if len(self._learnt) >= LEARNED:
            self._forger = self._forger_before([background_plate(self._learnt)])
            self._learnt = []

    def _wanted(self, time_ns: int) -> bool:
        """Return whether the frame with this time is to be forged."""
        if self._switch is not None:
            with contextlib.suppress(OSError, FormatError), open_regular(self._switch) as file:
                word = file.read(16).strip()
                if word in (b"real", b"forged"):
                    self.is_forged = word == b"forged"
        elif self._plan.period_s:
            if self._began is None:
                self._began = time_ns
            rounds = math.floor((time_ns - self._began) * 1e-9 / self._plan.period_s)
            return rounds % 2 == 1
        return self.is_forged

    def calibration(self) -> RgbdCalibration:
        """Return the calibration of all frames, real and forged."""
        return self._calibration

    def counters(self) -> dict[str, int]:
        """Return the inner source's counters, and the numbers of real and of forged frames."""
        return {**self._inner.counters, **self._counts}

    def conversions(self) -> Mapping[str, Any]:
        """Return how the inner source's frames differ from what its files hold."""
        found: Mapping[str, Any] = self._inner._source.conversions()
        return found

    def num_frames(self) -> int | None:
        """Return the number of frames of the inner source; None if it is not known."""
        found: int | None = self._inner.num_frames
        return found

    def is_live(self) -> bool:
        """Return whether the inner source is a live one."""
        return bool(self._inner.is_live)

    def start(self) -> None:
        """Open the device again, or rewind the recording; counts and alternation start anew.

        A background that was learnt from the source is learnt again.
        """
        with self._lock:
            if not self._is_started:  # the inner source is already open at the first call
                self._is_started = True
                return
            self._inner.start()
            self._begin()
            if self._learns:
                self._forger = None
            elif self._forger is not None:
                self._forger.reset()

    def stop(self) -> None:
        """End the thread of the inner source."""
        self._inner.stop()

    def close(self) -> None:
        """Close the inner source; `start` opens it again."""
        self._inner._close()


def _same(one: Registration | None, other: Registration | None) -> bool:
    if one is None or other is None:
        return one is other
    return (
        same_camera(one.color, other.color)
        and np.array_equal(one.rotation, other.rotation)
        and np.array_equal(one.translation, other.translation)
    )


def motion_of(place: str) -> list[Skeleton] | None:
    """Return the poses of a BVH file, resampled to 30 Hz; None for other files."""
    if not place.lower().endswith(".bvh"):
        return None
    return list(skeletons_from_motion(read_bvh(place), rate=_RATE))
