"""Table 6.1: verdicts of detectors I and II on original, CTP and CRTP scans."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from manip3d.experiments import _forensics, _published
from manip3d.experiments._model import Claim, Experiment, Finding, Row


def _as_many_right(detector: str, classes: tuple[str, ...]) -> Claim:
    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for line in _published.published_rows("table_6_1_lidar_forensics"):
            if line["class"] not in classes:
                continue
            found = _forensics.entries(rows, line["class"], kind=line["scene"])
            if not found:
                continue
            column = "original" if line["class"] == "original" else "forged"
            published = int(line[f"{detector}_{column}"]) / int(line["count"])
            right = sum(_forensics.is_right(entry, detector) for entry in found)
            numbers = (
                f"{right} of {len(found)}, published {line[f'{detector}_{column}']} "
                f"of {line['count']}"
            )
            name = f"{line['scene']}, {line['class']}"
            yield _forensics.finding(rows, name, right / len(found) >= published, numbers)

    names = " and ".join(classes)
    return Claim(
        f"Detector {detector} is right as often as published, or more often, on {names} scans",
        "table 6.1",
        judge,
    )


def _same_number(rows: Sequence[Row]) -> Iterator[Finding]:
    for line in _published.published_rows("table_6_1_lidar_forensics"):
        found = _forensics.entries(rows, line["class"], kind=line["scene"])
        yield _forensics.finding(
            rows,
            f"{line['scene']}, {line['class']}",
            len(found) == int(line["count"]),
            f"{len(found)} of {line['count']}",
        )


EXPERIMENT = Experiment(
    id="table-6.1",
    title="Detectors I and II on terrestrial scans",
    published="table_6_1_lidar_forensics",
    data=_forensics.HOAXES,
    cases=_forensics.cases,
    columns=_forensics.COLUMNS,
    claims=(
        Claim("As many scans as published are judged", "table 6.1", _same_number),
        _as_many_right("II", ("original", "CTP", "CRTP")),
        _as_many_right("I", ("original", "CTP")),
    ),
    complete=_forensics.complete,
    notes=(
        _forensics.resolution_note,
        _forensics.NOTE,
        'A cell says how many verdicts are right: "no_trace" on originals, "tampered" on '
        "forgeries. Hoaxes are whole, as published; those of which only the front was pasted stand "
        "in the results file and in table 6.2.",
    ),
)
