"""The notebooks run from top to bottom, show what they say, and are committed without outputs."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import manip3d
from manip3d import capture, simulate

nbformat = pytest.importorskip("nbformat")

NOTEBOOKS = {
    path.stem: path for path in sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
}
MIN_VIEWS = {
    "02_mesh_simplification": 2,
    "03_depth_simplification": 3,
    "04_phantom_limb": 2,
    "05_stream_forgery": 2,
    "06_lidar_forensics": 3,
    "07_lidar_alert": 2,
}


def tagged(notebook: Any, tag: str) -> Any:
    """The one cell of a notebook that has a tag."""
    (cell,) = [cell for cell in notebook.cells if tag in cell.metadata.get("tags", ())]
    return cell


def pixels(output: Any) -> NDArray[np.uint8]:
    from PIL import Image

    data = base64.b64decode(output.data["image/png"])
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


def num_colors(picture: NDArray[np.uint8]) -> int:
    return len(np.unique(picture.reshape(-1, 3), axis=0))


def shows_3d(output: Any) -> bool:
    """Whether an output is the viewer, or the picture that stands for it where it is not built."""
    data = output.get("data", {})
    is_thing = "manip3d." in data.get("text/plain", "")
    return "<iframe srcdoc=" in data.get("text/html", "") or (is_thing and "image/png" in data)


def panels(picture: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """The left and the right half of a figure."""
    return np.array_split(picture, 2, axis=1)


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_committed_without_outputs(name: str) -> None:
    cells = nbformat.read(NOTEBOOKS[name], as_version=4).cells
    assert [
        cell.source for cell in cells if cell.get("outputs") or cell.get("execution_count")
    ] == []


def test_every_notebook_is_looked_at() -> None:
    assert set(NOTEBOOKS) == set(MIN_VIEWS) == set(OWN_FILES)


@pytest.mark.parametrize(
    "name",
    [
        name if name.startswith("03") else pytest.param(name, marks=pytest.mark.slow)
        for name in NOTEBOOKS
    ],
)
def test_runs_in_quick_mode(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    monkeypatch.setenv("JUPYTER_RUNTIME_DIR", str(tmp_path))
    notebook = nbformat.read(NOTEBOOKS[name], as_version=4)
    tagged(notebook, "parameters").source = "QUICK = True"
    nbclient.NotebookClient(
        notebook, timeout=600, resources={"metadata": {"path": tmp_path}}
    ).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    assert [output.text for output in outputs if output.get("name") == "stderr"] == []
    printed = " ".join(output.text for output in outputs if output.get("name") == "stdout")
    assert "Open3D" not in printed
    pictures = [output for output in outputs if "image/png" in output.get("data", {})]
    assert len(pictures) >= 3
    assert min(num_colors(pixels(output)) for output in pictures) > 1
    assert sum(shows_3d(output) for output in outputs) >= MIN_VIEWS[name]
    if name.startswith("06"):
        check_forensics(notebook, pictures)


def check_forensics(notebook: Any, pictures: list[Any]) -> None:
    """The panel of Detector II has a ball in its middle; verdicts are those of the text."""
    (figure,) = [output for output in pictures if "<Figure" in output.data.get("text/plain", "")]
    _, behind = panels(pixels(figure))
    # Letters are narrower than the ball, and the frame around the panel is wider.
    dark = behind.max(axis=2) < 64
    runs = np.array([longest_run(row) for row in dark])
    assert np.count_nonzero((runs > 40) & (runs < 200)) > 60
    (verdicts,) = [
        output.data["text/plain"]
        for cell in notebook.cells
        for output in cell.get("outputs", ())
        if "with a shadow" in output.get("data", {}).get("text/plain", "")
    ]
    words = {line.split()[0]: line.split() for line in verdicts.splitlines()[1:]}
    assert words["CTP"][1:] == ["tampered", "tampered", "1"]
    assert words["CRTP"][1:] == ["no_trace", "tampered", "1"]


def longest_run(dark: NDArray[np.bool_]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], dark.astype(np.int8), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def write_model(folder: Path) -> str:
    simulate.models.head(faces=500).write(folder / "own.ply")
    return f"MY_FILE = {str(folder / 'own.ply')!r}"


def write_depth(folder: Path) -> str:
    from PIL import Image

    scene = simulate.depth.person(width=64, height=48)
    depth = scene.capture(flying=0, rng=0).depth
    Image.fromarray(depth).save(folder / "depth.png")
    Image.fromarray(scene.color).save(folder / "colour.png")
    camera = scene.intrinsics
    numbers = f"{camera.fx},{camera.fy},{camera.cx},{camera.cy}"
    return "\n".join(
        [
            f"MY_FILE = {str(folder / 'depth.png')!r}",
            f"CAMERA = {numbers!r}",
            f"COLOR = {str(folder / 'colour.png')!r}",
        ]
    )


def write_recording(folder: Path) -> str:
    body = simulate.BodySimulator(amputated="left_arm", frames=2, room=False)
    capture.record(body, folder / "own")
    return f"MY_FILE = {str(folder / 'own')!r}\nMISSING = 'left_arm'"


def write_scan(folder: Path) -> str:
    scene = simulate.scenes.make("outdoor-01")
    simulate.terrestrial_scan(scene, resolution_deg=2.0).frame.write(folder / "own.pcd")
    return f"MY_FILE = {str(folder / 'own.pcd')!r}"


def write_drive(folder: Path) -> str:
    pytest.importorskip("open3d")
    street = simulate.streets.street(4)
    own = simulate.write_drive(street, folder / "own", 2, pictures=False)
    return f"MY_FILE = {str(own)!r}"


OWN_FILES: dict[str, tuple[Callable[[Path], str], str, type]] = {
    "02_mesh_simplification": (write_model, "original", manip3d.Mesh),
    "03_depth_simplification": (write_depth, "depth", np.ndarray),
    "04_phantom_limb": (write_recording, "frame", manip3d.RgbdFrame),
    "05_stream_forgery": (write_recording, "frame", manip3d.RgbdFrame),
    "06_lidar_forensics": (write_scan, "scan", manip3d.LidarFrame),
    "07_lidar_alert": (write_drive, "scans", list),
}


@pytest.mark.parametrize("name", OWN_FILES)
def test_takes_the_readers_own_file(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for module in ("IPython", "matplotlib", "pandas", "PIL"):
        pytest.importorskip(module)
    write, variable, kind = OWN_FILES[name]
    notebook = nbformat.read(NOTEBOOKS[name], as_version=4)
    tagged(notebook, "file").source = write(tmp_path)
    last = notebook.cells.index(tagged(notebook, "opened"))
    values: dict[str, Any] = {}
    for cell in notebook.cells[: last + 1]:
        if cell.cell_type == "code":
            exec(cell.source.replace("%matplotlib inline", ""), values)
    assert isinstance(values[variable], kind)
    assert str(tmp_path) in capsys.readouterr().out
    if name.startswith("03"):
        assert values["color"].shape == (*values["depth"].shape, 3)
        assert values["color"].dtype == np.uint8
        assert values["camera"].width == values["depth"].shape[1]
    if name.startswith("05"):
        assert len(values["frames"]) == len(values["scenes"]) == 2
    if name.startswith("07"):
        assert len(values["scans"]) == 2
        assert values["pairs"] == [None, None]
    if name.startswith("04"):
        assert values["missing"] == "left_arm"
        assert len(values["frames"]) == 2
