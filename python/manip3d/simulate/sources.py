"""``sim:`` addresses of simulated scans, people and drives, which can be used as sources."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple, TypeVar
from urllib.parse import parse_qsl, urlsplit

from manip3d._util.checked import checked
from manip3d._util.times import nanoseconds
from manip3d.authenticate import DriveMoment, WatchedDrive
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame
from manip3d.simulate import cameras, scenes
from manip3d.simulate.drives import EPOCH_NS, DriveFrame, drive
from manip3d.simulate.people import BodySimulator
from manip3d.simulate.streets import street
from manip3d.simulate.terrestrial import terrestrial_scan

__all__ = ["open_drive", "open_source", "watched_street"]

_Number = TypeVar("_Number", int, float)


@checked
def open_source(address: str, *, threads: int = 0) -> Iterator[LidarFrame] | BodySimulator:
    """Open simulated scans or RGB-D frames of a person by their address.

    Parameters
    ----------
    address : str
        ``sim:street?seed=0&frames=10&start=0`` (HDL-64E on a car; ``seed`` determines the street);
        ``sim:indoor-00?seed=0&resolution=0.06`` (terrestrial scan of a scene of
        `manip3d.simulate.scenes`; ``seed`` is that of the noise); or
        ``sim:body?motion=arm-raise&amputated=right-arm&lost=2:3`` with the options of
        `BodySimulator` (``yes`` and ``no``; ``from:until`` for seconds). Options of streets and
        scenes default to the values shown here.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The scans do not depend on it.

    Returns
    -------
    iterator of LidarFrame, or BodySimulator
        Scans with ground truth in their fields ``label`` and ``object``; or, for ``sim:body``, the
        simulator, whose iteration yields `RgbdFrame`.

    Raises
    ------
    InputError
        The source, an option or a value is unknown.
    MissingExtraError
        Open3D is not installed.

    Examples
    --------
    >>> for frame in open_source("sim:street?seed=3&frames=2"):  # doctest: +SKIP
    ...     print(frame.num_points)
    """
    scheme, name, options = _parts_of(address)
    if scheme != "sim":
        raise InputError(f"address: expected sim:..., got {address!r}")
    if name == "body":
        return _body(options, address, threads)
    seed = _taken(options, "seed", int, 0)
    if seed < 0:
        raise InputError(f"seed: expected >= 0, got {seed}")
    if name == "street":
        frames, start = _taken(options, "frames", int, 10), _taken(options, "start", float, 0.0)
        _refuse_others(options, address, ("seed", "frames", "start"))
        return (
            frame.scan.frame.replace(source=address, time_ns=EPOCH_NS + nanoseconds(frame.time_s))
            for frame in drive(
                street(seed), frames, start=start, pictures=False, rng=seed, threads=threads
            )
        )
    if name in {**scenes.SCENES, **scenes.CALIBRATION}:
        resolution = _taken(options, "resolution", float, 0.06)
        _refuse_others(options, address, ("seed", "resolution"))
        scan = terrestrial_scan(
            scenes.make(name), resolution_deg=resolution, rng=seed, threads=threads
        )
        return iter([scan.frame.replace(source=address)])
    raise InputError(
        "address: expected sim:street or a scene such as sim:indoor-00 or sim:body, "
        f"got {address!r}"
    )


@checked
def open_drive(address: str, *, threads: int = 0) -> Iterator[DriveFrame]:
    """Open the simulated frames of a car with LiDAR and cameras by their address.

    Parameters
    ----------
    address : str
        ``sim:street?seed=0&frames=10&start=0&surround=no``, as for `open_source`; with
        ``surround=yes`` there are stereo pairs all around the car.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The frames do not depend on it.

    Yields
    ------
    DriveFrame

    Raises
    ------
    InputError
        The address, an option or a value is unknown.
    MissingExtraError
        Open3D is not installed.

    Examples
    --------
    >>> for frame in open_drive("sim:street?seed=3&frames=2"):  # doctest: +SKIP
    ...     print(frame.pictures.left.shape, frame.velocity)
    """
    options = _drive_options(address)
    return drive(
        street(options.seed),
        options.frames,
        start=options.start,
        surround=options.surround,
        rng=options.seed,
        threads=threads,
    )


class _DriveOptions(NamedTuple):
    """Options of an address of `open_drive`."""

    seed: int
    frames: int
    start: float
    surround: bool


def _drive_options(address: str) -> _DriveOptions:
    scheme, name, options = _parts_of(address)
    if (scheme, name) != ("sim", "street"):
        raise InputError(f"address: expected sim:street, got {address!r}")
    told = _DriveOptions(
        _taken(options, "seed", int, 0),
        _taken(options, "frames", int, 10),
        _taken(options, "start", float, 0.0),
        _yes_or_no("surround", options.pop("surround", "no")),
    )
    _refuse_others(options, address, _DriveOptions._fields)
    return told


@checked
def watched_street(address: str, *, frames: int | None = None, threads: int = 0) -> WatchedDrive:
    """Open a simulated drive for `manip3d.authenticate.watch_drive`.

    Parameters
    ----------
    address : str
        Same as for `open_drive`.
    frames : int, optional
        Largest number of frames.
    threads : int
        Same as for `open_drive`.

    Returns
    -------
    manip3d.authenticate.WatchedDrive

    Raises
    ------
    InputError, MissingExtraError
        Same as for `open_drive`.

    Examples
    --------
    >>> drive = watched_street("sim:street?seed=3&frames=2")  # doctest: +SKIP
    """
    if frames is not None and frames < 1:
        raise InputError(f"frames: expected at least 1, got {frames}")
    has = _drive_options(address).frames
    source = open_drive(address, threads=threads)
    first = next(source)
    around = cameras.surround_rigs()
    taken = itertools.islice(itertools.chain([first], source), frames)
    return WatchedDrive(
        around if first.around else around["front"],
        map(_moment, taken),
        has if frames is None else min(has, frames),
    )


def _moment(frame: DriveFrame) -> DriveMoment:
    one = None if frame.pictures is None else (frame.pictures.left, frame.pictures.right)
    pairs = {name: (pair.left, pair.right) for name, pair in frame.around.items()}
    return DriveMoment(
        frame.scan.frame,
        None if pairs else one,
        velocity=frame.velocity,
        time_s=frame.time_s,
        pairs=pairs or None,
    )


def _parts_of(address: str) -> tuple[str, str, dict[str, str]]:
    """Scheme, name and options of an address."""
    parts = urlsplit(address)
    if "#" in address:
        raise InputError(f"address: expected nothing after a #, got {address!r}")
    options: dict[str, str] = {}
    for name, text in parse_qsl(parts.query, keep_blank_values=True):
        if name in options:
            raise InputError(f"{name}: expected it once, got it twice in {address!r}")
        options[name] = text
    return parts.scheme, parts.path, options


def _body(options: Mapping[str, str], address: str, threads: int) -> BodySimulator:
    fields = {field.name: field for field in dataclasses.fields(BodySimulator)}
    others = {name: text for name, text in options.items() if name not in fields}
    _refuse_others(others, address, fields)
    values = {
        name: _parsed(name, text, str(fields[name].type), fields[name].default)
        for name, text in options.items()
    }
    return BodySimulator(**{"threads": threads} | values)


def _parsed(name: str, text: str, kind: str, default: Any) -> Any:
    """Parse an option of `BodySimulator` by the type of its field."""
    if kind.startswith("bool"):
        return _yes_or_no(name, text)
    if kind.startswith("str"):
        return text or default
    try:
        if kind.startswith("Interval"):
            first, last = (float(part) for part in text.split(":"))
            return first, last
        return int(text) if kind == "int" else float(text)
    except ValueError:
        expected = "FROM:UNTIL" if kind.startswith("Interval") else "a number"
        raise InputError(f"{name}: expected {expected}, got {text!r}") from None


def _yes_or_no(name: str, text: str) -> bool:
    if text not in ("yes", "no"):
        raise InputError(f"{name}: expected yes or no, got {text!r}")
    return text == "yes"


def _taken(
    options: dict[str, str], name: str, kind: Callable[[str], _Number], default: _Number
) -> _Number:
    """Remove an option from ``options``, and return its value or the default."""
    text = options.pop(name, None)
    if text is None:
        return default
    try:
        return kind(text)
    except ValueError:
        raise InputError(f"{name}: expected a number, got {text!r}") from None


def _refuse_others(options: Mapping[str, str], address: str, known: Iterable[str]) -> None:
    if options:
        raise InputError(
            f"{address}: unknown option {', '.join(sorted(options))}; expected some of "
            f"{', '.join(sorted(known))}"
        )
