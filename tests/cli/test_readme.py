"""Every example line of README and ``--help`` runs without an error."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from subprocess import PIPE

import click
import numpy as np
import pytest
from typer.testing import CliRunner

import lattice_scans
import manip3d
from cave_scans import AHEAD, ball
from landmarks import assert_accessible
from manip3d._util.extras import EXTRAS
from manip3d.cli import _VERBS, app, load
from manip3d.experiments import _simplification
from manip3d.phantom._page import HAZARDS, _hazard_page
from trial_files import write_trial

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
Image = pytest.importorskip("PIL.Image")

SHORTER = (
    (r"frames=\d+", "frames=3"),  # a second of a simulated person instead of three
    # Chapter 2's experiments have a test of their own; this is the quickest of them.
    (r"reproduce table-2\.2", "reproduce table-2.1"),
    (r"(reproduce \S+\b)(?: --scale quick)?", r"\1 --scale quick --data simulated"),
    (r"-o lattice\.json", "-o lattice.json --planted 1"),
    (r"sim:indoor-00", "sim:indoor-00 --resolution 1.5"),
    (r"(forge people .*)--frames 3", r"\1--frames 1 --scenes 1 --jobs 1"),  # no process of its own
    (r"^MANIP3D_DATA=\S+ ", ""),
)
"""Replacements that make the lines of the text quicker to run."""

NOT_RUN = ("demo", "data get", "forge alert-set")
"""Commands that are only parsed: two have tests of their own, and no test uses the network."""

EXIT_CODES = {
    "inspect scan.bin": 3,
    "inspect b.bin": 3,
    "inspect forged": 4,  # a camera's noise and holes tell it from a rendering
    "street.mcap": 4,
    "a3_s1_t1_depth.mat": 1,  # the joints of `write_trial` lie beside its person: no phantom
}
"""Lines of README that end with another code than 0 on the sources of these tests."""


def blocks(language: str) -> list[str]:
    """Return the code blocks of README in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.DOTALL | re.MULTILINE)


def readme_lines() -> list[str]:
    """Return the lines of README's shell blocks, and further ones for what these leave out."""
    further = Path(__file__).with_name("further_lines.sh").read_text().splitlines()[1:]
    return [line for block in blocks("sh") for line in block.splitlines() if line.strip()] + further


def commands(
    command: click.Command | None = None, path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """Return every command by its words, such as ``("capture", "record")``."""
    parts = command.commands if command else {verb: load(verb) for verb in _VERBS}
    for name, part in parts.items():
        if hasattr(part, "commands"):
            yield from commands(part, (*path, name))
        else:
            yield (*path, name), part


def examples(command: click.Command) -> list[str]:
    """Return the example lines of a command's help."""
    text = " ".join((command.callback.__doc__ or "").split()) if command.callback else ""
    return re.findall(r"Example: (manip3d .*?)(?= Example: |$)", text)


HELP_LINES = [line for _, command in commands() for line in examples(command)]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with small files under the names that README and the examples use."""
    folder = tmp_path_factory.mktemp("readme")
    (folder / "meshes").mkdir()  # what a data folder has
    vertices, faces = sphere(24, 48)
    for name in ("head.obj", "plane.obj"):
        manip3d.Mesh(vertices, faces).write(folder / name)
    np.save(folder / "weights.npy", np.ones(len(vertices)))
    manip3d.Mesh(0.7 * vertices, faces).write(folder / "car.obj")
    (folder / "models").mkdir()
    manip3d.Mesh(vertices, faces).write(folder / "models" / "ball.obj")
    for name in ("light.glb", "plane.glb"):
        manip3d.Mesh(vertices, faces).write(folder / name)
    hoax = np.concatenate([AHEAD, ball(0.6, 20_000) + np.float32([3, 1, 0])])
    for name in ("scan", "a", "b", "c"):
        manip3d.LidarFrame(hoax, np.zeros(len(hoax), np.float32)).write(folder / f"{name}.bin")
    Image.fromarray(depth_image()).save(folder / "depth.png")
    Image.fromarray(depth_image() < 3000).save(folder / "mask.png")
    write_cloud(folder / "cloud.pcd", depth_image() / 1000.0)
    Image.fromarray((2 - depth_image() // 3000).astype(np.uint8)).save(folder / "levels.png")
    return folder


def sphere(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a closed surface with rows of quadrilaterals between two poles."""
    polar, around = np.meshgrid(
        np.linspace(0, np.pi, rows + 1)[1:-1], np.arange(columns) * 2 * np.pi / columns,
        indexing="ij",
    )  # fmt: skip
    ring = np.stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], -1
    )
    vertices = np.vstack([ring.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    here = np.arange(len(ring) * columns).reshape(len(ring), columns)
    beside = np.roll(here, -1, axis=1)
    a, b, c, d = here[:-1], beside[:-1], beside[1:], here[1:]
    top, bottom = len(vertices) - 2, len(vertices) - 1
    parts = (
        np.stack([a, d, c], -1).reshape(-1, 3),
        np.stack([a, c, b], -1).reshape(-1, 3),
        np.stack([np.full(columns, top), here[0], beside[0]], -1),
        np.stack([np.full(columns, bottom), beside[-1], here[-1]], -1),
    )
    return vertices, np.vstack(parts).astype(np.int32)


def depth_image() -> np.ndarray:
    """Return a depth image of a bump before a wall, in the Kinect V2's size."""
    v, u = np.mgrid[:424, :512]
    bump = np.hypot(u - 256, v - 212) < 120
    return np.where(bump, 1500 + 0.2 * np.abs(u - 256), 3000 + 0.3 * v).astype(np.uint16)


def write_cloud(path: Path, depth: np.ndarray) -> None:
    """Write the image as an organised cloud."""
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    points = np.stack([(u - 256) * depth / 365, (v - 212) * depth / 365, depth], -1)
    header = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    size = f"WIDTH {depth.shape[1]}\nHEIGHT {depth.shape[0]}\nPOINTS {depth.size}\n"
    text = f"VERSION 0.7\n{header}{size}DATA binary\n"
    path.write_bytes(text.encode() + points.astype("<f4").tobytes())


def shortened(line: str) -> list[str]:
    """Return the words after ``manip3d`` of a line, with options that take less time."""
    for pattern, replacement in SHORTER:
        line = re.sub(pattern, replacement, line)
    return shlex.split(line, comments=True)[1:]


def check(line: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a line, or only parse it if it is in `NOT_RUN`."""
    monkeypatch.chdir(place)
    monkeypatch.setenv("MANIP3D_DATA", str(place))
    monkeypatch.delenv("DISPLAY", raising=False)
    (small,) = [(model, 8000) for model, _ in _simplification.SIMULATED if model.mesh == "rocker"]
    monkeypatch.setattr(_simplification, "SIMULATED", (small,))
    words = shortened(line)
    if any(" ".join(words).startswith(name) for name in NOT_RUN):
        command: click.Command = load(words.pop(0))
        while hasattr(command, "commands"):
            command = command.commands[words.pop(0)]
        command.make_context(command.name, words)  # raises click.UsageError for a wrong option
        return
    if "plane.html" in words and not any((ROOT / "python/manip3d/viewer/dist").glob("*.js")):
        pytest.skip("the viewer's bundle is not built")
    needs_recorder = any(word.endswith(".mkv") for word in words)
    if needs_recorder and not mkv_is_here():
        pytest.skip("this machine has no FFmpeg")
    make_sources(words, place)
    takes_force = words[0] not in ("info", "compare", "doctor", "data") and "list" not in words
    writes_nothing = (["capture", "info"], ["watermark", "keygen"], ["phantom", "live"])
    takes_force = takes_force and words[:2] not in writes_nothing
    takes_force = takes_force and (words[0] != "diary" or words[1] in ("export", "clips", "rescue"))
    if words[0] == "study":
        takes_force = words[1] in ("define", "stimuli", "results")
    done = CliRunner().invoke(app, [*words, *(["--force"] if takes_force else [])])
    expected = next((code for name, code in EXIT_CODES.items() if name in line), 0)
    assert done.exit_code == expected, (line, done.output, done.exception)
    if "-o" in words:
        assert (place / words[words.index("-o") + 1]).exists(), line


def test_no_line_writes_what_another_wrote() -> None:
    written = [words[words.index("-o") + 1] for line in readme_lines()
               if "-o" in (words := shlex.split(line, comments=True))
               and "--force" not in words]  # fmt: skip
    written += re.findall(r"""write\("(.+?)"\)""", "".join(blocks("python")))
    assert sorted(written) == sorted(set(written))
    assert len(written) > 30


def make_sources(words: list[str], place: Path) -> None:
    """Make what an earlier line writes, so that each test stands alone."""
    sources = " ".join(words).partition(" -o ")[0]
    if "patient.mkv" in sources and not (place / "patient.mkv").exists():
        manip3d.capture.record("sim:body?amputated=right-arm&frames=3", place / "patient.mkv")
    if "a3_s1_t1_depth.mat" in words:
        write_trial(place)
    if "study.diary" in words or words[:2] in (["diary", "keygen"], ["diary", "form"]):
        make_diary(words, place)
    if words[:2] == ["diary", "ask"]:
        from manip3d.diary import OWNERSHIP, write_questionnaire

        write_questionnaire(OWNERSHIP, place / "form.json")
    if words[0] in ("watermark", "alert") or sources.startswith("inspect drive"):
        make_watermark(words, place)
    if words[0] == "study":
        make_study(words, place)
    if sources == "inspect forged" and not (place / "forged").exists():
        line = 'forge stream "sim:body?motion=still&frames=12" --type 1 --still -q -o'
        forged = str(place / "forged")
        assert CliRunner().invoke(app, [*shlex.split(line), forged]).exit_code == 0
    if "street.mcap" in sources and not (place / "street.mcap").exists():
        from ros_bags import TYPES, message, points_of, write_bag

        clouds = [message(TYPES, points_of(number)) for number in range(2)]
        (file,) = write_bag(place / "bag", {"/points": clouds}).glob("*.mcap")
        file.rename(place / "street.mcap")
    if "walk.bag" in sources and not (place / "walk.bag").exists():
        from ros_bags import realsense

        realsense(place / "walk.bag", 0.001)
    if sources == "lattice clean":
        (place / "clean" / "velodyne").mkdir(parents=True, exist_ok=True)
        for number in range(4):
            points = lattice_scans.scan(np.random.default_rng(number))
            seen = manip3d.LidarFrame(points, np.zeros(len(points), np.float32))
            seen.write(place / "clean" / "velodyne" / f"{number:06d}.bin")
    if sources == "play frames/":
        (place / "frames").mkdir(exist_ok=True)
        manip3d.Mesh(np.eye(3), [[0, 1, 2]]).write(place / "frames/0.glb")
    if sources.startswith("depth rgbd/depth/") and not (place / "rgbd").exists():
        (place / "rgbd" / "depth").mkdir(parents=True)
        whole = np.pad(depth_image(), ((0, 56), (0, 128)), mode="edge")  # the size of TUM's cameras
        Image.fromarray(whole).save(place / "rgbd" / "depth" / "1.000.png")
        Image.fromarray(whole).save(place / "rgbd" / "depth" / "1.033.png")
        poses = "1.001 0 0 0 0 0 0 1\n1.034 0.1 0 0 0 0 0 1\n"
        (place / "rgbd" / "groundtruth.txt").write_text(poses)
    if sources == "report results" and not (place / "results").exists():
        line = "reproduce table-2.1 --scale quick --data simulated -q -o"
        results = str(place / "results")
        assert CliRunner().invoke(app, [*line.split(), results]).exit_code == 0


def make_diary(words: list[str], place: Path) -> None:
    """Make the diary with README's line that enrols a participant, without key or questionnaire."""
    for name in ("study.diary", "study.key", "form.json", "mcgill.json"):
        (place / name).unlink(missing_ok=True)
    if words[:2] == ["diary", "enrol"]:
        return
    (line,) = (line for line in readme_lines() if line.startswith("manip3d diary enrol "))
    enrol = [str(place / word) if word == "study.diary" else word for word in shortened(line)]
    assert CliRunner().invoke(app, enrol).exit_code == 0


def make_study(words: list[str], place: Path) -> None:
    """Write a small study of the kind that a line needs, its stimuli and answers."""
    from manip3d.study import StudyFolder, read_study, simulate_participants, write_template

    shutil.rmtree(place / "answers", ignore_errors=True)
    name = {"rating": "rating", "jnd": "jnd-non-textured", "stimuli": "jnd-non-textured"}
    file = write_template(name.get(words[1], "display"), place / "study.toml", example=True)
    text = file.read_text()
    if words[1] == "rating":
        (place / "stimuli").mkdir(exist_ok=True)
        Image.new("RGB", (8, 8)).save(place / "stimuli" / "a.png")
        columns = "file,truth,modality,form,resolution,background,example"
        row = "a.png,real,color,image,full,,0"
        (place / "stimuli" / "stimuli.csv").write_text(f"{columns}\n{row}\n")
        file.write_text(text.replace('composition = "published"', 'composition = "any"'))
    elif words[1] in ("jnd", "stimuli"):
        head, _, rest = text.partition("models = [")
        model = '{ name = "head", file = "head.obj", class = "manifold" }'
        text = f"{head}models = [{model}]" + rest.partition("\n]")[2]
        text = text.replace("step_percent = 5", "step_percent = 15")
        file.write_text(text)
        if words[1] == "jnd":
            made = CliRunner().invoke(app, ["study", "stimuli", str(file), "--force", "-q"])
            assert made.exit_code == 0
    elif words[1] in ("results", "withdraw"):
        study, content = read_study(file)
        with StudyFolder(place / "answers", content) as folder:
            simulate_participants(study, folder, 6)
            folder.begin("P07")


def make_watermark(words: list[str], place: Path) -> None:
    """Write a drive, a key and the files that are made from them."""
    (place / "sensor.key").unlink(missing_ok=True)
    if words[1] == "keygen":
        return
    key = manip3d.authenticate.KeyFile.create(place / "sensor.key")
    scans = place / "drive" / "velodyne_points" / "data"
    scans.mkdir(parents=True, exist_ok=True)
    scan = np.round(AHEAD, 3)
    manip3d.LidarFrame(scan, np.zeros(len(scan), np.float32)).write(scans / "0000000000.bin")
    pictures = place / "drive" / "image_02" / "data"
    pictures.mkdir(parents=True, exist_ok=True)
    picture = np.full((375, 1242, 3), 100, np.uint8)
    manip3d.authenticate.write_carrier(picture, pictures / "0000000000.png")
    if "carried" in words and words[1] != "embed":
        marker = manip3d.authenticate.Watermarker(key)
        taken = manip3d.io.read_scan(scans / "0000000000.bin")
        carried = marker.embed(taken, is_end=True, picture=picture)
        manip3d.authenticate.write_watermarked(
            carried,
            place / "carried" / "velodyne_points" / "data" / "0000000000.bin",
            picture=place / "carried" / "image_02" / "data" / "0000000000.png",
        )
    elif words[0] == "alert" or words[1] == "verify":
        marker = manip3d.authenticate.Watermarker(key)
        sent = marker.embed(manip3d.io.read_scan(scans / "0000000000.bin"), is_end=True)
        signed = place / "signed" / "velodyne_points" / "data"
        manip3d.authenticate.write_watermarked(sent, signed / "0000000000.bin")


def mkv_is_here() -> bool:
    from manip3d import capture

    return next(s.is_available for s in capture.sources() if s.name == "mkv")


@pytest.mark.parametrize(
    "line", [line for line in readme_lines() if "manip3d" in line.split()[0:2]]
)
def test_each_line_of_readme_runs(line: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check(line, place, monkeypatch)


def test_the_hazards_of_readme_are_those_of_the_page_that_people_must_read() -> None:
    table = README.partition("| Hazard |")[2].partition("\n\n")[0].splitlines()[2:]
    rows = [tuple(cell.strip() for cell in row.strip("|").split("|")) for row in table]
    assert rows
    assert_accessible(_hazard_page())
    assert [tuple(cell.replace("`", "") for cell in row) for row in rows] == list(HAZARDS)


def test_other_lines_of_readme_name_what_is_there() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    makefile = (ROOT / "Makefile").read_text()
    others = [line for line in readme_lines() if "manip3d" not in line.split()[0:2]]
    assert others
    for line in others:
        words = shlex.split(line, comments=True)
        if words[0] == "make":
            assert re.search(rf"^{words[1]}:", makefile, re.MULTILINE), line
        elif words[0] == "sudo":
            assert words[1:3] == ["apt-get", "install"], line
            assert set(words[3:]) <= set(re.split(r"[\s,)]+", makefile)), line
        elif "venv" in line:
            assert words in (["python3", "-m", "venv", ".venv"], [".", ".venv/bin/activate"]), line
        else:
            assert words[:2] == ["pip", "install"], line
            extras = re.search(r"\[(.*)\]", words[2])
            assert extras is not None
            assert set(extras[1].split(",")) <= set(project["optional-dependencies"]), line


def test_the_python_of_readme_runs(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(place)
    (block,) = blocks("python")
    exec(compile(block, "README.md", "exec"), {})


LINES_OF_README = {
    tuple(shortened(line)) for line in readme_lines() if "manip3d" in line.split()[0:2]
}


# Those that README has too are run above.
@pytest.mark.parametrize(
    "line", [line for line in HELP_LINES if tuple(shortened(line)) not in LINES_OF_README]
)
def test_each_example_of_help_runs(line: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check(line, place, monkeypatch)


def test_every_command_has_an_example_and_whole_help() -> None:
    for words, command in commands():
        name = " ".join(words)
        if name != "cs3":  # another name of depth
            assert examples(command), name
        for parameter in command.params:
            text = getattr(parameter, "help", None)
            if text and parameter.name != "help":
                assert text[0].isupper() or text.split()[0].rstrip(":") in ("guess",), (name, text)
                assert text.endswith("."), (name, text)
                assert not re.match(r"(Of|So|That|How|Which|Where)\b", text), (name, text)


GROUPS = [verb for verb in _VERBS if hasattr(load(verb), "commands")]


@pytest.mark.parametrize("words", [[], *([group] for group in GROUPS)])
def test_the_list_of_commands_is_not_cut(words: list[str]) -> None:
    """Summaries of commands fit into a terminal of 80 columns, of which Click uses 78."""
    done = CliRunner().invoke(app, [*words, "--help"], terminal_width=78)
    assert done.exit_code == 0
    assert "..." not in done.output.partition("Commands:")[2]


def test_every_extra_is_known_and_in_readme() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = set(project["optional-dependencies"]) - {"all", "dev", "peers"}
    assert set(EXTRAS) == extras
    rows = [line for line in README.splitlines() if line.startswith("| `")]
    (of_all,) = (row for row in rows if row.startswith("| `all` |"))
    table = "".join(row for row in rows if row != of_all)
    assert {extra for extra in extras if f"`{extra}`" not in table} == set()
    (included,) = re.findall(r"\[(.*)\]", project["optional-dependencies"]["all"][0])
    left_out = extras - {"demo"} - set(included.split(","))  # others of them have all of the demo's
    assert set(re.findall(r"`(\w+)`", of_all)) == left_out | {"all"}


WITHOUT_EXTRAS = """\
import contextlib, io, json, os, sys

class Blind:
    def __init__(self, finder):
        self.finder = finder

    def find_spec(self, name, path=None, target=None):
        absent = name.partition(".")[0] in {modules!r}
        return None if absent else self.finder.find_spec(name, path, target)

    def __getattr__(self, name):
        return getattr(self.finder, name)

sys.meta_path[:] = [Blind(finder) for finder in sys.meta_path]
from manip3d.cli import main
for line in sys.stdin:
    folder, arguments = json.loads(line)
    os.chdir(folder)
    said, code = io.StringIO(), 0
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        try:
            main(arguments)
        except SystemExit as exit:
            code = exit.code or 0
    print(json.dumps([code, said.getvalue()]), flush=True)
"""

Run = Callable[[list[str], Path], tuple[int, str]]


@pytest.fixture(scope="module")
def run_without_extras() -> Iterator[Run]:
    """Run commands as if no optional package were installed; give exit code and standard error.

    All commands share one process, because most of their time would go into starting it.
    """
    modules = sorted({module for modules in EXTRAS.values() for module in modules})
    program = WITHOUT_EXTRAS.format(modules=modules)
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=PIPE, stdout=PIPE, text=True
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None

        def run(arguments: list[str], folder: Path) -> tuple[int, str]:
            print(json.dumps([str(folder), arguments]), file=process.stdin, flush=True)
            code, said = json.loads(process.stdout.readline())
            return code, said

        yield run
        process.stdin.close()


@pytest.mark.parametrize(
    "line",
    [
        line
        for line in readme_lines()
        if line.startswith("manip3d ") and not re.search("mkv:| view | report ", line)
    ],
)
def test_lines_of_readme_need_the_extra_that_they_name(
    line: str, place: Path, tmp_path: Path, run_without_extras: Run
) -> None:
    named = re.search(r"\bneeds (?:\w+, )*(\w+)$", line)
    words = shortened(line)
    if "-o" in words:
        at = words.index("-o") + 1
        words[at] = str(tmp_path / words[at])
    for output in ("rows.csv", "case.jsonl", "drive.jsonl"):  # of the same line in the test before
        (place / output).unlink(missing_ok=True)
    make_sources(words, place)
    code, said = run_without_extras(words, place)
    if named is None:
        assert code in (0, 3, 4), said
    else:
        assert code == 1
        assert f"pip install 'manip3d[{named[1]}]'" in said.splitlines()[-1]


def test_a_demo_without_its_extra_is_one_sentence(tmp_path: Path, run_without_extras: Run) -> None:
    code, said = run_without_extras(["demo", "-o", "demo"], tmp_path)
    assert code == 1
    (line,) = said.splitlines()
    assert line.startswith("manip3d: error: ")
    assert line.endswith("pip install 'manip3d[demo]'")
    assert list(tmp_path.iterdir()) == []
