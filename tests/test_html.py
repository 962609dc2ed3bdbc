"""Tables of HTML pages."""

from __future__ import annotations

from manip3d._util.html import Html, html_table


def test_a_table_shows_texts_as_they_are_and_control_characters_as_escapes() -> None:
    rows = [["<b>bold</b>", "\x1b[31m"], [Html("<b>bold</b>"), "two\nlines"]]
    assert html_table(["one", "&"], rows) == (
        '<div class="wide" tabindex="0" role="region" aria-label="one, &amp;"><table>\n'
        "<tr><th>one</th><th>&amp;</th></tr>\n"
        "<tr><td>&lt;b&gt;bold&lt;/b&gt;</td><td>\\x1b[31m</td></tr>\n"
        "<tr><td><b>bold</b></td><td>two\nlines</td></tr>\n"
        "</table></div>"
    )
