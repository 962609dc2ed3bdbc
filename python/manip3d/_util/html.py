"""Tables of HTML pages."""

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


def html_table(heads: Iterable[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of texts; pages of a narrow screen scroll what has the class ``wide``."""
    head = "".join(f"<th>{as_html(name)}</th>" for name in heads)
    body = "\n".join(
        "<tr>" + "".join(f"<td>{as_html(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f'<div class="wide"><table>\n<tr>{head}</tr>\n{body}\n</table></div>'
