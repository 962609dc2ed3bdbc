"""Texture images: their paths, their bytes, and conversion to PNG, which glTF needs."""

from __future__ import annotations

import dataclasses
import io
import logging
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.extras import imported
from manip3d._util.paths import path_of
from manip3d.errors import FormatError
from manip3d.io._files import open_regular, regular_bytes
from manip3d.io._orientations import orientation_of, upright
from manip3d.io._remote import is_url
from manip3d.mesh import Mesh, Texture

if TYPE_CHECKING:
    from numpy.typing import NDArray

_COMMON = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff")  # first bytes of PNG and JPEG files
# Pillow's modes with alpha that PNG lacks, and the PNG mode to which each is converted.
_WITH_ALPHA = {"PA": "RGBA", "La": "LA", "RGBa": "RGBA"}

_logger = logging.getLogger("manip3d")


@checked
def texture_path(mesh: Mesh, texture: Texture) -> Path | None:
    """Return the path of a texture's image.

    A relative path is resolved in the folder of ``mesh.source`` and may not leave it, not even
    through symbolic links. An absolute path is used unchanged; a mesh file can contain one only if
    it is read with ``allow_outside=True``.

    Parameters
    ----------
    mesh : Mesh
        The mesh; relative paths start in the folder of its ``source``.
    texture : Texture
        One of its textures.

    Returns
    -------
    Path or None
        None if the texture has no path, or if the file does not exist.

    Raises
    ------
    InputError
        A relative path leads out of the folder.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from manip3d import Mesh, Texture, io
    >>> Path("wood.png").touch()
    >>> mesh = Mesh(np.eye(3), [[0, 1, 2]], source=Path("model.obj").absolute())
    >>> io.texture_path(mesh, Texture(path="wood.png")).name
    'wood.png'
    >>> io.texture_path(mesh, Texture(path="missing.png")) is None
    True
    """
    if texture.path is None:
        return None
    path = path_of(texture.path, "texture.path")
    if not path.is_absolute():
        if mesh.source is None or is_url(mesh.source):
            return None
        folder = Path(mesh.source).parent
        inside = _core.resolve_inside(os.fsencode(folder), os.fsencode(texture.path))
        path = Path(os.fsdecode(inside))
    return path if path.is_file() else None


def image_bytes(mesh: Mesh, texture: Texture) -> bytes | None:
    """Return the content of a texture's image file, or None if the file is not found."""
    if texture.data is not None:
        return texture.data
    path = texture_path(mesh, texture)
    return None if path is None else regular_bytes(path)


def with_common_images(mesh: Mesh) -> Mesh:
    """Return the mesh with all images that are neither PNG nor JPEG converted to PNG.

    Images that are missing or that Pillow cannot read stay unchanged; the logger ``manip3d`` names
    the latter.

    Raises
    ------
    MissingExtraError
        An image must be converted and Pillow is not installed.
    """
    converted: dict[Texture, Texture] = {}
    for texture in {t for material in mesh.materials for t in material.textures.values()}:
        if not _is_common(mesh, texture):
            converted[texture] = _as_png(mesh, texture)
    if not converted:
        return mesh
    materials = [
        dataclasses.replace(
            material,
            textures={role: converted.get(t, t) for role, t in material.textures.items()},
        )
        for material in mesh.materials
    ]
    return mesh.replace(materials=materials)


def _is_common(mesh: Mesh, texture: Texture) -> bool:
    """Return whether the image is PNG, JPEG, empty or absent."""
    if texture.data is not None:
        return not texture.data or texture.data.startswith(_COMMON)
    path = texture_path(mesh, texture)
    if path is None:
        return True
    with open_regular(path) as file:
        start = file.read(8)
    return not start or start.startswith(_COMMON)


def _as_png(mesh: Mesh, texture: Texture) -> Texture:
    image_module = imported("PIL.Image", "io")
    content = image_bytes(mesh, texture)
    assert content is not None  # _is_common is True for absent images
    stream = io.BytesIO()
    try:
        image = image_module.open(io.BytesIO(content))
        if image.mode not in ("1", "L", "LA", "P", "RGB", "RGBA", "I;16"):
            image = image.convert(_WITH_ALPHA.get(image.mode, "RGB"))
        image.save(stream, format="PNG")
    except (OSError, ValueError, SyntaxError, image_module.DecompressionBombError) as error:
        is_unknown = isinstance(error, image_module.UnidentifiedImageError)
        # The message of UnidentifiedImageError names a Python object and no reason.
        reason = "no image that Pillow knows" if is_unknown else error
        _logger.warning("texture %r cannot be converted to PNG: %s", texture.path, reason)
        return texture
    path = None
    if texture.path is not None and Path(texture.path).name:
        path = str(Path(texture.path).with_suffix(".png"))
    return dataclasses.replace(texture, path=path, data=stream.getvalue())


def read_color(path: Path, shape: tuple[int, ...] | None = None) -> NDArray[np.uint8]:
    """Read an image file as (H, W, 3) red, green, blue; of 16 bits the upper 8 are kept.

    It is turned upright by its EXIF data, unless only the stored image has the aspect ratio of
    ``shape`` (rows, columns), that of the depth image to which it belongs.

    Raises
    ------
    FormatError
        The file is not an image, is damaged or too large, has grey values that are not whole
        numbers of 8 or 16 bits, or is not a regular file.
    OSError
        The file cannot be opened or read.
    MissingExtraError
        Pillow is not installed.
    """
    image_module = imported("PIL.Image", "io")
    try:
        with open_regular(path) as file, image_module.open(file) as image:
            if image.mode.startswith(("I", "F")):  # Pillow would replace all above 255 by white
                stored = _rgb_of_numbers(np.asarray(image), image.mode, path)
            else:
                stored = np.array(image.convert("RGB"))
            return upright(stored, orientation_of(image), shape)
    except FormatError:  # must come before ValueError, its base class
        raise
    except (OSError, ValueError, SyntaxError, image_module.DecompressionBombError) as error:
        if isinstance(error, OSError) and error.errno is not None:  # Pillow's own have none
            raise
        raise FormatError(f"expected a colour image: {error}", file=str(path)) from error


def _rgb_of_numbers(numbers: NDArray[Any], mode: str, path: Path) -> NDArray[np.uint8]:
    """Convert grey numbers of 16 bits as Pillow converts colours of 16 bits."""
    if numbers.dtype.kind == "f" or numbers.min() < 0 or numbers.max() >= 1 << 16:
        raise FormatError(
            f"expected a colour image of 8 or 16 bits, got the mode {mode} with numbers from "
            f"{numbers.min():g} to {numbers.max():g}",
            file=str(path),
        )
    grey = (numbers >> 8).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def encoded_picture(pixels: NDArray[np.uint8]) -> bytes:
    """Return (H, W, 3) or (H, W, 4) pixels as a PNG file.

    Raises
    ------
    MissingExtraError
        Pillow is not installed.
    """
    stream = io.BytesIO()
    imported("PIL.Image", "io").fromarray(pixels).save(stream, format="PNG")
    return stream.getvalue()


def decoded_picture(data: bytes) -> NDArray[np.uint8]:
    """Decode a PNG or JPEG: (H, W) if it is grey, else (H, W, 3) red, green, blue.

    Raises
    ------
    FormatError
        The data is no PNG or JPEG, is damaged or cut off, is too large, or has more than 8 bits.
    MissingExtraError
        Pillow is not installed.
    """
    image_module = imported("PIL.Image", "alert")
    try:
        with image_module.open(io.BytesIO(data), formats=("PNG", "JPEG")) as image:
            if image.mode.startswith(("I", "F")):
                raise FormatError(
                    f"expected a picture of 8 bits, got the mode {image.mode}: how many of its "
                    "bits the camera used is unknown; scale both pictures of a pair alike"
                )
            pixels: NDArray[np.uint8] = np.asarray(
                image if image.mode == "L" else image.convert("RGB")
            )
    except FormatError:  # must come before ValueError, its base class
        raise
    except (OSError, ValueError, SyntaxError, image_module.DecompressionBombError) as error:
        raise FormatError(f"unreadable picture: {error}") from error
    return pixels
