"""OpenNI2 without hardware: its Dummy device, a spot that walks over a 320 x 240 image."""

from __future__ import annotations

import numpy as np
import pytest

from manip3d import DeviceError, InputError, Intrinsics, capture

CAMERA = Intrinsics(320, 240, 285.0, 285.0, 159.5, 119.5)
SCHEME = next(scheme for scheme in capture.sources() if scheme.name == "openni2")

pytestmark = pytest.mark.skipif("not built" in SCHEME.reason, reason=SCHEME.reason)


def test_the_dummy_device_streams() -> None:
    with capture.open_rgbd("openni2:Dummy", camera=CAMERA) as source:
        assert source.is_live
        frames = [source.read(timeout=20.0) for _ in range(8)]
        while len(frames) < 300 and all(frame and frame.color is None for frame in frames):
            frames.append(source.read(timeout=20.0))
        counters = source.counters
    numbers: list[int] = []
    colored = 0
    for frame in frames:
        assert frame is not None
        assert (frame.depth[0] == 2000).all()  # the driver draws a bar at the top
        spot = frame.depth[1:]
        assert 0 < (spot > 0).sum() < 300
        assert abs(int(spot[spot > 0].mean()) - 1000) < 1000
        assert frame.time_ns == frame.number * 33_000_000
        # The driver's two clocks drift: colour that is too old is left out, and counted.
        colored += frame.color is not None
        if frame.color is not None:
            assert frame.color.shape == (240, 320, 3)
            assert frame.color[0, 0].tolist() == [0, 0, 255]  # blue in the corner: R, G, B
        numbers.append(frame.number)
    assert (np.diff(numbers) > 0).all()
    assert colored > 0
    assert len(frames) - colored <= counters["without_color"]
    missed = numbers[-1] - numbers[0] + 1 - len(numbers)
    assert counters["dropped"] + counters["lost_by_camera"] >= missed
    assert source.calibration.depth.fx == 285.0


def test_it_can_be_stopped_and_opened_again() -> None:
    source = capture.open_rgbd("openni2:Oz", camera=CAMERA)
    assert source.read(timeout=20.0) is not None
    source.stop()
    while source.read() is not None:  # the frame that waited
        pass
    source.start()
    assert source.read(timeout=20.0) is not None
    source.stop()


def test_a_device_that_does_not_tell_its_field_of_view_needs_a_camera() -> None:
    with pytest.raises(InputError, match="openni2:Dummy tells no field of view"):
        capture.open_rgbd("openni2:Dummy")


def test_there_is_no_such_device() -> None:
    with pytest.raises(DeviceError, match="openni2: cannot open"):
        capture.open_rgbd("openni2:nowhere", camera=CAMERA)
