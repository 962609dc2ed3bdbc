"""Procedural textures that repeat seamlessly: (256, 256) uint8 brightness, 128: the surface's
own."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from manip3d._util.arrays import read_only
from manip3d.simulate._world import Surface

Pixels = NDArray[np.uint8]
Field = NDArray[np.float64]

SIZE = 256


def noise(seed: int, slope: float) -> Field:
    """Periodic noise of unit variance whose amplitude falls as frequency^-slope."""
    random = np.random.default_rng(seed)
    fx, fy = np.meshgrid(np.fft.rfftfreq(SIZE), np.fft.fftfreq(SIZE))
    frequency = np.hypot(fx, fy)
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(random.standard_normal((SIZE, SIZE))) * frequency**-slope
    field = np.fft.irfft2(spectrum)
    return np.asarray(field / field.std())


def _pixels(brightness: Field) -> Pixels:
    """Return the pixels of a brightness around 1, which all surfaces of a texture share."""
    return read_only(np.clip(128.0 * brightness, 0, 255).astype(np.uint8))


def _grid() -> tuple[Field, Field]:
    """Row and column of the texels, 0 to 1."""
    s = (np.arange(SIZE) + 0.5) / SIZE
    return np.meshgrid(s, s, indexing="ij")


@functools.cache
def rough(seed: int, contrast: float, slope: float) -> Pixels:
    """Texture of asphalt, plaster, concrete or earth."""
    return _pixels(1.0 + contrast * noise(seed, slope))


@functools.cache
def foliage(seed: int) -> Pixels:
    """Texture of grass and leaves, with strong contrast between leaves."""
    return _pixels(1.0 + 0.35 * noise(seed, 0.45))


@functools.cache
def courses(seed: int, rows: int, columns: int, joint: float) -> Pixels:
    """Texture of bricks, slabs or tiles: every second course is shifted, shades differ."""
    random = np.random.default_rng(seed)
    v, u = _grid()
    course = np.floor(v * rows).astype(int)
    along = u * columns + 0.5 * (course % 2)
    stone = np.floor(along).astype(int) % columns
    shade = 1.0 + 0.14 * random.standard_normal((rows, columns))
    edge = np.minimum(np.minimum(along % 1, 1 - along % 1) / columns * rows, 1.0)
    edge = np.minimum(edge, np.minimum(v * rows % 1, 1 - v * rows % 1))
    brightness = np.where(edge < joint, 0.72, shade[course, stone]) + 0.05 * noise(seed, 0.4)
    return _pixels(brightness)


@functools.cache
def window(seed: int) -> Pixels:
    """Texture of a window with a frame, curtains, and a dim room behind it."""
    v, u = _grid()
    frame = (abs(u - 0.5) < 0.02) | (np.minimum(u, 1 - u) < 0.03) | (np.minimum(v, 1 - v) < 0.03)
    random = np.random.default_rng(seed)
    curtain = abs(u - 0.5) > random.uniform(0.25, 0.45)
    folds = 0.85 + 0.2 * np.sin(2 * np.pi * u * 24)
    brightness = np.where(curtain, folds, 0.35 + 0.3 * v) + 0.05 * noise(seed, 1.2)
    return _pixels(np.where(frame, 1.25, brightness))


def asphalt(random: np.random.Generator) -> Surface:
    """Return the surface of a road."""
    shade = float(random.uniform(0.26, 0.36))
    return Surface(
        (shade, shade, shade * 1.03),
        float(random.uniform(0.3, 0.4)),
        texture=rough(1, 0.16, 0.45),
        texture_size=4.0,
    )


def paving(random: np.random.Generator) -> Surface:
    """Return the surface of a pavement."""
    shade = float(random.uniform(0.42, 0.55))
    return Surface(
        (shade, shade * 0.98, shade * 0.94), 0.35, texture=courses(2, 8, 8, 0.06), texture_size=3.2
    )


def grass() -> Surface:
    """Return the surface of verges and gardens."""
    return Surface((0.30, 0.42, 0.17), 0.45, texture=foliage(3), texture_size=3.0)


def wall(random: np.random.Generator) -> Surface:
    """Return the surface of a house: plaster, brick or concrete."""
    kind = random.integers(3)
    if kind == 0:
        color = (
            np.array([0.86, 0.82, 0.74]) * random.uniform(0.75, 1.1) * random.uniform(0.94, 1.06, 3)
        )
        texture, size, reflectance = rough(4, 0.07, 0.9), 5.0, 0.55
    elif kind == 1:
        color = np.array([0.58, 0.33, 0.25]) * random.uniform(0.7, 1.2)
        texture, size, reflectance = courses(5, 32, 10, 0.09), 2.6, 0.35
    else:
        color = np.array([0.6, 0.6, 0.6]) * random.uniform(0.7, 1.2)
        texture, size, reflectance = rough(6, 0.10, 0.8), 6.0, 0.4
    return Surface(_color(color), reflectance, texture=texture, texture_size=size)


def roof(random: np.random.Generator) -> Surface:
    """Return the surface of a roof of tiles."""
    color = np.array([0.48, 0.22, 0.16]) * random.uniform(0.6, 1.2)
    return Surface(_color(color), 0.3, texture=courses(7, 16, 16, 0.05), texture_size=4.0)


def pane(random: np.random.Generator) -> Surface:
    """Return the surface of windows, through which part of the laser's pulses pass."""
    texture = window(8 + int(random.integers(4)))
    return Surface((0.42, 0.46, 0.52), 0.12, transmission=0.12, texture=texture, texture_size=1.6)


def leaves(random: np.random.Generator) -> Surface:
    """Return the surface of a tree or a hedge."""
    color = np.array([0.26, 0.40, 0.15]) * random.uniform((0.7, 0.7, 0.6), (1.3, 1.2, 1.3))
    return Surface(_color(color), 0.45, texture=foliage(20), texture_size=1.5)


def paint(color: tuple[float, float, float]) -> Surface:
    """Return the surface of a car with a faint pattern; dark paint mirrors pulses away."""
    brightness = sum(color) / 3.0
    return Surface(
        color,
        0.15 + 0.6 * brightness,
        transmission=0.2 if brightness < 0.25 else 0.0,
        texture=rough(30, 0.08, 0.6),
        texture_size=2.0,
    )


def cloth(random: np.random.Generator, brightest: float) -> Surface:
    """Return the surface of clothes."""
    color = _color(random.uniform(0.05, brightest, 3))
    reflectance = float(random.uniform(0.1, 0.7))
    return Surface(color, reflectance, texture=rough(31, 0.2, 0.5), texture_size=0.8)


def bark() -> Surface:
    """Return the surface of a tree's trunk."""
    return Surface((0.34, 0.27, 0.2), 0.3, texture=rough(21, 0.25, 0.5), texture_size=0.8)


def _color(values: Field) -> tuple[float, float, float]:
    red, green, blue = np.clip(values, 0.0, 1.0).tolist()
    return red, green, blue
