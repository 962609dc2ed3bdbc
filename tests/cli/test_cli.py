"""The command line as a user meets it: verbs, exit codes, streams."""

from __future__ import annotations

import json
import os
import re
import signal
import struct
import subprocess
import sys
import time
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import exact_models
from command_line import error_line, manip3d
from gltf_files import PNG
from manip3d import (
    LidarFrame,
    Material,
    Mesh,
    Texture,
    cli,
    datasets,
    io,
    read_mesh,
    simplify,
    simulate,
)
from manip3d.cli import doctor
from manip3d.cli.demo import tell
from manip3d.cli.kinds import kind_of
from manip3d.cli.terminal import Terminal, table
from manip3d.metrics import metro


def test_choices_are_checked_before_files_are_read() -> None:
    for words in (
        ("inspect", "missing.bin", "--sensor", "lidar"),
        ("watermark", "embed", "missing.bin", "--key", "k", "-o", "o.bin", "--embedding", "lsb"),
        ("watermark", "verify", "missing.bin", "--key", "k", "--embedding", "lsb"),
        ("alert", "run", "missing", "--key", "k", "-o", "o.html", "--embedding", "lsb"),
    ):
        done = manip3d(*words)
        assert done.returncode == 2
        assert "is not one of" in done.stderr
        assert "missing" not in done.stderr


def test_jobs_are_threads_where_a_single_file_has_some(tmp_path: Path) -> None:
    """A number of threads that is given is not read from the environment."""
    exact_models.hill().write(tmp_path / "a.ply")
    order = ("simplify", tmp_path / "a.ply", "-o", tmp_path / "b.ply", "--ratio", "0.5", "--force")
    fast = (*order, "--mode", "fast")
    assert "MANIP3D_THREADS: expected" in manip3d(*fast, MANIP3D_THREADS="many").stderr
    assert manip3d(*fast, "--jobs", "2", MANIP3D_THREADS="many").returncode == 0
    for words, told in {
        ("simplify",): "Number of threads of --mode fast, or of processes",
        ("depth",): "Number of threads, or of processes for several files",
        ("inspect",): "Number of threads, or of processes for several files",
        ("convert",): "Number of processes for several files",
        ("info",): "Number of processes for several files",
    }.items():
        assert told in " ".join(manip3d(*words, "--help").stdout.split())


def test_version() -> None:
    done = manip3d("--version")
    assert done.returncode == 0
    assert done.stdout.startswith("manip3d 0.")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("lod", "a.ply", "-o", "b.glb", "--ratio", "2"), "--ratio: expected"),
        (("inspect", "a.bin", "--origin", "nan", "0", "0"), "--origin: expected"),
        (("view", "a.bin", "-o", "b.html", "--frame", "9"), "--frame: expected"),
        (("view", "a.bin", "-o", "b.html", "--color-by", "smell"), "--color-by: expected"),
        (("simulate", "sim:indoor-00", "-o", "b.pcd", "--resolution", "0"), "--resolution: exp"),
        (("--max-seconds", "nan", "info", "a.ply"), "--max-seconds: expected"),
    ],
)
def test_errors_name_the_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], expected: str
) -> None:
    if words[0] == "simulate":
        pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    monkeypatch.chdir(tmp_path)
    Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).write("a.ply")
    io.write_scan(LidarFrame(np.ones((9, 3), np.float32)), "a.bin")
    done = manip3d(*words)
    line = [line for line in done.stderr.splitlines() if "error" in line][-1]
    assert line.startswith(f"manip3d: error: {expected}"), done.stderr


def test_help_loads_nothing_heavy() -> None:
    """--help is quick because it imports no heavy module (bench_startup.py prints the time)."""
    program = """\
import sys
from manip3d.cli import main
try: main(["--help"])
except SystemExit: pass
print(*sys.modules, file=sys.stderr)
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    loaded = set(done.stderr.split())
    assert "manip3d.cli" in loaded
    heavy = {"matplotlib", "open3d", "pandas", "pyvista", "scipy", "vtk", "trimesh", "numpy"}
    assert not loaded & heavy


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["simplify", "a.obj", "--json"], "--output"),
        (["simplify", "a.obj", "--ratio", "q", "--json"], "--ratio"),
        (["watermark", "verify", "--json"], "SOURCE"),
        (["--max-bytes", "0", "info", "a.obj", "--json"], "--max-bytes"),
        (["nonsense", "--json"], "nonsense"),
    ],
)
def test_wrong_usage_is_one_json_value(arguments: list[str], expected: str) -> None:
    done = manip3d(*arguments)
    assert done.returncode == 2
    error = json.loads(done.stdout)["error"]
    assert error["code"] == "usage"
    assert expected in error["message"]
    assert "Usage:" in done.stderr


def test_no_arguments_and_wrong_ones_are_usage_errors() -> None:
    assert manip3d().returncode == 2
    assert manip3d("nonsense").returncode == 2
    assert manip3d("reproduce", "--scale", "huge").returncode == 2


def test_data_list_says_what_is_missing(tmp_path: Path) -> None:
    here = {"MANIP3D_DATA": str(tmp_path), "MANIP3D_CACHE": str(tmp_path / "cache")}
    done = manip3d("data", "list", "--json", **here)
    records = json.loads(done.stdout)
    assert sum(record["kind"] == "mesh" for record in records) == 24
    assert not any(record["here"] for record in records)
    text = manip3d("data", "list", **here).stdout
    assert "missing, can be fetched" in text
    assert "missing, get by hand" in text
    assert f"0 of {len(records)} here" in text


def test_data_list_says_what_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / datasets.get("rockerArm").files[0].path
    path.parent.mkdir(parents=True)
    path.write_text("v 0 0 0")
    done = manip3d(
        "data", "list", MANIP3D_DATA=str(tmp_path), MANIP3D_CACHE=str(tmp_path / "cache")
    )
    states = [line.split()[1] for line in done.stdout.splitlines() if line.startswith("rockerArm ")]
    assert states == ["damaged"]


def test_data_get_shows_the_licence_first_and_honours_offline(tmp_path: Path) -> None:
    done = manip3d(
        "data",
        "get",
        "rockerArm",
        MANIP3D_DATA=str(tmp_path),
        MANIP3D_CACHE=str(tmp_path),
        MANIP3D_OFFLINE="1",
    )
    assert done.returncode == 1
    lines = done.stderr.splitlines()
    assert any("licence" in line for line in lines[:-1])
    assert "MANIP3D_OFFLINE" in lines[-1]
    assert any("step 1   download https://" in line for line in lines)
    assert any("again: it checks every byte" in line for line in lines)


def test_data_get_ends_with_the_files_or_with_the_steps(tmp_path: Path) -> None:
    here = {"MANIP3D_DATA": "", "MANIP3D_CACHE": str(tmp_path), "MANIP3D_OFFLINE": "1"}
    done = manip3d("data", "get", "person_turning", "plane_holes", **here)
    assert done.returncode == 1
    lines = done.stderr.splitlines()
    assert "person_turning: to be fetched by hand" in lines[-1]
    assert [line.split()[1] for line in lines if line.startswith("  step")][:3] == ["1", "2", "3"]
    assert f"400 files under {tmp_path / 'data'}" in done.stderr


def test_unknown_data_set_is_one_line() -> None:
    assert "got 'nothing'" in error_line(manip3d("data", "get", "nothing"))


def test_traceback_only_for_debug() -> None:
    assert "Traceback" in manip3d("data", "get", "nothing", MANIP3D_LOG="debug").stderr


def test_wrong_log_level_is_refused() -> None:
    assert "MANIP3D_LOG" in error_line(manip3d("data", "list", MANIP3D_LOG="loud"))


def test_doctor_reports_state_and_cure(tmp_path: Path) -> None:
    """A data folder with the expected layout is no fault, even if it lacks most of the data."""
    (tmp_path / "meshes").mkdir()
    done = manip3d(
        "doctor",
        "--json",
        MANIP3D_DATA=str(tmp_path),
        MANIP3D_RENDERER="none",
        MANIP3D_CACHE=str(tmp_path / "cache"),
    )
    assert done.returncode == 0
    checks = {check["what"]: check for check in json.loads(done.stdout)}
    assert checks["core"]["state"] == "ok"
    mkv = checks["recordings (mkv:)"]  # not built: it says why
    assert mkv["state"] == "ok" or mkv["cure"]
    assert checks["real data"]["state"] == "missing"
    assert "MANIP3D_DATA" in checks["real data"]["cure"]
    assert checks["off-screen pictures"]["state"] == "missing"
    assert checks["recordings (mkv:)"]["state"] in ("ok", "missing")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("absent", "does not exist"),
        ("file", "is not a folder"),
        ("empty", "holds none of the folders"),
    ],
)
def test_a_wrong_data_folder_is_named(
    name: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wrong MANIP3D_DATA is an error; simulated data do not silently replace real ones."""
    (tmp_path / "file").touch()
    (tmp_path / "empty").mkdir()
    here = {"MANIP3D_DATA": str(tmp_path / name), "MANIP3D_CACHE": str(tmp_path / "cache")}
    refused = manip3d("reproduce", "table-2.1", "-o", tmp_path / "out", **here)
    assert f"MANIP3D_DATA: {tmp_path / name} {message}" in error_line(refused)
    assert not (tmp_path / "out").exists()
    assert f"{tmp_path / name} {message}" in error_line(
        manip3d("reproduce", "table-2.1", "--data", "real", "-o", tmp_path / "out", **here)
    )
    assert message in manip3d("data", "list", **here).stdout
    for variable, value in here.items():
        monkeypatch.setenv(variable, value)
    monkeypatch.setattr(doctor, "load", lambda _: None)  # packages of extras take seconds
    checks = doctor.examine()
    (check,) = [c for c in checks if c["what"] == "MANIP3D_DATA"]
    assert check["state"] == "broken"
    assert message in check["detail"]
    text = StringIO()
    told = Console(file=text, width=500)
    doctor.show(told, checks)
    shown, cures = text.getvalue().split("\nCures\n")
    assert re.search(rf"BROKEN +MANIP3D_DATA +.*{message}", shown)
    assert "set it to the data folder" in cures


def test_doctor_names_packages_that_cannot_be_imported(tmp_path: Path) -> None:
    """A package whose shared library was missing counted as installed."""
    why = "libGL.so.1: cannot open shared object file"
    (tmp_path / "cv2.py").write_text(f"raise ImportError({why!r})\n")
    done = manip3d("doctor", "--json", PYTHONPATH=str(tmp_path), MANIP3D_RENDERER="none")
    (check,) = [c for c in json.loads(done.stdout) if c["what"] == "extra alert"]
    if check["state"] == "missing":
        pytest.skip("the extra 'alert' is not installed")
    assert (done.returncode, check["state"]) == (1, "broken")
    assert why in check["detail"]
    assert check["cure"]


def test_unknown_experiment_is_refused() -> None:
    assert "got table-9.9" in error_line(manip3d("reproduce", "table-9.9"))


@pytest.mark.parametrize("as_json", [False, True])
def test_color_and_control_codes_stay_out_of_pipes(as_json: bool) -> None:
    done = manip3d("data", "list", *(["--json"] if as_json else []))
    assert "\x1b" not in done.stdout


# --- Verbs on meshes ----------------------------------------------------------------------------


@pytest.fixture
def torus(tmp_path: Path) -> Path:
    """Write a closed textured surface of 1 152 faces."""
    n, m = 36, 16
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a, b = 2 * np.pi * i / n, 2 * np.pi * j / m
    ring = 2 + np.cos(b)
    points = np.stack([ring * np.cos(a), np.sin(b), ring * np.sin(a)], -1).reshape(-1, 3)
    corner = [((i + di) % n) * m + (j + dj) % m for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1))]
    p, q, r, t = (index.ravel() for index in corner)
    faces = np.vstack([np.column_stack([p, t, q]), np.column_stack([q, t, r])])
    path = tmp_path / "torus.ply"
    Mesh(points, faces).write(path)
    return path


def test_simplify_reaches_the_target_and_says_what_it_did(torus: Path, tmp_path: Path) -> None:
    output = tmp_path / "light.obj"
    done = manip3d("simplify", torus, "-o", output, "--faces", "300")
    assert done.returncode == 0
    assert done.stdout == ""
    assert "read" in done.stderr
    assert "target reached" in done.stderr
    assert read_mesh(output).num_faces <= 300


@pytest.mark.parametrize("method", ["qem4vr", "qem-orig", "qem-bp", "qem-tp", "qem-btp"])
def test_every_method_has_a_name(torus: Path, tmp_path: Path, method: str) -> None:
    output = tmp_path / "light.ply"
    done = manip3d("simplify", torus, "-o", output, "--ratio", "0.5", "--method", method, "--json")
    record = json.loads(done.stdout)
    if method in ("qem-tp", "qem-btp"):  # no texture coordinates: the published failure
        assert done.returncode == 1
        assert record["stop"] == "refused"
        assert not output.exists()
    else:
        assert record["faces_after"] <= 576
        assert record["target_missed"] is False


def test_a_limit_without_a_target_misses_none(torus: Path, tmp_path: Path) -> None:
    output = tmp_path / "light.ply"
    order = ("simplify", torus, "-o", output, "--strict", "--json")
    done = manip3d(*order, "--max-distance", "1e9")
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    assert (record["stop"], record["target_missed"]) == ("no_legal_collapse", False)
    assert "missed" not in done.stderr
    output.unlink()
    # The error of a collapse, which may be larger than the bound, is not printed beside it.
    done = manip3d(*order[:-1], "--max-distance", "0.01")
    assert ", at most 0.01 from the input (units of the file), " in done.stderr
    assert "largest error" not in done.stderr
    output.unlink()
    assert manip3d(*order, "--max-distance", "1e9", "--faces", "1").returncode in (0, 4)
    done = manip3d(*order, "--headset", "0", "90")
    assert error_line(done).endswith("--headset: MS: expected a number > 0, got 0.0")
    both = ("simplify", torus, torus, "-o", tmp_path / "several", "--json", "--jobs", "1")
    done = manip3d(*both, "--headset", "5000", "90")  # 80 % of 1/90 s for both eyes
    assert [row["target_faces"] for row in json.loads(done.stdout)] == [888], done.stderr


def test_quality_is_the_mode_of_users(torus: Path, tmp_path: Path) -> None:
    output = tmp_path / "light.ply"
    base = ("simplify", torus, "-o", output, "--ratio", "0.5", "--json", "--force")
    assert json.loads(manip3d(*base).stdout)["method"] == "quality"
    assert json.loads(manip3d(*base, "--mode", "quality").stdout)["method"] == "quality"
    assert json.loads(manip3d(*base, "--mode", "published").stdout)["method"] == "qem4vr"
    clash = manip3d(*base, "--mode", "quality", "--method", "qem-bp")
    assert "--mode published" in error_line(clash)


@pytest.mark.parametrize("mode", ["quality", "fast"])
def test_what_lies_in_the_lock_box_stays(torus: Path, tmp_path: Path, mode: str) -> None:
    output = tmp_path / "light.ply"
    base = ("simplify", torus, "-o", output, "--ratio", "0.2", "--force", "--mode", mode)
    done = manip3d(*base, "--lock-box", "2", "-1", "-0.5", "3", "1", "0.5")
    assert done.returncode == 0
    original = read_mesh(torus).vertices
    low, high = [2, -1, -0.5], [3, 1, 0.5]
    kept = original[((original >= low) & (original <= high)).all(axis=1)]
    assert f"--lock-box holds {len(kept)} vertices" in done.stderr
    assert len(kept) > 10
    after = {tuple(vertex) for vertex in read_mesh(output).vertices}
    assert all(tuple(vertex) in after for vertex in kept)
    assert read_mesh(output).num_faces <= 231
    refused = manip3d(*base[:-1], "published", "--lock-box", "0", "0", "0", "1", "1", "1")
    assert "--mode quality or fast" in error_line(refused)


@pytest.mark.parametrize("mode", ["quality", "fast"])
@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_tiles_whose_boundaries_are_locked_still_meet(
    tmp_path: Path, mode: str, suffix: str
) -> None:
    whole = simulate.models.floor(columns=24, rows=20)
    x = whole.vertices[whole.faces, 0]
    middle = np.median(x)
    edges, before = [], []
    for name, inside in (("a", x.max(axis=1) <= middle), ("b", x.min(axis=1) >= middle)):
        tile = Mesh(whole.vertices, whole.faces[inside])
        tile.write(tmp_path / f"{name}{suffix}")
        done = manip3d("simplify", tmp_path / f"{name}{suffix}", "-o", tmp_path / f"{name}.off",
                       "--ratio", "0.25", "--mode", mode, "--lock-boundary", "--json")  # fmt: skip
        assert done.returncode == 0, done.stderr
        small = read_mesh(tmp_path / f"{name}.off")
        assert small.num_faces <= 0.25 * tile.num_faces
        assert small.summary().boundary_edges_welded == tile.summary().boundary_edges_welded
        for mesh, found in ((tile, before), (small, edges)):
            vertices = mesh.vertices[np.unique(mesh.faces)]
            found.append({tuple(np.float32(v)) for v in vertices if v[0] == middle})
    assert edges[0] == edges[1] == before[0]
    assert len(edges[0]) == 21
    refused = manip3d("simplify", tmp_path / f"a{suffix}", "-o", tmp_path / "x.off", "--ratio",
                      "0.5", "--mode", "published", "--lock-boundary")  # fmt: skip
    assert "--lock-boundary: expected --mode quality or fast" in error_line(refused)


@pytest.mark.parametrize("mode", ["quality", "fast"])
@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_color_weight_keeps_painted_regions(tmp_path: Path, mode: str, suffix: str) -> None:
    flat = simulate.models.floor(columns=40, rows=40)
    middle = flat.vertices.mean(axis=0)
    inside = np.linalg.norm(flat.vertices - middle, axis=1) < 0.3 * np.ptp(flat.vertices[:, 0])
    painted = Mesh(
        flat.vertices,
        flat.faces,
        colors=np.where(inside[:, None], [220, 30, 30], 240).astype(np.uint8),
    )
    source, light = tmp_path / f"painted{suffix}", tmp_path / f"light{suffix}"
    painted.write(source)
    base = ("simplify", source, "-o", light, "--force", "--ratio", "0.05")
    errors = {}
    for weight in ("0", "0.2"):
        done = manip3d(*base, "--mode", mode, "--color-weight", weight, "--json")
        assert done.returncode == 0, done.stderr
        compared = manip3d("compare", source, light, "--json")
        errors[weight] = json.loads(compared.stdout)["color_error"]["mean"]
    assert errors["0.2"] < 0.5 * errors["0"]
    assert "colour error, mean, levels of 255" in manip3d("compare", source, light).stdout
    done = manip3d("lod", source, "-o", tmp_path / "lods.glb", "--levels", "2", "--mode", mode,
                   "--color-weight", "0.2")  # fmt: skip
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("verb", [("simplify", "--ratio", "0.5"), ("lod",)])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--mode", "published", "--color-weight", "1"), "expected --mode quality or fast"),
        (("--color-weight", "-1"), "expected a finite number >= 0"),
        (("--color-weight", "nan"), "expected a finite number >= 0"),
    ],
)
def test_a_wrong_price_of_colors_is_refused(
    tmp_path: Path, verb: tuple[str, ...], options: tuple[str, ...], message: str
) -> None:
    simulate.models.floor(columns=3, rows=3).write(tmp_path / "floor.ply")
    command, *more = verb
    refused = manip3d(command, tmp_path / "floor.ply", "-o", tmp_path / "out.glb", *more, *options)
    assert refused.returncode != 0
    assert f"--color-weight: {message}" in error_line(refused)
    assert not (tmp_path / "out.glb").exists()


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_each_level_of_a_tile_keeps_its_boundary(tmp_path: Path, suffix: str) -> None:
    simulate.models.floor(columns=24, rows=20).write(tmp_path / f"tile{suffix}")
    base = ("lod", tmp_path / f"tile{suffix}", "-o", tmp_path / "levels", "--levels", "3")
    done = manip3d(*base, "--lock-boundary", "--json")
    assert done.returncode == 0, done.stderr
    faces = [level["faces"] for level in json.loads(done.stdout)["levels"]]
    assert faces[1] <= faces[0] // 2
    assert faces[2] <= faces[0] // 4
    levels = [read_mesh(file) for file in sorted((tmp_path / "levels").glob("*.glb"))]
    assert [level.num_faces for level in levels] == faces
    rims = [level.vertices[simplify.boundary_vertices(level)] for level in levels]
    sets = [set(map(tuple, np.float32(rim))) for rim in rims]
    assert sets[0] == sets[1] == sets[2]
    assert len(sets[0]) == 2 * (24 + 20)
    refused = manip3d(*base, "--force", "--mode", "published", "--lock-box", *"000111")
    assert "--lock-box: expected --mode quality or fast" in error_line(refused)


def test_importance_comes_from_a_file(torus: Path, tmp_path: Path) -> None:
    mesh = read_mesh(torus)
    weights, output = tmp_path / "weights.npy", tmp_path / "light.ply"
    base = (
        "simplify",
        torus,
        "-o",
        output,
        "--ratio",
        "0.2",
        "--quiet",
        "--force",
        "--importance",
        weights,
    )
    np.save(weights, np.where(mesh.vertices[:, 0] > 0, 50, 1))
    assert manip3d(*base).returncode == 0
    centers = read_mesh(output).vertices[read_mesh(output).faces].mean(axis=1)[:, 0]
    assert (centers > 0).sum() > 2 * (centers < 0).sum()
    assert "--importance: expected --mode quality" in error_line(manip3d(*base, "--mode", "fast"))
    np.save(weights, np.ones(7))
    refusal = f"importance: expected numbers of shape ({mesh.num_vertices},)"
    assert refusal in error_line(manip3d(*base))
    np.save(weights, np.ones((7, 2)))
    assert "weights.npy: expected one number for each vertex" in error_line(manip3d(*base))
    weights.write_bytes(weights.read_bytes()[:100])
    assert "weights.npy: " in error_line(manip3d(*base))
    weights.write_text("1 2 3")
    assert "weights.npy: " in error_line(manip3d(*base))
    header = b"{'descr': (".ljust(117) + b"\n"  # Python's tokenizer fails, not NumPy
    weights.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)
    assert "weights.npy: " in error_line(manip3d(*base))
    weights.unlink()
    os.mkfifo(weights)
    assert "expected a regular file" in error_line(manip3d(*base))


def test_seam_mode_is_for_the_published_method(torus: Path, tmp_path: Path) -> None:
    base = ("simplify", torus, "-o", tmp_path / "x.ply", "--ratio", "0.5", "--seam-mode", "paper")
    assert "--method qem4vr" in error_line(manip3d(*base))
    assert manip3d(*base, "--mode", "published").returncode == 0


def test_targets_refer_to_the_faces_as_read(torus: Path, tmp_path: Path) -> None:
    mesh = read_mesh(torus)
    doubled = tmp_path / "doubled.ply"
    Mesh(mesh.vertices, np.vstack([mesh.faces, mesh.faces])).write(doubled)
    arguments = ("simplify", doubled, "-o", tmp_path / "x.ply", "--ratio", "0.25", "--json")
    record = json.loads(manip3d(*arguments).stdout)
    assert record["faces_before"] == 2304
    assert record["faces_cleaned"] == 1152
    assert record["target_faces"] == 576


def test_cleaning_is_left_out_for_the_published_method_only(torus: Path, tmp_path: Path) -> None:
    for verb, more in (("simplify", ("--ratio", "0.5")), ("lod", ())):
        base = (verb, torus, "-o", tmp_path / "x.glb", *more, "--force", "--no-clean", "--mode")
        for mode in ("quality", "fast"):
            assert "--no-clean: expected --mode published" in error_line(manip3d(*base, mode))
        assert manip3d(*base, "published").returncode == 0


def test_a_small_ratio_leaves_a_face(torus: Path, tmp_path: Path) -> None:
    arguments = ("simplify", torus, "-o", tmp_path / "x.ply", "--ratio", "0.0001", "--json")
    assert json.loads(manip3d(*arguments).stdout)["target_faces"] == 1


def test_a_missed_target_is_exit_4_under_strict(tmp_path: Path) -> None:
    path = tmp_path / "tetrahedron.ply"  # closed: the published rules allow no face less
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    Mesh(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]).write(path)
    arguments = ("simplify", path, "-o", tmp_path / "x.ply", "--faces", "1", "--force")
    arguments += ("--mode", "published")
    done = manip3d(*arguments)
    assert done.returncode == 0
    assert "target of 1 face missed" in done.stderr
    assert manip3d(*arguments, "--strict").returncode == 4


def test_quiet_leaves_out_warnings_but_no_errors(tmp_path: Path) -> None:
    """-q silences warnings of readers and writers, in this process and in workers."""
    for name in ("a.obj", "b.obj"):
        text = "mtllib gone.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 1\nf 1 2 3\nf 2 4 3\n"
        (tmp_path / name).write_text(text)
    one = ("simplify", tmp_path / "a.obj", "-o", tmp_path / "a.glb", "--faces", "1", "--force")
    many = ("convert", tmp_path, "-o", tmp_path / "out", "--to", ".glb", "--jobs", "2", "--force")
    for command in (one, many):
        told, quiet = manip3d(*command), manip3d(*command, "-q")
        assert "gone.mtl" in told.stderr
        assert (quiet.returncode, quiet.stderr) == (0, "")
        assert "gone.mtl" in manip3d(*command, "--quiet", MANIP3D_LOG="warning").stderr
    assert "none.obj" in error_line(manip3d("info", tmp_path / "none.obj", "-q"))


def test_simplify_without_a_target_is_an_error(torus: Path, tmp_path: Path) -> None:
    done = manip3d("simplify", torus, "-o", tmp_path / "x.ply", "-q")
    assert done.returncode == 2  # as of 'depth' without --points
    assert "--faces" in done.stderr
    done = manip3d("simplify", torus, "-o", tmp_path / "x.ply", "--ratio", "1.5", "-q")
    assert "--ratio" in error_line(done)


@pytest.mark.parametrize(
    "limits",
    [
        ("--ratio", "0"),
        ("--ratio", "nan"),
        ("--max-distance", "inf"),
        ("--max-error", "nan"),
        ("--lock-box", "1", "1", "1", "0", "0", "0"),
        ("--lock-box", "nan", "0", "0", "1", "1", "1"),
    ],
)
def test_limits_without_sense_are_refused_before_the_mesh_is_read(
    limits: tuple[str, ...], tmp_path: Path
) -> None:
    order = ("simplify", tmp_path / "none.obj", "-o", tmp_path / "x.ply", "-q")
    done = manip3d(*order, *limits, *(() if limits[0] == "--ratio" else ("--ratio", "0.5")))
    assert done.returncode == 1
    assert error_line(done).startswith(f"manip3d: error: {limits[0]}: expected")


def test_existing_outputs_are_refused_without_force(torus: Path, tmp_path: Path) -> None:
    output = tmp_path / "there.ply"
    output.write_text("mine")
    arguments = ("simplify", torus, "-o", output, "--faces", "300", "-q")
    assert "--force" in error_line(manip3d(*arguments))
    assert output.read_text() == "mine"
    assert manip3d(*arguments, "--force").returncode == 0
    assert output.read_bytes().startswith(b"ply")
    assert "--force" in error_line(manip3d("convert", torus, "-o", output))
    page = tmp_path / "there.html"
    page.write_text("mine")
    assert "--force" in error_line(manip3d("view", torus, "-o", page))


def test_a_folder_becomes_a_folder(torus: Path, tmp_path: Path) -> None:
    source = tmp_path / "in"
    (source / "deep").mkdir(parents=True)
    torus.rename(source / "deep" / "a.ply")
    read_mesh(source / "deep" / "a.ply").write(source / "b.obj")
    (source / "broken.ply").write_text("ply\nnonsense\n")
    done = manip3d("simplify", source, "-o", tmp_path / "out", "--ratio", "0.5", "--json")
    assert done.returncode == 1  # one of three failed, and the others are there
    records = {Path(record["source"]).name: record for record in json.loads(done.stdout)}
    assert "FormatError" in records["broken.ply"]["error"]
    assert read_mesh(tmp_path / "out" / "deep" / "a.ply").num_faces <= 576
    assert read_mesh(tmp_path / "out" / "b.obj").num_faces <= 576


def test_an_output_of_several_files_is_a_folder(torus: Path, tmp_path: Path) -> None:
    half = ["--ratio", "0.5", "-o", tmp_path / "light.ply"]
    several = error_line(manip3d("simplify", torus, torus, *half))
    assert "light.ply: expected a folder for several files" in several
    folder = error_line(manip3d("simplify", tmp_path, *half))
    assert f"light.ply: expected a folder for the files of {tmp_path}" in folder
    assert not (tmp_path / "light.ply").exists()
    (tmp_path / "light.ply").mkdir()  # whoever wants such a folder makes it
    assert manip3d("simplify", torus, *half, "--table", tmp_path / "t.csv").returncode == 0
    assert (tmp_path / "light.ply" / torus.name).is_file()


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    done = manip3d("simplify", tmp_path / "in", "-o", tmp_path / "out", "--ratio", "0.5")
    assert "found none" in error_line(done)


def test_stdin_is_a_source(torus: Path, tmp_path: Path) -> None:
    done = manip3d("info", "-", "--json", stdin=torus.read_bytes())
    assert json.loads(done.stdout)["faces"] == 1152
    assert manip3d("info", "-", stdin=b"").returncode == 1


def test_info_counts(torus: Path) -> None:
    record = json.loads(manip3d("info", torus, "--json").stdout)
    assert (record["vertices"], record["faces"], record["boundary_edges"]) == (576, 1152, 0)
    text = manip3d("info", torus).stdout
    assert "1 152" in text
    assert "closed" in text


def test_info_names_embedded_textures(tmp_path: Path) -> None:
    textures = {"base_color": Texture(data=PNG), "normal": Texture("n.png", PNG)}
    mesh = Mesh(
        np.eye(3), [[0, 1, 2]], texcoords=np.eye(3)[:, :2], face_texcoords=[[0, 1, 2]],
        face_material=[0], materials=[Material("wood", textures=textures)],
    )  # fmt: skip
    mesh.write(tmp_path / "a.glb")
    (material,) = json.loads(manip3d("info", tmp_path / "a.glb", "--json").stdout)["materials"]
    embedded = f"embedded ({len(PNG)} bytes)"
    assert material == {"name": "wood", "textures": {"base_color": embedded, "normal": embedded}}
    assert f"material  wood  {embedded}" in manip3d("info", tmp_path / "a.glb").stdout


def test_compare_measures_both_directions_and_samplings(torus: Path, tmp_path: Path) -> None:
    light = tmp_path / "light.ply"
    manip3d("simplify", torus, "-o", light, "--faces", "300")
    record = json.loads(manip3d("compare", torus, light, "--json").stdout)
    assert record["faces"][0] == 1152
    meshes = read_mesh(torus), read_mesh(light)
    for sampling in ("vertex", "area"):
        found = metro(*meshes, sampling=sampling)
        for direction, expected in (("forward", found.forward), ("backward", found.backward)):
            assert record["metro"][sampling][direction]["mean"] == pytest.approx(expected.mean)
    assert found.forward.mean > 0
    assert found.forward.mean != found.backward.mean
    assert record["boundary_gap"]["cracks"] == 0
    text = manip3d("compare", torus, light).stdout
    assert "Metro, area samples, simplified to original" in text
    assert "diagonal" in text
    assert "FMPD" in text
    same = json.loads(manip3d("compare", torus, torus, "--json").stdout)
    assert same["metro"]["vertex"]["forward"]["max"] == 0


def test_convert_leaves_coordinates_alone_unless_asked(torus: Path, tmp_path: Path) -> None:
    original = read_mesh(torus)
    plain, metres = tmp_path / "plain.obj", tmp_path / "metres.ply"
    assert manip3d("convert", torus, "-o", plain).returncode == 0
    assert np.array_equal(read_mesh(plain).vertices, original.vertices)
    assert manip3d("convert", torus, "-o", metres, "--unit", "mm", "--up", "z").returncode == 0
    x, y, z = original.vertices.T
    np.testing.assert_allclose(
        read_mesh(metres).vertices, 1e-3 * np.column_stack([x, z, -y]), atol=1e-9
    )


def test_missing_and_broken_files_are_one_line(tmp_path: Path) -> None:
    absent = error_line(manip3d("info", tmp_path / "absent.obj"))
    assert "absent.obj: No such file" in absent
    broken = tmp_path / "broken.obj"
    broken.write_text("v 0 0 0\nf 1 2 9\n")
    assert "broken.obj: line 2" in error_line(manip3d("info", broken))


def test_view_refuses_other_kinds(torus: Path, tmp_path: Path) -> None:
    assert ".html" in error_line(manip3d("view", torus, "-o", tmp_path / "x.gif", "-q"))


# --- Experiments --------------------------------------------------------------------------------


def test_values_that_only_the_command_can_judge_are_errors_of_input(tmp_path: Path) -> None:
    mesh = tmp_path / "a.off"
    mesh.write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    for order, exit_code, code in (
        (("simplify", mesh, "--faces", 0, "-o", tmp_path / "b.off"), 2, "usage"),
        (("simplify", mesh, "--ratio", 1.5, "-o", tmp_path / "b.off"), 1, "input"),
        (("simplify", mesh, "--ratio", 0.5, "-o", tmp_path / "b.foo"), 1, "input"),
        (
            ("depth", mesh, "--points", 50, "--intrinsics", "nosuch", "-o", tmp_path / "b.glb"),
            1,
            "input",
        ),
    ):
        done = manip3d(*order, "--json")
        assert done.returncode == exit_code
        assert json.loads(done.stdout)["error"]["code"] == code


def test_reproduce_lists_what_is_missing(tmp_path: Path) -> None:
    here = {"MANIP3D_DATA": str(tmp_path), "MANIP3D_CACHE": str(tmp_path / "cache")}
    records = json.loads(manip3d("reproduce", "--list", "--json", **here).stdout)
    by_id = {record["id"]: record for record in records}
    assert {"table-2.1", "table-2.2", "figure-2.17"} <= set(by_id)
    assert by_id["table-2.2"]["missing"] == by_id["table-2.2"]["data"]
    listed = manip3d("reproduce", "--list", **here).stdout
    assert "simulated" in listed
    lines = {line.split()[0]: line.rstrip() for line in listed.splitlines()}
    assert lines["figure-7.7"].endswith("none needed")
    assert "kitti_object" in by_id["detector-3"]["missing"]
    assert "kitti_object" in by_id["table-7.2-cross-modal"]["missing"]
    sets = json.loads(manip3d("data", "list", "--json", **here).stdout)
    absent = {each["name"] for each in sets if not each["here"]}
    assert {name for record in records for name in record["missing"]} <= absent


def test_quiet_reproduction_prints_the_verdicts_and_their_data_alone(tmp_path: Path) -> None:
    """With -q it still told how to make a page of the results."""
    order = ("reproduce", "figure-7.8", "--scale", "quick", "--data", "simulated")
    done = manip3d(*order, "-o", tmp_path, "-q")
    assert "manip3d report" not in done.stdout + done.stderr
    assert "data" in done.stdout.split()
    assert "makes one page of it" in manip3d(*order, "-o", tmp_path).stderr
    (first, *_) = json.loads(manip3d(*order, "-o", tmp_path, "--json").stdout)["verdicts"][
        "figure-7.8"
    ]
    assert set(first) == {"claim", "verdict", "data"}


def test_strict_does_not_take_undecided_for_refuted(tmp_path: Path) -> None:
    done = manip3d(
        "reproduce", "figure-5.7", "--scale", "quick", "--data", "simulated", "--strict", "--json",
        "-o", tmp_path / "out", MANIP3D_RENDERER="none",
    )  # fmt: skip
    verdicts = {v["verdict"] for v in json.loads(done.stdout)["verdicts"]["figure-5.7"]}
    assert "undecided" in verdicts
    assert "does not hold" not in verdicts
    assert done.returncode == 0


def test_simulated_experiments_are_skipped_where_real_data_is_asked_for(tmp_path: Path) -> None:
    done = manip3d("reproduce", "figure-7.7", "--data", "real", "-o", tmp_path / "out", "-q")
    assert "--data: expected an experiment with real data, got figure-7.7" in error_line(done)
    assert not (tmp_path / "out").exists()
    two = ("reproduce", "table-2.1", "real-scans-6", "--scale", "quick", "-o", tmp_path / "out")
    done = manip3d(*two, "--data", "simulated", MANIP3D_RENDERER="none")
    assert done.returncode == 0, done.stderr
    assert "skipped, without simulated data: real-scans-6" in done.stderr
    done = manip3d("reproduce", "--list", "table-2.1", "real-scans-6", MANIP3D_DATA="")
    stand_in = [line.partition("not here: ")[2].strip() for line in done.stdout.splitlines()[1:]]
    assert stand_in == ["simulated models stand in", "no simulated models stand in"]


def test_reproduce_and_report(tmp_path: Path) -> None:
    results = tmp_path / "results"
    arguments = ("reproduce", "table-2.1", "-o", results, "--scale", "quick", "--json")
    simulated = (*arguments, "--data", "simulated")
    first = json.loads(manip3d(*simulated, MANIP3D_RENDERER="none").stdout)
    assert first["failed"] == 0
    again = json.loads(manip3d(*simulated, MANIP3D_RENDERER="none").stdout)
    assert again["resumed"] == again["cases"] == first["cases"]
    anew = json.loads(manip3d(*simulated, "--force", MANIP3D_RENDERER="none").stdout)
    assert (anew["resumed"], anew["cases"]) == (0, first["cases"])
    page = tmp_path / "page.html"
    done = manip3d("report", results, "-o", page)
    assert done.returncode == 0
    assert str(page) in done.stderr
    assert "table-2.1" in page.read_text()
    assert "--force" in error_line(manip3d("report", results, "-o", page))


def test_reproduce_refuses_a_foreign_folder(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    assert "--force" in error_line(manip3d("reproduce", "table-2.1", "-o", tmp_path, "-q"))


def test_real_data_that_is_missing_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    done = manip3d(
        "reproduce",
        "table-2.1",
        "--data",
        "real",
        "-q",
        "-o",
        tmp_path / "out",
        MANIP3D_DATA=str(tmp_path),
        MANIP3D_CACHE=str(tmp_path / "cache"),
    )
    assert "manip3d data get" in error_line(done)


def test_many_meshes_are_counted_converted_and_compared(torus: Path, tmp_path: Path) -> None:
    source = tmp_path / "in"
    source.mkdir()
    torus.rename(source / "a.ply")
    read_mesh(source / "a.ply").write(source / "b.obj")
    listed = manip3d("info", source / "*", "--jobs", "1", "-q")
    assert listed.returncode == 0
    header, *rows = listed.stdout.splitlines()
    assert header.split() == ["source", "faces", "vertices", "materials_used"]
    assert [row.split()[:2] for row in rows] == [
        [f"{source}/a.ply", "1152"],
        [f"{source}/b.obj", "1152"],
    ]
    done = manip3d("convert", source, "-o", tmp_path / "glb", "--to", ".glb", "--jobs", "1")
    assert done.returncode == 0, done.stderr
    assert read_mesh(tmp_path / "glb" / "a.glb").num_faces == 1152
    done = manip3d("convert", source / "a.ply", "-o", tmp_path / "one", "--to", ".off")
    assert done.returncode == 0, done.stderr  # a folder that a pattern found one file in, too
    assert read_mesh(tmp_path / "one" / "a.off").num_faces == 1152
    assert "--to: expected one of" in error_line(
        manip3d("convert", source, "-o", tmp_path / "x", "--to", ".asd")
    )
    done = manip3d("compare", source, tmp_path / "glb", "--json", "--jobs", "1")
    assert done.returncode == 0, done.stderr
    records = json.loads(done.stdout)
    assert [record["original"] for record in records] == [f"{source}/a.ply", f"{source}/b.obj"]
    assert all(record["metro"]["vertex"]["forward"]["max"] < 1e-6 for record in records)
    one = json.loads(manip3d("compare", source, tmp_path / "glb" / "b.glb", "--json").stdout)
    assert (one["original"], one["seed"]) == (f"{source}/b.obj", 0)
    for original, told in (("-", "several meshes, got stdin"), ("", "an address, got ''")):
        assert told in error_line(manip3d("compare", original, tmp_path / "glb"))
    assert "an address, got ''" in error_line(manip3d("compare", "", tmp_path / "glb" / "b.glb"))
    (source / "b.obj").rename(source / "A.obj")
    (tmp_path / "glb" / "b.glb").rename(tmp_path / "glb" / "A.glb")  # differs from a.glb in case
    done = manip3d("compare", source, tmp_path / "glb", "--json", "--jobs", "1")
    assert {record["original"] for record in json.loads(done.stdout)} == {
        f"{source}/a.ply", f"{source}/A.obj",
    }  # fmt: skip
    (source / "A.obj").rename(source / "a.off")
    done = manip3d("compare", source, tmp_path / "glb", "--jobs", "1")
    assert f"found {source}/a.off and {source}/a.ply" in error_line(done)


def test_a_url_is_a_source_and_an_output(torus: Path, tmp_path: Path) -> None:
    url = f"file://{torus}"
    done = manip3d("info", url, "--json", "-q")
    record = json.loads(done.stdout)
    assert (record["file"], record["faces"]) == (url, 1152)
    done = manip3d("convert", url, "-o", f"file://{tmp_path}/out/x.glb")
    assert done.returncode == 0, done.stderr
    assert "manip3d-" not in done.stderr  # no temporary name is shown
    assert read_mesh(tmp_path / "out" / "x.glb").num_faces == 1152


@pytest.mark.parametrize(
    ("during", "raised"),
    [
        *((name, "KeyboardInterrupt") for name in ("typer", "manip3d.errors", "numpy")),
        ("manip3d._core", "KeyboardInterrupt"),
        ("manip3d._core", "ImportError('initialization failed') from KeyboardInterrupt()"),
    ],
)
def test_ctrl_c_during_the_imports_leaves_no_traceback(during: str, raised: str) -> None:
    """An interrupted import of a compiled module raises an ImportError, which must not be shown."""
    code = f"""
import sys
class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == "{during}":
            raise {raised}
sys.meta_path.insert(0, Interrupting())
from manip3d._entry import main
sys.argv = ["manip3d", "info", "absent.obj"]
main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert (done.returncode, done.stderr.splitlines()) == (130, [b"manip3d: interrupted"])


def test_a_library_that_does_not_fit_into_memory_is_no_bug(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*words: object, **more: object) -> None:
        raise ImportError("_core.so: failed to map segment from shared object")

    monkeypatch.setattr(cli, "app", fails)
    with pytest.raises(SystemExit, match="1"):
        cli.main(["info", "a.obj"])
    told = capsys.readouterr().err
    assert "failed to map segment from shared object (too little memory, or" in told
    assert "internal error" not in told


def test_what_asks_the_demo_to_end_ends_it_like_ctrl_c(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The demo's worker processes end, too, and leave no semaphores behind."""

    def ended(*arguments: object, **options: object) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(5)

    monkeypatch.setattr("manip3d.report.demo.run_demo", ended)
    shell = Terminal(quiet=True)
    with pytest.raises(KeyboardInterrupt):
        tell(tmp_path / "demo", data="simulated", seed=0, jobs=1, terminal=shell)


@pytest.mark.parametrize("verb", [["info"], ["compare"], ["capture", "info"]])
def test_help_does_not_name_an_option_that_a_command_lacks(verb: list[str]) -> None:
    told = " ".join(manip3d(*verb, "--help").stdout.split())
    assert "--table" in told
    assert "-o" not in told.replace("-of", "")
    assert "Default with -o" in " ".join(manip3d("convert", "--help").stdout.split())


def test_a_folder_that_may_not_be_read_is_named_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(PermissionError) as told:
        kind_of(str(tmp_path))
    assert told.value.filename == str(tmp_path)


def test_warnings_are_lines_without_places_in_the_code(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.full((20, 20), 2.0, np.float32))
    camera = tmp_path / "camera.json"
    camera.write_text('{"fx": 20, "fy": 20, "cx": 9.5, "cy": 9.5, "note": 1}')
    order = ("--points", "9", "--intrinsics", camera, "-o", tmp_path / "a.glb", "--force")
    done = manip3d("depth", tmp_path / "a.npy", *order)
    assert done.returncode == 0, done.stderr
    warning = "warning: fields that are not a camera's are left out: 'note'"
    assert warning in done.stderr.splitlines()
    assert manip3d("depth", tmp_path / "a.npy", *order, "--quiet").stderr == ""
    for more in ((), ("--quiet",)):
        told = json.loads(manip3d("depth", tmp_path / "a.npy", *order, "--json", *more).stdout)
        assert told["warnings"] == [warning.removeprefix("warning: ")]
    ignored = manip3d("depth", tmp_path / "a.npy", *order, "--json", PYTHONWARNINGS="ignore")
    assert "warnings" not in json.loads(ignored.stdout)
    assert warning not in ignored.stderr


@pytest.mark.parametrize("more", [("--jobs", "1"), ("--jobs", "2"), ("--jobs", "2", "--quiet"),
                                  ("--dask", "local")])  # fmt: skip
def test_warnings_of_the_library_are_in_the_rows(more: tuple[str, ...], tmp_path: Path) -> None:
    """Each row states its warnings; on stderr a warning is printed once for all files."""
    if "--dask" in more:
        pytest.importorskip("distributed")
    images = tmp_path / "images"
    images.mkdir()
    for name in ("a", "b", "c", "d"):
        np.save(images / f"{name}.npy", np.full((20, 20), 2.0, np.float32))
    camera = tmp_path / "camera.json"
    camera.write_text('{"fx": 20, "fy": 20, "cx": 9.5, "cy": 9.5, "note": 1}')
    order = ("--points", "9", "--intrinsics", camera, "-o", tmp_path / "out", "--json")
    done = manip3d("depth", images, *order, *more)
    assert done.returncode == 0, done.stderr
    warning = "fields that are not a camera's are left out: 'note'"
    assert [row["warnings"] for row in json.loads(done.stdout)] == [[warning]] * 4
    assert done.stderr.count(warning) == ("--quiet" not in more)
    if "--quiet" not in more:
        assert f"{images / 'a.npy'} and 3 more files: warning: {warning}\n" in done.stderr


def test_an_empty_name_is_no_folder(tmp_path: Path) -> None:
    """An empty source, as from an unset variable of a script, is an error."""
    for verb, *more in (("simplify", "--ratio", "0.5"), ("play",), ("lattice",)):
        line = error_line(manip3d(verb, "", *more, "-o", tmp_path / "out"))
        assert line.endswith("source: expected a file, a folder or an address, got ''")


def test_wrong_numbers_of_films_and_levels_name_their_option(torus: Path, tmp_path: Path) -> None:
    done = manip3d("play", torus, "-o", tmp_path / "a.html", "--rate", "nan")
    assert error_line(done).startswith("manip3d: error: --rate: expected above 0")
    done = manip3d("lod", torus, "-o", tmp_path / "a.glb", "--levels", 10**20)
    assert "manip3d: error: --levels: expected a whole number of 64 bits" in done.stderr


def test_names_with_brackets_and_colons_are_no_markup(tmp_path: Path) -> None:
    """A bracket was taken for a style, or ended in an error."""
    mesh = exact_models.ball(5)
    for name in ("glass[red]pane", "a[/b]", ":smile:"):
        materials = [Material(name)]
        path = tmp_path / "head[old].obj"
        mesh.replace(materials=materials, face_material=[0] * mesh.num_faces).write(path)
        printed = manip3d("info", path).stdout
        assert name in printed
        assert "head[old].obj" in printed


def test_a_column_with_negative_numbers_is_right_aligned(capsys: pytest.CaptureFixture) -> None:
    rows = [("a", "1.5", "m"), ("b", "-12.25", "m"), ("c", "", "m")]
    table(Terminal().out, rows, ("name", "value", "unit"))
    lines = capsys.readouterr().out.splitlines()
    assert [line.index("m", 4) for line in lines[1:]] == [lines[0].index("unit")] * 3
    assert lines[1].index("1.5") + len("1.5") == lines[2].index("-12.25") + len("-12.25")
    table(Terminal().out, [])
    assert not capsys.readouterr().out


def test_outputs_are_named_where_lower_case_is_longer(tmp_path: Path) -> None:
    """The lower case of a dotted capital I has two characters."""
    names = ("\u0130stanbul.obj", "\u0130\u0130.OBJ.gz")
    mesh = exact_models.ball(5)
    for name in names:
        mesh.write(tmp_path / name)
    manip3d("convert", *(tmp_path / name for name in names), "--to", ".glb", "-o", tmp_path / "out",
            *("--jobs", "1"))  # fmt: skip
    made = sorted(path.name for path in (tmp_path / "out").glob("*.glb"))
    assert made == ["\u0130stanbul.glb", "\u0130\u0130.glb"]


def test_long_texts_wrap_where_the_numbers_beside_them_need_the_room() -> None:
    text = StringIO()
    rows = [("points removed", "10%", "4 of 40"), ("a class with a long name " * 6, "0%", "none")]
    table(Console(file=text, width=100, force_terminal=True, color_system=None), rows)
    assert "4 of 40" in text.getvalue()
    assert max(map(len, text.getvalue().splitlines())) <= 100
