"""The landmarks of a page that keyboards and screen readers need."""

from __future__ import annotations

from html.parser import HTMLParser

SCROLLED = {"wide", "scroll"}  # classes of elements that narrow screens scroll sideways


class _Page(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.mains = 0
        self.out_of_reach: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        found = dict(attributes)
        self.mains += tag == "main" or found.get("role") == "main"
        if tag == "div" and SCROLLED & set((found.get("class") or "").split()):
            is_reached = found.get("tabindex") == "0" and found.get("role") == "region"
            if not (is_reached and found.get("aria-label")):
                self.out_of_reach.append(self.get_starttag_text() or tag)


def assert_accessible(text: str) -> None:
    """Assert that a page has one main landmark, and that the keyboard reaches what scrolls."""
    page = _Page(text)
    assert page.mains == 1
    assert page.out_of_reach == []
