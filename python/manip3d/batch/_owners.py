"""Sources of the outputs of earlier runs, in files beside the rows of a table.

A row is stored only after its output, and not at all for a file that fails: whether an output is a
run's own is known from these lists, which are written before the work begins.
"""

from __future__ import annotations

import json
import os
import secrets
from collections.abc import Mapping

from manip3d._util.json import sealed, unsealed
from manip3d.batch._places import Place
from manip3d.batch._sources import absolute_names
from manip3d.errors import InputError
from manip3d.io._remote import is_url

_PREFIX = "outputs-"


class Owners:
    """The source of each output that earlier runs with one table were to make.

    Parameters
    ----------
    rows : Place
        Folder of the rows.
    names : sequence of str
        Files in it.
    """

    def __init__(self, rows: Place, names: list[str]) -> None:
        self._rows = rows
        self._lists = sorted(name for name in names if name.startswith(_PREFIX))
        self._sources: dict[str, str] = {}
        for name in self._lists:
            record = unsealed(rows.read(name)) or {}
            self._sources |= record.get("outputs", {})

    def refuse_others(
        self, output: Place, sizes: Mapping[str, int], targets: Mapping[str, str | None]
    ) -> None:
        """Refuse to replace an output that an earlier run has not made of the same source.

        Parameters
        ----------
        output : Place
            Folder of the outputs.
        sizes : mapping of str to int
            Files and folders in it by relative name.
        targets : mapping of str to str
            Output of each source.

        Raises
        ------
        InputError
            There is such an output.
        """
        start = len(output.of(""))
        there = {source: t for source, t in targets.items() if t is not None and t[start:] in sizes}
        for target, (place, source) in zip(there.values(), _placed(output, there), strict=True):
            maker = self._sources.get(place)
            if maker != source:
                made = "" if maker is None else f", made of {maker}"
                raise InputError(f"{target}: exists already{made}; overwrite=True replaces it")

    def add(self, output: Place, targets: Mapping[str, str | None]) -> None:
        """Store the sources of outputs that are going to be made."""
        new = {
            p: source for p, source in _placed(output, targets) if self._sources.get(p) != source
        }
        if new:
            name = f"{_PREFIX}{len(self._lists) + 1:06d}-{secrets.token_hex(4)}.json"
            self._rows.write(name, json.dumps(sealed({"outputs": new})))


def _placed(output: Place, targets: Mapping[str, str | None]) -> list[tuple[str, str]]:
    """Return output and source of each task as absolute paths and URLs."""
    folder = output.folder if is_url(output.folder) else os.path.realpath(output.folder)
    start = len(output.of(""))
    sources = absolute_names(targets)
    return [
        (f"{folder}/{target[start:]}", source)
        for target, source in zip(targets.values(), sources, strict=True)
        if target is not None
    ]
