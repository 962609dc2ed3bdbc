"""One function over many files: on all cores or on a Dask cluster, resumable, with one table.

`run` hands out one task a file. A file that fails is a row of the table, and the others go on; a
run that was stopped goes on where it was when the same call is made again. Sources and outputs may
be folders, patterns and URLs that fsspec opens (extra ``remote``).

What a million scans on a hundred workers cost follows from these measurements, made on a machine of
two cores that had other work to do, so that processor time is given where it could be:

- `manip3d.authenticate.inspect` with one thread took 1.0 s of processor time for a scan of 120 000
  points (KITTI, four scans), reading the 0.74 MB of its ``.bin.xz`` included.
- Handing out a task that does nothing and storing its row took the process that does so 0.24 ms of
  processor time with two workers, and 4.7 ms with Dask, whose scheduler ran in the same process:
  about 210 tasks a second.
- A task is 76 bytes on the wire and its row 237; a row of ``inspect`` has 960. On disk a row of
  ``inspect`` takes 1.3 kB, and 0.8 kB of the table in CSV. The process that hands out the work kept
  2.2 kB for each file of 20 000, and at most 9 kB with Dask and 3 000.
- Listing took 0.11 ms a file, and taking a stored row up again 0.3 ms.
- A file is read from S3 with two requests (HEAD, GET) and written with three; rows are written once
  a second.

A million scans are then 1.0 million core seconds, 2.8 hours for a hundred workers of one thread.
They ask for a hundred tasks a second, half of what one scheduler hands out: two hundred workers are
the most that a second of work a file can feed. The scans are 0.74 TB, 74 MB a second for all
workers together. The rows are 1.3 GB and the table 0.8 GB; the process that hands out the work
needs up to 10 GB, two minutes to list the files, and five minutes more where a stopped run goes on.
The totals are computed, not measured: no cluster of that size was there.
"""

from __future__ import annotations

from manip3d._util.lazy import lazily

__getattr__, __dir__, __all__ = lazily(
    __name__,
    {
        "_rows": "Rows",
        "_run": "Summary run",
        "_sources": "SourceFile find_drives find_files is_folder is_pattern",
        "_stored": "run_stored",
        "_table": "TABLE_SUFFIXES write_table",
    },
)
