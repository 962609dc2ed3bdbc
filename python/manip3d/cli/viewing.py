"""``manip3d view``: the browser, an interactive page, or a picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manip3d.cli.sources import open_mesh
from manip3d.cli.terminal import Terminal, count
from manip3d.errors import InputError

if TYPE_CHECKING:
    from manip3d.camera import Intrinsics


@dataclass(frozen=True)
class Choice:
    """What the options of ``view`` say about the source, and how it is coloured."""

    frame: int | None = None
    intrinsics: str = ""
    units_per_metre: float | None = None
    colour: Path | None = None
    calibration: Path | None = None
    colour_by: str | None = None


def view(source: str, output: Path | None, choice: Choice, terminal: Terminal) -> None:
    """Show what the user names, or write what the suffix of ``output`` tells."""
    from manip3d import viewer

    if output is not None and output.suffix.lower() not in (".html", ".png"):
        raise InputError(f"--output: expected a name that ends in .html or .png, got {output}")
    thing = _open(source, choice, terminal)
    options: dict[str, Any] = {"color_by": choice.colour_by}
    if output is None or output.suffix.lower() == ".html":
        options["title"] = "stdin" if source == "-" else Path(source).name
    path = viewer.view(thing, output, **options)
    if output is not None:
        terminal.say(f"wrote {output}")
    elif not viewer.has_display():
        print(path)  # a result: somebody may open it elsewhere
        terminal.say("There is no display here: open this page in a browser.")


def _open(source: str, choice: Choice, terminal: Terminal) -> Any:
    from manip3d import viewer

    kind = "mesh" if source == "-" else viewer.kind_of(source)
    if kind == "mesh":
        if choice.frame:
            raise InputError(f"--frame: expected none for a mesh, got {choice.frame}")
        return open_mesh(source, terminal)
    opened = viewer.open_thing(
        source,
        frame=choice.frame,
        intrinsics=_camera(source, choice) if choice.intrinsics else None,
        units_per_metre=choice.units_per_metre,
        color=choice.colour,
        calibration=choice.calibration,
    )
    note = f", {opened.note}" if opened.note else ""
    terminal.say(f"read {source} ({opened.kind}{note}): {_size(opened.thing)}")
    return opened.thing


def _size(thing: Any) -> str:
    from manip3d.lidar import LidarFrame

    if isinstance(thing, LidarFrame):
        return f"{count(thing.num_points)} points"
    height, width = thing.depth.shape
    return f"{width} x {height} pixels"


def _camera(source: str, choice: Choice) -> Intrinsics:
    """``--intrinsics`` of a depth image, or of the images of a folder."""
    from manip3d import viewer
    from manip3d.cli import capturing, reducing
    from manip3d.io import read_depth

    uri = viewer.rgbd_address(source)
    if uri is not None:
        return capturing.camera_of_folder(choice.intrinsics, uri)
    return reducing.camera(choice.intrinsics, *read_depth(source).shape)
