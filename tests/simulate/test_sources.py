"""``sim:`` addresses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from manip3d import InputError
from manip3d.simulate import Street, drive, open_source, scenes, terrestrial_scan
from manip3d.simulate.sources import open_drive, watched_street

pytest.importorskip("open3d")


def test_a_street_gives_its_drive(busy_street: Street) -> None:
    address = "sim:street?seed=3&frames=2&start=1.5"
    frames = list(open_source(address))
    expected = list(drive(busy_street, 2, start=1.5, pictures=False, rng=3))
    assert len(frames) == 2
    for got, made in zip(frames, expected, strict=True):
        np.testing.assert_array_equal(got.points, made.scan.points)
        np.testing.assert_array_equal(got.fields["label"], made.scan.label)
        assert got.time_ns == 946_728_000 * 10**9 + round(made.time_s * 1e9)
        assert got.source == address
        assert got.origin == (0.0, 0.0, 0.0)


def test_a_scene_gives_one_scan() -> None:
    (frame,) = open_source("sim:indoor-02?resolution=3&seed=5")
    scan = terrestrial_scan(scenes.make("indoor-02"), resolution_deg=3.0, rng=5)
    np.testing.assert_array_equal(frame.points, scan.points)
    np.testing.assert_array_equal(frame.fields["object"], scan.object)


@pytest.mark.parametrize(
    ("address", "text"),
    [
        ("kitti:street", "address: expected sim:..., got 'kitti:street'"),
        ("sim:moon", "address: expected sim:street or a scene"),
        ("sim:street?seed=x", "seed: expected a number, got 'x'"),
        ("sim:street?seed=-1", "seed: expected >= 0, got -1"),
        ("sim:street?resolution=1", "option resolution; expected some of frames, seed, start"),
        ("sim:indoor-00?frames=2", "unknown option frames"),
        ("sim:indoor-00?resolution=0", "resolution_deg: expected 1e-4 to 10 degrees"),
        ("sim:indoor-00?resolution=", "resolution: expected a number, got ''"),
        ("sim:street?frames=1#x", "address: expected nothing after a #"),
        ("sim:street?seed=1&seed=2", "seed: expected it once, got it twice"),
        ("sim:body?frames=2&frames=3", "frames: expected it once, got it twice"),
    ],
)
def test_bad_addresses_are_refused(address: str, text: str) -> None:
    with pytest.raises(InputError, match=text.replace("?", r"\?")):
        list(open_source(address))


@pytest.mark.parametrize(("asked", "told"), [(5, 2), (1, 1), (None, 2)])
def test_a_watched_street_states_how_long_it_is(asked: int | None, told: int) -> None:
    watched = watched_street("sim:street?frames=2&seed=3", frames=asked)
    assert watched.num_frames == told


@pytest.mark.parametrize("opened", [open_drive, watched_street])
def test_a_drive_s_address_has_each_option_once(opened: Callable[[str], Any]) -> None:
    for address, words in (
        ("sim:street?seed=1&seed=2", "seed: expected it once"),
        ("sim:street#x", "nothing after a #"),
    ):
        with pytest.raises(InputError, match=words):
            opened(address)
