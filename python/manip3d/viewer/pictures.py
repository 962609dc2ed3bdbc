"""Off-screen pictures of meshes, and contact sheets of several from one camera."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from manip3d.errors import InputError
from manip3d.mesh import Mesh
from manip3d.viewer import _chromium, _pyvista
from manip3d.viewer.renderer import renderer
from manip3d.viewer.scene import BACKGROUND, Camera, Style, frame, pillow, rgb

if TYPE_CHECKING:
    from manip3d.viewer.scene import Image, Rgb, Shading, Up

DRAW: dict[str, Callable[[Mesh, Camera, Style], Image]] = {
    "pyvista": _pyvista.draw,
    "chromium": _chromium.draw,
}


def picture(
    mesh: Mesh,
    *,
    size: tuple[int, int] = (800, 600),
    azimuth: float = 30.0,
    elevation: float = 20.0,
    zoom: float = 1.0,
    up: Up = "y",
    shading: Shading = "smooth",
    texture: bool = True,
    wireframe: bool = False,
    boundary: bool = False,
    backfaces: bool = True,
    background: str | Rgb = BACKGROUND,
) -> Image:
    """Draw a mesh off-screen, lit from both sides, filling the picture.

    Parameters
    ----------
    mesh : Mesh
    size : (width, height), pixels
    azimuth : float, degrees
        0 looks at the mesh's front (from +z, or from -y if ``up='z'``), 90 from +x.
    elevation : float, degrees in [-90, 90]
        How far the camera stands above the horizon.
    zoom : float
        1 just holds the mesh; 2 shows its middle twice as large.
    up : 'y' or 'z'
        The mesh's upward axis.
    shading : 'smooth' or 'flat'
        ``smooth`` uses the file's normals, else averages over edges flatter than 40 degrees;
        ``flat`` gives each triangle its own shade.
    texture : bool
        ``False`` draws the shape alone, in grey: no textures, materials or vertex colours.
    wireframe : bool
        Draw the triangles' edges too.
    boundary : bool
        Draw, in red, the edges that exactly one face uses once equal positions are one.
    backfaces : bool
        ``False`` leaves out faces seen from behind, as games do: for models with an outline
        shell, which would hide everything else.
    background : '#rrggbb' or (r, g, b) of 0 to 255

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
    """
    style = Style(size, shading, texture, wireframe, boundary, backfaces, rgb(background))
    camera = frame(mesh, style.size, azimuth, elevation, zoom, up)
    return DRAW[renderer()](mesh, camera, style)


def comparison(
    meshes: Sequence[Mesh],
    labels: Sequence[str] | None = None,
    *,
    columns: int | None = None,
    size: tuple[int, int] = (480, 400),
    azimuth: float = 30.0,
    elevation: float = 20.0,
    zoom: float = 1.0,
    up: Up = "y",
    shading: Shading = "smooth",
    texture: bool = True,
    wireframe: bool = False,
    boundary: bool = False,
    backfaces: bool = True,
    background: str | Rgb = BACKGROUND,
) -> Image:
    """Pictures of several meshes side by side, all from the camera that frames the first.

    Parameters
    ----------
    meshes : sequence of Mesh
        The first, usually the original, decides where the camera stands.
    labels : sequence of str, optional
        A caption above each; default: the number of faces.
    columns : int, optional
        Pictures per row; default: all in one row, at most four.
    size : (width, height), pixels
        Of one picture, without its caption.
    azimuth, elevation, zoom, up, shading, texture, wireframe, boundary, backfaces, background
        As for `picture`.

    Returns
    -------
    (H, W, 3) uint8, sRGB
        The contact sheet.

    Raises
    ------
    InputError, RenderError
        As `picture`; or the number of labels is not that of meshes.
    """
    if labels is None:
        labels = [f"{mesh.num_faces:,} faces" for mesh in meshes]
    if not meshes or len(labels) != len(meshes):
        raise InputError(
            f"labels: expected one for each of at least one mesh, got {len(labels)} labels "
            f"for {len(meshes)} meshes"
        )
    columns = min(len(meshes), 4) if columns is None else columns
    if columns < 1:
        raise InputError(f"columns: expected at least 1, got {columns}")
    style = Style(size, shading, texture, wireframe, boundary, backfaces, rgb(background))
    camera = frame(meshes[0], style.size, azimuth, elevation, zoom, up)
    draw = DRAW[renderer()]
    cells = [
        np.vstack([_caption(label, style), draw(mesh, camera, style)])
        for mesh, label in zip(meshes, labels, strict=True)
    ]
    blank = np.full_like(cells[0], style.background)
    cells += [blank] * (-len(cells) % columns)
    return np.vstack([np.hstack(cells[i : i + columns]) for i in range(0, len(cells), columns)])


def _caption(label: str, style: Style) -> Image:
    """A strip with the label in its middle."""
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


def png_bytes(image: Image) -> bytes:
    """The PNG file of an (H, W, 3) uint8 picture."""
    stream = io.BytesIO()
    pillow().fromarray(image).save(stream, format="PNG", optimize=True)
    return stream.getvalue()
