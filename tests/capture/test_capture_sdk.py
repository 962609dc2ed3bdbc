"""Cameras by their makers' SDKs, where those are built in; there is no camera on most machines.

What the drivers share is tried without any SDK, in cpp/tests/test_sdk_camera.cpp.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from manip3d import DeviceError, FormatError, InputError, capture
from real_data import RealData

BUILT = [
    scheme.name
    for scheme in capture.sources()
    if scheme.name in ("freenect2", "realsense", "orbbec") and "not built" not in scheme.reason
]
needs_realsense = pytest.mark.skipif("realsense" not in BUILT, reason="librealsense2 is absent")

if not BUILT:
    pytest.skip("no maker's SDK is built in", allow_module_level=True)


@pytest.mark.parametrize("name", BUILT)
def test_a_camera_that_is_not_there(name: str) -> None:
    with pytest.raises(DeviceError, match=f"^{name}: "):
        capture.open(f"{name}:no-such-serial")


@pytest.mark.parametrize("name", BUILT)
def test_unknown_options_are_named(name: str) -> None:
    with pytest.raises(InputError, match=rf"options of {name}: .* got 'color=3'"):
        capture.open(f"{name}:?color=3")


@pytest.mark.parametrize("name", sorted({"realsense", "orbbec"} & set(BUILT)))
def test_files_that_are_none(name: str, tmp_path: Path) -> None:
    path = tmp_path / "walk.bag"
    with pytest.raises(FileNotFoundError):
        capture.open(f"{name}:{path}")
    path.write_bytes(b"no recording\n")
    with pytest.raises((DeviceError, FormatError), match=f"{name}: "):
        capture.open(f"{name}:{path}")


@needs_realsense
def test_a_recording_of_a_d435(realdata: RealData) -> None:
    folder = realdata("rgbd/recording_realsense_d435")
    source = capture.open(f"realsense:{folder / 'single_depth_color_640x480.bag'}")
    assert not source.is_live
    (frame,) = source
    assert source.counters["frames"] == 1
    with Image.open(folder / "extracted_depth_2.png") as image:
        np.testing.assert_array_equal(frame.depth, np.asarray(image))
    # Colour is where both cameras see, and shows the same wall as the colour image does.
    with Image.open(folder / "extracted_color.png") as image:
        whole = np.asarray(image.convert("RGB"), float).reshape(-1, 3)
    assert frame.color is not None
    seen = frame.color[frame.color.any(axis=-1)].astype(float)
    assert 0.2 < len(seen) / frame.depth.size < 0.6
    np.testing.assert_allclose(seen.mean(axis=0), whole.mean(axis=0), atol=15.0)
    assert 380 < source.calibration.depth.fx < 400
