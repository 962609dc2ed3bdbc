"""Edits of every kind against the printed watermark, the keyed watermark and a keyed hash."""

from __future__ import annotations

import hmac
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate import KeyFile
    from manip3d.lidar import LidarFrame

    Points = NDArray[np.float32]
    Sent = tuple["LidarFrame", Any]
    """A scan as it was sent, and the metadata, record or tag sent with it."""

DEFENCES = ("paper lbm", "paper qim", "keyed lbm", "keyed qim", "keyed detached", "hmac")

_POINTS = 1800
_ATTEMPTS = {"quick": 20, "full": 900}
"""Attempts of each kind against each defence: 20 kinds x 900 attempts x 6 defences are about 10^5.
"""


# --- Defences -------------------------------------------------------------------------------------


class _Paper:
    """The printed watermark, whose bits do not depend on the points; metadata are sent safely."""

    def __init__(self, embedding: str) -> None:
        from manip3d.authenticate import noise_blocks

        self._embedding = {"qim": "qim-printed"}.get(embedding, embedding)
        self._blocks = noise_blocks(1, block_bits=40)

    def send(self, frames: Sequence[LidarFrame]) -> list[Sent]:
        from manip3d.authenticate import embed_paper

        marked = [
            embed_paper(frame, self._blocks, embedding=self._embedding, key_2=99, frame=number)
            for number, frame in enumerate(frames)
        ]
        return [(each.frame, each.metadata) for each in marked]

    def accepts(self, received: Sequence[Sent]) -> bool:
        from manip3d.authenticate import compare_paper

        return all(
            compare_paper(scan, self._blocks, metadata).verdict == "consistent"
            for scan, metadata in received
        )

    def suspects(self, received: Sequence[Sent]) -> NDArray[np.integer[Any]]:
        """Return the points of the last scan that the verifier lists."""
        from manip3d.authenticate import compare_paper

        scan, metadata = received[-1]
        return compare_paper(scan, self._blocks, metadata).suspected


class _Keyed:
    """`Watermarker`, whose bits and tags depend on the points and whose frames form a chain."""

    def __init__(self, embedding: str, key: KeyFile) -> None:
        self._embedding, self._key = embedding, key

    def send(self, frames: Sequence[LidarFrame]) -> list[Sent]:
        from manip3d.authenticate import Watermarker

        with Watermarker(self._key, embedding=self._embedding, least_points=40) as marker:
            sent = [
                marker.embed(frame, time_ns=number, is_end=number + 1 == len(frames))
                for number, frame in enumerate(frames)
            ]
        return [(each.frame, each.record) for each in sent]

    def accepts(self, received: Sequence[Sent]) -> bool:
        from manip3d.authenticate import Watermarker

        with Watermarker(self._key) as verifier:
            return all(
                verifier.verify(scan, record).verdict == "authentic" for scan, record in received
            )

    def suspects(self, received: Sequence[Sent]) -> NDArray[np.integer[Any]]:
        """Return the points of the last scan that the operator's report lists."""
        from manip3d.authenticate import Watermarker

        with Watermarker(self._key) as verifier:
            return [verifier.verify(scan, record) for scan, record in received][-1].suspected


class _Hmac:
    """HMAC-SHA256 of the buffer of points and intensities, the obvious baseline."""

    def __init__(self, key: bytes = bytes(range(32))) -> None:
        self._key = key

    def _tag(self, scan: LidarFrame) -> bytes:
        assert scan.intensity is not None
        return hmac.digest(
            self._key, np.column_stack([scan.points, scan.intensity]).tobytes(), "sha256"
        )

    def send(self, frames: Sequence[LidarFrame]) -> list[Sent]:
        return [(frame, self._tag(frame)) for frame in frames]

    def accepts(self, received: Sequence[Sent]) -> bool:
        return all(
            isinstance(tag, bytes) and hmac.compare_digest(self._tag(scan), tag)
            for scan, tag in received
        )

    def suspects(self, received: Sequence[Sent]) -> NDArray[np.integer[Any]]:
        """Return no points, because a hash does not locate changes."""
        return np.empty(0, np.int64)


# --- What an attacker without the key does to three frames ----------------------------------------


def _changed(sent: Sequence[Sent], points: NDArray[Any]) -> list[Sent]:
    """Return the stream with other points in its last frame."""
    scan, beside = sent[-1]
    wide = np.asarray(points, np.float64)
    return [*sent[:-1], (scan.replace(points=wide.astype(np.float32)), beside)]


def _same_points(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    """Permute the points of the last scan, which is no attack."""
    scan, beside = sent[-1]
    return [*sent[:-1], (scan.select(random.permutation(scan.num_points)), beside)]


def _move_one(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    points = sent[-1][0].points.astype(np.float64)
    points[random.integers(len(points))] += random.uniform(-1.0, 1.0, 3)
    return _changed(sent, points)


def _least_move(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    """Change one coordinate of a point to the next larger float32."""
    points = sent[-1][0].points.copy()
    row, axis = random.integers(len(points)), random.integers(3)
    points[row, axis] = np.nextafter(points[row, axis], np.float32(1e6))
    return _changed(sent, points)


def _move_object(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    points = sent[-1][0].points.astype(np.float64)
    near = np.linalg.norm(points - points[random.integers(len(points))], axis=1) < 4.0
    points[near] = np.round(points[near] + random.uniform(-3.0, 3.0, 3), 3)
    return _changed(sent, points)


def _delete(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    scan, beside = sent[-1]
    gone = random.choice(scan.num_points, int(random.integers(1, 50)), replace=False)
    kept = np.delete(np.arange(scan.num_points), gone)
    return [*sent[:-1], (scan.select(kept), beside)]


def _add(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    """Add points of another frame."""
    scan, beside = sent[-1]
    other = sent[0][0].select(random.choice(sent[0][0].num_points, 30, replace=False))
    return [*sent[:-1], (_joined(scan, other), beside)]


def _stuff(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    """Replace points by copies of one point."""
    scan, beside = sent[-1]
    rows = np.arange(scan.num_points)
    some = random.choice(scan.num_points, 6, replace=False)
    rows[some[1:]] = some[0]
    return [*sent[:-1], (scan.select(rows), beside)]


def _intensity(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    scan, beside = sent[-1]
    assert scan.intensity is not None
    values = scan.intensity.copy()
    values[random.integers(len(values))] += np.float32(0.01)
    return [*sent[:-1], (scan.replace(intensity=values), beside)]


def _flip_bit(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    units = _units(sent[-1][0].points)
    units[random.integers(len(units)), random.integers(3)] ^= 1
    return _changed(sent, units / 1000)


def _collage(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    """Replace half of the last scan by that of the first, cut at borders of azimuth sectors."""
    scan, beside = sent[-1]
    begin = 10.0 * random.integers(36)
    here, there = (_sector(s.points, begin, 180.0) for s in (scan, sent[0][0]))
    joined = _joined(scan.select(~here), sent[0][0].select(there))
    return [*sent[:-1], (joined, beside)]


def _swap_records(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    return [*sent[:-1], (sent[-1][0], sent[int(random.integers(len(sent) - 1))][1])]


def _replay(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    return [*sent, sent[int(random.integers(len(sent)))]]


def _drop(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    return [sent[0], *sent[int(random.integers(2, len(sent))) :]]


def _reorder(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    first = int(random.integers(len(sent) - 1))
    swapped = list(sent)
    swapped[first], swapped[first + 1] = swapped[first + 1], swapped[first]
    return swapped


def _begin_late(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    """Withhold the beginning of the stream, as after a rollback of the verifier."""
    return list(sent[int(random.integers(1, len(sent))) :])


def _damage_record(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    """Flip a bit of the record, truncate it, replace it by noise, or append bytes."""
    scan, beside = sent[-1]
    if not isinstance(beside, bytes):
        return []
    what, record = int(random.integers(4)), bytearray(beside)
    if what == 0:
        place = int(random.integers(8 * len(record)))
        record[place // 8] ^= 1 << place % 8
    elif what == 1:
        del record[int(random.integers(len(record))) :]
    elif what == 2:
        record = bytearray(random.bytes(len(record)))
    else:
        record += bytes(int(random.integers(1, 100)))
    return [*sent[:-1], (scan, bytes(record))]


def _downgrade(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    """Rewrite suite, embedding, carrier or flags of the record, and move a point."""
    _, beside = sent[-1]
    if not isinstance(beside, bytes) or len(beside) < 100:
        return []
    record = bytearray(beside)
    record[8 + int(random.integers(4))] = int(random.integers(8))
    moved = _move_one(sent, random)[-1][0]
    return [*sent[:-1], (moved, bytes(record))]


def _rewrite_bits(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    """Move the points of a sector along their rays and restore the embedded bits without a key.

    The lowest bits are read by rank before the movement and written back by rank after it.
    """
    scan, _ = sent[-1]
    units = _units(scan.points)
    cleared, bits = units & ~1, units & 1
    slices = _slices(cleared)
    read = bits[_rank(cleared, slices)]
    forged = cleared.copy()
    begin = 10.0 * random.integers(36)
    moved = _sector(scan.points, begin + 1.0, 8.0)
    forged[moved] = np.rint(cleared[moved] * random.uniform(1.2, 1.8)).astype(np.int64) & ~1
    stay = _slices(forged) == slices  # points that would leave their sector are not moved
    forged[~stay] = cleared[~stay]
    written = forged.copy()
    written[_rank(forged, slices)] |= read
    return _changed(sent, written / 1000)


def _foreign_key(sent: Sequence[Sent], random: np.random.Generator) -> list[Sent]:
    """Move a point of the last frame and sign all frames again with the attacker's key."""
    from manip3d.authenticate import EMBEDDINGS, KeyFile

    beside = sent[-1][1]
    if not isinstance(beside, bytes):
        return []  # nothing is signed
    forged = [scan for scan, _ in _move_one(sent, random)]
    if len(beside) < 100:
        return _Hmac(random.bytes(32)).send(forged)
    with (
        tempfile.TemporaryDirectory() as folder,
        KeyFile.create(Path(folder) / "attacker.key") as key,
    ):
        return _Keyed(EMBEDDINGS[beside[_EMBEDDING]], key).send(_on_grid(forged))


_EMBEDDING = 9
"""Index of the byte of a record that names the embedding."""


def _on_grid(frames: Sequence[LidarFrame]) -> list[LidarFrame]:
    """Round points to whole millimetres, as the embedder expects them."""
    return [
        frame.replace(points=(_units(frame.points) / 1000).astype(np.float32)) for frame in frames
    ]


def _mended(received: Sequence[Sent], guard: _Paper | _Keyed | _Hmac) -> list[Sent]:
    """Ask the verifier once and flip the lowest bits of the points that it suspects."""
    units = _units(received[-1][0].points)
    units[guard.suspects(received)] ^= 1
    return _changed(received, units / 1000)


ATTACKS: Mapping[str, Callable[[Sequence[Any], np.random.Generator], list[Any]]] = {
    "none: points in another order": _same_points,
    "one point moved": _move_one,
    "one coordinate by the least amount": _least_move,
    "an object moved": _move_object,
    "points deleted": _delete,
    "points of another frame added": _add,
    "points replaced by copies of one": _stuff,
    "one intensity": _intensity,
    "one carrier bit": _flip_bit,
    "collage of two frames": _collage,
    "records swapped": _swap_records,
    "record damaged": _damage_record,
    "record downgraded": _downgrade,
    "frame replayed": _replay,
    "frame dropped": _drop,
    "frames reordered": _reorder,
    "beginning withheld": _begin_late,
    "re-embedding without the key": _rewrite_bits,
    "signed with another key": _foreign_key,
    "one point moved, and the verifier asked": _move_one,
}
"""Attacks by name: functions from the sent stream of frames and records to the received stream."""

HARMLESS = "none: points in another order"
REEMBEDDING = "re-embedding without the key"
ORACLE = "one point moved, and the verifier asked"
"""Attack in which the verifier's report is used to repair the forgery; the repaired one counts."""


def _joined(scan: LidarFrame, other: LidarFrame) -> LidarFrame:
    from manip3d.lidar import LidarFrame

    assert scan.intensity is not None
    assert other.intensity is not None
    return LidarFrame(
        np.concatenate([scan.points, other.points]),
        np.concatenate([scan.intensity, other.intensity]),
    )


def _units(points: Points) -> NDArray[np.int64]:
    return np.rint(points.astype(np.float64) * 1000).astype(np.int64)


def _angle(points: NDArray[Any]) -> NDArray[np.float64]:
    degrees: NDArray[np.float64] = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360.0
    return degrees


def _sector(points: Points, begin: float, width: float) -> NDArray[np.bool_]:
    inside: NDArray[np.bool_] = (_angle(points) - begin) % 360.0 < width
    return inside


def _slices(cleared: NDArray[np.int64]) -> NDArray[np.int64]:
    return (_angle(cleared) // 10).astype(np.int64)


def _rank(cleared: NDArray[np.int64], slices: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the order of points that is public, because it depends on no key."""
    x, y, z = cleared.T
    return np.lexsort((y, x, x * x + y * y, z, slices))


def _frame(random: np.random.Generator) -> LidarFrame:
    """Make a scan of ground and walls in whole, even millimetres.

    All points are different, and none lies on a border of azimuth sectors.
    """
    from manip3d.lidar import LidarFrame

    angle = np.radians(random.integers(0, 36, _POINTS) * 10.0 + random.uniform(0.5, 9.5, _POINTS))
    reach = random.uniform(4.0, 30.0, _POINTS)
    height = np.where(random.random(_POINTS) < 0.6, -1.7, random.uniform(-1.7, 2.0, _POINTS))
    cloud = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), height])
    units = np.rint(cloud * 500.0).astype(np.int64) * 2
    _, first = np.unique(units, axis=0, return_index=True)
    intensity = random.integers(0, 100, len(first)) / 100.0
    return LidarFrame(
        (units[np.sort(first)] / 1000).astype(np.float32), intensity.astype(np.float32)
    )


# --- The experiment -------------------------------------------------------------------------------


def _cases(plan: Plan) -> list[Case]:
    attempts = _ATTEMPTS[plan.scale]
    return [
        Case(attack, {"model": name, "attempts": attempts, "seed": plan.seed + 1000 * number})
        for number, name in enumerate(ATTACKS)
    ]


def attack(case: Case) -> Row:
    """Count the accepted streams of each defence after an attack."""
    options = case.options
    random = np.random.default_rng(options["seed"])
    with tempfile.TemporaryDirectory() as folder:
        return count_accepted(options["model"], options["attempts"], random, Path(folder))


def count_accepted(
    name: str, attempts: int, random: np.random.Generator, folder: Path
) -> dict[str, Any]:
    """Count the accepted streams of ``attempts`` by defence; None: the attack does not apply."""
    from manip3d.authenticate import KeyFile

    with KeyFile.create(folder / "experiment.key") as key:
        defences: dict[str, _Paper | _Keyed | _Hmac] = {
            "paper lbm": _Paper("lbm"),
            "paper qim": _Paper("qim"),
            "keyed lbm": _Keyed("lbm", key),
            "keyed qim": _Keyed("qim", key),
            "keyed detached": _Keyed("detached", key),
            "hmac": _Hmac(),
        }
        counts: dict[str, Any] = {}
        for defence, guard in defences.items():
            accepted = tried = 0
            sent: list[Sent] = []
            for number in range(attempts):
                if number % 20 == 0:
                    sent = guard.send([_frame(random) for _ in range(3)])
                    if not guard.accepts(sent):
                        raise AssertionError(f"{defence} refuses what nobody changed")
                received = ATTACKS[name](sent, random)
                if name == ORACLE:
                    received = _mended(received, guard)
                if not received or _is_same(received, sent):
                    continue
                tried += 1
                accepted += guard.accepts(received)
            counts[defence] = accepted if tried else None
            counts[f"{defence} tried"] = tried
    return counts


def _is_same(received: Sequence[Sent], sent: Sequence[Sent]) -> bool:
    """Return whether the attack changed nothing, for instance rewrote a byte with its own value."""
    return len(received) == len(sent) and all(
        np.array_equal(a.points, b.points)
        and np.array_equal(a.intensity, b.intensity)  # type: ignore[arg-type]
        and record is other
        for (a, record), (b, other) in zip(received, sent, strict=True)
    )


_HOLDS: Mapping[str, Callable[[int, int], bool]] = {
    "all": lambda count, tried: count == tried,
    "most": lambda count, tried: 2 * count > tried,
    "none": lambda count, tried: count == 0,
}


def _judge(
    wanted: Callable[[str, str], str | None],
) -> Callable[[Sequence[Row]], Iterator[Finding]]:
    """Return a judge of whether all, most or no streams of a defence are accepted, as wanted."""

    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for row in rows:
            for defence in DEFENCES:
                share, tried = wanted(row["model"], defence), row.get(f"{defence} tried")
                if share is None or not tried:
                    continue
                count = row[defence]
                yield Finding(
                    f"{row['model']}, {defence}",
                    _HOLDS[share](count, tried),
                    f"{count} of {tried} accepted",
                )

    return judge


def _keyed_accepts(name: str, defence: str) -> str | None:
    if not defence.startswith("keyed"):
        return None
    return "all" if name == HARMLESS else "none"


def _paper_accepts(name: str, defence: str) -> str | None:
    return "most" if (name, defence) == (REEMBEDDING, "paper lbm") else None


def _hash_accepts(name: str, defence: str) -> str | None:
    return "none" if (name, defence) == (HARMLESS, "hmac") else None


EXPERIMENT = Experiment(
    id="security",
    title="Forged streams that are accepted",
    published="",
    data=(),
    cases=_cases,
    role=f"simulated frames of {_POINTS} points in whole millimetres, three to a stream",
    columns=tuple(
        Column(defence, defence.replace("hmac", "HMAC of the buffer")) for defence in DEFENCES
    ),
    claims=(
        Claim(
            "The keyed watermark accepts no forgery, and the same points in any order",
            "aim",
            _judge(_keyed_accepts),
        ),
        Claim(
            "The printed watermark accepts most scans that were re-embedded without a key",
            "chapter 7, read critically",
            _judge(_paper_accepts),
        ),
        Claim(
            "A keyed hash of the buffer refuses the same points in another order",
            "baseline",
            _judge(_hash_accepts),
        ),
    ),
    notes=(
        "Columns are streams of three frames that the verifier accepts as a whole. The attacker "
        "knows everything but the key, and cannot touch the channel of the printed watermark's "
        "metadata, so that attacks on records do not apply to it. The hash is bound to a frame "
        "alone and to the order of its points; a deployment that needs neither localisation nor "
        "another order can number its frames itself. A verifier that begins in the middle of a "
        "session says so, instead of accepting it. Re-embedding without the key fails where "
        "points that were moved tie with others in the public order; the forger can see that, and "
        "move them elsewhere.",
    ),
)
