"""Making of the stimuli of a study from its definition."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d._util.reprs import short_repr
from manip3d.errors import InputError
from manip3d.study._definition import Section, read_table
from manip3d.study._jnd import JndStudy, make_jnd_stimuli
from manip3d.study._reading import read_study
from manip3d.study._stimuli import copy_rating_stimuli, make_rating_stimuli

_FRAMES = 24  # default number of frames of a clip: 2.4 s at 10 frames per second
_MISSED = 0.5  # largest error of a level's difference, percent of the polygons


@dataclass(frozen=True)
class MadeStimuli:
    """Result of `make_stimuli`.

    Attributes
    ----------
    folder : Path
    count : int
        Number of files.
    problems : sequence of str
        Deviations from the definition.
    """

    folder: Path
    count: int
    problems: tuple[str, ...]

    __repr__ = short_repr


@checked
def make_stimuli(
    definition: str | os.PathLike[str],
    *,
    frames: int = _FRAMES,
    surfaces: int = 0,
    images: str | os.PathLike[str] | None = None,
    seed: int = 0,
    overwrite: bool = False,
    progress: Callable[[float, str], object] | None = None,
) -> MadeStimuli:
    """Make the stimuli of a rating or JND study, in the folder that its definition names.

    Parameters
    ----------
    definition : path-like
        A TOML or JSON file; the folder is relative to it.
    frames, surfaces, seed : int
        For a rating study only: as for `make_rating_stimuli`.
    images : path-like, optional
        For a rating study only: folder of your own pictures and clips, which are copied by
        `copy_rating_stimuli` in place of simulated stimuli.
    overwrite : bool
        Replace the folder if it contains only such stimuli.
    progress : callable, optional
        Called with the fraction done and a message.

    Returns
    -------
    MadeStimuli

    Raises
    ------
    InputError
        The study has no stimuli, the folder exists, or an argument is out of range. A method of a
        JND study does not apply to one of its models, as QEM_TP to faces without texture
        coordinates.
    FormatError
        The definition is invalid, or a mesh cannot be read.
    DataMissingError
        A public mesh that the definition names is not present.
    MissingExtraError
        Open3D or Pillow is not installed.
    OSError
        The folder cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from manip3d.study import make_stimuli, write_template
    >>> with tempfile.TemporaryDirectory() as place:
    ...     file = write_template("display", Path(place) / "study.toml", example=True)
    ...     make_stimuli(file)
    Traceback (most recent call last):
    manip3d.errors.InputError: definition: expected a rating or a jnd, got a display
    """
    file = path_of(definition)
    table = read_table(file)
    kind = Section(table, "", str(file)).word("kind", ("rating", "jnd", "display"))
    if kind == "display":
        raise InputError("definition: expected a rating or a jnd, got a display")
    if kind == "jnd":
        for name, is_given in {
            "images": images is not None,
            "surfaces": surfaces != 0,
            "frames": frames != _FRAMES,
            "seed": seed != 0,
        }.items():
            if is_given:
                raise InputError(f"{name}: can only be given with a rating, got a jnd")
    if kind == "rating":
        name = Section(table, "", str(file)).section("rating").text("stimuli")
        if images is not None:
            if surfaces:
                raise InputError("surfaces: expected none with images, which are all of the study")
            if frames != _FRAMES:
                raise InputError("frames: cannot be given with images, which are copied")
            copied = copy_rating_stimuli(images, file.parent / name, seed=seed, overwrite=overwrite)
            return MadeStimuli(file.parent / name, len(copied), ())
        made = make_rating_stimuli(
            file.parent / name,
            frames=frames,
            surfaces=surfaces,
            seed=seed,
            overwrite=overwrite,
            progress=progress,
        )
        return MadeStimuli(file.parent / name, len(made), ())
    study, _ = read_study(file)
    assert isinstance(study, JndStudy)
    assert study.stimuli is not None
    levels = make_jnd_stimuli(study, overwrite=overwrite, progress=progress)
    problems = []
    for model, method in study.conditions:
        short = [
            level
            for level in levels
            if (level.model, level.method) == (model, method)
            and level.reached_percent < level.difference_percent - _MISSED
        ]
        if short:
            problems.append(
                f"{model}, {method}: cannot be simplified beyond {short[0].reached_percent:.1f} %; "
                f"levels from {short[0].difference_percent} % on show and count as that"
            )
    count = len(levels) + len(study.models)
    return MadeStimuli(study.stimuli, count, tuple(problems))
