"""Short films of anomalies of a game, from a buffer of pictures of the last seconds."""

from __future__ import annotations

import io
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.extras import require

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.camera import Intrinsics
    from manip3d.modify import PhantomFrame
    from manip3d.phantom._level import Level
    from manip3d.phantom._state import GameState

BEFORE_S = 5.0
"""Seconds that a film shows before the anomaly begins."""
LONGEST_S = 30.0
"""Longest film, seconds; later pictures are left out."""
RATE = 10.0
"""Pictures per second."""

_GROUND = 32  # grey background: films show nothing of the room
_PHANTOM_BLUE = np.array([40, 130, 255], np.float32)
_TINT = 0.35  # share of blue in the pixels of the phantom limb
_EDGE = 320  # largest number of pixels of the longer side
_QUALITY = 70  # of JPEG
_PHANTOM = 2  # PixelKind.PHANTOM


class ClipRing:
    """Buffer of the pictures of the last five seconds of play, or since an anomaly may have begun.

    While a game is paused, no pictures are taken.
    """

    def __init__(self) -> None:
        require("live")
        self._pictures: deque[tuple[float, bytes]] = deque(maxlen=int(2 * LONGEST_S * RATE))

    def clear(self) -> None:
        """Discard all pictures."""
        self._pictures.clear()

    def add(
        self,
        shown: PhantomFrame,
        game: GameState,
        camera: Intrinsics,
        since: float | None,
        level: Level,
    ) -> None:
        """Add a picture if it is due.

        The game's places are in the axes of ``level``. ``since``: start of a possible anomaly,
        seconds of play; None: there is none. Pictures from more than `BEFORE_S` before this time
        (or before now) are dropped.
        """
        clock = game.clock
        if self._pictures and clock - self._pictures[-1][0] < 1.0 / RATE - 1e-6:
            return
        first = (clock if since is None else since) - BEFORE_S
        while self._pictures and self._pictures[0][0] < first:
            self._pictures.popleft()
        if since is not None and clock > since + LONGEST_S - BEFORE_S:
            return
        self._pictures.append((clock, _jpeg(picture(shown, game, camera, level))))

    def take(self, start: float, end: float) -> tuple[tuple[float, bytes], ...]:
        """Return play time (seconds) and JPEG of pictures from `BEFORE_S` before start to end."""
        return tuple(one for one in self._pictures if start - BEFORE_S <= one[0] <= end)


def picture(
    shown: PhantomFrame, game: GameState, camera: Intrinsics, level: Level
) -> NDArray[np.uint8]:
    """Draw the person on grey, the phantom limb bluish, targets as rings; return (H, W, 3)."""
    from PIL import Image, ImageDraw

    kinds = shown.kinds
    image = np.full((*kinds.shape, 3), _GROUND, np.uint8)
    pixels = shown.pixels[: shown.num_points]
    texcoords = shown.texcoords[: shown.num_points]
    column, row = pixels.T
    is_phantom = kinds[row, column] >= _PHANTOM
    for chosen, color in ((~is_phantom, shown.color), (is_phantom, shown.phantom_color)):
        if color is not None:
            image[row[chosen], column[chosen]] = _texels(color, texcoords[chosen])
        else:
            image[row[chosen], column[chosen]] = 160
    tinted = (1 - _TINT) * image[row[is_phantom], column[is_phantom]] + _TINT * _PHANTOM_BLUE
    image[row[is_phantom], column[is_phantom]] = tinted.astype(np.uint8)
    drawn = Image.fromarray(image)
    pen = ImageDraw.Draw(drawn)
    targets = np.array([target.place for target in game.targets], np.float64).reshape(-1, 3)
    places = level.in_camera(targets)
    for (u, v), (_, _, depth) in zip(camera.project(places), places, strict=True):
        if np.isfinite(u) and depth > 0:
            radius = max(2.0, game.radius * abs(camera.fx) / depth)
            pen.ellipse((u - radius, v - radius, u + radius, v + radius), outline=(255, 220, 90))
    scale = _EDGE / max(drawn.size)
    if scale < 1:
        width, height = (max(1, round(scale * side)) for side in drawn.size)
        drawn = drawn.resize((width, height), Image.Resampling.BILINEAR)
    return np.asarray(drawn)


def _texels(color: NDArray[np.uint8], texcoords: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Sample the colour image at the nearest pixels; grey where the colour camera sees nothing."""
    height, width = color.shape[:2]
    known = np.asarray(np.isfinite(texcoords).all(axis=1))
    u, v = np.where(known[:, None], texcoords, 0.0).T
    column = np.clip((u * width).astype(np.intp), 0, width - 1)
    row = np.clip(((1.0 - v) * height).astype(np.intp), 0, height - 1)
    found: NDArray[np.uint8] = color[row, column]
    found[~known] = 160
    return found


def _jpeg(image: NDArray[np.uint8]) -> bytes:
    from PIL import Image

    content = io.BytesIO()
    Image.fromarray(image).save(content, "JPEG", quality=_QUALITY)
    return content.getvalue()
