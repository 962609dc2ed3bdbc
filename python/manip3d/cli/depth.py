"""``manip3d depth`` and ``manip3d cs3``: depth images and range scans to sparse textured meshes."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from manip3d.cli.kinds import expect_kind, is_picture, kind_of, narrow_depth, path_in
from manip3d.cli.many import SKIPPED, over_files, with_defaults
from manip3d.cli.options import (
    MISSED,
    FolderJobs,
    Force,
    Json,
    Output,
    Quiet,
    Seed,
    Strict,
)
from manip3d.cli.terminal import (
    Terminal,
    check_output,
    count,
    counted,
    named_as_options,
    naming_options,
)
from manip3d.errors import FormatError, InputError
from manip3d.io import DEPTH_SUFFIXES, WRITABLE
from manip3d.io._scan_tables import scan_suffix

if TYPE_CHECKING:
    from manip3d.batch import SourceFile
    from manip3d.simplify import (
        DepthFileResult,
        DepthOptions,
        DepthSequence,
        JointFileResult,
        RecordingResult,
    )

_sequence: ContextVar[DepthSequence | None] = ContextVar("sequence", default=None)
"""Sequence through which the files of a command with ``--stable`` go."""


class DepthMethod(StrEnum):
    """Relief is manip3d's own; the others are those of chapter 3."""

    relief = "relief"
    cs3 = "cs3"
    uniform = "uniform"
    poisson = "poisson"
    ssa = "ssa"


class Effort(StrEnum):
    """Amount of work that relief does."""

    live = "live"
    fast = "fast"
    balanced = "balanced"
    fine = "fine"
    best = "best"


class Variant(StrEnum):
    """The four variants of CS3: importance (L or C), then sampling."""

    cios = "cios"
    lios = "lios"
    cnms = "cnms"
    lnms = "lnms"


_SCANS = (".ply", ".pcd")
_OPTIONS = ("intrinsics", "unit", "variant", "effort", "by-distance", "move-points", "max-edge",
            "depth-step", "color", "mask", "confidence", "confidence-max", "points", "ratio",
            "method", "min-coverage", "max-bridges", "bandwidth", "rate", "stable",
            "ray-depth")  # fmt: skip


def _frame_options(files: list[SourceFile], options: dict[str, Any]) -> dict[str, dict[str, str]]:
    """One unit for all depth images, and the colour image, mask and confidence of each frame."""
    from manip3d import simplify
    from manip3d.simplify._depth_inputs import may_have_8_bits
    from manip3d.simplify._depth_sets import common_guess

    with naming_options("unit", "intrinsics"):
        may_be_8_bits = may_have_8_bits(options["unit"], options["intrinsics"])
    maps = _maps_in_folders(files)
    names = [f.name for f in files if not is_picture(f.name, may_be_8_bits) and f.name not in maps]
    clouds = {name for name in names if _is_cloud(name)}
    if not clouds:
        _expect_camera(names, options["intrinsics"])
    each: dict[str, dict[str, str]] = {file.name: {"color": ""} for file in files}
    each |= {name: {SKIPPED: "a mask or confidences"} for name in maps}
    with naming_options("color", "mask", "confidence", "unit"):
        for name in clouds:  # the unit of another instrument; each cloud keeps its own guess
            each[name]["unit"] = options["unit"]
        images = [name for name in names if name not in clouds]
        options["unit"] = common_guess(images, options["unit"], options["intrinsics"])
        colors = options.pop("color")
        folders = {"color": colors} if colors else {}
        for name in ("mask", "confidence"):  # a file is that of all frames
            if options[name] and Path(options[name]).is_dir():
                folders[name] = options.pop(name)
        for name, folder in folders.items():
            for frame, image in simplify.colors_of_frames(names, folder, name=name).items():
                each[frame][name] = image
    return each


def _maps_in_folders(files: list[SourceFile]) -> set[str]:
    """Return the names of masks and confidences that lie beside depth images in folders."""
    from manip3d.simplify._depth_sets import maps_by_name

    maps = maps_by_name([file.name for file in files])
    return {file.name for file in files if file.name in maps and not file.is_named}


def _sentence_of_all(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return words on the depths and meshes of all images, as nobody reads those of each."""
    made = [row for row in rows if row.get("coverage") is not None]
    return "\n".join(words for words in (_depths_of_all(rows), _meshes_of_all(made)) if words)


def _meshes_of_all(rows: Sequence[Mapping[str, Any]]) -> str:
    if not rows:
        return ""
    bridges = {row["source"]: row["bridges"] - row["filled"] for row in rows}
    worst = min(rows, key=lambda row: row["coverage"])
    most = max(bridges, key=lambda name: bridges[name])
    words = (
        f"{counted(len(rows), 'mesh', 'meshes')}: {worst['source']} covers least of its surface's "
        f"pixels, {100 * worst['coverage']:.1f} %; {100 * bridges[most]:.2f} % of the area of "
        f"{most} bridges gaps, the largest share"
    )
    for name, missed in _MISSED:
        if number := sum(bool(row[name]) for row in rows):
            words += f"; {count(number)} {missed}"
    return words


_MISSED = (
    ("target_missed", "missed the target of points"),
    ("coverage_missed", "covered less than --min-coverage of the measured pixels"),
    ("bridges_missed", "had more bridges than --max-bridges"),
)
"""Columns of shortfalls, and words on the number of meshes that have them."""


def _depths_of_all(rows: Sequence[Mapping[str, Any]]) -> str:
    from manip3d.simplify._depth_words import DepthFound, sentence_of_images, size_warning

    found = [
        DepthFound(
            row["unit"],
            row["unit_guessed"],
            row["unit_doubt"] or "",
            row["depth_near"],
            row["depth_far"],
            row["marked_pixels"],
            row.get("size") or "",
            row.get("camera") or "",
        )
        for row in rows
        if row.get("unit")
    ]
    override = "; --unit overrides it" if any(each.is_guess for each in found) else ""
    return f"read {sentence_of_images(found)}{size_warning(found)}{override}" if found else ""


def _expect_camera(names: list[str], intrinsics: str) -> None:
    """Raise InputError if no camera of depth images is given."""
    from manip3d.simplify._depth_inputs import expect_camera

    if names:
        with naming_options("intrinsics"):
            expect_camera(intrinsics, Path(names[0]))


def _is_cloud(name: str) -> bool:
    from manip3d.io import is_url
    from manip3d.simplify._organised import is_cloud_file

    try:
        return scan_suffix(name) in _SCANS or (not is_url(name) and is_cloud_file(Path(name)))
    except (OSError, FormatError):  # the frame's own turn reports it
        return False


_BUDGETS = ("points", "ratio", "bandwidth", "rate")


def _expect_budget(
    *budgets: object, wanted: str = "--points or --ratio, or --bandwidth with --rate"
) -> None:
    if all(budget is None for budget in budgets):
        raise typer.BadParameter(f"give {wanted}", param_hint="--points")


def _options_of(given: Mapping[str, Any]) -> DepthOptions:
    """Options of a command that goes through its files in one process; jobs are threads."""
    from manip3d.simplify import DepthOptions

    names = ("points", "intrinsics", "unit", "max_edge", "depth_step", "by_distance", "move_points",
             "seed", "min_coverage", "bandwidth", "rate", "max_bridges", "ratio",
             "ray_depth")  # fmt: skip
    return DepthOptions(
        method=given["method"].value,
        variant=given["variant"].value,
        effort=given["effort"].value,
        threads=given["jobs"],
        **{name: given[name] for name in names},
    )


@contextmanager
def _through(sequence: DepthSequence) -> Iterator[None]:
    token = _sequence.set(sequence)
    try:
        yield
    finally:
        _sequence.reset(token)


def _in_order(given: Mapping[str, Any]) -> AbstractContextManager[None] | None:
    """With ``--stable``, return a context in which each mesh depends on those before; else None."""
    if not given["stable"]:
        return None
    from manip3d.simplify import DepthSequence

    with naming_options(*_OPTIONS, "dask"):
        if "dask" in given["shared"]:
            raise InputError("dask: cannot be given with stable, which reads the files in order")
        return _through(DepthSequence(_options_of(given)))


_NOT_JOINED = ("mask", "confidence", "confidence_max", "bandwidth", "rate", "by_distance",
               "move_points", "stable")  # fmt: skip


def _join(sources: list[str], given: dict[str, Any]) -> bool:
    """With ``--poses``, write one mesh of all files and return True; else return False."""
    if not given["poses"]:
        return False
    from manip3d import simplify
    from manip3d.batch import find_files
    from manip3d.simplify._depth_inputs import may_have_8_bits

    _expect_budget(given["points"], given["ratio"], wanted="--points or --ratio")
    output: Path = given["output"]
    shell = Terminal(as_json=given["as_json"], quiet=given["quiet"])
    if len(sources) == 1 and not given["intrinsics"]:
        given = {**given, "intrinsics": _camera_in(Path(sources[0]))}
    with naming_options(*_OPTIONS, "poses", *given["shared"]):
        refused = [*given["shared"], *(name for name in _NOT_JOINED if given[name])]
        if refused:
            raise InputError(f"{refused[0]}: cannot be given with poses")
        check_output(output, WRITABLE, force=given["force"])
        found = find_files(sources, suffixes=(*DEPTH_SUFFIXES, *_SCANS))
        may_be_8_bits = may_have_8_bits(given["unit"], given["intrinsics"])
        maps = _maps_in_folders(found)
        others = [f for f in found if f.name not in maps]
        pictures = [f for f in others if is_picture(f.name, may_be_8_bits)]
        for file in pictures:
            if file.is_named or len(pictures) == len(others):
                expect_kind(file.name, "depth", "range grid", verb="depth")
        files = [file.name for file in others if file not in pictures]
        if pictures:
            shell.say(f"{counted(len(pictures), 'file')} skipped, of another kind (picture)")
        if maps:
            words = "(mask or confidences)"
            shell.say(f"{counted(len(maps), 'file')} skipped, of another kind {words}")
        colors = simplify.colors_of_frames(files, given["color"]) if given["color"] else {}
        options = _options_of(given)
        with shell.progress("join") as progress:
            result = simplify.simplify_camera_files(
                files,
                given["poses"],
                output,
                options,
                colors=[colors[f] for f in files if colors],
                num_frames=given["frames"],
                progress=progress,
            )
    if result.depth:
        override = "; --unit overrides it" if result.unit_guessed else ""
        shell.say(f"read {named_as_options(result.depth, _OPTIONS)}{override}")
    shell.say(_joint_sentence(result))
    _warn_if_sparse(shell, result)
    shell.result(_joint_record(result))
    missed = result.target_missed or result.coverage_missed or result.bridges_missed
    if given["strict"] and missed:
        raise typer.Exit(MISSED)
    return True


_NOT_FOR_RECORDINGS = ("unit", "ray_depth", "color", "mask", "confidence", "confidence_max",
                       "bandwidth", "rate")  # fmt: skip
"""Options that are refused for a recording, because its frames state them."""


def _recording(sources: list[str], given: dict[str, Any]) -> bool:
    """Write a mesh of each frame of an RGB-D recording and return True; else return False."""
    if len(sources) != 1 or not _is_recording(sources[0], given["intrinsics"]):
        if given["frames"] is not None:
            raise InputError("--frames: can only be given with an RGB-D recording or --poses")
        return False
    from manip3d import simplify
    from manip3d.cli.capture import open_source

    _expect_budget(given["points"], given["ratio"], wanted="--points or --ratio")
    output: Path = given["output"]
    shell = Terminal(as_json=given["as_json"], quiet=given["quiet"])
    images = _images_alone(sources[0])
    with naming_options(*_OPTIONS, *given["shared"]):
        _refuse_for_recordings(images, given)
        check_output(output, (), force=given["force"], folder=True)
        if given["stable"] and given["method"] != DepthMethod.relief:
            raise InputError(f"stable: expected method relief, got {given['method']}")
        depth = _depth_of_images(images, given)
        per_metre = 0.0 if depth is None else depth.units_per_metre(images[0].parent)
        options = _options_of({**given, "intrinsics": "", "unit": "guess"})
    if depth is not None:
        shell.say(depth.sentence)
    with (
        open_source(
            sources[0], shell, intrinsics=given["intrinsics"], units_per_metre=per_metre
        ) as frames,
        shell.progress("simplify") as progress,
    ):
        made = simplify.simplify_recording(
            frames,
            output,
            options,
            stable=given["stable"],
            num_frames=given["frames"],
            replace=given["force"],
            progress=progress,
        )
    shell.say(_recording_sentence(made, output))
    failed = {str(n): named_as_options(reason, _OPTIONS) for n, reason in made.failed.items()}
    unit = {} if depth is None else {"unit": depth.unit, "unit_guessed": depth.is_guess}
    shell.result({"output": str(output), **unit, "frames": [_record(r) for r in made.frames],
                  "failed": failed})  # fmt: skip
    missed = any(r.target_missed or r.coverage_missed or r.bridges_missed for r in made.frames)
    if given["strict"] and (missed or failed):
        raise typer.Exit(MISSED)
    return True


def _refuse_for_recordings(images: Sequence[Path], given: Mapping[str, Any]) -> None:
    """Raise InputError if an option does not go with a recording, or with a folder of images."""
    asked = [
        name
        for name in _NOT_FOR_RECORDINGS
        if given[name] is not False
        and given[name] not in (None, "", "guess")
        and not (images and name == "unit")
    ]
    if refused := [*given["shared"], *asked]:
        taker = f"; {images[0].parent}, its depth images alone, takes it" if images else ""
        raise InputError(f"{refused[0]}: cannot be given with an RGB-D recording{taker}")


def _images_alone(source: str) -> list[Path]:
    """Return the depth images of a folder in which no recording's file states their unit."""
    from manip3d.capture._first_image import depth_images_of

    folder = Path(source.removeprefix("folder:"))
    if any((folder / name).exists() for name in (*_CAMERA_FILES, "frames.jsonl")):
        return []
    return depth_images_of(folder)


class _DepthOfImages(NamedTuple):
    """Unit of a folder's depth images, and a sentence on it for people to check."""

    unit: str
    is_guess: bool
    sentence: str

    def units_per_metre(self, images: Path) -> float:
        """Return the number of units in a metre, which the frames of a folder need.

        Raises
        ------
        InputError
            The unit is no multiple of a depth.
        """
        from manip3d.io._depth_units import units_per_metre

        number = units_per_metre(self.unit)
        if number is None:
            unit = f"{self.unit}, which was guessed" if self.is_guess else self.unit
            raise InputError(
                f"unit: expected a number of units per metre for the frames of a recording, got "
                f"{unit}; {images}, its depth images alone, may have it"
            )
        return number


def _depth_of_images(images: Sequence[Path], given: Mapping[str, Any]) -> _DepthOfImages | None:
    """Return the unit that was given, that the camera states, or that most images look like.

    None: there are no images that can be read, or no camera.
    """
    from manip3d.simplify._depth_sets import depths_of_some
    from manip3d.simplify._depth_words import sentence_of_images

    camera = given["intrinsics"] or (_camera_in(images[0].parents[1]) if images else "")
    if not images or not camera:
        return None
    found = depths_of_some(images, _options_of({**given, "intrinsics": camera}))
    if not found:
        return None
    is_guess = any(each.is_guess for each in found)
    override = "; --unit overrides it" if is_guess else ""
    return _DepthOfImages(found[0].unit, is_guess, f"read {sentence_of_images(found)}{override}")


def _camera_in(folder: Path) -> str:
    """Return the name of the file by which another tool states a folder's camera, or nothing."""
    from manip3d.capture._folder_camera import camera_file_of

    return str(camera_file_of(folder) or "")


_CAMERA_FILES = ("calibration.json", "depth.txt", "metadata.yaml")
"""Files of recordings that know their camera; the last is that of a ROS 2 bag."""


def _is_recording(source: str, intrinsics: str) -> bool:
    """Return whether a source is a recording whose camera is known, also by ``--intrinsics``."""
    from manip3d.capture._first_image import depth_images_of
    from manip3d.capture._folder_camera import camera_file_of
    from manip3d.io import is_url

    if source == "-" or is_url(source):
        return False
    try:
        kind = kind_of(source)
    except OSError:  # a pattern, or a file that is missed later on
        return False
    if kind != "stream":
        path = path_in(source)
        knows_camera = any((path / name).is_file() for name in _CAMERA_FILES)
        if not knows_camera and depth_images_of(path):
            knows_camera = bool(intrinsics) or camera_file_of(path) is not None
        return kind == "recording" and (knows_camera or path.is_file())
    from manip3d.capture import rgbd_address

    return rgbd_address(source) is not None


def _recording_sentence(made: RecordingResult, output: Path) -> str:
    worst = min(made.frames, key=lambda result: result.coverage)
    points = [result.points for result in made.frames]
    few = f"{count(min(points))} to {count(max(points))} points"
    seconds = sum(result.seconds for result in made.frames) / len(made.frames)
    failed = f"; {counted(len(made.failed), 'frame')} without a surface" if made.failed else ""
    return (
        f"{worst.options.method}: {counted(len(made.frames), 'frame')}, {few}, "
        f"{seconds * 1000:.1f} ms a frame; frame {worst.source} covers least of its surface's "
        f"pixels, {100 * worst.coverage:.1f} %{failed}; wrote {output}"
    )


def _joint_sentence(result: JointFileResult) -> str:
    options = result.options
    low = f", less than {100 * options.min_coverage:.4g} %" if result.coverage_missed else ""
    many = f", more than {100 * options.max_bridges:.4g} %" if result.bridges_missed else ""
    few = f"; target of {counted(options.points or 0, 'point')} missed"
    return (
        f"{options.method}: {counted(result.points_before, 'point')} of "
        f"{counted(len(result.sources), 'view')} -> {count(result.points)}, "
        f"{counted(result.faces, 'face')} in {result.seconds * 1000:.1f} ms; covers "
        f"{100 * result.coverage:.1f} % of the measured pixels{low}{_without_ray(result)}, "
        f"{100 * result.bridges:.2f} % of its area bridges gaps{many}"
        f"{few if result.target_missed else ''}; wrote {result.output}"
    )


def _joint_record(result: JointFileResult) -> dict[str, Any]:
    return {
        "inputs": [str(source) for source in result.sources],
        "output": str(result.output),
        "method": result.options.method,
        "effort": _effort_of(result.options),
        "depth": result.depth,
        "unit": result.unit,
        "unit_guessed": result.unit_guessed,
        "points_before": result.points_before,
        "target_points": result.options.points,
        "points": result.points,
        "faces": result.faces,
        "seconds": round(result.seconds, 4),
        "coverage": round(result.coverage, 6),
        "bridges": round(result.bridges, 6),
        "lone_pixels": result.lone_pixels,
        "without_ray": result.without_ray,
        "target_missed": result.target_missed,
        "coverage_missed": result.coverage_missed,
        "bridges_missed": result.bridges_missed,
    }


@over_files(
    lambda: (*DEPTH_SUFFIXES, *_SCANS), writable=lambda: WRITABLE, otherwise=".glb",
    prepare=_frame_options, check=lambda given: _expect_budget(*(given[name] for name in _BUDGETS)),
    together=lambda sources, given: _join(sources, given) or _recording(sources, given),
    in_order=_in_order, sentence=_sentence_of_all, may_be_frames=True,
)  # fmt: skip
def depth(
    source: Annotated[
        str,
        typer.Argument(
            help="A depth image (16-bit .png, .pgm, .tif, or .pfm, .exr, .npy, .npz), a range scan "
            "(.ply with range_grid), an organised cloud (.pcd, or .npy and .npz of H x W points), "
            "or an RGB-D recording (a folder, .mkv or an address)."
        ),
    ],
    output: Output,
    points: Annotated[
        int | None,
        typer.Option(
            min=3, help="Largest number of vertices; this, --ratio or --bandwidth is needed."
        ),
    ] = None,
    ratio: Annotated[
        float | None,
        typer.Option(
            help="Largest number of vertices as a share of the measured pixels, above 0 to 1."
        ),
    ] = None,
    intrinsics: Annotated[
        str,
        typer.Option(
            help="Camera of the depth image: fx,fy,cx,cy in pixels, a file (OpenCV's .xml or "
            ".yaml, also of a stereo pair, ROS's CameraInfo as .yaml, Open3D's .json, COLMAP's "
            "cameras.txt, a matrix as .txt or .csv, the calib.txt of a stereo pair), or a preset: "
            "tum, tum-fr1, tum-fr2, tum-fr3, kinect-v1, kinect-v2, azure, realsense, primesense. "
            "Scans need none."
        ),
    ] = "",
    unit: Annotated[
        str,
        typer.Option(
            help="Unit of the depth image: mm, tum (1/5000 m), m, kinect-raw (11-bit disparity), "
            "nyu, sun, a number of units per metre, or disparity:FB of a stereo pair, whose depth "
            "is FB / d. guess: the unit that the camera states, else estimated from the numbers, "
            "and printed."
        ),
    ] = "guess",
    ray_depth: Annotated[
        bool,
        typer.Option(
            "--ray-depth",
            help="The numbers are distances along the lines of sight (Hypersim, SceneNet), no "
            "depths along the optical axis; they are converted with the camera's lens. For depth "
            "images.",
        ),
    ] = False,
    method: Annotated[
        DepthMethod, typer.Option(help="Simplification method.")
    ] = DepthMethod.relief,
    variant: Annotated[Variant, typer.Option(help="Variant of --method cs3.")] = Variant.cios,
    effort: Annotated[
        Effort,
        typer.Option(
            help="From live, in a fraction of the time, to best, with the least error (--method "
            "relief)."
        ),
    ] = Effort.balanced,
    depth_step: Annotated[
        float,
        typer.Option(
            min=0,
            help="Leave out faces across depth steps: neighbouring pixels whose depths differ by "
            "more than this share of the depth, and by more than a surface inclined by 78 degrees "
            "explains; 0: leave out none. For depth images.",
        ),
    ] = 0.05,
    max_edge: Annotated[
        float | None,
        typer.Option(
            help="Leave out faces with an edge longer than this, in metres or in the unit of the "
            "scan. With --method relief it limits edges between neighbouring pixels."
        ),
    ] = None,
    by_distance: Annotated[
        bool,
        typer.Option(
            "--by-distance",
            help="Put more points where the surface is near (--method cs3, --variant cios or "
            "lios).",
        ),
    ] = False,
    move_points: Annotated[
        bool,
        typer.Option(
            "--move-points", help="Vertices may leave the measured points (--method relief)."
        ),
    ] = False,
    color: Annotated[
        str,
        typer.Option(
            help="Colour image of the same view, which becomes the texture; for several depth "
            "images, a folder with one for each, of the same name, of the nearest time if names "
            "are times, or in the order of their names. It may be the folder of the depth images: "
            "1.depth.png and 1.color.png."
        ),
    ] = "",
    mask: Annotated[
        str,
        typer.Option(
            help="Image, .npy or .npz of the same size: black (0) or transparent where the depth "
            "is not to be used; in a lossy image (JPEG, most WebP) darker than half, or only "
            "transparent if parts of it are. For several depth images, one mask for all or a "
            "folder with one for each."
        ),
    ] = "",
    confidence: Annotated[
        str,
        typer.Option(
            help="Grey image, .npy or .npz of the same size: weight of each pixel's error, as "
            "levels or 0 to 1 (--method relief). A pixel with weight 0 does not shape the surface; "
            "triangles lie over it. Where only such pixels lie between depth steps, they are left "
            "out as by --mask. A file or a folder, as --mask."
        ),
    ] = "",
    confidence_max: Annotated[
        int | None,
        typer.Option(
            help="Highest level of --confidence, which counts as 1: 2 for ARKit, 15 for a "
            "RealSense L515. Default: the maximum that a PGM states, else the largest number of 1, "
            "8 or 16 bits; needed for levels in wider integers or in floats."
        ),
    ] = None,
    poses: Annotated[
        str,
        typer.Option(
            help="Camera pose of each depth image; they become one mesh: TUM's groundtruth.txt "
            "(time tx ty tz qx qy qz qw, or without the time, or the 12 or 16 numbers of a "
            "matrix; other columns by their names: Stray Scanner's odometry.csv, EuRoC, whose "
            "poses are of the IMU: multiply each from the right by T_BS of cam0/sensor.yaml), a "
            "folder with a matrix for each (7-Scenes, ScanNet), Redwood's .log, a transforms.json "
            "(nerfstudio, instant-ngp, Record3D) or a Stanford .conf."
        ),
    ] = "",
    min_coverage: Annotated[
        float,
        typer.Option(
            min=0,
            max=1,
            help="With --strict, exit with code 4 if a smaller share of the measured pixels is "
            "covered.",
        ),
    ] = 0.9,
    max_bridges: Annotated[
        float,
        typer.Option(
            min=0,
            max=1,
            help="With --strict, exit with code 4 if a larger share of the mesh's area bridges "
            "gaps, slivers along contours included, or, with --depth-step 0, depth steps. Filled "
            "pinholes do not count.",
        ),
    ] = 0.1,
    bandwidth: Annotated[
        float | None,
        typer.Option(
            help="Bytes per second of a stream whose frames are the files: each file gets as many "
            "points as fit into its share. Needs --rate."
        ),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="Frames per second that share --bandwidth.")
    ] = None,
    stable: Annotated[
        bool,
        typer.Option(
            "--stable",
            help="Treat the files as frames of one camera, in the order of their names: depths "
            "are smoothed over time and vertices are kept, so that meshes do not flicker where the "
            "scene is at rest (--method relief). Runs in one process with --jobs threads; each run "
            "makes all files again. A folder with more meshes of an earlier run is refused; "
            "--force removes them.",
        ),
    ] = False,
    frames: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Stop after this many frames of an RGB-D recording, or images with --poses.",
        ),
    ] = None,
    force: Force = False,
    strict: Strict = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: FolderJobs = 0,
    seed: Seed = 0,
) -> None:
    """Turn a depth image or a range scan into a sparse textured mesh.

    Several depth images, all in one unit, become a folder with a .glb file for each; with --poses
    they become one mesh, with --stable a sequence of meshes that does not flicker. The result is in
    metres, with +y up in glTF (.glb, .gltf) and in the axes of the camera or the poses in .ply,
    .obj, .stl and .off.
    The depth range and its unit are printed: check them. Depths are those along the optical axis,
    unless --ray-depth is given. An RGB-D recording has its own camera,
    unit and colours; each of its frames becomes a .glb in a folder.

    Example: manip3d depth depth.png --intrinsics kinect-v2 --points 5000 -o person.glb
    """
    from manip3d import simplify

    assert not poses  # those files were joined
    assert frames is None  # that was a recording
    _expect_budget(points, ratio, bandwidth, rate)
    shell = Terminal(as_json=as_json, quiet=quiet)
    with naming_options(*_OPTIONS):
        options = simplify.DepthOptions(
            points=points,
            method=method.value,
            variant=variant.value,
            intrinsics=intrinsics,
            unit=unit,
            max_edge=max_edge,
            depth_step=depth_step,
            by_distance=by_distance,
            move_points=move_points,
            seed=seed,
            threads=jobs,
            min_coverage=min_coverage,
            bandwidth=bandwidth,
            rate=rate,
            max_bridges=max_bridges,
            effort=effort.value,
            ratio=ratio,
            ray_depth=ray_depth,
        )
        # Whether a cloud is an organised one is decided by its reader.
        clouds = ("scan",) if scan_suffix(source) in (".pcd", ".npy", ".npz") else ()
        pictures = narrow_depth(source, unit, intrinsics)
        expect_kind(source, "depth", "range grid", *clouds, *pictures, verb="depth")
        check_output(output, WRITABLE, force=force)
        sequence = _sequence.get()
        if stable and sequence is None:
            raise InputError("stable: can only be given with several depth images, got one")
        make = functools.partial(simplify.simplify_depth_file, options=options)
        result = (make if sequence is None else sequence.simplify_file)(
            source,
            output,
            color=color or None,
            mask=mask or None,
            confidence=confidence or None,
            confidence_max=confidence_max,
        )
    _tell(shell, result)
    shell.result(_record(result))
    if strict and (result.target_missed or result.coverage_missed or result.bridges_missed):
        raise typer.Exit(MISSED)


cs3 = with_defaults(depth, method=DepthMethod.cs3)
"""The verb `depth` with the method of chapter 3 as its default."""


def _tell(shell: Terminal, result: DepthFileResult) -> None:
    if result.depth:
        is_guess = result.unit and result.options.is_unit_guessed
        override = "; --unit overrides it" if is_guess else ""
        words = named_as_options(result.depth, _OPTIONS)
        shell.say(f"read {result.source}: {words}{override}")
    shell.say(_sentence(result))
    _warn_if_sparse(shell, result)


def _sentence(result: DepthFileResult) -> str:
    return f"{_made(result)}; {_covered(result)}{_missed(result)}; wrote {result.output}"


def _made(result: DepthFileResult) -> str:
    """Return words on how the mesh came about."""
    options = result.options
    kind = f" ({options.variant})" if options.method == "cs3" else ""
    if options.effort != Effort.balanced:
        kind = f" ({options.effort})"
    words = (
        f"{options.method}{kind}: {counted(result.points_before, 'point')} -> "
        f"{count(result.points)}, {counted(result.faces, 'face')}"
    )
    if result.faces_cut:
        words += f", {counted(result.faces_cut, 'face')} across depth steps left out"
    return f"{words} in {result.seconds * 1000:.1f} ms"


def _covered(result: DepthFileResult) -> str:
    """Return words on what the mesh covers and bridges, beside what was asked for."""
    options = result.options
    limit = f"less than {100 * options.min_coverage:.4g} %"
    # The limit is one on the measured pixels, of which some may lie on no surface.
    is_low = result.coverage < options.min_coverage
    low = f", {limit}" if is_low else ""
    outside = f" ({limit} of them are covered)" if result.coverage_missed and not is_low else ""
    many = f", more than {100 * options.max_bridges:.4g} %" if result.bridges_missed else ""
    if many and result.left_area:
        together = 100 * result.unwanted_bridges
        many = f" ({together:.2f} % with faces across depth steps{many})"
    bridges = 100 * (result.bridges - result.filled)
    filled = f" and {100 * result.filled:.2f} % fills pinholes" if result.filled else ""
    return (
        f"covers {100 * result.coverage:.1f} % of the surface's pixels{low}"
        f"{_not_covered(result, outside)}, "
        f"{bridges:.2f} % of its area bridges gaps{many}{filled}"
    )


def _missed(result: DepthFileResult) -> str:
    """Return words on the numbers of points and bytes, and on what speaks against the mesh."""
    options, words = result.options, ""
    if result.target_missed:
        words += f"; target of {counted(options.points or 0, 'point')} missed"
    if result.num_bytes is not None:
        words += f"; {count(result.num_bytes)} of {counted(options.max_bytes or 0, 'byte')}"
    return words + _left_across_steps(result)


def _not_covered(result: DepthFileResult, so_few: str) -> str:
    """Return words on the pixels that the coverage of the surface does not count.

    ``so_few`` says that too few of the measured pixels are covered, if they are.
    """
    words = ""
    if round(100 * result.outside, 1) > 0 or so_few:
        words += f", {100 * result.outside:.1f} % of the measured pixels lie on no surface{so_few}"
    words += _without_ray(result)
    if result.dropped_pixels:
        words += f", {counted(result.dropped_pixels, 'pixel')} of small pieces left out"
    if result.unsure_pixels:
        words += f", {counted(result.unsure_pixels, 'pixel')} without confidence left out"
    if result.filled_pixels:
        words += f", {counted(result.filled_pixels, 'pixel')} in pinholes filled"
    return words


def _without_ray(result: DepthFileResult | JointFileResult) -> str:
    from manip3d.simplify._depth_options import NO_RAY_WORDS

    if not result.without_ray:
        return ""
    have = "has" if result.without_ray == 1 else "have"
    return f", {counted(result.without_ray, 'pixel')} {have} {NO_RAY_WORDS}"


def _warn_if_sparse(shell: Terminal, result: DepthFileResult | JointFileResult) -> None:
    from manip3d.simplify._depth_options import SPARSE_WORDS

    if result.is_sparse:
        shell.warn(SPARSE_WORDS)


def _left_across_steps(result: DepthFileResult) -> str:
    if not result.faces_left:
        return ""
    return (
        f"; the scene has depth steps, and {counted(result.faces_left, 'face')} across them, "
        f"{100 * result.left_area:.2f} % of the area, stayed, as --depth-step is 0 and there is no "
        "--max-edge"
    )


def _effort_of(options: DepthOptions) -> str | None:
    return options.effort if options.method == DepthMethod.relief else None


def _record(result: DepthFileResult) -> dict[str, Any]:
    """The result for ``--json``."""
    files = {"input": str(result.source), "output": str(result.output)}
    is_cs3 = result.options.method == "cs3"
    return files | {
        "method": result.options.method,
        "variant": result.options.variant if is_cs3 else None,
        "effort": _effort_of(result.options),
        "depth": result.depth,
        "unit": result.unit,
        "unit_guessed": result.depth_found.is_guess,
        "unit_doubt": result.depth_found.doubt,
        "depth_near": result.depth_found.near,
        "depth_far": result.depth_found.far,
        "marked_pixels": result.depth_found.num_marked,
        "size": result.depth_found.size,
        "camera": result.depth_found.camera,
        "points_before": result.points_before,
        "target_points": result.options.points,
        "points": result.points,
        "bytes": result.num_bytes,
        "max_bytes": result.options.max_bytes,
        "faces": result.faces,
        "faces_cut": result.faces_cut,
        "stop": result.stop,
        "reached": result.reached,
        "literal_count": result.literal_count,
        "seconds": round(result.seconds, 4),
        "coverage": round(result.coverage, 6),
        "bridges": round(result.bridges, 6),
        "filled": round(result.filled, 6),
        "outside": round(result.outside, 6),
        "lone_pixels": result.lone_pixels,
        "without_ray": result.without_ray,
        "dropped_pixels": result.dropped_pixels,
        "filled_pixels": result.filled_pixels,
        "unsure_pixels": result.unsure_pixels,
        "faces_left": result.faces_left,
        "left_area": round(result.left_area, 6),
        "target_missed": result.target_missed,
        "coverage_missed": result.coverage_missed,
        "bridges_missed": result.bridges_missed,
    }
