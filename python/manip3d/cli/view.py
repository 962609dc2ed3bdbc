"""``manip3d view``."""

from __future__ import annotations

from manip3d.cli import scanning, viewing
from manip3d.cli.kinds import expect_kind
from manip3d.cli.options import Force, OptionalOutput, Quiet, Source
from manip3d.cli.terminal import Terminal, check_output


def view(
    source: Source,
    output: OptionalOutput = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Show a mesh or scan in the browser, or write a page (.html) or a picture (.png).

    Example: manip3d view light.glb -o light.html
    """
    expect_kind(source, "mesh", "scan", "range grid", "drive", verb="view")
    check_output(output, (".html", ".png"), force=force)
    if scanning.is_scan(source):
        scanning.view(source, output, Terminal(quiet=quiet))
        return
    viewing.view(source, output, Terminal(quiet=quiet))
