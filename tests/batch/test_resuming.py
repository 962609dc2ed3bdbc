"""What an earlier run has stored is used again only where nothing that it was made from changed."""

from __future__ import annotations

import importlib
import inspect
import os
import pkgutil
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from manip3d import Mesh, batch, cli
from manip3d._util.paths import by_number
from manip3d.batch import Rows, _run
from manip3d.batch._places import Place
from manip3d.batch._stamps import stamp_of_folder
from manip3d.batch._stored import Finished
from manip3d.errors import InputError
from toy_work import running, upper
from watermark_scans import key_file

TESTS = Path(__file__).parents[1]


@pytest.fixture
def texts(tmp_path: Path) -> Path:
    folder = tmp_path / "texts"
    folder.mkdir()
    for name in "ab":
        (folder / f"{name}.txt").write_text(name)
    return folder


def made_again(folder: Path, **options: Any) -> int:
    """How many of the files are not taken from an earlier run."""
    summary = batch.run(upper, folder, table=folder.parent / "t.csv", jobs=1, **options)
    return len(summary.rows) - summary.resumed


def rewrite(path: Path, content: bytes) -> None:
    """Other content of the same size, with the time of modification set back."""
    times = path.stat()
    assert times.st_size == len(content)
    time.sleep(0.02)  # a tick of the clock that file systems use
    path.write_bytes(content)
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


def test_a_time_that_was_set_back_hides_no_edit(texts: Path) -> None:
    assert [made_again(texts), made_again(texts)] == [2, 0]
    rewrite(texts / "a.txt", b"c")
    assert [made_again(texts), made_again(texts)] == [1, 0]


def test_further_inputs_and_answers_of_the_moment(texts: Path, tmp_path: Path) -> None:
    (tmp_path / "scale.txt").write_text("1")

    def inputs(file: batch.SourceFile) -> list[Path]:
        return [tmp_path / "scale.txt"] if file.name.endswith("a.txt") else []

    assert [made_again(texts, inputs_of=inputs) for _ in range(2)] == [2, 0]
    rewrite(tmp_path / "scale.txt", b"2")
    assert [made_again(texts, inputs_of=inputs) for _ in range(2)] == [1, 0]
    assert [made_again(texts, inputs_of=inputs, resume=False) for _ in range(2)] == [2, 2]
    assert made_again(texts, inputs_of=inputs) == 0  # stored all the same
    assert len(list((tmp_path / "t.rows").glob("*.jsonl"))) == 1  # and not piled up


@pytest.mark.parametrize("compressed", [False, True])
def test_what_a_mesh_names_is_an_input(compressed: bool, tmp_path: Path) -> None:
    import gzip

    folder = tmp_path / "meshes"
    (folder / "maps").mkdir(parents=True)
    text = b"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    (folder / "a.obj").write_bytes(text)
    if compressed:
        (folder / "a.obj").unlink()
        (folder / "a.obj.gz").write_bytes(gzip.compress(text))
    (folder / "a.mtl").write_text("newmtl skin\nmap_Kd maps/skin.png\n")

    def again() -> int:
        summary = batch.run(_nothing, folder, suffixes=[".obj"], table=tmp_path / "t.csv", jobs=1)
        return 1 - summary.resumed

    assert [again(), again()] == [1, 0]
    (folder / "maps" / "skin.png").write_bytes(b"picture")  # it has come
    assert [again(), again()] == [1, 0]
    rewrite(folder / "maps" / "skin.png", b"PICTURE")
    assert [again(), again()] == [1, 0]
    (folder / "a.mtl").write_text("newmtl skin\n")
    assert [again(), again()] == [1, 0]


def _nothing(source: Path, output: Path | None) -> dict[str, Any]:
    return {}


def test_linked_folders_of_a_drive_count(tmp_path: Path) -> None:
    (tmp_path / "drive").mkdir()
    (tmp_path / "pictures").mkdir()
    (tmp_path / "drive" / "image_02").symlink_to(tmp_path / "pictures")
    (tmp_path / "drive" / "circle").symlink_to(tmp_path / "drive")
    before = stamp_of_folder(tmp_path / "drive")
    (tmp_path / "pictures" / "0.png").touch()
    assert stamp_of_folder(tmp_path / "drive") != before


# --- rows of other options ------------------------------------------------------------------------


def test_an_interrupted_new_beginning_serves_no_old_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = str(tmp_path / "t.rows")
    old = Rows(folder, {"ratio": 0.5})
    old.save("a", {"faces": 500})
    old.flush()

    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    for step in ("remove", "write"):
        with monkeypatch.context() as patch:
            patch.setattr(Place, step, interrupted)
            with pytest.raises(KeyboardInterrupt):
                Rows(folder, {"ratio": 0.1}, overwrite=True)
        with pytest.raises(InputError, match="other options"):  # the old ones, if any, are there
            Rows(folder, {"ratio": 0.1})
    assert Rows(folder, {"ratio": 0.5}).load("a") is None
    assert Rows(folder, {"ratio": 0.1}, overwrite=True).load("a") is None


def test_two_runs_at_a_time_keep_their_rows_apart(tmp_path: Path) -> None:
    folder = str(tmp_path / "t.rows")
    first = Rows(folder, {"ratio": 0.5})
    second = Rows(folder, {"ratio": 0.1}, overwrite=True)
    first.save("a", {"faces": 500})
    first.flush()
    assert Rows(folder, {"ratio": 0.1}).load("a") is None
    second.save("a", {"faces": 100})
    second.flush()
    assert Rows(folder, {"ratio": 0.1}).load("a") == {"faces": 100}


# --- files that are not there, and names that are no text -----------------------------------------


def test_a_dangling_link_is_a_row_that_failed(texts: Path) -> None:
    (texts / "gone.txt").symlink_to(texts / "nowhere.txt")
    for sources in (texts, str(texts / "*.txt")):
        summary = batch.run(upper, sources, table=texts.parent / "t.csv", jobs=1)
        errors = [row["error"] for row in summary.rows]
        assert (errors[:2], errors[2].split(":")[0]) == (["", ""], "FileNotFoundError")


def test_a_drive_with_a_dangling_link_is_a_drive(tmp_path: Path) -> None:
    (tmp_path / "drive" / "velodyne").mkdir(parents=True)
    (tmp_path / "drive" / "readme").symlink_to(tmp_path / "nowhere")
    (drive,) = batch.find_drives(tmp_path)
    (tmp_path / "nowhere").touch()
    assert batch.find_drives(tmp_path)[0].stamp != drive.stamp


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_name_that_is_no_utf_8_is_escaped_in_the_table(suffix: str, texts: Path) -> None:
    if suffix == ".parquet":
        pytest.importorskip("pyarrow", reason="the extra 'parquet' is not installed")
    (texts / os.fsdecode(b"\xff.txt")).write_text("c")
    table = texts.parent / f"t{suffix}"
    summary = batch.run(upper, texts, table=table, jobs=1)
    assert summary.failed == 0
    assert rb"\udcff.txt" in table.read_bytes()
    assert batch.run(upper, texts, table=table, jobs=1).resumed == 3


# --- workers --------------------------------------------------------------------------------------

SCRIPT = """
import sys
from manip3d import batch
from toy_work import upper
if __name__ == "__main__":
    batch.run(upper, sys.argv[2], jobs=2, options={"log": sys.argv[1], "seconds": 60.0})
"""


def test_workers_end_with_the_process_that_started_them(texts: Path, tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([*sys.path, str(TESTS)])}
    log = tmp_path / "log"
    process = subprocess.Popen(
        [sys.executable, tmp_path / "script.py", log, texts], env=environment
    )
    deadline = time.monotonic() + 60
    while len(running(log)) < 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    workers = running(log)
    assert len(workers) == 2
    process.kill()
    process.wait()
    deadline = time.monotonic() + 20
    while any(map(_is_alive, workers)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(_is_alive, workers))


def _is_alive(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def test_what_asks_a_command_to_end_ends_its_batch_like_ctrl_c(
    texts: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ended(*arguments: object, **options: object) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(5)

    monkeypatch.setattr(batch, "run", ended)
    done = CliRunner().invoke(cli.app, ["info", str(texts / "*.txt")])
    assert done.exit_code != 0
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


# --- every verb of many files ---------------------------------------------------------------------

Change = Callable[[Path], None]
# The words of each verb, then the inputs by their names; SRC is what there are several of. All
# inputs are written as the few bytes that no verb ever reads here.
VERBS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "simplify": (
        ("SRC.obj", "-o", "out", "--faces", "9", "--importance", "w.npy"),
        ("s0.obj", "s0.mtl", "skin.png", "w.npy"),
    ),
    "lod": (("SRC.obj", "-o", "out"), ("s0.obj", "s0.mtl", "skin.png")),
    "depth": (
        ("SRC.pgm", "-o", "out", "--points", "9", "--intrinsics", "camera.json"),
        ("s0.pgm", "camera.json"),
    ),
    "compare": (
        ("original.obj", "SRC.obj", "--table", "t.csv"),
        ("s0.obj", "s0.mtl", "original.obj", "original.mtl"),
    ),
    "info": (
        ("SRC.3d", "--calibration", "db.xml", "--table", "t.csv"),
        ("s0.3d", "s0.pose", "db.xml"),
    ),
    "view": (
        ("SRC.obj", "-o", "out", "--calibration", "db.xml", "--color", "c.png"),
        ("s0.obj", "s0.mtl", "skin.png", "db.xml", "c.png"),
    ),
    "convert": (
        ("SRC.obj", "-o", "out", "--calibration", "db.xml"),
        ("s0.obj", "s0.mtl", "skin.png", "db.xml"),
    ),
    "inspect": (
        ("SRC.bin", "--table", "t.csv", "--lattice", "lattice.json", "--key", "k.key",
         "--calibration", "db.xml"),
        ("s0.bin", "s0.bin.wm", "lattice.json", "k.key", "db.xml"),
    ),
    "forge lidar": (
        ("ctp", "SRC.bin", "-o", "out", "--hoax", "original.obj", "--lattice", "lattice.json"),
        ("s0.bin", "original.obj", "original.mtl", "lattice.json"),
    ),
    "forge stream": (
        ("SRC.mkv", "-o", "out", "--type", "2", "--pose", "pose.bvh", "--background",
         "mkv:scene.mkv"),
        ("s0.mkv", "pose.bvh", "scene.mkv"),
    ),
    "watermark embed": (("SRC", "--key", "k.key", "-o", "out"), DRIVE := (
        "d0/velodyne/0.bin", "d0/image_02/0.png", "calib_velo_to_cam.txt", "k.key",
    )),
    "watermark verify": (("SRC", "--key", "k.key", "--table", "t.csv"), ()),
    "alert run": (
        ("SRC", "--key", "k.key", "-o", "out", "--calibration", "db.xml", "--rigs", "rigs.json"),
        (*DRIVE, "d0/velodyne/0.bin.wm", "db.xml", "rigs.json"),
    ),
    "phantom render": (("SRC.mkv", "-o", "out"), ("s0.mkv",)),
    "capture export": (("SRC.mkv", "-o", "out"), ("s0.mkv",)),
    "capture info": (("SRC.mkv", "--intrinsics", "camera.json", "--table", "t.csv"),
                     ("s0.mkv", "camera.json")),
}  # fmt: skip


def test_every_verb_of_many_files_is_looked_at() -> None:
    found = 0
    for info in pkgutil.iter_modules(cli.__path__):
        module = importlib.import_module(f"manip3d.cli.{info.name}")
        found += len(re.findall(r"^@over_files\(", inspect.getsource(module), re.MULTILINE))
    assert found == len(VERBS)


@pytest.mark.parametrize("verb", [v for v in VERBS if v != "watermark verify"])
def test_a_changed_input_is_another_task(
    verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words, inputs = VERBS[verb]
    _write_inputs()
    before = _keys_of(verb, words, monkeypatch)
    assert _keys_of(verb, words, monkeypatch) == before
    for name in inputs:
        if name == "k.key":
            Path(name).unlink()
            key_file(Path(name), bytes(range(1, 33)))
        else:
            rewrite(Path(name), Path(name).read_bytes()[:-1] + b" ")
        after = _keys_of(verb, words, monkeypatch)
        assert after[0] != before[0], name
        before = after


def _write_inputs() -> None:
    """Two sources of each kind, and all that they and the options name."""
    for drive in ("d0", "d1"):
        for name in ("velodyne/0.bin", "velodyne/0.bin.wm", "image_02/0.png"):
            Path(drive, name).parent.mkdir(parents=True, exist_ok=True)
            Path(drive, name).write_bytes(bytes(16))
    for stem in ("s0", "s1", "original"):
        Path(f"{stem}.obj").write_text(f"mtllib {stem}.mtl\nv 0 0 0\n\n")
        Path(f"{stem}.mtl").write_text("newmtl a\nmap_Kd skin.png\n\n")
        for suffix in (".bin", ".bin.wm", ".3d", ".pose", ".mkv", ".pgm"):
            Path(f"{stem}{suffix}").write_bytes(bytes(16))
    for name in ("skin.png", "w.npy", "db.xml", "c.png", "lattice.json", "camera.json", "pose.bvh",
                 "scene.mkv", "rigs.json", "calib_velo_to_cam.txt"):  # fmt: skip
        Path(name).write_bytes(bytes(16))
    key_file(Path("k.key"))


def _keys_of(verb: str, words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The keys of the tasks of a command, none of which is run."""
    found: dict[str, str] = {}

    def not_run(tasks: Mapping[str, Any], *rest: Any, **options: Any) -> Finished:
        found.update({arguments[1]: key for key, (_, arguments) in tasks.items()})
        return Finished(failed=dict.fromkeys(tasks, "not run"), details={k: {} for k in tasks})

    monkeypatch.setattr(_run, "run_stored", not_run)
    several = {"SRC": ["d0", "d1"]} | {
        f"SRC{suffix}": [f"s0{suffix}", f"s1{suffix}"]
        for suffix in (".obj", ".pgm", ".3d", ".bin", ".mkv")
    }
    for old in ("out", "t.csv", "t.rows"):
        shutil.rmtree(old, ignore_errors=True)
        Path(old).unlink(missing_ok=True)
    line = [one for word in words for one in several.get(word, [word])]
    done = CliRunner().invoke(cli.app, [*verb.split(), *line])
    assert len(found) == 2, done.output
    return [found[name] for name in sorted(found, key=by_number)]


# --- two of them from end to end ------------------------------------------------------------------


def run(*arguments: object) -> tuple[int, str]:
    done = CliRunner().invoke(cli.app, [str(each) for each in arguments])
    return done.exit_code, done.stderr


def test_a_changed_original_gives_other_distances(tmp_path: Path) -> None:
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    original, table = tmp_path / "original.obj", tmp_path / "t.csv"
    Mesh(corners, [[0, 1, 2]]).write(original)
    (tmp_path / "light").mkdir()
    for name in "ab":
        Mesh(corners, [[0, 1, 2]]).write(tmp_path / "light" / f"{name}.obj")
    command = ("compare", original, tmp_path / "light", "--table", table, "--jobs", 1)
    assert run(*command)[0] == 0
    first = table.read_text()
    Mesh([[0, 0, 1], [1, 0, 1], [0, 1, 1]], [[0, 1, 2]]).write(original)
    assert run(*command)[0] == 0
    assert table.read_text() != first
    assert "2 from an earlier run" in run(*command)[1]


def test_a_repeated_verification_sees_what_was_destroyed_since(tmp_path: Path) -> None:
    import numpy as np

    from watermark_scans import grid_scan

    key, out = key_file(tmp_path / "k.key"), tmp_path / "out"
    (tmp_path / "scans").mkdir()
    for number in range(2):
        rows = np.column_stack([grid_scan(3000, number), np.zeros(3000)]).astype("<f4")
        (tmp_path / "scans" / f"s{number}.bin").write_bytes(rows.tobytes())
    command = ("watermark", "embed", tmp_path / "scans", "--key", key, "-o", out, "--jobs", 1)
    assert run(*command)[0] == 0
    verify = ("watermark", "verify", out, "--key", key, "--table", tmp_path / "v.csv", "--jobs", 1)
    assert run(*verify)[0] == 0
    with (out / "s0.bin.wm").open("ab") as record:
        record.write(b"x")
    (out / "s1.bin.wm").unlink()
    code, told = run(*verify)
    assert (code, "earlier run" in told) == (4, False)
