"""HTML pages and their tables."""

from __future__ import annotations

from landmarks import assert_accessible
from manip3d._util.html import Html, html_page, html_table, wide


def test_a_table_shows_texts_as_they_are_and_control_characters_as_escapes() -> None:
    rows = [["<b>bold</b>", "\x1b[31m"], [Html("<b>bold</b>"), "two\nlines"]]
    assert html_table(["one", "&"], rows) == (
        '<div class="wide" tabindex="0" role="region" aria-label="one, &amp;"><table>\n'
        "<tr><th>one</th><th>&amp;</th></tr>\n"
        "<tr><td>&lt;b&gt;bold&lt;/b&gt;</td><td>\\x1b[31m</td></tr>\n"
        "<tr><td><b>bold</b></td><td>two\nlines</td></tr>\n"
        "</table></div>"
    )


def test_a_page_has_landmarks_and_its_title_is_text() -> None:
    page = html_page("<b> & c", "p{margin:0}", wide('a "b"', "<table></table>"))
    assert "<title>&lt;b&gt; &amp; c</title><style>p{margin:0}</style>" in page
    assert_accessible(page)
