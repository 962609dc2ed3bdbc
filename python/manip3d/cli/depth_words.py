"""Sentences and JSON of ``manip3d depth``: what was read, and what became of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manip3d.cli.depth_options import OPTIONS
from manip3d.cli.terminal import Terminal, count, counted, named_as_options

if TYPE_CHECKING:
    from manip3d.simplify import DepthFileResult, DepthOptions, JointFileResult, RecordingResult

OVERRIDE = "; --unit overrides it"
"""End of a sentence on a unit that was guessed."""


def has_missed(result: DepthFileResult | JointFileResult) -> bool:
    """Return whether a mesh has too many points, covers too little or bridges too much."""
    return result.target_missed or result.coverage_missed or result.bridges_missed


def sentence_of_all(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return words on the depths and meshes of all images, as nobody reads those of each."""
    made = [row for row in rows if row.get("coverage") is not None]
    return "\n".join(words for words in (_depths_of_all(rows), _meshes_of_all(made)) if words)


def _meshes_of_all(rows: Sequence[Mapping[str, Any]]) -> str:
    if not rows:
        return ""
    bridges = {row["source"]: row["bridges"] - row["filled"] for row in rows}
    worst = min(rows, key=lambda row: row["coverage"])
    most = max(bridges, key=lambda name: bridges[name])
    words = (
        f"{counted(len(rows), 'mesh', 'meshes')}: {worst['source']} covers least of its surface's "
        f"pixels, {100 * worst['coverage']:.1f} %; {100 * bridges[most]:.2f} % of the area of "
        f"{most} bridges gaps, the largest share"
    )
    for name, missed in _MISSED:
        if number := sum(bool(row[name]) for row in rows):
            words += f"; {count(number)} {missed}"
    return words


_MISSED = (
    ("target_missed", "missed the target of points"),
    ("coverage_missed", "covered less than --min-coverage of the measured pixels"),
    ("bridges_missed", "had more bridges than --max-bridges"),
)
"""Columns of shortfalls, and words on the number of meshes that have them."""


def _depths_of_all(rows: Sequence[Mapping[str, Any]]) -> str:
    from manip3d.simplify._depth_words import DepthFound, sentence_of_images, size_warning

    found = [
        DepthFound(
            row["unit"],
            row["unit_guessed"],
            row["unit_doubt"] or "",
            row["depth_near"],
            row["depth_far"],
            row["marked_pixels"],
            row.get("size") or "",
            row.get("camera") or "",
        )
        for row in rows
        if row.get("unit")
    ]
    override = OVERRIDE if any(each.is_guess for each in found) else ""
    return f"read {sentence_of_images(found)}{size_warning(found)}{override}" if found else ""


def recording_sentence(made: RecordingResult, output: Path) -> str:
    worst = min(made.frames, key=lambda result: result.coverage)
    points = [result.points for result in made.frames]
    few = f"{count(min(points))} to {count(max(points))} points"
    seconds = sum(result.seconds for result in made.frames) / len(made.frames)
    failed = f"; {counted(len(made.failed), 'frame')} without a surface" if made.failed else ""
    return (
        f"{worst.options.method}: {counted(len(made.frames), 'frame')}, {few}, "
        f"{seconds * 1000:.1f} ms a frame; frame {worst.source} covers least of its surface's "
        f"pixels, {100 * worst.coverage:.1f} %{failed}; wrote {output}"
    )


def joint_sentence(result: JointFileResult) -> str:
    options = result.options
    low = f", less than {100 * options.min_coverage:.4g} %" if result.coverage_missed else ""
    many = f", more than {100 * options.max_bridges:.4g} %" if result.bridges_missed else ""
    few = f"; target of {counted(options.points or 0, 'point')} missed"
    return (
        f"{options.method}: {counted(result.points_before, 'point')} of "
        f"{counted(len(result.sources), 'view')} -> {count(result.points)}, "
        f"{counted(result.faces, 'face')} in {result.seconds * 1000:.1f} ms; covers "
        f"{100 * result.coverage:.1f} % of the measured pixels{low}{_without_ray(result)}, "
        f"{100 * result.bridges:.2f} % of its area bridges gaps{many}"
        f"{few if result.target_missed else ''}; wrote {result.output}"
    )


def joint_record(result: JointFileResult) -> dict[str, Any]:
    return {
        "inputs": [str(source) for source in result.sources],
        "output": str(result.output),
        "method": result.options.method,
        "effort": _effort_of(result.options),
        "depth": result.depth,
        "unit": result.unit,
        "unit_guessed": result.unit_guessed,
        "points_before": result.points_before,
        "target_points": result.options.points,
        "points": result.points,
        "faces": result.faces,
        "seconds": round(result.seconds, 4),
        "coverage": round(result.coverage, 6),
        "bridges": round(result.bridges, 6),
        "lone_pixels": result.lone_pixels,
        "without_ray": result.without_ray,
        "target_missed": result.target_missed,
        "coverage_missed": result.coverage_missed,
        "bridges_missed": result.bridges_missed,
    }


def tell(shell: Terminal, result: DepthFileResult) -> None:
    if result.depth:
        is_guess = result.unit and result.options.is_unit_guessed
        override = OVERRIDE if is_guess else ""
        words = named_as_options(result.depth, OPTIONS)
        shell.say(f"read {result.source}: {words}{override}")
    shell.say(_sentence(result))
    warn_if_sparse(shell, result)


def _sentence(result: DepthFileResult) -> str:
    return f"{_made(result)}; {_covered(result)}{_missed(result)}; wrote {result.output}"


def _made(result: DepthFileResult) -> str:
    """Return words on how the mesh came about."""
    options = result.options
    kind = f" ({options.variant})" if options.method == "cs3" else ""
    if options.effort != "balanced":
        kind = f" ({options.effort})"
    words = (
        f"{options.method}{kind}: {counted(result.points_before, 'point')} -> "
        f"{count(result.points)}, {counted(result.faces, 'face')}"
    )
    if result.faces_cut:
        words += f", {counted(result.faces_cut, 'face')} across depth steps left out"
    return f"{words} in {result.seconds * 1000:.1f} ms"


def _covered(result: DepthFileResult) -> str:
    """Return words on what the mesh covers and bridges, beside what was asked for."""
    options = result.options
    limit = f"less than {100 * options.min_coverage:.4g} %"
    # The limit is one on the measured pixels, of which some may lie on no surface.
    is_low = result.coverage < options.min_coverage
    low = f", {limit}" if is_low else ""
    outside = f" ({limit} of them are covered)" if result.coverage_missed and not is_low else ""
    many = f", more than {100 * options.max_bridges:.4g} %" if result.bridges_missed else ""
    if many and result.left_area:
        together = 100 * result.unwanted_bridges
        many = f" ({together:.2f} % with faces across depth steps{many})"
    bridges = 100 * (result.bridges - result.filled)
    filled = f" and {100 * result.filled:.2f} % fills pinholes" if result.filled else ""
    return (
        f"covers {100 * result.coverage:.1f} % of the surface's pixels{low}"
        f"{_not_covered(result, outside)}, "
        f"{bridges:.2f} % of its area bridges gaps{many}{filled}"
    )


_WHY_FEWER = {
    "small_pieces": ", as small pieces were left out with all of their points",
    "few_faces": ", as only a few triangles of a larger mesh are left",
    "fewer_points": ", as a mesh of fewer points covers more",
    "pinholes": ", as points at pinholes were merged or left out",
}
"""Words on the ``stop`` of a relief with fewer points than the target."""


def _missed(result: DepthFileResult) -> str:
    """Return words on the numbers of points and bytes, and on what speaks against the mesh."""
    options, words = result.options, ""
    if result.target_missed:
        words += f"; target of {counted(options.points or 0, 'point')} missed"
        words += _WHY_FEWER.get(result.stop, "")
    if result.num_bytes is not None:
        words += f"; {count(result.num_bytes)} of {counted(options.max_bytes or 0, 'byte')}"
    return words + _left_across_steps(result)


def _not_covered(result: DepthFileResult, so_few: str) -> str:
    """Return words on the pixels that the coverage of the surface does not count.

    ``so_few`` says that too few of the measured pixels are covered, if they are.
    """
    words = ""
    if round(100 * result.outside, 1) > 0 or so_few:
        words += f", {100 * result.outside:.1f} % of the measured pixels lie on no surface{so_few}"
    words += _without_ray(result)
    if result.dropped_pixels:
        parts = "triangles" if result.stop == "few_faces" else "small pieces"
        words += f", {counted(result.dropped_pixels, 'pixel')} of {parts} left out"
    if result.unsure_pixels:
        words += f", {counted(result.unsure_pixels, 'pixel')} without confidence left out"
    if result.filled_pixels:
        words += f", {counted(result.filled_pixels, 'pixel')} in pinholes filled"
    return words


def _without_ray(result: DepthFileResult | JointFileResult) -> str:
    from manip3d.simplify._depth_options import NO_RAY_WORDS

    if not result.without_ray:
        return ""
    have = "has" if result.without_ray == 1 else "have"
    return f", {counted(result.without_ray, 'pixel')} {have} {NO_RAY_WORDS}"


def warn_if_sparse(shell: Terminal, result: DepthFileResult | JointFileResult) -> None:
    from manip3d.simplify._depth_options import SPARSE_WORDS

    if result.is_sparse:
        shell.warn(SPARSE_WORDS)


def _left_across_steps(result: DepthFileResult) -> str:
    if not result.faces_left:
        return ""
    return (
        f"; the scene has depth steps, and {counted(result.faces_left, 'face')} across them, "
        f"{100 * result.left_area:.2f} % of the area, stayed, as --depth-step is 0 and there is no "
        "--max-edge"
    )


def _effort_of(options: DepthOptions) -> str | None:
    return options.effort if options.method == "relief" else None


def record(result: DepthFileResult) -> dict[str, Any]:
    """The result for ``--json``."""
    files = {"input": str(result.source), "output": str(result.output)}
    is_cs3 = result.options.method == "cs3"
    return files | {
        "method": result.options.method,
        "variant": result.options.variant if is_cs3 else None,
        "effort": _effort_of(result.options),
        "seed": result.options.seed if result.options.method == "poisson" else None,
        "depth": result.depth,
        "unit": result.unit,
        "unit_guessed": result.depth_found.is_guess,
        "unit_doubt": result.depth_found.doubt,
        "depth_near": result.depth_found.near,
        "depth_far": result.depth_found.far,
        "marked_pixels": result.depth_found.num_marked,
        "size": result.depth_found.size,
        "camera": result.depth_found.camera,
        "points_before": result.points_before,
        "target_points": result.options.points,
        "points": result.points,
        "bytes": result.num_bytes,
        "max_bytes": result.options.max_bytes,
        "faces": result.faces,
        "faces_cut": result.faces_cut,
        "stop": result.stop,
        "reached": result.reached,
        "literal_count": result.literal_count,
        "seconds": round(result.seconds, 4),
        "coverage": round(result.coverage, 6),
        "bridges": round(result.bridges, 6),
        "filled": round(result.filled, 6),
        "outside": round(result.outside, 6),
        "lone_pixels": result.lone_pixels,
        "without_ray": result.without_ray,
        "dropped_pixels": result.dropped_pixels,
        "filled_pixels": result.filled_pixels,
        "unsure_pixels": result.unsure_pixels,
        "faces_left": result.faces_left,
        "left_area": round(result.left_area, 6),
        "target_missed": result.target_missed,
        "coverage_missed": result.coverage_missed,
        "bridges_missed": result.bridges_missed,
    }
