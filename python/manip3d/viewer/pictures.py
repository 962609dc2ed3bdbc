"""Off-screen pictures of meshes and points, and contact sheets with a common camera."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.checked import checked
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame
from manip3d.mesh import Mesh
from manip3d.viewer import _chromium, _pyvista
from manip3d.viewer.legend import with_legend
from manip3d.viewer.points import DrawnPoints, drawn_points
from manip3d.viewer.renderers import renderer
from manip3d.viewer.scene import (
    BACKGROUND,
    OBLIQUE,
    Camera,
    Style,
    camera_place,
    frame,
    frame_points,
    pillow,
    rgb,
)
from manip3d.viewer.sensor_points import scan_points
from manip3d.viewer.showing import Shown, shown

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike

    from manip3d.lidar import Box
    from manip3d.viewer.scene import Image, Rgb, Shading, Up

MAX_POINTS = 4_000_000
"""Largest number of points that are drawn; more cannot be distinguished in a picture."""

DRAW: dict[str, Callable[[Shown, Camera, Style], Image]] = {
    "pyvista": _pyvista.draw,
    "chromium": _chromium.draw,
}


@checked
def picture(
    thing: Any,
    *,
    size: tuple[int, int] = (800, 600),
    azimuth: float | None = None,
    elevation: float | None = None,
    zoom: float = 1.0,
    up: Up | None = None,
    place: str | None = None,
    color_by: str | None = None,
    legend: bool = True,
    shading: Shading = "smooth",
    texture: bool = True,
    wireframe: bool = False,
    boundary: bool = False,
    backfaces: bool = True,
    background: str | Rgb = BACKGROUND,
) -> Image:
    """Draw a mesh or points off-screen, filling the picture.

    Parameters
    ----------
    thing : Mesh, LidarFrame, RgbdFrame, DrawnPoints or a result
        Same as for `shown`.
    size : (width, height), pixels
    azimuth : float, degrees
        Direction of the camera. 0: from the front (from +z; from -y if ``up='z'``; from -z if
        ``up='-y'``); 90: from +x. Default for meshes: 30. If neither azimuth nor ``elevation`` nor
        ``up`` is given, the mesh of a depth image is seen from its camera, and points are seen from
        ``place``.
    elevation : float, degrees in [-90, 90]
        Angle of the camera above the horizon. Default for meshes: 20.
    zoom : float
        Magnification; 1: the mesh just fits into the picture, 2: its middle is twice as large.
    up : 'y', 'z' or '-y'
        The upward axis; ``-y`` is that of a camera (x right, y down, z ahead).
    place : str, optional
        For points only: name of one of `DrawnPoints.poses`; default: the first one.
    color_by : str, optional
        For points only: name of one of `DrawnPoints.columns`; default: the first one.
    legend : bool
        For points only: draw a legend of the colours in the lower left corner.
    shading : 'smooth' or 'flat'
        ``smooth`` uses the file's normals or, without normals, averages over edges flatter than 40
        degrees; ``flat`` shades each triangle with its own normal.
    texture : bool
        If false, draw only the shape in grey, without textures, materials and vertex colours.
    wireframe : bool
        Also draw the triangles' edges.
    boundary : bool
        Draw in red the boundary edges: edges of exactly one face after vertices at equal positions
        are merged.
    backfaces : bool
        Draw faces that are seen from behind. Without them, as in games, models with an outline
        shell show what is inside the shell.
    background : '#rrggbb' or (r, g, b), whole numbers of 0 to 255
        Background colour.

    Returns
    -------
    (height, width, 3) uint8, sRGB

    Raises
    ------
    InputError
        An option out of range.
    RenderError
        Nothing can draw here; the message names the cure.

    Warns
    -----
    UserWarning
        A texture cannot be read; its material's base colour is shown instead.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Mesh, viewer
    >>> triangle = Mesh(np.eye(3), [[0, 1, 2]])
    >>> viewer.picture(triangle, size=(320, 240)).shape  # doctest: +SKIP
    (240, 320, 3)
    """
    style = Style(size, shading, texture, wireframe, boundary, backfaces, rgb(background))
    one = _ready(thing, color_by)
    camera = _camera(one, style.size, zoom, place, azimuth, elevation, up)
    return _drawn(one, camera, style, legend=legend)


@checked
def points_picture(
    points: LidarFrame | ArrayLike,
    *,
    colors: ArrayLike | None = None,
    boxes: Sequence[Box] | Mapping[str, Sequence[Box]] = (),
    **options: Any,
) -> Image:
    """Draw points with colours and boxes off-screen.

    Parameters
    ----------
    points : LidarFrame or (N, 3) numbers, metres
        Points. A frame is seen from behind and above its scanner.
    colors : (N, 3) uint8, optional
        R, G, B of each point; default: colours show the height.
    boxes : sequence of Box, or mapping of str to sequence of Box
        Boxes, drawn as lines with a colour for each label or key.
    **options
        Options of `picture`.

    Returns
    -------
    (height, width, 3) uint8, sRGB

    Raises
    ------
    InputError, RenderError
        As `picture`; or ``colors`` has another shape.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Box, viewer
    >>> points = np.random.default_rng(0).normal(size=(1000, 3))
    >>> box = Box((0, 0, 0), (2, 2, 2), label="middle")
    >>> viewer.points_picture(points, boxes=[box], size=(320, 240)).shape  # doctest: +SKIP
    (240, 320, 3)
    """
    if isinstance(points, LidarFrame):
        if colors is None:
            return picture(scan_points(points, boxes=boxes), **options)
        cloud = drawn_points(points.points, colors=colors, boxes=boxes, origin=points.origin)
    else:
        cloud = drawn_points(points, colors=colors, boxes=boxes)
    return picture(cloud, **options)


def _ready(thing: Any, color_by: str | None) -> Shown:
    one = shown(thing)
    if isinstance(one, DrawnPoints):
        return one.colored_by(color_by).thinned(MAX_POINTS)
    return one


def _camera(
    thing: Shown,
    size: tuple[int, int],
    zoom: float,
    place: str | None,
    azimuth: float | None,
    elevation: float | None,
    up: Up | None,
) -> Camera:
    is_free = azimuth is None and elevation is None and up is None
    if isinstance(thing, Mesh):
        stood = camera_place(thing) if is_free else None
        if stood is not None:
            return stood.camera(thing.bounds, size, zoom)
        seen = OBLIQUE.but(azimuth, elevation, up)
        return frame(thing, size, *seen[:2], zoom, seen.up)
    pose = thing.pose(place)
    if is_free and pose is not None:
        return pose.camera(thing.bounds, size, zoom)
    seen = thing.direction.but(azimuth, elevation, up)
    return frame_points(thing.bulk(), size, *seen[:2], zoom, seen.up)


def _drawn(thing: Shown, camera: Camera, style: Style, *, legend: bool) -> Image:
    image = DRAW[renderer()](thing, camera, style)
    if legend and isinstance(thing, DrawnPoints):
        return with_legend(image, thing, style.background)
    return image


@checked
def comparison(
    things: Sequence[Any],
    labels: Sequence[str] | None = None,
    *,
    columns: int | None = None,
    size: tuple[int, int] = (480, 400),
    azimuth: float | None = None,
    elevation: float | None = None,
    zoom: float = 1.0,
    up: Up | None = None,
    place: str | None = None,
    color_by: str | None = None,
    legend: bool = True,
    shading: Shading = "smooth",
    texture: bool = True,
    wireframe: bool = False,
    boundary: bool = False,
    backfaces: bool = True,
    background: str | Rgb = BACKGROUND,
) -> Image:
    """Draw several objects side by side, all from the camera that frames the first one.

    Parameters
    ----------
    things : sequence of Mesh, LidarFrame, RgbdFrame, DrawnPoints or results
        Objects; the first one, usually the original, determines the camera.
    labels : sequence of str, optional
        A caption above each object; default: the number of faces or points.
    columns : int, optional
        Pictures per row; default: all in one row, at most four.
    size : (width, height), pixels
        Size of one picture, without its caption.
    azimuth, elevation, zoom, up, place, color_by, legend
        Same as for `picture`.
    shading, texture, wireframe, boundary, backfaces, background
        Same as for `picture`.

    Returns
    -------
    (H, W, 3) uint8, sRGB
        The contact sheet.

    Raises
    ------
    InputError, RenderError
        As `picture`; or the numbers of labels and of objects differ.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Mesh, viewer
    >>> triangle = Mesh(np.eye(3), [[0, 1, 2]])
    >>> sheet = viewer.comparison([triangle, triangle], ["before", "after"])  # doctest: +SKIP
    >>> sheet.shape[1]  # two pictures of 480 pixels  # doctest: +SKIP
    960
    """
    every = [_ready(thing, color_by) for thing in things]
    if labels is None:
        labels = [_count(one) for one in every]
    if not every or len(labels) != len(every):
        raise InputError(
            f"labels: expected one for each of at least one mesh, got {len(labels)} labels "
            f"for {len(every)} meshes"
        )
    columns = min(len(every), 4) if columns is None else columns
    if columns < 1:
        raise InputError(f"columns: expected at least 1, got {columns}")
    style = Style(size, shading, texture, wireframe, boundary, backfaces, rgb(background))
    camera = _camera(every[0], style.size, zoom, place, azimuth, elevation, up)
    cells = [
        np.vstack([_caption(label, style), _drawn(one, camera, style, legend=legend)])
        for one, label in zip(every, labels, strict=True)
    ]
    blank = np.full_like(cells[0], style.background)
    cells += [blank] * (-len(cells) % columns)
    return np.vstack([np.hstack(cells[i : i + columns]) for i in range(0, len(cells), columns)])


def _count(thing: Shown) -> str:
    return f"{thing.num_faces:,} faces" if isinstance(thing, Mesh) else thing.detail


def _caption(label: str, style: Style) -> Image:
    """Draw a strip with a centred label."""
    module = pillow()
    from PIL import ImageDraw, ImageFont

    height = 30
    strip = module.new("RGB", (style.size[0], height), style.background)
    ink = (30, 34, 40) if sum(style.background) > 384 else (230, 233, 238)
    ImageDraw.Draw(strip).text(
        (style.size[0] / 2, height / 2),
        label,
        fill=ink,
        font=ImageFont.load_default(size=15),
        anchor="mm",
    )
    return np.asarray(strip)


@checked
def png_bytes(image: Image) -> bytes:
    """Return the PNG file of a picture.

    Parameters
    ----------
    image : (H, W), (H, W, 3) or (H, W, 4) uint8
        Grey; R, G, B, as returned by `picture`; or R, G, B and opacity.

    Returns
    -------
    bytes

    Raises
    ------
    InputError
        ``image`` has another shape or dtype.
    MissingExtraError
        Pillow is not installed.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import viewer
    >>> viewer.png_bytes(np.zeros((4, 4, 3), np.uint8))[1:4]
    b'PNG'
    """
    if not (
        isinstance(image, np.ndarray)
        and image.dtype == np.uint8
        and image.shape[2:] in ((), (3,), (4,))
        and image.ndim > 1
        and image.size
    ):
        raise InputError("image: expected a picture, (H, W), (H, W, 3) or (H, W, 4) uint8")
    stream = io.BytesIO()
    pillow().fromarray(image).save(stream, format="PNG", optimize=True)
    return stream.getvalue()
