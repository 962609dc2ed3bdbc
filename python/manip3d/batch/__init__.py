"""One function over many files: on all cores or on a Dask cluster, resumable, with one table.

`run` hands out one task a file. A file that fails is a row of the table, and the others go on; a
run that was stopped goes on where it was when the same call is made again. Sources and outputs may
be folders, patterns and URLs that fsspec opens (extra ``remote``).
"""

from __future__ import annotations

from manip3d.batch._rows import Rows
from manip3d.batch._run import Summary, run
from manip3d.batch._sources import SourceFile, find_files, is_folder, is_pattern
from manip3d.batch._stored import run_stored
from manip3d.batch._table import TABLE_SUFFIXES, write_table

__all__ = [
    "TABLE_SUFFIXES",
    "Rows",
    "SourceFile",
    "Summary",
    "find_files",
    "is_folder",
    "is_pattern",
    "run",
    "run_stored",
    "write_table",
]
