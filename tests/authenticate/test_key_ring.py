"""Keys that replace each other: what older ones still verify, and what whoever stole one cannot."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from manip3d import LidarFrame, _core
from manip3d.authenticate import (
    KeyFile,
    KeyRing,
    Policy,
    Watermarked,
    Watermarker,
    WatermarkResult,
)
from manip3d.errors import Error, FormatError, InputError
from watermark_scans import grid_scan, reflectances

SECOND = 10**9
REFUSED = "the record states a time after its key had expired or had been replaced"
REPLACED = "the frame was signed with a key that the stream had replaced"


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each key is made 100 s after the one before, the first one at 1000 s."""
    times = itertools.count(1000 * SECOND, 100 * SECOND)
    create = KeyFile.create.__func__  # type: ignore[attr-defined]

    def create_then(cls: type[KeyFile], path: Path, **options: int) -> KeyFile:
        with monkeypatch.context() as patch:
            now = next(times)
            patch.setattr("time.time_ns", lambda: now)
            made: KeyFile = create(cls, path, **options)
            return made

    monkeypatch.setattr(KeyFile, "create", classmethod(create_then))


@pytest.fixture
def keys(clock: None, tmp_path: Path) -> Iterator[list[KeyFile]]:
    """Three, the oldest first, made at 1000 s, 1100 s and 1200 s."""
    made = [KeyFile.create(tmp_path / f"{name}.key") for name in "cab"]
    yield made
    for key in made:
        key.close()


def signed(
    key: KeyFile, count: int = 1, *, time_s: float = 1050.0, is_end: bool = False
) -> list[Watermarked]:
    """The frames of a session."""
    sender = Watermarker(key)
    return [
        sender.embed(
            LidarFrame(grid_scan(2000, n), reflectances(2000, n)),
            time_ns=round(time_s * SECOND),
            is_end=is_end and n + 1 == count,
        )
        for n in range(count)
    ]


def heard(verifier: Watermarker, sent: Watermarked, order: str = "chain") -> WatermarkResult:
    return verifier.verify(sent.frame, sent.record, policy=Policy(order=order))


def test_each_key_verifies_what_it_signed_before_the_next_one_was_made(keys: list[KeyFile]) -> None:
    for number, key in enumerate(keys):
        replaced_s = 1100.0 + 100.0 * number
        for time_s in (0.5, replaced_s - 1e-6, replaced_s, replaced_s + 1e6):
            (sent,) = signed(key, time_s=time_s)
            found = heard(Watermarker(KeyRing(keys)), sent)
            holds = time_s < replaced_s or key is keys[-1]
            assert found.verdict == ("authentic" if holds else "undecidable"), (number, time_s)
            assert found.key_id == (key.key_id if holds else "")
            assert holds or found.reason == REFUSED
            assert found.record()["key_id"] == found.key_id


def test_the_newest_key_embeds_and_a_verifier_without_the_ring_knows_it(
    keys: list[KeyFile],
) -> None:
    ring = KeyRing([keys[1], keys[2], keys[0]])
    assert [key.key_id for key in ring.keys] == [key.key_id for key in keys[::-1]]
    (sent,) = signed(ring.newest)
    made = Watermarker(ring).embed(sent.frame, time_ns=5)
    assert heard(Watermarker(keys[2]), made).verdict == "authentic"
    assert heard(Watermarker(keys[0]), made).verdict == "undecidable"


def test_a_stream_goes_on_with_the_next_key_and_never_back(keys: list[KeyFile]) -> None:
    """The downgrade: who stole the old key signs with a time at which it was in use."""
    verifier = Watermarker(KeyRing(keys[:2]))
    old, new = signed(keys[0], 2, is_end=True), signed(keys[1], 2, time_s=1150.0)
    assert [heard(verifier, each).verdict for each in (*old, new[0])] == ["authentic"] * 3
    (forged,) = signed(keys[0])
    for sent in (forged, old[0], old[1]):
        found = heard(verifier, sent, "any")
        assert (found.verdict, found.order) == ("tampered", "replay")
    assert heard(verifier, forged).reason == REPLACED
    assert heard(verifier, new[1]).order == "in order"  # the forgery did not break the chain


def test_an_old_key_cannot_go_on_with_the_session_of_a_newer_one(keys: list[KeyFile]) -> None:
    """Session, number and tag of the frame before stand in the record for everybody to read."""
    verifier = Watermarker(KeyRing(keys[:2]))
    genuine = signed(keys[1], 1, time_s=1090.0)[0]
    assert heard(verifier, genuine).verdict == "authentic"
    session = bytes.fromhex(heard(Watermarker(keys[1]), genuine).session)
    forger = _core.WatermarkEmbedder(
        keys[0]._key, bytes(16), session, 1, 36, 1000, paper_merge=False, round=False
    )
    frame = genuine.frame
    for number in range(2):
        points, record, *_ = forger.embed(
            frame.points, frame.intensity, 1050 * SECOND, 0, False, None
        )
        found = verifier.verify(frame.replace(points=points), record, policy=Policy(order="any"))
        assert (found.verdict, found.order, found.number) == ("tampered", "replay", number)
        assert found.reason == REPLACED


def test_the_state_file_remembers_that_a_newer_key_was_seen(
    keys: list[KeyFile], tmp_path: Path
) -> None:
    state = tmp_path / "seen"
    old, new = signed(keys[0], 3), signed(keys[1], 2, time_s=1150.0)
    with Watermarker(keys[0], state=state) as verifier:
        assert heard(verifier, old[0]).verdict == "authentic"
    for sent, verdict, order in (  # a ring goes on with the file of the old key alone
        (old[0], "tampered", "replay"),
        (old[1], "authentic", "in order"),
        (new[0], "undecidable", "gap"),  # the old session had not ended
        (old[2], "tampered", "replay"),
        (signed(keys[0])[0], "tampered", "replay"),
        (new[1], "authentic", "in order"),
    ):
        with Watermarker(KeyRing(keys), state=state) as verifier:
            found = heard(verifier, sent)
            assert (found.verdict, found.order) == (verdict, order)
    with Watermarker(keys[1], state=state) as verifier:  # it is of the key of its last frame
        assert heard(verifier, new[1]).order == "replay"
    with pytest.raises(FormatError, match="another key"):
        Watermarker(keys[2], state=state)


def test_what_was_forgotten_is_of_any_key(keys: list[KeyFile]) -> None:
    verifier = Watermarker(KeyRing(keys))
    assert heard(verifier, signed(keys[2])[0]).verdict == "authentic"
    verifier.reset()
    assert heard(verifier, signed(keys[0])[0]).verdict == "authentic"


def test_a_key_verifies_nothing_from_after_it_expired(clock: None, tmp_path: Path) -> None:
    day_s = 4_000_000_000  # it is not over while this test is of use
    with KeyFile.create(tmp_path / "a.key", expires_ns=day_s * SECOND) as key:
        for time_s, verdict in ((day_s - 1, "authentic"), (day_s, "undecidable")):
            (sent,) = signed(key, time_s=time_s)
            assert heard(Watermarker(key), sent).verdict == verdict
            assert heard(Watermarker(KeyRing([key])), sent).verdict == verdict


def test_a_record_of_no_key_of_the_ring_is_undecidable(keys: list[KeyFile]) -> None:
    (sent,) = signed(keys[0])
    verifier = Watermarker(KeyRing(keys[1:]))
    found = heard(verifier, sent)
    assert found.verdict == "undecidable"
    assert "another key" in found.reason
    damaged = bytearray(signed(keys[1])[0].record)
    damaged[60] ^= 1
    assert verifier.verify(sent.frame, bytes(damaged)).verdict == "undecidable"
    assert heard(verifier, signed(keys[1])[0]).verdict == "authentic"


def test_folders_of_keys(keys: list[KeyFile], tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no key")
    (tmp_path / "._a.key").write_bytes(b"\0\5\x16\7")  # macOS writes it
    with KeyRing.open([tmp_path]) as ring:
        assert [key.key_id for key in ring.keys] == [key.key_id for key in keys[::-1]]
        assert ring.newest.key_id[:8] in repr(ring)
        marker = Watermarker(ring)
    with pytest.raises(Error, match="closed"):
        Watermarker(ring)
    assert heard(marker, signed(keys[0])[0]).verdict == "authentic"  # it has copies of its own
    marker.close()
    with pytest.raises(Error, match="closed"):
        heard(marker, signed(keys[0])[0])


def test_a_key_made_at_time_0_replaces_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A computer without a clock begins in 1970."""
    made = []
    for name, time_ns in (("old", -100 * SECOND), ("new", 0)):
        with monkeypatch.context() as patch:
            patch.setattr("time.time_ns", lambda now=time_ns: now)
            made.append(KeyFile.create(tmp_path / f"{name}.key"))
    old, new = made
    with old, new, KeyRing(made) as ring:
        (sent,) = signed(old, time_s=50.0)
        found = heard(Watermarker(ring), sent)
        assert (found.verdict, found.reason) == ("undecidable", REFUSED)
        (sent,) = signed(old, time_s=-50.0)
        assert heard(Watermarker(ring), sent).verdict == "authentic"


def test_a_copy_of_a_key_is_no_other_key(keys: list[KeyFile], tmp_path: Path) -> None:
    shutil.copy2(tmp_path / "a.key", tmp_path / "backup.key")
    with KeyRing.open([tmp_path, tmp_path / "a.key"]) as ring:
        assert [key.key_id for key in ring.keys] == [key.key_id for key in keys[::-1]]
        (sent,) = signed(keys[1], time_s=1150.0)
        assert heard(Watermarker(ring), sent).verdict == "authentic"


def test_bad_rings_are_named(keys: list[KeyFile], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="keys: expected at least one"):
        KeyRing([])
    with pytest.raises(InputError, match="keys: expected each key once"):
        KeyRing([keys[0], keys[0]])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"empty: expected a folder with files that end in \.key"):
        KeyRing.open([tmp_path / "empty"])
    with pytest.raises(FileNotFoundError):
        KeyRing.open([tmp_path / "a.key", tmp_path / "missing.key"])
    (tmp_path / "a.key").chmod(0o644)
    with pytest.raises(InputError, match="only its owner"):
        KeyRing.open([tmp_path])
    verifier = _core.WatermarkVerifier(keys[0]._key)
    with pytest.raises(InputError, match="not given before"):
        verifier.add_older_key(keys[0]._key, 1)


def test_inspect_takes_keys_that_follow_each_other(tmp_path: Path) -> None:
    """Scans of the old key and of the new one are verified by one call, and in a drive."""
    from manip3d.authenticate import inspect, inspect_drive

    keys = tmp_path / "keys"
    keys.mkdir()
    sent = []
    for name in ("old", "new"):
        with KeyFile.create(keys / f"{name}.key") as key, Watermarker(key) as marker:
            sent.append(marker.embed(grid_scan(3000)))
    with KeyRing.open([keys]) as ring, KeyFile(keys / "new.key") as new:
        for each, verdict in zip(sent, ("undecidable", "no_trace"), strict=True):
            alone = inspect(each.frame, watermark=each.record, key=new, power=False)
            assert next(r for r in alone.detectors if r.name == "watermark").verdict == verdict
            both = inspect(each.frame, watermark=each.record, key=ring, power=False)
            assert next(r for r in both.detectors if r.name == "watermark").verdict == "no_trace"
        frames = [each.frame for each in sent]
        records = [each.record for each in sent]
        for found in inspect_drive(frames, records=records, key=ring, power=False):
            assert found is not None
            assert next(r for r in found.detectors if r.name == "watermark").verdict == "no_trace"
