"""``manip3d info``."""

from __future__ import annotations

from manip3d.cli import capture, describing, kinds, scanning
from manip3d.cli.kinds import SHOWN, expect_kind
from manip3d.cli.many import over_files
from manip3d.cli.options import Calibration, DepthUnit, FolderIntrinsics, Json, Quiet, Source
from manip3d.cli.terminal import Terminal, naming_options


@over_files(
    kinds.shown_suffixes,
    whole=kinds.WHOLE,
    choose=kinds.own_sources,
    prepare=kinds.refuse_unused_by_all,
    columns=(
        "source", "faces", "vertices", "materials_used", "format", "points", "pixels", "measured",
        "frames", "seconds", "range",
    ),
)  # fmt: skip
def info(
    source: Source,
    calibration: Calibration = None,
    intrinsics: FolderIntrinsics = "",
    unit: DepthUnit = "guess",
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Print counts and properties of a mesh, a scan, a depth image or a recording.

    Recordings are LiDAR packets (.pcap, .osf), ROS bags (.mcap), drives in KITTI's layout, RGB-D
    frames (.mkv, folders) and what 'capture list' names. If a recording has several sensors or
    topics, add # and the one to read: drive.pcap#1, drive.bag#/top. Several files make a table,
    which is printed, or written with --table.

    Example: manip3d info scan.bin
    """
    from manip3d.simplify._depth_inputs import unit_to_read
    from manip3d.viewer import kind_of

    with naming_options("unit", "intrinsics"):
        narrow = kinds.narrow_depth(source, unit, intrinsics)
    expect_kind(source, *SHOWN, *narrow, verb="info")
    shell = Terminal(as_json=as_json, quiet=quiet)
    if not shell.is_collecting:  # the option may apply to another one of several files
        given = {"intrinsics": intrinsics, "unit": unit, "calibration": calibration}
        kinds.refuse_unused([source], given)
    scanning.expect_packets(source, calibration)
    kind = "mesh" if source == "-" else kind_of(source)
    if kind == "rgbd":
        opened = capture.open_source(source, shell, intrinsics=intrinsics)
        told = capture.info(opened, shell)
        shell.result(told, lambda console: capture.show_info(console, told))
    elif kind == "scan":
        found, damage = scanning.summary(source, shell, calibration)
        shell.result(found, lambda console: scanning.show(console, found))
        if damage is not None:
            raise damage
    elif kind == "depth":
        with naming_options("unit", "intrinsics"):
            image = describing.depth_summary(source, unit_to_read(unit, intrinsics))
        shell.result(image, lambda console: describing.show_depth(console, image))
    else:
        record = describing.summary(source, shell)
        shell.result(record, lambda console: describing.show(console, record))
