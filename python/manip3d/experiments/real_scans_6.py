"""Detectors I and II on single real terrestrial scans; there are no published numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

import manip3d
from manip3d import authenticate, datasets, forge
from manip3d.experiments import _forensics, _recorded
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

_FOLDER = "lidar/tls"
_DATA_SETS = ("tls_forest", "tls_pump_room", "tls_rooms", "tls_3dtk")
_SCANS = (
    "riegl_vz400i_forest.ply.xz",
    "pump_room_e57.ply.xz",
    "room_scan1.ply.xz",
    "room_scan2.ply.xz",
    "3dtk_dat/scan000.3d.xz",
    "3dtk_dat/scan001.3d.xz",
    "3dtk_dat/scan002.3d.xz",
)
_SIZE = 0.3
"""Size of the hoax, metres."""


def _cases(plan: Plan) -> list[Case]:
    if plan.data == "simulated":
        return []
    hoax = _forensics.HOAXES[0]
    real = datasets.is_here(datasets.get(hoax))
    return [
        Case(
            judge_scan,
            {
                "model": name,
                "files": _recorded.sums([f"{_FOLDER}/{name}"]),
                "hoax": hoax if real else "ball",
                "data": "recorded",
                "role": f"recorded, hoax {hoax if real else 'ball'}",
            },
            inputs=(hoax,) if real else (),
        )
        for name in _SCANS
        if _recorded.are_here([f"{_FOLDER}/{name}"])
    ]


def judge_scan(case: Case) -> Row:
    """Judge a scan, clean and with a hoax.

    The hoax stands in the direction of the point with the median range, among points near the
    horizon, at 60 % of this range.
    """
    (file,) = case.options["files"]
    frame = manip3d.io.read_scan(_recorded.located(file))
    place = np.zeros(3) if frame.origin is None else np.asarray(frame.origin)
    points = (frame.points - place).astype(np.float32)
    vertices, _ = _forensics.open_hoax(case.options["hoax"])
    scale = _SIZE / float(np.ptp(vertices, axis=0).max())
    ranges = np.linalg.norm(points.astype(np.float64), axis=1)
    level = np.flatnonzero(np.abs(points[:, 2]) < 0.2 * ranges)
    seen = level[np.argsort(ranges[level], kind="stable")[len(level) // 2]]
    position = points[seen].astype(np.float64) * 0.6
    row: Row = {"points": len(points), "hoax_range": float(np.linalg.norm(position))}
    clean = frame.replace(points=points, origin=(0.0, 0.0, 0.0), exact=None)
    row |= _verdicts(clean, "")
    grid = authenticate.occlusion_consistency(clean).grid
    row |= {"cell_azimuth": grid.azimuth_deg, "cell_elevation": grid.elevation_deg}
    spacing = _spacing(position, grid)
    forged = {
        "_ctp": forge.ctp(clean, vertices, position=position, scale=scale),
        "_crtp": forge.crtp(clean, vertices, position=position, scale=scale, spacing=spacing),
    }
    for suffix, forgery in forged.items():
        row |= _verdicts(forgery.frame, suffix)
    return row


def _spacing(position: Any, grid: authenticate.AngularGrid) -> float:
    """Return the point spacing of the scanner's angular grid at the distance of the hoax."""
    step = np.radians(min(grid.azimuth_deg, grid.elevation_deg))
    return float(np.linalg.norm(position) * step)


def _verdicts(scan: manip3d.LidarFrame, suffix: str) -> Row:
    density = authenticate.density_consistency(scan)
    occlusion = authenticate.occlusion_consistency(scan)
    return {
        f"I{suffix}": density.verdict,
        f"II{suffix}": occlusion.verdict,
        f"II{suffix}_score": occlusion.score,
    }


def _reported(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        numbers = ", ".join(
            f"{name}: I {row[f'I{suffix}']}, II {row[f'II{suffix}']}"
            for name, suffix in (("as it is", ""), ("CTP", "_ctp"), ("CRTP", "_crtp"))
        )
        yield Finding(row["model"], None, numbers)


EXPERIMENT = Experiment(
    id="real-scans-6",
    title="Detectors I and II on real terrestrial scans",
    published="",
    data=(*_DATA_SETS, *_forensics.HOAXES[:1]),
    cases=_cases,
    columns=(
        Column("points", "points"),
        Column("cell_azimuth", "cell, azimuth, degrees", digits=4),
        Column("cell_elevation", "elevation, degrees", digits=4),
        Column("I", "I"),
        Column("II", "II"),
        Column("hoax_range", "hoax at, m", digits=1),
        Column("I_ctp", "I, CTP"),
        Column("II_ctp", "II, CTP"),
        Column("I_crtp", "I, CRTP"),
        Column("II_crtp", "II, CRTP"),
    ),
    claims=(Claim("Scan by scan", "aim", _reported, reported=True),),
    notes=(
        "Scanners of other kinds than the calibration's: a tilted one (3DTK), one that sees most "
        "directions twice (rooms), one without a grid of elevations (forest). A scan called "
        "tampered as it is, is a false alarm. "
        "Thresholds come from other scenes, but these scans had been looked at before the area "
        "threshold was fixed, and the estimator of the angular grid was mended after it had failed "
        "on them.",
    ),
)
