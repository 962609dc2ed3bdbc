"""The command ``manip3d``: its verbs and their options. What they do is in `manip3d.cli`.

Heavy modules are imported by the verb that needs them, so that ``manip3d --help`` is quick.
"""

from __future__ import annotations

import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, NoReturn

import typer

MISSED = 4
"""Exit code: target missed, or undecidable, under ``--strict``."""

app = typer.Typer(
    name="manip3d",
    help="Make 3D content lighter, change it, and tell whether somebody else changed it.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
data_app = typer.Typer(
    help="Public data sets: what is here, and fetching more.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
app.add_typer(data_app, name="data")
forge_app = typer.Typer(
    help="Forged scans with their truth, for testing detectors.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
app.add_typer(forge_app, name="forge")
phantom_app = typer.Typer(
    help="A limb that is missing, made of the one that is there.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
app.add_typer(phantom_app, name="phantom")

capture_app = typer.Typer(
    help="RGB-D cameras and recordings: list, record, play, info.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
app.add_typer(capture_app, name="capture")

Source = Annotated[
    str,
    typer.Argument(
        metavar="SOURCE",
        help="A mesh, a scan, a depth image or a recording; - reads a mesh from stdin.",
    ),
]
Output = Annotated[
    Path, typer.Option("-o", "--output", help="Where to; the suffix tells the kind.")
]
OptionalOutput = Annotated[
    Path | None, typer.Option("-o", "--output", help="Where to; the suffix tells the kind.")
]
Calibration = Annotated[
    Path | None,
    typer.Option(help="Of an HDL-64E, for recordings of its packets: db.xml or YAML."),
]
RgbdPlace = Annotated[
    str,
    typer.Argument(
        metavar="SOURCE", help="A recording, a folder of images, or as 'capture list' says."
    ),
]
RgbdIntrinsics = Annotated[
    str,
    typer.Option(
        "--intrinsics",
        help="Of a folder of images: fx,fy,cx,cy, FILE.json, kinect-v1, kinect-v2, primesense.",
    ),
]
RgbdUnits = Annotated[
    float,
    typer.Option("--units-per-metre", min=0, help="Of a folder of images; 0: as its kind has it."),
]
DepthUnits = Annotated[
    float | None,
    typer.Option(
        "--units-per-metre",
        help="Of whole-number depth images: 1000, or 5000 for TUM and ICL-NUIM.",
    ),
]
MostFrames = Annotated[int | None, typer.Option("--frames", min=1, help="Stop after so many.")]
Json = Annotated[bool, typer.Option("--json", help="The result as JSON on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No messages, no progress.")]
Jobs = Annotated[
    int,
    typer.Option("--jobs", "-j", min=0, help="Threads; processes for folders. 0: all cores."),
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of every random choice.")]
Force = Annotated[bool, typer.Option("--force", help="Replace existing outputs.")]
Strict = Annotated[bool, typer.Option("--strict", help="Exit 4 when a target is missed.")]


class Method(StrEnum):
    """The five methods of chapter 2."""

    qem4vr = "qem4vr"
    qem_orig = "qem-orig"
    qem_bp = "qem-bp"
    qem_tp = "qem-tp"
    qem_btp = "qem-btp"


class DepthMethod(StrEnum):
    """The methods of chapter 3, and manip3d's own."""

    cs3 = "cs3"
    relief = "relief"
    uniform = "uniform"
    poisson = "poisson"
    ssa = "ssa"


class Variant(StrEnum):
    """The four variants of CS3: importance (L or C), then sampling."""

    cios = "cios"
    lios = "lios"
    cnms = "cnms"
    lnms = "lnms"


class LidarAttack(StrEnum):
    """What ``forge lidar`` does to a scan."""

    ctp = "ctp"
    crtp = "crtp"
    insert = "insert"
    subtract = "subtract"
    deform = "deform"
    dent = "dent"
    translation = "translation"
    rotation = "rotation"
    replacement = "replacement"


class LimbName(StrEnum):
    """The person's own left and right."""

    left_arm = "left-arm"
    right_arm = "right-arm"
    left_leg = "left-leg"
    right_leg = "right-leg"


class Mirroring(StrEnum):
    """At the person's plane of symmetry, as printed, or in the image."""

    reflection = "reflection"
    paper = "paper"
    image = "2d"


class Segmenting(StrEnum):
    """By the nearest skin, or by the nearest bone as printed."""

    skin = "skin"
    paper = "paper"


class Smoothing(StrEnum):
    """Presets of the filter of joints."""

    default = "default"
    seated = "seated"
    none = "none"


class Unit(StrEnum):
    """Units of length of a file's coordinates."""

    m = "m"
    cm = "cm"
    mm = "mm"
    inch = "in"
    ft = "ft"


class Up(StrEnum):
    """The axis that points up in a file."""

    y = "y"
    z = "z"


class Tier(StrEnum):
    """Which data experiments use."""

    auto = "auto"
    real = "real"
    simulated = "simulated"


class Scale(StrEnum):
    """How much experiments do."""

    quick = "quick"
    full = "full"


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        from manip3d import __version__

        print(f"manip3d {__version__}")
        raise typer.Exit


@app.command()
def simplify(
    source: Annotated[str, typer.Argument(help="A mesh file, a folder of them, or - for stdin.")],
    output: Output,
    faces: Annotated[int | None, typer.Option(min=1, help="Stop at this many faces.")] = None,
    ratio: Annotated[
        float | None, typer.Option(help="Stop at this fraction of the faces as read.")
    ] = None,
    max_error: Annotated[
        float | None, typer.Option(help="Largest error of a collapse, in the file's units.")
    ] = None,
    method: Annotated[Method, typer.Option(help="How.")] = Method.qem4vr,
    no_clean: Annotated[bool, typer.Option("--no-clean", help="Do not clean first.")] = False,
    force: Force = False,
    strict: Strict = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
    seed: Seed = 0,
) -> None:
    """Reduce the faces of a mesh; cleans it first. The first target reached stops.

    A folder is simplified mesh by mesh into another folder, in parallel processes.
    """
    from manip3d.cli import simplifying, terminal

    shell = terminal.Terminal(as_json=as_json, quiet=quiet)
    order = simplifying.Order(method.value, faces, ratio, max_error, not no_clean, {})
    if Path(source).is_dir():
        records = simplifying.simplify_folder(
            Path(source), output, order, shell, jobs=jobs, force=force
        )
        shell.result(records)
        simplifying.fail_if_any(records)
    else:
        terminal.refuse_existing(output, force=force)
        with shell.progress("simplify") as progress:
            records = [simplifying.simplify_file(source, output, order, shell, progress)]
        shell.result(records[0])
        if records[0]["stop"] == "refused":
            raise typer.Exit(MISSED if strict else 1)
    if strict and any(record["target_missed"] for record in records):
        raise typer.Exit(MISSED)


@app.command()
def cs3(
    source: Annotated[
        str, typer.Argument(help="A depth image, a scan (PLY range_grid), or a folder of frames.")
    ],
    output: Output,
    points: Annotated[int, typer.Option(min=1, help="At most so many vertices.")],
    intrinsics: Annotated[
        str,
        typer.Option(help="fx,fy,cx,cy, FILE.json, kinect-v1, kinect-v2 or primesense."),
    ] = "",
    method: Annotated[DepthMethod, typer.Option(help="How.")] = DepthMethod.cs3,
    variant: Annotated[Variant, typer.Option(help="Of --method cs3.")] = Variant.cios,
    units_per_metre: Annotated[
        float, typer.Option(help="Of whole-number images: 1000, or 5000 for TUM and ICL-NUIM.")
    ] = 1000.0,
    max_edge: Annotated[
        float | None, typer.Option(help="Leave out triangles with a longer edge: for scenes.")
    ] = None,
    by_distance: Annotated[
        bool, typer.Option("--by-distance", help="More points where it is near (--method cs3).")
    ] = False,
    move_points: Annotated[
        bool, typer.Option("--move-points", help="Points may leave the input (--method relief).")
    ] = False,
    colour: Annotated[
        str, typer.Option(help="Colour image of the same size; for a folder, a folder of them.")
    ] = "",
    frames: Annotated[
        str, typer.Option(metavar="PATTERN", help="Which files of a folder are depth images.")
    ] = "*",
    force: Force = False,
    strict: Strict = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
    seed: Seed = 0,
) -> None:
    """Turn a depth image or a range scan into a sparse textured mesh.

    A folder becomes a folder of .glb files, in parallel processes; run again, it goes on where it
    stopped. Depth images become metres, in glTF with +y up, else in the camera's axes.
    """
    from manip3d.cli import reducing, terminal

    shell = terminal.Terminal(as_json=as_json, quiet=quiet)
    order = reducing.Order(
        points,
        method.value,
        variant.value,
        intrinsics,
        units_per_metre,
        max_edge,
        by_distance,
        move_points,
        colour,
        seed,
        threads=jobs,
    )
    if Path(source).is_dir():
        records = reducing.reduce_folder(
            Path(source), output, order, frames, shell, jobs=jobs, force=force
        )
        shell.result(records)
        reducing.fail_if_any(records)
    else:
        terminal.refuse_existing(output, force=force)
        records = [reducing.reduce_file(Path(source), output, order, shell)]
        shell.result(records[0])
    if strict and any(record["target_missed"] for record in records):
        raise typer.Exit(MISSED)


@app.command()
def compare(
    original: Annotated[str, typer.Argument(help="The original mesh.")],
    simplified: Annotated[str, typer.Argument(help="The mesh that is compared with it.")],
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
    seed: Seed = 0,
) -> None:
    """Measure how far a mesh is from the original: Metro, texture error, FMPD, boundary gap."""
    from manip3d.cli import comparing, terminal

    shell = terminal.Terminal(as_json=as_json, quiet=quiet)
    record = comparing.compare(original, simplified, shell, threads=jobs, seed=seed)
    shell.result(record, lambda console: comparing.show(console, record))


@app.command()
def info(
    source: Source,
    calibration: Calibration = None,
    units_per_metre: DepthUnits = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Count what a mesh, a scan, a depth image or a recording is made of.

    Recordings are LiDAR packets (.pcap), drives in KITTI's layout, RGB-D frames (.mkv, folders) and
    what 'capture list' names.
    """
    from manip3d.cli import capturing, describing, scanning, terminal
    from manip3d.viewer import kind_of

    shell = terminal.Terminal(as_json=as_json, quiet=quiet)
    kind = "mesh" if source == "-" else kind_of(source)
    if kind == "rgbd":
        opened = capturing.open_source(source, shell)
        told = capturing.info(opened, shell)
        shell.result(told, lambda console: capturing.show_info(console, told))
    elif kind == "scan":
        found = scanning.summary(source, shell, calibration)
        shell.result(found, lambda console: scanning.show(console, found))
    elif kind == "depth":
        image = describing.depth_summary(source, units_per_metre)
        shell.result(image, lambda console: describing.show_depth(console, image))
    else:
        record = describing.summary(source, shell)
        shell.result(record, lambda console: describing.show(console, record))


@app.command()
def view(
    source: Source,
    output: OptionalOutput = None,
    frame: Annotated[
        int | None,
        typer.Option(
            min=0, help="Scan or frame of a recording, from 0 on; default: the first whole one."
        ),
    ] = None,
    colour_by: Annotated[
        str | None,
        typer.Option(
            "--colour-by", help="Column of points: height, intensity, ring, depth, colour, person."
        ),
    ] = None,
    intrinsics: Annotated[
        str,
        typer.Option(
            help="Camera of a depth image, as for 'manip3d cs3'; without it one is assumed."
        ),
    ] = "",
    units_per_metre: DepthUnits = None,
    colour: Annotated[
        Path | None, typer.Option(help="Colour image of a depth image, of the same size.")
    ] = None,
    calibration: Calibration = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Show a mesh, a scan, a depth image or a frame of a recording.

    Opens the browser, or writes a page (.html) or a picture (.png). Scans and depth images are
    shown as points; a depth image is first seen as its camera saw it.
    """
    from manip3d.cli import terminal, viewing

    terminal.refuse_existing(output, force=force)
    choice = viewing.Choice(frame, intrinsics, units_per_metre, colour, calibration, colour_by)
    viewing.view(source, output, choice, terminal.Terminal(quiet=quiet))


@app.command()
def convert(
    source: Source,
    output: Output,
    unit: Annotated[
        Unit | None, typer.Option(help="Unit of the input; the output is in metres.")
    ] = None,
    up: Annotated[
        Up | None, typer.Option(help="Axis that is up in the input; the output has +y up.")
    ] = None,
    calibration: Calibration = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Write a mesh or a scan in another format. Coordinates change only with --unit or --up.

    Recordings of LiDAR packets (.pcap) become a folder of scans in KITTI's layout.
    """
    from manip3d.cli import converting, scanning, terminal
    from manip3d.viewer import kind_of

    terminal.refuse_existing(output, force=force)
    if source != "-" and kind_of(source) == "scan":
        if unit is not None or up is not None:
            raise typer.BadParameter("--unit and --up are for meshes: scans know their units")
        scanning.convert(source, output, terminal.Terminal(quiet=quiet), calibration)
        return
    converting.convert(
        source,
        output,
        unit=unit.value if unit else None,
        up=up.value if up else None,
        terminal=terminal.Terminal(quiet=quiet),
    )


@app.command()
def simulate(
    source: Annotated[
        str, typer.Argument(metavar="SOURCE", help="sim:street, sim:indoor-00, sim:outdoor-26 ...")
    ],
    output: Output,
    frames: Annotated[int, typer.Option(min=1, help="Of a street: turns of the LiDAR.")] = 10,
    resolution: Annotated[
        float, typer.Option(help="Of a scene: degrees between neighbouring rays.")
    ] = 0.06,
    no_pictures: Annotated[
        bool, typer.Option("--no-pictures", help="Of a street: LiDAR only.")
    ] = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
    seed: Seed = 0,
) -> None:
    """Make LiDAR data with truth: a drive in KITTI's layout, or a terrestrial scan.

    Another seed is another street; of a scene it is other noise.
    """
    from manip3d.cli import simulating, terminal

    terminal.refuse_existing(output, force=force)
    shell = terminal.Terminal(as_json=as_json, quiet=quiet)
    record = simulating.simulate(
        source,
        output,
        shell,
        frames=frames,
        resolution=resolution,
        pictures=not no_pictures,
        force=force,
        threads=jobs,
        seed=seed,
    )
    shell.result(record)


@app.command()
def inspect(
    source: Annotated[str, typer.Argument(metavar="SCAN", help="A scan file.")],
    output: OptionalOutput = None,
    origin: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="X Y Z", help="Where the scanner stood; else as the file says, or its grid."
        ),
    ] = None,
    printed: Annotated[
        bool, typer.Option("--printed", help="Thresholds as printed, not the calibrated ones.")
    ] = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
) -> None:
    """Say whether a scan was edited: exit code 0 authentic, 3 tampered, 4 undecidable.

    With -o, the evidence: a page (.html) with pictures and boxes, or .json.
    """
    from manip3d.cli import inspecting, terminal

    terminal.refuse_existing(output, force=force)
    shell = terminal.Terminal(as_json=as_json, quiet=quiet)
    record = inspecting.inspect(source, output, shell, origin=origin, printed=printed, threads=jobs)
    shell.result(record, lambda console: inspecting.show(console, record))
    raise typer.Exit(inspecting.EXIT_CODES[record["verdict"]])


@forge_app.command("lidar")
def forge_lidar(
    attack: Annotated[LidarAttack, typer.Argument(help="What is done to the scan.")],
    source: Annotated[str, typer.Argument(metavar="SCAN", help="A scan file.")],
    output: Output,
    hoax: Annotated[str | None, typer.Option(help="Mesh or scan file to paste.")] = None,
    position: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="X Y Z", help="Where its centroid goes, metres."),
    ] = None,
    box: Annotated[
        tuple[float, float, float, float, float, float, float] | None,
        typer.Option(
            metavar="X Y Z L W H YAW", help="Centre, size, turn; else the nearest object's."
        ),
    ] = None,
    scale: Annotated[float, typer.Option(help="Of the hoax's units to metres.")] = 1.0,
    yaw: Annotated[float, typer.Option(help="Turn about the vertical, radians.")] = 0.0,
    amplitude: Annotated[float, typer.Option(help="Of a deformation, metres.")] = 0.1,
    distance: Annotated[float, typer.Option(help="Of a translation, metres.")] = 3.0,
    range_noise: Annotated[float, typer.Option(help="Of inserted points, metres.")] = 0.0,
    printed: Annotated[
        bool, typer.Option("--printed", help="CTP's translation as printed.")
    ] = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
    seed: Seed = 0,
) -> None:
    """Forge a LiDAR scan; the truth goes beside it, as OUT.truth.json."""
    from manip3d.cli import forging, terminal

    terminal.refuse_existing(output, force=force)
    shell = terminal.Terminal(as_json=as_json, quiet=quiet)
    order = forging.Order(
        hoax,
        position,
        box,
        scale,
        yaw,
        amplitude,
        distance,
        range_noise,
        printed,
        seed,
        jobs,
    )
    record = forging.forge_scan(attack.value, source, output, order, shell, force=force)
    shell.result(record)


@app.command()
def demo(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder.")] = Path("demo"),
    scale: Annotated[Scale, typer.Option(help="quick: a minute; full: some more.")] = Scale.quick,
    data: Annotated[Tier, typer.Option(help="Which data.")] = Tier.auto,
    quiet: Quiet = False,
    jobs: Jobs = 0,
    seed: Seed = 0,
) -> None:
    """Run experiments on meshes and depth images and open their report; needs no data."""
    from manip3d.cli import reproducing, terminal

    shell = terminal.Terminal(quiet=quiet)
    plan = {"data": data.value, "scale": scale.value, "seed": seed}
    reproducing.reproduce(
        reproducing.demo_ids(), output, plan, shell, jobs=jobs, dask="", force=False
    )
    reproducing.open_report(reproducing.write_report(output, None, shell), shell)


@app.command()
def doctor(as_json: Json = False) -> None:
    """Say what is here, what is missing, why, and the cure."""
    from manip3d.cli import doctoring, terminal

    checks = doctoring.examine()
    shell = terminal.Terminal(as_json=as_json)
    shell.result(checks, lambda console: doctoring.show(console, checks))
    if any(check["state"] == "broken" for check in checks):
        raise typer.Exit(1)


@app.command()
def reproduce(
    ids: Annotated[list[str] | None, typer.Argument(help="table-2.2 ...; none: all.")] = None,
    list_only: Annotated[bool, typer.Option("--list", help="List the experiments.")] = False,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder.")] = Path("results"),
    data: Annotated[Tier, typer.Option(help="auto: real data where it is here.")] = Tier.auto,
    scale: Annotated[Scale, typer.Option(help="quick: a minute; full: minutes.")] = Scale.full,
    dask: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Dask scheduler to use; 'local' starts one.")
    ] = "",
    force: Force = False,
    strict: Annotated[bool, typer.Option("--strict", help="Exit 4 when a claim fails.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
    seed: Seed = 0,
) -> None:
    """Run the experiments behind published tables and figures; an interrupted run resumes."""
    from manip3d.cli import reproducing, terminal

    shell = terminal.Terminal(as_json=as_json, quiet=quiet)
    if list_only:
        records = reproducing.listing(ids or [])
        shell.result(records, lambda console: reproducing.show_listing(console, records))
        return
    plan = {"data": data.value, "scale": scale.value, "seed": seed}
    summary = reproducing.reproduce(
        ids or [], output, plan, shell, jobs=jobs, dask=dask, force=force
    )
    shell.result(reproducing.digest(summary), lambda console: reproducing.show(console, summary))
    if summary.failed:
        raise typer.Exit(1)
    if strict and reproducing.some_claim_fails(summary):
        raise typer.Exit(MISSED)


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(help="A results folder of 'reproduce'.")],
    output: OptionalOutput = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Turn a results folder into one page: .html (default), .md or .csv."""
    from manip3d.cli import reproducing, terminal

    terminal.refuse_existing(output, force=force)
    reproducing.write_report(folder, output, terminal.Terminal(quiet=quiet))


@capture_app.command("list")
def capture_list(as_json: Json = False) -> None:
    """List what can be opened here, and why the rest cannot."""
    from manip3d.cli import capturing, terminal

    records = capturing.listing()
    shell = terminal.Terminal(as_json=as_json)
    shell.result(records, lambda console: capturing.show_listing(console, records))


@capture_app.command("record")
def capture_record(
    source: RgbdPlace,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="A new folder, or a file that ends in .mkv.")
    ],
    frames: MostFrames = None,
    seconds: Annotated[
        float | None, typer.Option(help="Stop so long after the first frame.")
    ] = None,
    lossless_colour: Annotated[
        bool, typer.Option("--lossless-colour", help="Colour exactly, not as JPEG.")
    ] = False,
    quality: Annotated[int, typer.Option(min=1, max=100, help="Of JPEG.")] = 90,
    intrinsics: RgbdIntrinsics = "",
    units_per_metre: RgbdUnits = 0.0,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write frames to a recording. Ctrl-C ends it; what was written is whole."""
    from manip3d.cli import capturing, terminal

    terminal.refuse_existing(output, force=force)
    shell = terminal.Terminal(as_json=as_json, quiet=quiet)
    opened = capturing.open_source(
        source, shell, intrinsics=intrinsics, units_per_metre=units_per_metre
    )
    record = capturing.record(
        opened,
        output,
        shell,
        frames=frames,
        seconds=seconds,
        lossless_colour=lossless_colour,
        jpeg_quality=quality,
        force=force,
    )
    shell.result(record)


@capture_app.command("play")
def capture_play(
    source: RgbdPlace,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="A sheet of pictures (.png), or a folder of them."),
    ] = None,
    speed: Annotated[
        float, typer.Option(min=0, help="1: by the frames' times; 0: as fast as they are read.")
    ] = 1.0,
    frames: MostFrames = None,
    intrinsics: RgbdIntrinsics = "",
    units_per_metre: RgbdUnits = 0.0,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Read frame after frame and say how fast they come; pictures with -o."""
    from manip3d.cli import capturing, terminal

    terminal.refuse_existing(output, force=force)
    shell = terminal.Terminal(as_json=as_json, quiet=quiet)
    opened = capturing.open_source(
        source, shell, intrinsics=intrinsics, units_per_metre=units_per_metre, speed=speed
    )
    record = capturing.play(opened, output, shell, frames=frames, force=force)
    shell.result(record, lambda console: capturing.show_play(console, record))


@capture_app.command("info")
def capture_info(
    source: RgbdPlace,
    intrinsics: RgbdIntrinsics = "",
    units_per_metre: RgbdUnits = 0.0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Say what a recording holds: cameras, frames, times, gaps; reads it to the end."""
    from manip3d.cli import capturing, terminal

    shell = terminal.Terminal(as_json=as_json, quiet=quiet)
    opened = capturing.open_source(
        source, shell, intrinsics=intrinsics, units_per_metre=units_per_metre
    )
    record = capturing.info(opened, shell)
    shell.result(record, lambda console: capturing.show_info(console, record))


@phantom_app.command("render")
def phantom_render(
    source: Annotated[
        str,
        typer.Argument(metavar="SOURCE", help="sim:body?amputated=right-arm, mkv:FILE, ..."),
    ],
    output: Output,
    limb: Annotated[
        LimbName | None,
        typer.Option(help="To replace; else the simulated person's, or the right arm."),
    ] = None,
    mode: Annotated[Mirroring, typer.Option(help="How to mirror.")] = Mirroring.reflection,
    segmentation: Annotated[
        Segmenting, typer.Option(help="Of the person among its bones.")
    ] = Segmenting.skin,
    smoothing: Annotated[Smoothing, typer.Option(help="Of the joints.")] = Smoothing.default,
    azimuth: Annotated[float, typer.Option(help="Of the mesh's view, degrees.")] = 35.0,
    frames: Annotated[int, typer.Option(min=0, help="At most so many; 0: all.")] = 0,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
) -> None:
    """Draw people with a phantom limb: what was seen, the phantom, the mesh from the side.

    OUT.mp4 is a film; a name without a suffix is a folder of PNG pictures.
    """
    from manip3d.cli import rendering, terminal

    terminal.refuse_existing(output, force=force)
    shell = terminal.Terminal(as_json=as_json, quiet=quiet)
    record = rendering.render(
        source,
        output,
        shell,
        limb=limb.value if limb else None,
        mode=mode.value,
        segmentation=segmentation.value,
        smoothing=smoothing.value,
        azimuth=azimuth,
        frames=frames,
        force=force,
        threads=jobs,
    )
    shell.result(record)


@data_app.command("list")
def data_list(as_json: Json = False) -> None:
    """List the data sets: which are here, which are missing."""
    from manip3d.cli import data, terminal

    records = data.listing()
    shell = terminal.Terminal(as_json=as_json)
    shell.result(records, lambda console: data.show(console, records))


@data_app.command("get")
def data_get(
    names: Annotated[list[str], typer.Argument(help="Data sets, as 'data list' names them.")],
    quiet: Quiet = False,
) -> None:
    """Fetch data sets from their official homes; shows each licence first."""
    from manip3d.cli import data, terminal

    data.get(names, terminal.Terminal(quiet=quiet))


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run the command line; ends the process with its exit code."""
    from manip3d.errors import Error

    try:
        _start_logging(sys.argv[1:] if arguments is None else arguments)
        app(arguments, prog_name="manip3d")
    except KeyboardInterrupt:
        sys.exit(130)
    except (Error, OSError) as error:
        _fail(error, _one_line(error))
    except MemoryError as error:
        _fail(error, "out of memory")
    except Exception as error:  # a bug of ours: say so in one line too
        _fail(error, f"internal error: {type(error).__name__}: {error} (MANIP3D_LOG=debug: where)")
    sys.exit(0)


def _start_logging(arguments: list[str]) -> None:
    if os.environ.get("MANIP3D_LOG"):
        from manip3d.cli.terminal import configure_logging

        configure_logging(quiet="--quiet" in arguments or "-q" in arguments)


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def _fail(error: BaseException, message: str) -> NoReturn:
    """One clear line on stderr; the traceback only for ``MANIP3D_LOG=debug``."""
    if os.environ.get("MANIP3D_LOG", "").lower() == "debug":
        import traceback

        traceback.print_exception(error)
    print("manip3d: error: " + " ".join(message.split()), file=sys.stderr)
    sys.exit(1)
