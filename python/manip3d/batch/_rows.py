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
from typing import Any

from manip3d._util.json import canonical_json, sealed, unsealed
from manip3d._util.texts import counted
from manip3d.batch._places import Place
from manip3d.errors import InputError

_FLUSH_S = 1.0  # a run that is killed loses the rows of this time at most


class Rows:
    """The rows of a batch, stored once a second; a `manip3d.batch` store.

    Parameters
    ----------
    folder : path or URL
        Made if it is absent.
    asked : dict
        Function and options of the run, as JSON values.
    overwrite : bool
        Forget the rows that are there, of whatever run.
    resume : bool
        Without it, rows of the same function and options are forgotten, too.

    Raises
    ------
    InputError
        The rows that are there are those of another function or of other options.
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
        self._asked = hashlib.sha256(canonical_json(asked)).hexdigest()[:16]
        self._waiting: list[str] = []
        self._flushed_s = time.monotonic()
        self._rows: dict[str, dict[str, Any]] = {}
        parts = sorted(name for name in self._place.names() if name.endswith(".jsonl"))
        self._next = 1 + max((int(p[:6]) for p in parts if p[:6].isdecimal()), default=0)
        self.is_new = overwrite or not self._holds(asked) or not resume
        if self.is_new:
            # The rows go first: a run that is ended in between leaves none under another's name.
            self._place.remove(parts)
            self._place.write("run.json", json.dumps(sealed({"asked": asked}), indent=1))
            return
        for name in parts:
            try:
                lines = self._place.read(name).splitlines()
            except FileNotFoundError:  # removed by another run meanwhile, which begins anew
                continue
            for line in lines:
                record = unsealed(line)
                if record is not None and record.get("asked") == self._asked:
                    self._rows[record["key"]] = record["row"]

    def __repr__(self) -> str:
        return f"<manip3d.batch.Rows: {self._place}, {counted(len(self._rows), 'row')}>"

    def _holds(self, asked: dict[str, Any]) -> bool:
        """Whether rows are there, all of what is asked for now."""
        if "run.json" not in self._place.names():
            return False
        record = unsealed(self._place.read("run.json"))
        if record is not None and record.get("asked") != asked:
            raise InputError(
                f"{self._place}: holds results of another command or of other options; "
                "overwrite=True makes them again"
            )
        return record is not None

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

    def save(self, key: str, row: dict[str, Any]) -> dict[str, Any]:
        """Keep a row; it is on disk within a second, or after `flush`.

        Parameters
        ----------
        key : str
            Key of the task.
        row : dict
            What the task returned.

        Returns
        -------
        dict
            The same row.
        """
        record = {"key": key, "asked": self._asked, "row": row}
        self._waiting.append(json.dumps(sealed(record), separators=(",", ":")))
        if time.monotonic() - self._flushed_s >= _FLUSH_S:
            self.flush()
        return row

    def flush(self) -> None:
        """Store the rows that are not yet."""
        if self._waiting:
            name = f"{self._next:06d}-{secrets.token_hex(4)}.jsonl"
            self._place.write(name, "\n".join(self._waiting) + "\n")
            self._next += 1
            self._waiting = []
        self._flushed_s = time.monotonic()
