"""What can be drawn and shown on this machine."""

from __future__ import annotations

import pytest

from manip3d import Mesh, RenderError
from manip3d.viewer import _chromium
from manip3d.viewer.page import BUNDLE


@pytest.fixture
def bundle() -> None:
    if not BUNDLE.exists():
        pytest.skip("the viewer is not built: make setup")


@pytest.fixture
def chromium(bundle: None) -> None:
    pytest.importorskip("PIL.Image")
    try:
        _chromium.program()
    except RenderError as error:
        pytest.skip(str(error))


@pytest.fixture
def quad() -> Mesh:
    """A square with its texture upright, seen from +z.

    (0,1) 3---2 (1,1)
          | / |          faces 0 1 2 (lower right), 0 2 3 (upper left)
    (0,0) 0---1 (1,0)
    """
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    triangles = [[0, 1, 2], [0, 2, 3]]
    return Mesh(corners, triangles, texcoords=[c[:2] for c in corners], face_texcoords=triangles)
