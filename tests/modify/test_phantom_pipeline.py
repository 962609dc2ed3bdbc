"""The phantom limb, frame by frame, on a person of capsules whose surface is known exactly."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest
from numpy.typing import NDArray
from test_body_joints import all_distances

from capsule_body import (
    KINECT,
    SMALL,
    frame,
    hit_depth,
    jittered,
    pixel_rays,
    pose,
    render,
    surface_distance,
)
from capsule_body import bones as capsules
from manip3d import (
    InputError,
    Intrinsics,
    Registration,
    RgbdCalibration,
    RgbdFrame,
    Skeleton,
    _core,
)
from manip3d.modify import (
    Limb,
    MirrorMode,
    PhantomFrame,
    PhantomPipeline,
    PhantomReason,
    PhantomState,
    PixelKind,
    Segmentation,
    body_mirror,
)
from manip3d.modify._phantom import _Buffers
from manip3d.rgbd import JOINTS, MIRRORED_JOINTS, PARENTS
from manip3d.simplify import dense_mesh

LIMBS: tuple[Limb, ...] = get_args(Limb)
ROOTS = {"left_arm": 4, "right_arm": 8, "left_leg": 12, "right_leg": 16}
MIRRORED = (PixelKind.PHANTOM, PixelKind.AWAY)


def limb_bones(limb: str) -> set[int]:
    """Bones beyond the root of a limb."""
    beyond = {ROOTS[limb]}
    for _ in range(25):
        beyond |= {bone for bone in range(1, 25) if PARENTS[bone] in beyond}
    return beyond - {ROOTS[limb]}


def other(limb: str) -> str:
    side, part = limb.split("_")
    return f"{'right' if side == 'left' else 'left'}_{part}"


def once(frame_: RgbdFrame, limb: Limb = "right_arm", **options: object) -> PhantomFrame:
    """One frame, joints taken as they are."""
    return PhantomPipeline(limb, smoothing=None, **options).process(frame_)  # type: ignore[arg-type]


def kinds_of_points(result: PhantomFrame) -> NDArray[np.uint8]:
    u, v = result.pixels[: result.num_points].T
    return result.kinds[v, u]


def phantom_points(result: PhantomFrame) -> NDArray[np.float64]:
    """Points that were mirrored, not filled."""
    chosen = np.isin(kinds_of_points(result), MIRRORED)
    return result.vertices[: result.num_points][chosen].astype(float)


# ---- what comes out -------------------------------------------------------------------------


@pytest.mark.parametrize("limb", LIMBS)
@pytest.mark.parametrize("turn", [0.0, 8.0, -8.0])
def test_phantom_lies_on_the_limb_that_is_not_there(limb: Limb, turn: float) -> None:
    whole = pose(turn_deg=turn)
    amputee = frame(whole, KINECT, without=tuple(limb_bones(limb)))
    result = once(amputee, limb)
    assert result.state is PhantomState.TRACKING
    assert result.reason is PhantomReason.NONE
    assert result.opacity == 1
    points = phantom_points(result)
    assert len(points) > 1000
    errors = surface_distance(points, whole)
    assert np.median(errors) < 0.001  # the page asks for 5 mm
    assert np.quantile(errors, 0.99) < 0.005
    mirrored = result.phantom & (result.kinds != PixelKind.ROOT_FILLED)
    assert set(np.unique(result.labels[mirrored])) <= limb_bones(limb)


@pytest.mark.parametrize("limb", LIMBS)
@pytest.mark.parametrize("mode", ["reflection", "paper"])
def test_the_other_side_of_a_person_is_the_same(limb: Limb, mode: MirrorMode) -> None:
    """Left and right are exchanged by looking at the mirrored person: a wrong side would show."""
    bent = {"ElbowLeft": (0.45, 0.45, -0.05), "WristLeft": (0.40, 0.60, -0.2)}
    bent |= {"KneeLeft": (0.15, -0.4, -0.3), "AnkleLeft": (0.16, -0.8, -0.2)}
    mirrored = {n.replace("Left", "Right"): (-x, y, z) for n, (x, y, z) in bent.items()}
    a = once(frame(pose(bent)), limb, mode=mode)
    b = once(frame(pose(mirrored)), other(limb), mode=mode)  # type: ignore[arg-type]
    assert a.num_mirrored == b.num_mirrored
    assert np.mean(a.phantom != b.phantom[:, ::-1]) < 0.001
    both = a.phantom & b.phantom[:, ::-1]
    np.testing.assert_allclose(a.depth[both], b.depth[:, ::-1][both], atol=0.01)


@pytest.mark.parametrize("segmentation", ["skin", "paper"])
@pytest.mark.parametrize("limb", LIMBS)
@pytest.mark.parametrize("bent", [False, True])
def test_no_pixel_of_the_affected_limb_is_left(
    limb: Limb, bent: bool, segmentation: Segmentation
) -> None:
    """Elbows and knees at 90 degrees lie 0.2 and 0.3 m from the straight line."""
    moved: dict[str, tuple[float, float, float]] = {}
    for side, x in (("Left", 1.0), ("Right", -1.0)) if bent else ():
        moved |= {
            "Elbow" + side: (0.21 * x, 0.19, 0.0),
            "Wrist" + side: (0.23 * x, 0.19, -0.25),
            "Hand" + side: (0.23 * x, 0.19, -0.32),
            "HandTip" + side: (0.23 * x, 0.19, -0.40),
            "Thumb" + side: (0.19 * x, 0.21, -0.34),
            "Knee" + side: (0.13 * x, -0.06, -0.42),
            "Ankle" + side: (0.14 * x, -0.46, -0.42),
            "Foot" + side: (0.15 * x, -0.50, -0.57),
        }
    whole = pose(moved)
    image = frame(whole, KINECT)
    result = once(image, limb, segmentation=segmentation)
    _, bones = render(whole, KINECT)
    affected = np.isin(bones, list(limb_bones(limb)))
    assert affected.sum() > 500
    left = affected & (result.kinds == PixelKind.BODY)
    if not (bent and limb.endswith("arm") and segmentation == "skin"):
        assert not left.any()
        return
    # This upper arm touches the trunk, which is thinner than the mean adult's: in the seam, either
    # may have the other's pixels.
    points = (pixel_rays(KINECT) * (image.depth / 1000.0)[..., None])[left]
    assert (surface_distance(points, whole, only=(1, 20)) < 0.015).all()  # two pixels
    assert left.sum() < 0.02 * affected.sum()


def test_a_folded_arm_cuts_no_slot_into_the_chest() -> None:
    folded = {
        "ElbowRight": (-0.30, 0.25, 0.02),
        "WristRight": (-0.08, 0.28, -0.24),
        "HandRight": (0.0, 0.30, -0.25),
        "HandTipRight": (0.07, 0.31, -0.25),
        "ThumbRight": (0.0, 0.34, -0.26),
    }
    whole = pose(folded)
    result = once(frame(whole, KINECT))
    _, bones = render(whole, KINECT)
    taken = (bones == 20) | (bones == 1)
    lost = taken & ~np.isin(result.kinds, (PixelKind.BODY, PixelKind.PHANTOM))
    assert lost.sum() < 0.25 * taken.sum()


@pytest.mark.parametrize("limb", ["right_arm", "left_leg"])
def test_removal_without_tracked_joints(limb: Limb) -> None:
    side = "Right" if limb == "right_arm" else "Left"
    names = [JOINTS[b] for b in limb_bones(limb)]
    whole = pose()
    _, bones = render(whole, KINECT)
    affected = np.isin(bones, list(limb_bones(limb)))
    for missing in (names, [n for n in names if not n.startswith(("Elbow", "Knee"))]):
        guess = replace(frame(whole, KINECT), skeletons=(pose(missing=tuple(missing)),))
        result = once(guess, limb)
        left = (affected & (result.kinds == PixelKind.BODY)).sum()
        # From the root along the other limb, mirrored; beyond the last joint that is tracked, as
        # the other limb's mirror image.
        assert left == 0 if missing is names else left < 0.02 * affected.sum()
        assert result.skeleton.states[JOINTS.index(("Hand" if side == "Right" else "Foot") + side)]


@pytest.mark.parametrize("raised", [30.0, 60.0, 90.0])
def test_a_stump_that_rests_is_found(raised: float) -> None:
    """The other arm rises; the tracker knows of the stump's root alone."""
    angle = np.deg2rad(raised)
    down = np.array([np.sin(angle), -np.cos(angle), 0.0])
    shoulder = np.array([0.19, 0.46, 0.0])
    reach = {"Elbow": 0.27, "Wrist": 0.53, "Hand": 0.6, "HandTip": 0.68, "Thumb": 0.61}
    moved = {n + "Left": tuple(shoulder + r * down) for n, r in reach.items()}
    moved["ElbowRight"] = (-0.21, 0.31, 0.0)  # the stump's end
    beyond = (10, 11, 23, 24)
    stump = frame(pose(moved), KINECT, without=beyond)
    names = tuple(JOINTS[b] for b in limb_bones("right_arm"))
    unknown = replace(stump, skeletons=(pose(moved, missing=names),))
    _, bones = render(pose(moved), KINECT, without=beyond)
    points = pixel_rays(KINECT) * (stump.depth / 1000.0)[..., None]
    far = np.linalg.norm(points - unknown.skeletons[0].positions[8], axis=-1) > 0.12
    left = {}
    for segmentation in ("skin", "paper"):
        kinds = once(unknown, segmentation=segmentation).kinds
        left[segmentation] = ((bones == 9) & far & (kinds == PixelKind.BODY)).sum()
    assert left["skin"] == 0
    assert (left["paper"] > 0) == (raised >= 60.0)


def test_a_hand_on_the_thigh_leaves_the_thigh_alone() -> None:
    """A thigh's bone lies deeper below its skin than a hand's below its own."""
    moved = {
        "Knee": (0.14, -0.08, -0.42),
        "Ankle": (0.15, -0.48, -0.40),
        "Foot": (0.16, -0.52, -0.54),
        "Elbow": (0.26, 0.20, 0.0),
        "Wrist": (0.16, 0.09, -0.20),
        "Hand": (0.14, 0.06, -0.27),
        "HandTip": (0.13, 0.05, -0.35),
        "Thumb": (0.10, 0.07, -0.27),
    }
    seated = {f"{name}Left": p for name, p in moved.items()}
    seated |= {f"{name}Right": (-x, y, z) for name, (x, y, z) in moved.items()}
    whole = pose(seated)
    _, bones = render(whole, KINECT)
    thigh = bones == 17
    left = {}
    for segmentation in ("skin", "paper"):
        kinds = once(frame(whole, KINECT), "right_leg", segmentation=segmentation).kinds
        left[segmentation] = (thigh & (kinds == PixelKind.BODY)).sum()
    assert left["paper"] > 0.03 * thigh.sum()
    assert left["skin"] < 0.1 * left["paper"]


def test_keep_residual_leaves_the_stump() -> None:
    whole = pose()
    stump = frame(whole, KINECT, without=(10, 11, 23, 24))  # an upper arm is there
    result = once(stump, keep_residual=True)
    assert result.num_removed == 0
    _, bones = render(whole, KINECT, without=(10, 11, 23, 24))
    upper_arm = bones == 9
    assert (result.kinds[upper_arm] == PixelKind.BODY).mean() > 0.99
    assert result.phantom.sum() > 500
    assert once(stump).num_removed > 400


# ---- mirroring and writing beside an oracle -------------------------------------------------


@pytest.mark.parametrize("mode", ["reflection", "paper", "2d"])
@pytest.mark.parametrize("limb", LIMBS)
def test_writing_is_a_depth_buffer(limb: Limb, mode: MirrorMode) -> None:
    rng = np.random.default_rng(2)
    moved = {"ElbowLeft": (0.3, 0.25, -0.1), "WristLeft": (0.08, 0.3, -0.3),
             "HandLeft": (0.0, 0.32, -0.32), "HandTipLeft": (-0.07, 0.33, -0.32)}  # fmt: skip
    whole = jittered(pose(moved), rng, 0.003)
    image = frame(whole, KINECT)
    result = once(image, limb, mode=mode, segmentation="paper", root_radius=0)
    mirror = body_mirror(whole, limb, mode=mode)
    assert mirror is not None
    depth = image.depth / np.float32(1000)
    points = pixel_rays(KINECT) * depth[..., None]
    numbers, distances = all_distances(points[depth > 0], whole)
    nearest, bone = distances.min(0), numbers[distances.argmin(0)]
    radius = 0.13 if limb.endswith("arm") else 0.18
    here = np.flatnonzero(depth)
    in_limb = lambda name: np.isin(bone, list(limb_bones(name))) & (nearest <= radius)  # noqa: E731
    source = here[in_limb(other(limb))]
    assert abs(result.num_mirrored - len(source)) <= 0.01 * len(source)
    image_points = mirror(points.reshape(-1, 3)[source])
    uv = image_points[:, :2] / image_points[:, 2:] * 365.0 + (255.5, 211.5)
    u, v = np.floor(uv + 0.5).astype(int).T
    nearest_z = np.full(depth.shape, np.inf)
    np.minimum.at(nearest_z, (v, u), image_points[:, 2])
    body = np.where(result.kinds == PixelKind.BODY, depth, np.inf)
    # Wherever rounding and labels are clear, a body pixel is nearer than all candidates...
    covered = np.isfinite(nearest_z) & (result.kinds == PixelKind.BODY)
    assert (body[covered] > nearest_z[covered] + 1e-5).sum() <= 0.02 * covered.sum()
    # ...and a phantom pixel is the nearest candidate, with its source.
    drawn = np.isin(result.kinds, MIRRORED)
    assert drawn.sum() > 200
    same = np.abs(result.depth[drawn] - nearest_z[drawn]) < 1e-5
    assert same.mean() > 0.98
    i, j = result.source[drawn].T
    again = mirror(points[i, j])
    np.testing.assert_allclose(again[:, 2], result.depth[drawn], atol=1e-5)
    rows, cols = np.nonzero(drawn)
    np.testing.assert_allclose(again[:, 0] / again[:, 2] * 365 + 255.5, cols, atol=0.501)
    np.testing.assert_allclose(again[:, 1] / again[:, 2] * 365 + 211.5, rows, atol=0.501)
    label = np.zeros(depth.shape, int)
    label.flat[here] = bone
    mirrored_label = np.array(MIRRORED_JOINTS)[label[i, j]]
    assert (mirrored_label == result.labels[drawn]).mean() > 0.995  # but for near ties


def test_body_pixels_are_their_own_source() -> None:
    result = once(frame(pose()))
    rows, cols = np.nonzero(result.kinds == PixelKind.BODY)
    np.testing.assert_array_equal(
        result.source[rows, cols], np.stack([rows, cols], axis=1).astype(np.int32)
    )
    nothing = result.kinds == PixelKind.NONE
    assert (result.source[nothing] == -1).all()
    assert (result.depth[nothing] == 0).all()
    assert (result.labels[nothing] == 0).all()


@pytest.mark.parametrize("turn", [15.0, 30.0, 45.0])
def test_a_turned_limb_shows_its_back(turn: float) -> None:
    """17, 33 and 50 % of a cylinder's seen half face away: outer columns, (1 - cos 2 t) / 2."""
    straight = {"ShoulderLeft": (0.40, 0.46, 0.0), "ElbowLeft": (0.40, 0.20, 0.0),
                "WristLeft": (0.40, -0.06, 0.0), "HandLeft": (0.40, -0.14, 0.0),
                "HandTipLeft": (0.40, -0.20, 0.0), "ThumbLeft": (0.40, -0.14, 0.0)}  # fmt: skip
    whole = pose(straight, turn_deg=turn, at=(0, 0, 6.0))
    camera = Intrinsics(512, 424, 900.0, 900.0, 255.5, 211.5)  # far away: nearly parallel rays
    gone = tuple(limb_bones("right_arm"))
    result = once(frame(whole, camera, without=gone))
    share = (1 - np.cos(2 * np.deg2rad(turn))) / 2
    assert result.num_away / result.num_mirrored == pytest.approx(share, abs=0.08)
    # They lie behind points that do face the camera, and are drawn nowhere else.
    away = result.kinds == PixelKind.AWAY
    assert away.sum() < 0.1 * result.num_away
    drawn = np.isin(result.kinds, MIRRORED).sum()
    assert 0.2 < drawn / result.num_mirrored < 1


@pytest.mark.parametrize(("limb", "turn"), [("right_arm", 12), ("right_leg", 12), ("left_arm", 45)])
def test_hole_filling_reads_a_copy(limb: Limb, turn: float) -> None:
    result = once(frame(pose(turn_deg=turn), KINECT), limb)
    kinds = result.kinds.astype(int)
    filled = kinds == PixelKind.FILLED
    assert filled.sum() == result.num_filled > 0
    before = np.where(filled | (kinds == PixelKind.ROOT_FILLED), 0, kinds)  # bridges stay
    depth = np.where(before > 0, result.depth, 0)
    rows, cols = np.nonzero(np.isin(before, (*MIRRORED, PixelKind.BRIDGED)))
    box = np.zeros(kinds.shape, bool)
    box[max(rows.min(), 1) : rows.max() + 1, cols.min() : cols.max() + 1] = True
    expected = np.zeros(kinds.shape, bool)
    wide = 0

    def there(i: int, j: int, down: int, right: int) -> tuple[int, int]:
        nearer = (i + down, j + right)
        return nearer if before[nearer] > 0 else (i + 2 * down, j + 2 * right)

    for i, j in np.argwhere(box & (before == 0)):
        around = [((i, j - 1), (i, j + 1)), ((i - 1, j), (i + 1, j))]
        pairs = _whole_pairs(around, before)
        if not pairs:
            around = [
                (there(i, j, 0, -1), there(i, j, 0, 1)),
                (there(i, j, -1, 0), there(i, j, 1, 0)),
            ]
            if not all(before[p] > 0 for pair in around for p in pair):
                continue
            pairs = _whole_pairs(around, before)
            wide += bool(pairs)
        if not pairs:
            continue
        expected[i, j] = True
        values = [depth[p] for pair in around for p in pair if before[p] > 0]
        assert result.depth[i, j] == pytest.approx(np.mean(values), abs=1e-6)
        sources = [result.source[p] for p in pairs[0] if before[p] >= 2]
        middle = np.floor(np.mean(sources, axis=0) + 0.5)
        np.testing.assert_array_equal(result.source[i, j], middle)
        # The mean of linear indices would be half an image away where rows differ.
    np.testing.assert_array_equal(filled, expected)
    assert (wide > 0) == (turn >= 45)  # holes of two by two pixels


def _whole_pairs(around: list[Any], before: NDArray[np.int_]) -> list[Any]:
    """Those that are there, the phantom in one of the two."""
    return [
        pair
        for pair in around
        if all(before[p] > 0 for p in pair) and any(before[p] >= 2 for p in pair)
    ]


@pytest.mark.parametrize("turn", [0.0, 10.0, -10.0])
def test_no_hole_is_left_up_to_ten_degrees(turn: float) -> None:
    """The page: none over two pixels."""
    ndimage = pytest.importorskip("scipy.ndimage")
    result = once(frame(pose(turn_deg=turn), KINECT, without=tuple(limb_bones("right_arm"))))
    shown = result.phantom
    holes = ndimage.binary_fill_holes(shown) & (result.kinds == PixelKind.NONE)
    labels, _ = ndimage.label(holes)
    assert np.bincount(labels.ravel())[1:].max(initial=0) <= 2


def test_bridges_lie_on_the_surface_between_neighbours() -> None:
    whole = pose(turn_deg=25)
    result = once(frame(whole, KINECT, without=tuple(limb_bones("right_arm"))))
    bridged = result.kinds == PixelKind.BRIDGED
    assert bridged.sum() > 50
    points = (pixel_rays(KINECT) * result.depth[..., None])[bridged].astype(float)
    assert np.median(surface_distance(points, whole)) < 0.002
    mirror = body_mirror(whole, "right_arm")
    assert mirror is not None
    i, j = result.source[bridged].T
    depth = frame(whole, KINECT).depth / 1000
    source = mirror((pixel_rays(KINECT) * depth[..., None])[i, j])
    assert np.linalg.norm(source - points, axis=1).max() < 0.04  # six pixels


def test_second_filling_closes_the_gap_at_the_hip() -> None:
    # The affected hip is seen 8 cm too high: removal takes a piece of the body with the leg.
    s = pose()
    positions = s.positions.copy()
    positions[16] += (0, -0.08, 0)
    seen = replace(frame(pose(), KINECT), skeletons=(replace(s, positions=positions),))
    # By the published bones: by skins, what is taken out of the body is given back to it.
    without, with_root = (
        once(seen, "right_leg", root_radius=radius, segmentation="paper") for radius in (0.0, 0.2)
    )
    root = with_root.kinds == PixelKind.ROOT_FILLED
    assert root.sum() > 20
    assert (without.kinds[root] == PixelKind.NONE).all()
    rest = ~root
    np.testing.assert_array_equal(without.depth[rest], with_root.depth[rest])
    i, j = with_root.source[root].T
    place = (pixel_rays(KINECT) * (seen.depth / 1000)[..., None])[i, j]
    assert (np.linalg.norm(place - positions[12], axis=1) <= 0.1501).all()
    assert (place[:, 0] > positions[0, 0]).all()  # the intact side


# ---- mesh -----------------------------------------------------------------------------------


def test_mesh_of_the_body_is_the_dense_mesh_without_steps() -> None:
    hidden = frame(pose(missing=("ShoulderLeft",)))  # no plane: nothing is mirrored
    result = once(hidden, keep_residual=True)
    assert result.state is PhantomState.LOST
    dense = dense_mesh(hidden.depth, SMALL)
    np.testing.assert_array_equal(result.vertices, dense.vertices)
    np.testing.assert_array_equal(result.pixels, dense.pixels)
    np.testing.assert_array_equal(result.texcoords, dense.texcoords)
    z = dense.vertices[dense.faces, 2]
    kept = dense.faces[np.ptp(z, axis=1) <= np.float32(0.05)]
    np.testing.assert_array_equal(result.faces, kept)


@pytest.mark.parametrize("limb", LIMBS)
def test_mesh_is_whole_and_its_texture_comes_from_the_source(limb: Limb) -> None:
    result = once(frame(pose(turn_deg=5), KINECT), limb)
    assert result.faces.min() >= 0
    assert result.faces.max() < len(result.vertices)
    a, b, c = np.moveaxis(result.vertices[result.faces].astype(float), 1, 0)
    normal = np.cross(b - a, c - a)
    assert ((normal * a).sum(1) < 0).all()  # front faces look at the camera
    assert np.ptp(result.vertices[result.faces, 2], axis=1).max() <= np.float32(0.05)
    u, v = result.pixels[: result.num_points].T
    rows, cols = result.source[v, u].T
    expected = np.stack([(cols + 0.5) / 512, 1 - (rows + 0.5) / 424], axis=1)
    np.testing.assert_allclose(result.texcoords[: result.num_points], expected, atol=1e-6)
    # No triangle's texture leaps across the picture from one side of the body to the other.
    span = np.ptp(result.texcoords[result.faces], axis=1).max(axis=1)
    assert np.quantile(span, 0.999) < 12 / 424
    extra = result.vertices[result.num_points :]
    assert len(extra) > 0
    assert (result.kinds[tuple(result.pixels[result.num_points :].T[::-1])] == PixelKind.BODY).all()
    np.testing.assert_allclose(
        extra[:, 2], result.depth[tuple(result.pixels[result.num_points :].T[::-1])]
    )


def registration() -> Registration:
    c, s = np.cos(0.02), np.sin(0.02)
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    color = Intrinsics(1920, 1080, 1060.0, 1060.0, 960.0, 540.0)
    return Registration(color, turn, np.array([0.052, 0.001, 0.002]))


@pytest.mark.parametrize("distortion", [(0, 0, 0, 0, 0), (0.05, -0.02, 0.001, 0.0, 0.0)])
def test_registered_texture(distortion: tuple[float, ...]) -> None:
    r = registration()
    r = replace(r, color=replace(r.color, distortion=distortion))
    seen = replace(frame(pose(), KINECT), calibration=RgbdCalibration(KINECT, r))
    result = once(seen)
    u, v = result.pixels[: result.num_points].T
    rows, cols = result.source[v, u].T
    depth = seen.depth / np.float32(1000)
    exact = kinds_of_points(result) < PixelKind.FILLED
    points = (pixel_rays(KINECT) * depth[..., None])[rows, cols].astype(np.float32)
    expected = _core.registered_texcoords(np.ascontiguousarray(points), r)
    np.testing.assert_allclose(
        result.texcoords[: result.num_points][exact], expected[exact], atol=1e-5
    )
    calibrated = once(seen, texturing="calibration")
    own = _core.registered_texcoords(np.ascontiguousarray(calibrated.vertices), r)
    np.testing.assert_allclose(calibrated.texcoords, own, atol=1e-6)
    # Figure 4.4: the calibration puts the texture of whatever is behind on the phantom.
    phantom = np.isin(kinds_of_points(result), MIRRORED)
    leap = np.abs(
        calibrated.texcoords[: result.num_points] - result.texcoords[: result.num_points]
    ).max(1)
    assert leap[phantom].min() > 0.05
    assert leap[kinds_of_points(result) == PixelKind.BODY].max() < 1e-5


@pytest.mark.parametrize("distortion", [(0, 0, 0, 0, 0), (0.05, -0.02, 0.001, 0.0, 0.0)])
def test_a_narrow_picture_leaves_the_rest_without_texture(distortion: tuple[float, ...]) -> None:
    r = registration()
    r = replace(r, color=replace(r.color, width=300, cx=0.0, distortion=distortion))
    seen = replace(frame(pose(), KINECT), calibration=RgbdCalibration(KINECT, r))
    result = once(seen, texturing="calibration")
    own = _core.registered_texcoords(np.ascontiguousarray(result.vertices), r)
    np.testing.assert_allclose(result.texcoords, own, atol=1e-6)
    assert 0.2 < np.isnan(result.texcoords[:, 0]).mean() < 0.8
    assert np.nanmin(result.texcoords) >= 0
    assert np.nanmax(result.texcoords) <= 1


def test_an_equal_camera_is_no_new_camera() -> None:
    """A reader may make the table of rays anew for each frame; some pixels have no ray."""
    rays = pixel_rays(SMALL)[..., :2].astype(np.float32)
    rays[0, 0] = np.nan

    def seen(number: int, table: NDArray[np.float32], skeletons: tuple[Skeleton, ...]) -> RgbdFrame:
        camera = RgbdCalibration(replace(SMALL, rays=table.copy()))
        image = replace(frame(pose()), calibration=camera, skeletons=skeletons)
        return replace(image, number=number, time_ns=number * 33_000_000)

    for last, state in ((rays, PhantomState.HOLDING), (rays * 1.001, PhantomState.LOST)):
        pipeline = PhantomPipeline("right_arm")
        for number in range(3):
            result = pipeline.process(seen(number, rays, (pose(),)))
            assert result.state is PhantomState.TRACKING
        assert pipeline.process(seen(3, last, ())).state is state


def test_mesh_for_pictures_and_graphics_cards() -> None:
    result = once(frame(pose()))
    mesh = result.mesh()
    assert mesh.num_faces == len(result.faces)
    assert len(mesh.gpu_buffers()[0]) == len(result.vertices)


@pytest.mark.parametrize("kind", ["distorted", "table", "flipped"])
def test_other_lenses_find_their_pixels(kind: str) -> None:
    rays = pixel_rays(KINECT)[..., :2]
    r2 = (rays**2).sum(-1, keepdims=True)
    camera = {
        "distorted": replace(KINECT, distortion=(0.09, -0.27, 0.0, 0.0, 0.09)),
        "table": replace(KINECT, rays=(rays * (1 - 0.08 * r2)).astype(np.float32)),
        "flipped": replace(KINECT, fy=-365.0),
    }[kind]
    whole = pose()
    points = np.full(rays.shape[:2], 2.44)
    table = rays if kind == "flipped" else None
    lifted, valid, _ = _core.unproject(points.astype(np.float32), camera, 1)
    table = lifted.reshape(424, 512, 3) / np.float32(2.44)
    depth = np.full(points.shape, np.inf)
    for _, a, b, radius in capsules(whole):
        depth = np.minimum(depth, hit_depth(table.astype(float), a, b, radius))
    depth[~np.isfinite(depth)] = 0
    seen = RgbdFrame(
        np.round(1000 * depth).astype(np.uint16), RgbdCalibration(camera), skeletons=(whole,)
    )
    result = once(seen)
    assert valid.all()
    drawn = np.isin(result.kinds, MIRRORED)
    assert drawn.sum() > 1000
    # A mirrored point lies in the pixel whose ray passes nearest.
    mirror = body_mirror(whole, "right_arm")
    assert mirror is not None
    i, j = result.source[drawn].T
    again = mirror((table * result_depth(seen))[i, j].astype(float))
    ray = table[drawn]
    off = np.abs(again[:, :2] / again[:, 2:] - ray[:, :2]) * 365
    assert np.quantile(off, 0.99) < 0.56  # the pixel's width varies with the lens
    a, b, c = np.moveaxis(result.vertices[result.faces].astype(float), 1, 0)
    assert ((np.cross(b - a, c - a) * a).sum(1) < 0).all()


def result_depth(seen: RgbdFrame) -> NDArray[np.float32]:
    return (seen.depth / np.float32(1000))[..., None]


# ---- loss and recovery ----------------------------------------------------------------------


def play(pipeline: PhantomPipeline, frames: list[RgbdFrame]) -> list[PhantomFrame]:
    return [
        pipeline.process(replace(f, number=k, time_ns=k * 33_333_333)) for k, f in enumerate(frames)
    ]


def occluded(whole: Skeleton) -> RgbdFrame:
    """A board stands before most of the left arm."""
    seen = frame(whole)
    _, bones = render(whole, SMALL)
    assert seen.body_index is not None
    board = np.isin(bones, list(limb_bones("left_arm")))
    index = np.where(board, 255, seen.body_index).astype(np.uint8)
    depth = np.where(board, 1200, seen.depth).astype(np.uint16)
    return replace(seen, depth=depth, body_index=index)


def guessed(whole: Skeleton, *, is_seen: bool = False) -> RgbdFrame:
    """The left wrist is guessed, of an arm whose hand is seen or has a board before it."""
    states = whole.states.copy()
    states[6] = 1
    made = replace(frame(whole), skeletons=(replace(whole, states=states),))
    if is_seen:
        return made
    _, bones = render(whole, SMALL)
    assert made.body_index is not None
    board = np.isin(bones, list(limb_bones("left_arm"))[-3:])
    index = np.where(board, 255, made.body_index).astype(np.uint8)
    return replace(
        made, depth=np.where(board, 1200, made.depth).astype(np.uint16), body_index=index
    )


def test_a_guessed_joint_that_the_picture_shows_is_as_good_as_any() -> None:
    whole = pose()
    frames = [frame(whole)] * 5 + [guessed(whole, is_seen=True)] * 45
    for result in play(PhantomPipeline("right_arm"), frames):
        assert result.state is PhantomState.TRACKING


def test_a_root_that_the_thigh_hides_may_be_guessed() -> None:
    """A seated person's hips often are; the trunk tells where they are."""
    whole = pose()
    states = whole.states.copy()
    states[4] = 1  # ShoulderLeft
    hidden = replace(frame(whole), skeletons=(replace(whole, states=states),))
    results = play(PhantomPipeline("right_arm"), [frame(whole)] * 5 + [hidden] * 45)
    assert all(result.state is PhantomState.TRACKING for result in results)


@pytest.mark.parametrize("shift", [-0.06, 0.04, 0.06])
@pytest.mark.parametrize("joints", [("Knee", "Ankle", "Foot"), ("Knee",), ("Ankle", "Foot")])
def test_a_leg_is_found_where_its_flesh_is(joints: tuple[str, ...], shift: float) -> None:
    """Joints beside the leg are moved into it, so that its bones stay where they were."""
    whole = pose()
    told = whole.positions.copy()
    told[[JOINTS.index(f"{joint}Left") for joint in joints], 0] += shift
    seen = frame(whole, KINECT)
    beside = replace(seen, skeletons=(replace(whole, positions=told),))
    labels = [once(f, segmentation="skin").labels for f in (seen, beside)]
    leg = np.isin(labels[0], list(limb_bones("left_leg")))
    assert leg.sum() > 2000
    assert np.mean(labels[0][leg] == labels[1][leg]) > 0.97


LOSSES = {
    "occluded": (occluded, PhantomReason.OCCLUDED, 0.0),
    "inferred": (guessed, PhantomReason.INFERRED, 0.2),
    "no skeleton": (lambda s: replace(frame(s), skeletons=()), PhantomReason.NO_JOINTS, 0.0),
}


@pytest.mark.parametrize("loss", LOSSES)
def test_the_phantom_is_held_then_fades_then_comes_back(loss: str) -> None:
    hide, reason, delay = LOSSES[loss]
    whole = pose()
    seen, hidden = frame(whole), hide(whole)
    frames = [seen] * 5 + [hidden] * 45 + [seen] * 3
    results = play(PhantomPipeline("right_arm"), frames)
    for k, result in enumerate(results):
        since = (k - 4) / 30
        if k <= 4 or k >= 50 or since <= delay + 1e-3:
            assert result.state is PhantomState.TRACKING, k
            assert result.opacity == 1
            assert result.reason is PhantomReason.NONE
            assert result.texture_number == k
            continue
        assert result.reason is reason, k
        kept = since - delay if delay else since  # seconds without a new phantom
        if kept < 0.48:
            assert result.state is PhantomState.HOLDING, k
            assert result.opacity == 1
        elif 0.52 < kept < 0.98:
            assert result.state is PhantomState.FADING, k
            assert 0 < result.opacity < 1
            assert result.texture_number < k
        elif kept > 1.03:
            assert result.state is PhantomState.LOST, k
            assert result.opacity == 0
            assert not result.phantom.any()
        if result.state in (PhantomState.HOLDING, PhantomState.FADING):
            last = results[4 + round(30 * delay)].phantom
            np.testing.assert_array_equal(result.phantom & last, result.phantom)
            assert result.phantom.sum() > 0.9 * last.sum()
    fading = [r.opacity for r in results if r.state is PhantomState.FADING]
    assert fading == sorted(fading, reverse=True)
    assert len(fading) >= 10


def test_a_held_phantom_moves_with_the_body() -> None:
    start, later = pose(), pose(turn_deg=10, at=(0.15, 0.02, 2.5))
    pipeline = PhantomPipeline("right_arm", smoothing=None)
    results = play(pipeline, [frame(start, KINECT)] * 3 + [occluded_kinect(later)] * 2)
    held = results[-1]
    assert held.state is PhantomState.HOLDING
    assert np.median(surface_distance(phantom_points(held), later)) < 0.003
    np.testing.assert_allclose(held.skeleton.positions, later.positions, atol=1e-4)
    assert held.skeleton.states[11] == 1
    assert results[0].skeleton.states[11] == 2
    # Its texture is still that of the last frame in which the arm was seen.
    assert held.texture_number == 2


def occluded_kinect(whole: Skeleton) -> RgbdFrame:
    seen = frame(whole, KINECT)
    _, bones = render(whole, KINECT)
    assert seen.body_index is not None
    index = np.where(np.isin(bones, list(limb_bones("left_arm"))), 255, seen.body_index)
    return replace(seen, body_index=index.astype(np.uint8))


def test_a_lost_phantom_has_no_joints() -> None:
    results = play(PhantomPipeline("right_arm"), [occluded(pose())] * 2)
    assert results[-1].state is PhantomState.LOST
    assert (results[-1].skeleton.states[sorted(limb_bones("right_arm"))] == 0).all()
    assert results[-1].skeleton.states[8] == 2


def test_the_last_axes_stand_in_for_degenerate_ones() -> None:
    seen = frame(pose())
    blind = replace(seen, skeletons=(pose(missing=("ShoulderRight",)),))
    results = play(PhantomPipeline("right_arm", smoothing=None), [seen, blind])
    assert results[1].state is PhantomState.TRACKING
    assert results[1].phantom.sum() > 100
    alone = once(blind)
    assert alone.state is PhantomState.LOST
    assert alone.reason is PhantomReason.NO_PLANE


def test_late_frames_are_counted_and_passed_over() -> None:
    pipeline = PhantomPipeline("right_arm")
    first = pipeline.process(replace(frame(pose()), time_ns=2_000_000_000, number=60))
    for time in (2_000_000_000, 1_500_000_000):
        late = pipeline.process(replace(frame(pose()), time_ns=time))
        assert late.state is PhantomState.LATE
        np.testing.assert_array_equal(late.depth, first.depth)
    assert late.late_frames == 2
    assert pipeline.process(replace(frame(pose()), time_ns=2_000_000_001)).state == "tracking"
    # A recording that starts over is a new one.
    again = pipeline.process(replace(frame(pose(at=(0.3, 0, 2.6))), time_ns=0))
    assert again.state is PhantomState.TRACKING
    assert again.late_frames == 3


def test_nobody_is_nothing() -> None:
    empty = replace(frame(pose()), skeletons=())
    result = PhantomPipeline("left_leg").process(empty)
    assert result.state is PhantomState.LOST
    assert result.reason is PhantomReason.NO_JOINTS
    assert len(result.vertices) == len(result.faces) == 0
    assert not result.depth.any()


def test_other_people_are_ignored() -> None:
    patient, helper = pose(), pose(at=(0.9, 0, 2.0), identity=2, body=1)
    both = frame(patient)
    depth, _ = render(helper, SMALL)
    assert both.body_index is not None
    in_front = depth > 0
    crowd = replace(
        both,
        depth=np.where(in_front, np.round(1000 * depth), both.depth).astype(np.uint16),
        body_index=np.where(in_front, 1, both.body_index).astype(np.uint8),
        skeletons=(helper, patient),
    )
    result = once(crowd)
    assert result.num_person == ((crowd.depth > 0) & (crowd.body_index == 0)).sum()
    body = result.kinds == PixelKind.BODY
    assert not (body & in_front).any()


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0, 1e30, -1e5])
def test_hostile_joints_do_no_harm(bad: float) -> None:
    rng = np.random.default_rng(0)
    pipeline = PhantomPipeline("right_arm")
    for k in range(12):
        positions = pose().positions.copy()
        if k % 2 == 1:
            positions[rng.choice(25, rng.integers(1, 25), replace=False)] = bad
        seen = replace(
            frame(pose()),
            skeletons=(replace(pose(), positions=positions),),
            time_ns=k * 33_333_333,
        )
        result = pipeline.process(seen)
        assert np.isfinite(result.vertices).all()
        assert np.isfinite(result.skeleton.positions).all()
    result = pipeline.process(replace(frame(pose()), time_ns=10**9))
    assert result.state is PhantomState.TRACKING


def test_calibrations_may_change_and_may_be_wrong() -> None:
    pipeline = PhantomPipeline("right_arm")
    assert pipeline.process(frame(pose())).state is PhantomState.TRACKING
    assert pipeline.process(frame(pose(), KINECT, number=1)).depth.shape == (424, 512)
    with pytest.raises(InputError, match=r"depth: expected shape \(160, 192\)"):
        pipeline._core.process(  # a frame whose sizes do not agree cannot be made in Python
            np.zeros((3, 4), np.uint16), None, SMALL, None, None, (), 10**9, 2,
            _Buffers.of_size(3, 4),
        )  # fmt: skip
    shape = SMALL.height, SMALL.width
    with pytest.raises(InputError, match=r"color: expected shape \(160, 192, 3\).*got \(3, 4, 3\)"):
        pipeline._core.process(
            np.zeros(shape, np.uint16), None, SMALL, None, np.zeros((3, 4, 3), np.uint8), (),
            10**9, 2, _Buffers.of_size(*shape),
        )  # fmt: skip
    assert pipeline.process(frame(pose(), number=30)).state is PhantomState.TRACKING


def test_a_refused_option_is_shown_exactly() -> None:
    """The message was "expected 0 to 1.000000, got 1.000000"."""
    with pytest.raises(InputError, match=r"^least_visible: expected 0 to 1, got 1\.000000001$"):
        PhantomPipeline(least_visible=1.0 + 1e-9)


def test_options_are_checked() -> None:
    for options in (
        {"arm_radius": -1},
        {"leg_radius": float("nan")},
        {"least_visible": 2},
        {"root_radius": 1.1},
        {"inferred_seconds": -0.1},
        {"hold_seconds": float("inf")},
        {"fade_seconds": float("nan")},
        {"max_depth_step": float("nan")},
        {"near": float("nan")},
        {"near": 9.0},
        {"far": 65.1},
        {"margin": -0.1},
        {"mode": "mirror"},
    ):
        with pytest.raises(InputError, match=next(iter(options))):
            PhantomPipeline(**options)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="affected"):
        PhantomPipeline("nose")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="texturing"):
        PhantomPipeline(texturing="none")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="segmentation"):
        PhantomPipeline(segmentation="bone")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="smoothing"):
        PhantomPipeline(smoothing="lying")  # type: ignore[arg-type]


def test_reset_forgets() -> None:
    pipeline = PhantomPipeline("right_arm")
    play(pipeline, [frame(pose())] * 3)
    result = pipeline.reset().process(occluded(pose()))
    assert result.state is PhantomState.LOST


def test_3d_mirroring_is_right_when_the_person_turns_and_2d_is_not() -> None:
    """Figure 4.11 a and b."""
    whole = pose(turn_deg=45)
    seen = frame(whole, KINECT, without=tuple(limb_bones("right_arm")))
    true, flat = once(seen), once(seen, mode="2d")
    assert np.median(surface_distance(phantom_points(true), whole)) < 0.005
    assert np.median(surface_distance(phantom_points(flat), whole)) > 0.05
    hand = JOINTS.index("HandRight")
    assert np.linalg.norm(true.skeleton.positions[hand] - whole.positions[hand]) < 1e-4
    assert np.linalg.norm(flat.skeleton.positions[hand] - whole.positions[hand]) > 0.2


def test_stages_are_the_rows_of_table_4_1() -> None:
    result = once(frame(pose()))
    assert list(result.seconds) == [
        "segmentation", "removal", "mirroring", "hole filling", "phantom skeleton",
        "point cloud", "textured mesh",
    ]  # fmt: skip
    assert all(s >= 0 for s in result.seconds.values())
