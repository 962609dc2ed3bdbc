"""``manip3d capture``: list sources; record, play, export and describe RGB-D recordings."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import asdict
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from manip3d._util.extras import imported
from manip3d.cli import kinds
from manip3d.cli.kinds import expect_kind
from manip3d.cli.many import over_files
from manip3d.cli.options import (
    FolderIntrinsics,
    FolderRate,
    FolderUnits,
    Force,
    Json,
    MostFrames,
    Quiet,
    RgbdPlace,
)
from manip3d.cli.signals import ended_like_ctrl_c
from manip3d.cli.terminal import (
    Terminal,
    check_output,
    count,
    counted,
    left_out,
    naming_options,
    table,
    warn_of_left_out,
)
from manip3d.cli.triggers import trigger_of
from manip3d.errors import InputError
from manip3d.rgbd import RgbdFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from rich.console import Console

    from manip3d.camera import Intrinsics
    from manip3d.capture import ExportedJoints, Recording, RgbdSource

app = typer.Typer(
    name="capture",
    help="List, record, play and export RGB-D cameras and recordings.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

FirstFrame = Annotated[
    int, typer.Option("--start", min=0, help="Index of the first frame to read, from 0 on.")
]
_SHEET_FRAMES = 24  # largest number of frames on a contact sheet
_QUALITY = 90  # default quality of JPEG
_FLIPPED = "the images are flipped (mirrored camera)"


def listing() -> list[dict[str, Any]]:
    """Return a record of each kind of source, with ``reason`` and ``cure`` if it is unavailable."""
    from manip3d import capture

    return [asdict(scheme) for scheme in capture.sources()]


def show_listing(console: Console, records: list[dict[str, Any]]) -> None:
    """Print one line for each kind of source, and below it the cures of unavailable ones."""
    rows = [
        ("absent" if r["reason"] else "ok", f"{r['name']}:{r['location']}", r["description"])
        for r in records
    ]
    table(console, rows, ("state", "source", "frames of"))
    absent = [r for r in records if r["reason"]]
    if absent:
        console.print("\nAbsent")
        table(console, [(r["name"], r["reason"], r["cure"]) for r in absent])


def open_source(
    source: str,
    terminal: Terminal,
    *,
    intrinsics: str = "",
    units_per_metre: float = 0.0,
    rate: float | None = None,
    speed: float = 0.0,
    start: int = 0,
    verb: str = "capture",
) -> RgbdSource:
    """Open the RGB-D source at an address, file or folder, and print its size and length.

    It is also printed if its images are flipped, or if it has no times. ``rate``: that of
    ``--rate``, 0 if it is not given; None: the command has no such option. ``verb`` is the command
    in errors.

    Raises
    ------
    InputError
        The source cannot be opened.
    """
    from manip3d import capture

    if not Path(source).is_dir():
        expect_kind(source, "recording", verb=verb)
    folder = f"folder:{source}" if Path(source).is_dir() else source
    uri = capture.rgbd_address(source) or folder
    options: dict[str, Any] = {"speed": speed, "start": start}
    if intrinsics:
        options["camera"] = camera_of_images(intrinsics, uri)
    if units_per_metre:
        options["units_per_metre"] = units_per_metre
    if rate:
        options["rate"] = rate
    named = {"camera": "intrinsics", "uri": "SOURCE"}
    with naming_options("units-per-metre", "rate", "start", "speed", **named):
        opened = capture.open_rgbd(uri, **options)
    camera = opened.calibration.depth
    length = "" if opened.num_frames is None else f", {counted(opened.num_frames, 'frame')}"
    terminal.say(f"opened {uri}: {camera.width} x {camera.height} pixels{length}")
    if opened.flipped:
        terminal.say(_FLIPPED)
    if opened.assumed_rate:
        cure = "" if rate is None else "; --rate sets another rate"
        terminal.say(f"times: {_assumed(opened.assumed_rate)}{cure}")
    return opened


def _assumed(rate: float) -> str:
    return f"none in this folder, {rate:g} a second assumed"


def camera_of_images(text: str, uri: str) -> Intrinsics:
    """Read ``--intrinsics`` of a folder of images or a bag, for the size of its first image."""
    from manip3d.camera import read_intrinsics

    if uri.startswith("joints:"):
        from manip3d.capture import rgbd_address
        from manip3d.capture._joined_joints import source_and_file

        place = source_and_file(uri)[0]
        return camera_of_images(text, rgbd_address(place) or place)
    width, height = _size_of_images(uri)
    with naming_options("intrinsics"):
        return read_intrinsics(text, width=width, height=height)


def _size_of_images(uri: str) -> tuple[int, int]:
    """Return width and height of the first depth image in a bag or a folder."""
    scheme, _, folder = uri.partition(":")
    if scheme == "rgbd-bag":
        from manip3d.capture._bag import place_and_topic
        from manip3d.capture._bag_rgbd import depth_size

        bag, topic = place_and_topic(uri)
        return depth_size(Path(bag), topic)
    size = None
    if scheme in ("folder", "tum"):
        from manip3d.capture._first_image import first_depth_size

        size = first_depth_size(Path(folder), is_tum=scheme == "tum")
    if size is None:
        found = _suffixes_in(Path(folder) / "depth")
        others = f", where depth/ holds {found} and no PNG" if found else ""
        raise InputError(
            f"--intrinsics: expected a bag or a folder of depth images, got {uri}{others}"
        )
    return size


def _suffixes_in(folder: Path) -> str:
    if not folder.is_dir():
        return ""
    return ", ".join(sorted({path.suffix for path in folder.iterdir() if path.suffix}))


def check_recording_output(output: Path, *, force: bool) -> None:
    """Check ``-o`` of a recording, which may have a scheme: ``tum:walk``, ``mkv:a.mkv``.

    Raises
    ------
    InputError
        See `check_output`.
    """
    from manip3d.capture._rgbd_record import is_file_of_recording

    place = place_of_recording(output)
    is_tum = str(output).startswith("tum:")
    check_output(
        place,
        (".mkv",),
        force=force,
        folder=True,
        is_ours=lambda name: is_file_of_recording(place, name, is_tum=is_tum),
        in_place=True,
    )


def place_of_recording(output: Path) -> Path:
    """Return the path of a recording without its scheme."""
    scheme, _, place = str(output).partition(":")
    return Path(place) if scheme in ("folder", "mkv", "tum") and place else output


def write_recording(
    source: RgbdSource,
    output: Path,
    terminal: Terminal,
    *,
    frames: int | None,
    seconds: float | None,
    lossless_color: bool,
    jpeg_quality: int,
    trigger: str = "",
    before: float = 0.0,
    force: bool,
) -> dict[str, Any]:
    """Write a recording; after Ctrl-C it is complete.

    Raises
    ------
    InputError
        The source ended before the trigger, or it has no frame; a recording that was created is
        removed.
    """
    from manip3d import capture
    from manip3d.capture._rgbd_record import remove_recording

    place = place_of_recording(output)
    was_there = place.exists()
    with ExitStack() as opened:
        opened.enter_context(source)  # first, so that the source is closed on any error
        begins = None
        if trigger:
            begins, wanted = opened.enter_context(trigger_of(trigger))
            kept = f"; the last {before:g} s are kept" if before else ""
            terminal.say(f"waiting for {wanted}{kept}")
        opened.enter_context(naming_options("output", "seconds", "before", path="output"))
        progress = opened.enter_context(terminal.progress("record"))
        done = capture.record(
            source,
            output,
            frames=frames,
            seconds=seconds,
            lossless_color=lossless_color,
            jpeg_quality=jpeg_quality,
            trigger=begins,
            before=before,
            overwrite=force,
            progress=progress,
        )
    if trigger and not done.frames:
        if was_there:
            found = f"{output} is as it was"
        else:
            remove_recording(place)
            found = f"{output} was not written"
        raise InputError(
            f"--trigger {trigger}: the event did not occur before the source ended; {found}"
        )
    if not done.frames:
        found = f"{output} is as it was" if was_there else f"{output} was not written"
        if not was_there:
            remove_recording(place)
        raise InputError(f"{_without_frames(source, done.source_counters)}; {found}")
    _tell_of_recording(terminal, source, output, done)
    return {
        **asdict(done),
        "path": str(done.path),
        "source": source.uri,
        "flipped": list(source.flipped),
        "assumed_rate": source.assumed_rate,
    }


def _without_frames(source: RgbdSource, counters: Mapping[str, int]) -> str:
    """Return an error message about a source without a readable frame, with the reasons."""
    reasons = "".join(f"; {reason}" for reason in left_out(counters))
    return f"{source.uri}: expected a frame, found none{reasons}"


def _tell_of_recording(
    terminal: Terminal, source: RgbdSource, output: Path, done: Recording
) -> None:
    """Print what was recorded, and warn of what was left out."""
    told = "" if done.frames_with_skeleton else "; no frame of the source has a skeleton"
    terminal.say(f"wrote {output}: {counted(done.frames, 'frame')}, {done.seconds:.2f} s{told}")
    if str(output).startswith("tum:") and done.frames_with_skeleton:
        number = counted(done.frames_with_skeleton, "frame")
        terminal.warn(f"skeletons of {number} left out: a TUM sequence has no place for them")
    if done.counters.get("too_far"):
        number = counted(done.counters["too_far"], "pixel")
        terminal.warn(f"{number} left out: beyond 13.106 m, which a TUM sequence cannot hold")
    if source.flipped:
        terminal.say(
            f"{_FLIPPED}, also in the recording: add ?mirrored=yes to joints:{output}#FILE if "
            "FILE has pixels of the mirrored images"
        )
    warn_of_left_out(terminal, done.source_counters, source.errors)
    if "forged" in done.source_counters:
        forged, real = (done.source_counters[name] for name in ("forged", "real"))
        why = "" if forged else "; without a background, the first 30 frames of a source stay real"
        terminal.say(f"{count(forged)} of {counted(forged + real, 'frame')} forged{why}")


def play(
    source: RgbdSource,
    output: Path | None,
    terminal: Terminal,
    *,
    frames: int | None,
    force: bool,
    start: int = 0,
) -> dict[str, Any]:
    """Read all frames and measure their rate; write pictures of them to ``output``.

    A ``.png`` file is a contact sheet of up to 24 frames; a folder gets a picture of each frame.

    Raises
    ------
    InputError
        The recording has no frame that can be read.
    """
    from manip3d.capture._rgbd import RECORDINGS

    _refuse_folder_of(source, output)
    pictures = _Pictures(output, force=force)
    left = None if source.num_frames is None else source.num_frames - start
    total = min((n for n in (frames, left) if n), default=None)
    keep = _spread(total)
    shown = 0
    begin = time.perf_counter()
    with source, terminal.progress("play") as progress:
        for frame in islice(source._readable(), frames):
            shown += 1
            rate = shown / max(time.perf_counter() - begin, 1e-9)
            if progress is not None:
                progress(shown / total if total else 0.0, f"{rate:.1f} frames/s")
            pictures.add(frame, in_sheet=keep is None or shown - 1 in keep)
    took = time.perf_counter() - begin
    # A recording is live, too, if it is played in real time.
    if not shown and (source.has_known_end or source.uri.partition(":")[0] in RECORDINGS):
        pictures.leave()
        raise InputError(_without_frames(source, source._counted()))
    pictures.finish()
    warn_of_left_out(terminal, {}, source.errors)
    if output is not None:
        terminal.say(f"wrote {output}")
    return {
        "source": source.uri,
        "frames": shown,
        "seconds": took,
        "frames_per_second": shown / took if took > 0 else None,
        "counters": source._counted(),
    }


def _speed_of_play(output: Path | None) -> float:
    """Return the default of ``--speed``: pictures are of all frames, however long they take."""
    return 1.0 if output is None else 0.0


def show_play(console: Console, record: dict[str, Any]) -> None:
    """Print the number of frames, the time and the rate, and the source's counters."""
    rate = record["frames_per_second"] or 0.0
    console.print(
        f"{counted(record['frames'], 'frame')} in {record['seconds']:.2f} s, {rate:.1f} /s"
    )
    _show_counters(console, record["counters"])


def info(source: RgbdSource, terminal: Terminal) -> dict[str, Any]:
    """Return cameras, counts, times and gaps of a recording, or of 2 s of a live source."""
    from manip3d import capture

    with terminal.progress("read") as progress:
        found = capture.summarize(source, progress=progress).record()
    if not found["frames"] and source.has_known_end:
        raise InputError(_without_frames(source, found["counters"]))
    warn_of_left_out(terminal, {}, source.errors)
    return found


def show_info(console: Console, record: dict[str, Any]) -> None:
    """Print a line for each camera, then counts, depth range and times of the frames."""
    for name in ("depth", "colour"):
        camera = record[name]
        if camera is None:
            continue
        lens = "ray table" if camera["ray_table"] else f"distortion {camera['distortion']}"
        console.print(
            f"{name:8}{camera['width']} x {camera['height']}  "
            f"fx {camera['fx']:.6g}  fy {camera['fy']:.6g}  "
            f"cx {camera['cx']:.6g}  cy {camera['cy']:.6g}  {lens}"
        )
    with_ = ", ".join(f"{count(n)} with {name}" for name, n in record["with"].items())
    console.print(f"frames  {count(record['frames'])}: {with_}")
    if record["range"] is not None:
        console.print("range   {:.3f}..{:.3f} m".format(*record["range"]))
    if record["flipped"]:
        console.print(f"images  {_FLIPPED.removeprefix('the images are ')}")
    if record["assumed_rate"]:
        console.print(f"times   {_assumed(record['assumed_rate'])}")
    elif record["frames_per_second"] is not None:
        console.print(
            f"times   {record['seconds']:.3f} s, {record['frames_per_second']:.2f} frames/s, "
            f"longest gap {record['longest_gap']:.3f} s, "
            f"{count(record['missing_numbers'])} numbers missing"
        )
    _show_counters(console, record["counters"])


def _show_counters(console: Console, counters: dict[str, int]) -> None:
    told = [f"{name.replace('_', ' ')} {count(value)}" for name, value in counters.items() if value]
    if told:
        console.print("counted " + ", ".join(told))


# --- pictures -------------------------------------------------------------------------------------


def _spread(total: int | None) -> set[int] | None:
    """Return the indices of the frames of a sheet, spread evenly; None: use the first ones."""
    if total is None:
        return None
    wanted = min(total, _SHEET_FRAMES)
    return {int(i) for i in np.linspace(0, total - 1, wanted).round()}


class _Pictures:
    """Writer of a contact sheet or of a folder of pictures; without output it does nothing."""

    def __init__(self, output: Path | None, *, force: bool) -> None:
        self._output = output
        self._sheet: list[NDArray[np.uint8]] = []
        self._written = 0
        if output is None or output.suffix.lower() == ".png":
            return
        output.mkdir(exist_ok=force)

    def add(self, frame: RgbdFrame, *, in_sheet: bool) -> None:
        """Add a frame."""
        if self._output is None:
            return
        from manip3d import viewer

        if self._output.suffix:
            if in_sheet and len(self._sheet) < _SHEET_FRAMES:
                self._sheet.append(viewer.rgbd_picture(frame))
            return
        try:
            _write_png(self._output / f"{self._written:06}.png", viewer.rgbd_picture(frame))
        except OSError:
            self.leave()
            raise
        self._written += 1

    def leave(self) -> None:
        """Remove the folder if it is empty."""
        if self._output is not None and not self._output.suffix:
            with suppress(OSError):
                self._output.rmdir()

    def finish(self) -> None:
        """Write the sheet; in a folder, remove pictures with higher numbers from an earlier run."""
        if self._output is None:
            return
        if self._output.suffix:
            from manip3d import viewer

            if not self._sheet:
                raise InputError("source: expected a frame, found none")
            _write_png(self._output, viewer.sheet(self._sheet))
            return
        for old in self._output.iterdir():
            if _is_picture_of_play(old.name) and int(old.stem) >= self._written:
                old.unlink()


def _is_picture_of_play(name: str) -> bool:
    """Return whether `_Pictures` writes a picture of this name into its folder."""
    return bool(re.fullmatch(r"[0-9]{6}\.png", name))


def _refuse_folder_of(source: RgbdSource, output: Path | None) -> None:
    """Refuse an output inside the folder of the recording that is read."""
    folder = Path(source.uri.partition(":")[2].partition("?")[0])
    if output is None or not folder.is_dir():
        return
    if output.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"-o {output}: expected a place outside of the recording")


def _write_png(path: Path, image: NDArray[np.uint8]) -> None:
    from manip3d.io._files import atomic_path

    pillow = imported("PIL.Image", "io")
    with atomic_path(path) as temporary:
        pillow.fromarray(image).save(temporary)


@app.command("list")
def capture_list(as_json: Json = False) -> None:
    """List which sources can be opened here, and why others cannot.

    Example: manip3d capture list
    """
    records = listing()
    shell = Terminal(as_json=as_json)
    shell.result(records, lambda console: show_listing(console, records))


@app.command("record")
def capture_record(
    source: RgbdPlace,
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", help="A new folder, a file that ends in .mkv, or tum:FOLDER."
        ),
    ],
    frames: MostFrames = None,
    seconds: Annotated[
        float | None,
        typer.Option(help="Stop this many seconds after the first frame, or after the trigger."),
    ] = None,
    start: FirstFrame = 0,
    trigger: Annotated[
        str,
        typer.Option(
            metavar="EVENT", help="Begin at an event: key (Enter), person, SIGUSR1 or SIGUSR2."
        ),
    ] = "",
    before: Annotated[
        float,
        typer.Option(min=0, max=60, help="Also write this many seconds before the trigger."),
    ] = 0.0,
    lossless_color: Annotated[
        bool,
        typer.Option(
            "--lossless-color", help="Store colour exactly, not as JPEG; tum: always does."
        ),
    ] = False,
    quality: Annotated[
        int,
        typer.Option(min=1, max=100, help="Quality of JPEG, 1 to 100; without effect for tum:."),
    ] = _QUALITY,
    intrinsics: FolderIntrinsics = "",
    units_per_metre: FolderUnits = 0.0,
    rate: FolderRate = 0.0,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write frames of a camera or another source to a recording.

    Ctrl-C, SIGTERM or closing the terminal ends the recording: the file is then complete, the
    number of frames is printed, and the exit code is 130. With --trigger the recording begins at an
    event, and --before adds the seconds before the event. With 'tum:FOLDER' as output, a sequence
    for programs that read the TUM RGB-D benchmark is written.

    Example: manip3d capture record 'sim:body?motion=wave&frames=30' -o patient.mkv

    Example: manip3d capture record 'sim:body?frames=30' -o visit --before 5 --trigger person
    """
    check_recording_output(output, force=force)
    if before and not trigger:
        raise InputError("--before: can only be given with --trigger")
    if lossless_color and quality != _QUALITY:
        raise InputError("--quality: expected none with --lossless-color, which stores no JPEG")
    shell = Terminal(as_json=as_json, quiet=quiet)
    opened = open_source(
        source,
        shell,
        intrinsics=intrinsics,
        units_per_metre=units_per_metre,
        rate=rate,
        start=start,
    )
    with ended_like_ctrl_c():
        record = write_recording(
            opened,
            output,
            shell,
            frames=frames,
            seconds=seconds,
            lossless_color=lossless_color,
            jpeg_quality=quality,
            trigger=trigger,
            before=before,
            force=force,
        )
    shell.result(record)


@app.command("play")
def capture_play(
    source: RgbdPlace,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="A sheet of pictures (.png), or a new folder of pictures."
        ),
    ] = None,
    speed: Annotated[
        float | None,
        typer.Option(
            min=0,
            help="Playback speed; 0: as fast as read, 1: real time, which may leave out frames. "
            "Default: 0 with -o, else 1.",
        ),
    ] = None,
    frames: MostFrames = None,
    start: FirstFrame = 0,
    intrinsics: FolderIntrinsics = "",
    units_per_metre: FolderUnits = 0.0,
    rate: FolderRate = 0.0,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Read all frames and print their rate; with -o, draw each of them.

    Example: manip3d capture play patient.mkv -o frames.png
    """
    check_output(
        output, (".png",), force=force, folder=True, is_ours=_is_picture_of_play, in_place=True
    )
    shell = Terminal(as_json=as_json, quiet=quiet)
    opened = open_source(
        source,
        shell,
        intrinsics=intrinsics,
        units_per_metre=units_per_metre,
        rate=rate,
        speed=_speed_of_play(output) if speed is None else speed,
        start=start,
    )
    record = play(opened, output, shell, frames=frames, force=force, start=start)
    shell.result(record, lambda console: show_play(console, record))


@app.command("export")
@over_files(
    kinds.recording_suffixes,
    whole=kinds.RECORDING,
    writable=lambda: (".csv", ".bvh"),
    otherwise=".csv",
)
def capture_export(
    source: RgbdPlace,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="A table (.csv) or a motion (.bvh) of joints.")
    ],
    person: Annotated[
        int | None,
        typer.Option(
            help="Id of the person. By default a table has all people, and a motion the first one, "
            "who is followed under new ids, too."
        ),
    ] = None,
    frames: MostFrames = None,
    pose: Annotated[
        bool, typer.Option("--pose", help="Find the joints in the colour image with MediaPipe.")
    ] = False,
    intrinsics: FolderIntrinsics = "",
    units_per_metre: FolderUnits = 0.0,
    rate: FolderRate = 0.0,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write the joints of a recording for other programs.

    Example: manip3d capture export 'sim:body?motion=wave&frames=30' -o wave.bvh
    """
    from manip3d import capture

    check_output(output, (".csv", ".bvh"), force=force)
    shell = Terminal(as_json=as_json, quiet=quiet)
    place = open_source(
        source, shell, intrinsics=intrinsics, units_per_metre=units_per_metre, rate=rate
    )
    with place as opened, naming_options("output", "person"):
        done = capture.export_joints(
            opened, output, person=person, frames=frames, pose=pose, overwrite=force
        )
        counters = opened._counted()
    shell.say(f"wrote {output}: {counted(done.frames, 'skeleton')}")
    _warn_of_export(shell, done, has_chosen_person=person is not None)
    warn_of_left_out(shell, counters, opened.errors)
    shell.result({**asdict(done), "path": str(done.path), "source": opened.uri})


def _warn_of_export(terminal: Terminal, done: ExportedJoints, *, has_chosen_person: bool) -> None:
    """Warn of frames without the person, and of skeletons that the file lacks."""
    if done.held:
        frames = counted(done.held, "frame")
        terminal.warn(
            f"the person was not seen in {frames} (or they were dropped), and keeps the last pose"
        )
    if done.left_out:
        skeletons = counted(done.left_out, "skeleton")
        terminal.warn(
            f"left out {skeletons}, because an earlier skeleton already fills the nearest frame"
        )
    if len(done.ids) > done.people:
        ids = ", ".join(map(str, done.ids))
        terminal.warn(f"the person is followed under several ids ({ids}); --person writes one")
    if done.others and not has_chosen_person:
        by_id = ", ".join(f"id {other}: {count(seen)}" for other, seen in done.others.items())
        skeletons = counted(sum(done.others.values()), "skeleton")
        terminal.warn(
            f"left out {skeletons} of other people ({by_id}); --person writes one of them"
        )


@app.command("info")
@over_files(
    kinds.recording_suffixes,
    whole=kinds.RECORDING,
    columns=("source", "frames", "seconds", "frames_per_second", "longest_gap"),
)
def capture_info(
    source: RgbdPlace,
    intrinsics: FolderIntrinsics = "",
    units_per_metre: FolderUnits = 0.0,
    rate: FolderRate = 0.0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Print what a recording holds: cameras, frames, times, gaps. The recording is read to its end.

    Example: manip3d capture info patient.mkv
    """
    shell = Terminal(as_json=as_json, quiet=quiet)
    opened = open_source(
        source, shell, intrinsics=intrinsics, units_per_metre=units_per_metre, rate=rate
    )
    record = info(opened, shell)
    shell.result(record, lambda console: show_info(console, record))
