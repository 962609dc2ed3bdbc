"""Names of recordings of UDP packets, and of the files that are read with them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import PurePath

PACKETS = (".pcap", ".pcapng")
"""Suffixes of recordings of UDP packets."""


def ouster_metadata_names(recording: PurePath) -> Iterator[str]:
    """Yield the names that the JSON file beside an Ouster's packets may have, the best first.

    Ouster's programs write ``drive.json`` or, with the sensor's number, ``drive_0.json`` beside
    ``drive.pcap``, and name an excerpt of that recording ``drive_part.pcap``.
    """
    begin = recording.stem
    yield f"{begin}.json"
    yield f"{begin}_0.json"
    while begin := begin.rpartition("_")[0]:
        yield f"{begin}.json"
