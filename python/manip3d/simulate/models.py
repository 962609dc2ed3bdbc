"""Procedural meshes with the properties of the published models, for use without the data.

Each function computes its mesh from formulas: equal arguments give equal meshes. Lengths are in
metres, y is up and the front faces +z (glTF's axes). ``faces`` is an approximate number.

===========  =====================  ============================================================
model        stands for             traits
===========  =====================  ============================================================
rocker       RockerArm              closed, genus 4, smooth with the noise of a scanner, no UV
head         Head                   closed, textured, several charts and hence seams
car          Car                    unwelded panels, each face stored front and back, materials
lifeboat     Dragon                 non-manifold sheets, boundaries, triangle soup, materials
jet          Jet                    open shells, every face textured, manifold
airplane     Airplane               textured and plain materials, non-manifold edges, seams
===========  =====================  ============================================================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from manip3d._util.linear import product
from manip3d._util.options import generator_of
from manip3d.errors import InputError
from manip3d.mesh import Material, Mesh, Texture
from manip3d.simplify import clean
from manip3d.simulate._surfaces import (
    Patch,
    Points,
    box,
    join,
    png,
    revolved,
    sheet,
    smooth_cut,
    smooth_union,
    surface_of,
    vertex_normals,
    waves,
)

__all__ = [
    "MODELS",
    "airplane",
    "car",
    "disc",
    "floor",
    "head",
    "jet",
    "lifeboat",
    "rocker",
    "strip",
    "tube",
]

Array = NDArray[np.float64]


# --- Small meshes with known answers ------------------------------------------------------------
def strip(columns: int = 20, rows: int = 1) -> Mesh:
    """Make a flat open strip of unit squares in the xz plane; its only boundary is a rectangle."""
    return _welded([_floor_patch(0, columns, rows)])


def floor(columns: int = 10, rows: int = 6) -> Mesh:
    """Make a flat textured floor of two materials that meet along a straight line in the middle."""
    half = _checked("columns", columns, 2) // 2
    left = _floor_patch(0, half, rows, 0, u=(0.0, 0.5))
    right = _floor_patch(half, columns - half, rows, 1, u=(0.5, 1.0))
    return _welded([left, right], [_plain("wood", 0.45, 0.26, 0.12), _plain("tile", 0.7, 0.7, 0.7)])


def disc(sectors: int = 48, rings: int = 8) -> Mesh:
    """Make a flat disc of radius 1 whose boundary is a regular polygon."""
    _checked("sectors", sectors, 3)
    _checked("rings", rings, 1)
    angle = np.arange(sectors) * 2.0 * np.pi / sectors
    radius = (np.arange(rings) + 1.0)[:, None] / rings
    ring = np.stack([radius * np.cos(angle), 0.0 * radius * angle, -radius * np.sin(angle)], -1)
    around = np.arange(sectors)
    after = (around + 1) % sectors
    fan = np.column_stack([0 * around, 1 + around, 1 + after])
    start = 1 + np.arange(rings - 1)[:, None] * sectors
    a, b = (start + around).ravel(), (start + after).ravel()
    bands = [np.column_stack([a, a + sectors, b + sectors]), np.column_stack([a, b + sectors, b])]
    return Mesh(np.vstack([[[0, 0, 0]], ring.reshape(-1, 3)]), np.concatenate([fan, *bands]))


def tube(sectors: int = 32, rows: int = 12) -> Mesh:
    """Make an open textured tube of radius 1 and height 2, with two rims and a seam."""
    heights = np.linspace(-1.0, 1.0, _checked("rows", rows, 1) + 1)
    side = revolved(heights, np.ones_like(heights), sectors, 0, uv_box=(0, 0, 1, 1))
    return _welded([side.moved(axes=(1, 0, 2), scale=(1, 1, -1))], [_textured("label", _checker())])


# --- Models -------------------------------------------------------------------------------------
def rocker(faces: int = 80_354, *, rng: int | np.random.Generator = 0) -> Mesh:
    """Make a rocker arm as from a scanner: one closed surface of genus 4, no texture coordinates.

    Parameters
    ----------
    faces : int
        Approximate number of faces.
    rng : int or numpy.random.Generator
        Seed or generator of the surface's noise.

    Raises
    ------
    InputError
        ``faces`` is below 5000, or ``rng`` is neither a seed nor a generator.
    """
    random = generator_of(rng)
    low, high = (-0.068, -0.030, -0.026), (0.066, 0.030, 0.030)
    trial_cell = 0.002
    trial = surface_of(_rocker_distance, low, high, trial_cell)
    cell = trial_cell * np.sqrt(len(trial.faces) / _checked("faces", faces, 5_000))
    # In a coarse grid a cube may cross two sheets of the surface; then a finer one is used.
    for shrink in 0.98 ** np.arange(12):
        patch = surface_of(_rocker_distance, low, high, cell * shrink)
        if join([patch]).summary().non_manifold_edges == 0:
            break
    relief = 8e-5 * waves(patch.vertices, 40, 0.006, random) + 1.5e-5 * random.normal(
        size=len(patch.vertices)
    )
    vertices = patch.vertices + vertex_normals(patch) * relief[:, None]
    return _upright(join([Patch(vertices, patch.faces)]))


def _rocker_distance(p: Array) -> Array:
    """Distance-like field of a rocker arm, in metres; the shaft lies along y."""
    hub = _cylinder(p, (0, 0, 0), 1, 0.0155, 0.022)
    valve_side = _capsule(p, (0, 0, 0.004), (-0.046, 0, 0.010), 0.0095)
    cam_side = _capsule(p, (0, 0, 0), (0.045, 0, -0.004), 0.0105)
    screw_boss = _cylinder(p, (-0.052, 0, 0.010), 2, 0.0095, 0.0135)
    roller_fork = _cylinder(p, (0.050, 0, -0.004), 1, 0.0125, 0.015)
    body = smooth_union(hub, smooth_union(valve_side, cam_side, 0.006), 0.010)
    body = smooth_union(body, smooth_union(screw_boss, roller_fork, 0.004), 0.007)
    for hole in (
        _cylinder(p, (0, 0, 0), 1, 0.0092, 0.1),  # shaft
        _cylinder(p, (-0.052, 0, 0.010), 2, 0.0045, 0.1),  # adjusting screw
        _cylinder(p, (0.050, 0, -0.004), 1, 0.0055, 0.1),  # roller pin
        _cylinder(p, (-0.026, 0, 0.006), 1, 0.0042, 0.1),  # lightening
    ):
        body = smooth_cut(body, hole, 0.0025)
    return body


def head(faces: int = 17_684) -> Mesh:
    """Make a textured head with neck: closed, three charts, seams at the sides and at the crown.

    Parameters
    ----------
    faces : int
        Approximate number of faces.
    """
    rows = max(8, round(np.sqrt(_checked("faces", faces, 500)) / 2.0))
    half = max(4, round(faces / (4.0 * rows)))
    crown = max(2, round(0.12 * rows))
    polar = np.linspace(0.0, np.pi, rows + 1)[:, None]
    azimuth = np.linspace(0.0, 2.0 * np.pi, 2 * half + 1)  # 0: left ear, pi / 2: nose
    points = _head_points(polar, azimuth)
    points[:, -1] = points[:, 0]
    points[0], points[-1] = points[0, 0], points[-1, 0]
    uv = _head_uv(polar, azimuth, polar[crown, 0])
    charts = [
        (points[crown:, : half + 1], uv["front"][crown:, : half + 1]),
        (points[crown:, half:], uv["back"][crown:, half:]),
        (points[: crown + 1], uv["crown"][: crown + 1]),
    ]
    patches = [_textured_sheet(p, t) for p, t in charts]
    skin = _textured("skin", png(_head_pixels(512, polar[crown, 0])))
    return _upright(_welded(patches, [skin]))


def _head_distance(p: Array) -> Array:
    """Distance-like field of a head, in decimetres; the face looks towards -y, z is up."""
    mirrored = p.copy()
    mirrored[..., 0] = abs(p[..., 0])
    shape = _ellipsoid(p, (0, 0.12, 0.35), (0.76, 0.95, 0.88))
    shape = smooth_union(shape, _ellipsoid(p, (0, -0.30, -0.38), (0.56, 0.60, 0.88)), 0.30)
    shape = smooth_union(shape, _capsule(p, (0, 0.10, -0.5), (0, 0.25, -2.4), 0.47), 0.25)
    for start, end, radius, blend in (
        ((0.0, -0.74, -1.03), (0.12, -0.72, -1.03), 0.17, 0.20),  # chin
        ((0.0, -0.80, 0.22), (0.36, -0.72, 0.22), 0.10, 0.15),  # brow
        ((0.40, -0.55, -0.30), (0.46, -0.40, -0.26), 0.18, 0.25),  # cheek
        ((0.0, -0.86, 0.10), (0.0, -1.02, -0.26), 0.08, 0.14),  # bridge of the nose
        ((0.0, -0.98, -0.30), (0.09, -0.93, -0.34), 0.085, 0.12),  # nostrils
        ((0.0, -0.90, -0.60), (0.16, -0.86, -0.62), 0.055, 0.06),  # upper lip
        ((0.0, -0.89, -0.70), (0.14, -0.86, -0.69), 0.060, 0.05),  # lower lip
    ):
        shape = smooth_union(shape, _capsule(mirrored, start, end, radius), blend)
    shape = smooth_cut(shape, _ellipsoid(mirrored, (0.30, -0.98, 0.02), (0.17, 0.16, 0.11)), 0.10)
    shape = smooth_union(shape, _ellipsoid(mirrored, (0.30, -0.74, 0.02), (0.14, 0.14, 0.11)), 0.03)
    shape = smooth_union(shape, _ellipsoid(mirrored, (0.74, 0.10, -0.08), (0.12, 0.20, 0.28)), 0.12)
    return smooth_cut(shape, p[..., 2] + 1.75, 0.30)


def _head_points(polar: Array, azimuth: Array) -> Array:
    """Points of the surface on rays from the middle of the head, in metres."""
    direction = np.stack(
        [
            np.sin(polar) * np.cos(azimuth),
            -np.sin(polar) * np.sin(azimuth),
            np.cos(polar) + 0.0 * azimuth,
        ],
        axis=-1,
    )
    center = np.array([0.0, -0.05, -0.2])
    inside = np.zeros(direction.shape[:2])
    outside = np.full(direction.shape[:2], 2.5)
    for _ in range(48):  # the head is star-shaped around its middle: bisection finds its surface
        middle = 0.5 * (inside + outside)
        within = _head_distance(center + direction * middle[..., None]) < 0.0
        inside, outside = np.where(within, middle, inside), np.where(within, outside, middle)
    return 0.1 * (center + direction * inside[..., None])


def _head_uv(polar: Array, azimuth: Array, crown: float) -> dict[str, Array]:
    """Texture coordinates of each chart: front and back below, the crown's disc above."""
    down = 0.78 - 0.76 * (polar - crown) / (np.pi - crown) + 0.0 * azimuth
    around = azimuth / np.pi + 0.0 * polar
    radius = 0.09 * polar / crown
    return {
        "front": np.stack([0.01 + 0.48 * around, down], axis=-1),
        "back": np.stack([0.51 + 0.48 * (around - 1.0), down], axis=-1),
        "crown": np.stack(
            [0.12 + radius * np.cos(azimuth), 0.90 + radius * np.sin(azimuth)], axis=-1
        ),
    }


def _head_pixels(size: int, crown: float) -> NDArray[np.uint8]:
    """The texture of `_head_uv`: skin, eyes, lips, hair."""
    u, v = np.meshgrid((np.arange(size) + 0.5) / size, 1.0 - (np.arange(size) + 0.5) / size)
    polar = crown + (np.pi - crown) * (0.78 - v) / 0.76
    azimuth = np.pi * np.where(u < 0.5, (u - 0.01) / 0.48, 1.0 + (u - 0.51) / 0.48)
    disc = np.stack([u - 0.12, v - 0.90], axis=-1)
    on_crown = v > 0.79
    polar = np.where(on_crown, crown * np.hypot(*disc.transpose(2, 0, 1)) / 0.09, polar)
    azimuth = np.where(on_crown, np.arctan2(disc[..., 1], disc[..., 0]), azimuth)
    across = np.sin(polar) * np.cos(azimuth)
    back = -np.sin(polar) * np.sin(azimuth)
    up = np.cos(polar)
    color = np.array([224.0, 172, 142]) + 10.0 * np.sin(25 * across + 9 * up)[..., None] * (
        1,
        0.7,
        0.6,
    )

    def paint(where: NDArray[np.bool_], r: float, g: float, b: float) -> None:
        color[where] = (r, g, b)

    eye = ((abs(across) - 0.30) / 0.11) ** 2 + ((up - 0.225) / 0.05) ** 2
    iris = (abs(across) - 0.30) ** 2 + (up - 0.225) ** 2
    front = back < -0.3
    paint(
        front
        & (abs(across) < 0.40)
        & (abs(up - 0.40 + 0.6 * (abs(across) - 0.28) ** 2) < 0.025)
        & (abs(across) > 0.14),
        92,
        58,
        40,
    )  # eyebrows
    paint(front & (eye < 1.0), 245, 245, 245)
    paint(front & (iris < 0.045**2), 60, 100, 120)
    paint(front & (iris < 0.020**2), 15, 15, 15)
    paint(front & ((across / 0.19) ** 2 + ((up + 0.46) / 0.075) ** 2 < 1.0), 178, 92, 88)  # lips
    strands = 12.0 * np.sin(60.0 * azimuth) * np.sin(polar)
    hair = up > 0.30 + 0.35 * np.clip(-back, 0.0, 1.0) - 0.75 * np.clip(back, 0.0, 1.0)
    color[hair] = np.array([84.0, 54, 34]) + strands[hair][:, None]
    return np.asarray(np.clip(color, 0, 255), np.uint8)


def car(faces: int = 268_630) -> Mesh:
    """Make a car as exported by CAD programs: unwelded panels, each face stored front and back.

    Parameters
    ----------
    faces : int
        Approximate number of faces.
    """
    materials = [
        _plain("paint", 0.55, 0.03, 0.03, metallic=0.4, roughness=0.3),
        Material("glass", (0.35, 0.45, 0.5, 0.45), 0.0, 0.05, "blend"),
        _plain("tyre", 0.03, 0.03, 0.03, roughness=0.9),
        _plain("rim", 0.6, 0.6, 0.62, metallic=0.9, roughness=0.3),
        _plain("headlight", 0.9, 0.9, 0.8),
        _plain("tail light", 0.6, 0.02, 0.02),
        _plain("underbody", 0.08, 0.08, 0.08),
        _plain("seat", 0.25, 0.16, 0.1),
    ]

    def build(density: float) -> Mesh:
        panels = _car_body(density) + _car_interior(density)
        for x in (-1.36, 1.36):
            for side in (-1.0, 1.0):
                panels += [
                    p.moved((x, 0.80 * side, 0.34), scale=(1, side, 1)) for p in _wheel(density)
                ]
        return _upright(join([p for panel in panels for p in (panel, panel.reversed())], materials))

    return _sized(build, faces)


def _car_body(density: float) -> list[Patch]:
    """Panels of the body, separated at the doors, the bonnet, the boot and the windows."""
    s = np.linspace(-1.0, 1.0, round(90 * density) + 1)[:, None]
    a = np.linspace(-0.5, 0.5, round(56 * density) + 1) * np.pi
    x = 2.2 * np.sin(0.5 * np.pi * s)
    shrink = np.maximum(1.0 - abs(s) ** 14, 1e-3) ** 0.35  # rounds front and rear
    roof = _smooth_profile(
        x,
        [-2.2, -1.9, -1.0, -0.75, -0.15, 0.55, 1.35, 1.75, 2.2],
        [0.60, 0.70, 0.88, 0.92, 1.36, 1.38, 1.05, 0.98, 0.90],
    )
    sill = 0.24
    z = sill + (roof - sill) * abs(np.cos(a)) ** 0.42
    width = 0.88 * (1.0 - 0.10 * s**4) * (1.0 - 0.30 * _step((z - 0.86) / 0.45))
    y = width * np.sign(a) * abs(np.sin(a)) ** 0.42
    points = np.stack([x + 0.0 * a, y * shrink, 0.5 + (z - 0.5) * shrink], axis=-1)
    _snap_to_wheel_arches(points, 2.2 / (40 * density))
    body = sheet(points, 0).reversed()
    # Decide by cells of the grid, so that the borders of panels follow its lines.
    center = np.tile(body.centers.reshape(2, -1, 3).mean(axis=0), (2, 1))
    cx, cy, cz = center.T
    arch = np.hypot(abs(cx) - 1.36, cz - 0.34) < 0.40
    body_part = np.digitize(cx, [-0.85, 0.22, 1.15]) * 3 + np.digitize(cy, [-0.60, 0.60])
    top = np.interp(cx, x.ravel(), roof.ravel())
    window = (cz > 0.95) & (cz < top - 0.05) & (abs(cx - 0.22) > 0.05) & (cx < 1.25) & (cx > -0.62)
    screens = (
        (cz > 0.94)
        & (abs(cy) < 0.56)
        & (((cx > -0.68) & (cx < -0.22)) | ((cx > 0.75) & (cx < 1.28)))
    )
    lamps = (abs(abs(cy) - 0.56) < 0.16) & (abs(cz - 0.66) < 0.07)
    material = np.select([window | screens, lamps & (cx < -2.0), lamps & (cx > 2.0)], [1, 4, 5], 0)
    key = material * 100 + body_part
    closed = ~((abs(cy) > 0.45) & arch)
    panels = [
        replace(body.where((key == k) & closed), material=int(k) // 100) for k in np.unique(key)
    ]
    across = np.linspace(0.0, 1.0, round(20 * density) + 1)[:, None]
    under = points[:, :1] * (1.0 - across) + points[:, -1:] * across
    return [*panels, sheet(under, 6)]


def _snap_to_wheel_arches(points: Array, reach: float) -> None:
    """Move points near the circles of the wheel arches onto them, so that the cut is round."""
    middle = np.stack([np.copysign(1.36, points[..., 0]), np.full(points.shape[:2], 0.34)], -1)
    out = points[..., [0, 2]] - middle
    distance = np.maximum(np.linalg.norm(out, axis=-1), 1e-9)
    near = (abs(distance - 0.40) < reach) & (abs(points[..., 1]) > 0.45)
    points[near] = np.insert(
        (middle + out * (0.40 / distance)[..., None])[near], 1, points[near][:, 1], axis=1
    )


def _car_interior(density: float) -> list[Patch]:
    cells = max(1, round(6 * density))
    parts: list[Patch] = []
    for x in (-0.25, 0.65):
        for y in (-0.36, 0.36):
            parts += box((x - 0.24, y - 0.24, 0.30), (x + 0.24, y + 0.24, 0.52), cells, 7)
            parts += box((x + 0.18, y - 0.22, 0.52), (x + 0.30, y + 0.22, 1.05), cells, 7)
    return parts


def _wheel(density: float) -> list[Patch]:
    """Tyre and spoked rim around the y axis; the outer side faces +y."""
    sectors = 10 * max(2, round(6 * density))
    steps = max(6, round(14 * density))
    t = np.linspace(0.0, 1.0, steps + 1)
    bulge = np.sin(np.pi * t) ** 0.4
    tyre = revolved(0.22 * t - 0.11, 0.225 + 0.115 * bulge, sectors, 2)
    r = np.linspace(0.02, 0.225, steps + 1)
    disc_x = 0.07 + 0.02 * np.cos(np.pi * r / 0.225)
    rim = revolved(disc_x[::-1], r[::-1], sectors, 3)
    _, y, z = rim.centers.T
    radius, turn = np.hypot(y, z), np.arctan2(z, y) / (2.0 * np.pi) * 5.0 % 1.0
    spokes = rim.where((radius < 0.08) | (radius > 0.19) | (turn < 0.4))
    return [p.moved(axes=(2, 0, 1)) for p in (tyre, spokes)]


def lifeboat(faces: int = 37_986, *, rng: int | np.random.Generator = 0) -> Mesh:
    """Make an open boat of thin sheets: non-manifold where they meet, boundaries everywhere.

    Parameters
    ----------
    faces : int
        Approximate number of faces.
    rng : int or numpy.random.Generator
        Seed or generator of the heap of netting in the bows, a triangle soup.
    """
    random_seed = generator_of(rng).integers(2**32)
    materials = [
        _plain("hull", 0.85, 0.25, 0.03),
        _plain("wood", 0.45, 0.28, 0.13),
        _plain("rope", 0.7, 0.62, 0.45),
        _plain("oar", 0.6, 0.5, 0.3),
    ]

    def build(density: float) -> Mesh:
        hull = _hull_points(density)
        patches = [sheet(hull, 0), *_boat_sheets(hull, density)]
        patches += _oars(density)
        patches.append(_netting(round(1500 * density**2), np.random.default_rng(random_seed)))
        return _upright(_welded(patches, materials))

    return _sized(build, faces)


def _hull_points(density: float) -> Array:
    """(stations, ribs across, 3) from stern to bow and from port to starboard gunwale."""
    s = np.linspace(-1.0, 1.0, 8 * round(12 * density) + 1)[:, None]
    t = np.linspace(-1.0, 1.0, 2 * round(16 * density) + 1)
    beam = 1.25 * (1.0 - abs(s) ** 3) ** 0.6 * (1.0 + 0.08 * s)  # 0 where the sides meet
    sheer = 0.95 + 0.28 * s**2
    keel = 0.10 + 0.55 * abs(s) ** 5
    return np.stack(
        [
            4.0 * s + 0.0 * t,
            beam * np.sign(t) * abs(t) ** 0.8,
            keel + (sheer - keel) * abs(t) ** 2.6,
        ],
        axis=-1,
    )


def _boat_sheets(hull: Array, density: float) -> list[Patch]:
    """Frames, thwarts, keel and gunwale; each begins at a row of the hull's points."""
    stations, across = hull.shape[:2]
    depth = np.linspace(0.0, 1.0, max(2, round(3 * density)) + 1)[:, None, None]
    patches = []
    for i in range(stations // 16, stations - stations // 16, max(1, stations // 24)):
        inner = hull[i] * (1.0, 0.93, 1.0) + (0.0, 0.0, 0.06)
        patches.append(sheet(hull[i] * (1.0 - depth) + inner * depth, 1))  # frames
    middle = across // 2
    keel = hull[:, middle] - (0.0, 0.0, 0.18)
    patches.append(sheet(hull[:, middle] * (1.0 - depth) + keel * depth, 0))
    for side in (0, across - 1):
        rail = hull[:, side] * (1.0, 1.06, 1.0) + (0.0, 0.0, 0.01)
        patches.append(sheet(hull[:, side] * (1.0 - depth) + rail * depth, 1))
    width = np.linspace(0.0, 1.0, max(4, round(24 * density)) + 1)[:, None, None]
    port, starboard = across // 8, across - 1 - across // 8
    for start in range(stations // 8, stations - stations // 8, max(2, stations // 6)):
        seat = slice(start, start + max(2, stations // 24))
        patches.append(sheet(hull[seat, port] * (1.0 - width) + hull[seat, starboard] * width, 1))
    return patches


def _oars(density: float) -> list[Patch]:
    sectors = max(4, round(8 * density))
    along = np.linspace(-1.6, 1.4, round(30 * density) + 2)
    blade = np.stack(
        np.meshgrid(np.linspace(1.4, 2.0, round(10 * density) + 2), np.linspace(-0.09, 0.09, 4)), -1
    )
    parts = [
        revolved(along, np.full_like(along, 0.028), sectors, 3),
        sheet(np.concatenate([blade, np.zeros((*blade.shape[:2], 1))], axis=-1), 3),
    ]
    return [p.moved((0.2, y, 0.80)) for p in parts for y in (-0.45, 0.38)]


def _netting(count: int, random: np.random.Generator) -> Patch:
    """A heap of triangles between random nearby knots, in random order."""
    knots = random.normal(size=(max(40, count // 3), 3)) * (0.30, 0.20, 0.06) + (2.3, 0.0, 0.62)
    knots = knots[np.argsort(knots[:, 0], kind="stable")]
    first = random.integers(0, len(knots) - 20, count)
    steps = np.argsort(random.random((count, 19)), axis=1)[:, :2] + 1
    return Patch(knots, np.column_stack([first, first + steps[:, 0], first + steps[:, 1]]), None, 2)


def jet(faces: int = 35_095) -> Mesh:
    """Make a business jet of open shells: manifold, every face textured.

    Parameters
    ----------
    faces : int
        Approximate number of faces.
    """
    materials = [_textured("livery", png(_livery_pixels())), _textured("engine", _checker())]

    def build(density: float) -> Mesh:
        patches = _fuselage(density, length=15.0, radius=0.95, tail_rise=0.55)
        for side in (-1.0, 1.0):
            wing = _wing(density, span=7.2, root=2.9, tip=1.1, sweep=2.3, thickness=0.11)
            patches += [p.moved((0.4, 0.75 * side, -0.55), scale=(1, side, 1)) for p in wing]
            tail = _wing(density * 0.6, span=2.6, root=1.5, tip=0.8, sweep=1.3, thickness=0.09)
            patches += [p.moved((6.0, 0.0, 2.55), scale=(1, side, 1)) for p in tail]
            patches += [p.moved((3.6, 1.45 * side, 0.45)) for p in _nacelle(density)]
        fin = _wing(density * 0.6, span=2.1, root=2.6, tip=1.5, sweep=1.5, thickness=0.09)
        patches += [p.moved((4.7, 0.0, 0.55), axes=(0, 2, 1)) for p in fin]
        return _upright(_welded(patches, materials))

    return _sized(build, faces)


def airplane(faces: int = 66_496) -> Mesh:
    """Make an agricultural biplane: some materials and faces without UV, sheets that meet.

    Parameters
    ----------
    faces : int
        Approximate number of faces.
    """
    materials = [
        _textured("livery", png(_livery_pixels())),
        _plain("engine", 0.25, 0.25, 0.27, metallic=0.8, roughness=0.5),
        _plain("tyre", 0.03, 0.03, 0.03, roughness=0.9),
        _plain("strut", 0.6, 0.6, 0.62, metallic=0.7, roughness=0.4),
        Material("canopy", (0.5, 0.7, 0.8, 0.4), 0.0, 0.05, "blend"),
        Material(
            "propeller",
            alpha_mode="blend",
            textures={"base_color": Texture(data=png(_propeller_pixels(128)))},
        ),
    ]

    def build(density: float) -> Mesh:
        patches = _fuselage(density, length=8.4, radius=0.62, tail_rise=0.25)
        lower = _wing(density, span=4.9, root=1.5, tip=1.4, sweep=0.0, thickness=0.12)
        upper = _wing(density, span=5.6, root=1.5, tip=1.4, sweep=0.0, thickness=0.12)
        for side in (-1.0, 1.0):
            low = [p.moved((-2.1, 0.35 * side, -0.45), scale=(1, side, 1)) for p in lower]
            high = [p.moved((-2.5, 0.0, 1.35), scale=(1, side, 1)) for p in upper]
            patches += low + high + _interplane_struts(low[0], high[1], density)
            patches += _fences(high[0], density)
            tail = _wing(density * 0.5, span=1.8, root=1.1, tip=0.7, sweep=0.3, thickness=0.08)
            patches += [p.moved((3.0, 0.0, 0.25), scale=(1, side, 1)) for p in tail]
            wheel = [p.moved(scale=1.1) for p in _wheel(density * 0.6)]
            patches += [p.moved((-2.0, 1.1 * side, -1.35), scale=(1, side, 1)) for p in wheel]
            patches += box((-2.05, 1.0 * side - 0.04, -1.4), (-1.95, 1.0 * side + 0.04, -0.4), 4, 3)
        fin = _wing(density * 0.5, span=1.3, root=1.3, tip=0.7, sweep=0.5, thickness=0.08)
        patches += [p.moved((2.9, 0.0, 0.30), axes=(0, 2, 1)) for p in fin]
        patches += [*_radial_engine(density), _canopy(density), _spine(patches[0])]
        return _upright(_welded(patches, materials))

    return _sized(build, faces)


def _fuselage(density: float, *, length: float, radius: float, tail_rise: float) -> list[Patch]:
    """Two halves of a body along x, nose at -x: charts that meet at top and bottom; open tail."""
    s = np.linspace(0.0, 1.0, round(60 * density) + 1)
    section = radius * np.minimum((s / 0.22) ** 0.5, 1.0) * (1.0 - 0.80 * _step((s - 0.5) / 0.5))
    section = section + 0.02 * radius
    turn = np.linspace(0.0, np.pi, round(18 * density) + 1)[:, None]  # from below to above
    x = length * (s - 0.5) + 0.0 * turn
    rise = radius * tail_rise * _step((s - 0.5) / 0.5)
    sides = []
    for side, u in ((1.0, (0.02, 0.98)), (-1.0, (0.98, 0.02))):
        y = side * section * np.sin(turn)
        y[[0, -1]] = 0.0  # the sides meet exactly
        points = np.stack([x, y, rise - section * np.cos(turn)], axis=-1)
        v = (0.52, 0.74) if side > 0 else (0.76, 0.98)
        patch = sheet(points, 0, uv_box=(u[0], v[0], u[1], v[1]))
        sides.append(patch if side < 0 else patch.reversed())
    return sides


def _wing(
    density: float, *, span: float, root: float, tip: float, sweep: float, thickness: float
) -> list[Patch]:
    """Upper side, lower side and tip of a wing along +y, open at the root; NACA 00xx sections."""
    across = np.linspace(0.0, 1.0, round(34 * density) + 1)[:, None]
    t = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, round(18 * density) + 1))
    chord = root + (tip - root) * across
    half = (
        5.0
        * thickness
        * (0.2969 * np.sqrt(t) - 0.1260 * t - 0.3516 * t**2 + 0.2843 * t**3 - 0.1036 * t**4)
    )
    half[[0, -1]] = 0.0
    x = sweep * across + chord * t
    patches = []
    for side, u in ((1.0, 0.02), (-1.0, 0.52)):
        points = np.stack([x, span * across + 0.0 * t, side * chord * half], axis=-1)
        patch = sheet(points, 0, uv_box=(u, 0.02, u + 0.46, 0.48))
        patches.append(patch if side > 0 else patch.reversed())
    above, below = (points_of.vertices.reshape(*x.shape, 3)[-1] for points_of in patches)
    patches.append(sheet(np.stack([above, below]), 0, uv_box=(0.02, 0.485, 0.48, 0.49)).reversed())
    return patches


def _nacelle(density: float) -> list[Patch]:
    """An engine cowl, open in front and behind, with its inlet duct."""
    sectors = round(24 * density)
    s = np.linspace(0.0, 1.0, round(20 * density) + 1)
    outer = revolved(2.4 * s, 0.34 + 0.10 * np.sin(np.pi * s), sectors, 1, uv_box=(0, 0, 1, 1))
    inner = revolved(2.4 * s, 0.34 - 0.04 * np.sin(np.pi * s), sectors, 1, uv_box=(0, 0, 1, 1))
    return [outer, inner.reversed().where(inner.centers[:, 0] < 1.2)]


def _interplane_struts(lower: Patch, upper: Patch, density: float) -> list[Patch]:
    """Sheets between chord lines of the lower and the upper wing, whose points they share."""
    columns = round(18 * density) + 1
    low = lower.vertices.reshape(-1, columns, 3)
    high = upper.vertices.reshape(-1, columns, 3)
    rise = np.linspace(0.0, 1.0, round(12 * density) + 1)[:, None, None]
    struts = []
    for fraction in (0.35, 0.75):
        row = round(fraction * (len(low) - 1))
        for start in (columns // 6, columns - columns // 3):
            part = slice(start, start + max(2, columns // 8))
            struts.append(sheet(low[row, part] * (1.0 - rise) + high[row, part] * rise, 3))
    return struts


def _fences(wing: Patch, density: float) -> list[Patch]:
    """Low sheets along chord lines of a wing's upper side, whose edges thereby have three faces."""
    lines = wing.vertices.reshape(-1, round(18 * density) + 1, 3)
    rows = np.linspace(0.15, 0.9, 6) * (len(lines) - 1)
    return [sheet(np.stack([lines[r], lines[r] + (0.0, 0.0, 0.06)]), 3) for r in rows.astype(int)]


def _radial_engine(density: float) -> list[Patch]:
    """Nine finned cylinders around a crankcase, and a textured propeller in front."""
    parts = []
    height = np.linspace(0.0, 1.0, 2 * round(14 * density) + 1)
    fins = 0.085 + 0.02 * (np.arange(len(height)) % 2)
    finned = revolved(0.22 + 0.36 * height, fins, max(6, round(12 * density)), 1)
    for angle in np.arange(9) * 2.0 * np.pi / 9:
        turn = [
            [0.0, np.cos(angle), np.sin(angle)],
            [0.0, -np.sin(angle), np.cos(angle)],
            [1.0, 0, 0],
        ]
        turned = product(finned.vertices, turn)
        parts.append(Patch(turned - np.array([4.05, 0.0, 0.0]), finned.faces, None, 1))
    s = np.linspace(0.0, 1.0, round(10 * density) + 1)
    parts.append(revolved(-4.65 + 0.75 * s, 0.02 + 0.26 * np.sqrt(s), round(20 * density), 1))
    y, z = np.meshgrid(*[np.linspace(-1.35, 1.35, round(8 * density) + 1)] * 2)
    disc = np.stack([np.full_like(y, -4.55), y, z], axis=-1)
    parts.append(sheet(disc, 5, uv_box=(0, 0, 1, 1)).reversed())
    return parts


def _canopy(density: float) -> Patch:
    """A glass hood over the cockpit: an open half ellipsoid."""
    turn = np.linspace(0.0, np.pi, round(16 * density) + 1)[:, None]
    along = np.linspace(0.0, np.pi, round(16 * density) + 1)
    points = np.stack(
        [
            -0.55 - 0.75 * np.cos(along) + 0.0 * turn,
            -0.36 * np.sin(along) * np.cos(turn),
            0.48 + 0.52 * np.sin(along) * np.sin(turn),
        ],
        axis=-1,
    )
    return sheet(points, 4).reversed()


def _spine(side: Patch) -> Patch:
    """An antenna: a low sheet on the ridge of the fuselage, a third face at the ridge's edges."""
    columns = int(np.argmax(np.diff(side.vertices[:, 0]) < 0)) + 1
    ridge = side.vertices.reshape(-1, columns, 3)[-1, columns // 2 : -columns // 8]
    return sheet(np.stack([ridge, ridge + np.array([0.05, 0.0, 0.12])]), 3)


def _livery_pixels() -> NDArray[np.uint8]:
    """Wings in the lower half (two charts side by side), the two sides of the fuselage above."""
    size = 512
    u, v = np.meshgrid((np.arange(size) + 0.5) / size, 1.0 - (np.arange(size) + 0.5) / size)
    color = np.full((size, size, 3), 236.0)
    chord, span = (u % 0.5 - 0.02) / 0.46, (v - 0.02) / 0.46
    wing = v < 0.5
    color[wing & (span > 0.82)] = (196, 30, 34)
    color[wing & (abs(span % 0.125 - 0.06) < 0.004)] = (150, 150, 156)  # panel lines
    color[wing & (abs(chord - 0.72) < 0.008)] = (120, 120, 126)  # ailerons
    height = (v - np.where(v < 0.75, 0.52, 0.76)) / 0.22
    body = ~wing
    color[body & (height < 0.38)] = (30, 62, 130)
    color[body & (abs(height - 0.42) < 0.03)] = (214, 168, 40)
    windows = (abs(height - 0.62) < 0.06) & (abs(u * 24 % 1.0 - 0.5) < 0.28)
    color[body & windows & (u > 0.2) & (u < 0.62)] = (28, 34, 44)
    return np.asarray(color, np.uint8)


def _propeller_pixels(size: int) -> NDArray[np.uint8]:
    """A spinning propeller: grey rings, clear outside the disc."""
    y, x = np.meshgrid(*[(np.arange(size) + 0.5) / size * 2.0 - 1.0] * 2)
    radius = np.hypot(x, y)
    pixels = np.zeros((size, size, 4))
    pixels[..., :3] = np.where(abs(radius - 0.93) < 0.04, 230, 60)[..., None]
    pixels[..., 3] = np.where(radius < 0.97, 70, 0)
    return np.asarray(pixels, np.uint8)


MODELS: dict[str, Callable[..., Mesh]] = {
    "airplane": airplane,
    "car": car,
    "head": head,
    "jet": jet,
    "lifeboat": lifeboat,
    "rocker": rocker,
}


# --- Helpers ------------------------------------------------------------------------------------
def _checked(name: str, value: int, lowest: int) -> int:
    if not value >= lowest:
        raise InputError(f"{name}: expected at least {lowest}, got {value}")
    return value


def _sized(build: Callable[[float], Mesh], faces: int) -> Mesh:
    """Build a model with about ``faces`` faces; their number grows as the squared density."""
    _checked("faces", faces, 4_000)
    density, mesh = 1.0, build(1.0)
    for _ in range(4):  # numbers of rows are rounded, so that one step is not enough
        if abs(mesh.num_faces - faces) < 0.02 * faces:
            break
        density *= float(np.sqrt(faces / mesh.num_faces))
        mesh = build(density)
    return mesh


def _welded(patches: list[Patch], materials: list[Material] | None = None) -> Mesh:
    """Join patches, and weld vertices at equal positions; collapsed faces are removed."""
    return clean(join(patches, materials or ()), duplicates="keep").mesh


def _upright(mesh: Mesh) -> Mesh:
    """Change axes from z up and front at -y to y up and front at +z."""
    return mesh.replace(vertices=mesh.vertices[:, [0, 2, 1]] * (1.0, 1.0, -1.0))


def _floor_patch(
    start: int, columns: int, rows: int, material: int = -1, u: tuple[float, float] | None = None
) -> Patch:
    """Unit squares in the xz plane, from x = start."""
    _checked("columns", columns, 1)
    _checked("rows", rows, 1)
    x, z = np.meshgrid(start + np.arange(columns + 1.0), -np.arange(rows + 1.0))
    points = np.stack([x, 0.0 * x, z], axis=-1)
    return sheet(points, material, uv_box=None if u is None else (u[0], 0.0, u[1], 1.0))


def _textured_sheet(points: Points, texcoords: Array) -> Patch:
    patch = sheet(points, material=0)
    return Patch(patch.vertices, patch.faces, texcoords.reshape(-1, 2), patch.material)


def _plain(
    name: str, r: float, g: float, b: float, *, metallic: float = 0.0, roughness: float = 0.7
) -> Material:
    return Material(name, (r, g, b, 1.0), metallic, roughness)


def _textured(name: str, image: bytes) -> Material:
    return Material(name, roughness=0.6, textures={"base_color": Texture(data=image)})


def _checker() -> bytes:
    """A picture of 64 x 64 pixels with eight squares per side."""
    size, squares = 64, 8
    i, j = np.indices((size, size)) * squares // size
    shade = np.where((i + j) % 2 == 0, 225, 130)
    return png(np.stack([shade, shade, shade + 20], axis=-1).astype(np.uint8))


def _smooth_profile(x: Array, at: list[float], values: list[float]) -> Array:
    """Linear interpolation, averaged over a window of 0.3 to smooth its corners."""
    offsets = np.linspace(-0.15, 0.15, 9)
    return np.asarray(np.mean([np.interp(x + d, at, values) for d in offsets], axis=0))


def _step(t: Array) -> Array:
    """0 below 0, 1 above 1, smooth between."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _ellipsoid(p: Array, center: ArrayLike, radii: ArrayLike) -> Array:
    scaled = (p - np.asarray(center)) / np.asarray(radii, float)
    return np.asarray((np.linalg.norm(scaled, axis=-1) - 1.0) * np.min(radii))


def _capsule(p: Array, start: ArrayLike, end: ArrayLike, radius: float) -> Array:
    a, axis = np.asarray(start, float), np.asarray(end, float) - np.asarray(start, float)
    t = np.clip(product(p - a, axis) / product(axis, axis), 0.0, 1.0)
    return np.asarray(np.linalg.norm(p - a - t[..., None] * axis, axis=-1) - radius)


def _cylinder(p: Array, center: ArrayLike, axis: int, radius: float, half_length: float) -> Array:
    """A cylinder along a coordinate axis, with rims rounded by a sixth of the radius."""
    q = p - np.asarray(center, float)
    rounding = radius / 6.0
    across = np.hypot(q[..., (axis + 1) % 3], q[..., (axis + 2) % 3]) - radius + rounding
    along = abs(q[..., axis]) - half_length + rounding
    outside = np.hypot(np.maximum(across, 0.0), np.maximum(along, 0.0))
    return np.asarray(np.minimum(np.maximum(across, along), 0.0) + outside - rounding)
