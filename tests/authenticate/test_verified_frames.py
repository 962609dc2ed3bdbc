"""The file of what a verifier has seen: no kill, no second verifier and no bytes make it forget."""

from __future__ import annotations

import errno
import gc
import hashlib
import os
import resource
import signal
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from manip3d import LidarFrame
from manip3d.authenticate import KeyFile, Watermarked, Watermarker
from manip3d.authenticate import _verified_frames as kept
from manip3d.errors import Error, FormatError, InputError
from watermark_scans import ROOT_KEY, grid_scan


@pytest.fixture
def state(tmp_path: Path) -> Path:
    return tmp_path / "seen.state"


def signed(key: KeyFile, count: int, *, ends: bool = False) -> list[Watermarked]:
    """Return signed frames of one session, or with ``ends`` each as the end of its own session."""
    marker = Watermarker(key)
    frames = [LidarFrame(grid_scan(1200, seed)) for seed in range(count)]
    if ends:
        return [Watermarker(key).embed(frame, is_end=True) for frame in frames]
    return [marker.embed(frame) for frame in frames]


def orders(verifier: Watermarker, sent: list[Watermarked]) -> list[str]:
    return [verifier.verify(each.frame, each.record).order for each in sent]


def in_a_child(run: Callable[[], object]) -> int:
    """Run a function in a child process; return the status of `os.waitpid`, 0 without an error."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            run()
            code = 0
        finally:
            os._exit(code)
    return os.waitpid(child, 0)[1]


def refused(kind: type[Error], call: Callable[[], object]) -> None:
    with pytest.raises(kind):
        call()


@pytest.mark.parametrize("ends", [False, True])
def test_a_killed_verifier_forgets_no_frame(key: KeyFile, state: Path, *, ends: bool) -> None:
    sent = signed(key, 3, ends=ends)

    def die() -> None:
        verifier = Watermarker(key, state=state)
        assert orders(verifier, sent) == ["in order"] * 3
        os.kill(os.getpid(), signal.SIGKILL)

    assert in_a_child(die) == signal.SIGKILL
    with Watermarker(key, state=state) as verifier:
        assert orders(verifier, sent) == ["replay"] * 3


def test_a_state_file_has_one_verifier(key: KeyFile, state: Path) -> None:
    sent = signed(key, 3)
    first = Watermarker(key, state=state)
    with pytest.raises(InputError, match=r"state: .*one verifier.*seen\.state"):
        Watermarker(key, state=state)
    link = state.with_name("link.state")
    link.symlink_to(state)
    with pytest.raises(InputError, match="one verifier"):
        Watermarker(key, state=link)
    assert in_a_child(lambda: refused(InputError, lambda: Watermarker(key, state=state))) == 0
    assert orders(first, sent) == ["in order"] * 3
    first.close()
    first.close()
    with Watermarker(key, state=link) as second:
        assert orders(second, sent[1:]) == ["replay"] * 2


def test_a_forgotten_verifier_releases_its_file(key: KeyFile, state: Path) -> None:
    sent = signed(key, 2)
    verifier = Watermarker(key, state=state)
    assert orders(verifier, sent) == ["in order"] * 2
    del verifier
    gc.collect()
    with Watermarker(key, state=state) as again:
        assert orders(again, sent) == ["replay"] * 2


def test_a_child_of_the_verifiers_process_writes_nothing(key: KeyFile, state: Path) -> None:
    sent = signed(key, 2)
    with Watermarker(key, state=state) as verifier:
        assert orders(verifier, sent[:1]) == ["in order"]
        before = state.read_bytes()
        assert in_a_child(lambda: refused(Error, lambda: orders(verifier, sent[1:]))) == 0
        assert state.read_bytes() == before
        assert orders(verifier, sent[1:]) == ["in order"]


def test_the_journal_is_short_and_folded(
    key: KeyFile, state: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept, "CHECKPOINT_FRAMES", 4)
    sent = signed(key, 7)
    sizes = []
    with Watermarker(key, state=state) as verifier:
        for each in sent:
            assert orders(verifier, [each]) == ["in order"]
            sizes.append(state.stat().st_size)
    checkpoint = sizes[0]
    assert [size - checkpoint for size in sizes] == [0, 114, 228, 342, 0, 114, 228]
    assert state.stat().st_size == checkpoint


@pytest.mark.parametrize("before", [0, 1])
def test_a_frame_that_could_not_be_written_may_be_verified_again(
    key: KeyFile, state: Path, monkeypatch: pytest.MonkeyPatch, before: int
) -> None:
    """The first frame after opening, or the one that folds the journal, finds the disk full.

    Nobody got a verdict on it, so that it is no replay, neither here nor for the next verifier.
    """

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(state))

    monkeypatch.setattr(kept, "CHECKPOINT_FRAMES", 1)
    sent = signed(key, before + 1)
    verifier = Watermarker(key, state=state)
    orders(verifier, sent[:before])
    with monkeypatch.context() as patch:
        patch.setattr(kept, "atomic_write", full)
        with pytest.raises(OSError, match="No space"):
            orders(verifier, sent[before:])
    verifier.close()
    with Watermarker(key, state=state) as again:
        assert orders(again, sent) == ["replay"] * before + ["in order"]
        monkeypatch.setattr(kept, "atomic_write", full)
        with pytest.raises(OSError, match="No space"):
            orders(again, signed(key, 1, ends=True))
        monkeypatch.undo()
        assert orders(again, sent) == ["replay"] * (before + 1)


def test_a_torn_entry_is_of_a_frame_that_was_never_answered(key: KeyFile, state: Path) -> None:
    sent = signed(key, 4)
    verifier = Watermarker(key, state=state)
    orders(verifier, sent[:3])
    whole = state.read_bytes()
    for cut in (1, 50, 97):
        other = state.with_name(f"{cut}.state")
        other.write_bytes(whole[:-cut])
        with Watermarker(key, state=other) as again:
            assert orders(again, [sent[1], sent[2], sent[3]]) == ["replay", "in order", "in order"]
        with Watermarker(key, state=other) as again:
            assert orders(again, sent) == ["replay"] * 4


def test_a_file_without_a_journal_is_read(key: KeyFile, state: Path) -> None:
    sent = signed(key, 2)
    with Watermarker(key) as verifier:
        orders(verifier, sent)
        state.write_bytes(verifier._verifier.state())
    with Watermarker(key, state=state) as again:
        assert orders(again, sent) == ["replay"] * 2


def tag_of(state: bytes) -> bytes:
    return hashlib.blake2b(b"m3d-verifier-state" + state, key=ROOT_KEY, digest_size=32).digest()


def early(version: bytes, state: bytes) -> bytes:
    """A state of an early version, which has no times before the sessions."""
    step = 16 if version == b"m3d-vs01" else 24
    body = version + state[8:66]
    for begin in range(82, len(state) - 32, 24):
        body += state[begin : begin + step]
    return body + tag_of(body)


def test_a_state_of_the_first_version_is_read(key: KeyFile, state: Path) -> None:
    """It does not state the last frames of sessions that were left: all of theirs are replays."""
    left, last = signed(key, 3), signed(key, 2)
    with Watermarker(key) as verifier:
        orders(verifier, [*left[:2], last[0]])
        new = verifier._verifier.state()
    state.write_bytes(early(b"m3d-vs01", new))
    with Watermarker(key, state=state) as again:
        assert orders(again, [left[2], last[0], last[1]]) == ["replay", "replay", "in order"]


def test_a_journal_of_the_second_version_is_read(key: KeyFile, state: Path) -> None:
    """Its entries are shorter by the times."""
    left, last = signed(key, 3), signed(key, 4)
    with Watermarker(key) as verifier:
        orders(verifier, [*left[:2], last[0]])
        checkpoint = early(b"m3d-vs02", verifier._verifier.state())
        content = b"m3d-vj01" + len(checkpoint).to_bytes(4, "little") + checkpoint
        for each in last[1:3]:
            orders(verifier, [each])
            entry = early(b"m3d-vs02", verifier._verifier.state())
            content += entry[:66] + entry[-32:]
    state.write_bytes(content)
    with Watermarker(key, state=state) as again:
        assert orders(again, [last[2], left[1], last[3]]) == ["replay", "replay", "in order"]
        assert orders(again, [left[2]]) == ["gap"]


def test_frames_of_sessions_that_were_forgotten_are_not_authentic(
    key: KeyFile, state: Path
) -> None:
    """The last 4096 sessions are remembered. A replay of an older one states no later time."""
    scan = LidarFrame(grid_scan(12))
    first, second, third, late, new = (
        Watermarker(key).embed(scan, time_ns=time_ns, is_end=True) for time_ns in (1, 2, 3, 2, 4)
    )
    with Watermarker(key) as verifier:
        orders(verifier, [first, second])
        body = verifier._verifier.state()[:-32]  # with the first session as the only earlier one
    body += np.random.default_rng(0).bytes(4095 * 24)
    state.write_bytes(body + tag_of(body))
    with Watermarker(key, state=state) as verifier:
        assert orders(verifier, [first, third]) == ["replay", "in order"]
    with Watermarker(key, state=state) as verifier:  # its state says that one was forgotten
        replayed = verifier.verify(first.frame, first.record)
        assert (replayed.verdict, replayed.order) == ("undecidable", "unknown")
        assert orders(verifier, [new, late, new]) == ["in order", "unknown", "replay"]


def test_no_bytes_make_a_state_of_frames_that_were_not_seen(key: KeyFile, state: Path) -> None:
    """Changed bytes are refused, or are of an entry that does not count."""
    sent = signed(key, 4, ends=True)
    verifier = Watermarker(key, state=state)
    orders(verifier, sent[:1])
    more = signed(key, 3)
    orders(verifier, more)
    whole = state.read_bytes()
    verifier.close()
    rng = np.random.default_rng(14)
    num_refused = 0
    for _ in range(400):
        content = bytearray(whole)
        kind = rng.integers(4)
        if kind == 0:
            content[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            del content[rng.integers(len(content)) :]
        elif kind == 2:
            content += rng.bytes(int(rng.integers(1, 300)))
        else:
            content[8:12] = rng.bytes(4)
        state.write_bytes(content)
        try:
            with Watermarker(key, state=state) as again:
                assert orders(again, sent[:1])[0] == "replay"
                assert orders(again, more[:1])[0] == "replay"
        except FormatError:
            num_refused += 1
    assert num_refused > 200


@pytest.mark.parametrize("content", [b"", b"m3d-vj01", bytes(200_000), b"m3d-vj01" + bytes(150)])
def test_bytes_that_are_no_state_are_refused(key: KeyFile, state: Path, content: bytes) -> None:
    state.write_bytes(content)
    with pytest.raises(FormatError, match=r"seen\.state"):
        Watermarker(key, state=state)
    with pytest.raises(FormatError, match=r"seen\.state"):  # and the lock is free again
        Watermarker(key, state=state)


def test_a_pipe_is_refused(key: KeyFile, state: Path) -> None:
    os.mkfifo(state)
    with pytest.raises(FormatError, match="regular file"):
        Watermarker(key, state=state)
    os.mkfifo(state.with_name(".other.state.lock"))
    with Watermarker(key, state=state.with_name("other.state")):
        pass


def test_a_full_disk_is_an_error_and_the_frame_may_be_verified_again(
    key: KeyFile, state: Path
) -> None:
    sent = signed(key, 4)

    def on_a_full_disk() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        verifier = Watermarker(key, state=state)
        orders(verifier, sent[:2])
        size = state.stat().st_size
        _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
        with pytest.raises(OSError, match=r"seen\.state") as caught:
            orders(verifier, sent[2:3])
        assert caught.value.errno == errno.EFBIG
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
        assert orders(verifier, sent[2:]) == ["in order"] * 2
        os.kill(os.getpid(), signal.SIGKILL)

    assert in_a_child(on_a_full_disk) == signal.SIGKILL
    with Watermarker(key, state=state) as again:
        assert orders(again, sent) == ["replay"] * 4


def test_what_was_forgotten_stays_forgotten(key: KeyFile, state: Path) -> None:
    sent = signed(key, 1)
    with Watermarker(key, state=state) as verifier:
        orders(verifier, sent)
        verifier.reset()
    with Watermarker(key, state=state) as again:
        assert orders(again, sent) == ["in order"]


def test_threads_embed_into_one_session(key: KeyFile) -> None:
    scans = [LidarFrame(grid_scan(1200, seed)) for seed in range(8)]
    for _ in range(30):
        marker, barrier = Watermarker(key), threading.Barrier(8)
        sent: list[Watermarked] = []

        def embed(
            scan: LidarFrame,
            marker: Watermarker,
            barrier: threading.Barrier,
            sent: list[Watermarked],
        ) -> None:
            barrier.wait()
            sent.append(marker.embed(scan))

        threads = [threading.Thread(target=embed, args=(s, marker, barrier, sent)) for s in scans]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(each.number for each in sent) == list(range(8))


def test_threads_verify_into_one_file(key: KeyFile, state: Path) -> None:
    """The file ends with the last frame that was seen, whichever thread saw it."""
    sent = signed(key, 16)
    verifier = Watermarker(key, state=state)

    def run(mine: list[Watermarked]) -> None:
        orders(verifier, mine)

    threads = [threading.Thread(target=run, args=(sent[start::4],)) for start in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    stored = kept._last_state(state.read_bytes())
    assert stored == verifier._verifier.state()
