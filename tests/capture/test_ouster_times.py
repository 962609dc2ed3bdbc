"""Times of an Ouster's scans some of whose columns are missing, without ouster-sdk."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from manip3d.capture._ouster import OusterRecording


def scan(stamps: list[int]) -> Any:
    """A scan of two rays a column, as ouster-sdk has it: missing columns have the time 0."""
    reach = np.where(np.array([stamps, stamps]) > 0, 2000, 0).astype(np.uint32)
    return SimpleNamespace(
        sensor_info=SimpleNamespace(prod_line="OS-1-2"),
        packet_timestamp=np.zeros(1, np.uint64),
        timestamp=np.array(stamps, np.uint64),
        fields=["RANGE"],
        field=lambda name: reach,
        complete=lambda: False,
    )


@pytest.mark.parametrize(
    ("stamps", "expected"), [([0, 7_000_000_000, 5_000_000_000], 5.0), ([0, 0, 0], None)]
)
def test_the_time_of_a_scan_is_that_of_its_first_column_that_came(
    stamps: list[int], expected: float | None
) -> None:
    recording = OusterRecording.__new__(OusterRecording)
    recording._uri, recording._counters = "ouster:a.pcap", {"no_return": 0}
    recording._core = SimpleNamespace(XYZLut=lambda info, **_: lambda reach: np.ones((2, 3, 3)))
    frame = recording._to_frame(scan(stamps))
    assert frame.format is not None
    assert frame.format.header["sensor_time"] == expected
