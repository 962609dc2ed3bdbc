"""``manip3d inspect`` and ``manip3d forge lidar``: verdicts, exit codes, files."""

from __future__ import annotations

import csv
import hashlib
import json
import mmap
import platform
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

import lattice_scans
import manip3d
import manip3d.report
from cave_scans import AHEAD, ball
from command_line import run
from manip3d import authenticate, datasets, report
from manip3d.cli.forge import ATTACKS, Order
from manip3d.cli.inspect import _append, _code_of_rows
from manip3d.cli.many import _gravest
from manip3d.cli.terminal import Terminal
from manip3d.lidar import map_shift

Points = NDArray[np.float32]


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    path = tmp_path / "scan.bin"
    manip3d.LidarFrame(AHEAD, np.zeros(len(AHEAD), np.float32)).write(path)
    return path


@pytest.fixture
def hoax(tmp_path: Path) -> Path:
    path = tmp_path / "hoax.bin"
    manip3d.LidarFrame(ball(0.6, 20_000), np.zeros(20_000, np.float32)).write(path)
    return path


def test_clean_forged_and_undecidable(scan: Path, hoax: Path, tmp_path: Path) -> None:
    clean = run("inspect", scan, "--json", "-q")
    assert clean.exit_code == 0, clean.output
    assert json.loads(clean.stdout)["verdict"] == "no_trace"

    forged = tmp_path / "forged.bin"
    made = run(
        "forge",
        "lidar",
        "ctp",
        scan,
        "-o",
        forged,
        "--hoax",
        hoax,
        "--position",
        3,
        1,
        0,
        "--json",
        "-q",
    )
    assert made.exit_code == 0, made.output
    assert json.loads(made.stdout)["added"] == 20_000
    truth = json.loads((tmp_path / "forged.bin.truth.json").read_text())
    assert truth["added"] == list(range(len(AHEAD), len(AHEAD) + 20_000))

    page = tmp_path / "evidence.html"
    found = run("inspect", forged, "-o", page, "--json", "-q")
    assert found.exit_code == 3, found.output
    record = json.loads(found.stdout)
    assert record["verdict"] == "tampered"
    np.testing.assert_allclose(
        record["detectors"]["occlusion"]["boxes"][0]["center"], (3, 1, 0), atol=0.1
    )
    text = page.read_text()
    assert "tampered" in text
    assert text.count("data:image/png;base64,") == 3
    assert "<iframe srcdoc=" in text  # the scan as points
    assert not re.search(r"""(src|href)\s*=\s*["']?https?:""", text)
    assert run("inspect", forged, "-o", page).exit_code == 1  # exists
    refused = run("inspect", forged, "-o", tmp_path / "x.pdf")
    assert refused.exit_code == 1
    assert "-o" in str(refused.exception)

    fused = tmp_path / "fused.bin"
    manip3d.LidarFrame(np.concatenate([AHEAD, AHEAD + np.float32([2, 1, 0.3])])).write(fused)
    assert run("inspect", fused, "-q").exit_code == 4


def used(attack: str, hoax: Path) -> dict[str, tuple[Any, ...]]:
    """Hoax, place and box of an attack, those that it uses."""
    place = AHEAD[len(AHEAD) // 2] if attack == "crtp" else (3, 1, 0)
    options = {"hoax": (hoax,), "position": place, "box": (6, 0, 0, 4, 4, 4, 0.2)}
    return {name: options[name] for name in options if name in ATTACKS[attack].options}


def words(name: str, values: tuple[Any, ...] | None) -> tuple[Any, ...]:
    """An option and its values on the command line; None: it is not given."""
    return () if values is None else (f"--{name.replace('_', '-')}", *values)


@pytest.mark.parametrize(
    "attack",
    ["crtp", "insert", "subtract", "deform", "dent", "translation", "rotation", "replacement"],
)
def test_every_attack_writes_a_scan_and_its_truth(
    attack: str, scan: Path, hoax: Path, tmp_path: Path
) -> None:
    output = tmp_path / "forged.bin"
    options = used(attack, hoax) | {"yaw": (0.1,), "allow_collision": ()}  # a room full of points
    given = [word for name in ATTACKS[attack].options for word in words(name, options.get(name))]
    done = run("forge", "lidar", attack, scan, "-o", output, *given, "-q")
    assert done.exit_code == 0, done.output
    truth = json.loads((tmp_path / "forged.bin.truth.json").read_text())
    forged = manip3d.io.read_scan(output)
    assert forged.num_points == truth["points"]
    assert len(truth["added"]) + len(truth["moved"]) + len(truth["removed"]) > 0
    check_truth(truth, AHEAD, forged.points)


def check_truth(truth: dict[str, Any], before: Points, after: Points) -> None:
    """Hold a truth file to the points in the files: it names each change, and nothing else."""
    kept = np.setdiff1d(np.arange(len(before)), truth["removed"])
    source = np.concatenate([kept, np.full(len(truth["added"]), -1)])
    assert len(source) == len(after)
    assert truth["added"] == np.flatnonzero(source < 0).tolist()
    old = source >= 0
    changed = np.flatnonzero((after[old] != before[source[old]]).any(axis=1))
    assert truth["moved"] == changed.tolist()
    assert truth["moved_from"] == source[changed].tolist()


@pytest.mark.parametrize("suffix", [".bin", ".ply"])
# The attacks on a lattice need a scan that stands on one: tests/forge/test_firings.py.
@pytest.mark.parametrize("attack", sorted(ATTACKS.keys() - {"lattice-insert", "spoof"}))
def test_truth_files_tell_what_the_bytes_say(
    attack: str, suffix: str, scan: Path, hoax: Path, tmp_path: Path
) -> None:
    source = tmp_path / f"scan{suffix}"
    manip3d.io.read_scan(scan).write(source)
    output = tmp_path / f"forged{suffix}"
    given = [word for name, values in used(attack, hoax).items() for word in words(name, values)]
    done = run("forge", "lidar", attack, source, "-o", output, *given, "-q")
    assert done.exit_code == 0, done.output
    truth = json.loads(output.with_name(output.name + ".truth.json").read_text())
    before, after = manip3d.io.read_scan(source).points, manip3d.io.read_scan(output).points
    assert len(truth["added"]) + len(truth["moved"]) + len(truth["removed"]) > 0
    assert ("seed" in truth) == ("seed" in ATTACKS[attack].options)
    check_truth(truth, before, after)


@pytest.mark.parametrize(
    ("attack", "option"),
    [("rotation", "--yaw"), ("translation", "--distance"), ("dent", "--amplitude")],
)
def test_an_attack_that_changes_nothing_is_refused(
    attack: str, option: str, scan: Path, tmp_path: Path
) -> None:
    output = tmp_path / "forged.bin"
    done = run(
        "forge", "lidar", attack, scan, "-o", output, "--box", 6, 0, 0, 4, 4, 4, 0.2, option, 0
    )
    assert "no point would change" in str(done.exception)
    assert list(tmp_path.iterdir()) == [scan]


@pytest.mark.parametrize(
    ("attack", "option", "value"), [("translation", "--distance", 3), ("rotation", "--yaw", 45)]
)
def test_an_object_in_the_way_names_the_option_that_allows_it(
    attack: str, option: str, value: int, tmp_path: Path
) -> None:
    everywhere = np.random.default_rng(0).uniform(-9, 9, (20_000, 3)).astype(np.float32)
    manip3d.LidarFrame(everywhere).write(tmp_path / "full.bin")
    order = ("--box", 5, 0, 0, 2, 2, 2, 0, option, value)
    scans = (tmp_path / "full.bin", "-o", tmp_path / "forged.bin")
    done = run("forge", "lidar", attack, *scans, *order)
    assert str(done.exception).startswith(f"{option}: expected a free place")
    assert "(--allow-collision puts the object there all the same)" in str(done.exception)


def test_a_replacement_has_the_intensities_of_its_hoax(scan: Path, tmp_path: Path) -> None:
    thing = manip3d.LidarFrame(ball(0.6, 50), np.arange(50, dtype=np.float32))
    output = tmp_path / "forged.bin"
    for suffix in (".pcd", ".npz"):
        thing.write(tmp_path / f"thing{suffix}")
        given = ("--hoax", tmp_path / f"thing{suffix}", "--box", 6, 0, 0, 4, 4, 4, 0, "--scale", 2)
        done = run(
            "forge", "lidar", "replacement", scan, "-o", output, *given, "--allow-collision",
            "--force",
        )  # fmt: skip
        assert done.exit_code == 0, done.output
        forged = manip3d.io.read_scan(output)
        added = json.loads((tmp_path / "forged.bin.truth.json").read_text())["added"]
        assert forged.intensity is not None
        assert forged.intensity[added].tolist() == list(range(50))
        size = np.ptp(forged.points[added], axis=0)
        np.testing.assert_allclose(size, 2 * np.ptp(thing.points, axis=0), rtol=1e-4)


def test_what_is_wrong_with_a_hoax_names_its_option(scan: Path, tmp_path: Path) -> None:
    """The scan that is forged is not at fault."""
    output, mesh, thing = tmp_path / "forged.bin", tmp_path / "a.obj", tmp_path / "thing.bin"
    manip3d.Mesh([[1, 0, 0], [0, 2, 0], [0, 0, 4]], [[0, 1, 2]]).write(mesh)
    manip3d.LidarFrame(ball(0.6, 50)).write(thing)
    full = np.random.default_rng(0).uniform(-9, 9, (20_000, 3)).astype(np.float32)
    manip3d.LidarFrame(full).write(tmp_path / "full.bin")
    box = ("--box", 5, 0, 0, 2, 2, 2, 0)
    for attack, source, hoax, more, told in (
        ("spoof", scan, mesh, box, "--hoax: expected a scan, which this attack copies, got"),
        ("lattice-insert", scan, thing, (), "--hoax: expected an object that stands free"),
        (
            "replacement",
            tmp_path / "full.bin",
            thing,
            (*box, "--scale", 6),
            "--hoax: expected a free",
        ),
    ):
        done = run("forge", "lidar", attack, source, "-o", output, "--hoax", hoax, *more)
        assert str(done.exception).startswith(told), done.output
    assert "(--allow-collision puts the object there all the same)" in str(done.exception)


def test_forgeries_on_the_lattice_of_another_scanner_are_warned_of(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    firings, box = lattice_scans.scan(rng), ("--box", 6, 0, -1, 6, 3, 2, 0)
    manip3d.LidarFrame(firings).write(tmp_path / "a.bin")
    lattice_scans.lattice().save(tmp_path / "own.json")
    for own, warned in (((), True), (("--lattice", tmp_path / "own.json"), False)):
        done = run(
            "forge", "lidar", "lattice-remove", tmp_path / "a.bin", "-o", tmp_path / "b.bin", *box,
            *own, "--force",
        )  # fmt: skip
        assert done.exit_code == 0, done.output
        assert ("forged points stand out, because the scan is not on" in done.stderr) == warned


def test_missing_options_are_named(scan: Path, tmp_path: Path) -> None:
    output = tmp_path / "forged.bin"
    assert "--hoax" in str(run("forge", "lidar", "ctp", scan, "-o", output).exception)
    done = run("forge", "lidar", "ctp", scan, "-o", output, "--hoax", scan)
    assert "--position" in str(done.exception)
    far = run("forge", "lidar", "crtp", scan, "-o", output, "--hoax", scan, "--position", 0, 900, 0)
    assert str(far.exception).startswith("--position: expected scene points within")
    assert not output.exists()


@pytest.mark.parametrize("attack", ATTACKS)
def test_an_attack_uses_the_options_of_its_list(attack: str, scan: Path, tmp_path: Path) -> None:
    mesh = tmp_path / "box.obj"
    manip3d.Mesh([[1, 0, 0], [0, 2, 0], [0, 0, 4]], [[0, 1, 2]]).write(mesh)
    is_seen = "lattice" in ATTACKS[attack].options  # from a scan
    order = Order(
        str(scan if is_seen else mesh), (3, 1, 0), (6, 0, 0, 4, 4, 4, 0.2), 1.0, None, 0.1, 3.0,
        0.0, False, None, "z", 0, 1, False, print,
    )  # fmt: skip
    read: set[str] = set()

    class Watched:
        def __getattr__(self, name: str) -> object:
            read.add(name)
            return getattr(order, name)

    with suppress(manip3d.InputError):  # the scan is on no lattice, and its room is full
        ATTACKS[attack].forge(manip3d.io.read_scan(scan), cast(Order, Watched()))
    assert read - {"threads", "say"} == set(ATTACKS[attack].options)


@pytest.mark.parametrize("several", [False, True])
def test_options_that_an_attack_does_not_use_are_refused(
    several: bool, scan: Path, tmp_path: Path
) -> None:
    options = {
        "hoax": ("nope.ply",), "position": (9, 2, -1), "scale": (2,), "yaw": (3,), "up": ("y",),
        "printed": (), "range_noise": (0.1,), "box": (6, 0, 0, 4, 4, 4, 0), "amplitude": (0.2,),
        "distance": (1,), "allow_collision": (), "lattice": ("nope.json",), "seed": (1,),
    }  # fmt: skip
    assert set(options) == {name for each in ATTACKS.values() for name in each.options}
    more = ("--table", tmp_path / "table.csv") if several else ()
    before = sorted(tmp_path.iterdir())
    for attack, (_, known) in ATTACKS.items():
        for name in options.keys() - set(known):
            given = words(name, options[name])
            done = run("forge", "lidar", attack, scan, "-o", tmp_path / "out.bin", *given, *more)
            assert str(done.exception).startswith(f"{given[0]}: can only be given with '")
            assert str(done.exception).endswith(f", got '{attack}'")
    assert sorted(tmp_path.iterdir()) == before
    done = run("forge", "lidar", "subtract", scan, "-o", tmp_path / "out.bin", "--range-noise", 1)
    assert str(done.exception) == "--range-noise: can only be given with 'insert', got 'subtract'"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("replacement", "--scale", 0), "--scale: expected a finite number > 0, got 0.0"),
        (("replacement", "--scale", -1), "--scale: expected a finite number > 0, got -1.0"),
        (("ctp", "--scale", "inf"), "--scale: expected a finite number > 0, got inf"),
        (("ctp", "--yaw", "nan"), "--yaw: expected a finite number, got nan"),
        (("spoof", "--yaw", 7), "--yaw: expected at most one turn of 2 pi radians, got 7"),
        (("deform", "--box", 6, 0, 0, "nan", 4, 4, 0), "--box: expected finite numbers"),
    ],
)
def test_wrong_numbers_name_their_option(
    words: tuple[object, ...], told: str, hoax: Path, scan: Path, tmp_path: Path
) -> None:
    attack, *more = words
    more += {"ctp": ("--position", 9, 2, -1), "spoof": ("--box", 6, 0, 0, 4, 4, 4, 0)}.get(
        attack, ()
    )
    thing = () if attack in ("deform", "spoof") else ("--hoax", hoax)
    done = run("forge", "lidar", attack, scan, "-o", tmp_path / "out.bin", *thing, *more)
    assert str(done.exception).startswith(told)


def test_a_hoax_that_is_no_scan_is_named(hoax: Path, scan: Path, tmp_path: Path) -> None:
    wrong = hoax.with_suffix(".obj")
    done = run("forge", "lidar", "spoof", scan, "-o", tmp_path / "out.bin", "--hoax", wrong)
    assert str(done.exception).startswith("--hoax: expected a scan, which this attack copies")


def test_the_box_of_the_nearest_object_is_printed(tmp_path: Path) -> None:
    ground = np.mgrid[-20:20:0.5, -20:20:0.5, -1.5:-1:1].reshape(3, -1).T
    car = np.mgrid[4:6:0.2, -1:1:0.2, -1:0.4:0.2].reshape(3, -1).T
    source, output = tmp_path / "street.bin", tmp_path / "out.bin"
    manip3d.LidarFrame(np.concatenate([ground, car]).astype(np.float32)).write(source)
    done = run("forge", "lidar", "subtract", source, "-o", output)
    assert done.exit_code == 0, done.output
    line = next(line for line in done.stderr.splitlines() if line.startswith("box: "))
    assert line.endswith(", that of the nearest object, at a range of 4.9 m")
    box = line.split(",")[0].split()[1:]
    assert [round(float(value)) for value in box] == [5, 0, 0, 2, 2, 1, 0]
    again = run("forge", "lidar", "subtract", source, "-o", output, "--box", *box, "--force")
    assert "box: " not in again.stderr


def test_places_on_a_map_are_those_of_the_file(hoax: Path, tmp_path: Path) -> None:
    """Points far from 0 are shifted near it on reading, which no user is to know."""
    place = np.array([458_000.25, 5_429_000.5, 112.125])
    source, forged, rows = (tmp_path / name for name in ("map.npy", "forged.npy", "rows.csv"))
    np.save(source, AHEAD + place)
    where = place + np.array([3.0, 1.0, 0.0])
    made = run("forge", "lidar", "ctp", source, "-o", forged, "--hoax", hoax, "--position", *where)
    assert made.exit_code == 0, made.output
    truth = json.loads((tmp_path / "forged.npy.truth.json").read_text())
    np.testing.assert_allclose(truth["box"]["center"], where, atol=0.05)
    page = tmp_path / "page.html"
    told = run("inspect", forged, "--origin", *place, "--rows", rows, "--no-power", "-o", page)
    assert told.exit_code == 3, told.output
    assert "scanner at (458000.250, 5429000.500, 112.125) m, given" in told.stdout
    box = next(line for line in told.stdout.splitlines() if line.startswith("occlusion"))
    np.testing.assert_allclose([float(v) for v in box.split()[1:4]], where, atol=0.7)
    record = json.loads(run("inspect", forged, "--origin", *place, "--json", "-q").stdout)
    assert record["origin"] == place.tolist()
    center = record["detectors"]["occlusion"]["boxes"][0]["center"]
    assert "".join(f"<td>{value:.2f}</td>" for value in center) in page.read_text()
    np.testing.assert_allclose(record["regions"][0]["center"], where, atol=0.7)
    boxes = record["detectors"]["occlusion"]["boxes"]
    assert boxes[0]["center"] in [region["center"] for region in record["regions"]]
    table = np.loadtxt(rows, delimiter=",", skiprows=1, usecols=range(4))
    in_file = np.load(forged)[table[:, 0].astype(int)]
    np.testing.assert_allclose(table[:, 1:], in_file[:, :3], atol=1e-4)
    cut = run("forge", "lidar", "subtract", forged, "-o", tmp_path / "cut.npy", "--box", *where,
              2, 2, 2, 0)  # fmt: skip
    assert cut.exit_code == 0, cut.output
    bounds = json.loads(run("info", source, "--json").stdout)["scans"][0]["bounds"]
    stored = AHEAD + place
    np.testing.assert_allclose(bounds, [stored.min(0), stored.max(0)], atol=1e-4)


@pytest.mark.parametrize(("suffix", "keeps_map"), [(".bin", False), (".npy", True)])
def test_the_truth_of_a_scan_of_a_map_belongs_to_the_forged_file(
    suffix: str, keeps_map: bool, hoax: Path, tmp_path: Path
) -> None:
    """A .bin of 32 bits cannot hold coordinates of a map, so that its points lie near 0."""
    place = np.array([458_000.25, 5_429_000.5, 112.125])
    source, output = tmp_path / "map.npy", tmp_path / f"forged{suffix}"
    np.save(source, AHEAD + place)
    where = place + np.array([3.0, 1.0, 0.0])
    made = run("forge", "lidar", "ctp", source, "-o", output, "--hoax", hoax, "--position", *where)
    assert made.exit_code == 0, made.output
    assert ("warning: coordinates are written near 0" in made.stderr) != keeps_map
    truth = json.loads(output.with_name(f"{output.name}.truth.json").read_text())
    in_file = np.load(output)[:, :3] if keeps_map else manip3d.io.read_scan(output).points
    added = in_file[truth["added"]]
    middle = (added.min(axis=0) + added.max(axis=0)) / 2.0
    np.testing.assert_allclose(truth["box"]["center"], middle, atol=0.05)
    shift = map_shift(manip3d.io.read_scan(source))
    assert truth["shift"] == (shift.tolist() if keeps_map else [0.0] * 3)


@pytest.mark.parametrize("suffix", [".e57", ".ptx", ".pcd", ".ply", ".csv", ".las", ".npy", ".bin"])
def test_the_truth_tells_places_in_the_points_of_the_forged_file(
    suffix: str, hoax: Path, tmp_path: Path
) -> None:
    """E57 and PTX hold points relative to the scanner, and the box was not."""
    for package in {".las": ["laspy"], ".e57": ["pye57"]}.get(suffix, []):
        pytest.importorskip(package)
    place = np.array([6.0, -4.0, 1.5])
    source, output = tmp_path / "a.pcd", tmp_path / f"forged{suffix}"
    dark = np.zeros(len(AHEAD), np.float32)
    manip3d.LidarFrame(AHEAD + place.astype(np.float32), dark, origin=tuple(place)).write(source)
    where = place + np.array([3.0, 1.0, 0.0])
    made = run("forge", "lidar", "ctp", source, "-o", output, "--hoax", hoax,
               "--position", *where, "--yaw", 0.3)  # fmt: skip
    assert made.exit_code == 0, made.output
    truth = json.loads(output.with_name(f"{output.name}.truth.json").read_text())
    added = manip3d.io.read_scan(output).points[truth["added"]]
    middle = (added.min(axis=0) + added.max(axis=0)) / 2.0
    np.testing.assert_allclose(truth["box"]["center"], middle, atol=0.05)
    placed = np.array(truth["transform"]) @ [0.0, 0.0, 0.0, 1.0]  # the middle of the ball
    np.testing.assert_allclose(placed[:3], middle, atol=0.05)


@pytest.mark.parametrize("attack", ["translation", "rotation", "subtract"])
def test_the_transform_moves_points_of_the_forged_file(
    attack: str, hoax: Path, tmp_path: Path
) -> None:
    place = np.array([6.0, -4.0, 1.5])
    source, output = tmp_path / "a.pcd", tmp_path / "forged.ptx"
    dark = np.zeros(len(AHEAD), np.float32)
    manip3d.LidarFrame(AHEAD + place.astype(np.float32), dark, origin=tuple(place)).write(source)
    manip3d.io.read_scan(source).write(tmp_path / "a.ptx")
    options = used(attack, hoax) | {"yaw": (0.1,), "allow_collision": ()}
    options["box"] = tuple(np.add(options["box"], (*place, 0, 0, 0, 0)))
    given = [word for name in ATTACKS[attack].options for word in words(name, options.get(name))]
    made = run("forge", "lidar", attack, source, "-o", output, *given, "-q")
    assert made.exit_code == 0, made.output
    truth = json.loads((tmp_path / "forged.ptx.truth.json").read_text())
    before = manip3d.io.read_scan(tmp_path / "a.ptx").points[truth["moved_from"]]
    after = manip3d.io.read_scan(output).points[truth["moved"]]
    transform = np.array(truth["transform"])
    np.testing.assert_allclose(before @ transform[:3, :3].T + transform[:3, 3], after, atol=1e-4)
    assert len(after) > 0 or np.array_equal(transform, np.eye(4))


def test_the_origin_of_a_drive_on_a_map_is_that_of_its_files(tmp_path: Path) -> None:
    """The scanner stays, and the second scan is shifted near 0 by another amount than the first."""
    place = np.array([458_000.25, 5_429_000.5, 112.125])
    scans = tmp_path / "drive" / "velodyne"
    scans.mkdir(parents=True)
    for number, points in enumerate((AHEAD, AHEAD[AHEAD[:, 0] > 6.0])):
        np.save(scans / f"{number:06d}.npy", points + place)
    shifts = [map_shift(manip3d.io.read_scan(path)) for path in sorted(scans.iterdir())]
    assert not np.array_equal(*shifts)
    done = run("inspect", tmp_path / "drive", "--origin", *place, "--json", "-q", "--no-power")
    frames = json.loads(done.stdout)["frames"]
    assert [frame["origin"] for frame in frames] == [place.tolist()] * 2
    alone = run("inspect", scans / "000000.npy", "--origin", *place, "--json", "-q", "--no-power")
    assert frames[0]["sensor"] == json.loads(alone.stdout)["sensor"]


@pytest.mark.parametrize(("up", "size"), [("z", (1.0, 2.0, 3.0)), ("y", (1.0, 3.0, 2.0))])
def test_hoaxes_with_y_up_stand_upright(
    up: str, size: tuple[float, float, float], scan: Path, tmp_path: Path
) -> None:
    corners = np.array(np.meshgrid([0, 1], [0, 2], [0, 3])).reshape(3, -1).T
    mesh = tmp_path / "box.obj"
    manip3d.Mesh(corners, [[0, 1, 2]]).write(mesh)
    done = run(
        "forge", "lidar", "ctp", scan, "-o", tmp_path / "forged.bin", "--hoax", mesh, "--up", up,
        "--position", 3, 1, 0, "-q",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    pasted = manip3d.io.read_scan(tmp_path / "forged.bin").points[len(AHEAD) :]
    np.testing.assert_allclose(np.ptp(pasted, axis=0), size, atol=1e-5)


def test_y_up_turns_and_does_not_mirror(scan: Path, tmp_path: Path) -> None:
    mesh = tmp_path / "axes.obj"
    manip3d.Mesh([[1, 0, 0], [0, 2, 0], [0, 0, 4]], [[0, 1, 2]]).write(mesh)
    output = tmp_path / "forged.bin"
    done = run(
        "forge", "lidar", "ctp", scan, "-o", output, "--hoax", mesh, "--up", "y",
        "--position", 3, 1, 0, "-q",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    x, y, z = manip3d.io.read_scan(output).points[len(AHEAD) :].astype(float)
    np.testing.assert_allclose(y - x, [-1, 0, 2], atol=1e-5)  # the mesh's y became z
    np.testing.assert_allclose(z - x, [-1, -4, 0], atol=1e-5)  # and its z became -y


def test_many_scans_have_one_table_and_the_gravest_exit_code(
    scan: Path, hoax: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "scans"
    folder.mkdir()
    scan.rename(folder / "clean.bin")
    made = run("forge", "lidar", "ctp", folder, "-o", tmp_path / "forged", "--hoax", hoax,
               "--position", 3, 1, 0, "-q", "--jobs", 1)  # fmt: skip
    assert made.exit_code == 0, made.output
    assert (tmp_path / "forged" / "clean.bin.truth.json").is_file()
    (tmp_path / "forged" / "clean.bin").rename(folder / "forged.bin")
    (folder / "torn.bin").write_bytes(b"123")
    (folder / "mesh.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\n"
                                      b"element face 1\nend_header\n")  # fmt: skip
    table = tmp_path / "verdicts.csv"
    done = run("inspect", folder, "--table", table, "-q", "--jobs", 1)
    assert done.exit_code == 3  # tampering outranks files that cannot be read
    with table.open(newline="") as stream:
        rows = {Path(row["source"]).name: row for row in csv.DictReader(stream)}
    assert {name: row["verdict"] for name, row in rows.items()} == {
        "clean.bin": "no_trace", "forged.bin": "tampered", "torn.bin": "", "mesh.ply": "",
    }  # fmt: skip
    assert "FormatError" in rows["torn.bin"]["error"]
    assert rows["mesh.ply"]["skipped"] == "a mesh"
    (folder / "torn.bin").unlink()
    done = run("inspect", folder, "--table", table, "--jobs", 1)
    assert done.exit_code == 3
    assert "3 from an earlier run" in done.stderr
    named = run("inspect", folder / "mesh.ply", folder / "clean.bin", "-q", "--jobs", 1)
    assert named.exit_code == 1  # what is named must be what the command takes
    assert "OtherKindError" in named.stdout


def test_a_policy_holds_for_several_files(scan: Path, hoax: Path, tmp_path: Path) -> None:
    forged, empty = tmp_path / "forged.bin", tmp_path / "empty.bin"
    made = run("forge", "lidar", "ctp", scan, "-o", forged, "--hoax", hoax, "--position", 3, 1, 0)
    assert made.exit_code == 0, made.output
    empty.write_bytes(b"")
    for files, policy, code in (
        ((scan, forged), "", 3),
        ((scan, forged), "tampered=5", 5),
        ((empty, forged), "tampered=2,undecidable=9", 2),  # of the gravest verdict, not the code
        ((scan, empty), "undecidable=0,no_trace=7", 7),
        ((scan, scan), "no_trace=7", 7),
        ((scan, forged), "tampered=0", 0),
    ):
        done = run("inspect", *files, "--policy", policy, "-q", "--jobs", 1, "--no-power")
        assert done.exit_code == code, (policy, done.output)
    refused = run("inspect", scan, forged, "--policy", "tamperd=5")
    assert refused.exit_code == 2
    assert "expected VERDICT=CODE" in refused.output


def test_tampering_outranks_a_file_that_fails(scan: Path, hoax: Path, tmp_path: Path) -> None:
    forged, torn = tmp_path / "forged.bin", tmp_path / "torn.bin"
    made = run("forge", "lidar", "ctp", scan, "-o", forged, "--hoax", hoax, "--position", 3, 1, 0)
    assert made.exit_code == 0, made.output
    torn.write_bytes(b"123")
    done = run("inspect", forged, torn, "-q", "--jobs", 1)
    assert done.exit_code == 3, done.output
    assert "error: 1 of 2 files failed" in done.stderr
    rows = [{"verdict": "tampered"}, {"error": "FormatError: torn"}]
    for policy, code in (("", 3), ("tampered=9", 9), ("tampered=0", 1)):
        assert _code_of_rows(rows, {"policy": policy}) == code


def test_edits_are_planted_with_power_only(scan: Path) -> None:
    for sources in ((scan,), (scan, scan)):
        done = run("inspect", *sources, "--plant", 1, "--no-power")
        assert "--plant: can only be given with --power" in str(done.exception)


@pytest.mark.parametrize("option", ["--previous", "--following"])
def test_a_wrong_neighbour_is_named_by_its_option(scan: Path, option: str) -> None:
    refused = run("inspect", scan, option, "neighbour")
    assert refused.exit_code == 1
    assert f"{option}: expected a point file" in str(refused.exception)


def test_what_is_not_there_is_named_as_such(tmp_path: Path) -> None:
    absent = run("lattice", tmp_path / "nothing", "-o", tmp_path / "lattice.json")
    assert absent.exit_code == 1
    assert isinstance(absent.exception, FileNotFoundError)
    unknown = run("data", "get", "nosuch")
    assert "got 'nosuch' ('manip3d data list' lists all)" in str(unknown.exception)


def test_unknown_exit_codes_are_no_success() -> None:
    for codes, gravest in (((0, 0), 0), ((0, 5), 5), ((4, 3, 9), 3), ((2, 4), 4), ((), 0)):
        assert _gravest([{"exit_code": code} for code in codes]) == gravest
    failed = {"error": "FormatError: torn"}
    assert _gravest([failed, {"exit_code": 3}]) == 3
    assert _gravest([failed, {"exit_code": 4}]) == 1


def test_several_scans_are_a_short_table(scan: Path, tmp_path: Path) -> None:
    empty = tmp_path / "empty.bin"
    empty.write_bytes(b"")
    torn = tmp_path / "torn.bin"
    torn.write_bytes(b"123")
    done = run("inspect", scan, empty, "-q", "--jobs", 1)
    head, *rows = done.stdout.splitlines()
    assert head.split() == ["source", "verdict", "sensor", "reason"]  # I and II state no p-value
    assert [(row.split()[0], row.split()[1]) for row in rows] == [
        (str(empty), "undecidable"), (str(scan), "no_trace"),
    ]  # fmt: skip
    done = run("inspect", scan, torn, "-q", "--jobs", 1)
    assert done.exit_code == 1
    assert "FormatError" in done.stdout
    found = json.loads(run("inspect", scan, empty, "-q", "--jobs", 1, "--json").stdout)
    assert "detectors" in found[0]


@pytest.mark.parametrize("also", [(), ("--jobs", 1)])
def test_the_log_names_urls_and_no_temporary_copies(
    scan: Path, tmp_path: Path, also: tuple[object, ...]
) -> None:
    pytest.importorskip("fsspec", reason="the extra 'remote' is not installed")
    (tmp_path / "empty.bin").write_bytes(b"")
    urls = [f"file://{tmp_path}/empty.bin", *([f"file://{scan}"] if also else [])]
    log = tmp_path / "case.jsonl"
    done = run("inspect", *urls, "--log", log, "-q", *also)
    assert done.exit_code == 4, done.output
    entries = report.read_log(log)
    assert [entry["source"] for entry in entries] == urls
    hashes = [datasets.file_sha256(Path(url.removeprefix("file://"))) for url in urls]
    assert [entry["source_sha256"] for entry in entries] == hashes


def test_the_log_has_the_hash_of_a_recording_that_an_address_names(tmp_path: Path) -> None:
    path, log = tmp_path / "a.mkv", tmp_path / "case.jsonl"
    path.write_bytes(b"frames")
    empty = authenticate.inspect(np.zeros((0, 3), np.float32))
    for source in (f"mkv:{path}", f"pcap:{path}", f"bag:{path}#/points", "sim:body"):
        _append(log, empty, source, Terminal(quiet=True))
    *named, last = report.read_log(log)
    assert named[0]["source"] == f"mkv:{path}"
    for entry in named:
        assert entry["source_sha256"] == hashlib.sha256(b"frames").hexdigest()
    assert last["source_sha256"] == ""


def test_options_of_one_scan_are_refused_for_several(scan: Path, tmp_path: Path) -> None:
    for option in ("--previous", "--following", "--watermark", "--rows"):
        done = run("inspect", scan, tmp_path, option, tmp_path / "x.csv")
        assert done.exit_code == 1
        assert f"{option}: can only be given with a single scan, got several" in str(done.exception)
        done = run("inspect", scan, tmp_path / "missing", option, tmp_path / "x.csv")
        assert "got several" in str(done.exception)  # before any file is looked for
    rows = tmp_path / "rows.csv"
    rows.write_text("mine")
    assert "--force replaces it" in str(run("inspect", scan, "--rows", rows).exception)
    assert rows.read_text() == "mine"
    assert run("inspect", scan, "--rows", rows, "--force", "-q").exit_code == 0
    assert rows.read_text().startswith("row,")


def test_a_log_that_cannot_be_is_refused_at_once(
    scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError("was inspected")

    monkeypatch.setattr("manip3d.authenticate.inspect", never)
    other = tmp_path / "other.jsonl"
    other.write_bytes(b'{"a": 1}\n')
    for log, words in (
        (tmp_path / "case.txt", "ends in .jsonl"),
        (scan, "ends in .jsonl"),
        (other, "line 1: not an entry of a log"),
        (tmp_path / "no" / "case.jsonl", "there is no folder"),
    ):
        for sources in ((scan,), (scan, scan)):
            done = run("inspect", *sources, "--log", log, "--jobs", 1)
            assert done.exit_code == 1
            assert words in str(done.exception)
    assert other.read_bytes() == b'{"a": 1}\n'


def test_several_scans_share_a_log(scan: Path, tmp_path: Path) -> None:
    log = tmp_path / "case.jsonl"
    folder = tmp_path / "scans"
    folder.mkdir()
    for number in range(4):
        (folder / f"{number}.bin").write_bytes(scan.read_bytes()[: 16 * 500])
    done = run("inspect", folder, "--log", log, "-q", "--jobs", 2)
    assert done.exit_code == 4, done.output
    assert {Path(entry["source"]).name for entry in manip3d.report.read_log(log)} == {
        "0.bin", "1.bin", "2.bin", "3.bin",
    }  # fmt: skip


def inspected_with_log(scan: Path, place: Path) -> tuple[Path, Path, tuple[object, ...]]:
    """Inspect two scans; return their folder, the log, and the words of the command."""
    folder, log = place / "scans", place / "case.jsonl"
    folder.mkdir()
    for number in range(2):
        (folder / f"{number}.bin").write_bytes(scan.read_bytes()[: 16 * 500])
    asked = ("inspect", folder, "--table", place / "table.csv", "--log", log, "--jobs", 1)
    assert run(*asked).exit_code == 4
    return folder, log, asked


def test_a_log_that_is_gone_is_written_anew(scan: Path, tmp_path: Path) -> None:
    """Rows of the earlier run were printed, and the log was not written at all."""
    folder, log, asked = inspected_with_log(scan, tmp_path)
    log.unlink()
    assert "earlier run" not in run(*asked).stderr
    assert [Path(entry["source"]).name for entry in report.read_log(log)] == ["0.bin", "1.bin"]
    again = run(*asked)
    assert "2 from an earlier run" in again.stderr
    assert "warning" not in again.stderr
    assert len(report.read_log(log)) == 2
    log.unlink()
    run("inspect", folder / "0.bin", "--log", log, "-q")
    told = " ".join(run(*asked).stderr.split())
    assert "has no entry of 1 file from an earlier run; --force judges all again" in told
    run(*asked, "--force")
    assert {Path(entry["source"]).name for entry in report.read_log(log)} == {"0.bin", "1.bin"}


def test_a_log_whose_last_line_is_torn_lacks_its_scan(scan: Path, tmp_path: Path) -> None:
    """A power cut tears the line of a scan whose row is in the table of the earlier run."""
    _, log, asked = inspected_with_log(scan, tmp_path)
    log.write_bytes(log.read_bytes()[:-20])
    told = " ".join(run(*asked).stderr.split())
    assert "has no entry of 1 file from an earlier run; --force judges all again" in told
    run(*asked, "--force")
    assert [Path(entry["source"]).name for entry in report.read_log(log)] == [
        "0.bin", "0.bin", "1.bin",
    ]  # fmt: skip

    log.write_bytes(log.read_bytes().splitlines(keepends=True)[0][:-20])  # no entry is whole
    assert "earlier run" not in run(*asked).stderr
    assert [Path(entry["source"]).name for entry in report.read_log(log)] == ["0.bin", "1.bin"]


def test_the_log_has_sources_that_cannot_be_read(scan: Path, tmp_path: Path) -> None:
    folder = tmp_path / "drive" / "velodyne"
    folder.mkdir(parents=True)
    bad = folder / "1.bin"
    (folder / "0.bin").write_bytes(scan.read_bytes()[: 16 * 500])
    bad.write_bytes(b"12345")
    for number, (source, name) in enumerate(
        ((bad, str(bad)), (folder, str(bad)), (folder.parent, f"{folder.parent}: 1.bin"))
    ):
        log = tmp_path / f"case{number}.jsonl"
        assert run("inspect", source, "--log", log, "-q", "--jobs", 1).exit_code == 1
        (entry,) = (each for each in report.read_log(log) if "error" in each)
        assert entry["source"] == name
        assert entry["source_sha256"] == hashlib.sha256(b"12345").hexdigest()
        assert "file ends within a point" in entry["error"]
        assert "verdict" not in entry
    log = tmp_path / "other.jsonl"
    (tmp_path / "notes.md").write_text("no scan")
    assert run("inspect", tmp_path / "notes.md", "--log", log, "-q").exit_code == 1
    assert not log.exists()


def test_a_verdict_loads_no_simulator_and_no_viewer(scan: Path) -> None:
    code = (
        "import sys; from manip3d.cli import app; app(sys.argv[1:], standalone_mode=False); "
        "print(*sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "inspect", str(scan), "--no-power", "-q"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    loaded = set(done.stdout.splitlines()[-1].split())
    assert "manip3d.authenticate" in loaded
    assert not loaded & {
        f"manip3d.{room}"
        for room in ("simulate", "forge", "modify", "capture", "experiments", "viewer", "datasets")
    }
    # Readers of meshes and depth images, embedders of watermarks, and what only these import.
    assert not loaded & {
        "manip3d.mesh",
        "manip3d.io._mesh_files",
        "manip3d.io._depth_formats",
        "manip3d.authenticate._paper_watermark",
        "manip3d.authenticate._watermark_files",
        "multiprocessing",
        "xml.etree.ElementTree",
        "zipfile",
    }


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="mallopt is glibc's")
def test_the_pages_of_an_array_are_those_of_the_one_before() -> None:
    code = (
        "import resource; import numpy as np; from manip3d.cli.inspect import _keep_freed_memory; "
        "_keep_freed_memory(); np.ones(1 << 19).sum(); "
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt; "
        "[np.ones(1 << 19).sum() for _ in range(20)]; "
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    pages_of_array = (8 << 19) // mmap.PAGESIZE
    assert int(done.stdout) < pages_of_array  # of 20 arrays
