"""`report.append_log` and `read_log`: a chain that several writers share, and that shows damage."""

from __future__ import annotations

import errno
import hashlib
import multiprocessing
import os
from pathlib import Path

import numpy as np
import pytest

from manip3d import FormatError, authenticate, report
from manip3d.report._case_log import check_log


def test_log_shows_what_was_changed(tmp_path: Path) -> None:
    log = tmp_path / "case.jsonl"
    found = authenticate.inspect(np.zeros((0, 3), np.float32))
    hashes = [report.append_log(log, found, source=f"scan {i}") for i in range(3)]
    assert [entry["hash"] for entry in report.read_log(log)] == hashes
    lines = log.read_bytes().splitlines(keepends=True)
    for damaged in (
        [lines[0].replace(b"undecidable", b"tampered"), *lines[1:]],
        [lines[0], lines[2]],
        [*lines[:2], lines[1], lines[2]],
        [b"no JSON\n"],
    ):
        log.write_bytes(b"".join(damaged))
        with pytest.raises(FormatError, match="line"):
            report.read_log(log)
        with pytest.raises(FormatError, match="line"):
            report.append_log(log, found, source="another")


def _append_ten(log: Path, name: str) -> None:
    found = authenticate.inspect(np.zeros((0, 3), np.float32))
    for number in range(10):
        report.append_log(log, found, source=f"{name} {number}")


def test_several_processes_append_to_one_log(tmp_path: Path) -> None:
    log = tmp_path / "case.jsonl"
    context = multiprocessing.get_context("spawn")
    writers = [context.Process(target=_append_ten, args=(log, name)) for name in "abcd"]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(120)
    assert [writer.exitcode for writer in writers] == [0] * 4
    sources = [entry["source"] for entry in report.read_log(log)]
    assert len(sources) == 40
    for name in "abcd":
        assert [s for s in sources if s[0] == name] == [f"{name} {i}" for i in range(10)]


def test_a_log_whose_last_newline_is_missing_goes_on(tmp_path: Path) -> None:
    log = tmp_path / "case.jsonl"
    found = authenticate.inspect(np.zeros((0, 3), np.float32))
    report.append_log(log, found, source="a")
    for source in "bc":
        log.write_bytes(log.read_bytes().rstrip(b"\n"))
        report.append_log(log, found, source=source)
    assert [entry["source"] for entry in report.read_log(log)] == ["a", "b", "c"]


FOUND = authenticate.inspect(np.zeros((0, 3), np.float32))


def log_of(path: Path, sources: str = "ab") -> Path:
    """Return a log with an entry for each letter of ``sources``."""
    for source in sources:
        report.append_log(path / "case.jsonl", FOUND, source=source)
    return path / "case.jsonl"


@pytest.fixture(params=["start", "brace", "zeros", "start and zeros"])
def torn_log(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, bytes]:
    """A log of two entries whose third line was not written whole, and what there is of it."""
    log = log_of(tmp_path)
    whole = log.read_bytes()
    torn = {
        "start": whole[:100], "brace": b"{", "zeros": bytes(64),
        "start and zeros": whole[:50] + bytes(9),
    }[request.param]  # fmt: skip
    log.write_bytes(whole + torn)
    return log, torn


def append_after_torn(log: Path, source: str, number: int = 1) -> None:
    """Append an entry to a log whose last line is torn, and expect the warning about it."""
    with pytest.warns(UserWarning, match=rf"bytes, which are kept in .*torn-{number}"):
        report.append_log(log, FOUND, source=source)


def test_a_torn_line_is_named_by_reading_and_passes_the_check(
    torn_log: tuple[Path, bytes],
) -> None:
    log, _ = torn_log
    with pytest.raises(FormatError, match="line 3: the last line is not whole"):
        report.read_log(log)
    check_log(log)


def test_a_torn_line_is_kept_in_a_file_of_its_own(torn_log: tuple[Path, bytes]) -> None:
    log, torn = torn_log
    whole = log.read_bytes().removesuffix(torn)
    with pytest.warns(UserWarning, match=f"after {len(torn)} bytes, which are kept in .*torn-1"):
        report.append_log(log, FOUND, source="c")
    assert log.read_bytes().startswith(whole)
    assert log.with_name("case.jsonl.torn-1").read_bytes() == torn


def test_a_log_goes_on_after_a_torn_line_and_states_it(torn_log: tuple[Path, bytes]) -> None:
    log, torn = torn_log
    append_after_torn(log, "c")
    report.append_log(log, FOUND, source="d")
    entries = report.read_log(log)
    assert [entry["source"] for entry in entries] == ["a", "b", "c", "d"]
    sha256 = hashlib.sha256(torn).hexdigest()
    mark = {"bytes": len(torn), "sha256": sha256, "kept": "case.jsonl.torn-1"}
    assert [entry.get("torn_line") for entry in entries] == [None, None, mark, None]


def test_a_second_torn_line_gets_another_file(torn_log: tuple[Path, bytes]) -> None:
    log, torn = torn_log
    append_after_torn(log, "c")
    log.write_bytes(log.read_bytes() + torn)
    append_after_torn(log, "d", number=2)
    for number in (1, 2):
        assert log.with_name(f"case.jsonl.torn-{number}").read_bytes() == torn
    assert [entry["source"] for entry in report.read_log(log)] == ["a", "b", "c", "d"]


def test_a_last_line_that_no_entry_begins_with_is_no_torn_line(tmp_path: Path) -> None:
    log = log_of(tmp_path)
    log.write_bytes(log.read_bytes() + b"what no log begins with")
    with pytest.raises(FormatError, match="line 3: not an entry"):
        report.append_log(log, FOUND, source="c")


def test_a_full_disk_leaves_a_torn_line_in_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "case.jsonl"
    found = authenticate.inspect(np.zeros((0, 3), np.float32))
    report.append_log(log, found, source="a")
    log.write_bytes(log.read_bytes() + log.read_bytes()[:70])
    torn, write = log.read_bytes(), os.write

    def full(descriptor: int, data: bytes | memoryview) -> int:
        if len(data) > 70:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(descriptor, data)

    with monkeypatch.context() as patched:
        patched.setattr("manip3d.report._case_log.os.write", full)
        with pytest.raises(OSError, match="No space left"):
            report.append_log(log, found, source="b")
    assert log.read_bytes() == torn
    assert [path.name for path in tmp_path.iterdir()] == [log.name]


def test_a_full_disk_leaves_a_log_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "case.jsonl"
    found = authenticate.inspect(np.zeros((0, 3), np.float32))
    report.append_log(log, found, source="a")
    whole, write, calls = log.read_bytes(), os.write, []

    def some(descriptor: int, data: memoryview) -> int:
        calls.append(len(data))
        if len(calls) > 1:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(descriptor, data[:50])

    with monkeypatch.context() as patched:
        patched.setattr("manip3d.report._case_log.os.write", some)
        with pytest.raises(OSError, match="No space left"):
            report.append_log(log, found, source="b")
    assert len(calls) == 2
    assert log.read_bytes() == whole
    report.append_log(log, found, source="c")
    assert [entry["source"] for entry in report.read_log(log)] == ["a", "c"]


def test_appending_reads_a_log_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "case.jsonl"
    found = authenticate.inspect(np.zeros((0, 3), np.float32))
    hashed = []
    real = hashlib.sha256
    monkeypatch.setattr(
        "manip3d.report._case_log.hashlib.sha256", lambda text: hashed.append(0) or real(text)
    )
    for number in range(20):
        report.append_log(log, found, source=str(number))
    assert len(hashed) == 20
    lines = log.read_bytes().splitlines(keepends=True)
    log.write_bytes(b"".join(lines[:-2]))  # what was cut is noticed, and the log read anew
    report.append_log(log, found, source="new")
    assert len(hashed) == 20 + 18 + 1
    assert len(report.read_log(log)) == 19


def test_a_name_that_stands_twice_in_a_line_is_noticed(tmp_path: Path) -> None:
    log = tmp_path / "case.jsonl"
    found = authenticate.inspect(np.zeros((0, 3), np.float32))
    report.append_log(log, found, source="a")
    twice = log.read_bytes().replace(b'"verdict": ', b'"verdict": "no_trace", "verdict": ', 1)
    log.write_bytes(twice)
    with pytest.raises(FormatError, match="line 1: the chain of hashes is broken"):
        report.read_log(log)
