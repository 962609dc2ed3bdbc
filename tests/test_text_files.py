"""Text and XML that a stranger may have written."""

from __future__ import annotations

from pathlib import Path

import pytest

from manip3d import FormatError
from manip3d._util.text_files import parse_xml_bytes, text_of

EXTERNAL = b'<!DOCTYPE a SYSTEM "a.dtd">'


@pytest.mark.parametrize("content", [b"<a>&b;c</a>", b'<a d="&b;c"/>', b"<a/>"])
def test_an_external_dtd_is_refused_unless_it_does_not_matter(content: bytes) -> None:
    with pytest.raises(FormatError, match="line 1: entities and external DTDs are refused"):
        parse_xml_bytes(EXTERNAL + content, "a.xml")
    alone = b'<?xml version="1.0" standalone="yes"?>' + EXTERNAL + content
    if b"&" in content:
        with pytest.raises(FormatError, match="undefined entity"):
            parse_xml_bytes(alone, "a.xml")
    else:
        assert parse_xml_bytes(alone, "a.xml").tag == "a"


def test_a_byte_order_mark_is_no_part_of_a_text(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(b"\xef\xbb\xbfP0: 1\n\xef\xbb\xbf\xff")
    assert text_of(path) == "P0: 1\n\ufeff\udcff"
