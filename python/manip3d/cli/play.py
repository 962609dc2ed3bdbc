"""``manip3d play``: show a sequence of meshes on one page with a time bar."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Annotated

import typer

from manip3d.cli.kinds import expect_kind
from manip3d.cli.options import Force, OptionalOutput, Quiet
from manip3d.cli.sources import open_mesh
from manip3d.cli.terminal import (
    Terminal,
    check_output,
    counted,
    expect_named,
    naming_options,
    say_page,
)
from manip3d.io import READABLE


def play(
    source: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE...", help="The frames: meshes, folders of meshes, or patterns."
        ),
    ],
    output: OptionalOutput = None,
    rate: Annotated[float, typer.Option(min=0.01, max=1000.0, help="Frames per second.")] = 10.0,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Play a sequence of meshes on one page, with a time bar.

    The frames are in the order of their names, which 'manip3d depth' gives to the meshes of a
    folder of depth images. Opens the browser, or writes the page (.html), which is self-contained.

    Example: manip3d play frames/ -o film.html --rate 30
    """
    from manip3d import viewer
    from manip3d.batch import find_files

    expect_named("source", *source)
    check_output(output, (".html",), force=force)
    terminal = Terminal(quiet=quiet)
    files = [file.name for file in find_files(source, suffixes=READABLE)]
    for name in files:
        expect_kind(name, "mesh", verb="play")
    with terminal.progress("read") as progress:
        meshes = []
        for done, name in enumerate(files):
            meshes.append(open_mesh(name, Terminal(quiet=True), may_be_empty=True))
            if progress is not None:
                progress((done + 1) / len(files), PurePosixPath(name).name)
    title = PurePosixPath(source[0]).name
    labels = [PurePosixPath(name).name for name in files]
    with naming_options("rate"):
        path = viewer.play(meshes, output, rate=rate, title=title, labels=labels)
    terminal.say(counted(len(files), "frame"))
    say_page(path, output, terminal)
