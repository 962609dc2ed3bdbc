"""Rows of a batch on disk or behind a URL, as they finish: many in a file, few files in all.

::

    TABLE.rows/run.json        what was asked for, so that another run is not mixed in
    TABLE.rows/000001-….jsonl  a row in each line, with what was asked for and a checksum of itself

A row says for itself what it is an answer to: of two processes that ask for different things at the
same time, neither takes the other's. Files are written whole and never changed, which object stores
can do, too; their names are partly random, so that no process replaces those of another.
"""

from __future__ import annotations

import hashlib
import json
import secrets
import time
from collections.abc import Collection, Iterable
from typing import Any

from manip3d._util.json import canonical_json, sealed, unsealed
from manip3d._util.texts import counted
from manip3d.batch._places import Place
from manip3d.errors import InputError

_FLUSH_S = 1.0
"""Seconds for which `Rows.save` keeps rows in memory, so that many of them share a file. A run that
is killed loses those rows."""


class Rows:
    """The rows of a batch, many in a file; a `manip3d.batch` store.

    Parameters
    ----------
    folder : path or URL
        Made if it is absent.
    asked : dict
        Function and options of the run, as values that JSON can represent.
    overwrite : bool
        Remove all stored rows, also those of another function or of other options.
    resume : bool
        False: remove the stored rows of the same function and options, too.

    Raises
    ------
    InputError
        The stored rows are those of another function or of other options.
    """

    def __init__(
        self,
        folder: str,
        asked: dict[str, Any],
        *,
        overwrite: bool = False,
        resume: bool = True,
    ) -> None:
        self._place = Place(folder)
        asked = _as_read(asked)
        self._asked_hash = hashlib.sha256(canonical_json(asked)).hexdigest()[:16]
        self._waiting: list[str] = []
        self._flushed_s = time.monotonic()
        self._rows: dict[str, dict[str, Any]] = {}
        names = self._place.names()
        parts = sorted((name for name in names if name.endswith(".jsonl")), key=_order_of)
        self._next = 1 + max(map(_number_of, parts), default=0)
        if not overwrite and self._has_begun(asked, names) and resume:
            self._load_parts(parts)
        else:
            self._begin(asked, parts)

    def __repr__(self) -> str:
        return f"<manip3d.batch.Rows: {self._place}, {counted(len(self._rows), 'row')}>"

    def _has_begun(self, asked: dict[str, Any], names: Collection[str]) -> bool:
        """Return whether an earlier run has stored rows here; raise if it asked something else."""
        if "run.json" not in names:
            return False
        try:
            record = unsealed(self._place.read("run.json"))
        except FileNotFoundError:  # removed meanwhile
            return False
        # The texts are compared, because NaN equals itself only there.
        if record is not None and canonical_json(record.get("asked")) != canonical_json(asked):
            raise InputError(
                f"{self._place}: holds results of another command or of other options; "
                "overwrite=True makes them again"
            )
        return record is not None

    def _begin(self, asked: dict[str, Any], parts: list[str]) -> None:
        """Remove the stored rows, and store what is asked for now.

        The rows go first: a run that is ended in between leaves none under another's name.
        """
        self._place.remove(parts)
        self._place.write("run.json", json.dumps(sealed({"asked": asked}), indent=1))

    def _load_parts(self, parts: Iterable[str]) -> None:
        """Load the rows of the same function and options; the last row of a key counts."""
        for name in parts:
            try:
                lines = self._place.read(name).splitlines()
            except FileNotFoundError:  # removed by another run meanwhile, which begins anew
                continue
            for line in lines:
                record = unsealed(line)
                if record is not None and record.get("asked") == self._asked_hash:
                    self._rows.pop(record["key"], None)  # the order is that of the last rows
                    self._rows[record["key"]] = record["row"]

    def load(self, key: str) -> dict[str, Any] | None:
        """Return the row of a key, or None.

        Parameters
        ----------
        key : str
            Key of the task.

        Returns
        -------
        dict or None
        """
        return self._rows.get(key)

    def items(self) -> list[tuple[str, dict[str, Any]]]:
        """Return all keys and rows, in the order in which they were stored.

        Returns
        -------
        list of (str, dict)
        """
        return list(self._rows.items())

    def save(self, key: str, row: dict[str, Any]) -> dict[str, Any]:
        """Keep a row in memory; it is stored by `flush`, or by a `save` in a later second.

        Parameters
        ----------
        key : str
            Key of the task.
        row : dict
            What the task returned.

        Returns
        -------
        dict
            The row as `load` returns it: tuples have become lists, and keys strings.
        """
        row = self._rows[key] = _as_read(row)
        record = {"key": key, "asked": self._asked_hash, "row": row}
        self._waiting.append(json.dumps(sealed(record), separators=(",", ":")))
        if time.monotonic() - self._flushed_s >= _FLUSH_S:
            self.flush()
        return row

    def flush(self) -> None:
        """Store the rows that are still waiting in memory."""
        if self._waiting:
            name = f"{self._next:06d}-{secrets.token_hex(4)}.jsonl"
            self._place.write(name, "\n".join(self._waiting) + "\n")
            self._next += 1
            self._waiting = []
        self._flushed_s = time.monotonic()


def _as_read(value: dict[str, Any]) -> dict[str, Any]:
    """Return a value as it is read from JSON: with lists for tuples, and strings for keys."""
    read: dict[str, Any] = json.loads(json.dumps(value))
    return read


def _order_of(part: str) -> tuple[int, str]:
    """Return the key of a part's order; names tell apart parts that two runs gave one number."""
    return _number_of(part), part


def _number_of(part: str) -> int:
    """Return the number that begins the name of a part; 0 for a file that another program made."""
    number = part.partition("-")[0]
    return int(number) if number.isascii() and number.isdecimal() else 0
