"""Common parts of the experiments of chapter 3: range images, methods, and the measured case.

Tables 3.3 and 3.4 and most figures use the same reduced meshes. A case therefore belongs to no
single experiment: it reduces one range image by one method to one number of points and computes
every measure of the result.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np

from manip3d import datasets
from manip3d.errors import InputError
from manip3d.experiments import _published
from manip3d.experiments._model import Case, Column, Plan, Row
from manip3d.experiments._notes import data_note
from manip3d.mesh import Mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.camera import Intrinsics
    from manip3d.metrics import RangeImageError
    from manip3d.simplify import DepthMesh

T = TypeVar("T")
Kind = Literal["object", "scene", "person"]

VARIANTS = ("lnms", "lios", "cnms", "cios")
SAMPLINGS = ("uniform", "poisson", "ssa")
COLLAPSES = ("qem4vr", "qem-orig", "qem-tp")
PUBLISHED = ("qem4vr", "uniform", "poisson", "ssa", "cios")
METHODS = (*PUBLISHED, "relief")
REAL_TIME = ("uniform", "poisson", "ssa", "cios")
TITLES = {
    "qem4vr": "QEM (QEM4VR of chapter 2, dense mesh)",
    "qem-orig": "plain QEM (QEM_ORIG of chapter 2, dense mesh)",
    "qem-tp": "texture-preserving QEM (QEM_TP, dense mesh)",
    "uniform": "UNI (uniform grid)",
    "poisson": "PDS (Poisson disks)",
    "ssa": "SSA (scale-space analysis)",
    "cios": "CS3 (CIOS)",
    "relief": "relief (manip3d's own)",
    "lios": "LIOS",
    "lnms": "LNMS",
    "cnms": "CNMS",
}
SHORT = {name: title.partition(" (")[0] for name, title in TITLES.items()}
_PRINTED = {"qem4vr": "QEM", "uniform": "UNI", "poisson": "PDS", "ssa": "SSA", "cios": "CS3"}

MAX_EDGE = 0.5
"""Longest edge of a triangle in a scene, metres; a longer one joins two objects. The dissertation
gives no number."""


@dataclass(frozen=True)
class DepthModel:
    """Range image that is, or stands in for, one of the dissertation's models.

    Attributes
    ----------
    published : str
        Name of the dissertation's model.
    label : str
        Name of the range image in reports.
    kind : 'object', 'scene' or 'person'
        Content. In scenes, triangles with long edges are removed, as the dissertation says.
    source : tuple of str
        ``("scan", name)``, ``("frame", data set, frame)`` or ``("simulated", name)``.
    data : str
        Data set of the range image; ``""``: it is simulated.
    same_file : bool
        Whether the range image is the published file itself.
    width : int
        Width of a simulated image, pixels.
    """

    published: str
    label: str
    kind: Kind
    source: tuple[str, ...]
    data: str = ""
    same_file: bool = False
    width: int = 0

    @property
    def kind_of_data(self) -> str:
        """``published``, ``stand-in`` or ``simulated``."""
        if self.same_file:
            return "published"
        return "stand-in" if self.data else "simulated"

    @property
    def role(self) -> str:
        """Description in reports: the published model, or what stands in for it."""
        if self.same_file:
            return f"the published {self.published}"
        simulated = "" if self.data else "simulated "
        return f"{simulated}stand-in for {self.published}"

    @property
    def options(self) -> dict[str, Any]:
        """Return the options of a case that name the range image."""
        return {
            "model": self.label,
            "kind": self.kind,
            "source": list(self.source),
            "width": self.width,
            "stands_in_for": self.published,
            "data": self.kind_of_data,
            "role": self.role,
        }


REAL = (
    DepthModel("Dragon", "dragonStandRight_0", "object", ("scan", "dragonStandRight_0"),
               "dragon_stand"),
    DepthModel("Bunny", "bun000", "object", ("scan", "bun000"), "bunny_scans", same_file=True),
    DepthModel("Buddha", "happyStandRight_0", "object", ("scan", "happyStandRight_0"),
               "happy_stand", same_file=True),
    DepthModel("Desk", "TUM fr2 desk", "scene", ("frame", "scene_tum_desk", "frame1"),
               "scene_tum_desk"),
    DepthModel("Human", "turning person, whole image", "scene",
               ("frame", "person_turning", "0000000000"), "person_turning"),
    DepthModel("Cabinet", "7-Scenes kitchen", "scene",
               ("frame", "scene_kitchen", "frame-000000"), "scene_kitchen"),
    DepthModel("Person 1", "NormalGAN 01", "person", ("frame", "person_normalgan", "01"),
               "person_normalgan"),
    DepthModel("Person 2", "DDRNet 1", "person", ("frame", "person_ddrnet", "000001"),
               "person_ddrnet"),
    DepthModel("Person 3", "front surfaces 1", "person", ("frame", "person_frontsurfaces", "1"),
               "person_frontsurfaces"),
)  # fmt: skip
SIMULATED = (
    DepthModel("Bunny", "figure (simulated)", "object", ("simulated", "figure")),
    DepthModel("Desk", "room (simulated)", "scene", ("simulated", "room")),
    DepthModel("Person 1", "person (simulated)", "person", ("simulated", "person")),
)
# Stand-ins without data: the simulated image of the second model also stands in for the first.
_STANDS_FOR = {"Dragon": "Bunny", "Buddha": "Bunny", "Human": "Desk", "Cabinet": "Desk",
               "Person 2": "Person 1", "Person 3": "Person 1"}  # fmt: skip
_QUICK = ("Bunny", "Desk", "Person 1")
_QUICK_WIDTH, _FULL_WIDTH = 320, 640


def models(plan: Plan, published: Sequence[str] = ()) -> list[DepthModel]:
    """Return the range images of a plan.

    Parameters
    ----------
    plan : Plan
    published : sequence of str
        Published models to include, in quick runs, too. Empty: all models, or three of them in a
        quick run.
    """
    wanted = published or (_QUICK if plan.scale == "quick" else [m.published for m in REAL])
    chosen: list[DepthModel] = []
    for name in wanted:
        model = next(m for m in REAL if m.published == name)
        here = datasets.is_here(datasets.get(model.data))
        if plan.data == "simulated" or (plan.data == "auto" and not here):
            model = _simulated(name, plan)
        if model.label not in [m.label for m in chosen]:
            chosen.append(model)
    return chosen


def _simulated(published: str, plan: Plan) -> DepthModel:
    same = _STANDS_FOR.get(published, published)
    model = next(m for m in SIMULATED if m.published == same)
    return replace(model, published=published, width=simulated_width(plan))


def simulated_width(plan: Plan) -> int:
    """Return the width of simulated images, pixels."""
    return _QUICK_WIDTH if plan.scale == "quick" else _FULL_WIDTH


def real_data(published: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the data sets of an experiment on these models; empty: on all models."""
    return tuple(m.data for m in REAL if not published or m.published in published)


# --- Range images -------------------------------------------------------------------------------


@dataclass(frozen=True)
class RangeInput:
    """Range image in the form that the methods accept: a depth image with camera, or a point grid.

    Attributes
    ----------
    depth, intrinsics : (H, W) array and Intrinsics, or None
    points, valid : (H, W, 3) and (H, W) arrays, or None
    color : (H, W, 3) uint8 or None
    max_edge : float or None
        Longest edge of a triangle, metres; None: no limit.
    """

    depth: NDArray[Any] | None = None
    intrinsics: Intrinsics | None = None
    points: NDArray[np.float32] | None = None
    valid: NDArray[np.bool_] | None = None
    color: NDArray[np.uint8] | None = None
    max_edge: float | None = None

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Return (H, W) bool: pixels with a measurement."""
        if self.valid is not None:
            return self.valid
        assert self.depth is not None
        measured: NDArray[np.bool_] = self.depth > 0
        return measured

    def call(self, on_depth: Callable[..., T], on_grid: Callable[..., T], *a: Any, **k: Any) -> T:
        """Call ``on_depth`` if this is a depth image, ``on_grid`` if it is a grid of points."""
        if self.depth is None:
            return on_grid(self.points, self.valid, *a, **k)
        return on_depth(self.depth, self.intrinsics, *a, **k)

    def dense(self) -> DepthMesh:
        """Return the mesh of all measured pixels."""
        from manip3d import simplify

        return self.call(
            simplify.dense_mesh,
            simplify.dense_mesh_grid,
            max_edge=self.max_edge,
            color=self.color,
        )

    def error(self, mesh: Mesh | DepthMesh) -> RangeImageError:
        """Measure the errors of a mesh against this range image."""
        from manip3d import metrics

        return self.call(metrics.range_image_error, metrics.range_image_error_grid, mesh)


def open_input(options: Mapping[str, Any]) -> RangeInput:
    """Open the range image of a case."""
    max_edge = MAX_EDGE if options["kind"] == "scene" else None
    kind, *names = options["source"]
    if kind == "scan":
        scan = datasets.load_scan(names[0])
        points = scan.points.astype(np.float32)  # here, so that no method's time includes it
        return RangeInput(points=points, valid=scan.valid, max_edge=max_edge)
    if kind == "frame":
        frame = datasets.load_frame(names[0], names[1])
        depth = frame.person if options["kind"] == "person" else frame.depth
        return RangeInput(depth, frame.intrinsics, color=frame.color, max_edge=max_edge)
    return _open_simulated(names[0], options["width"], max_edge)


def _open_simulated(name: str, width: int, max_edge: float | None) -> RangeInput:
    from manip3d.simulate import depth as simulated

    make = simulated.room if name == "room" else simulated.person
    scene = make(width=width, height=width * 3 // 4)
    if name == "figure":  # stands in for a laser scan, without noise and colour
        exact = np.nan_to_num(scene.depth).astype(np.float32)
        return RangeInput(exact, scene.intrinsics, max_edge=max_edge)
    capture = scene.capture(flying=0.0, rng=0)  # "pre-processed to remove the sensor noise"
    return RangeInput(capture.depth, scene.intrinsics, color=scene.color, max_edge=max_edge)


# --- Methods ------------------------------------------------------------------------------------


def reduce(image: RangeInput, method: str, points: int, **options: Any) -> DepthMesh | Mesh:
    """Reduce a range image to at most ``points`` points by one method, on one thread.

    Methods by edge collapse build the dense mesh first, and their time includes this step.
    """
    from manip3d import simplify

    if method in COLLAPSES:
        return _collapsed(image.dense().mesh, method, points)
    common = {"color": image.color, "max_edge": image.max_edge} | options
    if method in SAMPLINGS:
        return image.call(
            simplify.sample_depth, simplify.sample_depth_grid, points, method=method, **common
        )
    if method == "relief":
        return image.call(simplify.relief, simplify.relief_grid, points, **common)
    if method in VARIANTS:
        return image.call(simplify.cs3, simplify.cs3_grid, points, variant=method, **common)
    raise InputError(f"method: expected one of {', '.join(TITLES)}, got {method!r}")


def _collapsed(dense: Mesh, method: str, points: int) -> Mesh:
    """Collapse edges to the level of detail that has at most ``points`` vertices.

    The target of a collapse is a number of faces. One run therefore goes below the target, and its
    record is searched for the level with the right number of vertices.
    """
    from manip3d import simplify

    result = simplify.METHODS[method](dense, target_faces=points)
    low, high = points, 3 * points  # a planar mesh has fewer than two faces per vertex
    while low < high:
        middle = (low + high + 1) // 2
        if result.level_of_detail(middle).num_vertices <= points:
            low = middle
        else:
            high = middle - 1
    return result.level_of_detail(low)


def processor_time_ms(work: Callable[[], Any], repeats: int) -> float:
    """Return the smallest processor time of ``repeats`` runs in milliseconds; fewer if too slow."""
    least, together = math.inf, 0.0
    for _ in range(repeats):
        started = time.process_time()
        work()
        took = time.process_time() - started
        least, together = min(least, took), together + took
        if together > _LONG:
            break
    return 1000.0 * least


_LONG = 2.0  # processor time of all runs, seconds, after which no run is added


def time_ms(image: RangeInput, method: str, points: int, reduced: Mesh | DepthMesh,
            repeats: int, **options: Any) -> float:  # fmt: skip
    """Return the time from range image to mesh, without the search for the level of detail."""
    if method not in COLLAPSES:
        return processor_time_ms(lambda: reduce(image, method, points, **options), repeats)
    from manip3d import simplify

    plain = replace(image, color=None)
    collapse = simplify.METHODS[method]
    return processor_time_ms(
        lambda: collapse(plain.dense().mesh, target_faces=reduced.num_faces), repeats
    )


# --- The case -----------------------------------------------------------------------------------

PUBLISHED_POINTS = {"Bunny": 4026, "Buddha": 7806}
"""Numbers of points of table 3.2 where the printed number is a tenth rounded to the nearest integer
instead of rounded down."""


def reduction_case(
    model: DepthModel, method: str, plan: Plan, *, share: float, **options: Any
) -> Case:
    """Return the case that reduces a range image by a method and computes every measure.

    Parameters
    ----------
    share : float
        Share of the measured pixels to keep.
    options
        Options of the method.
    """
    tenth = PUBLISHED_POINTS.get(model.published) if model.same_file and share == 0.1 else None
    return Case(
        reduce_and_measure,
        model.options
        | {
            "method": method,
            "share": share,
            "points_target": tenth,
            "method_options": options,
            "most_samples": 1_000_000 if plan.scale == "full" else 100_000,
            "repeats": 7 if plan.scale == "full" else 3,
            "seed": plan.seed,
        },
        inputs=(model.data,) if model.data else (),
    )


def reduce_and_measure(case: Case) -> Row:
    """Reduce one range image by one method and compare the result with the dense mesh."""
    options = case.options
    image = open_input(options)
    count = int(image.measured.sum())
    target = options["points_target"] or math.floor(count * options["share"])
    reduced = reduce(image, options["method"], target, **options["method_options"])
    mesh = reduced if isinstance(reduced, Mesh) else reduced.mesh
    row: Row = {
        "points_original": count,
        "points_target": target,
        "points": mesh.num_vertices,
        "faces": mesh.num_faces,
        "reached": mesh.num_vertices >= 0.97 * target,
        "time_ms": time_ms(
            image, options["method"], target, reduced, options["repeats"],
            **options["method_options"],
        ),
    }  # fmt: skip
    if not isinstance(reduced, Mesh):
        row["literal_count"] = getattr(reduced, "literal_count", None)
        row["pixels"] = reduced.pixels.astype(np.int16).tobytes()
    return row | {"reduced": mesh} | measures(image, mesh, options)


def measures(image: RangeInput, mesh: Mesh, options: Mapping[str, Any]) -> Row:
    """Return every measure of a reduced mesh, as flat columns."""
    from manip3d import metrics

    dense = image.dense().mesh
    samples = min(10 * dense.num_faces, options["most_samples"])
    row: Row = {"faces_original": dense.num_faces}
    for sampling in ("vertex", "area"):
        metro = metrics.metro(
            dense,
            mesh,
            sampling=sampling,
            samples=samples if sampling == "area" else None,
            rng=options["seed"],
        )
        row[f"metro_{sampling}"] = metro.mean
        row[f"metro_{sampling}_backward"] = metro.backward.mean / metro.diagonal
    range_error = image.error(mesh)
    row |= {
        "mse": range_error.mse,
        "mse_mm2": range_error.mean_square_mm2,
        "coverage": range_error.coverage,
        "fmpd": metrics.fmpd(dense, mesh, clip=True).value,
    }
    texture = metrics.texture_error(dense, mesh, samples=samples, rng=options["seed"])
    return row | {"texture_mean": texture.mean, "texture_mse": texture.mse}


# --- published values ---------------------------------------------------------------------------


def _printed(table: str, row: Row, column: str) -> float | None:
    """Return a cell of table 3.4, which has a row for each model and method."""
    name = _PRINTED.get(row["method"], row["method"])
    for printed in _published.published_rows(table):
        if printed["model"] == row["stands_in_for"] and printed["method"] == name:
            return _number(printed[column])
    return None


def printed_time(table: str, row: Row) -> float | None:
    """Return a cell of table 3.2 or 3.3, which has a column for each method."""
    method: str = row["method"]
    name = _PRINTED.get(method, method) if "3_3" in table else method.upper()
    for printed in _published.published_rows(table):
        if printed["model"] == row["stands_in_for"]:
            return _number(printed.get(name, ""))
    return None


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:  # the cell is "n.a." or unreadable
        return None


def complete_quality(row: Row) -> Row:
    """Add to a row the values that table 3.4 prints for its model."""
    units = {"metro": ("metro_1e-3", 1e-3), "mse": ("mse_1e-3", 1e-3), "fmpd": ("fmpd_1e-1", 1e-1)}
    printed = {name: _printed(QUALITY, row, column) for name, (column, _) in units.items()}
    return row | {
        f"published_{name}": None if value is None else value * units[name][1]
        for name, value in printed.items()
    }


QUALITY = "table_3_4_quality_at_5_percent"


def listing(rows: Mapping[str, Row], name: str, scale: float = 1.0, digits: int = 3) -> str:
    """Return the values of one column by method, such as ``UNI 0.889, CS3 0.711``."""
    return ", ".join(
        f"{SHORT.get(method, method)} {row[name] * scale:.{digits}f}"
        for method, row in rows.items()
        if row.get(name) is not None
    )


METHOD_COLUMN = Column("method", "method", words=TITLES)
QUALITY_COLUMNS = (
    METHOD_COLUMN,
    Column("points", "vertices"),
    Column("faces", "faces"),
    Column("metro_area", "Metro, area, 1e-3", 1e3, 3, "published_metro", lower_is_better=True),
    Column("metro_vertex", "Metro, vertex, 1e-3", 1e3, 3, lower_is_better=True),
    Column("metro_area_backward", "Metro back, area", 1e3, 3),
    Column("mse", "range-image MSE, 1e-6", 1e6, 3, lower_is_better=True),
    Column("mse_mm2", "mm²", 1.0, 3),
    Column("coverage", "coverage", 1.0, 4),
    Column("fmpd", "FMPD", 1.0, 3, "published_fmpd", ratio=False, lower_is_better=True),
)
ERROR_COLUMNS = tuple(replace(column, published="") for column in QUALITY_COLUMNS)
"""Columns without published numbers, for figures, whose values are not printed."""
DATA_NOTE = data_note("range image")
NOTE = (
    "Every method "
    "keeps the same number of vertices. The original is the dense mesh: two triangles per full "
    "2x2 cell of pixels, one where three are valid; of scenes, no edge longer than 0.5 m, in the "
    "original and in the results. Metro is the mean distance from original to result, in "
    "thousandths of the diagonal of the original's bounding box."
)
QEM_NOTE = (
    "QEM here is this package's QEM4VR on the dense mesh, which keeps boundaries as MeshLab's "
    "filter does with the published settings; it is not MeshLab's. Lindstrom-Turk (FMEPS) is no "
    "part of this package. MeshLab, CGAL, Open3D, meshoptimizer and greedy insertion are compared "
    "in benchmarks/RESULTS.md."
)
TIME_NOTE = (
    "Times are processor times on one thread, from range image to mesh, the least of several runs: "
    "they leave out what other programs took from this machine, and are not wall times. QEM's "
    "includes making the dense mesh. Compare ratios within this run."
)
