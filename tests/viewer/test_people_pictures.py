"""Pictures of people: depth, bones, texture, the mesh from the side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from manip3d import InputError
from manip3d.modify import PhantomFrame, PhantomPipeline, PhantomState
from manip3d.simulate import BodyCapture, BodySimulator
from manip3d.viewer import people
from manip3d.viewer.phantom import _pictures

pytest.importorskip("open3d")


@pytest.fixture(scope="module")
def scene() -> tuple[BodyCapture, PhantomFrame]:
    simulator = BodySimulator(amputated="right_arm", side="both", noise=0.0)
    capture = simulator.capture(1.5)
    return capture, PhantomPipeline("right_arm").process(capture.frame)


def test_near_is_light_and_nothing_is_black() -> None:
    picture = people.depth_picture(np.array([[0, 1000, 2000]], np.uint16), near=1000, far=2000)
    assert picture[0, :, 0].tolist() == [0, 245, 55]
    assert people.depth_picture(np.zeros((2, 2), np.uint16)).max() == 0


def test_bones_have_colors_of_their_own() -> None:
    picture = people.label_picture(np.arange(25, dtype=np.uint8)[None])
    assert picture[0, 0].tolist() == [0, 0, 0]
    assert len(np.unique(picture[0], axis=0)) == 25


def test_the_person_has_the_colors_of_the_frame(scene: tuple[BodyCapture, PhantomFrame]) -> None:
    capture, phantom = scene
    color = capture.frame.color
    assert color is not None
    picture = people.textured_picture(phantom, color)
    body = (phantom.kinds > 0) & ~phantom.phantom
    np.testing.assert_array_equal(picture[body], color[body])
    np.testing.assert_array_equal(picture[phantom.kinds == 0], 255)
    row, column = np.nonzero(phantom.phantom)
    source = phantom.source[row, column].T
    np.testing.assert_array_equal(picture[row, column], color[source[0], source[1]])
    without = people.textured_picture(phantom, color, with_phantom=False)
    np.testing.assert_array_equal(without[phantom.phantom], 255)
    older = people.textured_picture(phantom, color, phantom_color=np.zeros_like(color))
    assert (older[phantom.phantom] == 0).all()
    np.testing.assert_array_equal(older[body], color[body])
    assert set(np.unique(people.textured_picture(phantom, None))) == {200, 255}


def test_the_mesh_from_the_front_is_the_person(scene: tuple[BodyCapture, PhantomFrame]) -> None:
    capture, phantom = scene
    color = capture.frame.color
    camera = capture.frame.calibration.depth
    front = people.mesh_picture(phantom, color, camera, azimuth=0.0)
    flat = people.textured_picture(phantom, color)
    inside = (front < 255).any(axis=2) & (flat < 255).any(axis=2)
    assert inside.sum() > 0.85 * (phantom.kinds > 0).sum()
    assert np.abs(front[inside].astype(int) - flat[inside]).mean() < 10.0
    side = people.mesh_picture(phantom, color, camera, azimuth=35.0)
    assert 0.3 < (side < 255).any(axis=2).sum() / inside.sum() < 1.3
    bare = people.mesh_picture(phantom, None, camera)
    assert np.ptp(bare.astype(int), axis=2).max() == 0


def test_a_held_phantom_keeps_the_colours_of_its_frame() -> None:
    """Frames turn from red to blue after the hand is hidden; all have the same number."""
    pipeline = PhantomPipeline("right_arm")
    frames = []
    for number, frame in enumerate(
        BodySimulator(amputated="right_arm", occluder=(0.4, 2.0), frames=16)
    ):
        color = np.zeros((*frame.depth.shape, 3), np.uint8)
        color[..., 0 if number < 12 else 2] = 200
        frames.append(replace(frame, color=color, number=0))
    phantom = [pipeline.process(frame) for frame in frames][-1]
    assert phantom.state is PhantomState.HOLDING
    sheet = people.phantom_sheet(frames[-1], phantom, azimuth=0.0).astype(int)
    red, blue = sheet[..., 0] - sheet[..., 2] > 100, sheet[..., 2] - sheet[..., 0] > 100
    width = phantom.depth.shape[1]
    number = int(phantom.phantom.sum())
    for start in (width, 2 * width):
        part = slice(start, start + width)
        assert red[:, part].sum() == pytest.approx(number, rel=0.2)
        assert blue[:, part].sum() > 3 * number
    *_, (_, last, _) = _pictures(frames, PhantomPipeline("right_arm"), 0.0, 0)
    np.testing.assert_array_equal(last, sheet)


def test_a_sheet_has_three_pictures(scene: tuple[BodyCapture, PhantomFrame]) -> None:
    capture, phantom = scene
    sheet = people.phantom_sheet(capture.frame, phantom)
    assert sheet.shape == (424, 3 * 512, 3)
    np.testing.assert_array_equal(sheet[:, :512], capture.frame.color)
    grey = people.phantom_sheet(replace(capture.frame, color=None), phantom)
    np.testing.assert_array_equal(grey[:, :512], people.depth_picture(capture.frame.depth))
    other = replace(phantom, depth=phantom.depth[:100])
    with pytest.raises(InputError, match="phantom: expected images of"):
        people.phantom_sheet(capture.frame, other)
