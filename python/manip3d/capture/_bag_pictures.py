"""Decoding of the pictures in ROS bags, and the fixed transforms between their cameras."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.extras import imported
from manip3d._util.linear import inverse, product
from manip3d.capture._bag import BagPicture
from manip3d.errors import FormatError
from manip3d.io._images import decoded_picture

if TYPE_CHECKING:
    from numpy.typing import NDArray

_CHANNELS = {"mono8": 1, "rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4}
_BLUE_FIRST = ("bgr8", "bgra8", "8UC3")
"""Encodings with blue before red. 8UC3 does not state its channel order; it is the encoding of
images converted from OpenCV, whose order is blue, green, red."""
_BAYER = {"bayer_rggb8": "BG", "bayer_bggr8": "RG", "bayer_gbrg8": "GR", "bayer_grbg8": "GB"}
"""Bayer patterns of ROS and OpenCV's name of each: ROS names the first pixels of the first two
rows, OpenCV the second and third pixel of the second row."""
_UYVY = ("yuv422", "UYVY", "uyvy")
_YUYV = ("yuv422_yuy2", "YUYV", "yuyv", "YUY2")
"""Encodings with a luma for each pixel and two chromas for each pair of pixels: before and after
the lumas in turn. The names in capitals are RealSense's."""
COLOR_ENCODINGS = (*(name for name, channels in _CHANNELS.items() if channels > 1), *_UYVY, *_YUYV)
"""Encodings of uncompressed images with colours that need no package to be decoded."""
GREY_ENCODINGS = ("mono8", "8UC1", "Y8")
_MAX_PIXELS = 1 << 26  # largest number of pixels in a picture


def decoded(picture: BagPicture) -> NDArray[np.uint8]:
    """Decode a picture of a bag: (H, W) grey or (H, W, 3) red, green, blue.

    Raises
    ------
    FormatError
        The encoding is none of rgb8, bgr8, 8UC3, rgba8, bgra8, mono8, yuv422, yuv422_yuy2,
        bayer_*8, JPEG and PNG, or the message has too few bytes.
    MissingExtraError
        OpenCV (``bayer_*8``) or Pillow (JPEG, PNG) is not installed.
    """
    header, name = picture.header, picture.header["picture"]
    if "format" in header:
        try:
            return decoded_picture(picture.data)
        except FormatError as error:
            raise FormatError(f"{name}: {error.reason}") from error
    encoding = header["encoding"]
    if encoding in (*_UYVY, *_YUYV):
        return _decoded_yuv(picture)
    channels = 1 if encoding in (*_BAYER, *GREY_ENCODINGS) else _CHANNELS.get(encoding)
    if channels is None:
        known = ", ".join([*_CHANNELS, *_UYVY, *_YUYV, *_BAYER])
        raise FormatError(f"{name}: expected one of the encodings {known}, got {encoding!r}")
    rows = rows_of(picture, channels)
    if encoding in _BAYER:
        cv2 = imported("cv2", "alert")
        code = getattr(cv2, f"COLOR_Bayer{_BAYER[encoding]}2RGB")
        pixels: NDArray[np.uint8] = cv2.cvtColor(np.ascontiguousarray(rows), code)
        return pixels
    if channels == 1:
        return np.ascontiguousarray(rows)
    pixels = rows.reshape(len(rows), -1, channels)[..., :3]
    return np.ascontiguousarray(pixels[..., ::-1] if encoding in _BLUE_FIRST else pixels)


def _decoded_yuv(picture: BagPicture) -> NDArray[np.uint8]:
    """Decode an image of YUV 4:2:2 with luma of 16 to 235, by ITU-R BT.601."""
    header = picture.header
    if header["width"] % 2:
        raise FormatError(
            f"{header['picture']}: expected an even width of an image of {header['encoding']}, got "
            f"{header['width']}"
        )
    pairs = rows_of(picture, 2).astype(np.int32).reshape(header["height"], -1, 2, 2)
    luma, chroma = (1, 0) if header["encoding"] in _UYVY else (0, 1)
    y = 298 * (pairs[..., luma] - 16)
    u, v = (pairs[:, :, which, None, chroma] - 128 for which in (0, 1))
    # The coefficients of BT.601 times 256.
    rgb = np.stack([y + 409 * v, y - 100 * u - 208 * v, y + 516 * u], axis=-1)
    pixels = ((rgb + 128) >> 8).clip(0, 255).astype(np.uint8)
    return pixels.reshape(header["height"], -1, 3)


def rows_of(picture: BagPicture, pixel_bytes: int) -> NDArray[np.uint8]:
    """Cut an uncompressed picture into its rows: (H, W * pixel_bytes), without their padding.

    Raises
    ------
    FormatError
        The message has fewer bytes than its height, width and step require.
    """
    header = picture.header
    height, width, step = header["height"], header["width"], header["step"]
    row = width * pixel_bytes
    if not 0 < height * width <= _MAX_PIXELS or step < row or height * step > len(picture.data):
        raise FormatError(
            f"{header['picture']}: {height} rows of {width} pixels do not fit "
            f"{len(picture.data)} bytes with rows of {step}"
        )
    return np.frombuffer(picture.data, np.uint8, height * step).reshape(height, step)[:, :row]


def pose_of(
    transforms: Iterable[Mapping[str, Any]], to: str, frame: str
) -> NDArray[np.float64] | None:
    """Return T_to_frame, (4, 4), composed of fixed transforms; None if no chain connects them."""
    edges: dict[str, list[tuple[str, NDArray[np.float64]]]] = {}
    for each in transforms:
        matrix = rigid(each)
        if matrix is None:
            continue
        parent, child = each["parent"].lstrip("/"), each["child"].lstrip("/")
        edges.setdefault(parent, []).append((child, matrix))
        edges.setdefault(child, []).append((parent, inverse(matrix)))
    poses = {to.lstrip("/"): np.eye(4)}
    reached = deque(poses)
    while reached:
        name = reached.popleft()
        for beside, matrix in edges.get(name, ()):
            if beside not in poses:
                poses[beside] = product(poses[name], matrix)
                reached.append(beside)
    return poses.get(frame.lstrip("/"))


def rigid(transform: Mapping[str, Any]) -> NDArray[np.float64] | None:
    """Return T_parent_child of a translation and a quaternion (x, y, z, w); None if invalid."""
    x, y, z, w = turn = np.array(transform["rotation"])
    length = float(product(turn, turn))
    if not 0.99 < length < 1.01 or not np.isfinite(transform["translation"]).all():
        return None
    s = 2.0 / length
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
        [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
        [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
    ]
    matrix[:3, 3] = transform["translation"]
    return matrix
