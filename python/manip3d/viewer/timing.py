"""Measurement of the time to draw frames of a scene, without waiting for a screen."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.checked import checked
from manip3d.errors import InputError, RenderError
from manip3d.mesh import Mesh
from manip3d.viewer import _chromium, _pyvista
from manip3d.viewer.renderers import Renderer, check
from manip3d.viewer.scene import OBLIQUE, Camera, Style, frame_points

if TYPE_CHECKING:
    from numpy.typing import NDArray

SPACING = 0.8  # distance between models with unit diagonals, close but without overlap
_PATIENCE = 240.0  # time limit in seconds; software renderers are slow
_WARMING = 2  # number of frames before the timed ones; the same as in stage.js


@dataclass(frozen=True, eq=False)
class FrameTimes:
    """Result of `frame_times`.

    Attributes
    ----------
    milliseconds : (N,) float64
        Time of each frame until its last pixel was drawn.
    num_faces : int
        Number of faces of the scene.
    driver : str
        Renderer named by OpenGL: a graphics card or a software renderer.
    """

    milliseconds: NDArray[np.float64] = field(repr=False)
    num_faces: int
    driver: str

    @property
    def median(self) -> float:
        """Median time of a frame, milliseconds."""
        return float(np.median(self.milliseconds))

    @property
    def ms_per_million(self) -> float:
        """Milliseconds per million triangles, an argument of `simplify.polygon_budget`."""
        return 1e6 * self.median / max(self.num_faces, 1)


@checked
def frame_times(
    meshes: Sequence[Mesh],
    drawn_by: Renderer,
    *,
    size: tuple[int, int] = (1280, 720),
    frames: int = 100,
    seconds: float = 5.0,
) -> FrameTimes:
    """Measure the time that a renderer takes for each frame of a scene.

    Parameters
    ----------
    meshes : sequence of Mesh
        Meshes, which are scaled to the same size and placed side by side, so that all are visible.
    drawn_by : 'chromium' or 'pyvista'
        The viewer's page (three.js) in a headless browser, or VTK off screen.
    size : (width, height), pixels
    frames : int
        Largest number of timed frames; two further frames are drawn before them.
    seconds : float
        Time after which no frame is begun.

    Returns
    -------
    FrameTimes

    Raises
    ------
    InputError
        An option is out of range, there is no mesh, or a mesh has no faces.
    RenderError
        The renderer does not work here.

    Examples
    --------
    >>> from manip3d.simulate import models
    >>> times = frame_times([models.MODELS["rocker"](5000)], "chromium")  # doctest: +SKIP
    >>> times.num_faces  # doctest: +SKIP
    5600
    """
    if len(meshes) == 0 or any(mesh.num_faces == 0 for mesh in meshes):
        raise InputError(
            f"meshes: expected meshes with faces, got {[mesh.num_faces for mesh in meshes]} faces"
        )
    if frames < 1:
        raise InputError(f"frames: expected >= 1, got {frames}")
    if not (seconds > 0.0 and math.isfinite(seconds)):
        raise InputError(f"seconds: expected a number > 0, got {seconds}")
    style = Style(size)
    if drawn_by == "pyvista":
        check(drawn_by)  # in a child process, because a broken driver kills its process
    placed = _side_by_side(meshes)
    used = np.concatenate([mesh.vertices[np.unique(mesh.faces)] for mesh in placed])
    camera = frame_points(used, size, OBLIQUE.azimuth, OBLIQUE.elevation, 1.0, OBLIQUE.up)
    run = _in_browser if drawn_by == "chromium" else _in_vtk
    return run(placed, camera, style, frames, seconds)


def _side_by_side(meshes: Sequence[Mesh]) -> list[Mesh]:
    """Scale each mesh to a unit diagonal and place the meshes in rows."""
    columns = math.ceil(math.sqrt(len(meshes)))
    placed = []
    for i, mesh in enumerate(meshes):
        low, high = mesh.bounds
        row, column = divmod(i, columns)
        size = float(np.linalg.norm(high - low)) or 1.0
        place = SPACING * np.array([column, -row, 0.0])
        placed.append(mesh.replace(vertices=(mesh.vertices - 0.5 * (low + high)) / size + place))
    return placed


def _in_browser(
    meshes: Sequence[Mesh], camera: Camera, style: Style, frames: int, seconds: float
) -> FrameTimes:
    from manip3d.viewer.page import timing_page

    page = timing_page(meshes, camera, style, frames, seconds)
    with _chromium.open_page(page, style.size) as tab:
        tab.patience = _PATIENCE + seconds
        found = tab.evaluate("manip3d")
    if np.ptp(_chromium.picture_of(found["picture"])) == 0:
        raise RenderError("chromium: the picture is empty")
    return FrameTimes(np.array(found["milliseconds"]), _count(meshes), found["renderer"])


def _in_vtk(
    meshes: Sequence[Mesh], camera: Camera, style: Style, frames: int, seconds: float
) -> FrameTimes:
    with _pyvista.scene(meshes, camera, style) as plotter:
        window = plotter.render_window

        def frame() -> float:
            begun = time.perf_counter()
            window.Render()
            window.WaitForCompletion()
            return 1000.0 * (time.perf_counter() - begun)

        if np.ptp(plotter.screenshot(return_img=True)) == 0:
            raise RenderError("pyvista: the picture is empty")
        for _ in range(_WARMING):
            frame()
        times: list[float] = []
        end = time.perf_counter() + seconds
        while not times or (len(times) < frames and time.perf_counter() < end):
            times.append(frame())
        driver = _driver(window)
    return FrameTimes(np.array(times), _count(meshes), driver)


def _count(meshes: Sequence[Mesh]) -> int:
    return sum(mesh.num_faces for mesh in meshes)


def _driver(window: Any) -> str:
    lines = str(window.ReportCapabilities()).splitlines()
    names = [line.partition(":")[2].strip() for line in lines if "renderer string" in line]
    return names[0] if names else "unknown"
