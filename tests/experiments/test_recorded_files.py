"""Experiments on recorded LiDAR: results depend on the bytes that they read, and say which."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from manip3d import datasets
from manip3d.experiments import Case, Plan, _recorded, detector_3, real_scans_6, registry, run
from manip3d.experiments import _runner as runner
from manip3d.report import write_report
from toy_experiments import experiment

RECORDED = ("detector-3", "real-scans-6", "table-7.2-cross-modal")


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A data folder with every registered LiDAR file, each of its own few bytes."""
    monkeypatch.setenv("MANIP3D_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("MANIP3D_CACHE", str(tmp_path / "cache"))
    for data_set in datasets.registry().values():
        for file in data_set.files if data_set.kind == "lidar" else ():
            path = tmp_path / "data" / file.path
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(file.path)
    return tmp_path / "data"


def recorded_cases(name: str) -> list[Case]:
    return [case for case in registry()[name].cases(Plan("real", "full")) if case.files]


def keys(name: str) -> set[str]:
    return {case.key({}, "") for case in recorded_cases(name)}


@pytest.mark.parametrize("name", RECORDED)
def test_a_result_depends_on_the_bytes_of_every_file_that_its_case_names(
    name: str, root: Path
) -> None:
    """A scan that another one had replaced got the result of the first."""
    before = keys(name)
    named = {path for case in recorded_cases(name) for path in case.files}
    assert before
    for path in named:
        old = (root / path).read_bytes()
        (root / path).write_bytes(b"another")
        changed = before - keys(name)
        assert len(changed) == sum(path in case.files for case in recorded_cases(name)), path
        (root / path).write_bytes(old)


@pytest.mark.parametrize("name", RECORDED)
def test_what_an_experiment_reads_is_registered(name: str, root: Path) -> None:
    """`data list` and `doctor` call data present that `reproduce --list` calls missing."""
    of_sets = {file.path for one in registry()[name].data for file in datasets.get(one).files}
    named = {path for case in recorded_cases(name) for path in case.files}
    assert named <= of_sets
    lidar = [one for one in registry()[name].data if datasets.get(one).kind == "lidar"]
    for one in lidar:  # no set is listed in vain
        assert named & {file.path for file in datasets.get(one).files}, one


def test_detector_3_depends_on_the_lattice_and_on_the_pasted_objects(root: Path) -> None:
    for case in recorded_cases("detector-3"):
        assert {*detector_3.TUNING, *detector_3.DONORS, *case.options["scans"]} == set(case.files)
    (root / detector_3.TUNING[3]).unlink()
    assert recorded_cases("detector-3") == []


def test_an_uncompressed_copy_is_as_good(root: Path) -> None:
    path = f"{real_scans_6._FOLDER}/room_scan1.ply.xz"
    (root / path).rename(root / path.removesuffix(".xz"))
    assert _recorded.located(path) == root / path.removesuffix(".xz")
    assert any(path in case.files for case in recorded_cases("real-scans-6"))
    (root / path.removesuffix(".xz")).unlink()
    with pytest.raises(datasets.DataMissingError, match=r"tls_rooms: lidar/tls/room_scan1.ply.xz"):
        _recorded.located(path)


def test_a_broken_drive_fails_its_own_case_alone(root: Path) -> None:
    (root / "lidar/kitti_object/velodyne/demo.bin.xz").unlink()
    (root / "lidar/kitti_object/velodyne").rmdir()
    cases = registry()["table-7.2-cross-modal"].cases(Plan("real", "quick"))
    assert {case.options["model"]: bool(case.files) for case in cases} == {
        "2011_09_26_drive_0002_sync": True,
        "2011_09_26_drive_0005_sync": True,
        "kitti_stereo2015": True,
        "kitti_object": False,
        "kitti_odometry/00": True,
    }


@pytest.mark.realdata
def test_recorded_files_are_listed_with_origin_and_licence(realdata, tmp_path: Path) -> None:
    realdata("lidar/tls/room_scan1.ply.xz")
    files = _recorded.sums(["lidar/tls/room_scan1.ply.xz"])
    (record,) = run([experiment(1, files=files)], tmp_path, jobs=1).results["data"]
    assert (record["name"], record["licence"]) == ("tls_rooms", "BSD-3-Clause")
    assert record["files"] == files


def listed(folder: Path) -> dict[str, list[dict[str, str]]]:
    found: dict[str, list[dict[str, str]]] = {}
    for record in json.loads((folder / "results.json").read_text())["data"]:
        found.setdefault(record["name"], []).append(record["files"])
    return found


def test_files_of_no_data_set_are_listed_as_such(tmp_path: Path) -> None:
    run([experiment(1, name="first", files={"lidar/a.bin": "1" * 64})], tmp_path, jobs=1)
    assert listed(tmp_path) == {"other files": [{"lidar/a.bin": "1" * 64}]}
    # The records of other experiments are kept, and so is what they had read.
    run([experiment(2, name="second", files={"lidar/a.bin": "2" * 64})], tmp_path, jobs=1)
    assert listed(tmp_path)["other files"] == [
        {"lidar/a.bin": "1" * 64},
        {"lidar/a.bin": "2" * 64},
    ]
    both = {"lidar/a.bin": "2" * 64, "lidar/b.bin": "3" * 64}
    run([experiment(2, name="second", files=both)], tmp_path / "more", jobs=1)
    assert listed(tmp_path / "more")["other files"] == [both]


def test_rows_of_another_environment_are_told_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows of an earlier run had the processor and the libraries of the last one."""
    run([experiment(1, name="first"), experiment(2, name="second")], tmp_path, jobs=1)
    here = runner.machine()
    monkeypatch.setattr(runner, "machine", lambda: here | {"cpu": "Another processor"})
    run([experiment(1, name="first"), experiment(2, 3, name="second")], tmp_path, jobs=1)

    results = json.loads((tmp_path / "results.json").read_text())
    cpus = {
        name: [results["environments"][each]["cpu"] for each in record["environments"]]
        for name, record in results["experiments"].items()
    }
    assert cpus == {"first": [here["cpu"]], "second": [here["cpu"], "Another processor"]}
    assert "measured_by" not in results["experiments"]["first"]["rows"][0]
    for name in ("page.html", "page.md"):
        write_report(tmp_path, tmp_path / name)
        text = (tmp_path / name).read_text()
        assert text.count("Another processor") == 1
        assert here["cpu"] in text
    assert "measured on several machines" in (tmp_path / "page.html").read_text()


def test_a_page_names_the_one_environment_that_measured_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = runner.machine()
    monkeypatch.setattr(runner, "machine", lambda: here | {"cpu": "Another processor"})
    run([experiment(1)], tmp_path, jobs=1)
    monkeypatch.undo()
    assert run([experiment(1)], tmp_path, jobs=1).resumed == 1
    write_report(tmp_path, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert "Another processor" in text
    assert "several machines" not in text
