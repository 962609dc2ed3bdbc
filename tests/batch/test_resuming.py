"""A stored result of an earlier run is used again only if all of its inputs are unchanged."""

from __future__ import annotations

import gzip
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
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from gltf_files import PNG, glb
from manip3d import Material, Mesh, Texture, batch, capture, cli, io
from manip3d._util import fingerprint
from manip3d._util.paths import by_number
from manip3d.batch import Rows, _run
from manip3d.batch._places import Place
from manip3d.batch._stamps import Stamps, stamp_of_folder, stamp_of_info
from manip3d.batch._stored import Finished
from manip3d.errors import InputError
from manip3d.io._remote import companions, named_beside
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
    """Run the batch; return the number of files whose result is not from an earlier run."""
    summary = batch.run(upper, folder, table=folder.parent / "t.csv", jobs=1, **options)
    return len(summary.rows) - summary.resumed


def rewrite(path: Path, content: bytes) -> None:
    """Replace the content by another of the same size, and set the time of modification back."""
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


def test_all_that_a_mesh_names_is_an_input(tmp_path: Path) -> None:
    folder = tmp_path / "meshes"
    folder.mkdir()
    (folder / "a.obj").write_text("mtllib one.mtl two.mtl\nv 0 0 0\n")
    (folder / "b.ply").write_text("ply\ncomment TextureFile skin.png\nend_header\n")
    for name in ("one.mtl", "two.mtl", "skin.png"):
        (folder / name).write_text("1")

    def again() -> list[str]:
        made: list[str] = []
        batch.run(
            _nothing, folder, suffixes=[".obj", ".ply"], table=tmp_path / "t.csv", jobs=1,
            progress=lambda fraction, name: made.append(Path(name).name),
        )  # fmt: skip
        return sorted({name for name in made if name in ("a.obj", "b.ply")})

    again()
    for name, mesh in (("one.mtl", "a.obj"), ("two.mtl", "a.obj"), ("skin.png", "b.ply")):
        assert again() == []
        rewrite(folder / name, b"2")
        assert again() == [mesh]


TEXTURE = "ply\ncomment TextureFile my skin.png\nend_header\ncomment TextureFile not this.png\n"


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("a.obj", "mtllib a.mtl b.mtl\n", ["a.mtl b.mtl", "a.mtl", "b.mtl"]),
        ("a.obj", "\ufeff  mtllib\ta.mtl  \r\nv 0 0 0\r\n", ["a.mtl"]),
        ("a.obj", "# old \\\nmtllib a.mtl \\\nb.mtl\n", ["a.mtl  b.mtl", "a.mtl", "b.mtl"]),
        ("a.obj", "v 0 0 0\rmtllib a.mtl\rv 0 0 0\r", ["a.mtl"]),
        ("a.obj", "v 0 0 0\n" * 300_000 + "mtllib a.mtl", ["a.mtl"]),
        ("a.mtl", "MAP_KD my skin.png\n", ["my skin.png"]),
        ("a.mtl", "map_Kd -bm 1 my skin.png\n",
         ["-bm 1 my skin.png", "1 my skin.png", "my skin.png", "skin.png"]),
        ("a.ply", TEXTURE, ["my skin.png"]),
        ("a.gltf", '{"uri":\n"a%20b.bin", "uri": "data:,", "uri": "../c.bin"}', ["a b.bin"]),
        ("a.gltf", r'{"uri": "maps\/\u00e4.png"}', ["maps/ä.png"]),
        ("a.glb", glb(b'{"images": [{"uri": "a.png"}]}', b'"uri": "b.png"'), ["a.png"]),
        ("a.glb", "glTF", []),
        ("a.dae", "<init_from>\nmaps/a%20&amp;.png</init_from>", ["maps/a &.png", "a &.png"]),
        ("a.dae", "<init_from><ref>file:///C:/b.png</ref></init_from>", ["b.png"]),
    ],
)  # fmt: skip
@pytest.mark.parametrize("compressed", [False, True])
def test_the_names_in_a_file_are_those_that_its_reader_takes(
    name: str, content: str | bytes, expected: list[str], compressed: bool, tmp_path: Path
) -> None:
    path = tmp_path / (f"{name}.gz" if compressed else name)
    written = content.encode() if isinstance(content, str) else content
    path.write_bytes(gzip.compress(written) if compressed else written)
    assert [str(one) for one in companions(path)] == expected


@pytest.mark.parametrize("suffix", [".pcap", ".pcapng"])
@pytest.mark.parametrize("beside", ["drive_a_part", "drive_a_part_0", "drive_a", "drive"])
def test_an_ousters_metadata_are_a_companion_of_its_packets(
    beside: str, suffix: str, tmp_path: Path
) -> None:
    recording, metadata = tmp_path / f"drive_a_part{suffix}", tmp_path / f"{beside}.json"
    recording.write_bytes(b"packets")
    metadata.write_text('{"beam_altitude_angles": [1]}')
    assert capture.scan_address(str(recording)) == f"ouster:{recording}"
    before = Stamps().stamp_of_companions(str(recording))
    metadata.write_text('{"beam_altitude_angles": [1, 2]}')
    assert Stamps().stamp_of_companions(str(recording)) != before


def test_an_ousters_metadata_are_downloaded_with_its_packets(
    request: pytest.FixtureRequest,
) -> None:
    fsspec = pytest.importorskip("fsspec", reason="the extra 'remote' is not installed")
    place, memory = f"memory://ouster-{os.getpid()}", fsspec.filesystem("memory")
    request.addfinalizer(lambda: memory.rm(place, recursive=True))
    memory.pipe(f"{place}/drive.pcap", b"packets")
    memory.pipe(f"{place}/drive_0.json", b'{"beam_altitude_angles": [1]}')
    with io.local_copy(f"{place}/drive.pcap") as path:
        assert capture.scan_address(str(path)) == f"ouster:{path}"


def test_the_start_of_a_remote_glb_tells_what_it_names(request: pytest.FixtureRequest) -> None:
    fsspec = pytest.importorskip("fsspec", reason="the extra 'remote' is not installed")
    place, memory = f"memory://named-{os.getpid()}", fsspec.filesystem("memory")
    request.addfinalizer(lambda: memory.rm(place, recursive=True))
    content = glb({"images": [{"uri": "a.png"}]}, bytes(1 << 20))
    memory.pipe(f"{place}/a.glb", content)
    memory.pipe(f"{place}/a.png", b"picture")
    assert list(named_beside(f"{place}/a.glb")) == [f"{place}/a.png"]
    with io.local_copy(f"{place}/a.glb") as path:
        assert path.read_bytes() == content
        assert path.with_name("a.png").read_bytes() == b"picture"


@pytest.mark.parametrize("suffix", [".obj", ".mtl"])
def test_blank_lines_are_read_in_linear_time(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"\n" * 400_000)  # a quarter of an hour where the time grows with the square
    begin = time.process_time()
    assert list(companions(path)) == []
    assert time.process_time() - begin < 5


def test_a_run_behind_a_url_is_resumed(request: pytest.FixtureRequest) -> None:
    fsspec = pytest.importorskip("fsspec", reason="the extra 'remote' is not installed")
    place = f"memory://resuming-{os.getpid()}"
    memory = fsspec.filesystem("memory")
    request.addfinalizer(lambda: memory.rm(place, recursive=True))
    for name in ("a.obj", "b.obj"):
        memory.pipe(f"{place}/{name}", b"mtllib a.mtl\n")
    memory.pipe(f"{place}/a.mtl", b"1")

    def again(output: str | None) -> int:
        table = f"{place}/table.csv"
        options = {} if output is None else {"rename": lambda name: f"{name}.txt"}
        summary = batch.run(
            _copied, f"{place}/*.obj", output, table=table, jobs=1, overwrite=False, **options
        )  # fmt: skip
        assert summary.failed == 0, summary.rows
        return len(summary.rows) - summary.resumed

    for output in (None, f"{place}/out", place):  # the last one beside the sources
        made = [again(output) for _ in range(3)]
        assert made == [2, 0, 0], output
        memory.pipe(f"{place}/a.mtl", str(output).encode())
        assert [again(output), again(output)] == [2, 0], output
        memory.rm(f"{place}/table.rows", recursive=True)
        memory.rm(f"{place}/table.csv")


def test_a_folder_that_cannot_be_listed_costs_rows_and_not_the_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    memory = pytest.importorskip("fsspec", reason="needs the extra 'remote'").filesystem("memory")

    def refused(*arguments: object, **options: object) -> None:
        raise PermissionError("no listing")

    monkeypatch.setattr(type(memory), "find", refused)
    first, second = Stamps(), Stamps()
    name = "memory://no-listing/a.obj"
    assert first.stamp_of_companions(name) == first.stamp_of_companions("memory://no-listing/b.obj")
    assert first.stamp_of_companions(name) != second.stamp_of_companions(name)


@pytest.mark.parametrize(
    "told", ["ETag", "Content-MD5", "Digest", "Last-Modified", "md5Hash", "created", "mtime"]
)
def test_whatever_a_store_says_of_the_content_counts(told: str) -> None:
    info = {"name": "a", "size": 1, "mtime": 5.0, "type": "file"}
    assert stamp_of_info(info | {told: "1"}) != stamp_of_info(info | {told: "2"})


def test_a_file_behind_a_url_of_this_machine_cannot_be_set_back(texts: Path) -> None:
    pytest.importorskip("fsspec", reason="the extra 'remote' is not installed")
    url, table = f"file://{texts}/*.txt", texts.parent / "t.csv"

    def again() -> int:
        return 2 - batch.run(_nothing, url, table=table, jobs=1).resumed

    assert [again(), again()] == [2, 0]
    rewrite(texts / "a.txt", b"c")
    assert [again(), again()] == [1, 0]


def _copied(source: Path, output: Path | None) -> dict[str, Any]:
    if output is not None:
        shutil.copyfile(source, output)
    return {}


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


def test_two_runs_of_one_thing_lose_no_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = str(tmp_path / "t.rows")
    first, second = (Rows(folder, {"ratio": 0.5}) for _ in range(2))
    for key, rows in (("a", first), ("b", second)):
        rows.save(key, {"faces": 500})
        rows.flush()
    both = Rows(folder, {"ratio": 0.5})
    assert both.load("a") == both.load("b") == {"faces": 500}
    names = Place.names
    monkeypatch.setattr(Place, "names", lambda place: [*names(place), "000009-gone.jsonl"])
    assert Rows(folder, {"ratio": 0.5}).load("a") == {"faces": 500}


@pytest.mark.parametrize(
    "asked", [{"size": (1, 2)}, {"limit": float("nan")}, {"level": {9: 1, 10: 2}}], ids=str
)
def test_options_are_compared_as_json(asked: dict[str, Any], tmp_path: Path) -> None:
    folder = str(tmp_path / "t.rows")
    first = Rows(folder, asked)
    first.save("a", {"faces": 500})
    first.flush()
    assert Rows(folder, asked).load("a") == {"faces": 500}
    with pytest.raises(InputError, match="other options"):
        Rows(folder, {"size": (1, 3)})


def test_a_saved_row_is_loaded_as_it_will_be_by_the_next_run(tmp_path: Path) -> None:
    folder = str(tmp_path / "t.rows")
    rows = Rows(folder, {})
    saved = rows.save("a", {"size": (1, 2), "levels": {9: 1, 10: 2}})
    assert saved == rows.load("a") == {"size": [1, 2], "levels": {"9": 1, "10": 2}}
    assert repr(rows).endswith("1 row>")
    rows.flush()
    assert Rows(folder, {}).load("a") == saved


def test_parts_are_numbered_beyond_a_million(tmp_path: Path) -> None:
    folder = tmp_path / "t.rows"
    for number, faces in ((999_999, 1), (1_000_000, 2)):
        rows = Rows(str(folder), {})
        rows._next = number
        rows.save("a", {"faces": faces})
        rows.flush()
    rows = Rows(str(folder), {})
    assert rows.load("a") == {"faces": 2}  # the later one
    rows.save("b", {"faces": 3})
    rows.flush()
    assert len(list(folder.glob("1000001-*.jsonl"))) == 1


def test_a_folder_that_is_removed_meanwhile_begins_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = str(tmp_path / "t.rows")
    with monkeypatch.context() as patch:
        patch.setattr(Place, "names", lambda place: ["run.json"])
        rows = Rows(folder, {})
    rows.save("a", {"faces": 500})
    rows.flush()
    assert Rows(folder, {}).load("a") == {"faces": 500}


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
    told: list[str] = []

    def ended(*arguments: object, **options: object) -> None:
        told.append("begun")
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5)
        except KeyboardInterrupt:
            told.append("like Ctrl-C")
            raise

    monkeypatch.setattr(batch, "run", ended)
    done = CliRunner().invoke(cli.app, ["info", str(texts / "*.txt")])
    assert told == ["begun", "like Ctrl-C"]
    assert done.exit_code == 130
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


# --- every verb of many files ---------------------------------------------------------------------

# The words of each verb, then the inputs by their names; SRC is what there are several of. All
# inputs are written as the few bytes that no verb ever reads here.
VERBS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "simplify": (
        ("SRC.obj", "-o", "out", "--faces", "9", "--importance", "w.npy"),
        ("s0.obj", "s0.mtl", "skin.png", "w.npy"),
    ),
    "lod": (("SRC.ply", "-o", "out"), ("s0.ply", "skin.png")),
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
        ("SRC.pgm", "-o", "out", "--color", "c.png"),
        ("s0.pgm", "c.png"),
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
        ("spoof", "SRC.bin", "-o", "out", "--hoax", "original.obj", "--lattice", "lattice.json"),
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


@pytest.mark.parametrize(
    ("words", "beside"),
    [
        (("capture", "info", "SRC_depth.mat", "--table", "t.csv"), "s0_skeleton.mat"),
        (("phantom", "render", "SRC_depth.mat", "-o", "out"), "../Skeleton/s0_skeleton.mat"),
        (("info", "SRC.pcap", "--table", "t.csv"), "s0.json"),
        (("inspect", "SRC.pcap", "--table", "t.csv"), "s0_0.json"),
        (("convert", "SRC_part.pcap", "-o", "out"), "s0.json"),
    ],
)
def test_files_that_are_found_by_a_sources_name_are_inputs(
    words: tuple[str, ...], beside: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for source in ("s0", "s1"):
        for ending in ("_depth.mat", ".pcap", "_part.pcap"):
            Path(f"{source}{ending}").write_bytes(bytes(16))
    before = _keys_of("", words, monkeypatch)
    for text in ('{"beam_altitude_angles": 1}', '{"beam_altitude_angles": 2}'):
        Path(beside).parent.mkdir(exist_ok=True)
        Path(beside).write_text(text)
        after = _keys_of("", words, monkeypatch)
        assert after[0] != before[0]
        assert after[1] == before[1]
        before = after


def test_pictures_of_another_renderer_are_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    _write_inputs()
    keys = []
    for renderer in ("pyvista", "chromium", "pyvista"):
        monkeypatch.setenv("MANIP3D_RENDERER", renderer)
        keys.append(_keys_of("view", ("SRC.ply", "-o", "out", "--to", ".png"), monkeypatch))
    assert keys[0] == keys[2]
    assert not set(keys[0]) & set(keys[1])


@pytest.mark.parametrize(
    ("name", "is_shown"),
    [
        ("authenticate/lattice.json", False),
        ("modify/joints.csv", False),
        ("study/templates/a.toml", False),
        ("report/templates/a.html", True),
        ("viewer/dist/viewer.js", True),
        ("viewer/node_modules/a/b.js", None),
    ],
)
def test_what_the_package_reads_of_itself_is_a_part_of_its_fingerprint(
    name: str, is_shown: bool | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "manip3d"
    monkeypatch.setattr(fingerprint, "__file__", str(package / "_util" / "fingerprint.py"))
    functions = (fingerprint.code_fingerprint, fingerprint.presentation_fingerprint)
    before = [function.__wrapped__() for function in functions]
    (package / name).parent.mkdir(parents=True)
    (package / name).write_text("a table")
    after = [function.__wrapped__() for function in functions]
    assert (before[0] != after[0]) == (is_shown is False)
    assert (before[1] != after[1]) == (is_shown is True)


def test_rows_of_other_verbs_or_reports_are_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    _write_inputs()
    before = _keys_of("lod", VERBS["lod"][0], monkeypatch)
    monkeypatch.setattr(fingerprint, "presentation_fingerprint", lambda: "of other code")
    assert not set(before) & set(_keys_of("lod", VERBS["lod"][0], monkeypatch))


def _write_inputs() -> None:
    """Write two sources of each kind, and all files that they and the options name."""
    for drive in ("d0", "d1"):
        for name in ("velodyne/0.bin", "velodyne/0.bin.wm", "image_02/0.png"):
            Path(drive, name).parent.mkdir(parents=True, exist_ok=True)
            Path(drive, name).write_bytes(bytes(16))
    for stem in ("s0", "s1", "original"):
        Path(f"{stem}.obj").write_text(f"mtllib {stem}.mtl\nv 0 0 0\n\n")
        Path(f"{stem}.mtl").write_text("newmtl a\nmap_Kd skin.png\n\n")
        Path(f"{stem}.ply").write_text("ply\ncomment TextureFile skin.png\nend_header\n\n")
        for suffix in (".bin", ".bin.wm", ".3d", ".pose", ".mkv", ".pgm"):
            Path(f"{stem}{suffix}").write_bytes(bytes(16))
    for name in ("skin.png", "w.npy", "db.xml", "c.png", "lattice.json", "camera.json", "pose.bvh",
                 "scene.mkv", "rigs.json", "calib_velo_to_cam.txt"):  # fmt: skip
        Path(name).write_bytes(bytes(16))
    key_file(Path("k.key"))


def _keys_of(verb: str, words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the keys of the tasks of a command without running them."""
    found: dict[str, str] = {}

    def not_run(tasks: Mapping[str, Any], *rest: Any, **options: Any) -> Finished:
        found.update({arguments[1]: key for key, (_, arguments) in tasks.items()})
        return Finished(failed=dict.fromkeys(tasks, "not run"), details={k: {} for k in tasks})

    monkeypatch.setattr(_run, "run_stored", not_run)
    several = {"SRC": ["d0", "d1"]} | {
        f"SRC{suffix}": [f"s0{suffix}", f"s1{suffix}"]
        for suffix in (
            ".obj",
            ".ply",
            ".pgm",
            ".3d",
            ".bin",
            ".mkv",
            ".pcap",
            "_depth.mat",
            "_part.pcap",
        )
    }
    for old in ("out", "t.csv", "t.rows"):
        shutil.rmtree(old, ignore_errors=True)
        Path(old).unlink(missing_ok=True)
    line = [one for word in words for one in several.get(word, [word])]
    done = CliRunner().invoke(cli.app, [*verb.split(), *line])
    assert len(found) == 2, done.output
    return [found[name] for name in sorted(found, key=by_number(found))]


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


@pytest.mark.parametrize("suffix", [".gltf", ".obj"])
def test_a_mesh_whose_companion_is_gone_is_written_again(suffix: str, tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    white = Material(textures={"base_color": Texture("a.png", PNG)})
    for number in range(2):
        Mesh(
            [[0, 0, 0], [1, 0, 0], [0, 1, number + 1]], [[0, 1, 2]],
            texcoords=[[0, 0], [1, 0], [0, 1]], face_texcoords=[[0, 1, 2]], face_material=[0],
            materials=[white],
        ).write(tmp_path / "meshes" / f"m{number}.glb")  # fmt: skip
    command = ("convert", tmp_path / "meshes", "-o", tmp_path / "out", "--to", suffix, "--jobs", 1)
    assert run(*command)[0] == 0
    assert "2 from an earlier run" in run(*command)[1]
    for name in map(str, companions(tmp_path / "out" / f"m0{suffix}")):
        if (tmp_path / "out" / name).is_file():
            (tmp_path / "out" / name).unlink()
            assert "(1 from an earlier run)" in run(*command)[1], name
            assert (tmp_path / "out" / name).is_file()
            break
    else:
        pytest.fail("no companions")


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
    assert "2 from an earlier run" in run(*command)[1]
    (out / "s0.bin.wm").unlink()
    code, told = run(*command)
    assert (code, "(1 from an earlier run)" in told) == (0, True)
    assert (out / "s0.bin.wm").is_file()
    verify = ("watermark", "verify", out, "--key", key, "--table", tmp_path / "v.csv", "--jobs", 1)
    assert run(*verify)[0] == 0
    with (out / "s0.bin.wm").open("ab") as record:
        record.write(b"x")
    (out / "s1.bin.wm").unlink()
    code, told = run(*verify)
    assert (code, "earlier run" in told) == (4, False)


@pytest.mark.parametrize("are_reversed", [False, True])
def test_parts_of_one_number_have_an_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, are_reversed: bool
) -> None:
    """Two runs at once can give two parts one number; folders list files in any order."""
    stores = [Rows(str(tmp_path), {}) for _ in range(2)]
    for run, (store, name) in enumerate(zip(stores, ("aaaaaaaa", "bbbbbbbb"), strict=True)):
        monkeypatch.setattr("secrets.token_hex", lambda _, name=name: name)
        store.save("key", {"run": run})
        store.flush()
    names = sorted((path.name for path in tmp_path.iterdir()), reverse=are_reversed)
    monkeypatch.setattr("manip3d.batch._rows.Place.names", lambda _: names)
    assert Rows(str(tmp_path), {}).load("key") == {"run": 1}
