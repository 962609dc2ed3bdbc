"""Stimuli of the rating study: simulated people, real and forged, as pictures and clips."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.extras import require
from manip3d._util.paths import path_of, refuse_existing
from manip3d.errors import InputError
from manip3d.io._files import atomic_folder, open_regular, regular_bytes
from manip3d.study._engine import SHOWABLE
from manip3d.study._rating import (
    COLUMNS,
    FORMS,
    MANIFEST,
    MODALITIES,
    PUBLISHED_COMPOSITION,
    TRUTHS,
    Item,
)
from manip3d.study._replacing import refuse_other_stimuli

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.forge import ForgedFrame
    from manip3d.rgbd import RgbdFrame

    Image = NDArray[np.uint8]

_RATE = 10.0  # frames per second of a clip
_STREAMS = ("real", "type1", "type2")  # truths of a picture or clip of a person
_LOW_WIDTH, _LOW_QUALITY = 160, 12
_SURFACE_EDGE = 0.06  # metres; longer edges cross a depth step
_NEAREST, _FARTHEST = 2.1, 2.9  # metres from the camera to a person
_NEAR_MM, _FAR_MM = 1200.0, 6000.0  # ends of the grey scale of all depth pictures, mm


@dataclass(frozen=True)
class _Shot:
    """Person, action and background of a picture or clip, and its kind of forgery."""

    truth: str
    running: bool
    seed: int

    def frames(self, times: Sequence[float]) -> list[tuple[RgbdFrame, NDArray[np.bool_]]]:
        """Return the frames, each with the mask of the person's pixels."""
        from manip3d import forge
        from manip3d.rgbd import NO_BODY
        from manip3d.simulate import BodySimulator
        from manip3d.simulate.forged_people import ACTIONS, PEOPLE, SCENES, STRIPED

        random = np.random.default_rng(self.seed)
        person, action = int(random.integers(6)), int(random.integers(4))
        motion, side = ACTIONS[action]
        start = float(random.uniform(0.0, 3.0))
        distance = float(random.uniform(_NEAREST, _FARTHEST))
        scene = int(random.integers(len(SCENES)))
        actor = BodySimulator(
            motion=motion,
            side=side,
            girth=PEOPLE[person],
            stripes=person == STRIPED,
            distance=distance,
            tracker="kinect-v2",
            # In a forgery the person was recorded in another scene.
            scene=SCENES[scene if self.truth == "real" else (scene + 1) % len(SCENES)],
            seed=self.seed,
        )
        seen = [actor.frame(start + time) for time in times]
        if self.truth == "real":
            return [(f, np.asarray(f.body_index != NO_BODY)) for f in seen]
        room = replace(actor, scene=SCENES[scene])
        scenes = [room.background(start + 60.0 + time) for time in times]
        pose = None
        if self.truth == "type2":
            other, side = ACTIONS[(action + 1 + int(random.integers(3))) % 4]
            mover = BodySimulator(motion=other, side=side, color="none", seed=self.seed + 1)
            pose = [mover.frame(start + time).skeletons[0] for time in times]
        made: Iterator[ForgedFrame] = forge.stream(
            seen,
            scenes if self.running else scenes[0],
            kind=2 if self.truth == "type2" else 1,
            pose=pose,
            # Change only the distance: recorded people stand in the middle, too.
            move=(0.0, 0.0, float(random.uniform(_NEAREST, _FARTHEST)) - distance),
        ).frames()
        return [(f.frame, f.mask) for f in made]


def _depth(frame: RgbdFrame) -> Image:
    from manip3d.viewer.people import depth_picture

    return depth_picture(frame.depth, near=_NEAR_MM, far=_FAR_MM)


def _color(frame: RgbdFrame) -> Image:
    assert frame.color is not None
    return np.ascontiguousarray(np.asarray(frame.color)[..., :3])


def _rendered(frame: RgbdFrame, person: NDArray[np.bool_]) -> Image:
    """Render the person as a textured surface, seen from 20 degrees to the side of the camera."""
    from manip3d import simplify
    from manip3d.viewer.people import surface_picture

    camera = frame.calibration.depth
    alone = np.where(person, frame.depth, np.zeros((), frame.depth.dtype))
    mesh = simplify.dense_mesh(alone, camera, color=frame.color, max_edge=_SURFACE_EDGE)
    assert mesh.texcoords is not None
    color = np.asarray(frame.color)[..., :3]
    return surface_picture(mesh.vertices, mesh.faces, mesh.texcoords, color, camera, azimuth=20.0)


_DRAW: Mapping[str, Callable[[RgbdFrame, NDArray[np.bool_]], Image]] = {
    "depth": lambda frame, person: _depth(frame),
    "color": lambda frame, person: _color(frame),
    "rendered": _rendered,
}


@checked
def make_rating_stimuli(
    output: str | os.PathLike[str],
    *,
    composition: Mapping[tuple[str, str, str], Mapping[str, int]] | None = None,
    frames: int = 24,
    examples: bool = True,
    surfaces: int = 0,
    seed: int = 0,
    overwrite: bool = False,
    progress: Callable[[float, str], object] | None = None,
) -> tuple[Item, ...]:
    """Make a folder of stimuli for a rating study, of simulated people and of LiDAR scans.

    Parameters
    ----------
    output : path-like
        Folder to create, with ``stimuli.csv``.
    composition : mapping, optional
        Numbers of stimuli, in the form of `PUBLISHED_COMPOSITION`, which is the default.
    frames : int
        Number of frames of a clip, 10 per second.
    examples : bool
        Add one image of each class, which is shown before the questions.
    surfaces : int
        Number of surfaces meshed from real LiDAR scans; the same number has an object added, and
        the same number a dent or a bulge.
    seed : int
        Seed of all random choices, 0 or more.
    overwrite : bool
        Replace the folder if it contains only such stimuli.
    progress : callable, optional
        Called with the fraction done and a message.

    Returns
    -------
    tuple of Item
        Stimuli in the order of ``stimuli.csv``. File names are random and reveal nothing.

    Raises
    ------
    InputError
        An argument is out of range, or the folder exists.
    MissingExtraError
        Open3D or Pillow is not installed: ``pip install 'manip3d[simulate]'``.
    OSError
        The folder cannot be written.

    Notes
    -----
    The stimuli are simulated, with six people of different girths, four actions and three
    backgrounds, as in the published study. The background of a forged clip is a still frame in
    every second clip and a running sequence in the others. All depth pictures have the same grey
    scale. Clips are animated WebP files, lossless except for those of low resolution, which are
    160 pixels wide and have quality 12.
    """
    wanted = PUBLISHED_COMPOSITION if composition is None else composition
    if not 2 <= frames <= 1000 or not 0 <= surfaces <= 1000:
        raise InputError(
            f"frames, surfaces: expected 2 to 1000 and 0 to 1000, got {frames} and {surfaces}"
        )
    _check_seed(seed)
    _check_composition(wanted)
    plan = _planned(wanted, examples=examples, surfaces=surfaces)
    if not 1 <= len(plan) <= _MAX_STIMULI:
        raise InputError(
            f"composition: expected 1 to {_MAX_STIMULI} stimuli with examples and surfaces, "
            f"got {len(plan)}"
        )
    target = path_of(output)
    refuse_existing(target, overwrite=overwrite, name="output")
    refuse_other_stimuli(target, MANIFEST)
    require("simulate")
    random = np.random.default_rng(seed)
    names = random.choice(16**6, size=len(plan), replace=False)
    made = []
    with atomic_folder(target) as folder:
        for place, (item, number) in enumerate(plan):
            if progress is not None:
                progress(place / len(plan), f"{item.modality} {item.form}")
            name = f"{names[place]:06x}.{'webp' if item.form == 'clip' else 'png'}"
            own_seed = int(random.integers(2**31))
            content, background = _content(item, number, own_seed, frames)
            (folder / name).write_bytes(content)
            made.append(replace(item, file=name, background=background))
        made.sort(key=lambda item: item.file)
        _write_manifest(folder, made)
    return tuple(made)


def _check_seed(seed: int) -> None:
    if seed < 0:
        raise InputError(f"seed: expected 0 or more, got {seed}")


def _check_composition(composition: Mapping[tuple[str, str, str], Mapping[str, int]]) -> None:
    for (form, modality, resolution), counts in composition.items():
        good = form in FORMS and modality in _DRAW and resolution in ("full", "low")
        if not good or not set(counts) <= set(_STREAMS):
            raise InputError(
                f"composition: {form}, {modality}, {resolution}: expected image or clip; "
                f"{', '.join(_DRAW)}; full or low; numbers of real, type1 and type2"
            )
        for truth, count in counts.items():
            if not isinstance(count, int | np.integer) or count < 0:
                raise InputError(
                    f"composition: {form}, {modality}, {resolution}: expected a whole number of "
                    f"{truth} from 0 on, got {count!r}"
                )


def _planned(
    composition: Mapping[tuple[str, str, str], Mapping[str, int]], *, examples: bool, surfaces: int
) -> list[tuple[Item, int]]:
    """Return the stimuli without file names, each with its number within its class."""
    plan = [
        (Item("", truth, modality, form, resolution), number)
        for (form, modality, resolution), counts in composition.items()
        for truth, count in counts.items()
        for number in range(count)
    ]
    if examples:
        plan += [(Item("", truth, "color", "image", "full", example=True), 0) for truth in _STREAMS]
    plan += [
        (Item("", truth, "surface", "image", "full"), number)
        for number in range(surfaces)
        for truth in ("real", "added", "deformed")
    ]
    return plan


def _write_manifest(folder: Path, items: Sequence[Item]) -> None:
    with (folder / MANIFEST).open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for item in items:
            row = [getattr(item, column) for column in COLUMNS]
            writer.writerow([*row[:-1], "1" if item.example else "0"])


_EXAMPLE, _LOW = "example", "low"
_MAX_STIMULI = 10_000  # more than anybody can rate; such a folder is a mistake
_MAX_BYTES = 1 << 28  # largest size of a stimulus


@checked
def copy_rating_stimuli(
    images: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    seed: int = 0,
    overwrite: bool = False,
) -> tuple[Item, ...]:
    """Make a folder of stimuli for a rating study from your own pictures and clips.

    Parameters
    ----------
    images : path-like
        A folder with sub-folders ``real``, ``type1``, ``type2``, ``added`` or ``deformed``, whose
        names are the truth. Folders below them may be named by modality (``depth``, ``color``,
        ``rendered``, ``surface``; default: ``color``), ``low`` for low resolution, and ``example``
        for stimuli that are shown before the questions. Files ``.gif``, ``.webm``, ``.mp4`` and
        animated ``.webp`` are clips, all others images. Hidden files are left out.
    output : path-like
        Folder to create, with ``stimuli.csv``.
    seed : int
        Seed of the random file names, 0 or more.
    overwrite : bool
        Replace the folder if it contains only such stimuli.

    Returns
    -------
    tuple of Item
        Stimuli in the order of ``stimuli.csv``. File names are random and reveal nothing. Metadata
        inside the files, such as the time of a picture, is copied. Grey PNGs of 16 bits, which
        browsers show almost black, become pictures of 8 bits: all of one modality have the same
        scale, whose ends are the values below and above 98 % of their pixels (0 and 65535 left
        out). Near pixels of depth images are light.

    Raises
    ------
    InputError
        The folder contains nothing to show, files of other kinds, or folders of other names; or the
        output exists or lies within the folder.
    FormatError
        A PNG of 16 bits is damaged.
    MissingExtraError
        Pillow is not installed (grey PNGs of 16 bits).
    OSError
        A file cannot be read or written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from manip3d.study import copy_rating_stimuli
    >>> with tempfile.TemporaryDirectory() as place:
    ...     for truth in ("real", "type2"):
    ...         (Path(place) / "mine" / truth / "depth").mkdir(parents=True)
    ...         _ = (Path(place) / "mine" / truth / "depth" / "a.png").write_bytes(b"...")
    ...     made = copy_rating_stimuli(Path(place) / "mine", Path(place) / "stimuli")
    ...     sorted((item.truth, item.modality, item.form) for item in made)
    [('real', 'depth', 'image'), ('type2', 'depth', 'image')]
    """
    source, target = path_of(images, "images"), path_of(output)
    if not source.is_dir():
        raise InputError(f"images: expected a folder, got {source}")
    refuse_existing(target, overwrite=overwrite, name="output")
    refuse_other_stimuli(target, MANIFEST)
    if target.resolve().is_relative_to(source.resolve()):
        raise InputError("output: expected a folder beside that of the images, not within it")
    _check_seed(seed)
    files = sorted(
        path
        for path in source.rglob("*")
        if path.is_file() and not any(p.startswith(".") for p in path.relative_to(source).parts)
    )
    if not 1 <= len(files) <= _MAX_STIMULI:
        raise InputError(f"images: expected 1 to {_MAX_STIMULI} files, found {len(files)}")
    names = np.random.default_rng(seed).choice(16**6, size=len(files), replace=False)
    made = [
        _own_item(path.relative_to(source), f"{name:06x}", is_clip=_is_clip(path))
        for path, name in zip(files, names.tolist(), strict=True)
    ]
    for path in files:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(f"images: {path}: expected at most {_MAX_BYTES} bytes")
    scales = _grey_scales(zip(files, made, strict=True))
    with atomic_folder(target) as folder:
        for path, item in zip(files, made, strict=True):
            if _has_16_bits(path):
                content = _png(_in_8_bits(path, item.modality, scales[item.modality]))
            else:
                content = regular_bytes(path)
            (folder / item.file).write_bytes(content)
        made.sort(key=lambda item: item.file)
        _write_manifest(folder, made)
    return tuple(made)


def _has_16_bits(path: Path) -> bool:
    """Return whether a file is a grey PNG of 16 bits, by its header."""
    with open_regular(path) as stream:
        header = stream.read(26)
    return header.startswith(b"\x89PNG\r\n\x1a\n") and header[24:26] == bytes([16, 0])


def _grey_scales(files: Iterable[tuple[Path, Item]]) -> dict[str, tuple[float, float]]:
    """Return the ends of the grey scale of all pictures of 16 bits, by modality."""
    from manip3d.io._depth_files import read_stored_depth

    counts: dict[str, NDArray[np.int64]] = {}
    for path, item in files:
        if _has_16_bits(path):
            values = np.bincount(read_stored_depth(path).ravel(), minlength=1 << 16)
            counts[item.modality] = counts.get(item.modality, 0) + values
    scales = {}
    for modality, values in counts.items():
        values[[0, -1]] = 0  # no measurement
        heaped = np.cumsum(values)
        low, high = np.searchsorted(heaped, [0.01 * heaped[-1], 0.99 * heaped[-1]])
        scales[modality] = float(low), float(high)
    return scales


def _in_8_bits(path: Path, modality: str, scale: tuple[float, float]) -> Image:
    from manip3d.io._depth_files import read_stored_depth
    from manip3d.viewer.people import depth_picture

    values = read_stored_depth(path)
    low, high = scale
    if modality == "depth":
        return depth_picture(np.where(values == 65535, 0, values), near=low, far=high)
    share = np.clip((values - low) / max(high - low, 1.0), 0.0, 1.0)
    return np.repeat((255.0 * share).astype(np.uint8)[..., None], 3, axis=2)


def _is_clip(path: Path) -> bool:
    """Return whether a file shows several pictures, by its suffix or the header of a WebP file."""
    suffix = path.suffix.lower()
    return suffix in _CLIPS or (suffix == ".webp" and _is_animated(path))


def _is_animated(path: Path) -> bool:
    """Return whether a WebP file is an animation [RFC 9649, section 2.7: flag A of VP8X]."""
    with open_regular(path) as stream:
        header = stream.read(21)
    is_extended = len(header) == 21 and (header[:4], header[8:16]) == (b"RIFF", b"WEBPVP8X")
    return is_extended and bool(header[20] & 0x02)


def _own_item(place: Path, name: str, *, is_clip: bool) -> Item:
    """Return the stimulus described by the names of a file's folders."""
    truth, *others = place.parts[:-1] or ("",)
    suffix = place.suffix.lower()
    if truth not in TRUTHS:
        raise InputError(
            f"images: {place}: expected a folder of {', '.join(TRUTHS)}, got {truth or 'none'!r}"
        )
    if suffix not in SHOWABLE:
        shown = ", ".join(SHOWABLE)
        raise InputError(f"images: {place}: expected a name that ends in {shown}")
    known = {*MODALITIES, _EXAMPLE, _LOW}
    if not set(others) <= known or len(set(others) & set(MODALITIES)) > 1:
        raise InputError(
            f"images: {place}: expected folders of {', '.join(sorted(known))} below {truth}"
        )
    modality = next((other for other in others if other in MODALITIES), "color")
    form = "clip" if is_clip else "image"
    resolution = "low" if _LOW in others else "full"
    return Item(f"{name}{suffix}", truth, modality, form, resolution, "", _EXAMPLE in others)


_CLIPS = (".gif", ".webm", ".mp4")


def _content(item: Item, number: int, seed: int, frames: int) -> tuple[bytes, str]:
    """Return the content of a stimulus's file, and the kind of its background."""
    if item.modality == "surface":
        return _png(_scan_surface(item.truth, seed)), ""
    running = item.form == "image" or number % 2 == 1
    shot = _Shot(item.truth, running, seed)
    times = [n / _RATE for n in range(frames)] if item.form == "clip" else [0.0]
    pictures = [_DRAW[item.modality](*seen) for seen in shot.frames(times)]
    background = "" if item.truth == "real" else ("running" if running else "still")
    if item.form == "image":
        return _png(pictures[0], low=item.resolution == "low"), background
    return _clip(pictures, low=item.resolution == "low"), background


def _small(picture: Image) -> Image:
    from PIL import Image as Pillow

    height = max(1, round(picture.shape[0] * _LOW_WIDTH / picture.shape[1]))
    return np.asarray(Pillow.fromarray(picture).resize((_LOW_WIDTH, height)))


def _png(picture: Image, *, low: bool = False) -> bytes:
    from manip3d.viewer.pictures import png_bytes

    return png_bytes(_small(picture) if low else picture)


def _clip(pictures: Sequence[Image], *, low: bool) -> bytes:
    """Encode an animated WebP that plays in a loop."""
    from PIL import Image as Pillow

    first, *rest = (Pillow.fromarray(_small(p) if low else p) for p in pictures)
    stream = io.BytesIO()
    first.save(
        stream,
        "WEBP",
        save_all=True,
        append_images=rest,
        duration=round(1000 / _RATE),
        loop=0,
        lossless=not low,
        quality=_LOW_QUALITY if low else 50,
        method=2,
    )
    return stream.getvalue()


_SCAN_DEG = 0.2  # degrees of azimuth and elevation per cell
_SCAN_VIEW = ((-40.0, 40.0), (-30.0, 24.0))
_SCAN_EDGE = 0.25  # metres; triangles with longer edges are left out
_PLACES = 8  # random places that are tried for each object or dent
_OBJECTS = ("head", "rocker", "lifeboat")


def _scan_surface(truth: str, seed: int) -> Image:
    """Render a terrestrial scan, meshed along its angular grid, grey and lit from the viewer."""
    from manip3d import Intrinsics, simplify
    from manip3d.simulate import scenes, terrestrial_scan
    from manip3d.viewer.people import surface_picture

    random = np.random.default_rng(seed)
    scene = scenes.make(f"indoor-{int(random.integers(17)):02d}")
    scan = terrestrial_scan(scene, resolution_deg=_SCAN_DEG, field_of_view=_SCAN_VIEW, rng=random)
    points = scan.points
    grid, valid, _ = _grid(points.astype(np.float64))
    if truth == "added":
        grid, valid = _with_object(points, grid, valid, random)
    elif truth == "deformed":
        grid = _with_dent(grid, valid, random)
    mesh = simplify.dense_mesh_grid(grid, valid, max_edge=_SCAN_EDGE)
    seen = np.stack([-mesh.vertices[:, 1], -mesh.vertices[:, 2], mesh.vertices[:, 0]], axis=1)
    camera = Intrinsics(640, 440, 420.0, 420.0, 319.5, 219.5)
    return surface_picture(
        np.ascontiguousarray(seen, np.float32),
        mesh.faces,
        np.zeros((len(seen), 2), np.float32),
        None,
        camera,
        azimuth=8.0,
    )


def _with_object(
    points: NDArray[np.float32],
    grid: NDArray[np.float64],
    valid: NDArray[np.bool_],
    random: np.random.Generator,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Add an object on the floor to the grid, sampled as by the scanner (CRTP)."""
    from manip3d import forge
    from manip3d.simulate import models

    made = models.MODELS[_OBJECTS[int(random.integers(len(_OBJECTS)))]]().vertices
    vertices = np.stack([made[:, 2], made[:, 0], made[:, 1]], axis=1)  # from y up to z up
    scale = float(random.uniform(0.35, 0.7)) / float(np.ptp(vertices, axis=0).max())
    stands = _level_places(grid)
    most = 0
    for _ in range(_PLACES):  # keep the place where most of the object is visible
        place = stands[int(random.integers(len(stands)))].copy()
        place[2] += scale * float(vertices[:, 2].mean() - vertices[:, 2].min())
        forged = forge.crtp(points, vertices, position=place, scale=scale)
        found, there, owner = _grid(forged.points[:, :3].astype(np.float64))
        seen_cells = int(np.isin(owner, forged.added).sum())
        if seen_cells > most:
            most, grid, valid = seen_cells, found, there
    return grid, valid


_DENT_RADIUS = (0.25, 0.45)  # smallest and largest radius of the deformed part, metres
_DENT_DEPTH = (0.08, 0.15)  # smallest and largest depth of a dent or height of a bulge, metres
_DENT_SEEN = 0.02  # smallest displacement of a cell that counts as deformed, metres


def _with_dent(
    grid: NDArray[np.float64], valid: NDArray[np.bool_], random: np.random.Generator
) -> NDArray[np.float64]:
    """Deform a part of the surface in the grid by a dent or a bulge.

    Ranges change smoothly along the scanner's own rays, so that every point stays in its cell.
    """
    inside = np.zeros_like(valid)
    height, width = valid.shape
    inside[height // 6 : -height // 4, width // 5 : -width // 5] = True
    places = grid[valid & inside]
    radius = float(random.uniform(*_DENT_RADIUS))
    depth = float(random.uniform(*_DENT_DEPTH)) * (1.0 if random.random() < 0.5 else -1.0)
    shift, most = np.zeros(valid.shape), 0
    for _ in range(_PLACES):  # keep the place where most of the deformation is visible
        place = places[int(random.integers(len(places)))]
        away = np.minimum(np.linalg.norm(grid - place, axis=-1) / radius, 1.0)
        own = depth * np.cos(0.5 * np.pi * away) ** 2
        if (count := int((np.abs(own) > _DENT_SEEN).sum())) > most:
            shift, most = own, count
    deformed: NDArray[np.float64] = grid * (1.0 + shift / np.linalg.norm(grid, axis=-1))[..., None]
    return deformed


def _level_places(grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points of level surfaces, such as floors and tables, in the middle of the view."""
    step = np.abs(np.diff(grid, axis=0))
    # From one row to the next the distance changes, but not the height.
    level = (step[..., 2] < 0.02) & (step[..., :2].max(axis=-1) > 0.02)
    inside = np.zeros_like(level)
    height, width = level.shape
    inside[height // 6 : height // 2, width // 5 : -width // 5] = True
    found: NDArray[np.float64] = grid[:-1][level & inside]
    return found


def _grid(
    points: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.int64]]:
    """Sort points into the cells of the angular grid, with rows upwards.

    Return the nearest point of each cell, whether the cell has a point, and the point's index.
    """
    (left, right), (low, high) = _SCAN_VIEW
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    # Columns grow from left to right as in an image, but azimuth grows to the left.
    column = np.floor((right - azimuth) / _SCAN_DEG).astype(np.int64)
    row = np.floor((elevation - low) / _SCAN_DEG).astype(np.int64)
    width, height = round((right - left) / _SCAN_DEG), round((high - low) / _SCAN_DEG)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    kept = np.flatnonzero(inside)
    # Sort from far to near, so that nearer points overwrite farther ones.
    kept = kept[np.argsort(-np.linalg.norm(points[kept], axis=1), kind="stable")]
    grid = np.full((height, width, 3), np.nan)
    grid[row[kept], column[kept]] = points[kept]
    owner = np.full((height, width), -1, np.int64)
    owner[row[kept], column[kept]] = kept
    return grid, owner >= 0, owner
