"""``manip3d forge``: write forged scans and RGB-D streams, with their truth beside them."""

from __future__ import annotations

import inspect
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from enum import StrEnum
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
import typer

from manip3d.cli import kinds
from manip3d.cli.capture import check_recording_output, place_of_recording
from manip3d.cli.convert import Up
from manip3d.cli.kinds import expect_kind
from manip3d.cli.many import over_files
from manip3d.cli.options import (
    FolderIntrinsics,
    Force,
    Jobs,
    Json,
    MostFrames,
    Output,
    Quiet,
    RgbdPlace,
    Scan,
    Seed,
)
from manip3d.cli.scanning import tell_losses
from manip3d.cli.signals import ended_like_ctrl_c
from manip3d.cli.terminal import Terminal, check_output, count, counted, left_out, naming_options
from manip3d.cli.truth import truth_of
from manip3d.errors import FormatError, InputError
from manip3d.io import SCAN_SUFFIXES
from manip3d.io._files import atomic_pair
from manip3d.io._scan_files import FOLDER_SUFFIXES
from manip3d.io._scan_tables import scan_suffix
from manip3d.lidar import Box, LidarFrame, map_shift, origin_of, shifted, to_scan
from manip3d.rgbd import RgbdFrame

if TYPE_CHECKING:
    from manip3d.capture import Recording, RgbdSource
    from manip3d.forge import ForgedStream, Forgery
    from manip3d.rgbd import RgbdCalibration, Skeleton

app = typer.Typer(
    name="forge",
    help="Forge LiDAR scans and RGB-D streams, with their truth.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@dataclass(frozen=True)
class Order:
    """Options of ``forge lidar``; each attack uses some of them."""

    hoax: str | None
    position: Sequence[float] | None
    box: Sequence[float] | None
    scale: float
    yaw: float | None
    amplitude: float
    distance: float
    range_noise: float
    printed: bool
    lattice: Path | None
    up: str
    seed: int
    threads: int
    allow_collision: bool
    say: Callable[[str], object]


def forge_scan(
    attack: str, source: str, output: Path, order: Order, terminal: Terminal, *, force: bool
) -> dict[str, Any]:
    """Forge a scan and write it, with the truth as ``OUT.truth.json``.

    Raises
    ------
    InputError
        An option that the attack needs is missing; the attack would change nothing; the truth
        file exists without ``force``.
    FormatError, OSError
        See `manip3d.io.read_scan`.
    """
    import manip3d

    if not (order.scale > 0.0 and math.isfinite(order.scale)):
        raise InputError(f"--scale: expected a finite number > 0, got {order.scale}")
    if order.yaw is not None and not math.isfinite(order.yaw):
        raise InputError(f"--yaw: expected a finite number, got {order.yaw}")
    truth = output.with_name(output.name + ".truth.json")
    if truth.exists() and not force:
        raise InputError(f"{truth}: exists already; --force replaces it")
    frame = manip3d.io.read_scan(source)
    terminal.say(f"read {source}: {counted(frame.num_points, 'point')}")
    with naming_options(
        "allow-collision", "amplitude", "box", "distance", "hoax", "lattice", "position",
        "range-noise", "scale", angle="yaw", object_points="hoax", size="box", turn="yaw",
    ):  # fmt: skip
        forged = ATTACKS[attack].forge(frame, order)
    if "lattice" in ATTACKS[attack].options and (why := _why_off_lattice(frame, order)):
        terminal.warn(
            f"--lattice: forged points stand out, because the scan is not on the lattice: {why}; "
            "'manip3d lattice' makes the lattice of a scanner"
        )
    record = truth_of(forged, output) | {"source": source, "output": str(output)}
    if "seed" in ATTACKS[attack].options:
        record["seed"] = order.seed
    with atomic_pair(output, truth) as (scan, told):
        forged.write(scan)
        told.write_text(json.dumps(record) + "\n", encoding="utf-8")
    tell_losses([forged.frame], scan_suffix(output), terminal)
    terminal.say(f"wrote {output} and {truth.name}")
    return {
        key: len(value) if key in ("added", "moved", "moved_from", "removed") else value
        for key, value in record.items()
    }


def _ctp(frame: LidarFrame, order: Order) -> Forgery:
    from manip3d import forge

    return forge.ctp(
        frame,
        _hoax(order),
        position=_position(order, frame),
        rotation=order.yaw or 0.0,
        scale=order.scale,
        translation="paper" if order.printed else "centroid",
        threads=order.threads,
    )


def _crtp(frame: LidarFrame, order: Order) -> Forgery:
    from manip3d import forge

    return forge.crtp(
        frame,
        _hoax(order),
        position=_position(order, frame),
        rotation=order.yaw or 0.0,
        scale=order.scale,
        translation="paper" if order.printed else "centroid",
        rng=order.seed,
        threads=order.threads,
    )


def _insert(frame: LidarFrame, order: Order) -> Forgery:
    from manip3d import forge

    return forge.insert_occluding(
        frame,
        _hoax(order),
        position=_position(order, frame),
        rotation=order.yaw or 0.0,
        scale=order.scale,
        range_noise=order.range_noise,
        rng=order.seed,
        threads=order.threads,
    )


def _subtract(frame: LidarFrame, order: Order) -> Forgery:
    from manip3d import forge

    return forge.subtractive(frame, _box(order, frame), threads=order.threads)


def _deform(frame: LidarFrame, order: Order) -> Forgery:
    from manip3d import forge

    return forge.deform(
        frame,
        _box(order, frame),
        amplitude=order.amplitude,
        rng=order.seed,
        threads=order.threads,
    )


def _dent(frame: LidarFrame, order: Order) -> Forgery:
    from manip3d import forge

    return forge.deform(
        frame,
        _box(order, frame),
        amplitude=order.amplitude,
        direction="normal",
        rng=order.seed,
        threads=order.threads,
    )


def _translate(frame: LidarFrame, order: Order) -> Forgery:
    from manip3d import forge

    return forge.translation(
        frame,
        _box(order, frame),
        distance=order.distance,
        allow_collision=order.allow_collision,
        threads=order.threads,
    )


def _rotate(frame: LidarFrame, order: Order) -> Forgery:
    from manip3d import forge

    angle = {} if order.yaw is None else {"angle": order.yaw}
    return forge.rotation(
        frame,
        _box(order, frame),
        allow_collision=order.allow_collision,
        threads=order.threads,
        **angle,
    )


def _replace(frame: LidarFrame, order: Order) -> Forgery:
    from manip3d import forge

    hoax = _hoax(order)
    points = _points(hoax) * order.scale
    return forge.replacement(
        frame,
        LidarFrame(points, hoax.intensity) if isinstance(hoax, LidarFrame) else points,
        _box(order, frame),
        allow_collision=order.allow_collision,
        threads=order.threads,
    )


def _lattice_insert(frame: LidarFrame, order: Order) -> Forgery:
    from manip3d import forge

    thing, turn = _seen_object(frame, order), _turn(order)
    return forge.lattice_insert(
        frame, thing, lattice=_lattice(order), turn=turn, rng=order.seed, threads=order.threads
    )


def _spoof(frame: LidarFrame, order: Order) -> Forgery:
    from manip3d import forge

    thing, turn = _seen_object(frame, order), _turn(order)
    return forge.spoof(
        frame, thing, lattice=_lattice(order), turn=turn, rng=order.seed, threads=order.threads
    )


def _lattice_remove(frame: LidarFrame, order: Order) -> Forgery:
    from manip3d import forge

    box = _box(order, frame)
    return forge.lattice_remove(
        frame, box, lattice=_lattice(order), rng=order.seed, threads=order.threads
    )


class Attack(NamedTuple):
    """An attack of ``forge lidar``, and those options that only some attacks use."""

    forge: Callable[[LidarFrame, Order], Forgery]
    options: tuple[str, ...]


_PASTED = ("hoax", "position", "scale", "yaw", "up")
_SEEN = ("hoax", "box", "yaw", "lattice", "seed")

ATTACKS = {
    "ctp": Attack(_ctp, (*_PASTED, "printed")),
    "crtp": Attack(_crtp, (*_PASTED, "printed", "seed")),
    "insert": Attack(_insert, (*_PASTED, "range_noise", "seed")),
    "subtract": Attack(_subtract, ("box",)),
    "deform": Attack(_deform, ("box", "amplitude", "seed")),
    "dent": Attack(_dent, ("box", "amplitude", "seed")),
    "translation": Attack(_translate, ("box", "distance", "allow_collision")),
    "rotation": Attack(_rotate, ("box", "yaw", "allow_collision")),
    "replacement": Attack(_replace, ("hoax", "box", "scale", "up", "allow_collision")),
    "lattice-insert": Attack(_lattice_insert, _SEEN),
    "lattice-remove": Attack(_lattice_remove, ("box", "lattice", "seed")),
    "spoof": Attack(_spoof, _SEEN),
}


def _check_used(given: Mapping[str, Any]) -> None:
    """Raise `InputError` if an option is given that the attack does not use."""
    attack = str(given["attack"])
    parameters = inspect.signature(forge_lidar).parameters
    for name in dict.fromkeys(name for each in ATTACKS.values() for name in each.options):
        if name in ATTACKS[attack].options or given[name] == parameters[name].default:
            continue
        users = [f"'{other}'" for other, each in ATTACKS.items() if name in each.options]
        raise InputError(
            f"--{name.replace('_', '-')}: can only be given with {', '.join(users)}, got '{attack}'"
        )


def _hoax(order: Order) -> Any:
    """Read the hoax: a mesh with z up, or a scan."""
    import manip3d
    from manip3d.cli.sources import mesh_suffix
    from manip3d.io import READABLE

    if order.hoax is None:
        raise InputError("--hoax: expected a mesh or scan file, got none")
    path = Path(order.hoax)
    if mesh_suffix(path) not in READABLE:
        return _scan_of_hoax(order.hoax)
    mesh = manip3d.read_mesh(path)
    if order.up == "z":
        return mesh
    x, y, z = mesh.vertices.T
    return mesh.replace(vertices=np.column_stack([x, -z, y]))


def _scan_of_hoax(hoax: str) -> LidarFrame:
    import manip3d

    with naming_options(path="hoax"):
        return manip3d.io.read_scan(hoax)


def _seen_object(frame: LidarFrame, order: Order) -> LidarFrame:
    """Return the points in the box, from the hoax's scan or, without a hoax, from the scan itself.

    Without a box, the nearest object is used.
    """
    if order.hoax is not None and scan_suffix(order.hoax) not in SCAN_SUFFIXES:
        raise InputError(f"--hoax: expected a scan, which this attack copies, got {order.hoax}")
    scan = frame if order.hoax is None else _scan_of_hoax(order.hoax)
    # Without a box, the object is sought in the scan of the hoax.
    with naming_options("hoax", **({} if order.hoax is None else {"scan": "hoax"})):
        inside = _box(order, scan).contains(scan.points)
    intensity = None if scan.intensity is None else scan.intensity[inside]
    return LidarFrame(scan.points[inside], intensity)


def _turn(order: Order) -> float:
    return np.pi / 2.0 if order.yaw is None else order.yaw


def _why_off_lattice(frame: LidarFrame, order: Order) -> str | None:
    from manip3d.authenticate._sensors import why_off_lattice

    return why_off_lattice(frame, _lattice(order), threads=order.threads)


def _lattice(order: Order) -> Any:
    from manip3d import authenticate

    if order.lattice is None:
        return authenticate.kitti_lattice()
    return authenticate.SensorLattice.load(order.lattice)


def _points(hoax: Any) -> Any:
    return hoax.points if isinstance(hoax, LidarFrame) else hoax.vertices


def _position(order: Order, scan: LidarFrame) -> Sequence[float]:
    """Return the position of the order, given in the file's coordinates, in those of the scan."""
    if order.position is None:
        raise InputError("--position: expected X Y Z in metres, got none")
    place: list[float] = (np.asarray(order.position) - map_shift(scan)).tolist()
    return place


def _box(order: Order, scan: LidarFrame) -> Box:
    """Return the box of the order, or that of the nearest object, which is printed.

    The order's box, and the one that is printed, are in the coordinates of the scan's file.
    """
    from manip3d import forge

    if order.box is not None:
        x, y, z, length, width, height, yaw = order.box
        return shifted(Box((x, y, z), (length, width, height), yaw), -map_shift(scan))
    box = forge.nearest_object(scan)
    center = shifted(box, map_shift(scan)).center
    numbers = " ".join(f"{value:.2f}" for value in (*center, *box.size, box.yaw))
    distance = np.linalg.norm(np.subtract(box.center, origin_of(None, to_scan(scan))))
    order.say(f"box: {numbers}, that of the nearest object, at a range of {distance:.1f} m")
    return box


class LidarAttack(StrEnum):
    """Attacks of ``forge lidar`` on a scan."""

    ctp = "ctp"
    crtp = "crtp"
    insert = "insert"
    subtract = "subtract"
    deform = "deform"
    dent = "dent"
    translation = "translation"
    rotation = "rotation"
    replacement = "replacement"
    lattice_insert = "lattice-insert"
    lattice_remove = "lattice-remove"
    spoof = "spoof"


@app.command("lidar")
@over_files(lambda: FOLDER_SUFFIXES, writable=lambda: SCAN_SUFFIXES, check=_check_used)
def forge_lidar(
    attack: Annotated[LidarAttack, typer.Argument(metavar="ATTACK", help="Attack on the scan.")],
    source: Scan,
    output: Output,
    hoax: Annotated[str | None, typer.Option(help="Mesh or scan to paste into the scan.")] = None,
    position: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="X Y Z",
            help="Position of the hoax's centroid in the coordinates of the scan's file, metres.",
        ),
    ] = None,
    box: Annotated[
        tuple[float, float, float, float, float, float, float] | None,
        typer.Option(
            metavar="X Y Z L W H YAW",
            help="Box of the object that is changed: centre in the coordinates of the file, size "
            "(metres) and yaw (radians); by default that of the nearest object more than 1 m from "
            "the scanner, which is printed.",
        ),
    ] = None,
    scale: Annotated[float, typer.Option(help="Factor from the hoax's units to metres.")] = 1.0,
    yaw: Annotated[
        float | None,
        typer.Option(
            help="Rotation about the vertical, radians, counterclockwise from above: of the hoax "
            "(default: 0), of the object that 'rotation' turns (default: -0.1745), or, about the "
            "scanner, of the object that 'lattice-insert' and 'spoof' copy (default: 1.5708)."
        ),
    ] = None,
    amplitude: Annotated[float, typer.Option(help="Amplitude of a deformation, metres.")] = 0.1,
    distance: Annotated[float, typer.Option(help="Length of a translation, metres.")] = 3.0,
    up: Annotated[Up, typer.Option(help="Axis that is up in the hoax's mesh.")] = Up.z,
    range_noise: Annotated[
        float,
        typer.Option(help="Standard deviation of the range of inserted points, metres."),
    ] = 0.0,
    printed: Annotated[
        bool,
        typer.Option(
            "--printed", help="Translate by the formula that the dissertation prints for CTP."
        ),
    ] = False,
    lattice: Annotated[
        Path | None,
        typer.Option(
            help="Lattice of the scanner, as SensorLattice.save writes it (.json), for "
            "'lattice-insert', 'lattice-remove' and 'spoof'; by default that of KITTI's scanner."
        ),
    ] = None,
    allow_collision: Annotated[
        bool,
        typer.Option(
            "--allow-collision",
            help="Let 'translation', 'rotation' and 'replacement' put an object where another one "
            "stands.",
        ),
    ] = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
    seed: Seed = 0,
) -> None:
    """Forge a LiDAR scan. The truth is written beside it, as OUT.truth.json.

    An option that the attack does not use is refused.

    Example: manip3d forge lidar ctp scan.bin -o forged.bin --hoax car.obj --position 8 2 -1
    """
    expect_kind(source, "scan", verb="forge lidar")
    shell = Terminal(as_json=as_json, quiet=quiet)
    order = Order(
        hoax,
        position,
        box,
        scale,
        yaw,
        amplitude,
        distance,
        range_noise,
        printed,
        lattice,
        up.value,
        seed,
        jobs,
        allow_collision,
        shell.say,
    )
    _check_used({"attack": attack.value, **vars(order)})
    check_output(output, SCAN_SUFFIXES, force=force)
    record = forge_scan(attack.value, source, output, order, shell, force=force)
    shell.result(record)


@app.command("alert-set")
def alert_set(
    output: Annotated[Path, typer.Argument(metavar="OUT", help="Folder to write.")],
    frames: Annotated[
        int | None,
        typer.Option("--frames", min=1, help="At most this many frames of each drive and attack."),
    ] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    seed: Seed = 0,
) -> None:
    """Write the frames and attacks of table 7.2 (ALERT) as files. The frames come from three
    simulated drives.

    The set has as many frames as that of the dissertation: 1765 clean frames, and 8735 attacked
    frames except those without a suitable object. Scans have names such as
    OUT/drive_1/additive/000000.bin.xz; the truth of an attack is beside each scan as .truth.json,
    and OUT/manifest.csv lists all scans. A run that was stopped continues when the command is given
    again.

    Example: manip3d forge alert-set attacks --frames 5
    """
    from manip3d.cli.alert_set import write_set

    shell = Terminal(as_json=as_json, quiet=quiet)
    shell.result(write_set(output, frames, seed, shell, force=force))


class Method(StrEnum):
    """Skinning method, by which a mesh follows a skeleton."""

    lbs = "lbs"
    rigid = "rigid"
    spherical = "spherical"


class Scope(StrEnum):
    """Bones that follow a pose."""

    limbs = "limbs"
    body = "body"


def forge_frames(
    source: str,
    output: Path,
    terminal: Terminal,
    *,
    kind: int,
    pose: str,
    background: str,
    still: bool,
    frames: int | None,
    force: bool,
    options: dict[str, Any],
    intrinsics: str = "",
) -> dict[str, Any]:
    """Forge a stream and write it as a recording, with the truth as ``OUT.truth.npz``.

    ``output`` may have a scheme (``tum:walk``), which is no part of the truth's name.

    Raises
    ------
    InputError
        An option does not fit; the truth file exists without ``force``; the source is live, and
        ``frames`` is not given; no frame has a forged pixel (the recording and its truth are
        written all the same).
    FormatError, DeviceError, OSError
        A source cannot be read.
    """
    from manip3d import forge

    place = place_of_recording(output)
    if not place.name:
        raise InputError(f"-o {output}: expected the name of a recording")
    truth = place.with_name(place.name + ".truth.npz")
    if truth.exists() and not force:
        raise InputError(f"{truth}: exists already; --force replaces it")

    with ExitStack() as stack:
        people = stack.enter_context(_open_bounded(source, frames, terminal, intrinsics))
        given = forge.recorded_people(people, num_frames=frames, with_plate=not background)
        if given.plate is not None:
            terminal.say("background: the scene behind the person, from the source's own frames")
            behind: RgbdFrame | Sequence[RgbdFrame] = given.plate
        else:
            most = 1 if still else min(frames or forge.MAX_KEPT, forge.MAX_KEPT)
            with _open_bounded(background, frames, terminal, intrinsics) as opened:
                scenes = _first(opened, most)
            behind = scenes[0] if still else forge.at_pace(scenes, given.step_ns)
        motion = _motion(pose, given.step_ns, frames, terminal) if pose else None
        with naming_options("pose", "method", "scope", "move", "blend"):
            forged = forge.stream(given.frames, behind, kind=kind, pose=motion, **options)
        done = _record(forged, output, truth, terminal, force=force)
        for line in left_out(people.counters):
            terminal.warn(line)
    forged.write_truth(truth)
    terminal.say(f"wrote {output} and {truth.name}")
    if forged.missed == done.frames:
        raise InputError(
            f"{source}: expected a person before the background, but no frame of {output} has a "
            "forged pixel: nobody was found, or the person is behind the background or out of its "
            "view"
        )
    if forged.missed:
        terminal.warn(
            f"{count(forged.missed)} of {counted(done.frames, 'frame')} without a forged "
            "pixel: nobody was found, or the person is behind the background or out of its view"
        )
    return {
        "source": source,
        "output": str(output),
        "type": kind,
        "frames": done.frames,
        "frames_without_person": forged.missed,
        "forged_share": forged.forged_share,
    }


@dataclass(frozen=True)
class _WithoutOldTruth:
    """A forged stream that removes the truth file of an old recording before its first frame.

    The recorder has removed the old recording by then. If the new recording is stopped early, the
    old truth would otherwise lie beside it.
    """

    stream: ForgedStream
    truth: Path

    @property
    def calibration(self) -> RgbdCalibration | None:
        return self.stream.calibration

    def __iter__(self) -> Iterator[RgbdFrame]:
        self.truth.unlink(missing_ok=True)
        yield from self.stream


def _record(
    forged: ForgedStream, output: Path, truth: Path, terminal: Terminal, *, force: bool
) -> Recording:
    from manip3d import capture

    with terminal.progress("forge") as progress, naming_options("output", path="output"):
        return capture.record(
            capture.from_frames(_WithoutOldTruth(forged, truth)),
            output,
            overwrite=force,
            progress=progress,
        )


def _open_bounded(
    place: str, frames: int | None, terminal: Terminal, intrinsics: str = ""
) -> RgbdSource:
    """Open a source; raise if it is live and ``frames`` is None, because it would not end.

    ``intrinsics`` are used only if the source has no calibration of its own.
    """
    from manip3d.cli.capture import open_source

    try:
        opened = open_source(place, terminal, verb="forge stream")
    except (InputError, FormatError) as error:
        if not intrinsics or "calibration:" not in str(error):
            raise
        opened = open_source(place, terminal, intrinsics=intrinsics, verb="forge stream")
    if opened.is_live and frames is None:
        opened.stop()
        raise InputError(f"--frames: needed with {place}, which is live and has no end")
    return opened


def _first(opened: RgbdSource, most: int | None) -> list[RgbdFrame]:
    found = list(islice(opened, most))
    if not found:
        raise InputError(f"{opened.uri}: expected a frame, found none")
    return found


def _motion(
    pose: str, step_ns: float, frames: int | None, terminal: Terminal
) -> Sequence[RgbdFrame | Skeleton]:
    """Return the poses of a motion file or of another source at the pace of the person's frames."""
    from manip3d import forge

    if not pose.lower().endswith(".bvh"):
        with _open_bounded(pose, frames, terminal) as opened:
            most = forge.NUM_POSES if frames is None else frames
            poses = forge.recorded_poses(opened, num_frames=most)
        if not any(frame.skeletons for frame in poses):
            raise InputError(f"--pose: expected skeletons, got frames without in {pose}")
        return forge.at_pace(poses, step_ns)
    from manip3d.io import read_bvh
    from manip3d.modify import skeletons_from_motion

    return skeletons_from_motion(read_bvh(pose), rate=1e9 / step_ns if step_ns > 0 else 30.0)


def _check_type(kind: int, pose: str, method: Method, scope: Scope) -> None:
    if (kind == 2) != bool(pose):
        expected = "a motion for type 2" if kind == 2 else "none for type 1"
        raise InputError(f"--pose: expected {expected}, got {pose or 'none'}")
    for name, given, default in (("method", method, Method.lbs), ("scope", scope, Scope.limbs)):
        if kind == 1 and given != default:
            raise InputError(f"--{name}: can only be given with --type 2, got {given.value}")


@app.command("stream")
@over_files(
    kinds.written_recordings,
    whole=kinds.RECORDING,
    writable=kinds.written_recordings,
    check=lambda given: _check_type(*(given[n] for n in ("kind", "pose", "method", "scope"))),
)
def forge_stream(
    source: RgbdPlace,
    output: Output,
    kind: Annotated[
        int,
        typer.Option(
            "--type", min=1, max=2, help="Type 1: the person as recorded; 2: in other poses."
        ),
    ],
    pose: Annotated[
        str,
        typer.Option(
            metavar="MOTION",
            help="Poses for type 2: a .bvh file or any source with skeletons. Its first 9000 "
            "frames are played forwards and backwards at the recorded pace. A .bvh of "
            "capture export is level: for a tilted camera, give the recording itself.",
        ),
    ] = "",
    background: Annotated[
        str,
        typer.Option(
            metavar="SOURCE",
            help="Scene to put the person into; by default the one behind the person in SOURCE. "
            "Its first 300 frames are played forwards and backwards at the recorded pace.",
        ),
    ] = "",
    still: Annotated[
        bool, typer.Option("--still", help="Use the background's first frame only.")
    ] = False,
    method: Annotated[Method, typer.Option(help="Skinning method.")] = Method.lbs,
    scope: Annotated[
        Scope, typer.Option(help="Bones that follow the pose: those of the limbs, or all.")
    ] = Scope.limbs,
    move: Annotated[
        tuple[float, float, float],
        typer.Option(metavar="X Y Z", help="Displacement of the person, metres."),
    ] = (0.0, 0.0, 0.0),
    blend: Annotated[
        int, typer.Option(min=0, max=64, help="Pixels over which the person's edge fades.")
    ] = 1,
    intrinsics: FolderIntrinsics = "",
    frames: MostFrames = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Forge an RGB-D stream. The truth is written beside it, as OUT.truth.npz.

    With 'tum:FOLDER' as output, a sequence for programs that read the TUM RGB-D benchmark is
    written. If no frame has a forged pixel, the recording is kept and the exit code is 1.

    Example: manip3d forge stream "sim:body?frames=12" --type 1 --still -o insertion
    """
    _check_type(kind, pose, method, scope)
    check_recording_output(output, force=force)
    shell = Terminal(as_json=as_json, quiet=quiet)
    options = {"method": method.value, "scope": scope.value, "move": move, "blend": blend}
    record = forge_frames(
        source,
        output,
        shell,
        kind=kind,
        pose=pose,
        background=background,
        still=still,
        frames=frames,
        force=force,
        options=options,
        intrinsics=intrinsics,
    )
    shell.result(record)


class PeopleKind(StrEnum):
    """Kinds of recordings that ``forge people`` makes of a person."""

    real = "real"
    type1 = "type1"
    type2 = "type2"


@app.command("people")
def forge_people(
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", help="Folder to write; a run that was stopped continues in it."
        ),
    ],
    people: Annotated[int, typer.Option(min=1, max=6, help="Number of people.")] = 6,
    actions: Annotated[
        int,
        typer.Option(
            min=1,
            max=4,
            help="Number of actions, the first ones of: waving, raising the left arm, the right "
            "arm, both arms.",
        ),
    ] = 4,
    scenes: Annotated[
        int,
        typer.Option(
            min=1, max=3, help="Number of backgrounds, the first ones of: room, office, hall."
        ),
    ] = 3,
    kinds: Annotated[
        list[PeopleKind] | None,
        typer.Option(
            "--kind", help="Kind of recording; repeat the option for several. Default: all three."
        ),
    ] = None,
    frames: Annotated[int, typer.Option(min=1, help="Frames of each recording, 30 a second.")] = 60,
    still: Annotated[
        bool, typer.Option("--still", help="Use one still frame as the background of each forgery.")
    ] = False,
    no_color: Annotated[bool, typer.Option("--no-color", help="Write depth images only.")] = False,
    mkv: Annotated[
        bool, typer.Option("--mkv", help="Write .mkv files instead of folders.")
    ] = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Annotated[
        int, typer.Option("--jobs", "-j", min=0, help="Number of processes; 0: all cores.")
    ] = 0,
    seed: Seed = 0,
) -> None:
    """Forge the published set of people, with truth. It has six simulated people, four actions and
    three backgrounds.

    A run that was stopped continues when the same command is given again.

    Example: manip3d forge people -o streams --people 1 --actions 1 --scenes 1 --frames 3
    """
    from manip3d.simulate import write_forged_people

    shell = Terminal(as_json=as_json, quiet=quiet)
    with (
        shell.progress("forge") as progress,
        naming_options("output", kinds="kind"),
        ended_like_ctrl_c(),
    ):
        made = write_forged_people(
            output,
            people=people,
            actions=actions,
            scenes=scenes,
            kinds=[kind.value for kind in kinds or PeopleKind],
            frames=frames,
            still=still,
            color=not no_color,
            matroska=mkv,
            seed=seed,
            jobs=jobs,
            overwrite=force,
            progress=progress or shell.line,  # without a terminal, a line is printed for each
            on_error=lambda name, error: shell.say(f"error: {name}: {error}"),
        )
    resumed = f", {made.resumed} of them there already" if made.resumed else ""
    shell.say(f"wrote {counted(len(made.rows) - made.failed, 'stream')} to {output}{resumed}")
    shell.result(
        {
            "output": str(output),
            "streams": len(made.rows),
            "resumed": made.resumed,
            "failed": made.failed,
        }
    )
    if made.failed:
        raise typer.Exit(1)
