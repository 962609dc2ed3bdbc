"""False alarms of `inspect` on clean simulated scans, each judged by all detectors together.

``python benchmarks/bench_alarms.py scans.jsonl`` judges the clean scans of the section `alarms` of
the results:

- frames of drives of an HDL-64E, each with the previous and the next turn (detectors III, IV and V)
  and each alone (III and V), on streets where the car drives nearly straight and, with
  ``--turning``, on others where it weaves;
- terrestrial scans of 0.2 degrees (I and II);
- an HDL-32E, for which no detector is calibrated;
- three scanners by Hesai and Ouster, whose drivers keep lattices exact (III, by the lattice of each
  scan).

``--sequence`` judges drives of 100 frames like `inspect_drive` and counts the alarms of
`drive_evidence`, for the section `sequence`; the car weaves on every second street. ``--calibrate``
prints instead the strongest clean evidence of detectors IV and V, from which their thresholds are
chosen, on streets that are in no report.

The result of each scan is a line of the named file. Scans in the file are not judged again, so that
a stopped run continues. ``--minutes`` stops the run after this time; the table then contains the
scans judged so far. ``--first`` sets the number of the first street, to judge scans that are in no
earlier report and not in the calibration. Streets of calibrations and of reports have different
numbers.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from measuring import one_thread

if TYPE_CHECKING:
    from manip3d.authenticate import Inspection
    from manip3d.lidar import LidarFrame
    from manip3d.simulate.streets import Street

Line = dict[str, Any]
Doubles = NDArray[np.float64]

JUDGED = 10
"""Number of judged frames of a drive, all of which have both neighbours."""

LONG = 100
"""Number of frames of a long drive, whose evidence is added up."""

CALIBRATION_STREETS, REPORTED_STREETS = 70_000, 90_000
"""Number of the first street of calibrations and of reports."""

BEAMS_PER_DEGREE = 5
"""Number of azimuths per degree at which a simulated HDL-32E fires."""


MIN_SWAY, MAX_SWAY = 0.15, 1.5
"""Smallest and largest amplitude of a weaving car's path, metres, with a wavelength of 60 m. At
10 m/s the largest amplitude turns the car by 0.9 degrees between two turns of the scanner. For
comparison, KITTI's drive 0005 has 0.7 degrees, `simulate.street` a median of 0.02 and a maximum of
0.11 degrees."""


def drive_scans(number: int) -> Iterator[Line]:
    """Yield a line for each frame of an HDL-64E's drive, with its neighbours and alone."""
    from manip3d import simulate

    yield from scans_on(simulate.street(number), number)


def turning_scans(number: int) -> Iterator[Line]:
    """Yield a line for each frame of a street on which the car weaves."""
    yield from scans_on(weaving_street(number), number)


def weaving_street(number: int) -> Street:
    """Return a street on which the car weaves."""
    from manip3d import simulate

    sway = float(np.random.default_rng(number + 7).uniform(MIN_SWAY, MAX_SWAY))
    return replace(simulate.street(number), sway=sway)


def long_scans(number: int) -> Iterator[Line]:
    """Yield a line for each frame of an HDL-64E's long drive, with its neighbours."""
    from manip3d import simulate
    from manip3d.authenticate import inspect_drive

    street = weaving_street(number) if number % 2 else simulate.street(number)
    latest = min(15.0, street.duration - 0.1 * (LONG + 1))
    start = float(np.random.default_rng(number).uniform(0.5, latest))
    drive = simulate.drive(street, LONG, start=start, pictures=False, rng=number, threads=1)
    scans = (frame.scan.frame for frame in drive)
    for k, found in enumerate(inspect_drive(scans, power=False, threads=1)):
        assert found is not None  # no frame is missing
        yield {"frame": k, "beside": line_of(found)}


def scans_on(street: Street, number: int) -> Iterator[Line]:
    """Yield a line for each frame of an HDL-64E's drive on a street, with neighbours and alone."""
    from manip3d import simulate

    start = float(np.random.default_rng(number).uniform(0.5, 15.0))
    drive = simulate.drive(street, JUDGED + 2, start=start, pictures=False, rng=number)
    frames = [frame.scan.frame for frame in drive]
    for k in range(1, JUDGED + 1):
        beside = judged(frames[k], previous=frames[k - 1], following=frames[k + 1])
        yield {"frame": k, "beside": beside, "alone": judged(frames[k])}


def terrestrial_scans(number: int) -> Iterator[Line]:
    """Yield a line for a terrestrial scan; the kinds of indoor and outdoor scenes take turns."""
    from manip3d.simulate import scenes
    from manip3d.simulate.terrestrial import terrestrial_scan

    kinds = sorted({kind for kind, _ in scenes.SCENES.values()})
    kind = kinds[number % len(kinds)]
    inside = kind in {name for name, _ in scenes.INDOOR.values()}
    scene = (scenes.indoor if inside else scenes.outdoor)(kind, rng=number)
    scan = terrestrial_scan(scene, resolution_deg=0.2, rng=number).frame
    yield {"frame": 0, "kind": kind, "alone": judged(scan)}


def hdl32e_scans(number: int) -> Iterator[Line]:
    """Yield a line for a frame of an HDL-32E on a street's car, which does not move in a turn."""
    from manip3d import LidarFrame
    from manip3d.authenticate._sensors import BEAMS

    random = np.random.default_rng(number)
    azimuth = np.radians(np.arange(360 * BEAMS_PER_DEGREE) / BEAMS_PER_DEGREE)
    angle, height = (each.ravel() for each in np.meshgrid(azimuth, np.radians(BEAMS["HDL-32E"])))
    level = np.cos(height)
    beams = np.column_stack([level * np.cos(angle), level * np.sin(angle), np.sin(height)])
    ranges = ranges_on_street(number, np.zeros_like(beams), beams)
    seen = ranges < 70.0
    ranges = ranges[seen] + random.normal(0.0, 0.02, int(np.count_nonzero(seen)))
    points = np.ascontiguousarray(beams[seen] * ranges[:, None], np.float32)
    yield {"frame": 0, "alone": judged(LidarFrame(points, origin=(0.0, 0.0, 0.0)))}


def ranges_on_street(number: int, start: Doubles, beams: Doubles) -> Doubles:
    """Return ranges along beams of a scanner on the car, which does not move in a turn; metres.

    Infinite: no return.
    """
    from manip3d import simulate

    street = simulate.street(number)
    position, yaw = street.pose([1.0])
    cos, sin = np.cos(yaw[0]), np.sin(yaw[0])
    to_world = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    aim, origins = beams @ to_world.T, start @ to_world.T + position[0]
    at = np.full(len(aim), 1.0, np.float32)
    hits = street.stage.cast(origins.astype(np.float32), aim.astype(np.float32), at)
    return np.asarray(hits.distance, np.float64)


def exact_scans(number: int) -> Iterator[Line]:
    """Yield a line for a frame of a Hesai Pandar40P, a PandarXT-32 or an Ouster OS1-32.

    Its points are computed as by the scanner's driver.
    """
    yield {"frame": 0, "alone": judged(exact_scan(number))}


def exact_scan(number: int) -> LidarFrame:
    """Return the frame of `exact_scans`, in single precision with whole azimuth and range steps.

    Hesai: points firing by firing, beams through the axis, steps of 0.01 degrees and 4 mm; in half
    of the frames some firings have a second return. Ouster: points ring by ring, clockwise; beams
    start 15.8 mm off the axis and 36 mm above the origin; 1024 columns, steps of 1 mm; half of the
    frames have no ``ring``.
    """
    from manip3d import LidarFrame
    from manip3d.authenticate._sensors import BEAMS

    random = np.random.default_rng(number)
    model = ("Hesai Pandar40P", "Hesai PandarXT-32", "OS1-32")[number % 3]
    is_ouster = model == "OS1-32"
    heights = np.radians(np.linspace(21.5, -21.5, 32) if is_ouster else BEAMS[model])
    heights = heights + np.radians(random.normal(0.0, 0.05, len(heights)))  # spread of units
    columns = 1024 if is_ouster else 1800
    turn = np.radians(np.arange(columns) * 360.0 / columns)
    beside = np.resize([3.1, 1.0, -1.0, -3.1] if is_ouster else [-3.3, 0.0, 3.3, 1.0], len(heights))
    beside = np.radians(np.round(beside + random.normal(0.0, 0.03, len(heights)), 3))
    shape = (len(heights), columns)
    ring, column = (np.indices(shape) if is_ouster else np.indices(shape[::-1])[::-1]).reshape(
        2, -1
    )
    encoder = -turn[column].astype(np.float32)
    angle = encoder + beside[ring].astype(np.float32)
    level, rise = np.cos(heights).astype(np.float32), np.sin(heights).astype(np.float32)
    beams = np.column_stack([level[ring] * np.cos(angle), level[ring] * np.sin(angle), rise[ring]])
    start = np.zeros_like(beams)
    if is_ouster:
        start = np.column_stack([0.015806 * np.cos(encoder), 0.015806 * np.sin(encoder)])
        start = np.column_stack([start, np.full(len(start), 0.036195)]).astype(np.float32)
    step = 0.001 if is_ouster else 0.004
    ranges = ranges_on_street(number, start.astype(np.float64), beams.astype(np.float64))
    ranges += random.normal(0.0, 0.015, len(ranges))
    seen = (ranges < 90.0) & (ranges > 0.3) & (random.random(len(ranges)) > 0.02)
    rows = np.flatnonzero(seen)
    counts = np.rint(ranges[rows] / step)
    if not is_ouster and number % 2:  # add second returns behind the first ones
        again = random.random(len(rows)) < 0.08
        rows, counts = np.r_[rows, rows[again]], np.r_[counts, counts[again] + 250]
    whole = counts.astype(np.float32) * np.float32(step)
    points = (start[rows] + beams[rows] * whole[:, None]).astype(np.float32)
    labels = ring[rows].astype(np.uint16) if is_ouster and number % 2 else None
    return LidarFrame(np.ascontiguousarray(points), ring=labels, origin=(0.0, 0.0, 0.0))


SCANNERS: dict[str, Callable[[int], Iterator[Line]]] = {
    "HDL-64E": drive_scans,
    "HDL-64E, turning": turning_scans,
    "terrestrial": terrestrial_scans,
    "HDL-32E": hdl32e_scans,
    "exact": exact_scans,
    "HDL-64E, sequence": long_scans,
}


def judged(
    frame: LidarFrame, previous: LidarFrame | None = None, following: LidarFrame | None = None
) -> Line:
    """Inspect a scan; return the result as numbers from which other thresholds can be evaluated."""
    from manip3d.authenticate import inspect

    return line_of(inspect(frame, previous=previous, following=following, power=False, threads=1))


def line_of(found: Inspection) -> Line:
    """Return a scan's result as numbers from which other thresholds can be evaluated."""
    return {
        "verdict": found.verdict,
        "reason": found.reason if found.verdict != "no_trace" else "",
        "sensor": "" if found.sensor is None else found.sensor.name,
        "accusing": [r.name for r in found.detectors if r.verdict == "tampered"],
        "p_value": {r.name: r.p_value for r in found.detectors if r.p_value is not None},
        "strength": {r.name: r.score for r in found.detectors if r.score is not None},
    }


def run(file: Path, scanner: str, numbers: range, until: float = math.inf) -> list[Line]:
    """Return the lines of a scanner's scans; judge and append those that the file lacks.

    Parameters
    ----------
    until : float
        Time of the monotonic clock after which no scan is judged.
    """
    known = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    done = {(line["scanner"], line["number"]) for line in known}
    for number in numbers:
        if (scanner, number) in done or time.monotonic() > until:
            continue
        lines = [
            {"scanner": scanner, "number": number, **line} for line in SCANNERS[scanner](number)
        ]
        with file.open("a") as out:
            out.write("".join(json.dumps(line) + "\n" for line in lines))
        known += lines
        print(f"{scanner} {number}: {len(lines)} scans", file=sys.stderr, flush=True)
    return [line for line in known if line["scanner"] == scanner and line["number"] in numbers]


def interval(events: int, trials: int) -> tuple[float, float]:
    """Return the 95 % confidence interval of a rate [Clopper and Pearson, 1934]."""
    from manip3d._util.shares import clopper_pearson

    return clopper_pearson(events, trials)


def p_values(line: Line) -> dict[str, float]:
    """Return the p-value of each detector for one scan, at the thresholds of this package."""
    from manip3d.authenticate import _reflectance, _turns

    strength, found = line["strength"], dict(line["p_value"])
    if "turns" in found:
        found["turns"] = _turns.turn_p_value(strength["turns"])
    if "reflectance" in found:
        found["reflectance"] = _reflectance.reflectance_p_value(strength["reflectance"])
    return found


def accused_by(line: Line) -> list[str]:
    """Return the detectors that accuse a scan at the thresholds of this package."""
    from manip3d.authenticate._verdict import rate_of

    spinning = [name for name, p in p_values(line).items() if p <= rate_of(name)]
    return spinning + [name for name in line["accusing"] if name in ("density", "occlusion")]


def log10_ratio(line: Line) -> float:
    """Return log10 of a scan's likelihood ratio (`Inspection.likelihood_ratio`); 0: not judged."""
    from manip3d.authenticate import likelihood_ratio

    found = p_values(line)
    if line["verdict"] not in ("no_trace", "tampered") or not found:
        return 0.0
    return float(np.log10(likelihood_ratio(min(1.0, min(found.values()) * len(found)))))


def calibrate(lines: list[Line]) -> None:
    """Print the strongest clean evidence of detectors IV and V."""
    for name in ("turns", "reflectance"):
        found = [line["beside"]["strength"].get(name) for line in lines]
        strengths = sorted((value for value in found if value is not None), reverse=True)
        print(f"{name}: {len(strengths)} frames judged")
        print(", ".join(f"{value:.3f}" for value in strengths[:40]))


def drives_alarmed(lines: list[Line]) -> int:
    """Count the alarms of `drive_evidence` over the drives, at one false alarm per hour."""
    from manip3d.authenticate._sequence import FRAMES_PER_SECOND

    threshold = np.log10(3600.0 * FRAMES_PER_SECOND)
    alarms = 0
    for number in sorted({line["number"] for line in lines}):
        total = 0.0
        for line in lines:
            if line["number"] == number:
                total = max(total, 0.0) + log10_ratio(line["beside"])
                alarms += total >= threshold
                total = 0.0 if total >= threshold else total
    return alarms


def report_sequence(file: Path, streets: range, until: float) -> str:
    """Return the table of long drives: accused frames, and alarms of added evidence with bound."""
    import tables
    from manip3d._util.shares import upper_rate
    from manip3d.authenticate._sequence import FRAMES_PER_SECOND

    lines = run(file, "HDL-64E, sequence", streets, until)
    drives = len({line["number"] for line in lines})
    alarms = drives_alarmed(lines)
    bound = upper_rate(alarms, len(lines)) * 3600.0 * FRAMES_PER_SECOND
    return tables.table(HEAD, [row("HDL-64E, drives", [line["beside"] for line in lines])]) + (
        f"\n{alarms} alarms of `drive_evidence` at one an hour, in {len(lines)} frames of {drives} "
        f"drives: at most {bound:.1f} an hour (95 %).\n"
    )


def row(name: str, lines: list[Line]) -> list[str]:
    """Return a row of the table, with the verdicts of `inspect`."""
    accused = [accused_by(line) for line in lines]
    count = sum(bool(names) for names in accused)
    low, high = interval(count, len(lines))
    by = {names for each in accused for names in each}
    verdicts = [line["verdict"] for line in lines]
    return [
        name,
        f"{len(lines)}",
        f"{count}",
        f"{count / len(lines):.2%}",
        f"{low:.2%} to {high:.2%}",
        ", ".join(f"{each} {sum(each in names for names in accused)}" for each in sorted(by))
        or "–",
        f"{verdicts.count('processed')}",
        f"{verdicts.count('undecidable')}",
    ]


HEAD = ["clean simulated scans", "scans", "accused", "share", "95 % interval", "by", "processed",
        "undecidable"]  # fmt: skip


def report(file: Path, streets: range, turning: range, others: range, until: float) -> str:
    """Return the table of all scanners."""
    import tables

    # Judge the other scanners first, because they take a tenth of the time.
    terrestrial, other, exact = (
        run(file, name, others, until) for name in ("terrestrial", "HDL-32E", "exact")
    )
    weaving = run(file, "HDL-64E, turning", turning, until)
    drives = run(file, "HDL-64E", streets, until)
    beside, alone = ([line[key] for line in drives] for key in ("beside", "alone"))
    turned = [line["beside"] for line in weaving]
    judged_once = [line["alone"] for line in terrestrial + other + exact]
    kinds = {
        "HDL-64E, with the turns before and after (III, IV, V)": beside,
        "the same, where the car weaves": turned,
        "HDL-64E, alone (III, V)": alone,
        "terrestrial, 0.2 degrees (I, II)": [line["alone"] for line in terrestrial],
        "HDL-32E (no detector)": [line["alone"] for line in other],
        "Hesai, Ouster, exact (III)": [line["alone"] for line in exact],
        "all, once each": beside + turned + judged_once,
    }
    rows = [row(name, lines) for name, lines in kinds.items() if lines]
    text = tables.table(HEAD, rows)
    alarms = drives_alarmed(drives) + drives_alarmed(weaving)
    number = sum(len({line["number"] for line in lines}) for lines in (drives, weaving))
    return text + (
        f"\n{alarms} alarms of `drive_evidence` at one an hour, in {len(drives) + len(weaving)} "
        f"frames of {number} drives.\n"
    )


def main() -> None:
    """Judge missing scans, and write the table or print the strongest clean evidence."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="lines of what was judged, .jsonl")
    parser.add_argument("--calibrate", action="store_true")
    parser.add_argument("--streets", type=int, default=51)
    parser.add_argument("--turning", type=int, default=0, help="streets on which the car weaves")
    parser.add_argument("--sequence", type=int, default=0, help="long drives, and nothing else")
    parser.add_argument("--others", type=int, default=40, help="scans of each other scanner")
    parser.add_argument("--first", type=int, help="the first street")
    parser.add_argument("--minutes", type=float, default=math.inf, help="judge no longer than this")
    options = parser.parse_args()
    begin = CALIBRATION_STREETS if options.calibrate else REPORTED_STREETS
    end = REPORTED_STREETS if options.calibrate else 2 * REPORTED_STREETS
    first = begin if options.first is None else options.first
    if not begin <= first <= end - max(options.streets, options.turning, options.sequence):
        parser.error(f"--first: expected {begin} to {end - options.streets}, got {first}")
    until = time.monotonic() + 60.0 * options.minutes
    one_thread()
    import tables

    streets, turning, others = (
        range(first, first + n) for n in (options.streets, options.turning, options.others)
    )
    if options.calibrate:
        for scanner, numbers in (("HDL-64E", streets), ("HDL-64E, turning", turning)):
            print(scanner)
            calibrate(run(options.file, scanner, numbers, until))
    elif options.sequence:
        numbers = range(first, first + options.sequence)
        tables.write_section("sequence", report_sequence(options.file, numbers, until))
    else:
        tables.write_section("alarms", report(options.file, streets, turning, others, until))


if __name__ == "__main__":
    main()
