"""``manip3d view``: the browser, an interactive page, or a picture."""

from __future__ import annotations

from pathlib import Path

from manip3d.cli.sources import open_mesh
from manip3d.cli.terminal import Terminal


def view(source: str, output: Path | None, terminal: Terminal) -> None:
    """Show the mesh, or write what the suffix of ``output`` names."""
    from manip3d import viewer

    viewer.view(open_mesh(source, terminal), output)
    if output is not None:
        terminal.say(f"wrote {output}")
