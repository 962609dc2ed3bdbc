from __future__ import annotations

from manip3d.batch._rows import Rows
from manip3d.batch._run import Summary, run
from manip3d.batch._sources import SourceFile, find_drives, find_files, is_folder, is_pattern
from manip3d.batch._stored import run_stored
from manip3d.batch._table import TABLE_SUFFIXES, write_table

__all__ = [
    "TABLE_SUFFIXES",
    "Rows",
    "SourceFile",
    "Summary",
    "find_drives",
    "find_files",
    "is_folder",
    "is_pattern",
    "run",
    "run_stored",
    "write_table",
]
