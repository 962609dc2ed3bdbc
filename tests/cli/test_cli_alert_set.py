"""``manip3d forge alert-set``: its files, their truth, and a run that was stopped."""

from __future__ import annotations

import csv
import functools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import command_line
import manip3d
from manip3d.cli.alert_set import _begin
from manip3d.experiments import _alert_set
from manip3d.simulate import streets

pytest.importorskip("open3d", reason="the extra 'open3d' is not installed")


run = functools.partial(command_line.run, "forge", "alert-set")


def test_the_published_set_has_8735_attacks_of_1765_frames() -> None:
    counts = {
        name: sum(_alert_set.published_frames(drive, name) for drive in _alert_set.DRIVES)
        for name in _alert_set.ATTACKS
    }
    assert counts.pop("original") == 1765
    assert sum(counts.values()) == 8735


def _thinned(scan: Any) -> manip3d.LidarFrame:
    """Every eighth point: what is looked at here does not need all of them."""
    return manip3d.LidarFrame(scan.points[::8], scan.intensity[::8])


def test_a_frame_of_two_drives_with_its_attacks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_alert_set, "DRIVES", (1, 3))
    monkeypatch.setattr(_alert_set, "_as_frame", _thinned)
    monkeypatch.setattr(streets, "street", functools.cache(streets.street))  # a second for each
    out = tmp_path / "set"
    done = run(out, "--frames", 1, "--json")
    assert done.exit_code == 0, done.output
    assert "100%  drive_3-00000" in done.stderr  # no terminal: a line for each piece
    told = json.loads(done.stdout)
    assert told["attacks"]["original"] == {"wanted": 2, "written": 2}
    assert all(each["written"] <= each["wanted"] == 2 for each in told["attacks"].values())
    with (out / "manifest.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == told["scans"] == sum(e["written"] for e in told["attacks"].values()) > 8
    assert {row["file"] for row in rows} == {
        path.relative_to(out).as_posix() for path in out.rglob("*.bin.xz")
    }
    for row in rows:
        scan = manip3d.io.read_scan(out / row["file"])
        whole = manip3d.io.read_scan(out / f"drive_{row['drive']}/original/000000.bin.xz")
        added, moved, removed = (int(row[name]) for name in ("added", "moved", "removed"))
        assert scan.num_points == int(row["points"]) == whole.num_points + added - removed
        assert (added + moved + removed > 0) == (row["attack"] != "original")
        if row["attack"] == "translation":
            truth = json.loads((out / f"{row['file']}.truth.json").read_text())
            step = scan.points[truth["moved"]] - whole.points[truth["moved_from"]]
            assert np.linalg.norm(step, axis=1) == pytest.approx(3.0, abs=1e-4)

    # A run that was stopped after its first piece.
    manifest = (out / "manifest.csv").read_bytes()
    kept, again = (out / f"drive_{n}" / "original" / "000000.bin.xz" for n in (1, 3))
    written, content = kept.stat().st_mtime_ns, again.read_bytes()
    (out / "pieces" / "drive_3-00000.csv").unlink()
    (out / "manifest.csv").unlink()
    again.unlink()
    assert run(out, "--frames", 1, "-q").exit_code == 0
    assert kept.stat().st_mtime_ns == written
    assert again.read_bytes() == content
    assert (out / "manifest.csv").read_bytes() == manifest

    # Scans of finished pieces that are gone or cut.
    kept.write_bytes(kept.read_bytes()[:-1])
    (out / "drive_3" / "translation" / "000000.bin.xz.truth.json").unlink()
    assert run(out, "--frames", 1, "-q").exit_code == 0
    manip3d.io.read_scan(kept)
    assert (out / "drive_3" / "translation" / "000000.bin.xz.truth.json").is_file()
    assert (out / "manifest.csv").read_bytes() == manifest
    assert "it is of --seed 0 --frames 1" in str(run(out, "--seed", 1).exception)


def test_other_folders_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("kept")
    done = run(tmp_path / "mine", "--frames", 1)
    assert "expected an empty folder" in str(done.exception)
    assert "expected a folder's name" in str(run(tmp_path / "mine" / "notes.txt").exception)
    assert (tmp_path / "mine" / "notes.txt").read_text() == "kept"
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["notes.txt"]


def test_force_begins_anew_without_frames_of_another_set(tmp_path: Path) -> None:
    attacked = "drive_2/additive/000007.bin.xz"
    old = ["pieces/drive_2-00005.csv", "manifest.csv", "drive_2/original/000007.bin.xz",
           attacked, f"{attacked}.truth.json"]  # fmt: skip
    others = ["notes.txt", "drive_2/additive/best.bin.xz", "drive_2/mine/000007.bin.xz"]
    for name in (*old, *others, "set.json"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("{}")
    told = "of --seed 1 --frames all; it is of no options; --force begins anew"
    with pytest.raises(manip3d.InputError, match=told):
        _begin(tmp_path, {"seed": 1, "frames": None}, force=False)
    assert all((tmp_path / name).exists() for name in old)
    _begin(tmp_path, {"seed": 1}, force=True)
    left = {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file()}
    assert left == {*others, "set.json"}
    assert json.loads((tmp_path / "set.json").read_text()) == {"seed": 1}
