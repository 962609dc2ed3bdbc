"""Pictures of people in RGB-D frames: depth, bones, and the person with a phantom limb."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.camera import Intrinsics
    from manip3d.modify import PhantomFrame
    from manip3d.rgbd import RgbdFrame
    from manip3d.viewer.scene import Image

__all__ = [
    "depth_picture",
    "label_picture",
    "mesh_picture",
    "phantom_sheet",
    "surface_picture",
    "textured_picture",
]

_GREY = 200
"""Grey of points without a colour."""


def depth_picture(
    depth: NDArray[Any], *, near: float | None = None, far: float | None = None
) -> Image:
    """Draw a depth image in grey: near pixels are light, pixels without depth black.

    Parameters
    ----------
    depth : (H, W)
        Depth in any unit; 0: no measurement.
    near, far : float, optional
        Ends of the grey scale, in the same unit. Default: 98 % of the pixels lie between them.
    """
    there = depth > 0
    if near is None or far is None:
        ends = np.quantile(depth[there], [0.01, 0.99]) if there.any() else (0.0, 1.0)
        near = float(ends[0]) if near is None else near
        far = float(ends[1]) if far is None else far
    way = np.clip((depth.astype(np.float64) - near) / max(far - near, 1e-9), 0.0, 1.0)
    grey = np.where(there, 245.0 - 190.0 * way, 0.0).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def label_picture(labels: NDArray[np.uint8]) -> Image:
    """Draw a label image with a colour for each bone; black: no bone."""
    hue = (np.arange(256) * 0.381966) % 1.0  # steps of the golden angle, so that neighbours differ
    turn = (hue[:, None] + np.array([0.0, 2.0, 1.0]) / 3.0) % 1.0
    palette = 255.0 * np.clip(np.abs(6.0 * turn - 3.0) - 1.0, 0.15, 0.95)
    palette[0] = 0.0
    return np.asarray(palette[labels], np.uint8)


def textured_picture(
    phantom: PhantomFrame,
    color: Image | None,
    *,
    with_phantom: bool = True,
    phantom_color: Image | None = None,
) -> Image:
    """Draw the person as seen by the camera, on white.

    Parameters
    ----------
    phantom : PhantomFrame
    color : (H', W', 3) uint8, optional
        Colour image of the frame; default: everything is grey.
    with_phantom : bool
        Draw the phantom. If false, draw only the measured person without the affected limb.
    phantom_color : (H', W', 3) uint8, optional
        Colour image of frame ``phantom.texture_number``, which differs from ``color`` while the
        phantom is held. Default: the image in ``phantom``.
    """
    phantom_color = _color_of_phantom(phantom, color, phantom_color)
    count = phantom.num_points
    column, row = phantom.pixels[:count].T
    colors = _looked_up(phantom.texcoords[:count], color)
    is_phantom = phantom.phantom[row, column]
    colors[is_phantom] = _looked_up(phantom.texcoords[:count][is_phantom], phantom_color)
    shown = slice(None) if with_phantom else ~is_phantom
    picture = np.full((*phantom.depth.shape, 3), 255, np.uint8)
    picture[row[shown], column[shown]] = colors[shown]
    return picture


def _color_of_phantom(
    phantom: PhantomFrame, color: Image | None, phantom_color: Image | None
) -> Image | None:
    """Return the image that the phantom's texture coordinates refer to; None: it is grey."""
    if phantom_color is not None or color is None:
        return phantom_color
    if phantom.color is None and phantom.phantom_color is None:
        return color  # the pipeline got no colour images, unlike the caller
    return phantom.phantom_color


def _looked_up(texcoords: NDArray[np.float32], color: Image | None) -> Image:
    """Return the colours at texture coordinates (N, 2), v up."""
    if color is None:
        return np.full((len(texcoords), 3), _GREY, np.uint8)
    height, width = color.shape[:2]
    known = ~np.isnan(texcoords[:, 0])
    at = np.where(known[:, None], texcoords, 0.0)
    column = (at[:, 0] * width).astype(np.int64).clip(0, width - 1)
    row = ((1.0 - at[:, 1]) * height).astype(np.int64).clip(0, height - 1)
    return np.where(known[:, None], color[row, column], np.uint8(_GREY))


def mesh_picture(
    phantom: PhantomFrame,
    color: Image | None,
    camera: Intrinsics,
    *,
    phantom_color: Image | None = None,
    azimuth: float = 35.0,
    threads: int = 0,
) -> Image:
    """Draw the textured mesh, rotated about the vertical axis through its centre, on white.

    Parameters
    ----------
    phantom : PhantomFrame
    color : (H', W', 3) uint8, optional
        Colour image of the frame; default: the mesh is grey.
    camera : Intrinsics
        The depth camera, whose size the picture has.
    phantom_color : (H', W', 3) uint8, optional
        Same as for `textured_picture`.
    azimuth : float, degrees
        Angle of the rotation; positive: seen from the camera's right.
    threads : int
        Number of threads; 0: ``MANIP3D_THREADS`` if it is set, otherwise all cores.

    Raises
    ------
    MissingExtraError
        Open3D is not installed: ``pip install 'manip3d[simulate]'``.
    """
    images = (color, _color_of_phantom(phantom, color, phantom_color))
    surface = (phantom.vertices, phantom.faces, phantom.texcoords)
    return _drawn(
        *surface, images, phantom.phantom_faces, camera=camera, azimuth=azimuth, threads=threads
    )


def surface_picture(
    vertices: NDArray[np.float32],
    faces: NDArray[np.int32],
    texcoords: NDArray[np.float32],
    color: Image | None,
    camera: Intrinsics,
    *,
    azimuth: float = 35.0,
    threads: int = 0,
) -> Image:
    """Draw a textured surface, rotated about the vertical axis through its centre, on white.

    Parameters
    ----------
    vertices : (n, 3) float32, metres
        Vertices in the frame of the depth camera.
    faces : (m, 3) int32
    texcoords : (n, 2) float32
        Texture coordinates of each vertex.
    color, camera, azimuth, threads
        Same as for `mesh_picture`.

    Raises
    ------
    MissingExtraError
        Open3D is not installed: ``pip install 'manip3d[simulate]'``.
    """
    one = np.zeros(len(faces), np.bool_)
    return _drawn(
        vertices, faces, texcoords, (color, color), one,
        camera=camera, azimuth=azimuth, threads=threads,
    )  # fmt: skip


def _drawn(
    vertices: NDArray[np.float32],
    faces: NDArray[np.int32],
    texcoords: NDArray[np.float32],
    images: tuple[Image | None, Image | None],
    is_second: NDArray[np.bool_],
    *,
    camera: Intrinsics,
    azimuth: float,
    threads: int,
) -> Image:
    """Draw a surface of two parts, each with its own colour image; ``is_second`` (m,) of faces."""
    from manip3d.simulate._raycast import CHUNK, RayCaster

    size = (camera.height, camera.width)
    picture = np.full((*size, 3), 255, np.uint8)
    if not len(faces):
        return picture
    placed = vertices.astype(np.float64)
    middle = np.median(placed, axis=0)
    angle = np.deg2rad(azimuth)
    turn = np.array(
        [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
    )
    caster = RayCaster((placed - middle) @ turn.T + middle, faces)
    rays = camera.unproject(np.ones(size, np.float32)).reshape(-1, 3)
    flat = picture.reshape(-1, 3)
    for start in range(0, len(rays), CHUNK):
        part = rays[start : start + CHUNK]
        hits = caster.cast(np.zeros(3, np.float32), part, threads=threads)
        hit = np.flatnonzero(np.isfinite(hits.distance))
        face = hits.face[hit].astype(np.int64)
        corners = texcoords[faces[face]]
        at = corners[:, 0] + hits.uv[hit, :1] * (corners[:, 1] - corners[:, 0])
        at += hits.uv[hit, 1:] * (corners[:, 2] - corners[:, 0])
        slant = np.abs((hits.normal[hit] * part[hit]).sum(axis=1))
        slant /= np.linalg.norm(part[hit], axis=1)
        for which, color in zip((~is_second[face], is_second[face]), images, strict=True):
            shade = 0.6 + 0.4 * slant[which] if color is None else np.ones(which.sum())
            flat[start + hit[which]] = _looked_up(at[which], color) * shade[:, None]
    return picture


def phantom_sheet(
    frame: RgbdFrame,
    phantom: PhantomFrame,
    *,
    phantom_color: Image | None = None,
    azimuth: float = 35.0,
    threads: int = 0,
) -> Image:
    """Draw the camera's image, the person with the phantom, and the mesh from the side.

    Parameters
    ----------
    frame : RgbdFrame
    phantom : PhantomFrame
        Result of `manip3d.modify.PhantomPipeline` for the frame.
    phantom_color : (H', W', 3) uint8, optional
        Same as for `textured_picture`.
    azimuth : float, degrees
        Same as for `mesh_picture`.
    threads : int
        Number of threads; 0: ``MANIP3D_THREADS`` if it is set, otherwise all cores.

    Returns
    -------
    (H, 3 W, 3) uint8
        Three pictures of H x W pixels side by side, the size of the depth image. If there is no
        colour image with the depth image's pixels, the first picture shows the depth.

    Raises
    ------
    InputError
        The frames are of different sizes.
    MissingExtraError
        As `mesh_picture`.
    """
    if frame.depth.shape != phantom.depth.shape:
        raise InputError(
            f"phantom: expected images of {frame.depth.shape}, got {phantom.depth.shape}"
        )
    color = frame.color
    if color is not None and color.shape[:2] == frame.depth.shape:
        seen: Image = color
    else:
        seen = depth_picture(frame.depth)
    if color is None:
        person = depth_picture(phantom.depth)
    else:
        person = textured_picture(phantom, color, phantom_color=phantom_color)
    camera = frame.calibration.depth
    mesh = mesh_picture(
        phantom, color, camera, phantom_color=phantom_color, azimuth=azimuth, threads=threads
    )
    return np.concatenate([seen, person, mesh], axis=1)
