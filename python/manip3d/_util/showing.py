"""Base class of objects that can be shown in a browser and in a notebook."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path
from typing import Any


class Showable:
    """An object that `manip3d.viewer` can show."""

    __slots__ = ("__weakref__",)

    def show(self, output: str | os.PathLike[str] | None = None, **options: Any) -> Path:
        """Show the object in the browser, or write a page (``.html``) or a picture (``.png``).

        Parameters
        ----------
        output : path, optional
            Output file. Default: a page in the folder for temporary files, which is opened in the
            browser if there is a display.
        **options
            Options of `manip3d.viewer.view`.

        Returns
        -------
        Path
            The file that was written.
        """
        from manip3d.viewer import view

        return view(self, output, **options)

    def _repr_mimebundle_(
        self, include: Collection[str] | None = None, exclude: Collection[str] | None = None
    ) -> dict[str, str | bytes]:
        """Return the object in the forms that notebooks show: viewer, picture and text."""
        from manip3d.viewer.notebook import mimebundle

        return mimebundle(self)
