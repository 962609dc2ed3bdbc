"""Reading of study definitions, and templates of definitions."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.errors import FormatError, InputError
from manip3d.io._files import atomic_write, sha256_of
from manip3d.study._definition import ALL, Section, read_table
from manip3d.study._display import DisplayStudy
from manip3d.study._engine import Study
from manip3d.study._jnd import JndStudy
from manip3d.study._rating import RatingStudy
from manip3d.study._store import CHECKSUMS

_KINDS = {"rating": RatingStudy, "jnd": JndStudy, "display": DisplayStudy}

TEMPLATES = ("rating", "jnd-non-textured", "jnd-textured", "display")
"""Names of the templates of definitions."""


@checked
def read_study(path: str | os.PathLike[str]) -> tuple[Study, dict[str, Any]]:
    """Read the definition of a study.

    Parameters
    ----------
    path : path-like
        A TOML file, or a JSON file by its suffix. Paths of stimuli are relative to its folder.

    Returns
    -------
    study : Study
    definition : dict
        Content of the file, for `StudyFolder`. The stimuli of a rating study are added, and the
        checksums of all stimuli that exist, by which later changes are detected.

    Raises
    ------
    FormatError
        The file is not a definition; a key is missing, unknown or out of range; or two columns of
        the results would have the same name.
    InputError
        A rating study has no stimuli.
    OSError
        The file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from manip3d.study import read_study, write_template
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = write_template("display", Path(folder) / "study.toml")
    ...     read_study(file)
    Traceback (most recent call last):
    manip3d.errors.FormatError: ...consent: expected a list of 1 to 100 different texts that are ...
    """
    file = path_of(path)
    definition = read_table(file)
    study = _study(definition, file.parent, str(file))
    _check_names(study, str(file))
    _check_groups(study, str(file))
    if isinstance(study, RatingStudy):  # the stimuli are needed to evaluate the answers
        items = [{k: v for k, v in vars(item).items() if v != ""} for item in study.items]
        definition["rating"] = definition["rating"] | {"items": items}
    checksums = {n: sha256_of(f) for n, f in study.files().items() if f.is_file()}
    if checksums:
        definition[CHECKSUMS] = checksums
    return study, definition


@checked
def study_of(definition: Mapping[str, Any]) -> Study:
    """Return the study of a definition that is stored with its answers, without its stimuli.

    Parameters
    ----------
    definition : mapping
        Definition as in `StudyFolder.definition`.

    Returns
    -------
    Study

    Raises
    ------
    FormatError
        As `read_study`.

    Examples
    --------
    >>> from manip3d.study import study_of
    >>> study_of({"kind": "none"})
    Traceback (most recent call last):
    manip3d.errors.FormatError: kind: expected one of rating, jnd, display, got 'none'
    """
    return _study(definition, None, "")


def _study(definition: Mapping[str, Any], base: Path | None, file: str) -> Study:
    if base is None:  # stored with answers
        definition = {key: value for key, value in definition.items() if key != CHECKSUMS}
    top = Section(definition, "", file)
    kind = top.word("kind", tuple(_KINDS))
    return _KINDS[kind].read(Section(definition, "", file), base)  # type: ignore[attr-defined, no-any-return]


_RESERVED = ("record_id", "state", "group", "card_px", "distance_cm", "agree")
"""Names that questions must not have: common columns of the results, and the consent question."""


def _check_groups(study: Study, file: str) -> None:
    """Refuse a group that has the name of all groups together in the results of a display study.

    Stored definitions are not checked, because their answers must stay readable.
    """
    if isinstance(study, DisplayStudy) and ALL in map(str.lower, study.common.groups):
        raise FormatError(
            f"groups: expected no group named {ALL}, which results call all participants, "
            f"got {list(study.common.groups)}",
            file=file,
        )


def _check_names(study: Study, file: str) -> None:
    """Refuse a study in which two columns of the results would have the same name."""
    names = [*_RESERVED, *(field.name for _, field in study.variables())]
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise FormatError(
            f"{study.common.kind}: expected names that differ in the results, got {twice[0]} twice",
            file=file,
        )
    known = set(names)
    for number, field in enumerate(study.common.demographics):
        if field.name in known:
            raise FormatError(
                f"demographics[{number}].name: expected a name that no other column of the "
                f"results has, got {field.name!r}",
                file=file,
            )


_CONSENT = 'consent = ["This is a trial run with made-up questions; its answers mean nothing."]'


@checked
def write_template(name: str, path: str | os.PathLike[str], *, example: bool = False) -> Path:
    """Write a template of a definition.

    Parameters
    ----------
    name : str
        One of `TEMPLATES`.
    path : path-like
        File to write; its name must end in ``.toml``.
    example : bool
        Fill the empty texts with placeholders, and shorten familiarisation to a second, for a trial
        run.

    Returns
    -------
    Path
        ``path``.

    Raises
    ------
    InputError
        There is no such template, or the file name does not end in ``.toml``.
    OSError
        The file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from manip3d.study import write_template
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_template("jnd-textured", Path(folder) / "study.toml").read_text()[:5]
    '# Jus'
    """
    if name not in TEMPLATES:
        raise InputError(f"name: expected one of {', '.join(TEMPLATES)}, got {name!r}")
    target = path_of(path)
    if target.suffix.lower() != ".toml":
        raise InputError(f"path: expected a name that ends in .toml, got {target.name}")
    file = Path(__file__).parent / "templates" / f"{name}.toml"
    content = file.read_text(encoding="utf-8")
    if example:
        lines = [
            line.replace('text = ""', f'text = "Placeholder of line {number}"')
            for number, line in enumerate(content.splitlines(), 1)
        ]
        content = "\n".join(lines) + "\n"
        content = content.replace('consent = [""]', _CONSENT)
        content = content.replace("familiarisation_s = 180", "familiarisation_s = 1")
    atomic_write(target, content)
    return target
