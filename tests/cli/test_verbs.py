"""The list of verbs that --help prints without loading them."""

from __future__ import annotations

import pytest

from manip3d.cli import _VERBS, load

SHORTER = ("info", "view")
"""Verbs whose first line of help is too long for the list."""


@pytest.mark.parametrize("verb", [verb for verb in _VERBS if verb not in SHORTER])
def test_the_list_says_what_the_verb_says(verb: str) -> None:
    assert load(verb).get_short_help_str(200) == _VERBS[verb]


@pytest.mark.parametrize("verb", SHORTER)
def test_short_lines_are_needed(verb: str) -> None:
    assert len(load(verb).get_short_help_str(200)) > len(_VERBS[verb])
