"""Texture error and time of CS3 and texture-preserving QEM: figures 3.13 and 3.14 and a table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from manip3d.experiments import _depth_pictures, _published
from manip3d.experiments._depth import (
    DATA_NOTE,
    METHOD_COLUMN,
    NOTE,
    QEM_NOTE,
    TIME_NOTE,
    listing,
    models,
    real_data,
    reduction_case,
)
from manip3d.experiments._depth_claims import cs3_twenty_times_faster
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row, by_model

METHODS = ("qem-tp", "qem-orig", "cios", "relief")
_PRINTED = {"qem-tp": "texture-preserving QEM", "qem-orig": "QEM", "cios": "CS3"}
_TABLE = "figures_3_13_3_14_texture_error"


def _complete(row: Row) -> Row:
    for printed in _published.published_rows(_TABLE):
        here = (printed["model"], printed["method"])
        if here == (row["stands_in_for"], _PRINTED.get(row["method"])):
            return row | {
                "published_texture": float(printed["texture_error_1e-6"]) * 1e-6,
                "published_time": float(printed["time_ms"]),
            }
    return row | {"published_texture": None, "published_time": None}


def _printed_ratio(model: str) -> float:
    """Return the ratio of CS3's printed texture error to that of texture-preserving QEM."""
    printed = {
        row["method"]: float(row["texture_error_1e-6"])
        for row in _published.published_rows(_TABLE)
        if row["model"] == model
    }
    return printed["CS3"] / printed["texture-preserving QEM"]


def _near_texture_preserving(rows: Sequence[Row]) -> Iterator[Finding]:
    for model, group in by_model(rows):
        best, mine = group["qem-tp"]["texture_mse"], group["cios"]["texture_mse"]
        numbers = f"{listing(group, 'texture_mse', 1e6)} (1e-6), {mine / best:.2f} times"
        yield Finding(model, mine <= 2 * best, numbers)


def _below_plain(rows: Sequence[Row]) -> Iterator[Finding]:
    for model, group in by_model(rows):
        holds = group["cios"]["texture_mse"] < group["qem-orig"]["texture_mse"]
        yield Finding(model, holds, f"{listing(group, 'texture_mse', 1e6)} (1e-6)")


def _relief_below_preserving(rows: Sequence[Row]) -> Iterator[Finding]:
    for model, group in by_model(rows):
        for measure, scale in (("texture_mean", 1e3), ("texture_mse", 1e6)):
            holds = group["relief"][measure] < group["qem-tp"][measure]
            word = "mean" if measure == "texture_mean" else "squared"
            yield Finding(f"{model}, {word}", holds, listing(group, measure, scale))


def _fraction_of_the_time(rows: Sequence[Row]) -> Iterator[Finding]:
    yield from cs3_twenty_times_faster(rows, "qem-tp")


_COLUMNS = (
    METHOD_COLUMN,
    Column("points", "vertices"),
    Column("faces", "faces"),
    Column("texture_mse", "texture error (squared), 1e-6", 1e6, 3, "published_texture",
           ratio=False, lower_is_better=True),
    Column("texture_mean", "texture error (mean), 1e-3", 1e3, 3, lower_is_better=True),
    Column("metro_area", "Metro, area, 1e-3", 1e3, 3, lower_is_better=True),
    Column("time_ms", "ms", 1.0, 2, "published_time", lower_is_better=True),
)  # fmt: skip
_RELIEF_CLAIM = Claim(
    "The relief's texture error, mean and squared, is below texture-preserving QEM's",
    "aim",
    _relief_below_preserving,
)
_UNIT_NOTE = (
    "Texture error is the deviation of texture coordinates (1 = a whole image) on the surface; the "
    "printed one names no unit and no mean, and the mean square has its order of magnitude. Both "
    "QEM variants here keep points of the image with their texture coordinates, so plain QEM has "
    "nothing to lose; the printed one was made by a filter that moves points."
)


def _cases(plan: Plan, published: tuple[str, ...], share: float) -> list[Case]:
    return [
        reduction_case(model, method, plan, share=share)
        for model in models(plan, published)
        for method in METHODS
    ]


def texture_table(share: float) -> Experiment:
    """Return the experiment on every object, scene and person."""
    return Experiment(
        id="texture-3",
        title=f"Texture error and time of all range images, {share:.0%} of the points",
        published="",
        data=real_data(),
        cases=lambda plan: _cases(plan, (), share),
        columns=tuple(replace(column, published="") for column in _COLUMNS),
        claims=(_RELIEF_CLAIM,),
        notes=(DATA_NOTE, NOTE, QEM_NOTE, TIME_NOTE, _UNIT_NOTE),
    )


def texture_figure(number: str, published: str, share: float) -> Experiment:
    """Return the experiment of one of the two figures."""
    source = f"figure {number}"
    return Experiment(
        id=f"figure-{number}",
        title=f"Texture error and time, {published} at {share:.0%}",
        published=_TABLE,
        data=real_data((published,)),
        cases=lambda plan: _cases(plan, (published,), share),
        columns=_COLUMNS,
        claims=(
            Claim(
                "CS3's texture error is similar to texture-preserving QEM's (at most twice; "
                f"printed: {_printed_ratio(published):.1f} times)",
                source,
                _near_texture_preserving,
            ),
            Claim("CS3's texture error is below plain QEM's", source, _below_plain),
            Claim(
                "CS3 takes at most a twentieth of texture-preserving QEM's time",
                source,
                _fraction_of_the_time,
            ),
            _RELIEF_CLAIM,
        ),
        complete=_complete,
        sheets=_depth_pictures.sheets,
        notes=(DATA_NOTE, NOTE, QEM_NOTE, TIME_NOTE, _UNIT_NOTE),
    )
