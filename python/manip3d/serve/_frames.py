"""Frames as messages: a mesh in two ranges with their colours, quantised."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from manip3d.modify import PhantomFrame

_NO_VERTICES = np.empty((0, 3), np.float32)
_NO_TEXCOORDS = np.empty((0, 2), np.float32)
_NO_MARKS = np.empty(0, np.uint8)
_NO_FACES = np.empty((0, 3), np.int32)
_PHANTOM = 2  # PixelKind.PHANTOM; what follows it is the phantom's too


@checked
def encode_frame(
    frame: PhantomFrame | None,
    status: Mapping[str, Any],
    *,
    sequence: int,
    time_ns: int = 0,
    captured_ns: int = 0,
    jpeg_quality: int = 80,
) -> bytes:
    """Return one frame for the page as one binary message; its layout is in ``stream_frame.hpp``.

    Parameters
    ----------
    frame : PhantomFrame or None
        None: there is nothing to draw.
    status : mapping
        Anything else that the page shows, as JSON.
    sequence : int
        0 to 2^32 - 1.
    time_ns : int
        By the sensor's clock.
    captured_ns : int
        When the frame came in, by `time.time_ns`.
    jpeg_quality : int
        1 to 100.

    Returns
    -------
    bytes
        Positions in steps of 1/65535 of the extent along each axis, texture coordinates in steps
        of 1/65534 of the part of the image that they use, which follows as JPEG.

    Raises
    ------
    InputError
        A number out of range, or arrays that do not agree.

    Examples
    --------
    >>> from manip3d import serve
    >>> message = serve.encode_frame(None, {"score": 3}, sequence=7)
    >>> type(message).__name__, b"score" in message
    ('bytes', True)
    """
    if frame is None:
        vertices, texcoords, phantoms, faces = _NO_VERTICES, _NO_TEXCOORDS, _NO_MARKS, _NO_FACES
        color, phantom_color, opacity = None, None, 1.0
    else:
        column, row = frame.pixels.T
        phantoms = (frame.kinds[row, column] >= _PHANTOM).view(np.uint8)
        phantoms[frame.num_points :] = 1  # body pixels again, with the phantom's texture
        vertices, texcoords, faces = frame.vertices, frame.texcoords, frame.faces
        color, phantom_color = _packed(frame.color), _packed(frame.phantom_color)
        if frame.color is frame.phantom_color:
            phantom_color = color
        opacity = frame.opacity
    return _core.encode_stream_frame(
        vertices,
        texcoords,
        phantoms,
        faces,
        color,
        phantom_color,
        opacity,
        sequence,
        time_ns,
        captured_ns,
        json.dumps(status, separators=(",", ":")),
        jpeg_quality,
    )


def _packed(color: NDArray[np.uint8] | None) -> NDArray[np.uint8] | None:
    return None if color is None else np.ascontiguousarray(color)
