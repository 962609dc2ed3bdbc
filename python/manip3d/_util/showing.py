"""How things show themselves: in a window, and as the result of a notebook's cell."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path
from typing import Any


class Showable:
    """Something that the viewer knows how to show."""

    __slots__ = ()

    def show(self, output: str | os.PathLike[str] | None = None, **options: Any) -> Path:
        """Show it in the browser, or write a page (``.html``) or a picture (``.png``).

        Parameters
        ----------
        output : path, optional
            Where to write; without it a page in the folder for temporary files is opened in the
            browser, where there is a display.
        **options
            As for `manip3d.viewer.view`.

        Returns
        -------
        Path
            The file that shows it.
        """
        from manip3d.viewer import view

        return view(self, output, **options)

    def _repr_mimebundle_(
        self, include: Collection[str] | None = None, exclude: Collection[str] | None = None
    ) -> dict[str, str | bytes]:
        """Return what a notebook shows: the viewer, a picture, and text."""
        from manip3d.viewer.notebook import mimebundle

        return mimebundle(self)
