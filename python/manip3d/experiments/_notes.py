"""Notes of a report that name the data of a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from manip3d.experiments._model import Row

_MEANINGS = {
    "published": "The published files: {names}.",
    "stand-in": (
        "Public files in the place of the published ones: {names}. The published value beside "
        "them belongs to another {thing}, so there is no ratio and no claim of reproduction."
    ),
    "recorded": "Recorded, in the place of nothing published: {names}.",
    "simulated": (
        "Simulated: {names}. The published value beside them belongs to another {thing}, so there "
        "is no ratio and no claim of reproduction."
    ),
}


def data_note(thing: str) -> Callable[[Sequence[Row]], str]:
    """Return a note that lists the data of the rows by kind: published, stand-in, simulated.

    Parameters
    ----------
    thing : str
        Noun for the object of a row, such as ``mesh`` or ``range image``.
    """

    def note(rows: Sequence[Row]) -> str:
        return " ".join(
            meaning.format(names=names, thing=thing)
            for kind, meaning in _MEANINGS.items()
            if (names := _names(rows, kind))
        )

    return note


def _names(rows: Sequence[Row], kind: str) -> str:
    """Return names such as ``rockerArm as RockerArm, lifeboat for Dragon``."""
    models = {row["model"]: row.get("stands_in_for", "") for row in rows if row["data"] == kind}
    word = "as" if kind == "published" else "for"
    return ", ".join(
        f"{model} {word} {published}" if published else model for model, published in models.items()
    )
