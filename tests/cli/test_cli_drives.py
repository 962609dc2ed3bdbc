"""``watermark`` and ``alert run`` over several drives: one piece of work each, with one table."""

from __future__ import annotations

import csv
import json
import re
import shutil
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import command_line
from manip3d.errors import Error
from watermark_scans import grid_scan, key_file


class Done(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


def run(*arguments: str) -> Done:
    """The command in this process; a typed error is a line and exit code 1, as in a shell."""
    done = command_line.run(*arguments)
    if done.exception is None or isinstance(done.exception, SystemExit):
        return Done(done.exit_code, done.stdout, done.stderr)
    if not isinstance(done.exception, Error | OSError):
        raise done.exception
    return Done(1, done.stdout, f"{done.stderr}{done.exception}")


def write_drive(folder: Path, frames: int, seed: int) -> Path:
    scans = folder / "velodyne_points" / "data"
    scans.mkdir(parents=True)
    for number in range(frames):
        points = grid_scan(3000, seed=100 * seed + number)
        rows = np.column_stack([points, np.zeros(len(points))]).astype("<f4")
        (scans / f"{number:010d}.bin").write_bytes(rows.tobytes())
    return folder


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    """Two cars on one day, and one on another."""
    for number, name in enumerate(("monday/car_a", "monday/car_b", "tuesday/car_a")):
        write_drive(tmp_path / "fleet" / name, 2 + number, number)
    return tmp_path / "fleet"


@pytest.fixture
def key(tmp_path: Path) -> Path:
    return key_file(tmp_path / "sensor.key")


@pytest.fixture
def signed(fleet: Path, key: Path, tmp_path: Path) -> Path:
    out = tmp_path / "signed"
    done = run("watermark", "embed", str(fleet), "--key", str(key), "-o", str(out), "--jobs", "1")
    assert done.returncode == 0, done.stderr
    assert "3 sources in" in done.stderr
    return out


def verified(*arguments: object) -> tuple[int, list[dict[str, object]], str]:
    jobs = () if "--jobs" in arguments else ("--jobs", "1")
    done = run("watermark", "verify", *(str(a) for a in arguments), *jobs, "--json")
    return done.returncode, json.loads(done.stdout or "[]"), done.stderr


def damage(drive: Path) -> None:
    scan = drive / "velodyne_points" / "data" / "0000000001.bin"
    rows = np.fromfile(scan, "<f4").reshape(-1, 4)
    rows[5, 0] += 1.0
    scan.write_bytes(rows.tobytes())


def test_each_drive_is_a_session_of_its_own(signed: Path, key: Path) -> None:
    with (signed / "results.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["num_frames"] for row in rows] == ["2", "3", "4"]
    assert len({row["session"] for row in rows}) == 3
    code, found, _ = verified(signed, "--key", key, "--jobs", 2)
    assert code == 0
    assert [row["verdict"] for row in found] == ["authentic"] * 3
    assert [row["verdicts"] for row in found] == [{"authentic": n} for n in (2, 3, 4)]
    # A pattern, and one drive by itself.
    assert len(verified(str(signed / "*" / "car_a"), "--key", key)[1]) == 2
    assert verified(signed / "monday" / "car_b", "--key", key)[0] == 0


def test_the_table_of_drives_has_no_columns_for_frames(signed: Path) -> None:
    with (signed / "results.csv").open() as stream:
        columns = next(csv.reader(stream))
    assert "num_frames" in columns
    assert not [name for name in columns if name.startswith("frames.")]


def test_the_gravest_drive_gives_the_exit_code(signed: Path, key: Path, tmp_path: Path) -> None:
    shutil.copytree(signed / "monday", tmp_path / "copies" / "monday")
    copies = tmp_path / "copies"
    (copies / "monday" / "car_a" / "velodyne_points" / "data" / "0000000000.bin.wm").unlink()
    assert verified(copies, "--key", key)[0] == 4
    damage(copies / "monday" / "car_b")
    code, found, _ = verified(copies, "--key", key)
    assert code == 3
    assert [row["verdict"] for row in found] == ["undecidable", "tampered"]
    # A scan that cannot be read is one undecidable frame of its drive.
    unread = copies / "monday" / "car_a" / "velodyne_points" / "data" / "0000000001.bin"
    unread.write_bytes(b"x")
    code, found, _ = verified(copies, "--key", key)
    assert code == 3
    assert [row["verdict"] for row in found] == ["undecidable", "tampered"]
    # A drive that fails is told, and the others go on.
    for each in unread.parent.iterdir():
        each.unlink()
    done = run("watermark", "verify", str(copies), "--key", str(key), "--table",
               str(tmp_path / "table.csv"), "--jobs", "1")  # fmt: skip
    assert done.returncode == 3  # tampering outranks it
    assert "1 of 2 sources failed" in done.stderr
    assert "expected scans, found none" in done.stderr


def test_a_verdict_is_of_this_moment(signed: Path, key: Path, tmp_path: Path) -> None:
    table = ("--table", tmp_path / "table.csv")
    for _ in range(2):
        code, _, told = verified(signed, "--key", key, *table)
        assert (code, "from an earlier run" in told) == (0, False)
    damage(signed / "monday" / "car_a")
    assert verified(signed, "--key", key, *table)[0] == 3
    key.unlink()
    key_file(key, bytes(range(1, 33)))
    code, found, _ = verified(signed, "--key", key, *table)
    assert code == 4
    assert {row["verdict"] for row in found} == {"undecidable"}


def test_a_stopped_run_embeds_again_what_is_not_whole(fleet: Path, key: Path, signed: Path) -> None:
    again = ("watermark", "embed", str(fleet), "--key", str(key), "-o", str(signed), "--jobs", "1")
    assert "3 from an earlier run" in run(*again).stderr
    lost = signed / "monday" / "car_b" / "velodyne_points" / "data" / "0000000002.bin"
    lost.unlink()
    assert "2 from an earlier run" in run(*again).stderr
    assert verified(signed, "--key", key)[0] == 0


def test_outputs_of_others_and_options_of_one_drive_are_refused(
    fleet: Path, key: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    (out / "monday" / "car_a").mkdir(parents=True)
    (out / "monday" / "car_a" / "mine").write_text("mine")
    done = run("watermark", "embed", str(fleet), "--key", str(key), "-o", str(out))
    assert "exists already" in done.stderr
    for option, value in (("state", "s"), ("report", "r.json"), ("record", "r.wm")):
        done = run("watermark", "verify", str(fleet), "--key", str(key), f"--{option}", value)
        assert f"--{option}: can only be given with one scan or drive" in done.stderr
        one = str(fleet / "monday" / "car_a")
        done = run("watermark", "verify", one, "--key", str(key), f"--{option}", value,
                   "--table", str(tmp_path / "table.csv"))  # fmt: skip
        assert f"--{option}: cannot be given with --table, --to or --dask" in done.stderr
    done = run("alert", "run", one, "--key", str(key), "--state", "s", "--to", ".json", "-o", "o")
    assert "--state: cannot be given with --table, --to or --dask" in done.stderr
    done = run("watermark", "verify", "s3://bucket/drives", str(fleet), "--key", str(key))
    assert "expected a drive on this machine" in done.stderr
    (tmp_path / "empty").mkdir()
    done = run("watermark", "verify", str(tmp_path / "empty"), str(fleet), "--key", str(key))
    assert "expected drives in KITTI's layout, or files (.pcd.bin, .bin, " in done.stderr


def test_several_vehicles_are_on_one_page(signed: Path, key: Path, tmp_path: Path) -> None:
    damage(signed / "monday" / "car_b")
    out = tmp_path / "alerts"
    done = run("alert", "run", str(signed), "--key", str(key), "-o", str(out), "--jobs", "1")
    assert done.returncode == 3, done.stderr
    assert "3 sources in" in done.stderr
    pages = sorted(str(path.relative_to(out)) for path in out.rglob("*.html"))
    assert pages == ["monday/car_a.html", "monday/car_b.html", "overview.html",
                     "tuesday/car_a.html"]  # fmt: skip
    page = (out / "overview.html").read_text()
    assert "3 vehicles" in page
    assert "1 tampered, 2 authentic" in page
    assert re.search(r"worst: frame \d+ \(scan \d{10}\)", page)
    order = re.findall(r"href='([^']*)'", page)
    assert order[0] == "monday/car_b.html"  # the gravest first
    assert set(order) == set(pages) - {"overview.html"}
    assert page.count("aria-label='risk score'") == 3
    # Two cars have the same name: their folders tell them apart.
    assert re.findall(r"<a href='[^']*'>([^<]*)</a>", page) == [
        "car_b", "monday/car_a", "tuesday/car_a"
    ]  # fmt: skip
    assert not re.search(r"(src|href)=.?https?:", page)


def test_the_page_of_all_vehicles_replaces_that_of_none(fleet: Path, tmp_path: Path) -> None:
    shutil.move(fleet / "monday" / "car_a", fleet / "overview")
    out = tmp_path / "alerts"
    done = run("alert", "run", str(fleet), "-o", str(out), "--jobs", "1")
    assert done.returncode == 1
    assert "overview: expected another name, because overview.html has all sources" in done.stderr
    assert not out.exists()
    done = run("alert", "run", str(fleet), "-o", str(out), "--jobs", "1", "--to", ".json")
    assert done.returncode == 4, done.stderr
    assert {path.name for path in out.iterdir()} >= {"overview.html", "overview.json"}


def test_a_drive_among_several_has_the_name_of_its_folder(
    fleet: Path, key: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(fleet / "monday" / "car_a")
    out = tmp_path / "signed"
    done = run("watermark", "embed", ".", "../car_b", "--key", str(key), "-o", str(out),
               "--jobs", "1")  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert {path.parent.parent.parent for path in out.rglob("*.bin")} == {
        out / "car_a", out / "car_b"
    }  # fmt: skip


def test_dask_gives_the_same_verdicts(signed: Path, key: Path) -> None:
    pytest.importorskip("distributed")
    damage(signed / "tuesday" / "car_a")
    code, found, _ = verified(signed, "--key", key, "--dask", "local", "--jobs", 2)
    assert code == 3
    assert [row["verdict"] for row in found] == ["authentic", "authentic", "tampered"]


def test_hidden_scans_are_not_signed_and_are_noticed(
    fleet: Path, key: Path, tmp_path: Path
) -> None:
    """macOS leaves ._a.bin beside a.bin on other file systems; some readers would take them."""
    drive = fleet / "monday" / "car_a"
    scans = Path("velodyne_points", "data")
    for number in range(2):
        (drive / scans / f"._{number:010d}.bin").write_bytes(b"\0\5\x16\7" + bytes(60))
    out = tmp_path / "signed"
    done = run("watermark", "embed", str(drive), "--key", str(key), "-o", str(out))
    assert done.returncode == 0, done.stderr
    assert not [*(out / scans).glob("._*")]
    order = ("watermark", "verify", str(out), "--key", str(key), "--json")
    assert run(*order).returncode == 0
    shutil.copy(drive / scans / "._0000000000.bin", out / scans / ".0000000000.bin")
    done = run(*order)
    assert done.returncode == 4
    found = [each["scan"] for each in json.loads(done.stdout)["frames"]
             if each["verdict"] != "authentic"]  # fmt: skip
    assert found == [".0000000000.bin"]
