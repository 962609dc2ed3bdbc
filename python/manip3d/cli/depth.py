"""``manip3d depth`` and ``manip3d cs3``: depth images and range scans to sparse textured meshes."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from manip3d.cli.depth_frames import SCANS, expect_image, frame_options
from manip3d.cli.depth_joined import join
from manip3d.cli.depth_options import (
    BUDGETS,
    OPTIONS,
    DepthMethod,
    Effort,
    Variant,
    expect_budget,
    options_of,
)
from manip3d.cli.depth_recordings import simplify_frames
from manip3d.cli.depth_words import has_missed, record, sentence_of_all, tell
from manip3d.cli.many import Verb, over_files, with_defaults
from manip3d.cli.options import (
    MISSED,
    FolderJobs,
    Force,
    Json,
    Output,
    Quiet,
    Strict,
)
from manip3d.cli.terminal import Terminal, check_output, naming_options
from manip3d.errors import InputError
from manip3d.io import DEPTH_SUFFIXES, WRITABLE

if TYPE_CHECKING:
    from manip3d.simplify import DepthFileResult


def _in_order(given: Mapping[str, Any]) -> Verb | None:
    """With ``--stable``, return a verb whose meshes depend on those before; else None."""
    if not given["stable"]:
        return None
    from manip3d.simplify import DepthSequence

    with naming_options(*OPTIONS, "dask"):
        if "dask" in given["shared"]:
            raise InputError("dask: cannot be given with stable, which reads the files in order")
        sequence = DepthSequence(options_of(given))

    def next_frame(source: str, output: Path, **frame: Any) -> None:
        with naming_options(*OPTIONS):
            _check_files(source, output, frame)
        _simplify(sequence.simplify_file, source, output, frame)

    return next_frame


def _check_files(source: str, output: Path, given: Mapping[str, Any]) -> None:
    """Refuse a source that is no depth image, or an output that may not be written."""
    expect_image(source, given)
    check_output(output, WRITABLE, force=given["force"])


def _simplify(
    make: Callable[..., DepthFileResult], source: str, output: Path, given: Mapping[str, Any]
) -> None:
    """Write the mesh of a depth image, and print what it is."""
    # One of several files has none of these if a folder of them lacks an image for it.
    maps = ("color", "mask", "confidence")
    with naming_options(*OPTIONS):
        result = make(
            source,
            output,
            confidence_max=given["confidence_max"],
            **{name: given.get(name) or None for name in maps},
        )
    shell = Terminal(as_json=given["as_json"], quiet=given["quiet"])
    tell(shell, result)
    shell.result(record(result))
    if given["strict"] and has_missed(result):
        raise typer.Exit(MISSED)


@over_files(
    lambda: (*DEPTH_SUFFIXES, *SCANS), writable=lambda: WRITABLE, otherwise=".glb",
    prepare=frame_options, check=lambda given: expect_budget(*(given[name] for name in BUDGETS)),
    together=lambda sources, given: join(sources, given) or simplify_frames(sources, given),
    in_order=_in_order, sentence=sentence_of_all, may_be_frames=True,
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
    seed: Annotated[int, typer.Option(min=0, help="Seed of --method poisson.")] = 0,
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

    given = locals()  # all options by their names, as `over_files` has them
    expect_budget(*(given[name] for name in BUDGETS))
    with naming_options(*OPTIONS):
        options = options_of(given)
        _check_files(source, output, given)
        if stable:
            raise InputError("stable: can only be given with several depth images, got one")
    make = functools.partial(simplify.simplify_depth_file, options=options)
    _simplify(make, source, output, given)


cs3 = with_defaults(depth, method=DepthMethod.cs3)
"""The verb `depth` with the method of chapter 3 as its default."""
