"""Defaults of the Python functions equal those of the core's options structs."""

from __future__ import annotations

import contextlib
import inspect
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import manip3d
from manip3d import authenticate, capture, forge, metrics, modify, simplify

HEADERS = Path(__file__).parents[1] / "cpp" / "include" / "manip3d"
STRUCT = re.compile(r"^struct (\w+Options) \{\n(.*?)^\};", re.MULTILINE | re.DOTALL)
# "double near = 0.3, far = 8.0;", "Sampling sampling = Sampling::kVertex;", "std::string sender;"
FIELDS = re.compile(r"^  (?!static)([\w:<>, ]+?) (\w+(?: ?=[^;]+|\{\})?(?:, \w+ = [^;,]+)*);", re.M)
WORDS = {"": None, "true": True, "false": False}


def value_of(text: str) -> Any:
    """Return a C++ literal as a Python value; enumerators by name, kLikeThis -> like_this."""
    text = text.strip()
    if text in WORDS:
        return WORDS[text]
    if "infinity" in text:
        return math.inf
    if enumerator := re.fullmatch(r"\w+::k(\w+)", text):
        return re.sub(r"(?<!^)(?=[A-Z])", "_", enumerator[1]).lower()
    if text.endswith("Zero()"):
        return (0.0, 0.0, 0.0)
    if text.startswith('"'):
        return text.strip('"')
    return float(text) if re.fullmatch(r"[-\d.e]+", text) else None


def structs() -> dict[str, dict[str, Any]]:
    """Fields and defaults of every options struct of the public headers."""
    found: dict[str, dict[str, Any]] = {}
    for path in sorted(HEADERS.rglob("*.hpp")):
        for name, body in STRUCT.findall(re.sub(r"///?.*", "", path.read_text())):
            fields = found.setdefault(name, {})
            for _, declared in FIELDS.findall(body):
                for part in declared.split(", "):
                    key, _, default = part.partition("=")
                    fields[key.strip().removesuffix("{}")] = value_of(default)
    return found


CORE = structs()

# Facades of each struct. A parameter of another name than its field stands in ALIASES.
FACADES: dict[str, list[Callable[..., Any]]] = {
    "AnimationMeshOptions": [modify.animation_mesh],
    "BoundaryGapOptions": [metrics.boundary_gap],
    "CleanOptions": [simplify.clean],
    "ColliderOptions": [modify.ColliderTracker],
    "ColorErrorOptions": [metrics.color_error],
    "CompositeOptions": [forge.stream],
    "Cs3Options": [simplify.cs3, simplify.cs3_grid, simplify.Cs3Stream],
    "DeformOptions": [forge.deform],
    "DensityOptions": [authenticate.DensityParameters, authenticate.density_consistency],
    "DepthNoiseOptions": [authenticate.depth_noise],
    "DepthStepOptions": [modify.animation_mesh],
    "DepthSmootherOptions": [simplify.ReliefStream],
    "FastOptions": [simplify.fast],
    "FmpdOptions": [metrics.fmpd],
    "CrossModalOptions": [authenticate.CrossModalParameters],
    "GenericOptions": [authenticate.generic_consistency],
    "ReflectanceOptions": [authenticate.reflectance_consistency],
    "TurnOptions": [authenticate.turn_consistency],
    "GridMeshOptions": [simplify.dense_mesh, simplify.dense_mesh_grid],
    "HausdorffOptions": [metrics.hausdorff_bound],
    "InsertionOptions": [forge.insert_occluding],
    "JointSmootherOptions": [],  # JointSmoother() names a preset, which the core makes
    "KeyPersonOptions": [modify.KeyPerson],
    "MetroOptions": [metrics.metro],
    "NearestOptions": [metrics.nearest_distances],
    "OcclusionOptions": [authenticate.OcclusionParameters, authenticate.occlusion_consistency],
    "PaperOptions": [authenticate.embed_paper],
    "PersonMaskOptions": [modify.PhantomPipeline, modify.segment_body],
    "PhantomMeshOptions": [modify.PhantomPipeline],
    "PhantomOptions": [modify.PhantomPipeline],
    "PlacementOptions": [modify.PlacementEstimator],
    "QemOptions": [simplify.qem4vr],
    "QualityOptions": [simplify.quality],
    "ReadOptions": [manip3d.read_mesh],
    "ReadPointsOptions": [],  # max_bytes=None there, 0 here
    "RecorderOptions": [capture.record],
    "ReliefOptions": [simplify.relief, simplify.relief_grid, simplify.ReliefStream],
    "RegionOptions": [modify.segment_body],
    "RenderOptions": [metrics.render_depth],
    "ReposeOptions": [modify.repose],
    "ResampleOptions": [forge.resample, forge.crtp],
    "RgbdOptions": [capture.open_rgbd],
    "ScanOriginOptions": [],  # the scan says whether it lies on a map
    "SegmentOptions": [forge.segment],
    "ShoeCoverOptions": [modify.ShoeCoverTracker],
    "SnapOptions": [forge.snap_to_lattice],
    "SparseOptions": [],  # find_processing says which points stand alone
    "TextureErrorOptions": [metrics.texture_error],
    "UdpOptions": [capture.open_lidar],
    "VelodyneOptions": [capture.open_lidar],
    "WatermarkOptions": [authenticate.Watermarker],
    "SceneWriteOptions": [],  # of a scene that the writer of Python has
    "WriteOptions": [],  # a folder that the writer of Python names
}
ALIASES = {
    "num_threads": "threads",
    "seed": "rng",
    "texture": "seam_mode",
    "cut_azimuth_deg": "cut_azimuth",
    "min_range_m": "min_range",
    "max_range_m": "max_range",
    "method": "resampling",
    "round": "round_points",
}
WORDS_OF_THE_FACADE = {"seam_planes": "planes", "poisson_disk": "poisson"}
# A stream's own: single images have no frame before them, whose edges they could keep; and what
# runs for each frame leaves the other cores to the rest of its program.
OTHERWISE = {
    ("ReliefOptions", "ReliefStream", "stability"): 3.0,
    ("ReliefOptions", "ReliefStream", "num_threads"): 1,
    ("Cs3Options", "Cs3Stream", "num_threads"): 1,
}


def same(facade: Any, core: Any) -> bool:
    """Whether two defaults agree; None stands for the core's default or a value from the input."""
    if facade is None or core is None:
        return True
    return bool(
        facade == WORDS_OF_THE_FACADE.get(core, core) if isinstance(core, str) else facade == core
    )


def test_every_options_struct_has_its_facades_here() -> None:
    assert set(CORE) == set(FACADES)
    bound = {name for name in dir(manip3d._core) if name.endswith("Options")}
    assert bound <= set(FACADES)


@pytest.mark.parametrize(
    ("struct", "facade"),
    [(struct, facade) for struct, facades in FACADES.items() for facade in facades],
    ids=lambda value: getattr(value, "__name__", value),
)
def test_the_facade_s_defaults_are_the_core_s(struct: str, facade: Callable[..., Any]) -> None:
    given = {name: p.default for name, p in inspect.signature(facade).parameters.items()}
    compared = 0
    for name, core in CORE[struct].items():
        parameter = name if name in given else ALIASES.get(name, name)
        default = given.get(parameter, inspect.Parameter.empty)
        if default is inspect.Parameter.empty:
            continue
        wanted = OTHERWISE.get((struct, facade.__name__, name), core)
        assert same(default, wanted), f"{name}: {default!r} in Python, {wanted!r} in the core"
        compared += core is not None and default is not None
    assert compared > 0


def test_the_headers_are_read_as_they_stand() -> None:
    """Values read from the headers are those of bound structs made without arguments."""
    checked = 0
    for struct, fields in CORE.items():
        bound = getattr(manip3d._core, struct, None)
        if bound is None or struct == "VelodyneOptions":  # has no default constructor
            continue
        made = bound()
        for name, value in fields.items():
            if isinstance(value, float | bool) and hasattr(made, name):
                assert getattr(made, name) == value, f"{struct}.{name}"
                checked += 1
    assert checked > 30


def test_defaults_arrive_in_the_core() -> None:
    triangle = manip3d.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    facade = simplify.qem4vr(triangle, target_faces=0)._options
    core = manip3d._core.QemOptions()
    names = [name for name in dir(core) if not name.startswith("_")]
    assert len(names) >= 10
    assert {n: getattr(facade, n) for n in names} == {n: getattr(core, n) for n in names}


PER_FRAME = {"Cs3Stream", "ReliefStream"}


def test_functions_use_all_cores_and_what_runs_for_each_frame_one() -> None:
    found: dict[str, Any] = {}
    for module in (manip3d, authenticate, capture, forge, metrics, modify, simplify):
        for name, thing in vars(module).items():
            if name.startswith("_") or not callable(thing):
                continue
            methods = vars(thing).items() if inspect.isclass(thing) else ()
            public = [(f"{name}.{key}", f) for key, f in methods if key[0] != "_" and callable(f)]
            for called, call in [(name, thing), *public]:
                with contextlib.suppress(ValueError):  # an exception has no signature
                    threads = inspect.signature(call).parameters.get("threads")
                    if threads is not None:
                        found[called] = threads.default
    assert len(found) > 30
    assert {name for name, default in found.items() if default != 0} == PER_FRAME
