"""XML that a stranger may have written."""

from __future__ import annotations

import pytest

from manip3d import FormatError
from manip3d._util.text_files import parse_xml_bytes

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
