"""The phantom limb on recorded people: faults of pictures, and whether the pipeline reports them.

``python benchmarks/bench_people.py [--half tuning|reporting] [--sheet FILE.png] [--simulated]``
reads the trials of UTD-MHAD (``MANIP3D_DATA``) and prints one table; the sheet shows the worst
frames by a measure. A trial belongs to the tuning half if its action and its subject are both odd
or both even. Options are chosen on that half, and results are reported on the other one.

The *gate* is the pipeline's own test of plausibility, which decides the state of a frame. The
following faults are measured independently of the gate, from the picture and the raw joints:

cut       Legs: more than 15 % of the person's pixels below the hips show nothing. Arms: more than
          5 % of the trunk's pixels show nothing.
doubled   The result shows more than 10 % of the affected limb's body pixels. A pixel belongs to the
          limb if it is nearer to the limb's line of joints than to the rest of the skeleton, does
          not lie more than 12 cm behind that line (as a chair does), and is farther from the rest
          than other limbs are thick: 18 cm (legs: 16 cm), or 13 cm within 6 cm of the line. The
          trunk is the surface between shoulders and hips, because a chest extends more than 18 cm
          to either side of the spine, and with the spine alone chests and hips counted as doubled
          limbs. A pixel that is nearest to a leg in the whole skeleton does not belong to an arm,
          because the joints of seated thighs lie deep below the skin and otherwise a knee next to
          the hand counted as an arm (in six of seven frames of the tuning half that were looked
          at). If the limb is not removed (``--kept``), 95 % of the arms' frames and nine of ten
          legs count as doubled. For legs the measure is too strict: in some of the frames that
          it flags, the pixels belong to the intact thigh.
floating  The largest piece of the phantom begins more than 10 cm (arms) or 16 cm (legs) from its
          root.

A second table describes the lost pixels of the legs' frames with the fault `cut`, as means in
percent of the person's pixels below the hips:

limb        Pixels nearest to a recorded bone of the affected limb. They are flesh of that limb,
            which an amputee does not have and which is lost if the two legs are not symmetric about
            the plane. If the tracker puts the limb's joints into the other leg, as happens with
            some seated people, they include flesh of that leg.
shown       Pixels that the picture shows below the hips, including the phantom. 100 or more: the
            phantom only lies elsewhere than the leg.
body        Pixels nearest to another bone, which were removed by error.
background  Pixels farther than 20 cm from all bones, which were removed by error.
best plane  Lost pixels of the limb if the plane is turned about the vertical and shifted until the
            two recorded legs cover each other best, which is impossible for a person without the
            second leg.
turn        Median of the angle of that turn.

Options that print another table instead:

``--simulated``: simulated seated people with the errors of a Kinect V1's tracker, each once without
the affected leg and once with both legs. For people with the leg, `cut` includes the flesh of that
leg, which no patient has.

``--sleeves``: simulated people without the limb, with a bare stump or with an empty sleeve or
trouser leg. `cloth`: frames that the gate reports as cloth. `tracking, kept`: frames in state
`tracking` that keep more than 10 % of the cloth's pixels (farther than 10 cm from the root). `but
for it`: the same if the gate had no test for cloth. The limit was chosen on seeds 0 and 1; seeds 4
and 5, with further motions, are reported. ``--guessed`` marks the affected limb's joints in the
recordings as inferred, like those of a missing limb; reports of `cloth` are then false alarms.

``--flying``: simulated people with a bare stump, whose tracker (Kinect V2) reports the joints of
the missing limb as tracked at wrong places. `holes`: frames in which more than 1 % of the person's
other pixels (farther than 12 cm from the root) show nothing. `lost`: mean share of these pixels.
The rules were chosen on seed 0; seed 5 is reported.

``--stout``: simulated people of several girths (of trunk, arms and legs, relative to the default).
The table contains the states, and the frames in which the gate takes the trunk's flank for a
remaining limb. The rule was chosen on the right arm and the left leg at seed 0 with 10 mm of
jitter; the other two limbs are reported, at seeds 6 and 7 with 0 and 20 mm.

``--twist``: simulated people, tracked by a Kinect V2, whose chest turns relative to the pelvis by
an angle to either side, once in four seconds. The table contains the angle between the plane and
the true one (the pelvis's for legs, the chest's for arms); the error of the true hand or foot after
reflection at the plane; and the shares of all frames, and of those in state `tracking`, with more
than 5 degrees. ``--from-start`` begins at the largest twist and leaves out the first second. Rules
were chosen on seed 0 (``--seed 0``); seed 5 is reported.

``--calibration``: simulated people whose focal length is wrong by a factor. The table contains the
percentages of frames in state `tracking`, of all frames and of those after the first second, and of
frames whose reason is the calibration. The limits were chosen on seed 1 and the tuning half; seed 5
is reported.

``--unindexed``: simulated people in a room, and trials of the tuning half (``--half reporting``: of
the other half) of actions 3, 24, 25 and 27 with a floor and a wall drawn behind the people, 10 cm
behind the farthest of their points and with the depth steps of a Kinect V1. Each is processed with
its body index and without one. The table contains the percentage of frames in state `tracking`, and
the intersection over union of both pictures (mean, and 5th percentile).

``--disturbed``: trials 24 and 25 of the tuning half with additional errors of the joints: shoulders
and hips turned about the spine by an angle, or AR(1) jitter on all joints. The table contains
percentages of the seated frames of both legs (every second frame): in state `tracking`, with fault
`cut`, and cut frames among those in state `tracking`; and the 95th percentile of the share lost
below the hips.

``--mistaken``: trials of one half with mistakes of a source: joints with left and right exchanged,
in all frames or in 20 of them; a principal point that is off by 8 or 20 pixels; depth in a unit
that is a tenth too small. The table contains the percentages of frames in state `tracking`, and of
frames whose reason is the calibration or the sides.

``tests/modify/test_doubled_limbs.py`` tests `doubled` on simulated people, whose limbs are known.
For stout people (a girth of 1.5) who reach out, `doubled` is too strict.
"""

from __future__ import annotations

import argparse
import itertools
import re
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from manip3d.modify import BodySegmentation, Limb, PhantomFrame
    from manip3d.rgbd import RgbdFrame, Skeleton
    from manip3d.simulate import BodyCapture

LIMBS = ("left_arm", "right_arm", "left_leg", "right_leg")
FAULTS = ("cut", "doubled", "floating")
SEATED = (24, 25)  # actions "sit to stand" and "stand to sit"


def numbers(uri: str) -> tuple[int, int]:
    """Return action and subject of a trial."""
    found = re.fullmatch(r"utd-mhad:a(\d+)_s(\d+)", uri)
    assert found is not None
    return int(found[1]), int(found[2])


def is_tuning(uri: str) -> bool:
    """Return whether a trial belongs to the half on which options are chosen."""
    action, subject = numbers(uri)
    return (action + subject) % 2 == 0


def is_seated(frame: RgbdFrame) -> bool:
    """Return whether the thighs point more towards the camera than down."""
    hips, knees = (
        frame.skeletons[0].positions[list(rows)].mean(axis=0) for rows in ((12, 16), (13, 17))
    )
    return bool(knees[1] - hips[1] < hips[2] - knees[2])


@dataclass(frozen=True)
class Loss:
    """Losses of a frame below the hips, as shares of the person's pixels there."""

    limb: float
    body: float
    background: float
    best_plane: float
    turn_deg: float
    shown: float


@dataclass
class Tally:
    """Counts of frames by state, reason and fault."""

    frames: int = 0
    states: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    faults: Counter[str] = field(default_factory=Counter)
    unsaid: Counter[str] = field(default_factory=Counter)
    losses: list[Loss] = field(default_factory=list)

    def add(self, result: PhantomFrame, faults: set[str]) -> None:
        """Count a frame."""
        self.frames += 1
        self.states[result.state.value] += 1
        self.reasons[result.reason.value] += 1
        self.faults.update(faults)
        if result.state.value == "tracking":
            self.unsaid.update(faults)

    def loss_row(self) -> list[str]:
        """Return means over cut frames, and the share of frames cut only by wrong removal."""
        parts = np.array(
            [(c.limb, c.body, c.background, c.shown, c.best_plane) for c in self.losses]
        )
        turns = np.median([c.turn_deg for c in self.losses])
        by_error = sum(c.body + c.background > 0.15 for c in self.losses) / self.frames
        means = [f"{100 * mean:.1f}" for mean in parts.mean(axis=0)]
        return [str(len(self.losses)), *means, f"{turns:.0f}", f"{100 * by_error:.1f}"]

    def row(self) -> list[str]:
        """Return percentages of frames: states, faults, and faults among tracked frames."""
        tracking = max(1, self.states["tracking"])
        shares = [self.states[s] / self.frames for s in ("tracking", "degraded")]
        for fault in FAULTS:
            shares += [self.faults[fault] / self.frames, self.unsaid[fault] / tracking]
        reasons = {name: count for name, count in self.reasons.most_common(7) if name != "none"}
        said = ", ".join(f"{name} {100 * n / self.frames:.1f}" for name, n in reasons.items())
        return [str(self.frames), *(f"{100 * share:.1f}" for share in shares), said]


def segmented(frame: RgbdFrame, skeleton: Skeleton) -> BodySegmentation:
    """Return the nearest bone of each pixel."""
    from manip3d.modify import segment_body

    return segment_body(frame.depth, frame.calibration.depth, skeleton, body_index=frame.body_index)


def from_line(
    points: NDArray[Any], chain: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return distances to a line of joints, and how much farther from the camera points are."""
    nearest = np.full(points.shape[:2], np.inf)
    behind = np.zeros(points.shape[:2])
    for a, b in itertools.pairwise(chain):
        along = np.clip((points - a) @ (b - a) / max(1e-9, float((b - a) @ (b - a))), 0.0, 1.0)
        off = points - a - along[..., None] * (b - a)
        distance = np.linalg.norm(off, axis=-1)
        behind = np.where(distance < nearest, off[..., 2], behind)
        nearest = np.minimum(nearest, distance)
    return nearest, behind


def from_trunk(points: NDArray[Any], joints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return distances to the surface between shoulders and hips, sampled by nine lines."""
    left, right = (np.linspace(joints[a], joints[b], 9) for a, b in ((4, 12), (8, 16)))
    rungs = (from_line(points, np.stack(ends))[0] for ends in zip(left, right, strict=True))
    return np.asarray(np.minimum.reduce(list(rungs)), np.float64)


def is_of_limb(
    points: NDArray[Any], joints: NDArray[np.float64], limb: str, rest: BodySegmentation
) -> NDArray[np.bool_]:
    """Return the pixels that belong to the limb by the rule of `doubled`."""
    from manip3d.simulate import LIMBS as CHAINS

    mine, behind = from_line(points, joints[list(CHAINS[limb])])
    others = np.minimum(rest.distances, from_trunk(points, joints))
    thick = 0.18 if limb.endswith("arm") else 0.16
    is_off = (others > thick) | ((others > 0.13) & (mine < 0.06))
    return (mine < others) & (mine < 0.35) & (behind < 0.12) & is_off


def without(skeleton: Skeleton, limb: str) -> Skeleton:
    """Return the skeleton without a limb beyond its root."""
    from manip3d.simulate import LIMBS as CHAINS

    states, positions = skeleton.states.copy(), skeleton.positions.copy()
    gone = [j for j in range(25) if j in CHAINS[limb][1:]]
    states[gone], positions[gone] = 0, 0.0
    return replace(skeleton, states=states, positions=positions)


def shares(
    frame: RgbdFrame,
    result: PhantomFrame,
    limb: str,
    bones: BodySegmentation,
    rest: BodySegmentation,
) -> dict[str, float]:
    """Return each fault's measure divided by its limit."""
    from scipy import ndimage

    from manip3d.modify import PixelKind
    from manip3d.simulate import LIMBS as CHAINS

    joints = frame.skeletons[0].positions.astype(float)
    camera = frame.calibration.depth
    points = camera.unproject(frame.depth)
    person = frame.body_index == 0
    arm = limb.endswith("arm")
    if arm:
        off = points - joints[1]
        part = (np.abs(off[..., 0]) < 0.13) & (off[..., 1] > -0.20) & (off[..., 1] < 0.30)
    else:
        part = points[..., 1] > joints[0, 1]
    part &= person
    lost = (part & (result.kinds == PixelKind.NONE)).sum() / max(1, part.sum())
    chain = CHAINS[limb]
    mine = person & np.isin(bones.labels, chain[1:])
    left = person & (result.kinds == PixelKind.BODY) & is_of_limb(points, joints, limb, rest)
    if arm:
        left &= ~np.isin(bones.labels, (*CHAINS["left_leg"], *CHAINS["right_leg"]))
    doubled = left.sum() / max(30, mine.sum())
    shown = result.phantom & (result.kinds != PixelKind.ROOT_FILLED)
    pieces, count = ndimage.label(shown, np.ones((3, 3)))
    gap = 0.0
    if count:
        largest = pieces == 1 + np.argmax(np.bincount(pieces.ravel())[1:])
        seen = camera.unproject(result.depth)[largest]
        gap = float(np.linalg.norm(seen - result.skeleton.positions[chain[0]], axis=1).min())
    return {
        "cut": float(lost) / (0.05 if arm else 0.15),
        "doubled": float(doubled) / 0.10,
        "floating": gap / (0.10 if arm else 0.16),
    }


def coverage(
    points: NDArray[Any], origin: NDArray[np.float64], normal: NDArray[np.float64], camera: Any
) -> NDArray[np.bool_]:
    """Return the pixels that points cover after reflection; small gaps are closed."""
    from scipy import ndimage

    off = (points - origin) @ normal
    u, v = np.rint(camera.project(points - 2.0 * off[:, None] * normal)).astype(int).T
    covered = np.zeros((camera.height, camera.width), bool)
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    covered[v[inside], u[inside]] = True
    return np.asarray(ndimage.binary_closing(covered, np.ones((5, 5))))


def loss_below(
    frame: RgbdFrame, result: PhantomFrame, limb: str, bones: BodySegmentation
) -> Loss | None:
    """Return the pixels lost below the hips, by kind; None: there is no plane."""
    from manip3d.modify import PixelKind
    from manip3d.simulate import LIMBS as CHAINS
    from manip3d.simulate import opposite

    if result.plane is None:
        return None
    camera = frame.calibration.depth
    points = camera.unproject(frame.depth).astype(float)
    person = frame.body_index == 0
    part = person & (points[..., 1] > frame.skeletons[0].positions[0, 1])
    lost = part & (result.kinds == PixelKind.NONE)
    far = bones.distances > 0.20
    mine = np.isin(bones.labels, CHAINS[limb][1:]) & ~far
    intact = points[person & np.isin(bones.labels, CHAINS[opposite(limb)][1:])]
    gone = part & mine & (result.kinds != PixelKind.BODY)
    best, best_turn = np.inf, 0.0
    n = result.plane.normal
    for turn in np.radians(np.arange(-18, 19, 3)):
        c, s = np.cos(turn), np.sin(turn)
        turned = np.array([c * n[0] - s * n[2], n[1], s * n[0] + c * n[2]])
        for shift in np.arange(-0.06, 0.07, 0.02):
            covered = coverage(intact, result.plane.origin + shift * n, turned, camera)
            left = float((gone & ~covered).sum())
            if left < best:
                best, best_turn = left, abs(float(np.degrees(turn)))
    pixels = max(1, int(part.sum()))
    hips = frame.skeletons[0].positions[0, 1]
    drawn = (result.kinds != PixelKind.NONE) & (camera.unproject(result.depth)[..., 1] > hips)
    return Loss(
        limb=float((lost & mine).sum()) / pixels,
        body=float((lost & ~mine & ~far).sum()) / pixels,
        background=float((lost & far).sum()) / pixels,
        best_plane=best / pixels,
        turn_deg=best_turn,
        shown=float(drawn.sum()) / pixels,
    )


def lost_below_hips(frame: RgbdFrame, result: PhantomFrame) -> float:
    """Return the share of the person's pixels below the hips that show nothing."""
    from manip3d.modify import PixelKind

    points = frame.calibration.depth.unproject(frame.depth)
    part = (frame.body_index == 0) & (points[..., 1] > frame.skeletons[0].positions[0, 1])
    return float((part & (result.kinds == PixelKind.NONE)).sum()) / max(1, int(part.sum()))


def simulated_row(has_leg: bool, turn: float, thigh_turn: float = 0.0) -> list[str]:
    """Return percentages of all and of tracked frames of seated people turned by an angle."""
    from manip3d.modify import PhantomPipeline
    from manip3d.simulate import BodySimulator, opposite

    lost: list[float] = []
    ideal: list[float] = []
    tracked: list[bool] = []
    motions = (
        ("still", "dorsiflexion") if thigh_turn else ("still", "knee-extension", "dorsiflexion")
    )
    for leg, motion, aside in itertools.product(LIMBS[2:], motions, sorted({-turn, turn})):
        pipeline = PhantomPipeline(leg)
        simulator = BodySimulator(
            motion=motion,
            side=opposite(leg).split("_")[0],
            amputated=None if has_leg else leg,
            sitting=True,
            turn=aside,
            thigh_turn=thigh_turn,
            sway=5.0,
            tracker="kinect-v1",
            color="none",
            frames=60,
            seed=3,
        )
        for number in range(60):
            seen = simulator.capture(number / 30.0)
            result = pipeline.process(seen.frame)
            if number % 2 == 0:
                lost.append(lost_below_hips(seen.frame, result))
                ideal.append(ideal_loss(seen, leg) if has_leg and not thigh_turn else np.nan)
                tracked.append(result.state.value == "tracking")
    cut = np.array(lost) > 0.15
    unsaid = (cut & tracked).sum() / max(1, sum(tracked))
    shares = (np.mean(tracked), cut.mean(), unsaid, np.mean(lost))
    who = f"{'both legs' if has_leg else 'one leg'}, turned {turn:.0f} degrees"
    who += f", legs {thigh_turn:+.0f}" if thigh_turn else ""
    at_best = "" if np.isnan(ideal).any() else f"{100 * np.mean(np.array(ideal) > 0.15):.1f}"
    return [who, str(len(lost)), *(f"{100 * share:.1f}" for share in shares), at_best]


def ideal_loss(seen: BodyCapture, leg: str) -> float:
    """Return the share below the hips of leg pixels that the true mirror image does not hide."""
    from manip3d.simulate import LIMBS as CHAINS
    from manip3d.simulate import cast_mesh

    frame, truth = seen.frame, seen.truth
    camera = frame.calibration.depth
    points = camera.unproject(frame.depth)
    part = (frame.body_index == 0) & (points[..., 1] > frame.skeletons[0].positions[0, 1])
    hidden = cast_mesh(truth.phantom(leg), camera) > 0  # type: ignore[arg-type]
    mine = np.isin(truth.bones, CHAINS[leg][1:])
    return float((part & mine & ~hidden).sum()) / max(1, int(part.sum()))


def print_simulated() -> None:
    """Print the table of simulated people."""
    import tables

    rows = [simulated_row(has_leg, turn) for has_leg in (False, True) for turn in (0.0, 15.0)]
    rows += [simulated_row(True, 15.0, thigh_turn) for thigh_turn in (-15.0, 15.0)]
    head = ["simulated, seated; % of the frames", "frames", "tracking", "cut", "tracking", "lost"]
    print(tables.table([*head, "cut at best"], rows))


def without_sight(frame: RgbdFrame, limb: str) -> RgbdFrame:
    """Return the frame with the limb's joints inferred, as a tracker reports a missing limb's."""
    from manip3d.rgbd import INFERRED
    from manip3d.simulate import LIMBS as CHAINS

    person = frame.skeletons[0]
    states = person.states.copy()
    states[list(CHAINS[limb][1:])] = INFERRED
    return replace(frame, skeletons=(replace(person, states=states),))


def sleeve_row(kind: str, dressing: str, turn: float) -> list[str]:
    """Return percentages of frames of people turned by an angle, with a bare stump or a sleeve."""
    from manip3d.modify import PhantomPipeline, PixelKind
    from manip3d.simulate import LIMBS as CHAINS
    from manip3d.simulate import BodySimulator, opposite
    from manip3d.simulate.people import DEPTH_CAMERA

    motions = ("still", "reach", "arm-curl") if kind == "arm" else ("still", "stepping")
    frames = tracked = called = kept = kept_before = 0
    sides = (f"left_{kind}", f"right_{kind}")
    for limb, motion, aside, seed in itertools.product(
        sides, motions, sorted({-turn, turn}), (4, 5)
    ):
        pipeline = PhantomPipeline(limb)  # type: ignore[arg-type]
        simulator = BodySimulator(
            motion=motion,
            side=opposite(limb).split("_")[0],
            amputated=limb,
            dressing=dressing,
            tracker="kinect-v2",
            turn=aside,
            color="none",
            room=False,
            seed=seed,
        )
        for number in range(26):
            seen = simulator.capture(number / 30.0)
            result = pipeline.process(seen.frame)
            if number < 6 or number % 2:
                continue
            root = seen.truth.joints[CHAINS[limb][0]]
            off = np.linalg.norm(DEPTH_CAMERA.unproject(seen.frame.depth) - root, axis=-1)
            cloth = np.isin(seen.truth.bones, CHAINS[limb][1:]) & (seen.frame.depth > 0)
            left = (cloth & (off > 0.10) & (result.kinds == PixelKind.BODY)).sum()
            frames += 1
            tracked += result.state.value == "tracking"
            called += result.reason.value == "cloth"
            if dressing == "sleeve" and left > 0.10 * cloth.sum():
                kept += result.state.value == "tracking"
                kept_before += result.state.value == "tracking" or result.reason.value == "cloth"
    shares = [f"{100 * part / frames:.1f}" for part in (tracked, called, kept, kept_before)]
    if dressing != "sleeve":
        shares[2:] = ["", ""]
    return [f"{kind}, {dressing}, turned {turn:.0f} degrees", str(frames), *shares]


def print_sleeves() -> None:
    """Print the table of sleeves."""
    import tables

    cases = itertools.product(("arm", "leg"), ("bare", "sleeve"), (0.0, 15.0, 30.0))
    head = ["simulated; % of the frames", "frames", "tracking", "cloth"]
    head += ["tracking, kept", "but for it"]
    print(tables.table(head, [sleeve_row(*case) for case in cases]))


def flying_row(kind: str, sitting: bool, turn: float) -> list[str]:
    """Return percentages of frames of people whose missing limb's joints seem to be tracked."""
    from manip3d.modify import PhantomPipeline, PixelKind
    from manip3d.simulate import LIMBS as CHAINS
    from manip3d.simulate import BodySimulator, opposite
    from manip3d.simulate.people import DEPTH_CAMERA

    motions = {
        ("arm", False): ("still", "reach", "arm-raise", "elbow-bent"),
        ("arm", True): ("reach",),
        ("leg", False): ("still", "stepping"),
        ("leg", True): ("knee-extension",),
    }[kind, sitting]
    lost: list[float] = []
    tracked: list[bool] = []
    for limb, motion in itertools.product((f"left_{kind}", f"right_{kind}"), motions):
        pipeline = PhantomPipeline(limb)  # type: ignore[arg-type]
        simulator = BodySimulator(
            motion=motion,
            side=opposite(limb).split("_")[0],
            amputated=limb,
            sitting=sitting,
            tracker="kinect-v2",
            turn=turn,
            color="none",
            room=False,
            seed=5,
        )
        for number in range(26):
            seen = simulator.capture(number / 30.0)
            result = pipeline.process(seen.frame)
            if number < 4 or number % 2:
                continue
            points = DEPTH_CAMERA.unproject(seen.frame.depth)
            off = np.linalg.norm(points - seen.truth.joints[CHAINS[limb][0]], axis=-1)
            body = (seen.frame.body_index == 0) & (seen.truth.bones != 255)
            rest = body & ~np.isin(seen.truth.bones, CHAINS[limb][1:]) & (off > 0.12)
            lost.append(float((rest & (result.kinds == PixelKind.NONE)).sum() / rest.sum()))
            tracked.append(result.state.value == "tracking")
    holes = np.array(lost) > 0.01
    unsaid = (holes & tracked).sum() / max(1, sum(tracked))
    parts = (np.mean(tracked), holes.mean(), unsaid)
    who = f"{kind}, {'seated' if sitting else 'standing'}, turned {turn:.0f} degrees"
    shares = [f"{100 * part:.1f}" for part in parts]
    return [who, str(len(lost)), *shares, f"{100 * np.mean(lost):.2f}"]


def print_flying() -> None:
    """Print the table of joints at wrong places."""
    import tables

    cases = itertools.product(("arm", "leg"), (False, True), (0.0, 20.0))
    head = ["simulated; % of the frames", "frames", "tracking", "holes", "tracking", "lost"]
    print(tables.table(head, [flying_row(*case) for case in cases]))


def twist_row(kind: str, sitting: bool, twist: float, seed: int, begin: int = 0) -> list[str]:
    """Errors of the plane of people whose chest turns against the pelvis."""
    from manip3d.modify import PhantomPipeline
    from manip3d.simulate import LIMBS as CHAINS
    from manip3d.simulate import BodySimulator, opposite

    motions = ("still", "reach") if kind == "arm" else ("still", "knee-extension")
    degrees, metres, tracked = [], [], []
    for side, motion, way in zip(("left", "right"), motions, (1.0, -1.0), strict=True):
        limb: Limb = f"{side}_{kind}"  # type: ignore[assignment]
        pipeline = PhantomPipeline(limb)
        simulator = BodySimulator(
            motion=motion, amputated=limb, sitting=sitting, twist=way * twist, color="none",
            tracker="kinect-v2", room=False, seed=seed,
        )  # fmt: skip
        for number in range(begin, 120):
            seen = simulator.capture(number / 30.0)
            result = pipeline.process(seen.frame)
            if number < max(15, 2 * begin) or result.plane is None:
                continue
            origin, normal = seen.truth.mirror_plane(limb)
            end = seen.truth.joints[CHAINS[opposite(limb)][3]].astype(float)
            true = end - 2.0 * float((end - origin) @ normal) * normal
            metres.append(float(np.linalg.norm(result.plane(end) - true)))
            cosine = min(1.0, abs(float(result.plane.normal @ normal)))
            degrees.append(float(np.degrees(np.arccos(cosine))))
            tracked.append(result.state.value == "tracking")
    off = np.array(degrees) > 5.0
    unsaid = (off & tracked).sum() / max(1, sum(tracked))
    who = f"{kind}, {'seated' if sitting else 'standing'}, {twist:.0f} degrees"
    spread = [f"{x:.1f}" for x in (np.median(degrees), np.percentile(degrees, 95))]
    spread += [f"{1e3 * x:.0f}" for x in (np.median(metres), np.percentile(metres, 95))]
    shares = [f"{100 * share:.1f}" for share in (np.mean(tracked), off.mean(), unsaid)]
    return [who, str(len(degrees)), shares[0], *spread, *shares[1:]]


def print_twist(seed: int, begin: int) -> None:
    """Print the table of people whose chest turns against the pelvis."""
    import tables

    twists = (20.0,) if begin else (0.0, 10.0, 20.0, 30.0)
    cases = itertools.product(("leg", "arm"), (False, True), twists)
    head = ["simulated, twisted", "frames", "tracking, %", "plane, degrees", "95 %", "end, mm"]
    head += ["95 %", "over 5 degrees, %", "of tracking"]
    print(tables.table(head, [twist_row(*case, seed, begin) for case in cases]))


STOUT_MOTIONS: dict[Limb, tuple[str, ...]] = {
    "left_arm": ("arm-raise", "reach", "arm-curl"),
    "right_leg": ("stepping", "knee-extension", "dorsiflexion"),
}


def stout_row(girth: float, limb: Limb, frames: int = 40) -> tuple[str, ...]:
    """Return the states of the phantom on people of a girth."""
    from manip3d.modify import PhantomPipeline
    from manip3d.simulate import BodySimulator

    states: Counter[str] = Counter()
    seeds = ((6, 0.0), (7, 0.02))
    for motion, (seed, jitter) in itertools.product(STOUT_MOTIONS[limb], seeds):
        pipeline = PhantomPipeline(limb)
        people = BodySimulator(
            motion=motion, amputated=limb, girth=girth, color="none", frames=frames, rate=10.0,
            seed=seed, jitter=jitter, threads=1,
        )  # fmt: skip
        for frame in people:
            result = pipeline.process(frame)
            states[result.state.value] += 1
            states[result.reason.value] += 1
    total = len(STOUT_MOTIONS[limb]) * len(seeds) * frames
    counted = ("tracking", "degraded", "doubled", "detached", "cut", "calibration", "lost")
    return (
        limb,
        f"{girth:g}",
        str(total),
        *(f"{100 * states[name] / total:.1f}" for name in counted),
    )


def print_stout() -> None:
    """Print the table of stout people."""
    import tables

    head = ["simulated; % of the frames", "girth", "frames", "tracking", "degraded", "doubled",
            "detached", "cut", "calibration", "lost"]  # fmt: skip
    girths = (0.8, 1.0, 1.2, 1.3, 1.4, 1.5, 1.6, 1.8)
    print(tables.table(head, [stout_row(g, limb) for limb in STOUT_MOTIONS for g in girths]))


CALIBRATION_CASES: tuple[tuple[Limb, dict[str, Any]], ...] = (
    ("right_arm", {"motion": "reach"}),
    ("left_arm", {"motion": "arm-raise", "tracker": "kinect-v1"}),
    ("left_leg", {"motion": "stepping", "tracker": "kinect-v2"}),
    ("right_arm", {"motion": "reach", "sitting": True, "tracker": "kinect-v2"}),
    ("right_leg", {"motion": "knee-extension", "sitting": True}),
)


def calibration_rows(limb: Limb, body: dict[str, Any]) -> list[list[str]]:
    """Return the states of the phantom by focal length factor, for two seconds of one person."""
    from manip3d.modify import PhantomPipeline
    from manip3d.rgbd import RgbdCalibration
    from manip3d.simulate import BodySimulator

    frames = list(BodySimulator(amputated=limb, color="none", frames=60, seed=5, **body))
    camera = frames[0].calibration.depth
    rows = []
    for factor in (0.7, 0.85, 0.9, 0.93, 0.95, 0.97, 1.0, 1.03, 1.05, 1.07, 1.1, 1.15, 1.3):
        pipeline = PhantomPipeline(limb)
        told = RgbdCalibration(replace(camera, fx=factor * camera.fx, fy=factor * camera.fy))
        results = [pipeline.process(replace(frame, calibration=told)) for frame in frames]
        tracked = [result.state.value == "tracking" for result in results]
        named = [result.reason.value == "calibration" for result in results]
        shares = (np.mean(tracked), np.mean(tracked[30:]), np.mean(named))
        who = f"{limb}, {', '.join('seated' if v is True else str(v) for v in body.values())}"
        said = f"{results[-1].quality.stature:.3f}"
        rows.append([who, f"{factor:g}", *(f"{100 * share:.0f}" for share in shares), said])
    return rows


def print_calibration() -> None:
    """Print the table of wrong focal lengths."""
    import tables

    head = ["simulated; % of the frames", "factor", "tracking", "after 1 s", "calibration"]
    rows = [row for case in CALIBRATION_CASES for row in calibration_rows(*case)]
    print(tables.table([*head, "stature"], rows))


def without_index(frame: RgbdFrame) -> RgbdFrame:
    """Return the frame without body index."""
    from manip3d.rgbd import NO_BODY

    people = tuple(replace(person, body=NO_BODY) for person in frame.skeletons)
    return replace(frame, body_index=None, skeletons=people)


def in_a_room(frames: list[RgbdFrame]) -> list[RgbdFrame]:
    """Add a floor and a wall to recordings of people whose background was removed."""
    camera = frames[0].calibration.depth
    points = np.concatenate([camera.unproject(f.depth)[f.body_index == 0] for f in frames[::10]])
    rays = camera.unproject(np.ones(frames[0].depth.shape, np.float32))
    with np.errstate(divide="ignore"):
        floor = np.where(rays[..., 1] > 1e-3, np.percentile(points[:, 1], 99.7) / rays[..., 1], 99)
    behind = 1000.0 * np.minimum(floor, np.percentile(points[:, 2], 99.5) + 0.10)
    step = behind**2 / (285.63 * 75.0) / 8.0  # an eighth of a pixel of disparity
    noise = np.random.default_rng(0)
    rooms = []
    for frame in frames:
        room = np.rint((behind + noise.normal(0.0, 3.0, behind.shape)) / step) * step
        depth = np.where(frame.depth > 0, frame.depth, room).astype(np.uint16)
        rooms.append(replace(frame, depth=depth))
    return rooms


def unindexed_row(who: str, cases: list[tuple[list[RgbdFrame], Limb]]) -> list[str]:
    """Return percentages of tracked frames with and without body index, and the overlap."""
    from manip3d.modify import PhantomPipeline, PixelKind

    tracked: list[tuple[bool, bool]] = []
    overlaps: list[float] = []
    for frames, limb in cases:
        pipelines = PhantomPipeline(limb), PhantomPipeline(limb)
        for number, frame in enumerate(frames):
            given = frame, without_index(frame)
            results = [p.process(f) for p, f in zip(pipelines, given, strict=True)]
            if number < 4:
                continue
            tracked.append(tuple(r.state.value == "tracking" for r in results))  # type: ignore[arg-type]
            a, b = (result.kinds != PixelKind.NONE for result in results)
            overlaps.append(float((a & b).sum()) / max(1, int((a | b).sum())))
    shares = [f"{100 * share:.1f}" for share in np.mean(tracked, axis=0)]
    overlap = [f"{value:.3f}" for value in (np.mean(overlaps), np.percentile(overlaps, 5))]
    return [who, str(len(overlaps)), *shares, *overlap]


def print_unindexed(half: str) -> None:
    """Print the table of people without a body index."""
    import tables
    from manip3d import datasets
    from manip3d.simulate import BodySimulator

    rows = []
    for kind, sitting in itertools.product(("arm", "leg"), (False, True)):
        motion = "reach" if kind == "arm" else "knee-extension" if sitting else "stepping"
        cases: list[tuple[list[RgbdFrame], Limb]] = []
        for side, (scene, turn) in itertools.product(
            ("left", "right"), (("room", 0.0), ("office", 15.0))
        ):
            limb: Limb = f"{side}_{kind}"  # type: ignore[assignment]
            people = BodySimulator(
                motion=motion, amputated=limb, sitting=sitting, turn=turn, scene=scene,
                tracker="kinect-v2", color="none", seed=5, frames=24, rate=15.0,
            )  # fmt: skip
            cases.append((list(people), limb))
        rows.append(
            unindexed_row(f"simulated, {kind}, {'seated' if sitting else 'standing'}", cases)
        )
    trials = [
        in_a_room(list(datasets.open_people(uri)))
        for uri in datasets.people_uris()
        if uri.startswith("utd") and is_tuning(uri) == (half == "tuning")
        and numbers(uri)[0] in (3, 24, 25, 27)
    ]  # fmt: skip
    for name in LIMBS:
        rows.append(unindexed_row(f"recorded, {name}", [(frames, name) for frames in trials]))  # type: ignore[misc]
    head = ["% of the frames", "frames", "tracking, index", "tracking, none", "overlap", "5 %"]
    print(tables.table(head, rows))


def turned_trunks(frames: list[RgbdFrame], degrees: float) -> list[RgbdFrame]:
    """Return frames whose joints of shoulders and hips are turned about the spine."""
    girdles = [4, 8, 12, 16]
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    told = []
    for frame in frames:
        person = frame.skeletons[0]
        positions = person.positions.copy()
        spine = positions[[0, 20]].mean(axis=0)
        off = positions[girdles] - spine
        positions[girdles, 0] = spine[0] + c * off[:, 0] - s * off[:, 2]
        positions[girdles, 2] = spine[2] + s * off[:, 0] + c * off[:, 2]
        told.append(replace(frame, skeletons=(replace(person, positions=positions),)))
    return told


def with_jitter(frames: list[RgbdFrame], metres: float, seed: int) -> list[RgbdFrame]:
    """Return frames with AR(1) jitter on the joints."""
    rho = 0.9
    noise = np.random.default_rng(seed)
    error = noise.normal(size=(25, 3))
    told = []
    for frame in frames:
        error = rho * error + np.sqrt(1.0 - rho * rho) * noise.normal(size=(25, 3))
        person = frame.skeletons[0]
        off = metres * error * (person.states != 0)[:, None]
        positions = (person.positions + off).astype(np.float32)
        told.append(replace(frame, skeletons=(replace(person, positions=positions),)))
    return told


def disturbed_row(name: str, cases: list[tuple[list[RgbdFrame], list[RgbdFrame]]]) -> list[str]:
    """Return percentages of the seated frames of recorded people with disturbed joints."""
    from manip3d.modify import PhantomPipeline

    lost: list[float] = []
    tracked: list[bool] = []
    for (frames, told), limb in itertools.product(cases, LIMBS[2:]):
        pipeline = PhantomPipeline(limb)
        for number, (frame, given) in enumerate(zip(frames, told, strict=True)):
            result = pipeline.process(given)
            if number % 2 or not is_seated(frame):
                continue
            lost.append(lost_below_hips(frame, result))
            tracked.append(result.state.value == "tracking")
    cut = np.array(lost) > 0.15
    unsaid = (cut & tracked).sum() / max(1, sum(tracked))
    shares = (np.mean(tracked), cut.mean(), unsaid, np.percentile(lost, 95))
    return [name, str(len(lost)), *(f"{100 * share:.1f}" for share in shares)]


def print_disturbed() -> None:
    """Print the table of recorded seated people with disturbed joints."""
    import tables
    from manip3d import datasets

    trials = [
        list(datasets.open_people(uri))
        for uri in datasets.people_uris()
        if uri.startswith("utd") and is_tuning(uri) and numbers(uri)[0] in SEATED
    ]
    told = {
        "as recorded": trials,
        "turned by 12 degrees": [turned_trunks(frames, 12.0) for frames in trials],
        "turned by -12 degrees": [turned_trunks(frames, -12.0) for frames in trials],
        "AR(1) 20 mm": [with_jitter(frames, 0.02, 1) for frames in trials],
        "AR(1) 30 mm": [with_jitter(frames, 0.03, 2) for frames in trials],
    }
    rows = [
        disturbed_row(name, list(zip(trials, given, strict=True))) for name, given in told.items()
    ]
    head = ["recorded legs, seated; % of the frames", "frames", "tracking", "cut", "tracking"]
    print(tables.table([*head, "lost, 95 %"], rows))


def with_sides_exchanged(frames: list[RgbdFrame], first: int, count: int) -> list[RgbdFrame]:
    """Return frames, some of which have the joints of left and right exchanged."""
    from manip3d.rgbd import MIRRORED_JOINTS

    told = list(frames)
    for number in range(first, min(first + count, len(frames))):
        person = frames[number].skeletons[0]
        exchanged = replace(
            person,
            positions=person.positions[list(MIRRORED_JOINTS)],
            states=person.states[list(MIRRORED_JOINTS)],
        )
        told[number] = replace(frames[number], skeletons=(exchanged,))
    return told


def with_principal_point_off(frames: list[RgbdFrame], pixels: float) -> list[RgbdFrame]:
    """Return frames whose calibration has the principal point too far to the right."""
    told = []
    for frame in frames:
        camera = frame.calibration.depth
        wrong = replace(frame.calibration, depth=replace(camera, cx=camera.cx + pixels))
        told.append(replace(frame, calibration=wrong))
    return told


def with_depth_times(frames: list[RgbdFrame], factor: float) -> list[RgbdFrame]:
    """Return frames with depth multiplied by a factor, as by a wrong unit."""
    return [replace(f, depth=np.rint(factor * f.depth).astype(np.uint16)) for f in frames]


def mistaken_row(name: str, trials: list[list[RgbdFrame]], every: int) -> list[str]:
    """Return percentages of frames of all limbs: tracked, and with the mistake as reason."""
    from manip3d.modify import PhantomPipeline

    counted: Counter[str] = Counter()
    frames = 0
    for told, limb in itertools.product(trials, LIMBS):
        pipeline = PhantomPipeline(limb)  # type: ignore[arg-type]
        for number, frame in enumerate(told):
            result = pipeline.process(frame)
            if number % every:
                continue
            frames += 1
            counted.update((result.state.value, result.reason.value))
    shares = (100 * counted[key] / frames for key in ("tracking", "calibration", "sides"))
    return [name, str(frames), *(f"{share:.1f}" for share in shares)]


def print_mistaken(half: str, every: int) -> None:
    """Print the table of recorded people with mistakes of a source."""
    import tables
    from manip3d import datasets

    trials = [
        list(datasets.open_people(uri))
        for uri in datasets.people_uris()
        if uri.startswith("utd") and is_tuning(uri) == (half == "tuning")
    ]
    told: dict[str, Callable[[list[RgbdFrame]], list[RgbdFrame]]] = {
        "as recorded": lambda fs: fs,
        "sides exchanged": lambda fs: with_sides_exchanged(fs, 0, len(fs)),
        "sides exchanged in 20 frames": lambda fs: with_sides_exchanged(fs, len(fs) // 3, 20),
        "principal point off by 8 pixels": lambda fs: with_principal_point_off(fs, 8.0),
        "principal point off by 20 pixels": lambda fs: with_principal_point_off(fs, 20.0),
        "depth times 1.1": lambda fs: with_depth_times(fs, 1.1),
    }
    rows = [
        mistaken_row(name, [mistake(frames) for frames in trials], every)
        for name, mistake in told.items()
    ]
    print(tables.table(["% of the frames", "frames", "tracking", "calibration", "sides"], rows))


@dataclass(frozen=True, eq=False)
class Shown:
    """A picture of the sheet."""

    score: float
    title: str
    picture: NDArray[np.uint8]


def options_of() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--half", choices=("tuning", "reporting"), default="reporting")
    parser.add_argument("--trials", default="", help="a pattern of names, such as a2[45]")
    parser.add_argument("--limbs", nargs="*", default=LIMBS, choices=LIMBS)
    parser.add_argument("--every", type=int, default=4, help="measure one frame of this many")
    parser.add_argument("--kept", action="store_true", help="nothing is removed: all are doubled")
    parser.add_argument("--sheet", help="write the worst frames to this picture")
    parser.add_argument("--sort", default="score", help="score, or a fault under tracking")
    parser.add_argument("--reason", help="only frames of the sheet with this reason")
    parser.add_argument("--simulated", action="store_true", help="simulated people alone")
    parser.add_argument("--sleeves", action="store_true", help="simulated empty sleeves alone")
    parser.add_argument("--flying", action="store_true", help="simulated joints that fly alone")
    parser.add_argument("--stout", action="store_true", help="simulated stout people alone")
    parser.add_argument("--twist", action="store_true", help="simulated twisted people alone")
    parser.add_argument("--from-start", action="store_true", help="twisted in the first frame")
    parser.add_argument("--seed", type=int, default=5, help="of simulated twisted people")
    parser.add_argument("--calibration", action="store_true", help="wrong focal lengths alone")
    parser.add_argument("--unindexed", action="store_true", help="no body index")
    parser.add_argument("--guessed", action="store_true", help="joints of the limb are guessed")
    parser.add_argument("--disturbed", action="store_true", help="recorded, with worse joints")
    parser.add_argument("--mistaken", action="store_true", help="recorded, from a wrong source")
    return parser.parse_args()


def main() -> None:
    """Print the table selected by the options; default: the recorded trials."""
    options = options_of()
    if options.mistaken:
        print_mistaken(options.half, options.every)
    elif options.disturbed:
        print_disturbed()
    elif options.sleeves:
        print_sleeves()
    elif options.flying:
        print_flying()
    elif options.stout:
        print_stout()
    elif options.twist:
        print_twist(options.seed, 30 if options.from_start else 0)
    elif options.calibration:
        print_calibration()
    elif options.unindexed:
        print_unindexed(options.half)
    elif options.simulated:
        print_simulated()
    else:
        print_recorded(options)


def print_recorded(options: argparse.Namespace) -> None:
    """Run the recorded trials, print their tables and, if asked for, draw a sheet of frames."""
    from manip3d import datasets
    from manip3d.modify import PhantomPipeline

    groups: dict[str, Tally] = {}
    pictures: list[Shown] = []
    for uri in datasets.people_uris():
        if not uri.startswith("utd") or is_tuning(uri) != (options.half == "tuning"):
            continue
        if not re.search(options.trials, uri):
            continue
        frames = list(datasets.open_people(uri))
        for limb in options.limbs:
            pipeline = PhantomPipeline(limb, keep_residual=options.kept)
            for number, frame in enumerate(frames):
                given = without_sight(frame, limb) if options.guessed else frame
                result = pipeline.process(given)
                if number % options.every:
                    continue
                measured = add_frame(groups, uri, frame, result, limb)
                score = score_of(result, measured, options)
                if options.sheet and score > 0.0:
                    title = f"{uri[9:]} {limb} {number}\n{result.reason.value} {score:.1f}"
                    pictures.append(Shown(score, title, pair_of(frame, result)))
    print_groups(groups)
    if options.sheet:
        draw(sorted(pictures, key=lambda p: -p.score)[:40], options.sheet)


def add_frame(
    groups: dict[str, Tally], uri: str, frame: RgbdFrame, result: PhantomFrame, limb: str
) -> dict[str, float]:
    """Add a frame to the tallies of its groups; return the measured shares."""
    bones = segmented(frame, frame.skeletons[0])
    rest = segmented(frame, without(frame.skeletons[0], limb))
    measured = shares(frame, result, limb, bones, rest)
    faults = {name for name, share in measured.items() if share > 1.0}
    names = ["all", limb]
    action, _ = numbers(uri)
    if action in SEATED:
        kind = "arms" if limb.endswith("arm") else "legs"
        names.append(f"a24, a25: {kind}")
        if is_seated(frame):
            names.append(f"of these seated: {kind}")
    loss = None
    if "cut" in faults and limb.endswith("leg"):
        loss = loss_below(frame, result, limb, bones)
    for name in names:
        tally = groups.setdefault(name, Tally())
        tally.add(result, faults)
        tally.losses += [loss] if loss else []
    return measured


def score_of(
    result: PhantomFrame, measured: dict[str, float], options: argparse.Namespace
) -> float:
    """Return the number by which the sheet is sorted; 0: the frame is not on it."""
    if options.reason and result.reason.value != options.reason:
        return 0.0
    if options.sort in FAULTS:
        return measured[options.sort] if result.state.value == "tracking" else 0.0
    return result.quality.score


def pair_of(frame: RgbdFrame, result: PhantomFrame) -> NDArray[np.uint8]:
    """Return the depth image and the kinds of pixels of the result, side by side."""
    from manip3d.experiments._phantom import box_of
    from manip3d.experiments.real_people_4 import _kinds
    from manip3d.viewer import people

    box = box_of(frame.depth > 0, 4)
    return np.hstack([people.depth_picture(frame.depth)[box], _kinds(result)[box]])


def print_groups(groups: dict[str, Tally]) -> None:
    """Print the tables of all groups of frames."""
    import tables

    head = ["% of the frames", "frames", "tracking", "degraded"]
    for fault in FAULTS:
        head += [fault, "tracking"]
    order = sorted(groups, key=lambda name: (name != "all", name not in LIMBS, name))
    print(tables.table([*head, "reasons"], [[name, *groups[name].row()] for name in order]))
    if any(groups[name].losses for name in order):
        head = ["cut, legs", "frames cut", "limb", "body", "background", "shown"]
        head += ["best plane", "turn", "cut by error"]
        order = [name for name in order if groups[name].losses]
        print(tables.table(head, [[name, *groups[name].loss_row()] for name in order]))


def draw(shown: list[Shown], path: str) -> None:
    """Draw a sheet of pairs of pictures: as measured, and with the phantom."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(20, 20), layout="constrained")
    for k, picture in enumerate(shown):
        axes = figure.add_subplot(5, 8, k + 1)
        axes.imshow(picture.picture, interpolation="nearest")
        axes.set(xticks=[], yticks=[])
        axes.set_title(picture.title, fontsize=8)
    figure.savefig(path, dpi=70)


if __name__ == "__main__":
    main()
