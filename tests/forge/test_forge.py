"""Attacks on scans: what they touch is exactly what they say they touch."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import manip3d
from manip3d import Box, InputError, LidarFrame, Mesh, _core, forge

Points = NDArray[np.float32]


def room(seed: int = 0, count: int = 4000) -> Points:
    """Random points in a room of 20 x 20 x 3 m around the scanner."""
    random = np.random.default_rng(seed)
    return random.uniform((-10, -10, -1.5), (10, 10, 1.5), (count, 3)).astype(np.float32)


def wall(distance: float = 8.0, step: float = math.radians(0.2)) -> Points:
    """A wall across x, on a regular angular grid."""
    azimuth, elevation = np.meshgrid(np.arange(-150, 151) * step, np.arange(-60, 61) * step)
    return np.column_stack(
        [
            np.full(azimuth.size, distance),
            distance * np.tan(azimuth.ravel()),
            distance * np.tan(elevation.ravel()) / np.cos(azimuth.ravel()),
        ]
    ).astype(np.float32)


def plate(size: float = 1.0) -> Mesh:
    """A square across x."""
    corners = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]], np.float64)
    return Mesh(size / 2 * corners, [[0, 1, 2], [0, 2, 3]])


def grid_plate(count: int = 41, size: float = 1.0) -> Points:
    """The same as points on a grid."""
    side = np.linspace(-size / 2, size / 2, count)
    y, z = np.meshgrid(side, side)
    return np.column_stack([np.zeros(y.size), y.ravel(), z.ravel()]).astype(np.float32)


def spacing(points: Points) -> float:
    return float(cKDTree(points).query(points, k=2)[0][:, 1].mean())


BOX = Box((3.0, 1.0, 0.0), (4.0, 2.0, 2.0), 0.5)

ATTACKS: dict[str, Callable[..., forge.Forgery]] = {
    "ctp": lambda s, **k: forge.ctp(s, grid_plate(), position=(4, 0, 0), rotation=0.3, **k),
    "ctp paper": lambda s, **k: forge.ctp(
        s, grid_plate(), position=(4, 0, 0), translation="paper", **k
    ),
    "crtp": lambda s, **k: forge.crtp(s, grid_plate(), position=(4, 0, 0), **k),
    "crtp finer": lambda s, **k: forge.crtp(s, plate(), position=(4, 0, 0), spacing=0.02, **k),
    "subtract": lambda s, **k: forge.subtract(s, BOX, **k),
    "deform": lambda s, **k: forge.deform(s, BOX, amplitude=0.1, rng=3, **k),
    "dent": lambda s, **k: forge.deform(s, BOX, amplitude=0.1, direction="normal", **k),
    "insert": lambda s, **k: forge.insert_occluding(
        s, plate(), position=(2, 0, 0), range_noise=0.01, rng=5, **k
    ),
    "insert cloud": lambda s, **k: forge.insert_occluding(s, grid_plate(), position=(2, 0, 0), **k),
    "additive": lambda s, **k: forge.additive(
        s, grid_plate(), offset=(4, 0, 0), allow_collision=True, **k
    ),
    "subtractive": lambda s, **k: forge.subtractive(s, BOX, **k),
    "additive_subtractive": lambda s, **k: forge.additive_subtractive(
        s, grid_plate(), BOX, offset=(-4, 0, 0), allow_collision=True, **k
    ),
    "replacement": lambda s, **k: forge.replacement(
        s, grid_plate(), BOX, allow_collision=True, **k
    ),
    "translation": lambda s, **k: forge.translation(s, BOX, allow_collision=True, **k),
    "rotation": lambda s, **k: forge.rotation(s, BOX, sideways=2.0, allow_collision=True, **k),
}


WIDE = Box((3.0, 1.0, 0.0), (8.0, 4.0, 2.0), 0.5)  # contains the origin

AROUND_ORIGIN: dict[str, Callable[..., forge.Forgery]] = {
    "subtract": lambda s: forge.subtract(s, WIDE),
    "deform": lambda s: forge.deform(s, WIDE, amplitude=0.1, rng=3),
    "dent": lambda s: forge.deform(s, WIDE, amplitude=0.1, direction="normal"),
    "subtractive": lambda s: forge.subtractive(s, WIDE),
    "additive_subtractive": lambda s: forge.additive_subtractive(
        s, grid_plate(), WIDE, offset=(-4, 0, 0), allow_collision=True
    ),
    "replacement": lambda s: forge.replacement(s, grid_plate(), WIDE, allow_collision=True),
    "translation": lambda s: forge.translation(s, WIDE, allow_collision=True),
    "rotation": lambda s: forge.rotation(s, WIDE, allow_collision=True),
}


# Points of the room that an attack moves: those in the box, or behind the plate.
MOVED = dict.fromkeys(("deform", "dent", "translation", "rotation"), 56)
MOVED |= {"insert": 239, "insert cloud": 251}
MOVED["dent"] = 34  # the box's corners lie beyond the dent


@pytest.mark.parametrize("name", ATTACKS)
def test_truth_is_exact(name: str) -> None:
    scan = room()
    intensity = np.linspace(0, 1, len(scan), dtype=np.float32)
    forged = ATTACKS[name](LidarFrame(scan, intensity))
    index = forged.source_index
    assert forged.num_touched > 0
    # Every point is an original one, bit for bit, or is marked.
    untouched = forged.label == 0
    np.testing.assert_array_equal(forged.points[untouched], scan[index[untouched]])
    assert forged.intensity is not None
    kept = index >= 0
    np.testing.assert_array_equal(forged.intensity[kept], intensity[index[kept]])
    # Moved points really moved; what is missing is what was removed.
    np.testing.assert_array_equal(index[forged.moved], forged.moved_from)
    moved = (forged.points[forged.moved] != scan[forged.moved_from]).any(axis=1)
    assert len(moved) == MOVED.get(name, 0)
    assert moved.all()
    missing = np.setdiff1d(np.arange(len(scan)), index)
    np.testing.assert_array_equal(missing, forged.removed)
    np.testing.assert_array_equal(np.flatnonzero(index < 0), forged.added)
    assert (np.diff(index[kept]) > 0).all()
    # The box holds what was added and moved.
    touched = forged.points[forged.label > 0] if (forged.label > 0).any() else scan[forged.removed]
    low = np.asarray(forged.box.center) - np.asarray(forged.box.size) / 2
    np.testing.assert_allclose(touched.min(axis=0), low, atol=1e-6)
    np.testing.assert_allclose(np.ptp(touched, axis=0), forged.box.size, atol=1e-5)
    assert forged.frame.num_points == len(forged.points)


@pytest.mark.parametrize("name", ATTACKS)
def test_threads_and_layout_do_not_matter(name: str) -> None:
    scan = room(1, 150_000)  # three chunks
    first = ATTACKS[name](scan, threads=1)
    for threads, given in ((2, scan), (4, np.asfortranarray(scan))):
        again = ATTACKS[name](given, threads=threads)
        for field in ("points", "added", "moved", "moved_from", "removed", "transform"):
            np.testing.assert_array_equal(getattr(first, field), getattr(again, field))
    assert first.intensity is None


def test_centroid_lands_on_the_position() -> None:
    hoax = grid_plate() + np.float32(7)
    forged = forge.ctp(room(), hoax, position=(4, 2, 1), rotation=1.0, scale=2.0)
    pasted = forged.points[forged.added].astype(np.float64)
    np.testing.assert_allclose(pasted.mean(axis=0), (4, 2, 1), atol=1e-5)
    turn = forge.ctp(room(), hoax, position=(4, 2, 1), rotation=0.0, scale=2.0)
    before = turn.points[turn.added] - np.float32([4, 2, 1])
    c, s = math.cos(1.0), math.sin(1.0)
    rotated = before @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T
    np.testing.assert_allclose(pasted - [4, 2, 1], rotated, atol=1e-5)


def test_printed_translation_lands_elsewhere() -> None:
    scene, hoax = room() + np.float32([1, 2, 0]), grid_plate() + np.float32(7)
    forged = forge.ctp(scene, hoax, position=(4, 2, 1), translation="paper")
    o_scene, o_object = scene.mean(axis=0, dtype=float), hoax.mean(axis=0, dtype=float)
    t = np.array([4, 2, 1]) - (o_scene - o_object)
    np.testing.assert_allclose(forged.transform[:3, 3], t, atol=1e-6)
    np.testing.assert_allclose(forged.points[forged.added], hoax + t, atol=1e-5)


def test_printed_translation_leaves_out_firings_without_a_return() -> None:
    returns, none = room() + np.float32([1, 2, 0]), np.zeros((500, 3), np.float32)
    options = {"position": (4, 2, 1), "translation": "paper"}
    forged = forge.ctp(np.concatenate([none, returns]), grid_plate(), **options)
    expected = forge.ctp(returns, grid_plate(), **options).transform
    np.testing.assert_allclose(forged.transform, expected, rtol=1e-12)


@pytest.mark.parametrize("resampling", ["poisson", "uniform"])
@pytest.mark.parametrize("factor", [1.5, 3.0])
def test_thinning_reaches_the_spacing(resampling: str, factor: float) -> None:
    hoax = grid_plate(81)
    goal = factor * spacing(hoax)
    thinned = forge.resample(hoax, spacing=goal, resampling=resampling, rng=1)
    assert spacing(thinned) == pytest.approx(goal, rel=0.08)
    assert len({*map(tuple, thinned.tolist())} - {*map(tuple, hoax.tolist())}) == 0


@pytest.mark.parametrize("lone", [0, 3], ids=["one piece", "lone points"])
@pytest.mark.parametrize("goal", [0.02, 0.1, 0.6])
def test_poisson_disks_are_apart_and_full(goal: float, lone: int) -> None:
    """Some radius is at most the distance of all that stay and more than that of all that go."""
    random = np.random.default_rng(4)
    hoax = np.vstack([random.random((4000, 3)), 50.0 + 20.0 * random.random((lone, 3))])
    hoax = np.ascontiguousarray(hoax, np.float32)
    stays = cKDTree(forge.resample(hoax, spacing=goal, rng=2))
    assert stays.query(hoax)[0].max() < stays.query(stays.data, k=2)[0][:, 1].min()


@pytest.mark.parametrize("hoax", [plate(), grid_plate(21)], ids=["faces", "points"])
def test_interpolation_stays_on_the_surface(hoax: object) -> None:
    finer = forge.resample(hoax, spacing=0.02, rng=1)
    assert spacing(finer) == pytest.approx(0.02, rel=0.05)
    assert np.abs(finer[:, 0]).max() == 0.0
    assert np.abs(finer[:, 1:]).max() <= 0.5 + 1e-6


def test_points_between_neighbours_lie_in_triangles_and_not_on_their_sides() -> None:
    corners = np.float32([[0, 0, 0], [0, 1, 0], [0, 0.3, 0.8]])
    made = forge.resample(corners, spacing=0.05, rng=1).astype(np.float64)
    weights = np.linalg.solve(
        np.c_[corners[:, 1:], np.ones(3)].T, np.c_[made[:, 1:], np.ones(len(made))].T
    )
    assert len(made) > 100
    assert (weights.min(axis=0) < 1e-6).sum() <= 3  # the corners themselves


def test_two_points_are_interpolated_between_them() -> None:
    made = forge.resample([[0, 0, 0], [1, 0, 0]], spacing=0.1, rng=1)
    assert spacing(made) == pytest.approx(0.1, rel=0.1)
    np.testing.assert_array_equal(made[:, 1:], 0.0)


@pytest.mark.parametrize("copies", [2, 7])
def test_an_object_whose_points_are_stored_several_times_has_the_spacing_of_one(
    copies: int,
) -> None:
    once = room(5, 1000)
    several = np.repeat(once, copies, axis=0)
    finer = forge.resample(several, spacing=0.5 * spacing(once), rng=3)
    np.testing.assert_array_equal(finer, forge.resample(once, spacing=0.5 * spacing(once), rng=3))
    for resampling in ("poisson", "uniform"):
        goal = 2.0 * spacing(once)
        made = forge.resample(several, spacing=goal, resampling=resampling, rng=3)
        assert spacing(np.unique(made, axis=0)) == pytest.approx(goal, rel=0.08)


def test_faces_without_area_have_no_points() -> None:
    line = Mesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
    assert forge.resample(line, spacing=0.1).shape == (0, 3)


def test_points_of_a_triangle_fill_it_evenly() -> None:
    corners = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.3, 0.8]])
    made = forge.resample(Mesh(corners, [[0, 1, 2]]), spacing=0.02, rng=1).astype(np.float64)
    weights = np.linalg.solve(
        np.c_[corners[:, 1:], np.ones(3)].T, np.c_[made[:, 1:], np.ones(len(made))].T
    )
    assert weights.min() > -1e-6
    np.testing.assert_allclose(weights.mean(axis=1), 1 / 3, atol=0.01)
    # A quarter of the area lies nearer to each corner than half of the way to the other side.
    np.testing.assert_allclose((weights > 0.5).mean(axis=1), 1 / 4, atol=0.03)


def test_crtp_takes_the_spacing_around_the_position() -> None:
    scene = wall(4.0)
    near = np.linalg.norm(scene - np.float32([4, 0, 0]), axis=1) <= 1.0
    mid = cKDTree(scene).query(scene[near], k=2)[0][:, 1].mean()
    forged = forge.crtp(scene, grid_plate(301), position=(4, 0, 0))
    assert forged.parameters["spacing"] == pytest.approx(mid, rel=1e-6)
    assert spacing(forged.points[forged.added]) == pytest.approx(mid, rel=0.05)


def test_subtract_is_the_box() -> None:
    scan = room()
    np.testing.assert_array_equal(
        forge.subtract(scan, BOX).removed, np.flatnonzero(BOX.contains(scan))
    )
    rows = np.array([5, 3, 3, 17])
    np.testing.assert_array_equal(forge.subtract(scan, rows=rows).removed, [3, 5, 17])


def test_random_deformation_is_bounded_and_centred() -> None:
    scan = room(2, 60_000)
    forged = forge.deform(scan, BOX, amplitude=0.2, rng=1)
    move = forged.points[forged.moved].astype(float) - scan[forged.moved_from]
    length = np.linalg.norm(move, axis=1)
    assert length.max() <= 0.2 + 1e-6
    assert length.mean() == pytest.approx(0.15, rel=0.03)  # 3/4 of the radius of a ball
    assert np.abs(move.mean(axis=0)).max() < 0.01


def test_dent_points_away_from_the_scanner() -> None:
    scan = wall()
    box = Box((8.0, 0.0, 0.0), (1.0, 2.0, 2.0))
    forged = forge.deform(scan, box, amplitude=0.3, direction="normal")
    move = forged.points[forged.moved] - scan[forged.moved_from]
    d = 2 * scan[forged.moved_from] / np.float32([np.inf, 2, 2])
    profile = np.maximum(0, 1 - (d**2).sum(axis=1)) ** 2
    np.testing.assert_allclose(move[:, 0], 0.3 * profile, atol=2e-3)
    assert np.abs(move[:, 1:]).max() < 2e-3


@pytest.mark.parametrize("hoax", [plate(), grid_plate(81)], ids=["faces", "points"])
def test_inserted_object_hides_what_is_behind(hoax: object) -> None:
    scan = wall()
    forged = forge.insert_occluding(scan, hoax, position=(4, 0, 0))
    # Every ray keeps its direction; those through the plate end on it.
    after = forged.points / np.linalg.norm(forged.points, axis=1, keepdims=True)
    before = scan / np.linalg.norm(scan, axis=1, keepdims=True)
    np.testing.assert_allclose(after, before, atol=1e-6)
    crossing = np.abs(scan[:, 1:] * 0.5).max(axis=1)
    hit = forged.label == 2
    assert hit[crossing < 0.499].all()
    assert not hit[crossing > 0.52].any()
    depth = 1e-5 if isinstance(hoax, Mesh) else 5e-3  # a point is a disc across the ray
    np.testing.assert_allclose(forged.points[hit, 0], 4.0, atol=depth)


def test_rays_into_the_sky_hit_the_object_too() -> None:
    lattice = forge.Lattice.grid(np.radians(np.arange(-10, 10, 0.5)), math.radians(0.5))
    forged = forge.insert_occluding(
        np.zeros((0, 3), np.float32), plate(), position=(4, 0, 0), lattice=lattice
    )
    pasted = forged.points[forged.added].astype(float)
    azimuth = np.degrees(np.arctan2(pasted[:, 1], pasted[:, 0]))
    elevation = np.degrees(np.arctan2(pasted[:, 2], np.hypot(pasted[:, 0], pasted[:, 1])))
    np.testing.assert_allclose(azimuth / 0.5, np.round(azimuth / 0.5), atol=1e-4)
    np.testing.assert_allclose(elevation / 0.5, np.round(elevation / 0.5), atol=1e-4)
    np.testing.assert_allclose(pasted[:, 0], 4.0, atol=1e-5)
    expected = sum(
        abs(4 * math.tan(a)) <= 0.5 and abs(4 * math.tan(e) / math.cos(a)) <= 0.5
        for a in np.radians(np.arange(-20, 20.1, 0.5))
        for e in np.radians(np.arange(-10, 10, 0.5))
    )
    assert len(pasted) == expected


@pytest.mark.parametrize("along", ["height", "ray"])
def test_snapped_points_lie_on_the_lattice(along: str) -> None:
    rings = np.column_stack(
        [np.tan(np.radians(np.linspace(-24, 2, 64))), np.linspace(0.1, 0.2, 64)]
    )
    lattice = forge.Lattice(rings, math.radians(0.18), 0.001)
    forged = forge.ctp(room(), grid_plate(), position=(6, 1, -1))
    snapped = forge.snap_to_lattice(forged, lattice, along=along)
    p = snapped.points[snapped.added].astype(float)
    rho = np.hypot(p[:, 0], p[:, 1])
    height = np.abs(p[:, 2, None] - rho[:, None] * rings[:, 0] - rings[:, 1]).min(axis=1)
    assert height.max() < 2e-6
    steps = (np.arctan2(p[:, 1], p[:, 0]) - 0.001) / math.radians(0.18)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)
    np.testing.assert_array_equal(snapped.points[: len(room())], room())
    np.testing.assert_array_equal(snapped.label, forged.label)


def test_rows_without_a_return_are_not_snapped() -> None:
    scan = np.array([[8, 1, 0.3], [0, 0, 0]], np.float32)
    rings = [(-0.1, 1.7), (-0.2, 1.7)]
    rows = np.array([0, 1], np.int32)
    points = _core.snap_to_lattice(
        scan, np.ones(2, np.float32), rows, rings, 0.003, 0.0, True, True, 1.0, 1
    )[0]
    assert (points[0] != scan[0]).any()
    np.testing.assert_array_equal(points[1], [0, 0, 0])


@pytest.mark.parametrize("kind", ["float64", "Fortran", "strided", "big-endian"])
def test_points_of_any_layout_are_snapped(kind: str) -> None:
    lattice = forge.Lattice.grid(np.radians([-2, 0, 2]), np.radians(0.5))
    forged = forge.ctp(room(), grid_plate(), position=(6, 1, -1))
    given = {
        "float64": forged.points.astype(np.float64),
        "Fortran": np.asfortranarray(forged.points),
        "strided": np.repeat(forged.points, 2, axis=0)[::2],
        "big-endian": forged.points.astype(">f4"),
    }[kind]
    snapped = forge.snap_to_lattice(dataclasses.replace(forged, points=given), lattice)
    expected = forge.snap_to_lattice(forged, lattice)
    np.testing.assert_array_equal(snapped.points, expected.points)


def _street(*things: Points) -> Points:
    ground = np.mgrid[-20:20:0.5, -20:20:0.5, -1.5:-1:1].reshape(3, -1).T
    return np.vstack([ground, *things]).astype(np.float32)


def test_objects_are_not_moved_into_others() -> None:
    """A car before a wall: straight on, sideways, turned, replaced by a longer one.

          +--+    |
    o     |  |    | wall
          +--+    |
       4     6   7.5
    """
    car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T.astype(np.float32)
    wall = np.mgrid[7.5:8:0.2, -3:3:0.2, -1.2:2:0.2].reshape(3, -1).T
    box = Box((5.0, 0.0, -0.3), (2.4, 2.4, 2.2))
    scan = _street(car, wall)
    attacks: list[tuple[Callable[..., forge.Forgery], dict[str, Any], str]] = [
        (forge.translation, {"distance": 3.0}, "distance: expected a free place"),
        (forge.replacement, {"object_points": car * [4, 1, 1]}, "object_points: expected a free"),
    ]
    for attack, options, words in attacks:
        with pytest.raises(InputError, match=words):
            attack(scan, box=box, **options)
        assert attack(scan, box=box, allow_collision=True, **options).num_touched
        attack(_street(car), box=box, **options)  # without the wall
    forge.translation(scan, box, distance=1.0)  # there is room, and its own points leave
    forge.rotation(scan, box)
    forge.replacement(scan, car, box)
    fence = np.mgrid[4:6:0.2, 2.2:2.4:0.1, -1.2:1:0.2].reshape(3, -1).T
    with pytest.raises(InputError, match="angle, sideways: expected a free place"):
        forge.rotation(_street(car, fence), box, sideways=2.0)
    forge.rotation(_street(car, fence), box, sideways=-2.0)
    post = np.array([[4.9, 1.0, 0.0]])  # in the way of a corner
    tight = Box((4.9, -0.1, -0.3), (1.9, 1.9, 2.2))
    with pytest.raises(InputError, match="angle: expected a free place, got one with 1 point of"):
        forge.rotation(_street(car, post), tight, angle=0.8)


CAR_BOX = Box((5.0, 0.0, -0.3), (2.4, 2.4, 2.2))


@pytest.mark.parametrize(
    ("forged", "name"),
    [
        (lambda scan, torn: forge.additive(scan, torn, offset=(0, 6, 0)), "object_points"),
        (lambda scan, torn: forge.additive_subtractive(scan, torn, CAR_BOX), "object_points"),
        (lambda scan, torn: forge.replacement(scan, torn, CAR_BOX), "object_points"),
        (forge.range_scale, "hoax"),
        (lambda scan, torn: forge.range_scale(torn, scan), "scan"),
    ],
)
def test_coordinates_that_are_not_finite_are_of_the_argument_that_has_them(
    forged: Callable[[np.ndarray, np.ndarray], object], name: str
) -> None:
    """The scale of a scan with one of them was NaN, and objects were refused for their offset."""
    car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T.astype(np.float32)
    torn = car.copy()
    torn[7, 1] = np.nan
    with pytest.raises(InputError, match=f"^{name}: expected finite numbers, got others in row 7"):
        forged(_street(car), torn)


def test_the_extent_of_a_scan_may_exceed_float32() -> None:
    scan = np.array([[-3e38, 0, 0], [3e38, 0, 0]], np.float32)
    assert forge.range_scale(scan, [[0, 0, 0], [2, 0, 0]]) == pytest.approx(3e38)


def test_a_row_that_is_given_twice_is_removed_once() -> None:
    forged = forge.subtract(room(), rows=[3, 3, 8])
    assert forged.parameters["rows"] == len(forged.removed) == 2


def test_an_object_above_the_scanner_can_turn_but_has_no_side() -> None:
    blob = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    box = Box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0))
    assert forge.rotation(blob, box, allow_collision=True).num_touched
    with pytest.raises(InputError, match="box: expected a centre beside the scanner's vertical"):
        forge.rotation(blob, box, sideways=1.0, allow_collision=True)


def test_the_place_of_a_turned_object_is_turned() -> None:
    """A long car at 45 degrees passes a pole that its upright box would hold."""
    turn = np.array([[1.0, -1.0], [1.0, 1.0]]) / math.sqrt(2.0)
    car = np.mgrid[-3:3:0.2, -0.5:0.5:0.2, -1.2:0.4:0.2].reshape(3, -1).T
    car[:, :2] = car[:, :2] @ turn.T
    pole = np.tile([[12.0, -2.0, 0.0]], (30, 1)) + np.linspace(0, 0.1, 30)[:, None]
    box = Box((8.0, 0.0, -0.4), (6.4, 1.4, 1.9), math.pi / 4)
    there = car + np.array([8.0, 0.0, 0.0])
    forge.translation(_street(there, pole), box, distance=3.0)
    with pytest.raises(InputError, match="free place"):
        forge.translation(_street(there, pole + np.array([-1.0, 2.0, 0.0])), box, distance=3.0)


def test_what_leaves_makes_room() -> None:
    car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T.astype(np.float32)
    box = Box((5.0, 0.0, -0.3), (2.4, 2.4, 2.2))
    forged = forge.additive_subtractive(_street(car), car, box, offset=(0.3, 0.0, 0.0))
    assert len(forged.added) == len(car)
    with pytest.raises(InputError, match="offset: expected a free place"):
        forge.additive(_street(car), car, offset=(0.3, 0.0, 0.0))


def test_alert_transforms() -> None:
    scan = room(4, 40_000)
    away = forge.translation(scan, BOX, distance=3.0, allow_collision=True)
    unit = np.array([3.0, 1.0, 0.0]) / math.hypot(3, 1)
    np.testing.assert_allclose(
        away.points[away.moved] - scan[away.moved_from],
        np.tile(3 * unit, (len(away.moved), 1)),
        atol=1e-5,
    )
    turned = forge.rotation(scan, BOX, allow_collision=True)
    old = scan[turned.moved_from].astype(float)
    new = turned.points[turned.moved].astype(float)
    np.testing.assert_allclose(old.mean(axis=0), new.mean(axis=0), atol=1e-5)
    a = np.radians(-10)
    matrix = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    np.testing.assert_allclose(
        (old - old.mean(axis=0)) @ matrix.T, new - new.mean(axis=0), atol=1e-5
    )
    swapped = forge.replacement(scan, grid_plate(), BOX, allow_collision=True)
    np.testing.assert_allclose(
        swapped.points[swapped.added].mean(axis=0, dtype=float),
        scan[swapped.removed].mean(axis=0, dtype=float),
        atol=1e-5,
    )
    with pytest.raises(InputError, match="expected a free place"):
        forge.additive(
            scan,
            grid_plate()
            + np.float32([4, 0, 0])
            + np.random.default_rng(0).normal(0, 0.5, (1681, 3)),
        )


def street() -> tuple[Points, list[Box]]:
    """Ground on a grid, three boxes of points on it, a wall."""
    side = np.arange(-30, 30, 0.2)
    x, y = np.meshgrid(side, side)
    ground = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -1.7) + 0.02 * x.ravel()])
    boxes = [
        Box((6, 3, -0.8), (4, 1.6, 1.4), 0.5),
        Box((-9, -4, -1.1), (2, 1, 1.4), 0.0),
        Box((15, -12, -0.6), (3, 2, 1.4), -0.7),
    ]
    random = np.random.default_rng(0)
    things = [ground]
    for box in boxes:
        local = random.uniform(-0.5, 0.5, (2000, 3)) * box.size
        c, s = math.cos(box.yaw), math.sin(box.yaw)
        things.append(local @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + box.center)
    wide = random.uniform((-25, 20, -1.5), (25, 20.2, 3), (20_000, 3))
    return np.concatenate([*things, wide]).astype(np.float32), boxes


def test_segmentation_finds_the_boxes() -> None:
    scan, boxes = street()
    found = forge.segment(scan)
    assert len(found.boxes) == 3  # and not the wall
    first = len(scan) - 26_000
    for index, box in enumerate(boxes[i] for i in (0, 1, 2)):
        part = found.label[first + 2000 * index : first + 2000 * (index + 1)]
        nearest = int(np.bincount(part[part >= 0]).argmax())
        assert (part == nearest).mean() > 0.8
        np.testing.assert_allclose(found.boxes[nearest].center[:2], box.center[:2], atol=0.2)
    assert (found.label[:first] == -1).mean() > 0.97
    assert forge.nearest_object(scan) == found.boxes[0]
    assert found.boxes[0].center[0] == pytest.approx(6, abs=0.2)
    again = forge.segment(scan)
    np.testing.assert_array_equal(found.label, again.label)


def test_the_carrier_of_the_scanner_is_not_the_nearest_object() -> None:
    """The scanner stands on a mast at the edge of a roof; yaws and places of the whole vary."""
    car = np.mgrid[4:6:0.2, -1:1:0.2, -1:0.4:0.2].reshape(3, -1).T
    for beside, is_carrier in ((-1.0, True), (0.3, True), (0.9, True), (1.4, False)):
        roof = np.mgrid[beside : beside + 1.2 : 0.1, -0.6:0.6:0.1, -0.5:-0.3:0.1].reshape(3, -1).T
        for turn in (0.0, 2.0):
            c, s, shift = math.cos(turn), math.sin(turn), np.array([100.0, -50.0, 3.0])
            scan = _street(car, roof) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + shift
            first = forge.segment(scan, origin=shift).boxes[0]
            assert np.linalg.norm(first.center - shift) < 3.0
            if not is_carrier:
                assert forge.nearest_object(scan, origin=shift) == first
                continue
            found = forge.nearest_object(scan, origin=shift)
            np.testing.assert_allclose(found.center[:2] - shift[:2], (5 * c, 5 * s), atol=0.3)
    with pytest.raises(InputError, match="more than 1 m from the scanner, found none"):
        forge.nearest_object(_street(roof - np.array([beside, 0, 0])))


def test_rows_without_a_return_are_no_object() -> None:
    """Scans that are written firing by firing hold (0, 0, 0) where nothing came back."""
    scan, _ = street()
    empty = np.zeros((500, 3), np.float32)
    mixed = np.concatenate([empty, scan, empty])
    found = forge.segment(mixed)
    assert found.boxes == forge.segment(scan).boxes
    np.testing.assert_array_equal(found.label[500:-500], forge.segment(scan).label)
    assert set(found.label[:500]) | set(found.label[-500:]) == {-2}
    assert len(forge.translation(mixed, distance=0.5, allow_collision=True).moved) > 100


@pytest.mark.parametrize("name", AROUND_ORIGIN)
def test_rows_without_a_return_are_in_no_box(name: str) -> None:
    """Organised clouds hold (0, 0, 0) where nothing came back; these boxes contain the origin."""
    scan = room()
    rows = np.arange(0, len(scan) + 1, 8)  # before, between and after the points
    mixed = np.insert(scan, rows, 0.0, axis=0)
    is_empty = ~mixed.any(axis=1)
    assert WIDE.contains(np.zeros((1, 3)))[0]
    forged = AROUND_ORIGIN[name](mixed)
    assert not is_empty[forged.moved_from].any()
    assert not is_empty[forged.removed].any()
    alone = AROUND_ORIGIN[name](scan)
    assert len(forged.moved) == len(alone.moved)
    assert len(forged.removed) == len(alone.removed)
    np.testing.assert_array_equal(forged.points[forged.added], alone.points[alone.added])


def test_rows_without_a_return_occupy_no_place() -> None:
    """The empty rows are in the middle of the place to which the car moves."""
    car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T.astype(np.float32)
    scan = _street(car, np.zeros((50, 3)))
    box = Box((5.0, 0.0, -0.3), (2.4, 2.4, 2.2))
    assert len(forge.translation(scan, box, distance=-5.0).moved) == len(car)


@pytest.mark.parametrize("empty", [0, 500])
def test_points_stored_twice_have_the_spacing_of_one(empty: int) -> None:
    """Some scans of rooms hold each point twice; rows without a return are at the origin."""
    once = room(3, 40_000)
    twice = np.concatenate([np.zeros((empty, 3), np.float32), np.repeat(once, 2, axis=0)])
    one, two = (forge.crtp(s, grid_plate(), position=(0.3, 0, 0)) for s in (once, twice))
    assert two.parameters["spacing"] == one.parameters["spacing"]
    np.testing.assert_array_equal(two.points[two.added], one.points[one.added])
    with pytest.raises(InputError, match=r"position: expected scene points within .* different"):
        forge.crtp(np.ones((500, 3)), grid_plate(), position=(1, 1, 1))


@pytest.mark.parametrize("axes", [(1.0, -1.0, 0, 1), (-1.0, 1.0, 0, 1), (1.0, 1.0, 1, 0)])
def test_the_ground_is_the_same_seen_from_any_side(axes: tuple[float, float, int, int]) -> None:
    """Its cells lie around the scanner, which stands in the middle of one."""
    random = np.random.default_rng(5)
    scan = random.uniform((-20, -20, 0), (20, 20, 1.5), (6000, 3)).astype(np.float32)
    scan[:, 2] += 0.4 * np.sin(scan[:, 0] / 2) + 0.3 * np.cos(scan[:, 1] / 3)
    sign_x, sign_y, first, second = axes
    turned = scan[:, [first, second, 2]] * np.float32([sign_x, sign_y, 1.0])
    ground = forge.segment(scan).label == -1
    assert 0.1 < ground.mean() < 0.6
    np.testing.assert_array_equal(forge.segment(turned).label == -1, ground)


HOSTILE = {
    "empty": np.zeros((0, 3)),
    "one": np.ones((1, 3)),
    "same": np.ones((500, 3)),
    "far": np.full((10, 3), 1e9),
    "origin": np.zeros((7, 3)),
    "duplicates": np.repeat(room(0, 50), 3, axis=0),
}
OUTSIDE = HOSTILE.keys() - {"one", "same"}  # without a point in the box of the attacks
REFUSALS = {
    "crtp": HOSTILE.keys(),
    "dent": HOSTILE.keys(),
    "insert": HOSTILE.keys() - {"duplicates"},
    "insert cloud": HOSTILE.keys() - {"duplicates"},
    **dict.fromkeys(("subtract", "deform", "subtractive", "additive_subtractive"), OUTSIDE),
    **dict.fromkeys(("replacement", "translation", "rotation"), OUTSIDE),
}
"""Scans that an attack refuses, because it would change nothing or cannot tell their spacing."""


@pytest.mark.parametrize("name", ATTACKS)
@pytest.mark.parametrize("kind", HOSTILE)
def test_hostile_scans(name: str, kind: str) -> None:
    scan = HOSTILE[kind]
    if kind in REFUSALS.get(name, ()):
        with pytest.raises(InputError):
            ATTACKS[name](scan)
        return
    forged = ATTACKS[name](scan)
    assert np.isfinite(forged.points).all()
    assert len(forged.source_index) == len(forged.points) == len(forged.label)
    assert len(forged.points) == len(scan) + len(forged.added) - len(forged.removed)


@pytest.mark.parametrize("name", ATTACKS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_scans_that_are_not_finite(name: str, value: float) -> None:
    scan = room()
    scan[1234, 1] = value
    with pytest.raises(InputError, match="row 1234"):
        ATTACKS[name](scan)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: forge.ctp(s, grid_plate(), position=(0, 0)), "position: expected three"),
        (lambda s: forge.ctp(s, grid_plate(), position=(0, 0, np.nan)), "position"),
        (lambda s: forge.ctp(s, np.zeros((0, 3)), position=(0, 0, 0)), "hoax: expected points"),
        (lambda s: forge.ctp(s, grid_plate(), position=(0, 0, 0), scale=0), "scale: expected > 0"),
        (lambda s: forge.ctp(s, grid_plate(), position=(0, 0, 0), scale=np.nan), "scale"),
        (
            lambda s: forge.ctp(s, grid_plate(), position=(0, 0, 0), rotation=np.ones((3, 3))),
            "rotation: expected a rotation matrix",
        ),
        (
            lambda s: forge.ctp(s, grid_plate(), position=(0, 0, 0), scale=1e39, threads=1),
            "beyond the finite floats",
        ),
        (lambda s: forge.ctp(s, grid_plate(), position=(0, 0, 0), threads=-1), "threads"),
        (
            lambda s: forge.ctp(s, grid_plate(), position=(0, 0, 0), translation="odd"),
            "translation: expected 'centroid' or 'paper'",
        ),
        (
            lambda s: forge.crtp(s, grid_plate(), position=(0, 90, 0)),
            "expected scene points within",
        ),
        (lambda s: forge.crtp(s, grid_plate(), position=(0, 0, 0), spacing=0), "spacing"),
        (lambda s: forge.crtp(s, grid_plate(), position=(0, 0, 0), spacing=1e-7), "spacing"),
        (lambda s: forge.crtp(s, np.ones((5, 3)), position=(0, 0, 0)), "different places"),
        *(
            (
                lambda _, step=step: forge.resample([[0, 0, 0], [1, 0, 0]], spacing=step),
                r"spacing: needs .* points of the object's surface, at most 2\^24",
            )
            for step in (1e-5, 1e-8, 1e-10)
        ),
        (lambda s: forge.subtract(s), "either a box or rows"),
        (lambda s: forge.subtract(s, rows=[9999]), "rows: expected 0 to 3999, got 9999"),
        (lambda s: forge.subtract(s, Box((0, 0, 0), (-1, 1, 1))), "size: expected numbers >= 0"),
        (
            lambda s: forge.subtract(s, Box((0, 0, np.nan), (1, 1, 1))),
            "center: expected finite numbers",
        ),
        (lambda s: forge.deform(s, BOX, amplitude=np.nan), "amplitude"),
        (lambda s: forge.translation(s, BOX, distance=np.nan), "distance: expected a finite"),
        (
            lambda _: forge.translation([[9, 9, 9], [3, 1, 0]], BOX, distance=1e39),
            "takes row 1 beyond the finite floats",
        ),
        (
            lambda s: forge.additive(s, grid_plate(), offset=(1e39, 0, 0)),
            "offset: takes points beyond the finite floats",
        ),
        (lambda s: forge.rotation(s, BOX, angle=np.inf), "angle: expected a finite"),
        (lambda s: forge.rotation(s, BOX, sideways=np.nan), "sideways: expected a finite"),
        (lambda s: forge.insert_occluding(s, grid_plate(), position=(0, 0, 0)), "one side"),
        (
            lambda s: forge.insert_occluding(s, plate(), position=(4, 0, 0), range_noise=1e160),
            "beyond the finite floats",
        ),
        (
            lambda s: forge.insert_occluding(s, plate(), position=(4, 0, 0), range_noise=-1),
            "range_noise",
        ),
        *(
            (
                lambda s, step=step: forge.snap_to_lattice(
                    forge.subtract(s, rows=[0]), forge.Lattice([[0, 0]], step)
                ),
                "azimuth step of 0 or 1e-4 to 1 radian",
            )
            for step in (-0.1, 1e-5, 13.0, np.nan, np.inf)
        ),
        (lambda s: forge.segment(s, tolerance=0.0), "tolerance"),
        (lambda s: forge.nearest_object(s[:10]), "found none"),
        (lambda s: forge.translation(s, Box((0, 0, 0), (1, 1, 1))), "beside the scanner"),
    ],
)
def test_bad_arguments(call: Callable[[Points], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        call(room())


AWAY = Box((40.0, 0.0, 90.0), (1.0, 1.0, 1.0))


@pytest.mark.parametrize(
    ("attack", "message"),
    [
        (lambda s: forge.rotation(s, BOX, angle=0.0), r"angle: .* no point would"),
        (lambda s: forge.translation(s, BOX, distance=0.0), r"distance: .* no point would"),
        (lambda s: forge.deform(s, BOX, amplitude=0.0), r"amplitude: .* no point would"),
        (
            lambda s: forge.deform(s, BOX, amplitude=0.0, direction="normal"),
            r"amplitude: .* no point would",
        ),
        (lambda s: forge.deform(s, BOX, amplitude=1e-30, rng=1), r"amplitude: .* no point would"),
        (lambda s: forge.subtract(s, AWAY), "box: expected scene points in it, got none"),
        (lambda s: forge.subtract(s, rows=[]), "rows: expected rows to remove, got none"),
        (lambda s: forge.subtractive(s, AWAY), "box: expected scene points in it"),
        (
            lambda s: forge.additive_subtractive(s, s[:9], AWAY, allow_collision=True),
            "box: expected scene points in it",
        ),
        (
            lambda s: forge.replacement(s, s[:9], AWAY, allow_collision=True),
            "box: expected scene points in it",
        ),
        (lambda s: forge.translation(s, AWAY), "box: expected scene points in it"),
        (lambda s: forge.rotation(s, AWAY), "box: expected scene points in it"),
        (lambda s: forge.deform(s, AWAY, amplitude=0.1), "box: expected scene points in it"),
        (
            lambda s: forge.insert_occluding(s, grid_plate(), position=(400, 0, 0)),
            r"position: .* no point would change",
        ),
    ],
)
def test_an_attack_that_changes_no_point_is_refused(
    attack: Callable[[Points], forge.Forgery], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        attack(room())


def test_points_on_the_lattice_stay_in_the_truth_of_a_snapped_forgery() -> None:
    rings = forge.Lattice([[0.0, 0.0], [0.0, 1.0]])
    forged = forge.ctp(room(), [[5, 0, 0], [5, 1, 0.9], [5, 2, 0.9]], position=(5, 1, 0.6))
    snapped = forge.snap_to_lattice(forged, rings)
    assert len(snapped.added) == 3
    added = snapped.points[snapped.added].astype(float)
    np.testing.assert_allclose(np.ptp(added, axis=0), snapped.box.size)
    again = forge.snap_to_lattice(snapped, rings)
    assert again.box == snapped.box
    np.testing.assert_array_equal(again.points, snapped.points)


def test_written_back_as_it_was_read(tmp_path: object) -> None:
    frame = LidarFrame(room(), np.linspace(0, 1, 4000, dtype=np.float32))
    path = f"{tmp_path}/forged.bin"
    forge.subtract(frame, BOX).write(path)
    again = manip3d.io.read_scan(path)
    np.testing.assert_array_equal(again.points, forge.subtract(frame, BOX).points)
