"""Colours and brightness of hits from mip-mapped textures and given light."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from manip3d.simulate._world import Surface

Floats = NDArray[np.float32]

LEVELS = 9
"""Mip levels of a texture: 256, 128, ..., 1 texels per side."""
SIDE = 1 << (LEVELS - 1)


class Shader:
    """Computes colours from tables of texture coordinates by face, and of textures by surface.

    Parameters
    ----------
    surfaces : sequence of S Surface
        Surfaces with their colours and textures.
    face_surface : (F,) int32
        Index into ``surfaces`` of each face.
    texcoords : (F, 3, 2) float32, metres
        Texture coordinates of the corners.
    """

    def __init__(
        self,
        surfaces: Sequence[Surface],
        face_surface: NDArray[np.int32],
        texcoords: Floats,
    ) -> None:
        self._face_surface = face_surface
        size = np.array([s.texture_size for s in surfaces], np.float32)
        self._color = np.array([s.color for s in surfaces], np.float32)
        self._repeats = 1.0 / size
        blank = np.full((SIDE, SIDE), 128, np.uint8)
        textures = {id(blank): blank} | {
            id(s.texture): s.texture for s in surfaces if s.texture is not None
        }
        chains = [_mip_chain(texture) for texture in textures.values()]
        self._texels = np.concatenate(chains)
        start = {key: i * len(chains[0]) for i, key in enumerate(textures)}
        of_surface = [id(blank if s.texture is None else s.texture) for s in surfaces]
        self._start = np.array([start[key] for key in of_surface], np.int32)
        self._level_start = np.concatenate(
            [[0], np.cumsum([4 ** (LEVELS - 1 - level) for level in range(LEVELS - 1)])]
        ).astype(np.int32)
        # Texture coordinates at the first corner and along the two edges, in repetitions.
        scaled = texcoords * self._repeats[face_surface][:, None, None]
        edges = scaled[:, 1:] - scaled[:, :1]
        self._plane = np.concatenate([scaled[:, :1], edges], axis=1).reshape(-1, 6)

    def colors(
        self, face: NDArray[np.int64], uv: Floats, footprint: Floats, light: Floats
    ) -> Floats:
        """Return the colours of N hits.

        Parameters
        ----------
        face : (N,) int64
            Index of the face.
        uv : (N, 2) float32
            Barycentric weights of the second and the third corner.
        footprint : (N,) float32, metres
            Size of a pixel on the surface.
        light : (N,) float32
            Light at each hit; factor on the brightness.

        Returns
        -------
        (N, 3) float32, 0 to 255
            Colours, not clipped.
        """
        shade = self.brightness(face, uv, footprint)
        color = self._color[self._face_surface[face]]
        return np.asarray(color * (shade * light * np.float32(255))[:, None])

    def brightness(self, face: NDArray[np.int64], uv: Floats, footprint: Floats) -> Floats:
        """Return the relative brightness of N hits; ``face``, ``uv``: see `colors`.

        Parameters
        ----------
        footprint : (N,) float32, metres
            Size of a pixel or beam on the surface.

        Returns
        -------
        (N,) float32
            Relative brightness; 1 if the surface has no texture.
        """
        surface = self._face_surface[face]
        plane = self._plane[face]
        s = plane[:, 0] + uv[:, 0] * plane[:, 2] + uv[:, 1] * plane[:, 4]
        t = plane[:, 1] + uv[:, 0] * plane[:, 3] + uv[:, 1] * plane[:, 5]
        texels = footprint * (SIDE * self._repeats[surface])
        level = np.frexp(texels)[1].clip(0, LEVELS - 1)  # texels are at least as large as the pixel
        shade = self._bilinear(self._start[surface] + self._level_start[level], level, s, t)
        return np.asarray(shade * np.float32(1 / 128))

    def _bilinear(
        self, start: NDArray[np.int32], level: NDArray[np.int32], s: Floats, t: Floats
    ) -> Floats:
        """Brightness at (s, t), interpolated between the four nearest texels of one level."""
        side = np.int32(SIDE) >> level
        column, row = s * side - np.float32(0.5), t * side - np.float32(0.5)
        left, top = np.floor(column), np.floor(row)
        column -= left
        row -= top
        mask = side - 1
        c0, r0 = left.astype(np.int32) & mask, top.astype(np.int32) & mask
        c1, r1 = (c0 + 1) & mask, (r0 + 1) & mask
        r0, r1 = start + r0 * side, start + r1 * side
        texels = self._texels
        upper = texels[r0 + c0]
        upper += column * (texels[r0 + c1] - upper)
        lower = texels[r1 + c0]
        lower += column * (texels[r1 + c1] - lower)
        upper += row * (lower - upper)
        return upper


def _mip_chain(texture: NDArray[np.uint8]) -> Floats:
    """All mip levels in one array; each level has half the side of the previous one."""
    level = texture.astype(np.float32)
    levels = [level]
    while len(level) > 1:
        level = level.reshape(len(level) // 2, 2, len(level) // 2, 2).mean(axis=(1, 3))
        levels.append(level)
    return np.concatenate([image.ravel() for image in levels]).astype(np.float32)
