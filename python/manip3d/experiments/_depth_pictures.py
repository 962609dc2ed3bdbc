"""Pictures of chapter 3: reduced meshes, chosen pixels, and error maps."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.json import canonical_json
from manip3d.experiments import _pictures
from manip3d.experiments._depth import SHORT, RangeInput, open_input
from manip3d.experiments._model import Row, Sheet
from manip3d.experiments._store import unpack_mesh
from manip3d.io._files import atomic_write
from manip3d.mesh import Mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

_VIEW: dict[str, Any] = {"azimuth": 12.0, "elevation": 8.0, "zoom": 0.95}
_SOURCE = ("source", "width", "kind")
_Draw = Callable[[str, Mapping[str, Any]], list[dict[str, Any]]]


def sheets(rows: Sequence[Row]) -> dict[str, Sheet]:
    """Return a sheet of the reduced meshes for each range image."""
    return _sheets(rows, draw_meshes, "reduced", "")


def error_sheets(rows: Sequence[Row]) -> dict[str, Sheet]:
    """Return a sheet of error maps for each range image."""
    about = "distance from each vertex of the dense mesh: dark blue 0, yellow 2e-3 of the diagonal"
    return _sheets(rows, draw_errors, "reduced", about)


def point_sheets(rows: Sequence[Row]) -> dict[str, Sheet]:
    """Return a sheet of chosen pixels over the depth image for each range image."""
    return _sheets(rows, draw_points, "pixels", "the chosen pixels over the depth")


def _sheets(rows: Sequence[Row], draw: _Draw, name: str, about: str) -> dict[str, Sheet]:
    found: dict[str, Sheet] = {}
    files: dict[str, dict[str, str]] = {}
    for row in rows:
        if not row.get(name):
            continue
        title = f"{row['experiment']}, {row['model']}"
        label = row.get("label") or SHORT.get(row["method"], row["method"])
        files.setdefault(title, {})[f"{label}, {row['points']} vertices"] = row[name]
        options = {key: row[key] for key in _SOURCE} | {"files": files[title]}
        said = " · ".join(filter(None, (row["role"], about)))
        found[title] = Sheet(said, draw, options)
    return found


def draw_meshes(folder: str, options: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Draw the dense mesh and each method's mesh, in grey and with the colour image."""
    image = open_input(options)
    dense = image.dense().mesh
    labels, meshes, identity = _unpacked(folder, options, dense)
    styles = ("shaded", "textured") if image.color is not None else ("shaded",)
    everything = [_upright(mesh, image) for mesh in (dense, *meshes)]
    return _pictures.draw_set(
        Path(folder), identity, ["original", *labels], everything, styles, **_VIEW
    )


def draw_errors(folder: str, options: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Draw the dense mesh, coloured by the distance of its vertices from each method's mesh."""
    from manip3d import metrics

    image = open_input(options)
    dense = image.dense().mesh
    labels, meshes, identity = _unpacked(folder, options, dense)
    diagonal = float(np.linalg.norm(np.ptp(dense.vertices, axis=0)))
    colored = []
    for mesh in meshes:
        distance = metrics.closest_points(mesh, dense.vertices).distance / diagonal
        colored.append(Mesh(dense.vertices, dense.faces, colors=_heat(distance / _LARGEST_ERROR)))
    everything = [_upright(mesh, image) for mesh in colored]
    items = _pictures.draw_set(
        Path(folder), [*identity, "errors"], labels, everything, ("textured",), **_VIEW
    )
    for item, mesh in zip(items, meshes, strict=True):
        item["faces"] = mesh.num_faces
    return items


_LARGEST_ERROR = 2e-3
_HEAT = np.array([[34, 30, 90], [40, 110, 140], [90, 180, 110], [250, 230, 60]], dtype=float)


def _heat(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return colours of values from 0 to 1; larger values are lighter."""
    at = np.clip(values, 0.0, 1.0) * (len(_HEAT) - 1)
    channels = [np.interp(at, np.arange(len(_HEAT)), channel) for channel in _HEAT.T]
    return np.stack(channels, axis=1).astype(np.uint8)


def draw_points(folder: str, options: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Draw each method's pixels as dots over the depth image, cropped to the measured pixels."""
    root = Path(folder)
    image = open_input(options)
    shade = _depth_shade(image)
    rows, columns = (np.flatnonzero(image.measured.any(axis=axis)) for axis in (1, 0))
    cut = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    items = []
    for label, name in options["files"].items():
        data = (root / name).read_bytes()
        u, v = np.frombuffer(data, np.int16).reshape(-1, 2).T
        picture = np.repeat(shade[..., None], 3, axis=2)
        picture[v, u] = (150, 0, 0)
        identity = [options["source"], options["width"], hashlib.sha256(data).hexdigest()]
        digest = hashlib.sha256(canonical_json([*identity, "points, upright"])).hexdigest()[:24]
        path = f"pictures/{digest}.webp"
        (root / "pictures").mkdir(exist_ok=True)
        # Rows of a scan are counted upwards.
        shown = picture[cut] if image.points is None else picture[cut][::-1]
        atomic_write(root / path, _pictures.webp(_enlarged(shown)))
        items.append({"label": label, "faces": 0, "shaded": path})
    return items


def _enlarged(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Enlarge each pixel to a square, on a page with the sheet's aspect ratio."""
    factor = max(2, min(960 // picture.shape[1], 800 // picture.shape[0]))
    large = picture.repeat(factor, axis=0).repeat(factor, axis=1)
    width = max(large.shape[1], large.shape[0] * 6 // 5)
    height = max(large.shape[0], width * 5 // 6)
    page = np.full((height, width, 3), 255, dtype=np.uint8)
    top, left = (height - large.shape[0]) // 2, (width - large.shape[1]) // 2
    page[top : top + large.shape[0], left : left + large.shape[1]] = large
    return page


def _depth_shade(image: RangeInput) -> NDArray[np.uint8]:
    """Return the depth as grey values: near pixels are light, pixels without depth white."""
    measured = image.measured
    if image.points is not None:
        values = -np.nan_to_num(image.points)[..., 2]
    else:
        values = np.asarray(image.depth, dtype=np.float64)
    low, high = np.percentile(values[measured], [1, 99])
    grey = 240.0 - 90.0 * np.clip((values - low) / max(high - low, 1e-12), 0.0, 1.0)
    return np.where(measured, grey, 255.0).astype(np.uint8)


def _unpacked(
    folder: str, options: Mapping[str, Any], like: Mesh
) -> tuple[list[str], list[Mesh], list[Any]]:
    """Return labels and meshes of the pictures, and the values that identify the pictures."""
    packed = {label: (Path(folder) / name).read_bytes() for label, name in options["files"].items()}
    identity = [options["source"], options["width"], _VIEW]
    identity += [hashlib.sha256(data).hexdigest() for data in packed.values()]
    return list(packed), [unpack_mesh(data, like=like) for data in packed.values()], identity


def _upright(mesh: Mesh, image: RangeInput) -> Mesh:
    """Turn a mesh from the camera's axes (z ahead, y down) to those of pictures (from +z, y up)."""
    if image.depth is None:
        return mesh
    return mesh.replace(vertices=mesh.vertices * np.array([1.0, -1.0, -1.0]))
