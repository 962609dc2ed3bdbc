"""Which scanner made a scan, told from the elevations of its points; scans made of directions."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from manip3d.authenticate import identify_sensor
from manip3d.authenticate._sensors import BEAM_WIDTH, BEAMS

COUNT = 8000


def scan_of(
    elevations: NDArray[np.float64], *, blur: float = 0.0, turn: float = 360.0, seed: int = 0
) -> NDArray[np.float32]:
    """Points at random azimuths and distances; ``blur``: degrees around the elevations."""
    random = np.random.default_rng(seed)
    elevation = np.radians(random.choice(elevations, COUNT) + random.normal(0.0, blur, COUNT))
    azimuth = np.radians(random.uniform(-turn / 2, turn / 2, COUNT))
    level = np.cos(elevation)
    beam = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    return (beam * random.uniform(4.0, 40.0, (COUNT, 1))).astype(np.float32)


@pytest.mark.parametrize("model", BEAMS)
def test_lasers_at_a_makers_elevations_name_the_model(model: str) -> None:
    found = identify_sensor(scan_of(BEAMS[model], blur=0.03))
    assert (found.name, found.kind) == (model, "spinning")
    assert found.reason.endswith("% of the points at its lasers' elevations")
    assert found.lattice is None


@pytest.mark.parametrize("model", BEAMS)
def test_lasers_beside_them_do_not(model: str) -> None:
    """A mount that tilts, or a unit of another maker."""
    apart = float(np.diff(np.sort(BEAMS[model])).min())
    shifted = BEAMS[model] + (0.5 * apart if apart < 4 * BEAM_WIDTH else 2 * BEAM_WIDTH)
    assert identify_sensor(scan_of(shifted)).name != model


def test_a_part_of_the_points_beside_the_lasers_is_another_scanner() -> None:
    mixed = np.concatenate([np.tile(BEAMS["VLP-32C"], 20), np.linspace(-25, 15, 300)])
    assert identify_sensor(scan_of(mixed, blur=0.03)).name != "VLP-32C"


def test_a_model_needs_more_than_half_of_its_lasers() -> None:
    """Sixteen of 32 whole degrees could be any scanner's."""
    some = np.sort(BEAMS["Hesai PandarXT-32"])
    assert identify_sensor(scan_of(some[:24], blur=0.03)).name == "Hesai PandarXT-32"
    assert identify_sensor(scan_of(some[:12], blur=0.03)).name != "Hesai PandarXT-32"


@pytest.mark.parametrize("lasers", [12, 40, 100])
def test_other_lasers_are_counted(lasers: int) -> None:
    found = identify_sensor(scan_of(np.linspace(-21.37, 17.91, lasers)))
    assert (found.name, found.kind) == ("spinning scanner", "spinning")
    assert found.reason == f"the points stand on {lasers} elevations"


def test_no_rows_are_no_spinning_scanner() -> None:
    anywhere = np.linspace(-20.0, 20.0, 100_000)
    assert identify_sensor(scan_of(anywhere)).kind == "unknown"
    ahead = identify_sensor(scan_of(anywhere, turn=80.0))
    assert (ahead.name, ahead.kind) == ("non-repetitive scanner", "non-repetitive")


def test_few_points_tell_nothing() -> None:
    few = identify_sensor(scan_of(BEAMS["VLP-16"])[:900])
    assert (few.kind, few.reason) == ("unknown", "fewer than 1000 points")
