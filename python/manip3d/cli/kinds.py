"""Kinds of sources (mesh, scan, recording, ...), and the commands that accept each kind."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from manip3d.errors import FormatError, InputError
from manip3d.io._elsewhere import scan_advice, with_depth_advice
from manip3d.io._remote import is_url, named_beside, reads_beside
from manip3d.io._scan_files import (
    FOLDER_SUFFIXES,
    SCAN_SUFFIXES,
    are_points_only,
    holds_points,
    ply_elements,
)
from manip3d.io._utd_mhad import DEPTH_ENDING as TRIAL
from manip3d.io._utd_mhad import joints_of, trial_at

if TYPE_CHECKING:
    from manip3d.batch import SourceFile

_PACKETS = (".pcap", ".pcapng")
_RECORDINGS = (*_PACKETS, ".osf", ".mcap", ".bag", ".mkv", TRIAL)
_POINTS_IN = {
    ".npy": (
        "An array of points has at least 9 rows and 3 to 8 columns of floats, or 3 to 8 for each "
        "pixel of an image"
    ),
    ".npz": "An archive of points has an array of floats named points, positions or xyz",
}
_PICTURES = (".jpg", ".jpeg", ".bmp", ".tga", ".gif", ".webp")

SHOWN = ("mesh", "scan", "range grid", "depth", "packets", "recording", "drive")
"""Kinds that ``info`` and ``view`` accept."""

WHOLE = ("recording", "packets", "drive")
"""Kinds of folders that are a single source, although they hold many files."""

RECORDING = ("recording",)
"""The same for commands that accept RGB-D recordings only."""

NO_RECORDING = (
    ". A folder is an RGB-D recording if it holds frames.jsonl, depth images in depth/ (colour "
    "images in color/), the lists depth.txt and rgb.txt of a TUM sequence, or a trial of UTD-MHAD"
)
"""Advice in an error about a folder without any recording."""

NAMES = {
    "mesh": "a mesh",
    "scan": "a LiDAR scan",
    "range grid": "a range scan",
    "depth": "a depth image",
    "packets": "a recording of a LiDAR",
    "recording": "an RGB-D recording",
    "drive": "a drive of LiDAR scans",
    "picture": "a picture",
    "results": "a results folder",
    "truth": "the truth of a forged stream",
    "folder": "a folder",
    "unknown": "a file of unknown kind",
}
VERBS = {
    "mesh": "simplify, compare, info, view, play, convert",
    "scan": (
        "inspect, forge lidar, watermark, info, view, convert, depth (of an organised cloud as "
        ".pcd, .npy or .npz, or as .ply with an element range_grid)"
    ),
    "range grid": "depth, info, view, convert",
    "depth": "depth, info, view",
    "packets": "inspect, lattice, alert, info, view, convert",
    "recording": (
        "capture play, capture info, info, view, inspect, forge stream, phantom render, depth"
    ),
    "drive": "inspect, watermark, alert, info, view, convert",
    "picture": "depth, as --color",
    "results": "report",
    "folder": "simplify and play (of meshes), depth (of depth images), info and view (of a drive)",
}
"""Commands that accept each kind."""


def kind_of(source: str) -> str:
    """Return the kind of a source, one of `NAMES`; ``stream`` for an address or stdin.

    Raises
    ------
    FormatError
        A ROS 1 bag has no index.
    OSError
        The file or folder does not exist.
    """
    if source == "-" or (":" in source and not Path(source).exists()):
        return "stream"
    path = path_in(source)
    if path.is_dir():
        if not os.access(path, os.R_OK | os.X_OK):  # else the error names a file within
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), source)
        return _kind_of_folder(path)
    path.stat()  # raises OSError, which names the file, if it does not exist
    suffix = _suffix(path)
    if suffix in (".pcap", ".pcapng", ".osf"):
        return "packets"
    if suffix in (".bag", ".mcap", ".db3"):
        from manip3d.capture import holds_clouds

        return "packets" if holds_clouds(path) else "recording"
    if suffix == ".mkv" or path.name.endswith(TRIAL):
        return "recording"
    if suffix == ".ply":
        return _kind_of_ply(path)
    if suffix in SCAN_SUFFIXES and (suffix not in (".npy", ".npz") or holds_points(path)):
        return "scan"
    # Imported here, because this loads all readers of meshes.
    from manip3d.io import DEPTH_SUFFIXES, READABLE, is_color_png

    if suffix in READABLE and suffix not in SCAN_SUFFIXES:
        return "mesh"
    if path.name.endswith(".truth.npz"):
        return "truth"
    if suffix in DEPTH_SUFFIXES:
        return "picture" if is_color_png(path) else "depth"
    return "picture" if suffix in _PICTURES else "unknown"


def path_in(source: str) -> Path:
    """Return the file or folder of a source, without the topic or sensor's number after a ``#``.

    A path with a ``#`` of its own stays whole.
    """
    path = Path(source)
    file, mark, _ = source.rpartition("#")
    return Path(file) if mark and not path.exists() and Path(file).exists() else path


def is_picture(source: str, may_be_8_bits: bool) -> bool:
    """Return whether a file is a PNG of 8 bits, unless it is grey and depths may have 8 bits.

    It is False for files that cannot be read, and for addresses.
    """
    from manip3d.io import is_color_png
    from manip3d.io._depth_files import is_grey_png

    try:
        if is_url(source) or not is_color_png(source):
            return False
        return not (may_be_8_bits and is_grey_png(source))
    except (OSError, FormatError):  # whoever reads the file reports it
        return False


def narrow_depth(source: str, unit: str, intrinsics: str) -> tuple[str, ...]:
    """Return the kind ``picture`` if these options make depths of a picture of 8 bits; else ().

    It is for `expect_kind`, which takes such a picture as a depth image then.
    """
    from manip3d.simplify._depth_inputs import may_have_8_bits

    is_narrow = is_picture(source, False) and not is_picture(source, True)
    return ("picture",) if is_narrow and may_have_8_bits(unit, intrinsics) else ()


class OtherKindError(InputError):
    """Raised for a source of a kind that the command does not accept.

    Attributes
    ----------
    kind : str
        The kind, as a value of `NAMES`.
    """

    def __init__(self, message: str, kind: str) -> None:
        super().__init__(message)
        self.kind = kind

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.kind)


def expect_kind(source: str, *kinds: str, verb: str) -> str:
    """Return the kind of a source, and raise if the command does not accept that kind.

    Raises
    ------
    OtherKindError
        The source has another kind; the message names the commands that accept it.
    OSError
        The file or folder does not exist.
    """
    kind = kind_of(source)
    if (advice := _advice(Path(source), kind, kinds, verb)) is not None:
        raise OtherKindError(f"{source}: {advice}", NAMES[kind])
    if kind in ("stream", *kinds) or (kind == "unknown" and "mesh" in kinds):
        return kind  # the mesh reader recognises files of any name by their content
    if kind == "recording" and verb == "depth":
        raise OtherKindError(_reason_against_recording(path_in(source)), NAMES[kind])
    *others, last = (NAMES[name] for name in kinds)
    wanted = f"{', '.join(others)} or {last}" if others else last
    takers = f". Commands that take {NAMES[kind]}: {VERBS[kind]}" if kind in VERBS else ""
    if kind == "truth":
        takers = ". Python reads it with manip3d.forge.read_stream_truth"
    message = f"{source} is {NAMES[kind]}; {verb} takes {wanted}{takers}"
    cure = _POINTS_IN.get(_suffix(Path(source))) if kind == "depth" and "scan" in kinds else None
    if cure is not None:  # whatever the array holds, its name does not say that it is an image
        message = f"{source} holds no points as {verb} reads them. {cure}{takers}"
    if kind == "folder" and kinds == RECORDING:
        message += NO_RECORDING
    if kind == "picture" and "depth" in kinds and _suffix(Path(source)) == ".png":
        message += ". If it holds depths of 8 bits, give their number in a metre as --unit, or "
        message += "disparity:FB of a stereo pair"
    raise OtherKindError(message, NAMES[kind])


_USES: Mapping[str, tuple[Any, Sequence[str]]] = {
    "color_by": (None, ("scan", "depth", "rgbd")),
    "intrinsics": ("", ("depth", "rgbd")),
    "unit": ("guess", ("depth",)),
    "color": (None, ("depth",)),
    "calibration": (None, ("scan",)),
}
"""Options of ``info`` and ``view`` that apply to some kinds of `viewer.kind_of` only: their
defaults, and the kinds."""
_WORDS = {"scan": "a scan", "depth": "a depth image", "rgbd": "a recording"}


def refuse_unused(sources: Sequence[str], given: Mapping[str, Any]) -> None:
    """Refuse an option of ``info`` or ``view`` that would have no effect on any of the sources.

    Nothing is refused if the content of a source is not known here (`_shown_kind`).

    Raises
    ------
    InputError
        An option of `_USES` differs from its default and applies to none of the sources.
    """
    asked = [n for n, (default, _) in _USES.items() if n in given and given[n] != default]
    found = [_shown_kind(source) for source in sources] if asked else []
    if None in found:
        return
    for name in asked:
        _, uses = _USES[name]
        if not set(found).intersection(uses):
            expected = " or ".join(_WORDS[kind] for kind in uses)
            raise InputError(
                f"--{name.replace('_', '-')}: can only be given with {expected}, got "
                f"{', '.join(sources)}"
            )


def refuse_unused_by_all(
    files: Sequence[SourceFile], given: Mapping[str, Any]
) -> Mapping[str, Mapping[str, Any]]:
    """Call `refuse_unused` for the files of a run, and return no options of single files."""
    refuse_unused([file.name for file in files], given)
    return {}


def _shown_kind(source: str) -> str | None:
    """Return the kind of `viewer.kind_of`.

    None for a URL, a pattern, a folder of several files and an unknown address, whose content is
    not known, and for a file that cannot be read, about which another error is raised later.
    """
    from manip3d import viewer

    if source == "-":
        return "mesh"
    if is_url(source):
        return None
    try:
        kind, shown = kind_of(source), viewer.kind_of(source)
    except (OSError, FormatError):
        return None
    is_known = kind != "folder" and (kind, shown) != ("stream", "mesh")
    return shown if is_known else None


def _advice(path: Path, kind: str, kinds: tuple[str, ...], verb: str) -> str | None:
    """Return how to convert a file to a format of the kinds that a command takes; None: unknown.

    Some depth maps have the suffix of a scan, which commands that take scans read as one.
    """
    is_unknown = kind == "unknown"
    takes_points = "scan" in kinds or "mesh" in kinds
    advice = scan_advice(path) if is_unknown and takes_points else None
    if "depth" in kinds and (is_unknown or (kind == "scan" and "scan" not in kinds)):
        return with_depth_advice(advice, path, takes_ray_depth=verb == "depth")
    return advice


def _reason_against_recording(source: Path) -> str:
    """Return why ``depth`` does not take a recording: it is not the only source or has no camera.

    A recording that is the only source and has a camera does not get here.
    """
    if not source.is_dir():
        alone = "only as its single source and without --poses"
        return f"{source} is an RGB-D recording, which depth takes {alone}"
    images = source / "depth"
    cure = f"; --intrinsics states it for the images in {images}" if images.is_dir() else ""
    return f"{source} is an RGB-D recording that states no camera{cure}"


def _suffix(path: Path) -> str:
    return Path(path.name.lower().removesuffix(".xz").removesuffix(".gz")).suffix


def _kind_of_folder(path: Path) -> str:
    if (path / "results.json").is_file():
        return "results"
    names = ("frames.jsonl", "depth.txt", "depth")
    if any((path / name).exists() for name in names):
        return "recording"
    if (path / "metadata.yaml").is_file():  # a ROS 2 bag
        from manip3d.capture import holds_clouds

        return "packets" if holds_clouds(path) else "recording"
    if (path / "velodyne").is_dir() or (path / "velodyne_points").is_dir():
        return "drive"
    return "folder" if trial_at(path) is None else "recording"


def _kind_of_ply(path: Path) -> str:
    """Return the kind of a PLY file: a mesh has faces, a range scan a grid, a scan only points."""
    elements = ply_elements(path)
    if elements is None:
        return "mesh"
    if b"range_grid" in elements:
        return "range grid"
    if not elements:
        return "unknown"  # a damaged file
    return "scan" if are_points_only(elements) else "mesh"


def shown_suffixes() -> tuple[str, ...]:
    """Return the suffixes of the files of a folder that ``info`` and ``view`` read."""
    from manip3d.io import DEPTH_SUFFIXES, READABLE

    return (*READABLE, *FOLDER_SUFFIXES, *DEPTH_SUFFIXES, *_RECORDINGS)


def inspected_suffixes() -> tuple[str, ...]:
    """Return the suffixes of the scans and recordings of a folder that ``inspect`` reads."""
    return (*FOLDER_SUFFIXES, *_RECORDINGS)


def recording_suffixes() -> tuple[str, ...]:
    """Return the endings of files that are RGB-D recordings."""
    return (".mkv", TRIAL)


def written_recordings() -> tuple[str, ...]:
    """Return the suffixes of RGB-D recordings that are written to files."""
    return (".mkv",)


def converted_suffixes() -> tuple[str, ...]:
    """Return the suffixes of meshes and scans."""
    from manip3d.io import READABLE

    return (*READABLE, *FOLDER_SUFFIXES)


def own_sources(files: list[SourceFile]) -> list[SourceFile]:
    """Remove files that are no sources: buffers and textures of meshes, truths of forgeries.

    The ``.bin`` of a glTF file is no scan, a texture of 16 bits is no depth image, and the truth of
    a forgery (``OUT.truth.npz``) is neither. Files that the user names, also by a pattern, are
    kept.
    """
    from manip3d.io import READABLE

    files = [file for file in files if file.is_named or not file.name.endswith(".truth.npz")]
    doubtful = [f for f in files if not f.is_named and _suffix_of(f.name) not in READABLE]
    folders = {folder for file in doubtful for folder in _folders_above(file.name)}
    meshes = [f.name for f in files if f.name.rpartition("/")[0] in folders]
    named = set(_all_named(meshes)) if doubtful else set()
    return [file for file in files if file.is_named or file.name not in named]


def beside(source: str) -> Iterator[Path]:
    """Yield the files with other names that are read with a recording: joints, a sensor's data."""
    if is_url(source):
        return
    path = Path(source)
    trial = trial_at(path)
    if trial is not None and trial.name.endswith(TRIAL):
        yield from joints_of(trial)
    if _suffix(path) in _PACKETS:
        from manip3d.capture._addresses import ouster_metadata

        metadata = ouster_metadata(path)
        if metadata is not None:
            yield metadata


def _all_named(sources: list[str]) -> Iterator[str]:
    """Yield all files to which sources refer, directly or through others (material libraries)."""
    waiting = [source for source in sources if reads_beside(PurePosixPath(source))]
    seen = set(waiting)
    while waiting:
        for name in named_beside(waiting.pop()):
            if name not in seen:
                seen.add(name)
                waiting.append(name)
            yield name


def _folders_above(name: str) -> Iterator[str]:
    while "/" in name:
        name = name.rpartition("/")[0]
        yield name
    yield ""


def _suffix_of(name: str) -> str:
    return _suffix(Path(PurePosixPath(name).name))
