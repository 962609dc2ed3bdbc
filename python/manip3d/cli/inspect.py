"""``manip3d inspect``: has this scan been edited?"""

from __future__ import annotations

import base64
import html
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from manip3d.cli.options import Force, Jobs, Json, OptionalOutput, Quiet
from manip3d.cli.terminal import Terminal, count, finite, refuse_existing, table
from manip3d.errors import InputError
from manip3d.io._files import atomic_write
from manip3d.lidar import Box, LidarFrame

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from manip3d.authenticate import DensityResult, GenericResult, OcclusionResult

EXIT_CODES = {"authentic": 0, "tampered": 3, "undecidable": 4}

NAMES = {
    "density": "I: spacing follows range",
    "occlusion": "II: nothing behind anything",
    "generic": "III: the sensor's lattice",
}


def judge(
    source: str,
    output: Path | None,
    terminal: Terminal,
    *,
    origin: Sequence[float] | None,
    printed: bool,
    threads: int,
) -> dict[str, Any]:
    """Judge a scan by all detectors; with ``output``, write the evidence.

    Raises
    ------
    InputError
        ``output`` is neither .html nor .json.
    FormatError, OSError
        As `manip3d.read_scan`.
    """
    import manip3d
    from manip3d import authenticate

    if output is not None and output.suffix.lower() not in (".html", ".json"):
        raise InputError(f"{output}: expected a name that ends in .html or .json")
    frame = manip3d.read_scan(source)
    terminal.say(f"read {source}: {count(frame.num_points)} points")
    place, why = _scanner(frame, origin, threads)
    record: dict[str, Any] = {"source": source, "points": frame.num_points, "origin": place}
    pictures: dict[str, str] = {}
    suspected: dict[str, Any] = {}
    if place is None:
        record |= {"verdict": "undecidable", "detectors": {name: _silent(why) for name in NAMES}}
    else:
        record["origin_from"] = why
        density = authenticate.density_consistency(
            frame,
            parameters=authenticate.PAPER_DENSITY if printed else None,
            origin=place,
            threads=threads,
        )
        occlusion = authenticate.occlusion_consistency(
            frame,
            parameters=authenticate.PAPER_OCCLUSION if printed else None,
            origin=place,
            threads=threads,
        )
        lattice = (
            authenticate.generic_consistency(_at_origin(frame, place), threads=threads)
            if occlusion.grid.elevation_strength == 0.0
            else None
        )
        generic = (
            _silent("no scan of a spinning scanner")
            if lattice is None
            else _generic(lattice, place)
        )
        record["verdict"] = combined(density.verdict, occlusion.verdict, str(generic["verdict"]))
        record["detectors"] = {
            "density": _density(density),
            "occlusion": _occlusion(occlusion),
            "generic": generic,
        }
        if output is not None:
            pictures = _pictures(density, occlusion)
        suspected = {"density": density.suspected, "occlusion": occlusion.suspected}
        suspected["generic"] = () if lattice is None else lattice.suspected
    if output is not None:
        scene = _scene(frame, record, suspected) if output.suffix.lower() == ".html" else ""
        _write(record, output, pictures, scene)
        terminal.say(f"wrote {output}")
    return record


def _scanner(
    frame: LidarFrame, origin: Sequence[float] | None, threads: int
) -> tuple[list[float] | None, str]:
    """Where the scanner stood and who says so; or None and why nobody can judge the scan."""
    from manip3d import authenticate

    stated = origin if origin is not None else frame.origin
    if stated is None:
        found = authenticate.estimate_origin(frame, threads=threads)
        return (None if found.position is None else list(found.position)), found.reason
    grid = authenticate.estimate_grid(frame, origin=stated, threads=threads)
    if grid.elevation_strength > 0.0:  # there is a grid: does it hold for the whole scan?
        known = authenticate.estimate_origin(frame, known=stated, threads=threads)
        if known.position is None:
            return None, "several positions fused, or the scanner stood elsewhere"
    return list(stated), "the command line" if origin is not None else "the file"


def _place(record: dict[str, Any]) -> str:
    if record["origin"] is None:
        return "the scanner's position is not known"
    x, y, z = record["origin"]
    return f"scanner at ({x:.3f}, {y:.3f}, {z:.3f}) m, as {record['origin_from']} says"


def _silent(reason: str) -> dict[str, Any]:
    """Of a detector that cannot say anything."""
    return {"verdict": "undecidable", "reason": reason, "suspected_points": 0, "boxes": []}


def combined(density: str, occlusion: str, generic: str) -> str:
    """One verdict: none where no single position explains the scan; tampered if one says so."""
    verdicts = (density, occlusion, generic)
    if occlusion == "undecidable":
        return generic if generic == "tampered" else "undecidable"
    return "tampered" if "tampered" in verdicts else "authentic"


def show(console: Console, record: dict[str, Any]) -> None:
    """Verdicts, reasons and boxes."""
    rows = [
        (NAMES[name], found["verdict"], found["reason"])
        for name, found in record["detectors"].items()
    ]
    console.print(record["verdict"])
    console.print(_place(record))
    console.print()
    table(console, rows)
    boxes = [(name, box) for name, found in record["detectors"].items() for box in found["boxes"]]
    if boxes:
        console.print()
        cells = [
            (name, *(f"{value:.2f}" for value in (*box["center"], *box["size"])))
            for name, box in boxes
        ]
        table(console, cells, ("box, metres", "x", "y", "z", "length", "width", "height"))


def _at_origin(frame: LidarFrame, place: Sequence[float]) -> LidarFrame:
    """The frame with the scanner in (0, 0, 0), as detector III takes it."""
    import numpy as np

    if not any(place):
        return frame
    return LidarFrame((frame.points - np.asarray(place)).astype(np.float32), frame.intensity)


def _boxes(boxes: Sequence[Box]) -> list[dict[str, Any]]:
    return [{"center": list(box.center), "size": list(box.size), "yaw": box.yaw} for box in boxes]


def _density(found: DensityResult) -> dict[str, Any]:
    return {
        "verdict": found.verdict,
        "reason": found.reason,
        "score": found.score,
        "offending_ranges": found.offending.tolist(),
        "suspected_points": len(found.suspected),
        "boxes": _boxes(found.boxes),
        "calibration": _calibration(found.calibration),
    }


def _occlusion(found: OcclusionResult) -> dict[str, Any]:
    return {
        "verdict": found.verdict,
        "reason": found.reason,
        "score": found.score,
        "cell_degrees": [found.grid.azimuth_deg, found.grid.elevation_deg],
        "suspected_points": len(found.suspected),
        "boxes": _boxes(found.boxes),
        "calibration": _calibration(found.calibration),
    }


def _generic(found: GenericResult, place: Sequence[float]) -> dict[str, Any]:
    reason = {
        "authentic": "points lie where the sensor can measure",
        "tampered": "points lie where the sensor cannot measure",
        "undecidable": "no lattice of a spinning scanner in this scan",
    }[found.verdict]
    return {
        "verdict": found.verdict,
        "reason": reason,
        "score": found.score,
        "p_value": found.p_value,
        "false_alarm_rate": found.false_alarm_rate,
        "suspected_points": len(found.suspected),
        "boxes": _boxes([_box(region.lower, region.upper, place) for region in found.regions]),
    }


def _box(lower: Sequence[float], upper: Sequence[float], place: Sequence[float]) -> Box:
    """The box between two corners, which are seen from the scanner, in the scan's own frame."""
    (a, b, c), (d, e, f) = lower, upper
    x, y, z = place
    return Box((x + (a + d) / 2, y + (b + e) / 2, z + (c + f) / 2), (d - a, e - b, f - c))


def _calibration(calibration: Any) -> dict[str, Any] | None:
    return None if calibration is None else vars(calibration)


def _write(record: dict[str, Any], output: Path, pictures: dict[str, str], scene: str) -> None:
    if output.suffix.lower() == ".json":
        text = json.dumps(finite(record), indent=1) + "\n"
    else:
        text = _page(record, pictures, scene)
    atomic_write(output, text.encode())


_DETECTORS = {"density": "detector I", "occlusion": "detector II", "generic": "detector III"}


def _scene(frame: LidarFrame, record: dict[str, Any], suspected: dict[str, Any]) -> str:
    """The scan as points, suspected ones and boxes coloured by detector, as part of a page."""
    from manip3d import viewer

    seen = frame if record["origin"] is None else frame.replace(origin=tuple(record["origin"]))
    cloud = viewer.evidence(
        seen,
        verdict=record["verdict"],
        suspected={_DETECTORS[name]: rows for name, rows in suspected.items()},
        boxes={
            _DETECTORS[name]: [
                Box(tuple(b["center"]), tuple(b["size"]), b["yaw"]) for b in found["boxes"]
            ]
            for name, found in record["detectors"].items()
        },
    )
    return viewer.figure(cloud, "The scan, with suspected points and boxes by detector")


def _pictures(density: DensityResult, occlusion: OcclusionResult) -> dict[str, str]:
    """Evidence as PNG data, by caption; none without matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return {}
    pictures = {}
    if len(density.ranges):
        figure = Figure(figsize=(8, 3), layout="constrained")
        axes = figure.add_subplot()
        axes.plot(density.ranges, 1e3 * density.signal, label="spacing", color="#0072B2")
        axes.plot(density.ranges, 1e3 * density.fit, label="usual at this range", color="#999999")
        for low, high in density.offending:
            axes.axvspan(low, high, color="#D55E00", alpha=0.3)
        axes.set(xlabel="range, m", ylabel="nearest neighbour, mm")
        axes.legend()
        pictures["Spacing over range; marked: levels that are off"] = _png(figure)
    if occlusion.mask.size:
        figure = Figure(figsize=(8, 3), layout="constrained")
        axes = figure.add_subplot()
        top = occlusion.lowest_deg + occlusion.mask.shape[0] * occlusion.grid.elevation_deg
        axes.imshow(
            _shrunk(occlusion.mask),
            origin="lower",
            aspect="auto",
            cmap="gray_r",
            extent=(-180.0, 180.0, occlusion.lowest_deg, top),
        )
        axes.set(xlabel="azimuth, degrees", ylabel="elevation, degrees")
        pictures["Directions in which something is seen behind something else"] = _png(figure)
    return pictures


def _shrunk(mask: Any) -> Any:
    """At most 1600 columns and 600 rows; a marked cell stays visible."""
    import numpy as np

    down, across = (
        max(1, -(-size // most)) for size, most in zip(mask.shape, (600, 1600), strict=True)
    )
    rows, columns = (
        size // step * step for size, step in zip(mask.shape, (down, across), strict=True)
    )
    blocks = mask[:rows, :columns].reshape(rows // down, down, columns // across, across)
    return np.asarray(blocks.max(axis=(1, 3)))


def _png(figure: Figure) -> str:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    return base64.b64encode(stream.getvalue()).decode()


_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}"
    "table{border-collapse:collapse}td,th{padding:.2rem .8rem;text-align:left;"
    "border-bottom:1px solid #ccc}img{max-width:100%}.wide{overflow-x:auto}"
    "@media(max-width:40rem){body{margin:1rem auto}td,th{padding:.2rem .4rem}}"
    ".tampered{color:#b00020}.authentic{color:#1b5e20}.undecidable{color:#7a5c00}"
)


def _page(record: dict[str, Any], pictures: dict[str, str], scene: str) -> str:
    """One page that loads nothing."""
    escape = html.escape
    rows = "".join(
        f"<tr><td>{escape(NAMES[name])}</td><td class={found['verdict']}>{found['verdict']}</td>"
        f"<td>{escape(found['reason'])}</td><td>{found['suspected_points']}</td></tr>"
        for name, found in record["detectors"].items()
    )
    boxes = "".join(
        f"<tr><td>{_DETECTORS[name]}</td>"
        + "".join(f"<td>{value:.2f}</td>" for value in (*box["center"], *box["size"]))
        + "</tr>"
        for name, found in record["detectors"].items()
        for box in found["boxes"]
    )
    images = "".join(
        f'<h2>{escape(caption)}</h2><img alt="{escape(caption)}" '
        f'src="data:image/png;base64,{data}">'
        for caption, data in pictures.items()
    )
    calibrations = "".join(
        f"<li>{escape(NAMES[name])}: {escape(found['calibration']['scenes'])}; "
        f"{found['calibration']['false_alarms']} of {found['calibration']['num_scans']} "
        f"clean scans alarmed. {escape(found['calibration']['note'])}</li>"
        for name, found in record["detectors"].items()
        if found.get("calibration")
    )
    verdict = record["verdict"]
    return (
        "<!doctype html><html lang=en><meta charset=utf-8>"
        "<meta name=viewport content='width=device-width, initial-scale=1'>"
        f"<title>{escape(record['source'])}: {verdict}</title><style>{_STYLE}</style>"
        f"<h1 class={verdict}>{verdict}</h1>"
        f"<p>{escape(record['source'])}, {record['points']} points; {_place(record)}</p>"
        "<div class=wide><table><tr><th>detector<th>verdict<th>why<th>suspected points</tr>"
        f"{rows}</table></div>{scene}"
        + (
            "<h2>Boxes, metres</h2><div class=wide><table>"
            "<tr><th>detector<th>x<th>y<th>z<th>length<th>width"
            f"<th>height</tr>{boxes}</table></div>"
            if boxes
            else ""
        )
        + images
        + (
            f"<h2>Where the thresholds come from</h2><ul>{calibrations}</ul>"
            if calibrations
            else ""
        )
        + "</html>\n"
    )


def inspect(
    source: Annotated[str, typer.Argument(metavar="SCAN", help="A scan file.")],
    output: OptionalOutput = None,
    origin: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="X Y Z", help="Where the scanner stood; else as the file says, or its grid."
        ),
    ] = None,
    printed: Annotated[
        bool, typer.Option("--printed", help="Thresholds as printed, not the calibrated ones.")
    ] = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
) -> None:
    """Say whether a scan was edited: exit code 0 authentic, 3 tampered, 4 undecidable.

    With -o, the evidence: a page (.html) with pictures and boxes, or .json.
    """
    refuse_existing(output, force=force)
    shell = Terminal(as_json=as_json, quiet=quiet)
    record = judge(source, output, shell, origin=origin, printed=printed, threads=jobs)
    shell.result(record, lambda console: show(console, record))
    raise typer.Exit(EXIT_CODES[record["verdict"]])
