"""Results as Markdown tables, each in its own section of RESULTS.md or of a page of ``results/``.

A section lies between ``<!-- NAME -->`` and ``<!-- /NAME -->``. The text around sections is written
by hand and is not changed.
"""

from __future__ import annotations

import math
import re
import statistics
from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

SUMMARY = Path(__file__).with_name("RESULTS.md")
PAGES = (SUMMARY, *sorted(SUMMARY.with_name("results").glob("*.md")))
REFERENCE = "manip3d QEM4VR"
MIB = 2**20
Row = dict[str, Any]


def write_section(name: str, markdown: str) -> None:
    """Replace a section on the page that contains it."""
    pattern = re.compile(f"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
    for page in PAGES:
        text, found = pattern.subn(
            lambda match: f"{match[1]}\n{markdown}\n{match[2]}", page.read_text(encoding="utf-8")
        )
        if found:
            page.write_text(text, encoding="utf-8")
            return
    raise ValueError(f"{SUMMARY} and its pages: no section {name}")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table; the first column is left-aligned, all others right-aligned."""
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def environment_line(environment: Row) -> str:
    """Return a sentence about the machine and the versions."""
    versions = ", ".join(f"{name} {version}" for name, version in environment["versions"].items())
    return (
        f"{environment['cpu']}, {environment['cores']} cores, {environment['memory_gib']} GiB, "
        f"{environment['system']}, Python {environment['python']}; {versions}.\n"
    )


def number(value: float | None, digits: int = 3) -> str:
    """Format a number with ``digits`` significant digits; a dash for None."""
    if value is None:
        return "–"
    if value == 0.0:
        return "0"
    if abs(value) >= 10.0 ** (digits - 1):
        return f"{value:,.0f}"
    return f"{value:#.{digits}g}"


def write_simplify(results: Row) -> None:
    """Write the sections `environment`, `claims`, `ratios` and `simplify`."""
    write_section("environment", environment_line(results["environment"]))
    models = [list(rows) for _, rows in groupby(results["rows"], key=lambda row: row["model"])]
    write_section("claims", _claims(results["rows"]))
    write_section("ratios", _ratios(models))
    write_section("simplify", "\n".join(map(_model_tables, models)))


def _median_time(row: Row) -> float:
    return float(statistics.median(row["cpu_s"]))


def _vertex_metro(row: Row) -> float:
    return float(row["metro_vertex"]["mean"])


def _area_metro(row: Row) -> float:
    return float(row["metro_area"]["mean"])


COMPARED = {"time": _median_time, "vertex Metro": _vertex_metro, "area Metro": _area_metro}


def _claims(rows: list[Row]) -> str:
    """Return the claims with their numbers; claims whose rows are missing are left out."""
    ran = {(row["model"], row["peer"]): row for row in rows if row["status"] == "ok"}
    body = []

    def claim(words: str, got: float, limit: float, digits: int = 3) -> None:
        verdict = "holds" if got <= limit else "**does not hold**"
        body.append([words, number(got, digits), number(limit, digits), verdict])

    for model in ("rockerArm", "ferrari_458"):
        for peer in ("PyMeshLab subset", "PyMeshLab optimal"):
            if (model, REFERENCE) in ran and (model, peer) in ran:
                own, theirs = (_median_time(ran[model, name]) for name in (REFERENCE, peer))
                claim(f"{model}: QEM4VR's ms, at most those of {peer}", 1e3 * own, 1e3 * theirs)
    if row := ran.get(("ferrari_458", REFERENCE)):
        most = max(row["peak_bytes"]) / MIB
        claim(f"{row['input_faces']:,} faces: MiB of the process, at most 1 GiB", most, 1024)
    if row := ran.get(("rockerArm", REFERENCE)):
        claim("rockerArm: vertex Metro, 1e-3", 1e3 * _vertex_metro(row), 0.160)
        claim("rockerArm: area Metro, 1e-3", 1e3 * _area_metro(row), 0.142)
    if row := ran.get(("LeePerrySmith", REFERENCE)):
        claim("Head: mean texture error, 1e-2", 1e2 * row["texture"]["mean"], 0.34)
        claim("Head: RMS texture error, 1e-2 (aim)", 1e2 * row["texture"]["rms"], 0.45)
        for name in ("QEM_TP", "QEM_BTP"):
            if other := ran.get(("LeePerrySmith", f"manip3d {name}")):
                for kind, metro in (("vertex", _vertex_metro), ("area", _area_metro)):
                    words = f"Head: {kind} Metro, 1e-3, at most {name}'s"
                    claim(words, 1e3 * metro(row), 1e3 * metro(other))
    return table(["claim", "QEM4VR", "limit", "verdict"], body)


def _ratios(models: list[list[Row]]) -> str:
    """Return time and error of each peer divided by QEM4VR's; above 1 the peer is worse."""
    peers = list(dict.fromkeys(row["peer"] for rows in models for row in rows))
    others = [peer for peer in peers if not peer.startswith("manip3d")]
    parts = []
    for title, value in COMPARED.items():
        body = []
        for rows in models:
            ran = {row["peer"]: row for row in rows if row["status"] == "ok"}
            if REFERENCE not in ran:
                continue
            own = value(ran[REFERENCE])
            cells = [
                f"{value(ran[peer]) / own:.2f}{_missed(ran[peer])}" if peer in ran else "–"
                for peer in others
            ]
            body.append([rows[0]["model"], *cells])
        parts.append(table([f"{title} / QEM4VR's", *others], body))
    return "\n".join(parts)


def _model_tables(rows: list[Row]) -> str:
    first = rows[0]
    rounds = max(len(row["cpu_s"]) for row in rows)
    head = (
        f"### {first['model']}: {first['input_faces']:,} → {first['target']:,} faces\n\n"
        f"Rounds: {rounds}; load average at the start: {first['load']:.1f}.\n"
    )
    reference = next((row for row in rows if row["peer"] == REFERENCE), None)
    if reference is None or reference["status"] != "ok":
        reference = None
    ran = [row for row in rows if row["status"] == "ok"]
    absent = [row for row in rows if row["status"] != "ok"]
    notes = "".join(f"- {row['peer']}: {_status(row)}\n" for row in absent)
    return f"{head}\n{_costs(ran, reference)}\n{_measures(ran)}\n{notes}"


def _status(row: Row) -> str:
    message = row.get("message", "")
    return f"{row['status']} ({message})" if message else row["status"]


def _ratio(row: Row, reference: Row | None) -> str:
    if reference is None:
        return "–"
    return f"{_median_time(row) / _median_time(reference):.2f}"


def _missed(row: Row) -> str:
    """Return a mark if the target was missed by more than one per cent."""
    return " *" if abs(row["faces"] - row["target"]) > 0.01 * row["target"] else ""


def _faces(row: Row) -> str:
    return f"{row['faces']:,}{_missed(row)}"


def _costs(rows: list[Row], reference: Row | None) -> str:
    body = []
    for row in rows:
        extra = [p - b for p, b in zip(row["peak_bytes"], row["base_bytes"], strict=True)]
        body.append(
            [
                row["peer"],
                row["placement"],
                _faces(row),
                number(1e3 * _median_time(row)),
                number(1e3 * min(row["cpu_s"])),
                _ratio(row, reference),
                f"{statistics.median(extra) / MIB:.0f}",
                f"{statistics.median(row['peak_bytes']) / MIB:.0f}",
            ]
        )
    head = [
        "peer", "placement", "faces", "ms, median", "ms, least", "time / QEM4VR",
        "MiB for the call", "MiB of the process",
    ]  # fmt: skip
    return table(head, body)


def _measures(rows: list[Row]) -> str:
    textured = rows[0]["textured"] if rows else False
    head = [
        "errors / diagonal, 1e-3", "vertex mean", "area mean", "area RMS", "area max",
        "area back", "FMPD", "boundary gap", "cracks",
    ]  # fmt: skip
    if textured:
        head += ["texture mean, 1e-2", "texture RMS, 1e-2", "wrong material"]
    return table(head, [_measure_row(row, textured) for row in rows])


def _measure_row(row: Row, textured: bool) -> list[str]:
    area = row["metro_area"]
    gap = row.get("boundary_gap")
    cells = [
        row["peer"],
        number(1e3 * row["metro_vertex"]["mean"]),
        number(1e3 * area["mean"]),
        number(1e3 * area["rms"]),
        number(1e3 * area["max"]),
        number(1e3 * area["backward_mean"]),
        number(row["fmpd"]),
        number(None if gap is None else 1e3 * gap),
        str(row["cracks"]),
    ]
    if not textured:
        return cells
    if not row["keeps_texture"]:
        return [*cells, "ignores UVs", "–", "–"]
    texture = row.get("texture")
    if texture is None or texture["mean"] is None:
        return [*cells, "–", "–", "–"]
    mismatch = 100.0 * texture["material_mismatch_rate"]
    return [
        *cells,
        number(100.0 * texture["mean"]),
        number(100.0 * texture["rms"]),
        f"{mismatch:.2f} %",
    ]


# --- Every mesh of the data folder ------------------------------------------------------------

OURS, OURS_SHAPE = "manip3d", "manip3d, shape only"
EVERY_MESH_PEERS = (
    OURS,
    OURS_SHAPE,
    "manip3d fast",
    "PyMeshLab texture",
    "meshoptimizer attributes",
    "meshoptimizer update",
    "PyMeshLab subset",
    "PyMeshLab optimal",
    "MeshLib",
    "VTK",
    "fast-simplification",
    "pyfqmr",
    "Open3D",
    "CGAL Lindstrom-Turk",
)
FEW_FACES = 50  # results with smaller targets are reported but not judged
ROUNDING = 1e-9  # share of the diagonal; smaller errors count as equal


def write_every_mesh(results: Row) -> None:
    """Write the section `every_mesh`."""
    write_section("every_mesh", every_mesh(results))


def missing_of_every_mesh(results: Row, meshes: Iterable[str]) -> list[str]:
    """Return the meshes of which the results have no row of manip3d or of a peer."""
    ran = {(row["mesh"], row["peer"]) for row in results["rows"]}
    return [mesh for mesh in meshes if not {(mesh, p) for p in EVERY_MESH_PEERS} <= ran]


def every_mesh(results: Row) -> str:
    """Return the aims with their verdicts, all cases, and the cases that are worse than a peer."""
    by_case: dict[tuple[str, float], list[Row]] = {}
    for row in results["rows"]:
        by_case.setdefault((row["mesh"], row["ratio"]), []).append(row)
    cases = [_case(rows) for rows in by_case.values() if any(row["peer"] == OURS for row in rows)]
    parts = [environment_line(results["environment"]), _every_mesh_aims(cases)]
    parts += [_every_mesh_table(cases), _every_mesh_worse(cases)]
    return "\n".join(parts)


def _reached(row: Row) -> bool:
    return row.get("area") is not None and row["faces"] <= 1.01 * row["target"]


def _best(rows: list[Row], value: str) -> Row | None:
    """Return the peer with the smallest value among those that reached the target."""
    rivals = [row for row in rows if not row["peer"].startswith(OURS) and _reached(row)]
    return min(
        (r for r in rivals if r.get(value) is not None), key=lambda r: r[value], default=None
    )


def _case(rows: list[Row]) -> Row:
    """Return the comparison of manip3d with the best peers, for one mesh and number of faces."""
    own = next(row for row in rows if row["peer"] == OURS)
    shape = next((row for row in rows if row["peer"] == OURS_SHAPE), None)
    keeping = [row for row in rows if row["keeps_uv"]]
    case: Row = {"own": own, "judged": own["target"] >= FEW_FACES, "has_uv": own["has_uv"]}
    pairs: list[tuple[str, Row, Row | None, str]] = []  # name, our row, best peer's row, value
    if own["has_uv"]:
        pairs.append(("area", own, _best(keeping, "area"), "area"))
        pairs.append(("UV", own, _best(keeping, "texture"), "texture"))
        if shape is not None:
            blind = [row for row in rows if not row["keeps_uv"]]
            pairs.append(("area, shape only", shape, _best(blind, "area"), "area"))
    else:
        pairs.append(("area", own, _best(rows, "area"), "area"))
    case["pairs"] = [
        (what, mine[value], best[value], best["peer"])
        for what, mine, best, value in pairs
        if best is not None and mine.get(value) is not None
    ]
    return case


def _ratio_to_best(own: float, best: float) -> float:
    """Return our error divided by the best peer's; above 1 ours is worse."""
    return max(own, ROUNDING) / max(best, ROUNDING)


def _every_mesh_aims(cases: list[Row]) -> str:
    judged = [case for case in cases if case["judged"]]

    def share(of: list[bool]) -> str:
        return f"{sum(of)} of {len(of)}, {100.0 * sum(of) / len(of):.1f} %" if of else "–"

    body = []

    def aim(words: str, of: list[bool], least: float) -> None:
        if not of:
            body.append([words, "–", "–"])
            return
        holds = sum(of) >= least * len(of)
        body.append([words, share(of), "holds" if holds else "**does not hold**"])

    def factors(what: str) -> list[float]:
        return [
            _ratio_to_best(mine, best)
            for case in judged
            for name, mine, best, _ in case["pairs"]
            if name == what
        ]

    over = [case["own"].get("faces", 10**9) / case["own"]["target"] for case in judged]
    aim("target met, or missed by less than 1.2 times: 95 %", [x < 1.2 for x in over], 0.95)
    body.append(["target met", share([x <= 1.0 for x in over]), "–"])
    for what, words in (
        ("area", "`area` error at most the best peer's (UV-carrying ones where there are UVs)"),
        ("area, shape only", "textured meshes without their UVs, beside geometry-only peers"),
    ):
        aim(f"{words}: 90 %", [x <= 1.0 for x in factors(what)], 0.90)
        aim("… at most 2 times: all", [x <= 2.0 for x in factors(what)], 1.0)
    measured = [case for case in judged if case["pairs"]]
    meshes = {case["own"]["mesh"] for case in measured}
    of = f"{len(measured)} of {len(meshes)} meshes"
    body.append(["judged cases in which a peer reached the target", of, "–"])
    aim("UV error at most the best peer's: 90 %", [x <= 1.0 for x in factors("UV")], 0.90)
    return table(["aim", "cases", "verdict"], body)


def _every_mesh_table(cases: list[Row]) -> str:
    """Return all cases, with errors and those of the best peer that reached the target."""
    body = []
    for case in cases:
        own = case["own"]
        cells = [f"{own['mesh']}, {100.0 * own['ratio']:g} %"]
        missed = " *" if own.get("faces", 0) > own["target"] else ""
        cells.append(f"{own.get('faces', own['status'])}{missed} / {own['target']}")
        cells.append(number(1e3 * own["cpu_s"]) if "cpu_s" in own else "–")
        for what, scale in (("area", 1e3), ("UV", 1e2), ("area, shape only", 1e3)):
            found = [pair for pair in case["pairs"] if pair[0] == what]
            cells.append(
                f"{number(scale * found[0][1])} / {number(scale * found[0][2])}" if found else "–"
            )
        body.append(cells)
    head = [
        "mesh, faces that stay", "faces / target", "ms", "`area`, 1e-3: ours / best peer's",
        "UV, 1e-2: ours / best peer's", "shape only, 1e-3: ours / best peer's",
    ]  # fmt: skip
    return table(head, body)


def _every_mesh_worse(cases: list[Row]) -> str:
    """Return the judged cases with a larger error than a peer, the worst first."""
    found = [
        (_ratio_to_best(mine, best), what, mine, best, peer, case["own"])
        for case in cases
        if case["judged"]
        for what, mine, best, peer in case["pairs"]
        if _ratio_to_best(mine, best) > 1.0
    ]
    found.sort(key=lambda entry: -entry[0])
    body = [
        [f"{own['mesh']}, {100.0 * own['ratio']:g} %", what, peer, number(mine), number(best),
         f"{factor:.2f}"]
        for factor, what, mine, best, peer, own in found
    ]  # fmt: skip
    return table(["worse than a peer", "error", "best peer", "ours", "its", "times"], body)


def write_every_depth(results: Row) -> None:
    """Write the section `every_depth`."""
    write_section("every_depth", every_depth(results))


def every_depth(results: Row) -> str:
    """Return the results at each share of the points, and the images with too large an error."""
    rows = results["rows"]
    images = len({row["input"] for row in rows})
    parts = [environment_line(results["environment"]), f"{images} images and scans.\n"]
    head = ("", "points", "error at most the peer's", "most", "coverage, least", "5 %", "median",
            "bridges, most", "time over the peer's, most", "ms of 640x480, most")  # fmt: skip
    groups: dict[tuple[str, float], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["how"], row["share"]), []).append(row)
    parts.append(table(head, (_depth_line(*key, of) for key, of in groups.items())))
    parts.append(table(
        ("image", "points", "effort", "error ratio", "coverage", "bridges", "stop"),
        ((row["input"], f"{row['points']} ({_percent(row['share'])})", row["how"],
          number(_error_ratio(row)), f"{row['coverage']:.3f}", _percent(row["bridges"]),
          row["stop"]) for row in rows if _is_far(row)),
    ))  # fmt: skip
    return "\n".join(parts)


def write_every_coverage(rows: Sequence[Row]) -> None:
    """Write the section `every_coverage`."""
    write_section("every_coverage", every_coverage(rows))


def every_coverage(rows: Sequence[Row]) -> str:
    """Return the numbers of images that reach the aimed coverage, and the least covered image."""
    head = ("", "points", "images", "empty", "coverage 0.99 and more", "0.95 and more", "least",
            "of", "bridges 0.1 % and less", "median", "most", "of")  # fmt: skip
    groups: dict[tuple[str, float], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["how"], row["share"]), []).append(row)

    def line(how: str, share: float, of: list[Row]) -> tuple[str, ...]:
        least = min(of, key=lambda row: row["coverage"])
        most = max(of, key=lambda row: row["bridges"])

        def count(is_so: Callable[[Row], bool]) -> str:
            return str(sum(map(is_so, of)))

        return (
            how, _percent(share), str(len(of)), count(lambda row: row["faces"] == 0),
            count(lambda row: row["coverage"] >= 0.99), count(lambda row: row["coverage"] >= 0.95),
            f"{least['coverage']:.3f}", least["input"], count(lambda row: row["bridges"] <= 1e-3),
            _percent(statistics.median(row["bridges"] for row in of)), _percent(most["bridges"]),
            most["input"],
        )  # fmt: skip

    return table(head, (line(*key, of) for key, of in groups.items()))


def write_missing_pixels(results: Row) -> None:
    """Write the section `missing_pixels`."""
    write_section("missing_pixels", missing_pixels(results))


def missing_pixels(results: Row) -> str:
    """Return each scene at each share of missing pixels, also relative to no missing pixels."""
    head = ("scene", "missing", "effort", "points", "pixels filled", "ms", "over none missing",
            "error, 1e-3", "over none missing", "coverage", "of the measured",
            "bridges")  # fmt: skip
    lines = []
    for name, rows in results["missing"].items():
        complete = {row["effort"]: row for row in rows if row["missing"] == 0}
        for row in rows:
            of = complete[row["effort"]]
            lines.append((
                name, _percent(row["missing"]), row["effort"], f"{row['points']:,}",
                f"{row['filled_pixels']:,}", number(1e3 * row["cpu_s"]),
                number(row["cpu_s"] / of["cpu_s"]), number(1e3 * row["mean"]),
                number(row["mean"] / of["mean"]), f"{row['coverage']:.3f}",
                f"{row['reported']:.3f}", _percent(row["bridges"]),
            ))  # fmt: skip
    return environment_line(results["environment"]) + "\n" + table(head, lines)


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"


def _error_ratio(row: Row) -> float | None:
    """Return our error divided by the peer's; above 1 ours is worse.

    None: the peer's result is empty, or larger than the target.
    """
    peer = row["peer"]
    if peer.get("mean") is None or peer["vertices"] > 1.01 * max(row["points"], row["vertices"]):
        return None
    return float(row["mean"] / peer["mean"]) if row.get("mean") is not None else math.inf


def _is_far(row: Row) -> bool:
    """Return whether the error exceeds the aim for a single image."""
    ratio = _error_ratio(row)
    return ratio is not None and ratio > (1.3 if row["how"] == "live" else 1.5)


def _depth_line(how: str, share: float, rows: list[Row]) -> tuple[str, ...]:
    ratios = [ratio for ratio in map(_error_ratio, rows) if ratio is not None]
    coverage = sorted(row["coverage"] for row in rows)
    frames = [1e3 * row["cpu_s"] for row in rows if row["pixels"] == 640 * 480]
    return (
        how,
        _percent(share),
        f"{sum(ratio <= 1 for ratio in ratios)} of {len(ratios)}",
        number(max(ratios, default=None)),
        f"{coverage[0]:.3f}",
        f"{coverage[len(coverage) // 20]:.3f}",
        f"{statistics.median(coverage):.3f}",
        _percent(max(row["bridges"] for row in rows)),
        number(max(row["cpu_s"] / row["peer"]["cpu_s"] for row in rows)),
        number(max(frames, default=None)),
    )
