"""The terrestrial scanner: its grid, its noise, its truth."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from manip3d import InputError
from manip3d.simulate import TerrestrialScan, scenes, terrestrial_scan
from manip3d.simulate.terrestrial import _Grid, _mixture

pytest.importorskip("open3d")

COARSE = 0.5
FIELDS = ("points", "intensity", "label", "object", "mixed", "row", "column")


@pytest.fixture(scope="module")
def street() -> scenes.Scene:
    return scenes.make("outdoor-00")


@pytest.fixture(scope="module")
def office() -> scenes.Scene:
    return scenes.make("indoor-00")


@pytest.fixture(scope="module")
def street_scan(street: scenes.Scene) -> TerrestrialScan:
    return terrestrial_scan(street, resolution_deg=COARSE)


def ranges(scan: TerrestrialScan) -> NDArray[np.float64]:
    return np.linalg.norm(scan.points.astype(float), axis=1)


def range_image(scan: TerrestrialScan) -> NDArray[np.float64]:
    image = np.full(scan.shape, np.nan)
    image[scan.row, scan.column] = ranges(scan)
    return image


def test_counts_of_scenes_are_the_published_ones() -> None:
    assert (len(scenes.INDOOR), len(scenes.OUTDOOR)) == (17, 27)
    assert not set(scenes.SCENES) & set(scenes.CALIBRATION)
    assert not {r for r in scenes.SCENES.values()} & {r for r in scenes.CALIBRATION.values()}


@pytest.mark.parametrize("step", [5, pytest.param(1, marks=pytest.mark.slow)])
def test_all_scenes_differ(step: int) -> None:
    every = [*scenes.SCENES, *scenes.CALIBRATION][::step]
    worlds = {scenes.make(name).world.vertices.tobytes() for name in every}
    assert len(worlds) == len(every)


@pytest.mark.parametrize("name", [*list(scenes.INDOOR)[:6], *list(scenes.OUTDOOR)[:6]])
def test_each_kind_of_scene_shows_many_things(name: str) -> None:
    scene = scenes.make(name)
    assert scene.indoor == ("indoor" in name)
    scan = terrestrial_scan(scene, resolution_deg=4.0)
    assert len(scan.points) > 0.35 * np.prod(scan.shape)
    assert len(np.unique(scan.label)) >= 3
    assert (scan.object >= 0).mean() > 0.02
    assert ranges(scan).min() > 0.49


def test_same_seed_same_scan_whatever_the_threads(street: scenes.Scene) -> None:
    first, again, other = (
        terrestrial_scan(street, resolution_deg=2.0, rng=seed, threads=threads)
        for seed, threads in ((3, 1), (3, 2), (4, 2))
    )
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(first, field), getattr(again, field))
    assert first.points.shape != other.points.shape or (first.points != other.points).any()


def test_points_lie_on_the_grid(street_scan: TerrestrialScan) -> None:
    x, y, z = street_scan.points.astype(float).T
    azimuth = street_scan.first_azimuth_deg + street_scan.column * COARSE
    elevation = street_scan.first_elevation_deg + street_scan.row * COARSE
    assert street_scan.shape == (200, 720)
    off = (np.degrees(np.arctan2(y, x)) - azimuth + 180.0) % 360.0 - 180.0
    level = np.degrees(np.arctan2(z, np.hypot(x, y))) - elevation
    assert np.std(off) == pytest.approx(0.0005, rel=0.05)
    assert np.std(level) == pytest.approx(0.0005, rel=0.05)


def test_the_frame_shares_the_arrays(street_scan: TerrestrialScan) -> None:
    frame = street_scan.frame
    assert np.shares_memory(frame.points, street_scan.points)
    assert frame.fields["label"] is street_scan.label
    assert frame.origin == (0.0, 0.0, 0.0)


def test_points_come_column_by_column(street_scan: TerrestrialScan) -> None:
    order = street_scan.column.astype(int) * street_scan.shape[0] + street_scan.row
    assert (np.diff(order) > 0).all()


def test_hits_are_the_nearest_of_all_triangles(office: scenes.Scene) -> None:
    scan = terrestrial_scan(office, resolution_deg=6.0, range_noise=0.0, beam_divergence=0.0)
    world, points = office.world, scan.points[::3].astype(float)
    distance = np.linalg.norm(points, axis=1)
    direction = points / distance[:, None]
    a, b, c = (world.vertices[world.faces[:, i]].astype(float) for i in range(3))
    # Moeller and Trumbore, all pairs.
    edge1, edge2, to_origin = b - a, c - a, np.asarray(office.scanner) - a
    p = np.cross(direction[:, None], edge2)
    determinant = (p * edge1).sum(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (p * to_origin).sum(axis=2) / determinant
        q = np.cross(to_origin, edge1)
        v = (direction @ q.T) / determinant
        t = (q * edge2).sum(axis=1) / determinant
        t[~((u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > 0))] = np.inf
    nearest = t.argmin(axis=1)
    np.testing.assert_allclose(t.min(axis=1), distance, atol=6e-4)  # ranges in whole mm
    assert (world.face_label[nearest] == scan.label[::3]).mean() > 0.999
    assert (world.face_object[nearest] == scan.object[::3]).mean() > 0.999


def test_points_of_an_object_lie_in_its_box(
    street: scenes.Scene, street_scan: TerrestrialScan
) -> None:
    boxes = {box.track: box for box in street.world.boxes}
    mine = (street_scan.object >= 0) & ~street_scan.mixed
    at = street_scan.points[mine].astype(float) + np.asarray(street.scanner)
    box = [boxes[number] for number in street_scan.object[mine].tolist()]
    off = at - [b.center for b in box]
    yaw = np.array([b.yaw for b in box])
    along = off[:, 0] * np.cos(yaw) + off[:, 1] * np.sin(yaw)
    aside = off[:, 1] * np.cos(yaw) - off[:, 0] * np.sin(yaw)
    size, slack = np.array([b.size for b in box]), 5 * 0.003 + 1e-3
    assert (abs(along) <= size[:, 0] / 2 + slack).all()
    assert (abs(aside) <= size[:, 1] / 2 + slack).all()
    assert (abs(off[:, 2]) <= size[:, 2] / 2 + slack).all()
    buildings = [b.label == "Building" for b in box]
    assert (street_scan.label[mine][buildings] == scenes.Label.BUILDING).all()


def test_range_noise_is_what_was_asked_for(office: scenes.Scene) -> None:
    clean, noisy = (
        terrestrial_scan(
            office,
            resolution_deg=COARSE,
            range_noise=noise,
            angle_noise_deg=0.0,
            beam_divergence=0.0,
        )
        for noise in (0.0, 0.004)
    )
    difference = ranges(noisy) - ranges(clean)
    assert abs(difference.mean()) < 5 * 0.004 / np.sqrt(len(difference))
    assert np.std(difference) == pytest.approx(np.hypot(0.004, 1e-3 / np.sqrt(12)), rel=0.01)
    rounded = ranges(clean) * 1000
    assert abs(rounded - np.round(rounded)).max() < 0.01


def test_mixed_ranges_lie_between_the_two_surfaces(street: scenes.Scene) -> None:
    options = {"resolution_deg": 0.2, "range_noise": 0.0, "field_of_view": ((0, 60), (-20, 30))}
    sharp = terrestrial_scan(street, beam_divergence=0.0, **options)
    blurred = terrestrial_scan(street, beam_divergence=2e-3, **options)
    assert not sharp.mixed.any()
    assert 0.002 < blurred.mixed.mean() <= 0.02
    image, mixed_image = range_image(sharp), range_image(blurred)
    changed = abs(mixed_image - image) > 0.05
    mixed = np.zeros(image.shape, np.bool_)
    mixed[blurred.row[blurred.mixed], blurred.column[blurred.mixed]] = True
    assert (mixed | ~changed).all()
    assert changed[mixed].mean() > 0.7


def test_glass_returns_little(office: scenes.Scene) -> None:
    scan = terrestrial_scan(office, resolution_deg=COARSE)
    assert 0.9 < len(scan.points) / np.prod(scan.shape) < 0.999


def test_progress_and_interruption(office: scenes.Scene) -> None:
    said: list[float] = []
    terrestrial_scan(
        office, resolution_deg=COARSE, progress=lambda fraction, _: said.append(fraction)
    )
    assert said == sorted(said)
    assert said[-1] == 1.0

    def stop(fraction: float, message: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        terrestrial_scan(office, resolution_deg=COARSE, progress=stop)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"resolution_deg": 0.0}, "resolution_deg: expected 1e-4 to 10 degrees, got 0.0"),
        ({"resolution_deg": float("nan")}, "resolution_deg"),
        ({"resolution_deg": 0.001}, "more than 65 535"),
        ({"field_of_view": ((0, 361), (-40, 60))}, "field_of_view"),
        ({"field_of_view": ((0, 10), (-91, 60))}, "field_of_view"),
        ({"range_noise": float("nan")}, "range_noise: expected a finite number >= 0, got nan"),
        ({"beam_divergence": -1.0}, "beam_divergence"),
        ({"max_range": 0.1}, "max_range: expected more than 0.5"),
    ],
)
def test_bad_options_are_refused(
    office: scenes.Scene, options: dict[str, object], text: str
) -> None:
    with pytest.raises(InputError, match=text):
        terrestrial_scan(office, **options)


def test_the_sky_returns_nothing_at_any_range(street: scenes.Scene) -> None:
    near = terrestrial_scan(street, resolution_deg=3.0, max_range=1e9)
    far = terrestrial_scan(street, resolution_deg=3.0, max_range=float("inf"))
    np.testing.assert_array_equal(far.points, near.points)


def test_unknown_scenes_are_refused() -> None:
    with pytest.raises(InputError, match="name: expected a scene"):
        scenes.make("indoor-99")
    with pytest.raises(InputError, match="kind: expected one of office"):
        scenes.indoor("street")


def test_no_mixed_point_lies_beyond_the_range(street: scenes.Scene) -> None:
    """A beam at an edge mixed its range with that of surfaces from which nothing returns."""
    scan = terrestrial_scan(
        street, resolution_deg=0.4, beam_divergence=3e-3, min_range=3.0, max_range=25.0,
        range_noise=0.0,
    )  # fmt: skip
    assert scan.mixed.sum() > 50
    assert 3.0 - 0.001 <= ranges(scan).min() <= ranges(scan).max() <= 25.0 + 0.001


@pytest.mark.parametrize(
    ("azimuths", "step", "columns", "is_full"),
    [
        ((-180.0, 180.0), 0.06, 6000, True),
        ((0.0, 359.6), 1.0, 359, False),  # the seam is 2 degrees wide
        ((0.0, 359.6), 0.6, 599, False),  # 0.6 degrees lack of a turn: the seam is 1.2
        ((0.0, 360.0), 0.7, 514, True),  # the seam is 0.9 degrees wide
        ((0.0, 90.0), 0.1, 900, False),
    ],
)
def test_the_seam_of_a_full_turn_is_hardly_wider_than_a_step(
    azimuths: tuple[float, float], step: float, columns: int, is_full: bool
) -> None:
    grid = _Grid(step, (azimuths, (-10.0, 10.0)))
    assert (grid.columns, grid.full_turn) == (columns, is_full)


def test_a_mixed_range_is_a_number_even_if_its_weight_is_drawn_as_0() -> None:
    ranges = np.array([[2.0, 4.0], [np.inf, 8.0]], np.float32)
    weight = np.array([[0.0, 0.25], [0.5, 0.75]], np.float32)
    assert _mixture(ranges, ranges < 100.0, weight).tolist() == [2.0, 7.0]
