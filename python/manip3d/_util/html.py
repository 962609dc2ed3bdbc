"""Pages of HTML that load nothing, and their tables."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence

from manip3d._util.texts import legible


class Html(str):
    """Text that is HTML already."""

    __slots__ = ()


def as_html(text: str) -> str:
    """Return a text as HTML, with control characters as visible escapes; `Html` as it is."""
    return text if isinstance(text, Html) else html.escape(legible(text))


def html_page(title: str, style: str, content: str) -> str:
    """Return a page; ``title`` is text, and ``content`` is HTML."""
    return (
        "<!doctype html><html lang=en><meta charset=utf-8>"
        '<meta name=viewport content="width=device-width">'
        f"<title>{html.escape(title)}</title><style>{style}</style><main>{content}</main></html>\n"
    )


def html_table(heads: Iterable[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of texts; pages of a narrow screen scroll what has the class ``wide``."""
    names = list(heads)
    head = "".join(f"<th>{as_html(name)}</th>" for name in names)
    body = "\n".join(
        "<tr>" + "".join(f"<td>{as_html(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return wide(", ".join(names), f"<table>\n<tr>{head}</tr>\n{body}\n</table>")


def wide(name: str, content: str) -> str:
    """Return HTML that narrow screens scroll, which the keyboard reaches; ``name`` says what."""
    label = html.escape(legible(name))
    return f'<div class="wide" tabindex="0" role="region" aria-label="{label}">{content}</div>'
