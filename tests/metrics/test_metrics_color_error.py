"""Colour error: known changes, borders between colours, coincident sheets, bad input."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from manip3d import InputError, Mesh, metrics, simplify
from manip3d.metrics import color_error
from metrics_oracles import plane


def colored(size: int, color: object) -> Mesh:
    """A square of side 8 with a colour for all vertices, or one for each."""
    mesh = plane(size)
    colors: NDArray[np.uint8] = np.empty((mesh.num_vertices, 3), dtype=np.uint8)
    colors[:] = color
    return mesh.replace(vertices=mesh.vertices * (8 / size), colors=colors)


def ramp(size: int, scale: float = 1.0) -> Mesh:
    """Red grows from 0 to 240 times the scale along x; the other channels are 0."""
    mesh = plane(size)
    red = np.rint(240 * scale * mesh.vertices[:, 0] / size)
    return colored(size, np.stack([red, 0 * red, 0 * red], axis=-1))


def test_same_colors_on_other_faces() -> None:
    error = color_error(ramp(8), ramp(4))
    assert (error.mean, error.rms, error.max) == pytest.approx((0, 0, 0), abs=1e-9)
    assert error.samples == 128


def test_a_change_is_the_root_mean_square_of_its_channels() -> None:
    error = color_error(colored(8, [100, 100, 100]), colored(3, [103, 96, 100]))
    assert (error.mean, error.rms, error.max) == pytest.approx((np.sqrt(25 / 3),) * 3, rel=1e-12)


def test_black_beside_white_is_255() -> None:
    assert color_error(colored(2, 0), colored(2, 255)).max == pytest.approx(255, rel=1e-12)


def test_known_slope() -> None:
    """Red is wrong by up to 48 at x = 8: by 24 on average, by 48 / sqrt(3) in root mean square."""
    error = color_error(ramp(8), ramp(8, 0.8), samples=200_000)
    assert error.mean == pytest.approx(24 / np.sqrt(3), rel=5e-3)
    assert error.rms == pytest.approx(48 / 3, rel=5e-3)
    assert error.max == pytest.approx(48 / np.sqrt(3), rel=5e-3)


def test_a_border_between_two_colors_is_no_error() -> None:
    """Two halves with colours of their own, whose vertices lie at one place along the border."""
    left, right = colored(4, [200, 0, 0]), colored(4, [0, 0, 200])
    assert left.colors is not None
    assert right.colors is not None

    def both(order: tuple[Mesh, Mesh]) -> Mesh:
        first, second = order
        assert first.colors is not None
        assert second.colors is not None
        return Mesh(
            np.vstack([first.vertices, second.vertices]),
            np.vstack([first.faces, second.faces + first.num_vertices]),
            colors=np.vstack([first.colors, second.colors]),
        )

    right = right.replace(vertices=right.vertices + np.array([8, 0, 0]))
    assert color_error(both((left, right)), both((right, left)), samples=5000).max < 1e-9


def test_either_side_of_a_sheet_of_two_faces_counts() -> None:
    sheet = colored(1, [250, 250, 250])
    back = sheet.replace(colors=np.zeros((4, 3), dtype=np.uint8))
    assert sheet.colors is not None
    assert back.colors is not None
    both = Mesh(
        np.vstack([sheet.vertices, back.vertices]),
        np.vstack([sheet.faces, back.faces[:, ::-1] + 4]),
        colors=np.vstack([sheet.colors, back.colors]),
    )
    assert color_error(sheet, both).max < 1e-9
    assert color_error(back, both).max < 1e-9


def test_a_simplified_picture_loses_more_without_a_price_of_colors() -> None:
    mesh = plane(40)
    inside = np.hypot(*(mesh.vertices[:, :2] - 20).T) < 12
    painted = mesh.replace(colors=np.where(inside[:, None], [220, 30, 30], 240).astype(np.uint8))
    kept, lost = (
        color_error(painted, simplify.quality(painted, ratio=0.05, color_weight=weight).mesh)
        for weight in (0.01, 0.0)
    )
    assert kept.mean < 0.5 * lost.mean


def test_it_is_part_of_the_comparison() -> None:
    found = metrics.compare(ramp(8), ramp(3, 0.9))
    assert found.color_error == color_error(ramp(8), ramp(3, 0.9))
    assert metrics.compare(ramp(8), plane(3)).color_error is None


@pytest.mark.parametrize("missing", ["original", "simplified"])
def test_a_mesh_without_colors_is_refused(missing: str) -> None:
    meshes = {"original": ramp(2), "simplified": ramp(2)}
    meshes[missing] = plane(2)
    with pytest.raises(InputError, match=f"{missing}: expected a mesh with colours"):
        color_error(**meshes)


def test_bad_options_are_refused() -> None:
    with pytest.raises(InputError, match="epsilon"):
        color_error(ramp(2), ramp(2), epsilon=-1.0)
    with pytest.raises(InputError, match="samples"):
        color_error(ramp(2), ramp(2), samples=0)
