"""``manip3d view``: show a source in the browser, or write an interactive page or a picture."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from manip3d.cli import kinds
from manip3d.cli.kinds import SHOWN, expect_kind
from manip3d.cli.many import over_files
from manip3d.cli.options import Calibration, DepthUnit, Force, OptionalOutput, Quiet, Source
from manip3d.cli.scanning import expect_packets
from manip3d.cli.sources import open_mesh
from manip3d.cli.terminal import Terminal, check_output, counted, naming_options, say_page
from manip3d.errors import InputError
from manip3d.io import is_url
from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from manip3d.camera import Intrinsics


SUFFIXES = (".html", ".png")


@dataclass(frozen=True)
class Choice:
    """Options that apply to the source, and not to the output."""

    frame: int | None
    intrinsics: str
    unit: str
    color: Path | None
    calibration: Path | None


_OPTIONS = ("frame", "unit", "color", "color-by")
MAX_BESIDE = 9  # largest number of sources on one page; more get a page each in a folder


def _refuse_unused(sources: Sequence[str], given: Mapping[str, Any]) -> None:
    """Refuse an option that would have no effect on any of the sources."""
    from manip3d import capture

    kinds.refuse_unused(sources, given)
    files = [source for source in sources if source == "-" or Path(source).is_file()]
    if len(files) == len(sources) and not any(
        source != "-" and capture.scan_address(source) for source in sources
    ):
        expect_packets(sources[0], given["calibration"])


def _side_by_side(sources: list[str], given: dict[str, Any]) -> bool:
    """Show several explicitly named files on one page or picture; return whether this was done."""
    from manip3d import viewer
    from manip3d.batch import is_pattern

    if len(sources) == 1:
        _refuse_unused(sources, given)
    output = given["output"]
    one_place = output is None or (Path(output).suffix.lower() in SUFFIXES and not is_url(output))
    named = all(source != "-" and not is_pattern(source) for source in sources)
    if not 1 < len(sources) <= MAX_BESIDE or not one_place or not named or given["shared"]:
        return False
    if any(is_url(source) or kinds.kind_of(source) == "folder" for source in sources):
        return False
    if output is not None and Path(output).is_dir():
        return False  # each source gets a page in that folder
    check_output(output, SUFFIXES, force=given["force"])
    terminal = Terminal(quiet=given["quiet"])
    calibration = given["calibration"]
    choice = Choice(given["frame"], given["intrinsics"], given["unit"], given["color"], calibration)
    for source in sources:
        narrow = kinds.narrow_depth(source, choice.unit, choice.intrinsics)
        expect_kind(source, *SHOWN, *narrow, verb="view")
    _refuse_unused(sources, given)
    with naming_options(*_OPTIONS):
        things = [_open(source, choice, terminal) for source in sources]
    names = [Path(source).name for source in sources]
    labels = names if len(set(names)) == len(names) else list(sources)
    options: dict[str, Any] = {"color_by": given["color_by"], "labels": labels}
    if output is None or Path(output).suffix.lower() == ".html":
        options["title"] = ", ".join(labels)
    with naming_options(*_OPTIONS):
        say_page(viewer.view(things, output, **options), output, terminal)
    return True


@over_files(
    kinds.shown_suffixes,
    whole=kinds.WHOLE,
    choose=kinds.own_sources,
    writable=lambda: SUFFIXES,
    otherwise=".html",
    prepare=kinds.refuse_unused_by_all,
    together=_side_by_side,
    depends=lambda given: os.environ.get("MANIP3D_RENDERER", ""),  # pictures differ in pixels
)
def view(
    source: Source,
    output: OptionalOutput = None,
    frame: Annotated[
        int | None,
        typer.Option(
            min=0, help="Index of the scan or frame of a recording; default: the first whole one."
        ),
    ] = None,
    color_by: Annotated[
        str | None,
        typer.Option(
            help="Colour points by height, intensity, ring, depth, colour, person or another "
            "column of the source."
        ),
    ] = None,
    intrinsics: Annotated[
        str,
        typer.Option(
            help="Camera of a depth image, as for 'manip3d depth'; without it a camera is assumed."
        ),
    ] = "",
    unit: DepthUnit = "guess",
    color: Annotated[
        Path | None, typer.Option(help="Colour image of a depth image, of the same size.")
    ] = None,
    calibration: Calibration = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Show a mesh, a scan, a depth image or a frame of a recording.

    Opens the browser, or writes a page (.html) or a picture (.png). Scans and depth images are
    shown as points; the first view of a depth image is that of its camera. Several files are shown
    side by side, or with a folder as --output as a page each.

    Example: manip3d view scan.bin -o scan.html
    """
    check_output(output, SUFFIXES, force=force)
    expect_kind(source, *SHOWN, *kinds.narrow_depth(source, unit, intrinsics), verb="view")
    terminal = Terminal(quiet=quiet)
    choice = Choice(frame, intrinsics, unit, color, calibration)
    with naming_options(*_OPTIONS):
        write(_open(source, choice, terminal), source, output, color_by, terminal)


def write(
    thing: Any, source: str, output: Path | None, color_by: str | None, terminal: Terminal
) -> None:
    """Show an object in the browser, or write it in the format of ``output``'s suffix."""
    from manip3d import viewer

    options: dict[str, Any] = {"color_by": color_by}
    if output is None or output.suffix.lower() == ".html":
        options["title"] = "stdin" if source == "-" else Path(source).name
    say_page(viewer.view(thing, output, **options), output, terminal)


def _open(source: str, choice: Choice, terminal: Terminal) -> Any:
    from manip3d import viewer
    from manip3d.simplify._depth_inputs import unit_to_read
    from manip3d.viewer.opening import options_of

    kind = "mesh" if source == "-" else viewer.kind_of(source)
    if kind == "mesh":
        if choice.frame:
            raise InputError(f"--frame: expected none for a mesh, got {choice.frame}")
        return open_mesh(source, terminal, may_be_empty=True)
    # The others apply to other sources of the same command; a wrong frame is an error of any.
    known = options_of(source, kind) | {"frame"}
    has_camera = "intrinsics" in known and choice.intrinsics
    options: dict[str, Any] = {
        "frame": choice.frame,
        "intrinsics": _camera(source, choice) if has_camera else None,
        "unit": unit_to_read(choice.unit, choice.intrinsics),
        "color": choice.color,
        "calibration": choice.calibration,
    }
    opened = viewer.open_thing(source, **{n: v for n, v in options.items() if n in known})
    note = f", {opened.note}" if opened.note else ""
    terminal.say(f"read {source} ({opened.kind}{note}): {_size(opened.thing)}")
    return opened.thing


def _size(thing: Any) -> str:
    if isinstance(thing, LidarFrame):
        return counted(thing.num_points, "point")
    height, width = thing.depth.shape
    return f"{width} x {height} pixels"


def _camera(source: str, choice: Choice) -> Intrinsics:
    """Read ``--intrinsics`` for a depth image, or for the images of a folder."""
    from manip3d.camera import read_intrinsics
    from manip3d.capture import rgbd_address
    from manip3d.cli import capture
    from manip3d.io import read_depth_guessing
    from manip3d.simplify._depth_inputs import unit_to_read

    uri = rgbd_address(source)
    if uri is not None:
        return capture.camera_of_images(choice.intrinsics, uri)
    unit = unit_to_read(choice.unit, choice.intrinsics)
    height, width = read_depth_guessing(source, unit=unit).depth.shape
    with naming_options("intrinsics"):
        return read_intrinsics(choice.intrinsics, width=width, height=height)
