"""Verdicts on RGB-D streams, clean and forged, after filters of the whole depth image: `filters`.

``python benchmarks/bench_filters.py filtered.jsonl`` applies depth filters that are common behind a
camera to clean recordings and to streams with an inserted person, inspects the results and writes
the section `filters`. No clean stream may be accused, and a filter may not turn a forgery that was
found into `no_trace`. Each stream is judged twice: as `inspect_stream` does, and without the traces
of filters in the shape and duration of holes (`before`).

The limits of these traces were chosen on the first ten frames of the kitchen, TUM's desk, the first
half of the turning person and forged streams of subjects 1 to 4, with the filters in `CHOSEN_ON`.
Streams of two frames or single ones have no verdict: of these, the report on silhouettes counts.
Each result is a line of the named file; what it contains is not judged again.
"""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from measuring import one_thread

if TYPE_CHECKING:
    from manip3d.rgbd import RgbdFrame

Line = dict[str, Any]
Depth = NDArray[np.uint16]
Filter = Callable[[Sequence[Depth]], Sequence[NDArray[Any]]]
Choose = Callable[..., NDArray[Any]]


def each(change: Callable[[Depth], NDArray[Any]]) -> Filter:
    """Return the filter that changes each image by itself."""
    return lambda depths: [change(depth) for depth in depths]


def windows(depth: Depth, side: int) -> NDArray[np.float32]:
    """Return the square neighbourhoods of all pixels, with NaN for missing ones."""
    padded = np.pad(depth.astype(np.float32), side // 2)
    padded[padded == 0] = np.nan
    around = np.lib.stride_tricks.sliding_window_view(padded, (side, side))
    return around.reshape(*depth.shape, side * side)


def chosen(depth: Depth, side: int, choose: Choose, *, holes: bool) -> NDArray[Any]:
    """Replace pixels, or only missing ones, by a statistic of the measured ones around them."""
    rows, columns = np.nonzero((depth == 0) | (not holes))
    filtered = depth.copy()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # nothing is measured around some pixels
        values = choose(windows(depth, side)[rows, columns], axis=-1)
    filtered[rows, columns] = np.rint(np.nan_to_num(values))
    return filtered


def median(side: int) -> Filter:
    """Return the median filter that takes missing pixels for depth 0."""
    from scipy.ndimage import median_filter

    return each(lambda depth: np.asarray(median_filter(depth, size=side, mode="nearest")))


def nearest(pixels: float) -> Filter:
    """Return the filter that fills pixels near measured ones with the nearest depth."""
    from scipy.ndimage import distance_transform_edt

    def fill(depth: Depth) -> NDArray[Any]:
        away, place = distance_transform_edt(depth == 0, return_indices=True)
        return np.where(away <= pixels, depth[tuple(place)], 0)

    return each(fill)


def bilateral(depth: Depth) -> NDArray[Any]:
    """Average measured pixels of similar depth in 5 x 5 pixels; holes take the nearer side's."""
    around = windows(depth, 5)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        own = np.where(depth > 0, depth, np.nanmin(around, axis=-1))
    v, u = np.indices((5, 5)).reshape(2, -1) - 2
    weights = np.exp(-(v**2 + u**2) / 8.0 - (around - own[..., None]) ** 2 / (2.0 * 30.0**2))
    weights = np.nan_to_num(weights)
    total = weights.sum(axis=-1)
    return np.where(
        total > 0, (weights * np.nan_to_num(around)).sum(axis=-1) / np.maximum(total, 1e-6), 0.0
    )


def preserving_edges(depth: Depth) -> NDArray[Any]:
    """Smooth along rows and columns, back and forth, up to steps of 20 mm, as RealSense has it."""
    image = depth.astype(np.float32)
    for turn in (0, 1, 2, 3, 0, 1, 2, 3):
        lines = np.rot90(image, turn).copy()
        for k in range(1, lines.shape[1]):
            now, last = lines[:, k], lines[:, k - 1]
            alike = (now > 0) & (last > 0) & (np.abs(now - last) < 20)
            lines[:, k] = np.where(alike, 0.5 * now + 0.5 * last, now)
        image = np.rot90(lines, -turn)
    return image


def decimated(depth: Depth) -> NDArray[Any]:
    """Halve the resolution by the lower median of the measured pixels, and enlarge again."""
    blocks = windows_of_two(depth)
    count = (blocks > 0).sum(axis=-1)
    ordered = np.sort(np.where(blocks > 0, blocks, 65535), axis=-1)
    middle = np.take_along_axis(ordered, np.maximum(count - 1, 0)[..., None] // 2, -1)[..., 0]
    return np.repeat(np.repeat(np.where(count > 0, middle, 0), 2, axis=0), 2, axis=1)


def windows_of_two(depth: Depth) -> Depth:
    """Return blocks of 2 x 2 pixels."""
    height, width = (side // 2 for side in depth.shape)
    blocks = depth[: 2 * height, : 2 * width].reshape(height, 2, width, 2)
    return blocks.swapaxes(1, 2).reshape(height, width, 4)


def persistent(least: int, last: int) -> Filter:
    """Return RealSense's filter over time, which smooths depths that hardly change.

    A missing pixel keeps its depth if ``least`` of the ``last`` frames measured it.
    """

    def keep(depths: Sequence[Depth]) -> list[NDArray[Any]]:
        kept: list[NDArray[Any]] = [depths[0].astype(np.float64)]
        for number, depth in enumerate(depths[1:], 1):
            now, before = depth.astype(np.float64), kept[-1]
            alike = (now > 0) & (before > 0) & (np.abs(now - before) < 20)
            now = np.where(alike, 0.4 * now + 0.6 * before, now)
            seen = [other > 0 for other in depths[max(0, number - last) : number]]
            is_kept = (depth == 0) & (np.sum(seen, axis=0) >= least)
            kept.append(np.where(is_kept, before, now))
        return [np.rint(image) for image in kept]

    return keep


def over_time(depths: Sequence[Depth]) -> list[NDArray[Any]]:
    """Return the median of the measurements of each pixel in the last three frames."""
    found = []
    for k in range(len(depths)):
        some = np.stack(depths[max(0, k - 2) : k + 1]).astype(np.float32)
        some[some == 0] = np.nan
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            found.append(np.rint(np.nan_to_num(np.nanmedian(some, axis=0))))
    return found


def lossy(change: Filter) -> Filter:
    """Return the filter after which three of a thousand pixels are lost at random."""

    def lose(depths: Sequence[Depth]) -> list[NDArray[Any]]:
        rng = np.random.default_rng(0)
        return [np.where(rng.random(d.shape) < 0.003, 0, d) for d in change(depths)]

    return lose


CHOSEN_ON: dict[str, Filter] = {
    "none": list,
    "missing pixels kept, 1 of 4": persistent(1, 4),
    "missing pixels kept, 1 of 5": persistent(1, 5),
    "missing pixels kept, 2 of 8": persistent(2, 8),
    "holes by a 3 x 3 median": each(lambda d: chosen(d, 3, np.nanmedian, holes=True)),
    "holes by a 5 x 5 median": each(lambda d: chosen(d, 5, np.nanmedian, holes=True)),
    "5 x 5 median": median(5),
    "3 x 3 minimum": each(lambda d: chosen(d, 3, np.nanmin, holes=False)),
    "5 x 5 minimum": each(lambda d: chosen(d, 5, np.nanmin, holes=False)),
}
UNSEEN: dict[str, Filter] = {
    "bilateral, holes filled": each(bilateral),
    "edge-preserving": each(preserving_edges),
    "decimated by 2, enlarged": each(decimated),
    "7 x 7 median": median(7),
    "5 x 5 maximum": each(lambda d: chosen(d, 5, np.nanmax, holes=False)),
    "holes by a 5 x 5 mean": each(lambda d: chosen(d, 5, np.nanmean, holes=True)),
    "holes by the nearest, 2 pixels": nearest(2.0),
    "holes by the nearest, 4 pixels": nearest(4.0),
    "median over 3 frames": over_time,
    "3 x 3 minimum, then losses": lossy(each(lambda d: chosen(d, 3, np.nanmin, holes=False))),
}


def clean_streams() -> Iterator[tuple[str, str, list[RgbdFrame]]]:
    """Yield kind, name and frames of clean recordings."""
    from manip3d import datasets
    from manip3d.experiments import _streams

    kitchen, turning = _streams.scene("scene_kitchen"), list(_streams.turning())
    yield "clean, chosen on", "kitchen 0", kitchen[:10]
    yield "clean, chosen on", "TUM desk", _streams.scene("scene_tum_desk")
    yield "clean, chosen on", "turning 10", turning[10:22]
    yield "clean, unseen", "kitchen 100", kitchen[10:]
    for start in (50, 75):
        yield "clean, unseen", f"turning {start}", turning[start : start + 12]
    for name in ("person_ddrnet", "person_ddrnet_arms_up"):
        yield "clean, unseen", name, list(datasets.open_people(f"people:{name}"))[:12]
    for name in ("scene_kinect2_desk", "wall_realsense"):
        yield "clean, unseen", name, _streams.scene(name)


def forged_streams() -> Iterator[tuple[str, str, list[RgbdFrame]]]:
    """Yield kind, name and frames of streams with an inserted person."""
    from manip3d import datasets, forge
    from manip3d.experiments import _streams

    kitchen, walls = _streams.scene("scene_kitchen")[:10], _streams.walls()
    poses = datasets.open_people("utd-mhad:a16_s1")[10:20]
    for subject in range(1, 9):
        people = datasets.open_people(f"utd-mhad:a3_s{subject}")[:10]
        wall = walls[10 * (subject - 1) : 10 * subject]
        for place, scene, move in (("wall", wall, -0.9), ("kitchen", kitchen, -1.2)):
            for kind, pose in ((1, None), (2, poses)):
                for how, background in (("still", scene[0]), ("running", scene)):
                    forged = forge.stream(
                        people, background, kind=kind, pose=pose, move=(0.0, 0.0, move)
                    )
                    group = "forged, chosen on" if subject < 5 else "forged, unseen"
                    yield group, f"{place} {subject} type {kind} {how}", list(forged)


def verdict(frames: list[RgbdFrame]) -> str:
    """Return the verdict on a stream, or that of the silhouettes of one that is too short."""
    from manip3d.authenticate import inspect_stream

    found = inspect_stream(frames)
    if len(frames) >= 6:
        return str(found.verdict)
    return str(next(each.verdict for each in found.detectors if each.name == "silhouettes"))


SILHOUETTES = "manip3d.authenticate._silhouettes"


def is_filtered(group: str, name: str) -> bool:
    """Whether a stream is judged behind all filters: of the forged ones, a part of the unseen."""
    return group.startswith("clean") or (group == "forged, unseen" and "type 1 running" in name)


def run(file: Path) -> list[Line]:
    """Return the lines of all filtered streams; judge and append those that the file lacks."""
    lines = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    done = {(line["stream"], line["filter"]) for line in lines}
    for group, name, frames in chain(clean_streams(), forged_streams()):
        depths = [np.where(frame.depth == 65535, 0, frame.depth) for frame in frames]
        filters = CHOSEN_ON | UNSEEN if is_filtered(group, name) else {"none": list}
        for kind, change in filters.items():
            if (name, kind) in done:
                continue
            images = [np.ascontiguousarray(image, np.uint16) for image in change(depths)]
            filtered = [replace(f, depth=d) for f, d in zip(frames, images, strict=True)]
            line = {"group": group, "stream": name, "filter": kind, "verdict": verdict(filtered)}
            line["before"] = line["verdict"]
            if line["verdict"] == "processed":  # the traces change no other verdict
                with mock.patch(f"{SILHOUETTES}.filter_trace", return_value=None):
                    line["before"] = verdict(filtered)
            lines.append(line)
            with file.open("a") as out:
                out.write(json.dumps(line) + "\n")
        print(f"{group}: {name}", file=sys.stderr, flush=True)
    return lines


GROUPS = ("clean, chosen on", "clean, unseen", "forged, chosen on", "forged, unseen")
HEAD = ["filter"] + [
    f"{group}: {what}"
    for group in GROUPS
    for what in (("accused",) if group.startswith("clean") else ("accused", "`no_trace`"))
]


def report(lines: list[Line]) -> str:
    """Return the table: counts before and now, of all streams of a group."""
    import tables

    rows = []
    for kind in CHOSEN_ON | UNSEEN:
        cells = [kind if kind in CHOSEN_ON else f"{kind} (unseen)"]
        for group in GROUPS:
            some = [x for x in lines if x["group"] == group and x["filter"] == kind]
            was, now = (Counter(line[key] for line in some) for key in ("before", "verdict"))
            told = ("tampered",) if group.startswith("clean") else ("tampered", "no_trace")
            cells += [f"{was[t]} → {now[t]} of {len(some)}" if some else "–" for t in told]
        rows.append(cells)
    return tables.table(HEAD, rows)


def main() -> None:
    """Filter, inspect and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="lines of what was judged, .jsonl")
    options = parser.parse_args()
    one_thread()
    import tables

    tables.write_section("filters", report(run(options.file)))


if __name__ == "__main__":
    main()
