"""Check before a folder of stimuli is replaced: it must contain nothing else."""

from __future__ import annotations

from pathlib import Path

from manip3d._util.csv_tables import csv_records
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
        The table is no CSV in UTF-8.
    """
    known = {table}
    path = folder / table
    if path.is_file():
        for row in csv_records(path, errors="replace"):
            known |= {str(row.get("file")), f"{row.get('model')}.glb"}
    refuse_other_files(folder, known.__contains__)
