"""Frames as messages: what the page reads is what the pipeline made, within the steps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import capsule_body
from frame_reader import picture, read_frame
from manip3d import InputError, _core
from manip3d.modify import PhantomFrame, PhantomPipeline
from manip3d.serve import encode_frame


def shown() -> PhantomFrame:
    frame = capsule_body.painted(0)
    v, u = np.mgrid[0 : frame.depth.shape[0], 0 : frame.depth.shape[1]]
    color = np.stack([u % 256, v % 256, 0 * u + 90], axis=-1).astype(np.uint8)
    return PhantomPipeline("right_arm").process(replace(frame, color=color))


SHOWN = shown()


def test_a_frame_comes_back_within_the_steps() -> None:
    message = encode_frame(
        SHOWN, {"a": [1, "é"]}, sequence=7, time_ns=-5, captured_ns=12345, jpeg_quality=95
    )
    found = read_frame(message)
    assert (found.sequence, found.time_ns, found.captured_ns) == (7, -5, 12345)
    assert found.status == {"a": [1, "é"]}
    assert found.opacity == SHOWN.opacity
    extent = np.ptp(SHOWN.vertices.astype(np.float64), axis=0)
    off = np.abs(found.vertices - SHOWN.vertices)
    assert (off <= 0.51 * extent / 65535 + 1e-6).all()


def test_body_and_phantom_are_ranges_in_the_order_of_the_faces() -> None:
    found = read_frame(encode_frame(SHOWN, {}, sequence=0))
    chosen = SHOWN.phantom_faces
    assert 0 < chosen.sum() < len(chosen)
    np.testing.assert_array_equal(found.body, SHOWN.faces[~chosen])
    np.testing.assert_array_equal(found.phantom, SHOWN.faces[chosen])


def test_texels_are_those_of_the_image() -> None:
    pytest.importorskip("PIL")
    found = read_frame(encode_frame(SHOWN, {}, sequence=0, jpeg_quality=100))
    assert found.is_shared
    image = picture(found.body_jpeg).astype(int)
    assert SHOWN.color is not None
    height, width = SHOWN.color.shape[:2]
    assert image.shape[0] < height  # the region of the body alone
    colored = found.texels[:, 0] < 65535
    assert colored.mean() > 0.9
    np.testing.assert_array_equal(colored, np.isfinite(SHOWN.texcoords).all(axis=1))
    at = found.texels[colored] / 65534 * [image.shape[1], image.shape[0]]
    column, row = np.minimum(at.astype(int), [image.shape[1] - 1, image.shape[0] - 1]).T
    u, v = SHOWN.texcoords[colored].T
    expected = np.stack([u * width, (1 - v) * height], axis=-1) - 0.5
    off = np.abs(image[row, column, :2] - expected)
    assert np.median(off) < 2.0  # of 256 levels: one a pixel, and JPEG's own
    assert np.percentile(off, 99) < 8.0


def test_a_held_phantom_keeps_its_own_image() -> None:
    pytest.importorskip("PIL")
    assert SHOWN.color is not None
    older = np.full_like(SHOWN.color, (250, 0, 0))
    found = read_frame(encode_frame(replace(SHOWN, phantom_color=older), {}, sequence=0))
    assert not found.is_shared
    assert picture(found.phantom_jpeg)[..., 0].min() > 240
    assert picture(found.body_jpeg)[..., 2].max() < 130
    assert len(found.phantom_jpeg) < len(found.body_jpeg)


def test_opacity_goes_along() -> None:
    assert read_frame(encode_frame(replace(SHOWN, opacity=0.25), {}, sequence=0)).opacity == 0.25


def test_without_colours_there_are_none() -> None:
    bare = replace(SHOWN, color=None, phantom_color=None)
    found = read_frame(encode_frame(bare, {}, sequence=0))
    assert (found.body_jpeg, found.phantom_jpeg) == (b"", b"")
    assert (found.texels == 65535).all()


def test_nothing_to_draw_is_a_frame_too() -> None:
    found = read_frame(encode_frame(None, {"state": "lost"}, sequence=2**32 - 1))
    assert found.sequence == 2**32 - 1
    assert len(found.vertices) == len(found.body) == len(found.phantom) == 0
    assert found.status == {"state": "lost"}


def arguments(n: int = 3) -> dict[str, Any]:
    return {
        "vertices": np.zeros((n, 3), np.float32),
        "texcoords": np.zeros((n, 2), np.float32),
        "phantoms": np.zeros(n, np.uint8),
        "faces": np.array([[0, 1, 2]], np.int32),
        "color": None,
        "phantom_color": None,
        "opacity": 1.0,
        "sequence": 0,
        "time_ns": 0,
        "captured_ns": 0,
        "status": "{}",
        "jpeg_quality": 80,
    }


def test_more_vertices_than_16_bits_have_wide_indices() -> None:
    given = arguments(70_000) | {"faces": np.array([[0, 65_536, 69_999]], np.int32)}
    found = read_frame(_core.encode_stream_frame(**given))
    np.testing.assert_array_equal(found.body, [[0, 65_536, 69_999]])


def test_a_single_place_and_huge_extents_are_finite() -> None:
    for scale in (0.0, 1e-30, 3.4e38):
        vertices = np.float32([[-scale, 0, 1], [scale, 0, 1], [0, 0, 1]])
        found = read_frame(_core.encode_stream_frame(**arguments() | {"vertices": vertices}))
        np.testing.assert_allclose(found.vertices, vertices, atol=2 * scale / 65535)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"vertices": np.full((3, 3), np.nan, np.float32)}, "vertices: expected finite"),
        ({"vertices": np.zeros((2, 3), np.float32)}, "vertices: expected 3 for each"),
        ({"vertices": np.zeros((3, 2), np.float32)}, r"vertices: expected shape \(N, 3\)"),
        ({"texcoords": np.zeros((4, 2), np.float32)}, "texcoords: expected 2 for each"),
        ({"faces": np.array([[0, 1, 3]], np.int32)}, "faces: expected indices below 3, got 3"),
        ({"faces": np.array([[0, 1, -1]], np.int32)}, "faces: expected indices below 3, got -1"),
        ({"color": np.zeros((0, 4, 3), np.uint8)}, "color: expected 1 to 16384 pixels"),
        ({"color": np.zeros((4, 4), np.uint8)}, r"color: expected shape \(H, W, 3\)"),
        ({"opacity": float("nan")}, "opacity: expected 0 to 1"),
        ({"opacity": 1.5}, "opacity: expected 0 to 1"),
        ({"jpeg_quality": 0}, "jpeg_quality: expected 1 to 100, got 0"),
    ],
)
def test_bad_frames(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        _core.encode_stream_frame(**arguments() | wrong)
