"""Check before a folder of stimuli is replaced: it must contain nothing else."""

from __future__ import annotations

import os
from pathlib import Path

from manip3d._util.csv_tables import csv_records
from manip3d.errors import FormatError
from manip3d.io._files import refuse_other_files


def refuse_other_stimuli(folder: Path, table: str) -> None:
    """Refuse to replace a folder that contains files which its table of stimuli does not list.

    Parameters
    ----------
    folder : Path
        The folder; it may be absent.
    table : str
        File name of its table, a CSV with the columns ``file`` and, for a JND study, ``model``.

    Raises
    ------
    InputError
        There are other files; the message names some of them.
    FormatError
        The table cannot be read, and the folder contains other files, which it may list.
    """
    path = folder / table
    known = {table}
    try:
        if path.is_file():
            known |= _listed(path)
    except FormatError as error:
        if os.listdir(folder) != [table]:
            raise FormatError(
                f"{error.reason}; it lists the files that may be replaced: mend it, or delete "
                f"{folder} if nothing in it is to be kept",
                file=error.file,
                line=error.line,
            ) from None
    refuse_other_files(folder, known.__contains__)


def _listed(path: Path) -> set[str]:
    """Return the names of the files in a table of stimuli."""
    found = set[str]()
    for row in csv_records(path, errors="replace"):
        found |= {str(row.get("file")), f"{row.get('model')}.glb"}
    return found
