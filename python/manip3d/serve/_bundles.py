"""The pages that npm builds: a frame of HTML around a script and its style."""

from __future__ import annotations

import html
from pathlib import Path

from manip3d._util.checked import checked
from manip3d.errors import InputError, RenderError
from manip3d.serve._server import Page
from manip3d.viewer.page import BUNDLE

_HTML = """\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="stylesheet" href="/{name}.css">
</head>
<body>
<noscript>This page needs JavaScript.</noscript>
{body}
<script src="/{name}.js"></script>
</body>
</html>
"""


@checked
def bundled_pages(name: str, title: str, body: str) -> dict[str, Page]:
    """Return a page and what it loads, by path, for `LocalServer`.

    Parameters
    ----------
    name : str
        Name of the bundle: ``live`` or ``study``.
    title : str
        Title of the page, as text.
    body : str
        HTML before the script.

    Returns
    -------
    dict of str to Page

    Raises
    ------
    InputError
        There is no bundle of this name.
    RenderError
        The bundle is not built.

    Examples
    --------
    >>> from manip3d import serve
    >>> pages = serve.bundled_pages("study", "My study", "<main></main>")
    >>> sorted(pages), b"My study" in pages["/"].content
    (['/', '/study.css', '/study.js'], True)
    """
    if name not in ("live", "study"):
        raise InputError(f"name: expected live or study, got {name!r}")
    text = _HTML.format(title=html.escape(title), name=name, body=body)
    return {
        "/": Page("text/html; charset=utf-8", text.encode()),
        f"/{name}.js": Page("text/javascript; charset=utf-8", _built(f"{name}.js")),
        f"/{name}.css": Page("text/css; charset=utf-8", _built(f"{name}.css")),
    }


def _built(name: str) -> bytes:
    path: Path = BUNDLE.parent / name
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise RenderError(
            f"the page is not built ({path} is missing): run 'make setup', or "
            f"'npm ci && npm run build' in {path.parents[1]}"
        ) from None
