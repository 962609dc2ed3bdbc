"""Writing of evidence as an HTML page or as JSON, by the suffix of the file."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from manip3d._util.json import finite
from manip3d._util.paths import path_of
from manip3d.errors import InputError
from manip3d.io._files import atomic_write

EVIDENCE_KINDS = (".html", ".json")
"""Suffixes that `write_evidence`, `write_stream_evidence` and `AlertTimeline.write` accept."""


def write_page_or_record(
    output: str | os.PathLike[str],
    page: Callable[[], str],
    record: Callable[[], Mapping[str, Any]],
) -> None:
    """Write the page or the record, by the suffix of ``output``; the other one is not computed."""
    path = path_of(output, "output")
    kind = path.suffix.lower()
    if kind not in EVIDENCE_KINDS:
        raise InputError(f"output: expected a name that ends in .html or .json, got {path.name}")
    text = page() if kind == ".html" else json.dumps(finite(record()), indent=1) + "\n"
    atomic_write(path, page_bytes(text))


def page_bytes(page: str) -> bytes:
    """Encode a page. Names of files may hold bytes that are not UTF-8; these become escapes."""
    return page.encode(errors="backslashreplace")


_SCAN_SCHEMES = ("pcap", "ouster", "kitti", "bag")


def sha256_of_source(source: str) -> tuple[str, str]:
    """Return the SHA-256 of a file or folder, and a phrase that states what was hashed.

    The source may have the scheme of a file or a folder, as ``folder:`` or ``pcap:``; a bag's topic
    and a recording's sensor after ``#`` are ignored. Both are empty if it is neither a file nor a
    folder.
    """
    from manip3d.capture._bag import place_and_topic
    from manip3d.datasets import file_sha256, folder_sha256

    # The functions of os.path, unlike those of Path, are False for a text too long for a path.
    place = Path(source)
    scheme, _, rest = source.partition(":")
    if scheme in ("folder", "mkv", "tum", *_SCAN_SCHEMES) and not os.path.exists(place):
        place = Path(rest)
    place = Path(place_and_topic(f"any:{place}")[0])
    if os.path.isfile(place):
        return file_sha256(place), "the file"
    if os.path.isdir(place):
        return folder_sha256(place), "what sha256sum prints for the files of the folder"
    return "", ""
