"""Points keep their places and colours on the way into pages and pictures."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from page_content import content, reddish, screenshot

from manip3d import (
    Box,
    InputError,
    Intrinsics,
    LidarFrame,
    Mesh,
    RenderError,
    RgbdCalibration,
    RgbdFrame,
    Skeleton,
    simplify,
)
from manip3d.viewer import (
    Classes,
    DepthImage,
    DrawnPoints,
    Scale,
    _chromium,
    box_lines,
    depth_points,
    drawn_points,
    html,
    picture,
    points_picture,
    rgbd_points,
    scan_points,
    skeleton_lines,
    view,
)
from manip3d.viewer.page import document, round_length
from manip3d.viewer.points import EMPHASIS, PALETTE, QUIET, RAMP
from manip3d.viewer.scene import camera_place, first_view

WHITE = (255, 255, 255)
CAMERA = Intrinsics(8, 6, 10.0, 10.0, 3.5, 2.5)


def scan(**changes: object) -> LidarFrame:
    """Nine points on a ramp, and one that did not come back."""
    x = np.arange(10.0)
    points = np.column_stack([x, np.zeros(10), 0.5 * x]).astype(np.float32)
    frame = LidarFrame(
        points,
        np.linspace(0, 1, 10).astype(np.float32),
        ring=np.arange(10) % 3,
        origin=(0.0, 0.0, 0.0),
    )
    return frame.replace(**changes)


def names(cloud: DrawnPoints) -> list[str]:
    return [column.name for column in cloud.columns]


# ------------------------------------------------------------------------------- columns


def test_a_scan_has_a_column_for_all_that_it_tells() -> None:
    cloud = scan_points(scan())
    assert names(cloud) == ["height", "intensity", "ring"]
    assert cloud.num_points == 9  # the one at (0, 0, 0) did not come back
    assert cloud.detail == "9 points, 1 without return"
    assert names(scan_points(scan(intensity=None, ring=None))) == ["height"]


def test_a_column_that_is_the_same_everywhere_is_left_out() -> None:
    assert names(scan_points(scan(intensity=np.ones(10, np.float32)))) == ["height", "ring"]


@pytest.mark.parametrize(("full", "dtype"), [(255, np.uint8), (65535, np.uint16)])
def test_stored_colors_are_brought_to_eight_bits(full: int, dtype: type) -> None:
    red = np.linspace(0, full, 10).astype(dtype)
    none = np.zeros(10, dtype)
    cloud = scan_points(scan(fields={"red": red, "green": none, "blue": none}))
    assert names(cloud)[0] == "colour"
    np.testing.assert_allclose(cloud.colors()[:, 0], np.linspace(0, 255, 10)[1:], atol=1)
    assert not cloud.colors()[:, 1:].any()


def test_fractions_are_colors_too() -> None:
    """Other programs write colours of 0 to 1 into PLY files, which would all be black of 255."""
    red = np.linspace(0, 1, 10)
    cloud = scan_points(scan(fields={"red": red, "green": red[::-1], "blue": np.zeros(10)}))
    np.testing.assert_allclose(cloud.colors()[:, 0], 255 * red[1:], atol=0.5)


def test_numbers_become_colors_between_their_ends() -> None:
    column = Scale("x", np.array([0.0, 5.0, 10.0, 99.0]), limits=(0.0, 10.0))
    assert column.levels().tolist() == [0, 128, 255, 255]
    assert column.colors()[0].tolist() == list(RAMP[0])
    assert column.colors()[2].tolist() == list(RAMP[-1])
    assert column.select(np.array([1])).levels().tolist() == [128]  # the ends stay


def test_a_single_stray_point_does_not_take_the_colors() -> None:
    values = np.append(np.linspace(0, 1, 1000), 1e6)
    assert Scale("x", values).ends[1] < 1.1


def test_one_value_everywhere_is_the_first_color() -> None:
    assert Scale("x", np.full(4, 7.0)).levels().tolist() == [0, 0, 0, 0]


def test_emphasised_points_are_wider_and_survive_thinning() -> None:
    values = np.zeros(1000, np.uint8)
    values[[3, 500, 999]] = 1
    classes = Classes("verdict", values, ("no", "yes"), (QUIET, WHITE), (1,))
    points = np.random.default_rng(1).random((1000, 3))
    cloud = DrawnPoints(points, (classes,), least=0.1)
    assert cloud.widths().tolist() == [0.1] * 1000
    np.testing.assert_array_equal(cloud.emphasis()[[2, 3]], [1.0, EMPHASIS])
    few = cloud.thinned(10)
    assert few.num_points == 10
    assert isinstance(few.columns[0], Classes)
    assert few.columns[0].counts() == [7, 3]
    assert few.detail == "1,000 points, 10 shown"
    assert set(map(tuple, few.points)) <= set(map(tuple, points))
    assert np.array_equal(few.points, cloud.thinned(10).points)  # the same every time
    assert cloud.thinned(1000) is cloud
    most = replace(classes, values=np.uint8(np.arange(1000) < 900))  # an object of most points
    assert DrawnPoints(points, (most,)).thinned(100).columns[0].counts() == [50, 50]
    assert DrawnPoints(points, (most,)).thinned(950).columns[0].counts() == [100, 850]
    with pytest.raises(InputError, match="max_points: expected > 0"):
        cloud.thinned(0)


def test_points_of_a_dense_scan_do_not_hide_each_other_when_thinned() -> None:
    """Six million points of a terrestrial scan were drawn as balls that covered everything."""
    points = np.random.default_rng(2).normal(size=(100_000, 3))
    dense = DrawnPoints(points, origin=(0.0, 0.0, 0.0), spread=0.02)
    assert dense.thinned(1000).spread == pytest.approx((4 * np.pi / 1000) ** 0.5)
    sparse = replace(dense, spread=0.002)
    assert sparse.thinned(1000).spread == pytest.approx(0.02)


@pytest.mark.parametrize("count", [1, 2, 3, 8, 50, 199])
def test_all_of_few_points_fill_the_picture(count: int) -> None:
    """Each of few points may be the outermost one along some axis; two always are."""
    points = np.random.default_rng(0).uniform(5, 6, (count, 3))
    np.testing.assert_array_equal(drawn_points(points).bulk(), points)


def test_the_outermost_of_many_points_do_not_shrink_the_picture() -> None:
    points = np.random.default_rng(0).uniform(5, 6, (200, 3))
    points[0] = 1e6
    bulk = drawn_points(points).bulk()
    assert 194 <= len(bulk) < 200
    assert bulk.max() < 6


def test_points_far_from_the_sensor_are_wider() -> None:
    cloud = scan_points(scan())
    width = cloud.widths()
    assert width[-1] == pytest.approx(cloud.spread * np.linalg.norm([9, 4.5]), rel=1e-6)
    assert (np.diff(width) >= 0).all()
    assert width[-1] > 5 * width[0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"colors": np.zeros((2, 3), np.uint8)}, r"colors: expected uint8 of shape \(3, 3\)"),
        ({"colors": np.zeros((3, 3))}, "got float64"),
        ({"values": {"heat": [1, 2]}}, "heat: expected 3 values"),
        ({"values": {"heat": [1, 2, np.nan]}}, "heat: expected finite numbers"),
    ],
)
def test_columns_that_do_not_fit_are_named(options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        drawn_points(np.eye(3), **options)


def test_points_that_are_none_are_refused() -> None:
    with pytest.raises(InputError, match="points: expected finite coordinates"):
        drawn_points([[0, 0, np.inf]])
    with pytest.raises(InputError, match="expected values below 1, got 2"):
        DrawnPoints(np.eye(3), (Classes("x", np.array([0, 0, 2], np.uint8), ("a",), (QUIET,)),))


def test_an_unknown_column_or_place_is_answered_with_the_known_ones() -> None:
    with pytest.raises(InputError, match="color_by: expected height, intensity, ring, got 'rng'"):
        scan_points(scan()).colored_by("rng")
    with pytest.raises(InputError, match="place: expected Behind, Above, Sensor, got 'Moon'"):
        scan_points(scan()).pose("Moon")
    assert names(scan_points(scan()).colored_by("ring")) == ["ring", "height", "intensity"]


# ------------------------------------------------------------------------------- lines


def test_the_edges_of_a_box_are_its_own() -> None:
    turned = Box((1.0, 2.0, 3.0), (4.0, 2.0, 1.0), yaw=np.pi / 2, label="Car")
    (lines,) = box_lines([turned])
    assert lines.name == "Car"
    lengths = np.linalg.norm(lines.ends[:, 1] - lines.ends[:, 0], axis=1)
    assert sorted(lengths.round(9)) == [1.0] * 4 + [2.0] * 4 + [4.0] * 4
    np.testing.assert_allclose(lines.ends.reshape(-1, 3).min(axis=0), [0, 0, 2.5], atol=1e-12)
    np.testing.assert_allclose(lines.ends.reshape(-1, 3).max(axis=0), [2, 4, 3.5], atol=1e-12)


def test_boxes_of_one_name_share_a_color() -> None:
    car, bike = Box((0, 0, 0), (1, 1, 1), label="Car"), Box((9, 0, 0), (1, 1, 1), label="Cyclist")
    lines = box_lines([car, bike, car])
    assert [(one.name, len(one.ends)) for one in lines] == [("Car", 24), ("Cyclist", 12)]
    assert lines[0].color != lines[1].color
    (named,) = box_lines({"detector": [car], "none": []}, {"detector": (1, 2, 3)})
    assert (named.name, named.color) == ("detector", (1, 2, 3))


def test_bones_join_tracked_joints_only() -> None:
    positions = np.arange(75, dtype=np.float32).reshape(25, 3)
    states = np.full(25, 2, np.uint8)
    assert [len(one.ends) for one in skeleton_lines([Skeleton(positions, states=states)])] == [24]
    states[3] = 1  # the head, which hangs from the neck, is inferred
    states[15] = 0  # the left foot is not tracked
    positions[15] = np.nan
    sure, guessed = skeleton_lines([Skeleton(positions, states=states)])
    assert (len(sure.ends), len(guessed.ends)) == (22, 1)
    np.testing.assert_array_equal(guessed.ends[0], positions[[2, 3]])
    assert np.isfinite(sure.ends).all()
    assert sure.in_front


# ------------------------------------------------------------------------------- cameras


def depth_image() -> np.ndarray:
    depth = np.full((6, 8), 2000, np.uint16)
    depth[0, 0] = 0
    return depth


def test_a_depth_image_becomes_points_before_its_camera() -> None:
    color = np.zeros((6, 8, 3), np.uint8)
    color[5, 7] = (255, 0, 0)
    cloud = depth_points(depth_image(), CAMERA, color=color)
    assert names(cloud) == ["colour", "depth"]
    assert cloud.num_points == 47
    np.testing.assert_allclose(cloud.points[-1], [0.7, 0.5, 2.0], atol=1e-6)  # right, down
    assert cloud.colors()[-1].tolist() == [255, 0, 0]
    pose = cloud.pose(None)
    assert pose is not None
    assert pose.up == "-y"
    np.testing.assert_array_equal(pose.position, 0.0)
    assert pose.aspect == pytest.approx(8 / 6)
    assert np.tan(np.radians(pose.view_angle / 2)) == pytest.approx(0.3)
    with pytest.raises(InputError, match=r"depth: expected shape \(6, 8\)"):
        depth_points(depth_image()[1:], CAMERA)


def test_a_depth_image_without_a_camera_says_what_is_assumed() -> None:
    image = DepthImage(depth_image())
    assert image.camera.fx == pytest.approx(8 * 525 / 640)
    assert image.drawn().detail == "47 points, camera assumed: focal length 7 pixels"
    assert DepthImage(depth_image(), CAMERA).drawn().detail == "47 points"


def test_a_frame_shows_its_people() -> None:
    people = np.full((6, 8), 255, np.uint8)
    people[3:, 2:4] = 4
    body = Skeleton(np.ones((25, 3), np.float32))
    frame = RgbdFrame(depth_image(), RgbdCalibration(CAMERA), body_index=people, skeletons=(body,))
    cloud = rgbd_points(frame)
    assert names(cloud) == ["depth", "person"]
    person = cloud.columns[1]
    assert isinstance(person, Classes)
    assert dict(zip(person.labels, person.counts(), strict=True)) == {"person 4": 6, "nobody": 41}
    assert [line.name for line in cloud.lines] == ["bones"]
    assert cloud.detail == "47 points, 1 skeleton"


def test_people_are_those_of_pixels_that_have_a_ray() -> None:
    """A table of rays has none in the corners of a wide image, where a depth may be stored."""
    column, row = np.meshgrid(np.arange(8), np.arange(6))
    rays = np.stack([(column - 3.5) / 10, (row - 2.5) / 10], axis=-1).astype(np.float32)
    rays[0, :2] = np.nan
    camera = Intrinsics(8, 6, 10.0, 10.0, 3.5, 2.5, rays=rays)
    people = np.full((6, 8), 255, np.uint8)
    people[0] = 4
    depth = np.full((6, 8), 2000, np.uint16)
    person = rgbd_points(RgbdFrame(depth, RgbdCalibration(camera), body_index=people)).columns[1]
    assert isinstance(person, Classes)
    assert dict(zip(person.labels, person.counts(), strict=True)) == {"person 4": 6, "nobody": 40}


def test_a_frame_of_bones_alone_is_seen_from_where_they_fit() -> None:
    nothing = np.zeros((6, 8), np.uint16)
    body = Skeleton(np.full((25, 3), 3.0, np.float32))
    cloud = rgbd_points(RgbdFrame(nothing, RgbdCalibration(CAMERA), skeletons=(body,)))
    assert cloud.columns == ()
    assert cloud.detail == "1 skeleton"
    assert cloud.poses[0].target[2] == 3.0


def depth_mesh(turn: object = (1, 1, 1)) -> Mesh:
    """The mesh of a depth image (x right, y down, z ahead), its coordinates times ``turn``."""
    mesh = simplify.dense_mesh(depth_image(), CAMERA).mesh
    return mesh.replace(vertices=mesh.vertices * turn)


def test_the_mesh_of_a_depth_image_is_first_seen_as_its_camera_saw_it() -> None:
    assert first_view(depth_mesh()) == (0.0, 0.0, "-y")
    assert first_view(depth_mesh((1, -1, -1))) == (0.0, 0.0, "y")  # as glTF has it
    place = camera_place(depth_mesh())
    assert place is not None
    assert place.position.tolist() == [0, 0, 0]
    assert place.target == pytest.approx([0, 0, 2], abs=1e-6)
    assert np.tan(np.radians(place.view_angle / 2)) == pytest.approx(1.06 * 0.25)
    away = Mesh(depth_mesh().vertices, depth_mesh().faces[:, ::-1])
    assert first_view(away) == (30.0, 20.0, "y")
    around = depth_mesh().replace(vertices=depth_mesh().vertices - [0, 0, 2])
    assert first_view(around) == (30.0, 20.0, "y")
    wide = depth_mesh((99, 99, 1))
    assert first_view(wide) == (30.0, 20.0, "y")
    assert camera_place(wide) is None


@pytest.mark.parametrize("ahead", [0.0, -0.1, 1e-9])
def test_no_camera_sees_what_is_beside_or_behind_it(bundle: None, ahead: float) -> None:
    """Faces that face the origin, one of which has a corner beside it, or behind it."""
    corners = [[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1], [0, 0.3, ahead], [0.1, 0.3, 1]]
    mesh = Mesh([*corners, [0, 0.4, 1]], [[0, 2, 1], [0, 3, 2], [4, 5, 6]])
    assert camera_place(mesh) is None
    assert content(html(mesh))["places"] == []


def test_numbers_that_json_does_not_have_get_into_no_page(bundle: None) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        document("", {"view": float("nan")})


@pytest.mark.parametrize(("length", "rounded"), [(1.0, 1.0), (4.9, 2.0), (0.07, 0.05), (950, 500)])
def test_axes_have_round_lengths(length: float, rounded: float) -> None:
    assert round_length(length) == pytest.approx(rounded)


# ------------------------------------------------------------------------------- the page


def placed(model: dict) -> np.ndarray:
    """The positions of a page's points, in the page's units."""
    entry = model["points"]
    data = base64.b64decode(entry["positions"])
    if entry["exact"]:
        return np.frombuffer(data, "<f4").reshape(-1, 3).astype(float)
    steps = np.frombuffer(data, "<u2").reshape(-1, 3)
    return np.array(entry["low"]) + steps / 65535 * np.array(entry["extent"])


def values(model: dict, name: str) -> np.ndarray:
    (column,) = (c for c in model["points"]["columns"] if c["name"] == name)
    return np.frombuffer(base64.b64decode(column["values"]), np.uint8)


def test_points_travel_with_their_columns(bundle: None) -> None:
    points = np.random.default_rng(0).normal(size=(500, 3)) * [40, 40, 2] + 1e5
    page = content(html(drawn_points(points, values={"heat": points[:, 0]})))
    (model,) = page["models"]
    low, high = points.min(axis=0), points.max(axis=0)
    found = placed(model) * np.linalg.norm(high - low) + 0.5 * (low + high)
    away = np.linalg.norm(found[:, None] - points[None], axis=2)
    assert sorted(away.argmin(axis=1)) == list(range(500))
    assert away.min(axis=1).max() < np.ptp(points, axis=0).max() / 65535
    heat = values(model, "heat")[np.argsort(points[away.argmin(axis=1), 0])].astype(int)
    assert (np.diff(heat) >= 0).all()
    assert (heat[0], heat[-1]) == (0, 255)
    assert model["detail"] == "500 points"


def test_far_points_do_not_blur_the_others(bundle: None) -> None:
    points = np.vstack([np.random.default_rng(0).random((1000, 3)), [[1e5, 0, 0]]])
    (model,) = content(html(drawn_points(points)))["models"]
    assert model["points"]["exact"]
    (usual,) = content(html(drawn_points(points[:-1])))["models"]
    assert not usual["points"]["exact"]


def test_a_scan_is_seen_from_behind_and_above_its_scanner(bundle: None) -> None:
    page = content(html(scan(origin=(1.0, 0.0, 0.0))))
    behind = page["places"][0]
    origin = page["models"][0]["points"]["origin"]
    assert [place["name"] for place in page["places"]] == ["Behind", "Above", "Sensor"]
    assert behind["position"][0] < origin[0] < behind["target"][0]
    assert behind["position"][2] > origin[2]
    np.testing.assert_allclose(page["places"][2]["position"], origin)
    assert content(html(scan(origin=None)))["places"] == []
    assert content(html(scan(), azimuth=10))["places"] == []


def test_few_of_many_points_are_shown_and_counted(bundle: None) -> None:
    (model,) = content(html(scan(), max_points=4))["models"]
    assert len(placed(model)) == 4
    assert model["detail"] == "9 points, 1 without return, 4 shown"


def test_two_million_points_fit_into_thirty_megabytes(bundle: None) -> None:
    points = np.random.default_rng(0).random((2_000_000, 3), np.float32)
    frame = LidarFrame(points, points[:, 0], ring=np.arange(2_000_000) % 64)
    assert len(html(frame)) < 30e6


def test_points_and_meshes_stand_side_by_side(bundle: None, quad: Mesh) -> None:
    models = content(html([quad, scan()]))["models"]
    assert [sorted(m) for m in models] == [
        ["boundary", "detail", "glb", "label"],
        ["detail", "label", "points"],
    ]


def luminance(color: str) -> float:
    """Return the relative luminance of a CSS color by WCAG 2.2."""
    parts = np.array([float(part) for part in re.findall(r"[\d.]+", color)[:3]]) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear.dot([0.2126, 0.7152, 0.0722]))


def test_letters_of_the_axes_can_be_read_in_light_and_dark(chromium: None) -> None:
    """WCAG 2.2 asks for a contrast of 4.5; the legend's background is the page's."""
    colors = "[document.body, ...document.querySelectorAll('.legend b')].map((node, i) => "
    colors += "getComputedStyle(node)[i ? 'color' : 'backgroundColor']).join(';')"
    with _chromium.open_page(html(scan()), (500, 400)) as tab:
        tab.evaluate("manip3d")
        light = tab.evaluate(colors)
        tab.evaluate("document.dispatchEvent(new KeyboardEvent('keydown', {key: 'd'}))")
        dark = tab.evaluate(colors)
    assert light != dark
    for told in (light, dark):
        paper, *letters = (luminance(color) for color in told.split(";"))
        assert len(letters) == 3
        for letter in letters:
            assert (max(paper, letter) + 0.05) / (min(paper, letter) + 0.05) >= 4.5, told


def test_the_browser_colors_points_as_chosen(chromium: None) -> None:
    grid = np.stack(np.meshgrid(np.arange(40.0), np.arange(40.0), [0.0]), -1).reshape(-1, 3)
    red = np.tile(np.array([230, 20, 20], np.uint8), (len(grid), 1))
    box = Box((20, 20, 0), (44, 44, 2))
    cloud = drawn_points(grid, colors=red, values={"x": grid[:, 0]}, boxes=[box])
    with _chromium.open_page(html(cloud, elevation=90, azimuth=0), (700, 500)) as tab:
        tab.evaluate("manip3d")
        first = screenshot(tab)
        choose = "const s = document.querySelector('select'); s.value = 'x';"
        tab.evaluate(choose + "s.dispatchEvent(new Event('change'))")
        by_x = screenshot(tab)
        legend = tab.evaluate("document.querySelector('.legend').textContent")
        for key in "ll":
            tab.evaluate(f"document.dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}'}}))")
        for key in "]]]]":
            tab.evaluate(f"document.dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}'}}))")
        larger = screenshot(tab)
    assert reddish(first).sum() > 1500
    before, bluish = ((image[..., 2] > image[..., 0] + 60).sum(axis=0) for image in (first, by_x))
    assert bluish[:350].sum() > 3 * bluish[350:].sum()  # low x is left, and blue
    assert bluish[:350].sum() > 5 * before[:350].sum()
    assert legend.startswith("x")
    assert "box" in legend
    drawn = [(np.abs(image - [245, 246, 248]).max(axis=2) > 30).sum() for image in (by_x, larger)]
    assert drawn[1] > 1.5 * drawn[0]


# ------------------------------------------------------------------------------- pictures


def test_both_renderers_draw_the_same_points(
    chromium: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pyvista")
    grid = np.stack(np.meshgrid(np.arange(12.0), np.arange(9.0), [0.0]), -1).reshape(-1, 3)
    covered = {}
    for name in ("pyvista", "chromium"):
        monkeypatch.setenv("MANIP3D_RENDERER", name)
        cloud = drawn_points(grid, boxes=[Box((6, 4, 0), (14, 11, 2))])
        try:
            image = picture(cloud, size=(160, 120), background=WHITE, legend=False)
        except RenderError as error:
            pytest.skip(str(error))
        covered[name] = (image < 235).any(axis=2)
    both = (covered["pyvista"] & covered["chromium"]).sum()
    either = (covered["pyvista"] | covered["chromium"]).sum()
    assert either > 300
    assert both > 0.75 * either


@pytest.mark.usefixtures("needs_renderer")
def test_a_picture_of_points_shows_their_colors_and_boxes(tmp_path: Path) -> None:
    grid = np.stack(np.meshgrid(np.arange(60.0), np.arange(40.0), [0.0]), -1).reshape(-1, 3)
    colors = np.zeros((len(grid), 3), np.uint8)
    colors[:, 0] = 255
    options = {"size": (300, 200), "azimuth": 0, "elevation": 90, "background": WHITE}
    image = points_picture(grid, colors=colors, **options)
    rows, columns = np.nonzero(reddish(image.astype(int)))
    assert len(rows) > 0.05 * image[..., 0].size
    assert np.ptp(rows) > 150
    assert np.ptp(columns) > 220
    boxed = points_picture(grid, colors=colors, boxes=[Box((30, 20, 0), (80, 50, 1))], **options)
    orange = np.abs(boxed.astype(int) - PALETTE[1]).max(axis=2) < 40
    assert orange.sum() > 200  # the edges of a box without a label
    assert not (np.abs(image.astype(int) - PALETTE[1]).max(axis=2) < 40).any()
    path = view(scan(), tmp_path / "scan.png", size=(120, 90))
    assert path.read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("needs_renderer")
def test_coordinates_of_a_map_are_drawn_as_those_near_0() -> None:
    """Points at coordinates of a map are drawn precisely; float32 would draw a few stripes."""
    y, x = np.mgrid[0:60, 0:60] * 0.05
    points = np.column_stack([x.ravel(), y.ravel(), 0.2 * np.sin(3 * x).ravel()])
    place = np.array([450_000.0, 5_400_000.0, 300.0])

    def drawn(at: np.ndarray) -> np.ndarray:
        boxes = [Box(tuple(at + np.array([1.5, 1.5, 0.0])), (1.0, 1.0, 1.0))]
        sensor = tuple(at + np.array([-1.0, 1.0, 1.0]))
        cloud = drawn_points(points + at, boxes=boxes, origin=sensor)
        return picture(cloud, size=(240, 180), legend=False).astype(int)

    near, far = drawn(np.zeros(3)), drawn(place)
    paper = near[0, 0]
    inked = np.abs(near - paper).max(axis=2) > 40
    assert inked.sum() > 2000
    assert (np.abs(near - far).max(axis=2) > 40).sum() < 0.02 * inked.sum()


@pytest.mark.usefixtures("needs_renderer")
def test_a_depth_image_is_drawn_as_its_camera_saw_it() -> None:
    depth = np.full((60, 80), 2000, np.uint16)
    color = np.full((60, 80, 3), 90, np.uint8)
    color[:20, :30] = (255, 0, 0)  # the upper left corner
    camera = Intrinsics(80, 60, 70.0, 70.0, 39.5, 29.5)
    cloud = depth_points(depth, camera, color=color)
    image = picture(cloud, size=(160, 120), background=WHITE, legend=False).astype(int)
    assert reddish(image[4:36, 4:56]).mean() > 0.95
    assert reddish(image[46:, :]).sum() == 0
    assert reddish(image[:, 66:]).sum() == 0
    assert (image[4:-4, 4:-4, 1:] < 250).all(axis=2).mean() > 0.99  # no gaps


@pytest.mark.usefixtures("needs_renderer")
def test_the_legend_says_what_the_colors_mean() -> None:
    bare = picture(scan(), size=(300, 220), legend=False)
    full = picture(scan(), size=(300, 220))
    changed = np.abs(full.astype(int) - bare).max(axis=2) > 20
    assert changed[-80:, :160].sum() > 500
    assert not changed[:120].any()
    small = picture(scan(), size=(100, 80))
    assert small.shape == (80, 100, 3)
