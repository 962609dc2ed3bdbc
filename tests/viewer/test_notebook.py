"""The representation of a mesh in a notebook: a viewer, a picture or text."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from manip3d import Mesh, RenderError
from manip3d.viewer import notebook, page, picture


def test_text_is_always_there() -> None:
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    assert nothing._repr_mimebundle_() == {"text/plain": "<manip3d.Mesh: 0 vertices, 0 faces>"}


def test_the_viewer_is_a_frame(bundle: None, quad: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MANIP3D_RENDERER", "none")
    shown = quad._repr_mimebundle_(include=None, exclude=None)
    assert set(shown) == {"text/plain", "text/html"}
    assert str(shown["text/html"]).startswith("<iframe srcdoc=")
    assert shown["text/plain"] == repr(quad)


@pytest.mark.usefixtures("needs_renderer")
def test_a_picture_where_one_can_be_drawn(quad: Mesh) -> None:
    shown = quad._repr_mimebundle_()
    assert bytes(shown["image/png"])[:8] == b"\x89PNG\r\n\x1a\n"  # type: ignore[arg-type]


def test_without_viewer_and_renderer_the_text_says_why(
    quad: Mesh, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("MANIP3D_RENDERER", "none")
    monkeypatch.setattr(page, "BUNDLE", tmp_path / "dist" / "viewer.js")
    page._bundle.cache_clear()
    try:
        shown = quad._repr_mimebundle_()
    finally:
        page._bundle.cache_clear()
    assert set(shown) == {"text/plain"}
    assert "make setup" in str(shown["text/plain"])
    assert "MANIP3D_RENDERER=none" in str(shown["text/plain"])


def test_large_meshes_are_simplified_and_say_so(
    bundle: None, quad: Mesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MANIP3D_RENDERER", "none")
    monkeypatch.setattr(notebook, "SHOWN_FACES", 1)
    text = str(quad._repr_mimebundle_()["text/plain"])
    assert text.startswith(repr(quad))
    assert "2 faces, shown with" in text


def test_huge_meshes_are_text_only(quad: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(notebook, "MAX_FACES", 1)
    shown = quad._repr_mimebundle_()
    assert set(shown) == {"text/plain"}
    assert "manip3d.view(mesh)" in str(shown["text/plain"])


def test_a_renderer_that_cannot_be_imported_leaves_the_text(
    quad: Mesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A renderer that fails to import, as pyvista without ``libGL.so.1``, leaves the text."""
    (tmp_path / "pyvista.py").write_text('raise ImportError("libGL.so.1: cannot open")')
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "pyvista", raising=False)
    monkeypatch.setenv("MANIP3D_RENDERER", "pyvista")
    with pytest.raises(RenderError, match=r"cannot be imported: libGL\.so\.1"):
        picture(quad)
    assert repr(quad) in str(quad._repr_mimebundle_()["text/plain"])
