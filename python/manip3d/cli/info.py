"""``manip3d info``."""

from __future__ import annotations

from manip3d.cli import capture, describing, scanning
from manip3d.cli.kinds import expect_kind
from manip3d.cli.options import Calibration, Json, Quiet, Source
from manip3d.cli.terminal import Terminal


def info(
    source: Source,
    calibration: Calibration = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Count what a mesh, a scan or a recording (LiDAR packets, RGB-D) is made of.

    Example: manip3d info head.obj
    """
    expect_kind(source, "mesh", "scan", "range grid", "packets", "recording", "drive", verb="info")
    shell = Terminal(as_json=as_json, quiet=quiet)
    if capture.is_recording(source):
        opened = capture.open_source(source, shell)
        told = capture.info(opened, shell)
        shell.result(told, lambda console: capture.show_info(console, told))
        return
    if scanning.is_scan(source):
        found = scanning.summary(source, shell, calibration)
        shell.result(found, lambda console: scanning.show(console, found))
        return
    record = describing.summary(source, shell)
    shell.result(record, lambda console: describing.show(console, record))
