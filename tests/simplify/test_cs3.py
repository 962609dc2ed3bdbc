"""CS3 on depth images and range scans chooses the points of an oracle, and keeps invariants."""

from __future__ import annotations

import math
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from manip3d import InputError, Intrinsics, Registration, metrics, simplify
from manip3d.experiments._published import value as published_value
from manip3d.io import read_range_grid
from manip3d.simplify import Cs3Result, Cs3Stream, Reached, Variant
from real_data import RealData

VARIANTS = get_args(Variant)
CAMERA = Intrinsics(64, 48, 60.0, 58.0, 30.5, 24.0)

Map = NDArray[np.float32]


def bumpy(height: int = 48, width: int = 64, seed: int = 0, holes: float = 0.1) -> Map:
    """Return a depth image of a wavy disk without background, with noise and holes."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[0:height, 0:width]
    depth = 1.0 + 0.1 * np.sin(u / 5) * np.cos(v / 7) + rng.normal(scale=0.002, size=u.shape)
    depth[np.hypot((u - width / 2) / width, (v - height / 2) / height) > 0.45] = 0
    depth[rng.random(depth.shape) < holes] = 0
    return depth.astype(np.float32)


# --- The oracle: every formula written down once more, with the float32 operations of the text ---


def lift(depth: Map, camera: Intrinsics) -> Map:
    height, width = depth.shape
    ray_u = ((np.arange(width) - camera.cx) / camera.fx).astype(np.float32)
    ray_v = ((np.arange(height) - camera.cy) / camera.fy).astype(np.float32)
    z = np.where(depth > 0, depth, np.float32(np.nan))
    return np.stack([ray_u[None] * z, ray_v[:, None] * z, z], axis=-1)


def shifted(values: Map, du: int, dv: int, fill: float) -> Map:
    """Return values(u + du, v + dv), with `fill` outside."""
    height, width, *channels = values.shape
    padded = np.full((height + 8, width + 8, *channels), fill, np.float32)
    padded[4:-4, 4:-4] = values
    return padded[4 + dv : 4 + dv + height, 4 + du : 4 + du + width]


def dot(a: Map, b: Map) -> Map:
    products = a * b
    return products[..., 0] + products[..., 1] + products[..., 2]


def area_map(points: Map, beside: str) -> Map:
    differences = []
    for du, dv in ((1, 0), (0, 1)):
        forward = shifted(points, du, dv, np.nan) - points
        backward = points - shifted(points, -du, -dv, np.nan)
        use = np.isnan(forward) if beside == "backward" else np.zeros_like(forward, bool)
        differences.append(np.where(use, backward, forward))
    a, b = differences
    ax, ay, az = np.moveaxis(a, -1, 0)
    bx, by, bz = np.moveaxis(b, -1, 0)
    normal = np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)
    with np.errstate(all="ignore"):
        area = np.sqrt(dot(normal, normal)) / (dot(a, a) * dot(b, b))
    return np.where(np.isfinite(area), area, np.float32(np.nan if beside == "unknown" else 0))


def hessian(area: Map, stencil: str, beside: str) -> tuple[Map, Map, Map]:
    fill = np.nan if beside == "unknown" else 0.0

    def a(du: int, dv: int) -> Map:
        return shifted(area, du, dv, fill)

    two, quarter = np.float32(2), np.float32(0.25)
    cross = a(1, 1) - a(-1, 1) - a(1, -1) + a(-1, -1)
    if stencil == "gradient_of_gradient":
        middle = two * a(0, 0)
        return a(2, 0) - middle + a(-2, 0), a(0, 2) - middle + a(0, -2), cross
    if stencil == "compact":
        middle = two * a(0, 0)
        return a(1, 0) - middle + a(-1, 0), a(0, 1) - middle + a(0, -1), quarter * cross
    if stencil == "forward":
        return (
            a(2, 0) - two * a(1, 0) + a(0, 0),
            a(0, 2) - two * a(0, 1) + a(0, 0),
            a(1, 1) - a(1, 0) - a(0, 1) + a(0, 0),
        )
    corners = a(1, 1) + a(-1, 1) + a(1, -1) + a(-1, -1)
    sides_u, sides_v = a(1, 0) + a(-1, 0), a(0, 1) + a(0, -1)
    middle = np.float32(4) * a(0, 0)
    return (
        corners + two * (sides_u - sides_v) - middle,
        corners + two * (sides_v - sides_u) - middle,
        cross,
    )


def rounded(omega: Map) -> Map:
    """Round to 14 significant bits, as the core does."""
    bits = omega.view(np.uint32)
    down = np.where(omega >= 0, bits | np.uint32(0x3FF), bits & np.uint32(0xFFFFFC00))
    return down.astype(np.uint32).view(np.float32)


def importance(points: Map, variant: str, stencil: str, beside: str) -> Map:
    uu, vv, uv = hessian(area_map(points, beside), stencil, beside)
    half = np.float32(0.5)
    if variant[0] == "l":
        omega = uu + vv
    else:
        mean, difference = half * (uu + vv), half * (uu - vv)
        omega = np.abs(mean - np.sqrt(difference * difference + uv * uv))
    return rounded(np.where(np.isfinite(omega), omega, np.float32(0)))


class Oracle:
    def __init__(
        self, points: Map, valid: NDArray[np.bool_], n: int, variant: str, **reading: str
    ) -> None:
        self.variant = variant
        self.rounding = reading.get("rounding", "down")
        stencil = reading.get("stencil", "gradient_of_gradient")
        beside = reading.get("beside_invalid", "backward")
        self.valid = valid
        self.omega = importance(points, variant, stencil, beside)
        self.hessian = hessian(area_map(points, beside), stencil, beside)
        v, u = np.nonzero(valid)
        w, h = np.ptp(u) + 1, np.ptp(v) + 1
        self.interval = math.sqrt(w * h / n)
        self.order = sorted(
            zip(v.tolist(), u.tolist(), strict=True), key=lambda p: (-self.omega[p], p)
        )
        self.depth_ratio = np.ones(valid.shape)

    def radius(self, p: tuple[int, int], factor: float) -> int:
        low, high = (float(self.omega[self.order[i]]) for i in (-1, 0))
        relative = 1.0 - (float(self.omega[p]) - low) / (high - low) if high > low else 1.0
        radius = factor * self.interval * (relative * self.depth_ratio[p])
        return {
            "down": math.floor(radius),
            "nearest": math.floor(radius + 0.5),
            "up": math.ceil(radius),
        }[self.rounding]

    def by_order(self, factor: float) -> set[tuple[int, int]]:
        blocked = np.zeros(self.valid.shape, bool)
        chosen = set()
        for v, u in self.order:
            if blocked[v, u]:
                continue
            chosen.add((v, u))
            r = self.radius((v, u), factor)
            blocked[max(0, v - r) : v + r + 1, max(0, u - r) : u + r + 1] = True
        return chosen

    def maxima(self, factor: float) -> set[tuple[int, int]]:
        rank = {p: i for i, p in enumerate(self.order)}
        window = factor * self.interval
        chosen = set()
        for p in self.order:
            uu, vv, uv = (float(part[p]) for part in self.hessian)
            values, vectors = np.linalg.eigh([[uu, uv], [uv, vv]])
            large, small = (1, 0) if abs(values[1]) >= abs(values[0]) else (0, 1)
            ratio = abs(values[large]) / max(abs(values[small]), 1e-300)
            lengths = {large: window, small: min(4.0, math.sqrt(ratio)) * window}
            neighbourhood = {
                (
                    math.floor(p[0] + k * vectors[1, i] + 0.5),
                    math.floor(p[1] + k * vectors[0, i] + 0.5),
                )
                for i, length in lengths.items()
                for k in range(-int(length), int(length) + 1)
            }
            if all(rank.get(q, math.inf) >= rank[p] for q in neighbourhood):
                chosen.add(p)
        return chosen


def pixels_of(result: Cs3Result) -> set[tuple[int, int]]:
    return {(v, u) for u, v in result.pixels.tolist()}


READINGS = [
    {},
    {"stencil": "compact"},
    {"stencil": "forward"},
    {"stencil": "sobel"},
    {"beside_invalid": "zero"},
    {"beside_invalid": "unknown"},
    {"rounding": "nearest"},
    {"rounding": "up"},
]


@pytest.mark.parametrize("variant", ["cios", "lios"])
@pytest.mark.parametrize("reading", READINGS, ids=lambda r: "-".join(r.values()) or "kept")
def test_importance_order_sampling_is_that_of_the_formulas(
    variant: Variant, reading: dict[str, str | float]
) -> None:
    for seed, n in ((0, 150), (1, 60), (2, 300)):
        depth = bumpy(seed=seed)
        result = simplify.cs3(depth, CAMERA, n, variant=variant, reading=reading)
        oracle = Oracle(lift(depth, CAMERA), depth > 0, n, variant, **reading)  # type: ignore[arg-type]
        assert result.literal_count == len(oracle.by_order(1.0))
        chosen = oracle.by_order(result.factor)
        if result.reached is Reached.FACTOR:
            assert pixels_of(result) == chosen
            assert n - n // 100 <= len(chosen) <= n
        else:
            assert result.reached is Reached.CONTINUED
            left = [p for p in oracle.order if p not in chosen]
            assert pixels_of(result) == chosen | set(left[: n - len(chosen)])


@pytest.mark.parametrize("variant", ["cnms", "lnms"])
def test_suppression_is_that_of_the_formulas(variant: Variant) -> None:
    depth = bumpy(seed=4)
    n = 120
    result = simplify.cs3(depth, CAMERA, n, variant=variant)
    oracle = Oracle(lift(depth, CAMERA), depth > 0, n, variant)
    expected = oracle.maxima(result.factor)
    # Directions that end half-way between two pixels may round either way.
    differ = expected ^ pixels_of(result)
    added = n - len(expected) if result.reached is Reached.CONTINUED else 0
    assert len(differ) <= added + 0.03 * n
    assert abs(result.literal_count - len(oracle.maxima(1.0))) <= 0.03 * n


def test_a_cone_keeps_its_tip() -> None:
    """The tip, at which alone the cone bends, has the greatest importance and is chosen first."""
    v, u = np.mgrid[0:49, 0:65]
    cone = (1.0 + 0.01 * np.hypot(u - 32, v - 24)).astype(np.float32)
    result = simplify.cs3(cone, Intrinsics(65, 49, 60.0, 60.0, 32.0, 24.0), 40)
    assert any(abs(u - 32) <= 1 and abs(v - 24) <= 1 for v, u in pixels_of(result))


def test_distance_dependent_radii() -> None:
    depth = bumpy(seed=7, holes=0.0)
    depth[:, 32:] *= 3
    n = 200
    result = simplify.cs3(depth, CAMERA, n, distance_dependent=True)
    oracle = Oracle(lift(depth, CAMERA), depth > 0, n, "cios")
    oracle.depth_ratio = depth.astype(float) / float(depth.max())
    assert result.literal_count is None
    assert result.reached is Reached.FACTOR
    assert pixels_of(result) == oracle.by_order(result.factor)
    plain = simplify.cs3(depth, CAMERA, n)
    assert (result.pixels[:, 0] < 32).sum() > 1.5 * (plain.pixels[:, 0] < 32).sum()
    with pytest.raises(InputError, match="distance_dependent: expected a depth image"):
        Cs3Stream(10, distance_dependent=True).simplify_grid(lift(depth, CAMERA))
    for variant in ("cnms", "lnms"):  # these have no radii, and the option would change nothing
        message = f"variant: expected the variant cios or lios, got {variant}"
        with pytest.raises(InputError, match=f"distance_dependent, {message}"):
            simplify.cs3(depth, CAMERA, n, variant=variant, distance_dependent=True)
        with pytest.raises(InputError, match=f"by_distance, {message}"):
            simplify.DepthOptions(n, method="cs3", variant=variant, by_distance=True)


# --- Invariants ----------------------------------------------------------------------------------


def signed_areas(result: Cs3Result) -> NDArray[np.int64]:
    a, b, c = (result.pixels[result.faces[:, i]].astype(np.int64) for i in range(3))
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]


def check(result: Cs3Result, points: Map, valid: NDArray[np.bool_], n: int) -> None:
    height, width = valid.shape
    u, v = result.pixels.T
    assert valid[v, u].all()
    assert len(set(zip(u.tolist(), v.tolist(), strict=True))) == result.num_vertices
    assert result.num_vertices <= n
    assert result.num_vertices >= min(n - n // 100, valid.sum())
    np.testing.assert_array_equal(result.vertices, points[v, u])  # points never move
    exact = np.column_stack([(u + 0.5) / width, 1 - (v + 0.5) / height])
    np.testing.assert_array_equal(result.texcoords, exact.astype(np.float32))
    centroids = (2 * result.pixels[result.faces].sum(axis=1) + 3) // 6
    assert valid[centroids[:, 1], centroids[:, 0]].all()
    # The result is the Delaunay triangulation without faces whose centroid is an invalid pixel.
    full = simplify.grid_delaunay(result.pixels)
    ends = (2 * result.pixels[full].sum(axis=1) + 3) // 6
    kept = full[valid[ends[:, 1], ends[:, 0]]]
    assert {tuple(sorted(t)) for t in kept.tolist()} == {
        tuple(sorted(t)) for t in result.faces.tolist()
    }


@pytest.mark.parametrize("variant", VARIANTS)
@given(
    width=st.integers(1, 20),
    height=st.integers(1, 20),
    n=st.integers(1, 120),
    seed=st.integers(0, 5),
    holes=st.sampled_from([0.0, 0.2, 0.7, 0.95]),
)
@settings(max_examples=60)
def test_invariants(
    variant: Variant, width: int, height: int, n: int, seed: int, holes: float
) -> None:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.5, 2.0, (height, width)).astype(np.float32)
    depth[rng.random(depth.shape) < holes] = 0
    camera = Intrinsics(width, height, 30.0, 30.0, width / 2, height / 2)
    result = simplify.cs3(depth, camera, n, variant=variant)
    check(result, lift(depth, camera), depth > 0, n)
    assert (signed_areas(result) < 0).all()  # faces the camera: rows go down
    assert result.literal_count <= (depth > 0).sum()


def test_grids_are_like_depth_images() -> None:
    depth = bumpy()
    points = lift(depth, CAMERA)
    plain = simplify.cs3(depth, CAMERA, 100)
    grid = simplify.cs3_grid(points, depth > 0, 100)
    np.testing.assert_array_equal(grid.pixels, plain.pixels)
    assert (signed_areas(grid) > 0).all()  # rows go up
    down = simplify.cs3_grid(points, None, 100, rows_up=False)
    np.testing.assert_array_equal(down.faces, plain.faces)


@pytest.mark.parametrize("power", [-100, -40, 40, 100])
def test_the_unit_does_not_matter(power: int) -> None:
    points = lift(bumpy(), CAMERA)
    one = simplify.cs3_grid(points, None, 100)
    other = simplify.cs3_grid(points * np.float32(2.0**power), None, 100)
    np.testing.assert_array_equal(one.pixels, other.pixels)
    np.testing.assert_array_equal(one.faces, other.faces)


@pytest.mark.parametrize("variant", VARIANTS)
def test_same_bytes_for_any_number_of_threads(variant: Variant) -> None:
    depth = bumpy(240, 320, holes=0.05)
    camera = Intrinsics(320, 240, 300.0, 300.0, 160.0, 120.0)
    has_radii = variant in ("cios", "lios")
    results = [
        simplify.cs3(depth, camera, 800, variant=variant, threads=t, distance_dependent=has_radii)
        for t in (1, 2, 4, 0)
    ]
    for other in results[1:]:
        for name in ("vertices", "faces", "pixels", "texcoords"):
            assert getattr(results[0], name).tobytes() == getattr(other, name).tobytes()


def test_long_edges_are_dropped() -> None:
    depth = bumpy(holes=0.0)
    depth[:, 32:] *= 2
    plain = simplify.cs3(depth, CAMERA, 200)
    scene = simplify.cs3(depth, CAMERA, 200, max_edge=0.5)
    assert 0 < scene.num_faces < plain.num_faces
    corners = scene.vertices[scene.faces].astype(float)
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= 0.5
    assert {tuple(t) for t in scene.faces.tolist()} < {tuple(t) for t in plain.faces.tolist()}


def test_registered_color() -> None:
    depth = bumpy()
    registration = Registration(Intrinsics(32, 24, 30.0, 29.0, 15.0, 12.0))
    color = np.full((24, 32, 3), 128, np.uint8)
    result = simplify.cs3(depth, CAMERA, 100, color=color, registration=registration)
    dense = simplify.dense_mesh(depth, CAMERA, registration=registration)
    uv_of = dict(zip(map(tuple, dense.pixels.tolist()), dense.texcoords.tolist(), strict=True))
    assert [uv_of[tuple(p)] for p in result.pixels.tolist()] == result.texcoords.tolist()
    assert result.mesh.materials[0].textures["base_color"].data is not None


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(
    ("depth", "n"),
    [
        (np.zeros((0, 0), np.uint16), 10),
        (np.zeros((5, 7), np.uint16), 10),
        (np.full((5, 7), np.nan, np.float32), 10),
        (np.ones((5, 7), np.float32), 1),
        (np.ones((5, 7), np.float32), 2),
        (np.ones((5, 7), np.float32), 3),
        (np.ones((5, 7), np.float32), 35),
        (np.ones((5, 7), np.float32), 1000),
        (np.diag([0, 0, 1, 0, 0]).astype(np.float32), 4),
        (np.ones((1, 9), np.float32), 4),
        (np.ones((9, 1), np.float32), 4),
        (np.full((6, 6), 65535, np.uint16), 9),
    ],
)
def test_border_cases(depth: NDArray[np.float32], n: int, variant: Variant) -> None:
    height, width = depth.shape
    metres = (depth / np.float32(1000)).astype(np.float32) if depth.dtype == np.uint16 else depth
    if width == 0:
        result = simplify.cs3_grid(np.zeros((0, 0, 3)), None, n, variant=variant)
        assert result.num_vertices == result.num_faces == result.mesh.num_faces == 0
        return
    camera = Intrinsics(width, height, 30.0, 30.0, width / 2, height / 2)
    result = simplify.cs3(depth, camera, n, variant=variant)
    check(result, lift(metres, camera), metres > 0, n)
    if n >= (metres > 0).sum():
        assert result.reached is Reached.ALL_PIXELS
    assert result.mesh.num_vertices == result.num_vertices


def test_more_points_than_any_factor_gives() -> None:
    """With constant importance, counts jump with the rounded radius; the rest is added."""
    flat = np.ones((30, 40), np.float32)
    result = simplify.cs3_grid(np.stack([*np.mgrid[0:30, 0:40][::-1], flat], axis=-1), None, 1000)
    assert result.num_vertices == 1000
    assert result.reached is Reached.CONTINUED


def test_a_stream_gives_what_single_calls_give() -> None:
    stream, pooled = Cs3Stream(150), Cs3Stream(150, frames=2)
    results = []
    for seed in range(4):
        depth = bumpy(seed=seed, holes=0.1 * seed)
        single = simplify.cs3(depth, CAMERA, 150)
        results.append(stream.simplify(depth, CAMERA))
        for other in (results[-1], pooled.simplify(depth, CAMERA)):
            for name in ("vertices", "faces", "pixels", "texcoords"):
                assert getattr(single, name).tobytes() == getattr(other, name).tobytes()
    for seed, result in enumerate(results):  # fresh arrays by default
        expected = simplify.cs3(bumpy(seed=seed, holes=0.1 * seed), CAMERA, 150)
        assert result.vertices.tobytes() == expected.vertices.tobytes()
    kept = [pooled.simplify(bumpy(seed=s), CAMERA) for s in range(3)]
    assert np.shares_memory(kept[0].vertices, kept[2].vertices)
    assert not np.shares_memory(kept[0].vertices, kept[1].vertices)
    smaller = Intrinsics(32, 24, 30.0, 29.0, 15.0, 12.0)  # another camera in the same stream
    depth = bumpy(24, 32)
    other = pooled.simplify(depth, smaller)
    assert other.vertices.tobytes() == simplify.cs3(depth, smaller, 150).vertices.tobytes()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target_points": 0}, "target_points: expected >= 1, got 0"),
        ({"target_points": -1}, "target_points: expected a whole number >= 0"),
        ({"target_points": 2.5}, "target_points: expected a whole number of 64 bits, got 2.5"),
        ({"variant": "best"}, "variant: expected 'lnms', 'lios', 'cnms' or 'cios', got 'best'"),
        ({"max_edge": 0.0}, "max_edge: expected > 0"),
        ({"max_edge": math.nan}, "max_edge: expected > 0"),
        (
            {"reading": {"stencil": "wide"}},
            "expected one of gradient_of_gradient, compact, ",
        ),
        ({"reading": {"kernel": "wide"}}, "reading: expected stencil, beside_invalid, rounding"),
        ({"reading": {"outliers": 1.0}}, "outliers: expected a share"),
        ({"threads": -1}, "threads: expected 0 to 2147483647, got -1"),
    ],
)
def test_refused(options: dict[str, object], message: str) -> None:
    arguments = {"target_points": 10, **options}
    with pytest.raises(InputError, match=message):
        simplify.cs3(bumpy(), CAMERA, **arguments)  # type: ignore[arg-type]


def test_a_point_that_is_not_finite() -> None:
    points = lift(bumpy(), CAMERA)
    points[20, 30] = np.inf
    valid = ~np.isnan(points[..., 2])
    with pytest.raises(InputError, match=r"points: .* at row 20, column 30"):
        simplify.cs3_grid(points, valid, 10)
    points[20, 30] = np.nan
    with pytest.raises(InputError, match=r"points: .* at row 20, column 30"):
        simplify.cs3_grid(points, valid, 10)


# --- Real scans ----------------------------------------------------------------------------------


def scan(path: Path) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    grid = read_range_grid(path)
    return grid.points, grid.valid


@pytest.mark.published("table 3.4")
@pytest.mark.parametrize(
    ("name", "model", "n", "tolerance"),
    [("bunny/bun000", "Bunny", 2012, 0.15), ("happy_stand/happyStandRight_0", "Buddha", 3902, 0.0)],
)
def test_published_errors(
    realdata: RealData, name: str, model: str, n: int, tolerance: float
) -> None:
    """CS3's distance is between half of the printed one and the printed one plus tolerance."""
    points, valid = scan(realdata(f"range_scans/{name}.ply.xz"))
    dense = simplify.dense_mesh_grid(points, valid).mesh
    errors = {}
    for variant in ("cios", "lios"):
        result = simplify.cs3_grid(points, valid, n, variant=variant)  # type: ignore[arg-type]
        check(result, points.astype(np.float32), valid, n)
        errors[variant] = metrics.metro(dense, result.mesh, sampling="area").mean
    printed = published_value("table_3_4_quality_at_5_percent", model, "CS3", "metro_1e-3")
    assert isinstance(printed, float)
    assert 0.5 <= errors["cios"] / (printed * 1e-3) <= 1.0 + tolerance
    assert errors["cios"] < errors["lios"]  # figure 3.7
