"""``manip3d demo``: run the demo and open its page."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from manip3d.cli.data import expect_data_folder
from manip3d.cli.options import Processes, Quiet, Seed, Tier
from manip3d.cli.reproduce import refuse_foreign_folder, say_what_was_done
from manip3d.cli.signals import ended_like_ctrl_c
from manip3d.cli.terminal import Terminal

if TYPE_CHECKING:
    from manip3d.report.demo import Demo


def demo(
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="Folder of the results and of the page."),
    ] = Path("demo"),
    data: Annotated[
        Tier, typer.Option(help="Data to use; auto: recorded data if MANIP3D_DATA has them.")
    ] = Tier.auto,
    quiet: Quiet = False,
    jobs: Processes = 0,
    seed: Seed = 0,
) -> None:
    """Show what manip3d does, on one page with pictures.

    The page has stories with pictures and the commands that made them, followed by tables, and is
    opened in the browser. No data and no network are needed. A demo that was stopped continues when
    the same command is given again.

    Example: manip3d demo -o demo
    """
    from manip3d._util.extras import require

    require("demo")
    expect_data_folder(data)
    shell = Terminal(quiet=quiet)
    done = tell(output, data=data.value, seed=seed, jobs=jobs, terminal=shell)
    open_page(done.page, shell)
    if done.summary.failed or done.summary.problems:
        raise typer.Exit(1)


def tell(folder: Path, *, data: Any, seed: int, jobs: int, terminal: Terminal) -> Demo:
    """Run the demo in a new folder or in that of an earlier demo, and print the page's path."""
    from manip3d.report.demo import run_demo

    refuse_foreign_folder(folder, force=None)
    terminal.say("five stories, then the tables; about two minutes on two cores")
    try:
        with terminal.progress("demo") as bar, ended_like_ctrl_c():
            done = run_demo(folder, data=data, seed=seed, jobs=jobs, progress=bar or terminal.line)
    except KeyboardInterrupt:
        kept = f"finished parts are in {folder}, and " if any(folder.glob("*")) else ""
        terminal.say(f"interrupted; {kept}the same command continues")
        raise
    say_what_was_done(done.summary, terminal)
    terminal.say(f"page: {done.page.resolve()}")
    return done


def open_page(path: Path, terminal: Terminal) -> None:
    """Open the page in a browser, if there is a display."""
    import webbrowser

    if terminal.quiet or not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return
    if not webbrowser.open(path.resolve().as_uri()):
        terminal.say("no browser found to open it with")
