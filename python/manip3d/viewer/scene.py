"""Common parts of all renderers: options, camera, edges, materials and textures."""

from __future__ import annotations

import io
import math
import operator
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.extras import imported
from manip3d._util.linear import product
from manip3d._util.options import threads_of
from manip3d.errors import FormatError, InputError
from manip3d.io import texture_path
from manip3d.io._files import regular_bytes
from manip3d.mesh import Material, Mesh, Texture

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Image = NDArray[np.uint8]
    Points = NDArray[np.float64]

Up = Literal["y", "z", "-y"]
Shading = Literal["smooth", "flat"]
Rgb = tuple[int, int, int]

CLAY = (0.74, 0.76, 0.79)  # sRGB colour of surfaces without a colour
BACKGROUND = "#f5f6f8"
MAX_SIDE = 4096  # largest width and height of a picture, pixels
CREASE_ANGLE = 40.0  # degrees; edges with a smaller angle are shaded smoothly
VIEW_ANGLE = 30.0  # vertical field of view, degrees; small, for little perspective distortion
MARGIN = 1.06  # ratio of the picture's size to that of the mesh in it
WIDEST_VIEW = 3.0  # tangent of half the widest field of view of a depth camera, 143 degrees
SEEN_SHARE = 0.999  # share of a depth mesh's faces that face its camera; rounding flips slivers


def rgb(color: str | Rgb) -> Rgb:
    """Return red, green and blue, 0 to 255, of a colour ``'#rrggbb'`` or (r, g, b).

    Raises
    ------
    InputError
        The text is no such colour, or a number is not whole or out of range.
    """
    try:
        if isinstance(color, str):
            if len(color) != 7 or color[0] != "#":
                raise ValueError
            color = (int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16))
        # Fractions are refused, because 0.9 of 1, which some libraries expect, would become black.
        red, green, blue = map(operator.index, color)
        if not all(0 <= c <= 255 for c in (red, green, blue)):
            raise ValueError
    except (TypeError, ValueError):
        raise InputError(
            f"background: expected '#rrggbb' or (r, g, b), whole numbers of 0 to 255, got {color!r}"
        ) from None
    return red, green, blue


@checked
@dataclass(frozen=True)
class Style:
    """Options of a picture, which `manip3d.viewer.picture` describes."""

    size: tuple[int, int] = (800, 600)
    shading: Shading = "smooth"
    texture: bool = True
    wireframe: bool = False
    boundary: bool = False
    backfaces: bool = True
    background: Rgb = (245, 246, 248)

    def __post_init__(self) -> None:
        if len(self.size) != 2 or not all(1 <= n <= MAX_SIDE for n in self.size):
            raise InputError(
                f"size: expected (width, height) of 1 to {MAX_SIDE} pixels, got {self.size}"
            )
        if self.shading not in ("smooth", "flat"):
            raise InputError(f"shading: expected 'smooth' or 'flat', got {self.shading!r}")


@dataclass(frozen=True)
class Camera:
    """A perspective camera in the mesh's coordinates; the vertical view angle is in degrees."""

    position: Points
    target: Points
    up: Points
    view_angle: float
    near: float
    far: float


@dataclass(frozen=True, eq=False)
class Pose:
    """A camera pose.

    Attributes
    ----------
    name : str
        Name in the list of poses.
    position, target : (3,) float64
        Position of the camera, and the point in the middle of its picture.
    up : 'y', 'z' or '-y'
        The upward axis.
    view_angle : float, degrees
        Vertical view angle of a picture with the aspect ratio ``aspect``.
    aspect : float
        Width divided by height. Narrower pictures get a larger angle, so that the same width is
        visible.
    """

    name: str
    position: Points
    target: Points
    up: Up
    view_angle: float
    aspect: float

    def camera(self, bounds: Points, size: tuple[int, int], zoom: float) -> Camera:
        """Return the camera at this pose, whose far clipping plane lies behind ``bounds``.

        Parameters
        ----------
        bounds : (2, 3)
            Lowest and highest corner of the scene.
        size : (int, int), pixels
            Width and height of the picture.
        zoom : float
            Magnification; 1: the view angle of the pose.

        Raises
        ------
        InputError
            ``zoom`` is not a finite number above 0.
        """
        if not (zoom > 0.0 and math.isfinite(zoom)):
            raise InputError(f"zoom: expected a number > 0, got {zoom}")
        tan = math.tan(math.radians(self.view_angle / 2.0)) / zoom
        tan *= max(1.0, self.aspect * size[1] / size[0])
        middle = 0.5 * (bounds[0] + bounds[1])
        radius = 0.5 * float(np.linalg.norm(bounds[1] - bounds[0], axis=-1))
        far = float(np.linalg.norm(self.position - middle, axis=-1)) + radius
        near = 1e-3 * float(np.linalg.norm(self.target - self.position, axis=-1))
        return Camera(
            position=self.position,
            target=self.target,
            up=up_vector(self.up),
            view_angle=2.0 * math.degrees(math.atan(tan)),
            near=near,
            far=max(1.01 * far, 2.0 * near),
        )


class Direction(NamedTuple):
    """Direction of view on an object that fills the picture; see `manip3d.viewer.picture`."""

    azimuth: float
    elevation: float
    up: Up

    def but(self, azimuth: float | None, elevation: float | None, up: Up | None) -> Direction:
        """Return the direction with the given values replaced.

        Raises
        ------
        InputError
            An angle is out of range, or ``up`` is unknown.
        """
        chosen = Direction(
            self.azimuth if azimuth is None else azimuth,
            self.elevation if elevation is None else elevation,
            self.up if up is None else up,
        )
        check_view(*chosen)
        return chosen


OBLIQUE = Direction(30.0, 20.0, "y")
"""Default direction of view on meshes."""


def up_vector(up: Up) -> Points:
    """Return (3,) the upward axis."""
    return np.array({"y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0), "-y": (0.0, -1.0, 0.0)}[up])


def check_view(azimuth: float, elevation: float, up: Up) -> None:
    """Refuse an unknown ``up`` and angles out of range."""
    if up not in ("y", "z", "-y"):
        raise InputError(f"up: expected 'y', 'z' or '-y', got {up!r}")
    if not math.isfinite(azimuth):
        raise InputError(f"azimuth: expected degrees, got {azimuth}")
    if not -90.0 <= elevation <= 90.0:
        raise InputError(f"elevation: expected degrees in [-90, 90], got {elevation}")


def _axes(azimuth: float, elevation: float, up: Up) -> Points:
    """Return (3, 3): the camera's right, up and backward axis as rows, in mesh coordinates."""
    check_view(azimuth, elevation, up)
    a, e = math.radians(azimuth), math.radians(elevation)
    right = np.array([math.cos(a), 0.0, -math.sin(a)])
    backward = np.array([math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)])
    axes = np.array([right, np.cross(backward, right), backward])
    if up == "z":  # from y up to z up: (x, y, z) -> (x, -z, y)
        axes = axes[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
    if up == "-y":  # half a turn about x: y points down, and the front is seen from -z
        axes = axes * [1.0, -1.0, -1.0]
    return axes


def frame(
    mesh: Mesh, size: tuple[int, int], azimuth: float, elevation: float, zoom: float, up: Up
) -> Camera:
    """Return the camera in direction (azimuth, elevation) whose picture the mesh just fills."""
    used = mesh.vertices[np.unique(mesh.faces)] if mesh.num_faces else np.zeros((1, 3))
    return frame_points(used, size, azimuth, elevation, zoom, up)


def frame_points(
    used: Points, size: tuple[int, int], azimuth: float, elevation: float, zoom: float, up: Up
) -> Camera:
    """Return the camera in direction (azimuth, elevation) whose picture (N, 3) points just fill.

    N > 0.
    """
    if not (zoom > 0.0 and math.isfinite(zoom)):
        raise InputError(f"zoom: expected a number > 0, got {zoom}")
    axes = _axes(azimuth, elevation, up)
    center = 0.5 * (used.min(axis=0) + used.max(axis=0))
    x, y, z = product(axes, (used - center).T)
    # At distance d a point is inside when |x| <= (d - z) tan_x and |y| <= (d - z) tan_y.
    tan_y = math.tan(math.radians(VIEW_ANGLE / 2.0))
    tan_x = tan_y * size[0] / size[1]
    nearest = float(z.max()) + 1e-3 * (float(np.ptp(used, axis=0).max()) or 1.0)
    shift = np.zeros(2)
    for _ in range(4):  # iterate, because sideways shift and distance depend on each other
        reach = np.maximum(np.abs(x - shift[0]) / tan_x, np.abs(y - shift[1]) / tan_y)
        distance = max(nearest, float((MARGIN * reach + z).max()))
        seen = (np.array([x, y]) - shift[:, None]) / (distance - z)
        shift += 0.5 * distance * (seen.min(axis=1) + seen.max(axis=1))
    target = center + product(shift, axes[:2])
    return Camera(
        position=target + distance * axes[2],
        target=target,
        up=axes[1],
        view_angle=2.0 * math.degrees(math.atan(tan_y / zoom)),
        near=0.9 * (distance - float(z.max())),
        far=1.1 * (distance - float(z.min())),
    )


def first_view(mesh: Mesh) -> Direction:
    """Return the default direction of view on a mesh.

    A mesh is taken for that of a depth image if all of its faces lie in front of the origin and
    `SEEN_SHARE` of them face it; it is seen from the camera at the origin. Every other mesh is seen
    obliquely from its front.
    """
    if not mesh.num_faces:
        return OBLIQUE
    used = mesh.vertices[np.unique(mesh.faces)]
    ahead = used[:, 2]
    if not ((ahead > 0.0).all() or (ahead < 0.0).all()):
        return OBLIQUE
    is_before = (np.abs(used[:, :2]).max(axis=1) < WIDEST_VIEW * np.abs(ahead)).all()
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    towards = -np.einsum("ij,ij->i", np.cross(b - a, c - a), (a + b + c) / 3.0)
    if not is_before or np.mean(towards >= 0.0) < SEEN_SHARE or not (towards > 0.0).any():
        return OBLIQUE
    return Direction(0.0, 0.0, "-y" if ahead[0] > 0.0 else "y")


def camera_place(mesh: Mesh) -> Pose | None:
    """Return the camera pose of the depth image that a mesh was made from; None: another mesh."""
    seen = first_view(mesh)
    if seen == OBLIQUE:
        return None
    used = mesh.vertices[np.unique(mesh.faces)]
    slopes = used[:, :2] / np.abs(used[:, 2:])
    low, high = slopes.min(axis=0), slopes.max(axis=0)
    wide, tall = np.maximum(0.5 * MARGIN * (high - low), 1e-3)
    ahead = float(np.median(used[:, 2]))
    across, down = 0.5 * abs(ahead) * (low + high)
    angle = 2.0 * math.degrees(math.atan(tall))
    target = np.array([across, down, ahead])
    return Pose("Camera", np.zeros(3), target, seen.up, angle, float(wide / tall))


def with_shading_normals(mesh: Mesh, shading: Shading) -> Mesh:
    """Return the mesh with a normal at every corner: its own, or smooth up to the crease angle."""
    if shading == "flat":
        mesh = mesh.replace(normals=None, face_normals=None)
    crease_angle = CREASE_ANGLE if shading == "smooth" else 0.0
    normals, face_normals = _core.shading_normals(mesh, crease_angle, threads_of(0))
    return mesh.replace(normals=normals, face_normals=face_normals)


def boundary_edges(mesh: Mesh) -> NDArray[np.int32]:
    """Return (E, 2) the boundary edges: edges of exactly one face after equal positions merge."""
    edges: NDArray[np.int32] = _core.welded_boundary(mesh)
    return edges


def srgb(linear: Any) -> NDArray[np.float64]:
    """Convert linear light in [0, 1] to sRGB in [0, 1] [IEC 61966-2-1]."""
    x = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
    encoded: Points = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)
    return encoded


def linear(srgb: Any) -> Points:
    """Convert sRGB in [0, 1] to linear light, the inverse of `srgb`."""
    x = np.clip(np.asarray(srgb, dtype=np.float64), 0.0, 1.0)
    decoded: Points = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
    return decoded


@dataclass(frozen=True)
class Surface:
    """Faces with the same appearance.

    Attributes
    ----------
    faces : (N,) rows of ``Mesh.faces``
    color : (3,) sRGB in [0, 1]
        Factor of texture and vertex colours.
    opacity : float in [0, 1]
    image : (H, W, 3 or 4) uint8, or None
        Base colour texture, whose alpha depends on the material's alpha mode.
    double_sided : bool
        Whether the faces are visible from behind.
    """

    faces: NDArray[np.intp]
    color: Points
    opacity: float = 1.0
    image: Image | None = None
    double_sided: bool = True


def surfaces(mesh: Mesh) -> Iterator[Surface]:
    """Yield the faces by material, those with and without texture coordinates separately.

    A material with a texture yields both surfaces, and either may be without faces. The opacity of
    the textured one is 1, because the material's alpha is in its image.
    """
    materials = np.full(mesh.num_faces, -1) if mesh.face_material is None else mesh.face_material
    images = _base_color_images(mesh)
    for index in np.unique(materials):
        faces = np.flatnonzero(materials == index)
        if index < 0 or not mesh.materials:
            yield Surface(faces, np.array(CLAY if mesh.colors is None else (1.0, 1.0, 1.0)))
            continue
        material = mesh.materials[index]
        color = srgb(material.base_color[:3])
        opacity = material.base_color[3] if material.alpha_mode == "blend" else 1.0
        image = images.get(material.textures.get("base_color"))
        if image is None or mesh.face_texcoords is None:
            yield Surface(faces, color, opacity, double_sided=material.double_sided)
            continue
        has_uv = (mesh.face_texcoords[faces] >= 0).all(axis=1)
        textured = _with_alpha(image, material)
        yield Surface(faces[has_uv], color, image=textured, double_sided=material.double_sided)
        yield Surface(faces[~has_uv], color, opacity, double_sided=material.double_sided)


def downsampled(image: Image, factor: int) -> Image:
    """Reduce an image by means over squares of ``factor`` x ``factor`` pixels."""
    height, width = (side // factor for side in image.shape[:2])
    blocks = image.reshape(height, factor, width, factor, 3)
    small: Image = np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)
    return small


def pillow() -> Any:
    """Return the module ``PIL.Image``."""
    return imported("PIL.Image", "viz")


def _base_color_images(mesh: Mesh) -> dict[Texture | None, Image | None]:
    """Read each base colour texture once; None and a warning if it cannot be read."""
    textures = (material.textures.get("base_color") for material in mesh.materials)
    return {t: _texture_image(mesh, t) for t in dict.fromkeys(textures) if t is not None}


def texture_bytes(mesh: Mesh, texture: Texture) -> bytes | None:
    """Return the content of the image file; None and a warning if it cannot be read."""
    if texture.data is not None:
        return texture.data
    try:
        path = texture_path(mesh, texture)
        if path is None:
            raise FileNotFoundError("no such file")
        return regular_bytes(path)
    except (OSError, InputError, FormatError) as error:
        _warn_unreadable(texture, error)
        return None


def _texture_image(mesh: Mesh, texture: Texture) -> Image | None:
    module = pillow()
    content = texture_bytes(mesh, texture)
    if content is None:
        return None
    try:
        with module.open(io.BytesIO(content)) as image:
            return np.asarray(image.convert("RGBA"))
    except (OSError, ValueError, module.DecompressionBombError) as error:
        _warn_unreadable(texture, error)
        return None


def _warn_unreadable(texture: Texture, error: Exception) -> None:
    warnings.warn(
        f"texture {texture.path or '(embedded)'} cannot be read, the material's base colour is "
        f"shown instead: {error}",
        stacklevel=2,
    )


def _with_alpha(image: Image, material: Material) -> Image:
    """Return the texture with alpha according to its material's alpha mode."""
    if material.alpha_mode == "opaque":
        return image[..., :3]
    alpha = image[..., 3] * material.base_color[3]
    if material.alpha_mode == "mask":
        alpha = np.where(alpha >= 255.0 * material.alpha_cutoff, 255.0, 0.0)
    return np.dstack([image[..., :3], np.rint(alpha).astype(np.uint8)])
