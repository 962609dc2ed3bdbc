"""Pictures of RGB-D frames and their sheet, in Python and as `capture play` writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import rgbd_frames
from command_line import manip3d
from manip3d import capture, viewer
from manip3d.errors import InputError


def test_the_sheet_is_that_of_capture_play(tmp_path: Path) -> None:
    capture.record(rgbd_frames.frames(5), tmp_path / "walk", lossless_color=True)
    done = manip3d("capture", "play", tmp_path / "walk", "-o", tmp_path / "a.png", "--speed", "0")
    assert done.returncode == 0, done.stderr
    with capture.open_rgbd(f"folder:{tmp_path / 'walk'}") as frames:
        sheet = viewer.sheet([viewer.rgbd_picture(frame) for frame in frames])
    with Image.open(tmp_path / "a.png") as image:
        assert np.array_equal(np.asarray(image), sheet)


def test_pictures_of_several_sizes_have_cells_of_the_largest() -> None:
    white = [np.full(size, 255, np.uint8) for size in ((3, 8, 3), (5, 4, 3))]
    sheet = viewer.sheet(white)
    assert sheet.shape == (5, 16, 3)
    assert sheet[:3, :8].all()
    assert sheet[:, 8:12].all()
    assert not sheet[3:, :8].any()
    assert not sheet[:, 12:].any()


def test_pictures_are_reduced_to_about_400_columns() -> None:
    wide = np.zeros((7, 1200, 3), np.uint8)
    assert viewer.sheet([wide]).shape == (3, 400, 3)


@pytest.mark.parametrize("images", [[], [np.zeros((4, 4), np.uint8)], [np.zeros((4, 4, 3))]])
def test_what_is_no_picture_is_refused(images: list[np.ndarray]) -> None:
    with pytest.raises(InputError, match=r"^images: expected"):
        viewer.sheet(images)
