"""One function over many files: rows, failures, resuming, workers that die, remote files."""

from __future__ import annotations

import csv
import functools
import logging
import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manip3d import LidarFrame, Material, Mesh, Texture, batch, io, read_mesh
from manip3d._util import parallel
from manip3d.errors import Error, FormatError, InputError, MissingExtraError
from manip3d.io import ReadLimits, read_scan
from toy_work import clashing, running, talkative, upper

TESTS = Path(__file__).parents[1]


@pytest.fixture
def texts(tmp_path: Path) -> Path:
    """Four files in two folders, one of which no work can be done on."""
    folder = tmp_path / "texts"
    (folder / "deep").mkdir(parents=True)
    for name, text in {"a": "one", "b": "bad", "c": "three", "deep/d": "four"}.items():
        (folder / f"{name}.txt").write_text(text)
    (folder / "picture.png").write_bytes(b"no text")
    return folder


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def begun(log: Path) -> list[str]:
    lines = log.read_text().splitlines() if log.exists() else []
    return sorted(line.split()[1] for line in lines if line.startswith("begin"))


def test_each_file_has_a_row_and_a_failure_is_one(texts: Path, tmp_path: Path) -> None:
    seen: list[tuple[float, str]] = []
    errors: list[str] = []
    summary = batch.run(
        upper, texts, tmp_path / "out", suffixes=[".txt"], jobs=1,
        progress=lambda f, m: seen.append((f, Path(m).name)),
        on_error=lambda source, error: errors.append(error),
    )  # fmt: skip
    assert [Path(row["source"]).name for row in summary.rows] == [
        "a.txt",
        "b.txt",
        "c.txt",
        "d.txt",
    ]
    assert (summary.failed, summary.resumed) == (1, 0)
    assert errors == [f"ValueError: {texts / 'b.txt'}: bad text"]
    assert (tmp_path / "out" / "deep" / "d.txt").read_text() == "FOUR"
    assert seen[-1] == (1.0, "d.txt")
    rows = table(tmp_path / "out" / "results.csv")
    assert [row["length"] for row in rows] == ["3", "", "5", "4"]
    assert [row["nested.pair.1"] for row in rows] == ["2", "", "2", "2"]
    assert [bool(row["error"]) for row in rows] == [False, True, False, False]
    assert rows[0]["read"] == str(texts / "a.txt")
    assert rows[0]["output_bytes"] == "3"


def test_processes_give_the_same_rows(texts: Path, tmp_path: Path) -> None:
    one = batch.run(upper, texts, tmp_path / "1", suffixes=[".txt"], jobs=1)
    two = batch.run(upper, texts, tmp_path / "2", suffixes=[".txt"], jobs=2)
    for first, second in zip(one.rows, two.rows, strict=True):
        assert first.get("length") == second.get("length")
        assert first["error"] == second["error"]


def test_only_what_is_new_or_changed_is_done_again(texts: Path, tmp_path: Path) -> None:
    log = tmp_path / "log"
    arguments = {"suffixes": [".txt"], "jobs": 1, "options": {"log": str(log)}}
    batch.run(upper, texts, tmp_path / "out", **arguments)
    log.unlink()
    (texts / "b.txt").write_text("two")  # mended
    (texts / "c.txt").write_text("changed")
    (texts / "e.txt").write_text("new")
    (tmp_path / "out" / "a.txt").write_text("torn by somebody")
    summary = batch.run(upper, texts, tmp_path / "out", **arguments)
    assert begun(log) == ["a.txt", "b.txt", "c.txt", "e.txt"]
    assert (summary.resumed, summary.failed) == (1, 0)
    assert (tmp_path / "out" / "a.txt").read_text() == "ONE"
    assert len(table(tmp_path / "out" / "results.csv")) == 5
    again = batch.run(upper, texts, tmp_path / "out", overwrite=True, **arguments)
    assert again.resumed == 0


def test_a_changed_line_of_the_rows_is_not_believed(texts: Path, tmp_path: Path) -> None:
    arguments = {"suffixes": [".txt"], "jobs": 1}
    batch.run(upper, texts, tmp_path / "out", **arguments)
    (part,) = (tmp_path / "out" / "results.rows").glob("*.jsonl")
    first, *rest = part.read_text().splitlines()
    part.write_text("\n".join([first.replace('"length":3', '"length":9'), *rest, '{"torn']) + "\n")
    summary = batch.run(upper, texts, tmp_path / "out", **arguments)
    assert summary.resumed == 2
    assert summary.rows[0]["length"] == 3


def test_a_run_over_no_files_leaves_the_table_as_it_was(texts: Path, tmp_path: Path) -> None:
    rows = tmp_path / "rows.csv"
    batch.run(upper, texts / "a.txt", table=rows, jobs=1)
    before = rows.read_bytes()
    for options in ({"table": rows}, {"output": tmp_path / "out"}):
        with pytest.raises(InputError, match="sources: expected files, found none"):
            batch.run(upper, [], jobs=1, **options)  # type: ignore[arg-type]
    assert rows.read_bytes() == before
    assert not (tmp_path / "out").exists()


def test_outputs_of_others_are_not_replaced(texts: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "c.txt").write_text("mine")
    with pytest.raises(InputError, match=r"c\.txt: exists already; overwrite=True"):
        batch.run(upper, texts, out, suffixes=[".txt"], jobs=1)
    assert (out / "c.txt").read_text() == "mine"
    assert not (out / "results.rows").exists()
    batch.run(upper, texts, out, suffixes=[".txt"], jobs=1, overwrite=True)
    with pytest.raises(InputError, match="other options; overwrite=True"):
        batch.run(upper, texts, out, suffixes=[".txt"], jobs=1, options={"seconds": 0.001})
    (tmp_path / "t.csv").write_text("mine")
    with pytest.raises(InputError, match=r"t\.csv: exists already"):
        batch.run(upper, texts, table=tmp_path / "t.csv", suffixes=[".txt"], jobs=1)


def test_a_later_run_knows_the_outputs_of_earlier_ones(texts: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "a.txt").write_text("two")  # of the size of the first a.txt
    arguments = {"output": tmp_path / "out", "jobs": 1}
    batch.run(upper, [texts / "a.txt", texts / "c.txt"], **arguments)
    with pytest.raises(
        InputError, match=r"out/a\.txt: exists already, made of .*texts/a\.txt; over"
    ):
        batch.run(upper, tmp_path / "other", **arguments)
    (tmp_path / "out" / "d.txt").write_text("mine")
    with pytest.raises(InputError, match=r"d\.txt: exists already; overwrite=True"):
        batch.run(upper, texts / "deep" / "d.txt", **arguments)
    assert (tmp_path / "out" / "d.txt").read_text() == "mine"
    batch.run(upper, tmp_path / "other", overwrite=True, **arguments)
    with pytest.raises(InputError, match=r"a\.txt: exists already, made of .*other/a\.txt; over"):
        batch.run(upper, texts / "a.txt", **arguments)
    assert batch.run(upper, texts / "c.txt", **arguments).resumed == 0


def test_an_output_that_a_failure_left_is_replaced_by_the_next_run(
    texts: Path, tmp_path: Path
) -> None:
    arguments = {"output": tmp_path / "out", "jobs": 1}
    assert batch.run(upper, texts / "b.txt", **arguments).failed == 1
    (tmp_path / "out" / "b.txt").write_text("TO")
    (texts / "b.txt").write_text("two")
    assert batch.run(upper, texts / "b.txt", **arguments).failed == 0
    assert (tmp_path / "out" / "b.txt").read_text() == "TWO"


def test_a_row_is_used_again_only_if_it_is_the_last_of_its_output(
    texts: Path, tmp_path: Path
) -> None:
    def resumed(die: str) -> int:
        options = {"die": die}
        return batch.run(
            upper, texts / "a.txt", tmp_path / "out", jobs=1, options_of=lambda file: options
        ).resumed

    assert [resumed(die) for die in ("x", "x", "y", "x", "y", "y")] == [0, 1, 0, 0, 0, 1]


def test_a_file_that_is_named_in_two_ways_is_one_source(
    texts: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(texts)
    (texts / "link.txt").symlink_to("a.txt")
    twice = ["a.txt", texts / "a.txt", "deep/../a.txt", "./a.t?t"]
    assert [file.name for file in batch.find_files([*twice, "link.txt"])] == ["a.txt", "link.txt"]
    listed = [*batch.find_files("a.txt"), *batch.find_files(str(texts / "a.txt")), *twice]
    assert len(batch.run(upper, listed, tmp_path / "out", jobs=1).rows) == 1
    (texts / "day" / "velodyne").mkdir(parents=True)
    assert len(batch.find_drives(["day", texts / "day", ".", "day/."])) == 1


def test_bad_arguments_are_refused(texts: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="jobs: expected >= 0"):
        batch.run(upper, texts, jobs=-1)
    with pytest.raises(InputError, match=r"table: expected a name that ends in \.csv or \.parquet"):
        batch.run(upper, texts, table=tmp_path / "t.txt")
    with pytest.raises(InputError, match=r"expected files \(\.obj\), found none"):
        batch.run(upper, texts, suffixes=[".obj"])
    with pytest.raises(InputError, match="found none"):
        batch.run(upper, str(texts / "*.xyz"))
    with pytest.raises(FileNotFoundError):
        batch.run(upper, texts / "absent.txt")
    with pytest.raises(InputError, match="two inputs would be written there"):
        batch.run(upper, texts, tmp_path / "out", rename=lambda name: "same", jobs=1)


def test_a_table_in_parquet_without_pyarrow_is_refused_before_any_work(
    texts: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingExtraError, match=r"^pyarrow is needed here: .*parquet"):
        batch.run(upper, texts, tmp_path / "out", table=tmp_path / "t.parquet", jobs=1)
    assert not (tmp_path / "out").exists()


def test_sources_are_files_folders_and_patterns(texts: Path) -> None:
    def names(*sources: object, **more: object) -> list[str]:
        return [file.relative for file in batch.find_files(sources, **more)]  # type: ignore[arg-type]

    assert names(texts / "a.txt", texts / "a.txt") == ["a.txt"]
    assert names(texts, suffixes=[".txt"]) == ["a.txt", "b.txt", "c.txt", "deep/d.txt"]
    assert names(texts, suffixes=[".TXT"]) == ["a.txt", "b.txt", "c.txt", "deep/d.txt"]
    assert names(str(texts / "[ab].txt")) == ["a.txt", "b.txt"]
    assert names(str(texts / "**" / "*.txt")) == ["a.txt", "b.txt", "c.txt", "deep/d.txt"]
    (texts / "odd[1].txt").write_text("named like a pattern")
    assert names(str(texts / "odd[1].txt")) == ["odd[1].txt"]


def test_outputs_below_the_sources_are_no_sources(texts: Path) -> None:
    for _ in range(2):
        summary = batch.run(upper, texts, texts / "out", suffixes=[".txt"], jobs=1)
        assert len(summary.rows) == 4


def test_outputs_are_no_sources_however_their_folder_is_written(
    texts: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(texts)
    places = [(".", "out"), (texts, "out"), (".", texts / "out"), ("../texts", "./out")]
    for sources, output in places:
        summary = batch.run(upper, sources, output, suffixes=[".txt"], jobs=1, overwrite=True)
        assert len(summary.rows) == 4


def test_a_table_in_parquet_keeps_types(texts: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra 'parquet' is not installed")
    batch.run(upper, texts, table=tmp_path / "t.parquet", suffixes=[".txt"], jobs=1)
    columns = parquet.read_table(tmp_path / "t.parquet").to_pydict()
    assert columns["length"] == [3, None, 5, 4]
    batch.write_table([{"a": 1}, {"a": "word"}], tmp_path / "mixed.parquet")
    assert parquet.read_table(tmp_path / "mixed.parquet").to_pydict() == {"a": ["1", "word"]}
    batch.write_table([{"a": 1}, {"a": 2**64}], tmp_path / "large.parquet")
    assert parquet.read_table(tmp_path / "large.parquet").to_pydict() == {"a": ["1", str(2**64)]}


def test_a_table_has_the_number_of_a_list_of_mappings_however_short(tmp_path: Path) -> None:
    row = {"drive": "a", "frames": [{"scan": "0.bin", "tiles": 36}], "bounds": [0.5, 1.5]}
    batch.write_table([row], tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text() == "drive,frames,bounds.0,bounds.1\na,1,0.5,1.5\n"


def test_a_worker_that_dies_takes_only_its_file_along(texts: Path, tmp_path: Path) -> None:
    (texts / "b.txt").write_text("two")
    summary = batch.run(upper, texts, tmp_path / "out", suffixes=[".txt"], jobs=2,
                        options={"die": "c.txt"})  # fmt: skip
    assert ["process" in row["error"] for row in summary.rows] == [False, False, True, False]
    assert (tmp_path / "out" / "deep" / "d.txt").read_text() == "FOUR"


COUNT = """
import sys
from manip3d import batch
def count(source, output):
    return {"bytes": len(source.read_bytes())}
"""
CALL = 'summary = batch.run(count, sys.argv[1], sys.argv[2], jobs=2, suffixes=[".txt"])'


def python(*arguments: str | Path, **options: Any) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, **options)


def test_a_function_that_workers_cannot_import_is_refused_before_any_work(
    texts: Path, tmp_path: Path
) -> None:
    """All files failed, with the words for a lack of memory. A cell of a notebook is no file."""
    out = tmp_path / "out"
    for given in (lambda source, output: {}, functools.partial(upper, seconds=0.0)):
        with pytest.raises(InputError, match="function: expected one"):
            batch.run(given, texts, out, jobs=2)
    assert batch.run(lambda source, output: {}, texts, jobs=1).failed == 0
    cell = f"{COUNT}{CALL}"
    for done in (python("-c", cell, texts, out), python("-", texts, out, input=cell)):
        told = done.stderr.splitlines()[-1]
        assert "InputError: function: expected one that workers can import, got <func" in told
        assert told.endswith(ADVICE)
    assert not out.exists()


ADVICE = (
    "; define it at the top level of a module (a .py file other than __main__.py), or give jobs=1 "
    'or dask="local"'
)


def test_a_nested_function_and_one_of_a_package_s_main_are_told_where_to_go(
    texts: Path, tmp_path: Path
) -> None:
    """Both are in a module already, which the advice named."""

    def nested(source: Path, output: Path) -> dict[str, Any]:
        return {}

    with pytest.raises(InputError, match=re.escape(ADVICE)):
        batch.run(nested, texts, jobs=2)
    package = tmp_path / "package"
    package.mkdir()
    (package / "__main__.py").write_text(f'{COUNT}if __name__ == "__main__":\n    {CALL}\n')
    done = python("-m", "package", texts, tmp_path / "out", cwd=tmp_path)
    assert done.stderr.splitlines()[-1].endswith(ADVICE)


ENDED = (
    "InputError: jobs: all workers ended at their start (see their output); if a script calls "
    'this, it must do so below `if __name__ == "__main__":`, because its worker processes import it'
)


def test_a_script_that_workers_must_not_run_again_says_so(texts: Path, tmp_path: Path) -> None:
    """Each file failed after an attempt of its own to start workers."""
    unguarded, guarded = tmp_path / "unguarded.py", tmp_path / "guarded.py"
    unguarded.write_text(f"{COUNT}{CALL}")
    guarded.write_text(f'{COUNT}if __name__ == "__main__":\n    {CALL}\n    print(summary.failed)')
    done = python(unguarded, texts, tmp_path / "out")
    *_, told = done.stderr.splitlines()
    assert told.endswith(ENDED)
    assert done.stderr.count("InputError: jobs: a script must call this below `if") in (1, 2)
    assert python(guarded, texts, tmp_path / "out").stdout == "0\n"


SCRIPT = """
import sys
from manip3d import batch
from toy_work import upper
if __name__ == "__main__":
    log, source, output = sys.argv[1:]
    batch.run(upper, source, output, jobs=1, options={"log": log, "seconds": 0.05})
"""


def test_a_killed_run_goes_on_and_equals_an_uninterrupted_one(tmp_path: Path) -> None:
    source, log = tmp_path / "in", tmp_path / "log"
    source.mkdir()
    for number in range(60):
        (source / f"{number:02}.txt").write_text(f"text {number}")
    (tmp_path / "script.py").write_text(SCRIPT)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([*sys.path, str(TESTS)])}
    command = [sys.executable, tmp_path / "script.py", log, source, tmp_path / "out"]
    process = subprocess.Popen(command, env=environment)
    deadline = time.monotonic() + 60
    while not list((tmp_path / "out").glob("results.rows/*.jsonl")) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.kill()
    process.wait()
    before = len(begun(log))
    assert 0 < before < 60
    subprocess.run(command, env=environment, check=True)
    assert 60 <= len(begun(log)) < 60 + before  # some rows were there already
    assert len(table(tmp_path / "out" / "results.csv")) == 60
    for number in range(60):
        assert (tmp_path / "out" / f"{number:02}.txt").read_text() == f"TEXT {number}"


def test_dask_outlives_a_worker_that_is_killed(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra 'dask' is not installed")
    source, log = tmp_path / "in", tmp_path / "log"
    source.mkdir()
    for number in range(12):
        (source / f"{number:02}.txt").write_text(f"text {number}")
    (source / "05.txt").write_text("bad")
    killed: list[int] = []

    def kill_one(fraction: float, message: str) -> None:
        if not killed and fraction > 0.2 and (at_work := running(log)):
            killed.append(at_work[-1])
            os.kill(killed[0], signal.SIGKILL)

    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0"
    ) as cluster:
        summary = batch.run(
            upper, source, tmp_path / "out", dask=cluster.scheduler_address,
            options={"log": str(log), "seconds": 0.3}, progress=kill_one,
        )  # fmt: skip
    assert killed
    assert summary.failed == 1  # the bad one
    assert "ValueError" in summary.rows[5]["error"]
    lost = [line for line in log.read_text().splitlines() if line.endswith(f" {killed[0]}")]
    name = lost[-1].split()[1]  # began, did not end, and ran again elsewhere
    assert lost[-1].startswith("begin")
    assert begun(log).count(name) >= 2
    for number in range(12):
        if number != 5:
            assert (tmp_path / "out" / f"{number:02}.txt").read_text() == f"TEXT {number}"


def test_dask_needs_no_semaphore(texts: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some machines have none, and only the pool of processes uses one."""
    distributed = pytest.importorskip("distributed", reason="the extra 'dask' is not installed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0"
    ) as cluster:
        monkeypatch.setattr(parallel, "_SPAWN", None)
        summary = batch.run(upper, texts / "a.txt", dask=cluster.scheduler_address)
    assert summary.failed == 0


def test_dask_workers_print_what_the_log_of_the_caller_does(
    texts: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra 'dask' is not installed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0"
    ) as cluster:
        for level in (logging.ERROR, logging.WARNING):
            caplog.set_level(level, "manip3d")
            for name in ("a", "c"):
                batch.run(talkative, texts / f"{name}.txt", dask=cluster.scheduler_address)
            told, is_loud = capfd.readouterr().err, level == logging.WARNING
            for name in ("a", "c"):
                assert (f"{name}.txt is in the log" in told) == is_loud
                assert (f"a warning of {name}.txt" in told) == is_loud


def test_a_task_that_kills_every_dask_worker_is_given_up(texts: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra 'dask' is not installed")
    dask = pytest.importorskip("dask")
    (texts / "b.txt").write_text("two")
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0"
        ) as it,
    ):
        summary = batch.run(upper, texts, tmp_path / "out", suffixes=[".txt"],
                            dask=it.scheduler_address, options={"die": "a.txt"})  # fmt: skip
    assert "KilledWorker" in summary.rows[0]["error"]
    assert [row["error"] for row in summary.rows[1:]] == ["", "", ""]


# --- remote files ---------------------------------------------------------------------------------

TRIANGLE = Mesh(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
    [[0, 1, 2]],
    texcoords=[[0, 0], [1, 0], [0, 1]],
    face_texcoords=[[0, 1, 2]],
    face_material=[0],
    materials=[Material("a", textures={"base_color": Texture("a.png", b"\x89PNG\r\n\x1a\nmore")})],
)


@pytest.fixture
def memory() -> Iterator[str]:
    """A folder in fsspec's memory."""
    fsspec = pytest.importorskip("fsspec", reason="the extra 'remote' is not installed")
    yield "memory://store"
    fsspec.filesystem("memory").rm("/store", recursive=True)


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A bucket of moto's S3 server, for this process and for those that it starts."""
    s3fs = pytest.importorskip("s3fs", reason="the extra 'remote' is not installed")
    server_of = pytest.importorskip("moto.server", reason="moto is not installed")
    server = server_of.ThreadedMotoServer(port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "test")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
    reset = urllib.request.Request(f"http://{host}:{port}/moto-api/reset", method="POST")
    urllib.request.urlopen(reset).close()  # every server of this process has the same buckets
    s3fs.S3FileSystem(skip_instance_cache=True).mkdir("scans")
    yield "s3://scans"
    server.stop()


def test_readers_and_writers_take_urls(memory: str) -> None:
    TRIANGLE.write(f"{memory}/x.obj")
    read = read_mesh(f"{memory}/x.obj")
    assert read.source == f"{memory}/x.obj"
    assert np.array_equal(read.vertices, TRIANGLE.vertices)
    texture = read.materials[0].textures["base_color"]  # nobody finds it beside the file later
    assert texture.data == b"\x89PNG\r\n\x1a\nmore"
    read.write(f"{memory}/y.glb")
    again = read_mesh(f"{memory}/y.glb").materials[0].textures["base_color"]
    assert again.data == texture.data
    points = np.arange(30, dtype=np.float32).reshape(10, 3)
    LidarFrame(points, np.zeros(10, np.float32)).write(f"{memory}/s.bin")
    scan = read_scan(f"{memory}/s.bin")
    assert np.array_equal(scan.points, points)
    assert scan.source == f"{memory}/s.bin"


def num_points(source: Path, output: Path | None) -> dict[str, int]:
    return {"points": read_scan(source).num_points}


@pytest.mark.parametrize("jobs", [1, 2])
def test_limits_of_readers_hold_on_workers(tmp_path: Path, jobs: int) -> None:
    for name, size in (("a", 10), ("b", 11)):
        np.zeros((size, 4), np.float32).tofile(tmp_path / f"{name}.bin")
    with ReadLimits(max_points=10), ReadLimits(max_bytes=10_000):
        few, many = batch.run(num_points, tmp_path, suffixes=[".bin"], jobs=jobs).rows
    assert (few["points"], few["error"]) == (10, "")
    assert many["error"].endswith("b.bin: 11 points, more than max_points = 10")
    assert batch.run(num_points, tmp_path, suffixes=[".bin"], jobs=jobs).failed == 0


def test_a_row_says_of_an_error_what_programs_need(texts: Path) -> None:
    (texts / "b.txt").write_text("bad")
    fine, bad = batch.run(clashing, texts, suffixes=[".txt"], jobs=1).rows[:2]
    assert (fine["source"], fine["error"], fine["seconds"]) == (str(texts / "a.txt"), "", 60.0)
    assert fine["task_seconds"] >= 0.0
    name = str(texts / "b.txt")
    assert bad["error"] == f"FormatError: {name}: line 3: expected a good text"
    assert bad["error_details"] == {
        "code": "format",
        "message": f"{name}: line 3: expected a good text",
        "reason": "expected a good text",
        "file": name,
        "line": 3,
        "byte_offset": None,
    }


def test_errors_of_remote_files_name_the_url(memory: str) -> None:
    fsspec = pytest.importorskip("fsspec")
    fsspec.filesystem("memory").pipe("/store/bad.ply", b"ply\nnonsense")
    with pytest.raises(FormatError) as damaged:
        read_mesh(f"{memory}/bad.ply")
    assert damaged.value.file == f"{memory}/bad.ply"
    assert str(damaged.value).startswith(f"{memory}/bad.ply: line 2")
    with pytest.raises(FileNotFoundError) as absent:
        read_mesh(f"{memory}/none.ply")
    assert absent.value.filename == f"{memory}/none.ply"
    TRIANGLE.write(f"{memory}/x.ply")
    with pytest.raises(FormatError, match=f"{memory}/x.ply: expected at most max_bytes = 10 bytes"):
        read_mesh(f"{memory}/x.ply", max_bytes=10)
    with pytest.raises(InputError, match="Protocol not known: bogus"):
        read_mesh("bogus://x.ply")
    with pytest.raises(Error, match="gcsfs"):
        read_mesh("gs://bucket/x.ply")


def test_a_server_that_is_not_there_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"ftp://127.0.0.1:{server.getsockname()[1]}/y.ply"
    with pytest.raises(OSError, match="refused") as caught:
        io.read_mesh(url)  # FTP's file system connects as soon as it is made
    assert caught.value.filename == url


def test_a_remote_output_is_whole_or_not_there(bucket: str) -> None:
    fsspec = pytest.importorskip("fsspec")
    store = fsspec.filesystem("s3", skip_instance_cache=True, use_listings_cache=False)

    def stopped_halfway() -> None:
        with io.local_output(f"{bucket}/x/half.txt") as path:
            path.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        stopped_halfway()
    assert store.find("scans") == []
    with io.local_output(f"{bucket}/x/whole.txt") as path:
        (path.parent / "beside.txt").write_text("beside")
        path.write_text("whole")
        assert store.find("scans") == []
    assert store.find("scans") == ["scans/x/beside.txt", "scans/x/whole.txt"]
    assert store.cat("scans/x/whole.txt") == b"whole"
    with pytest.raises(FileNotFoundError) as absent, io.local_output("s3://none/x") as path:
        path.write_text("x")  # and no bucket is made
    assert absent.value.filename == "s3://none/x"


def test_a_batch_over_an_object_store(bucket: str) -> None:
    fsspec = pytest.importorskip("fsspec")
    store = fsspec.filesystem("s3", skip_instance_cache=True, use_listings_cache=False)
    for name, text in {"in/a.txt": "one", "in/b.txt": "bad", "in/deep/c.txt": "three"}.items():
        store.pipe(f"scans/{name}", text.encode())
    arguments = {"suffixes": [".txt"], "jobs": 2}
    summary = batch.run(upper, f"{bucket}/in", f"{bucket}/out", **arguments)
    assert summary.failed == 1
    assert summary.rows[1]["error"] == f"ValueError: {bucket}/in/b.txt: bad text"
    assert summary.rows[0]["read"] == f"{bucket}/in/a.txt"
    assert store.cat("scans/out/deep/c.txt") == b"THREE"
    rows = store.cat("scans/out/results.csv").decode().splitlines()
    assert len(rows) == 4
    store.pipe("scans/in/b.txt", b"mended")
    again = batch.run(upper, f"{bucket}/in/**/*.txt", f"{bucket}/out", **arguments)
    assert (again.resumed, again.failed) == (2, 0)
    assert store.cat("scans/out/b.txt") == b"MENDED"


def test_hidden_files_of_a_folder_are_left_out(texts: Path) -> None:
    """macOS leaves ._a.txt beside a.txt on other file systems."""
    (texts / "._a.txt").write_bytes(b"\0\5\x16\7" + bytes(60))
    (texts / ".git").mkdir()
    (texts / ".git" / "e.txt").write_text("five")
    named = [file.relative for file in batch.find_files(texts, suffixes=[".txt"])]
    assert named == ["a.txt", "b.txt", "c.txt", "deep/d.txt"]
    assert [file.relative for file in batch.find_files(texts)][-1] == "picture.png"
    assert [file.is_named for file in batch.find_files(texts / "._a.txt")] == [True]
    hidden = texts / ".git"  # named itself
    assert [file.relative for file in batch.find_files(hidden, suffixes=[".txt"])] == ["e.txt"]
    for drive in (texts / "drive", texts / ".old"):
        (drive / "velodyne").mkdir(parents=True)
    assert [drive.relative for drive in batch.find_drives(texts)] == ["drive"]


def test_hidden_files_match_no_pattern_behind_a_url_either(memory: str) -> None:
    store = pytest.importorskip("fsspec").filesystem("memory")
    for name in ("a.txt", "._a.txt", ".git/b.txt"):
        store.pipe(f"/store/{name}", b"text")
    for pattern, expected in (
        ("*.txt", ["a.txt"]),
        ("**/*.txt", ["a.txt"]),
        (".*.txt", ["._a.txt"]),
        (".git/*", ["b.txt"]),
        ("._a.txt", ["._a.txt"]),
    ):
        found = batch.find_files(f"{memory}/{pattern}")
        assert [file.relative for file in found] == expected, pattern


def test_what_is_no_address_of_a_scheduler_is_refused(texts: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the extra 'dask' is not installed")
    with pytest.raises(InputError, match=r"dask: expected local or the address .* got 'somewhere'"):
        batch.run(upper, texts, tmp_path / "out", dask="somewhere")
