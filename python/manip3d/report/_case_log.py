"""A log of inspections that shows when a line of it was changed, left out or put in."""

from __future__ import annotations

import hashlib
import json
import os
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from manip3d import __version__
from manip3d._util.checked import checked
from manip3d._util.json import finite
from manip3d._util.paths import path_of
from manip3d.errors import FormatError
from manip3d.io._files import open_regular

if TYPE_CHECKING:
    from manip3d.authenticate import Inspection

_FIRST = "0" * 64
"""In the place of the hash of the line before the first."""


@checked
def append_log(
    path: str | os.PathLike[str], inspection: Inspection, *, source: str, source_sha256: str = ""
) -> str:
    """Append an inspection to a log whose lines hold the hash of the line before.

    Parameters
    ----------
    path : path
        A ``.jsonl`` file; made if it is not there.
    inspection : Inspection
        The result of `manip3d.authenticate.inspect`.
    source : str
        Name of the scan.
    source_sha256 : str
        Hash of its file, in hexadecimal digits.

    Returns
    -------
    str
        The hash of the new line, 64 hexadecimal digits. Who keeps it elsewhere can prove later that
        the log up to this line is the same.

    Raises
    ------
    FormatError
        The log is damaged.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import authenticate, report
    >>> found = authenticate.inspect(np.zeros((0, 3), np.float32))
    >>> first = report.append_log("cases.jsonl", found, source="scan.bin")
    >>> second = report.append_log("cases.jsonl", found, source="other.bin")
    >>> first == second, report.read_log("cases.jsonl")[1]["previous"] == first
    (False, True)
    """
    target = path_of(path)
    before = read_log(target)[-1]["hash"] if target.exists() and target.stat().st_size else _FIRST
    entry = {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "manip3d": __version__,
        "source": source,
        "source_sha256": source_sha256,
        **finite(inspection.record()),
        "previous": before,
    }
    entry["hash"] = _hash(entry)
    with open(target, "ab") as file:
        file.write(json.dumps(entry).encode() + b"\n")
        file.flush()
        os.fsync(file.fileno())
    return str(entry["hash"])


@checked
def read_log(path: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """Read a log of inspections and check its chain of hashes.

    Parameters
    ----------
    path : path
        What `append_log` wrote.

    Returns
    -------
    list of dict
        One entry per inspection, the oldest first.

    Raises
    ------
    FormatError
        A line is no entry, or it, or the one before it, was changed, left out or put in.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import authenticate, report
    >>> found = authenticate.inspect(np.zeros((0, 3), np.float32))
    >>> _ = report.append_log("cases.jsonl", found, source="scan.bin")
    >>> [entry["source"] for entry in report.read_log("cases.jsonl")]
    ['scan.bin']
    """
    with open_regular(path_of(path)) as file:
        lines = file.read().splitlines()
    entries: list[dict[str, Any]] = []
    before = _FIRST
    for number, line in enumerate(lines, 1):
        try:
            entry = json.loads(line)
            kept = entry["hash"]
            linked = entry["previous"] == before and _hash(entry) == kept
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise FormatError(
                f"line {number}: not an entry of a log: {error}", file=os.fspath(path)
            ) from error
        if not linked:
            raise FormatError(
                f"line {number}: the chain of hashes is broken: it, or the line before it, was "
                "changed, left out or put in",
                file=os.fspath(path),
            )
        entries.append(entry)
        before = kept
    return entries


def _hash(entry: dict[str, Any]) -> str:
    content = {name: value for name, value in entry.items() if name != "hash"}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
