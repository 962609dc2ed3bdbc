"""Textures of a simulated person: clothes, face and skin, one small image per kind of part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manip3d.simulate._skin import TILES

Array = NDArray[np.float64]
Color = tuple[int, int, int]

SIDE = 256
"""Side of a tile, texels."""


@dataclass(frozen=True)
class Clothes:
    """Colours of a person; ``stripes``: the shirt has white stripes."""

    shirt: Color = (58, 104, 160)
    trousers: Color = (66, 62, 66)
    shoes: Color = (84, 52, 36)
    skin: Color = (214, 164, 132)
    hair: Color = (58, 40, 30)
    stripes: bool = False
    long_sleeves: bool = False


COVER: Color = (36, 78, 205)
"""Blue of a shoe cover: H 112, S 210, V 205 in OpenCV's units."""


def paint(clothes: Clothes) -> NDArray[np.uint8]:
    """Paint the tiles of `_skin.TILES`, then the foot with a shoe cover: (8, SIDE, SIDE, 3)."""
    painters = {
        "torso": _torso,
        "head": _head,
        "arm": _arm,
        "leg": _leg,
        "foot": _shoe,
        "skin": _skin,
        "bandage": _bandage,
    }
    tiles = [painters[name](clothes) for name in TILES]
    return np.clip(np.stack([*tiles, _cover()]), 0, 255).astype(np.uint8)


def _place() -> tuple[Array, Array]:
    """Angle from the front, radians, positive to the left; position from top (0) to bottom (1)."""
    along, around = (np.mgrid[:SIDE, :SIDE] + 0.5) / SIDE
    return (0.5 - around) * 2.0 * np.pi, along


def _plain(color: Color) -> Array:
    return np.broadcast_to(np.array(color, float), (SIDE, SIDE, 3)).copy()


def _cloth(color: Color, depth: float) -> Array:
    """A colour with soft folds, the same on both sides."""
    angle, along = _place()
    aside = np.abs(angle)
    folds = np.cos(5.0 * aside + 3.0 * np.sin(9.0 * along) * np.cos(angle)) * np.sin(31.0 * along)
    folds += 0.5 * np.sin(67.0 * along) * np.cos(2.0 * angle)
    return _plain(color) * (1.0 + depth * folds)[..., None]


def _shirt(clothes: Clothes, height: float) -> Array:
    """The shirt's tile; ``height`` is its extent from top to bottom, metres."""
    image = _cloth(clothes.shirt, 0.05)
    if clothes.stripes:
        _, along = _place()
        image[(along * height) % 0.05 < 0.022] = (236, 234, 228)
    return image


def _torso(clothes: Clothes) -> Array:
    angle, along = _place()
    y = 0.66 - 0.778 * along
    image = _shirt(clothes, 0.778)
    button = (np.abs(angle) < 0.035) & (np.abs((y - 0.05) % 0.08 - 0.04) < 0.006) & (y < 0.50)
    image[button] = (230, 226, 214)
    below = y < 0.0
    image[below] = _cloth(clothes.trousers, 0.06)[below]
    belt = (y >= 0.0) & (y < 0.032)
    image[belt] = (44, 30, 22)
    image[belt & (np.abs(angle) < 0.16)] = (180, 172, 150)
    neck = y > 0.545 + 0.03 * (np.abs(angle) / np.pi)
    image[neck] = clothes.skin
    collar = ~neck & (y > 0.525 + 0.03 * (np.abs(angle) / np.pi))
    image[collar] = np.array(clothes.shirt) * 0.7
    return image


def _head(clothes: Clothes) -> Array:
    angle, along = _place()
    y = 0.870 - 0.238 * along
    aside = np.abs(angle)
    image = _plain(clothes.skin)
    image *= (1.0 - 0.10 * np.exp(-(((y - 0.66) / 0.02) ** 2)))[..., None]  # below the lips

    def spot(x: float, height: float, width: float, tall: float) -> NDArray[np.bool_]:
        inside: NDArray[np.bool_] = ((aside - x) / width) ** 2 + ((y - height) / tall) ** 2 < 1.0
        return inside

    image[spot(0.36, 0.748, 0.22, 0.014)] *= 0.86  # sockets
    image[spot(0.36, 0.747, 0.155, 0.0085)] = (242, 240, 236)
    image[spot(0.36, 0.747, 0.065, 0.0080)] = (70, 52, 36)
    image[spot(0.36, 0.747, 0.028, 0.0040)] = (12, 10, 10)
    image[spot(0.37, 0.770, 0.20, 0.0055)] = np.array(clothes.hair) * 0.9
    image[spot(0.10, 0.705, 0.045, 0.004)] *= 0.55  # nostrils
    image[spot(0.0, 0.681, 0.30, 0.0085)] = (178, 96, 90)
    image[spot(0.0, 0.681, 0.27, 0.0014)] = (110, 50, 48)
    hairline = np.interp(
        aside, [0.0, 0.7, 1.0, 1.2, 1.9, np.pi], [0.815, 0.812, 0.79, 0.745, 0.70, 0.665]
    )
    hair = y > hairline
    strands = 1.0 + 0.12 * np.sin(60.0 * aside + 14.0 * along)
    image[hair] = (np.array(clothes.hair) * strands[..., None])[hair]
    return image


def _arm(clothes: Clothes) -> Array:
    _, along = _place()
    down = 0.652 * along - 0.040  # metres below the shoulder
    image = _shirt(clothes, 0.652)
    sleeve = 0.50 if clothes.long_sleeves else 0.19
    bare = down > sleeve
    image[bare] = clothes.skin
    image[(down > sleeve - 0.008) & ~bare] = np.array(clothes.shirt) * 0.7
    return image


def _leg(clothes: Clothes) -> Array:
    angle, along = _place()
    image = _cloth(clothes.trousers, 0.07)
    image[np.abs(np.abs(angle) - np.pi / 2.0) < 0.04] *= 0.75  # seams
    image[along * 0.91 - 0.075 > 0.79] = (230, 230, 226)  # socks
    return image


def _shoe(clothes: Clothes) -> Array:
    angle, along = _place()
    image = _plain(clothes.shoes)
    laces = (np.abs(angle) < 0.45) & (np.abs(along - 0.55) < 0.12) & (np.sin(150.0 * along) > 0.3)
    image[laces] = (225, 220, 205)
    image[np.abs(angle) > 2.15] = (206, 200, 186)  # the sole
    return image


def _cover() -> Array:
    angle, along = _place()
    crumpled = 1.0 + 0.06 * np.sin(21.0 * along + 2.0 * np.cos(3.0 * angle)) * np.cos(4.0 * angle)
    return _plain(COVER) * crumpled[..., None]


def _bandage(clothes: Clothes) -> Array:
    """Windings of white elastic cloth around the limb."""
    angle, along = _place()
    image = _plain((232, 226, 212))
    image[((5.0 * along + angle / (2.0 * np.pi)) % 1.0) < 0.12] *= 0.86
    return image


def _skin(clothes: Clothes) -> Array:
    return _plain(clothes.skin)
