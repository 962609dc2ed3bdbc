"""Damaged messages of a page give a valid message or a FormatError, and no other error."""

from __future__ import annotations

import random

import pytest

from manip3d import FormatError
from manip3d.phantom import MESSAGES
from manip3d.serve import read_message

CASES = 20_000
SEEDS = (
    '{"type":"ack","sequence":12,"decoded_ms":1767225600000.125}',
    '{"type":"choose","game":"bubbles","difficulty":3}',
    '{"type": "ready"}',
    '{"type":"stop"}',
    '{"type":"event","text":"fell \\u00e9"}',
    '{"type":"ownership","mode":"synchronous","q1":-3,"q2":3,"q3":0,"q4":1,"q5":2,"q6":-1}',
    '{"type":"felt","length":50,"telescoping":10,"raised":-30,"bent":0}',
    '{"type":"gain","value":1.5}',
    '{"type":"pain","value":7,"page":4294967295,"number":12}',
    '{"type":"unwell","page":1,"number":1}',
    '{"type":"enough","page":2,"number":3}',
    '{"type":"unanswered","page":2,"number":4}',
    '{"type":"screen"}',
    '{"type":"bad"}',
)
TYPES = MESSAGES
PIECES = (
    "{",
    "}",
    "[",
    "]",
    '"',
    ":",
    ",",
    "\\",
    "\\ud800",
    "\x00",
    "NaN",
    "-",
    "1e999",
    "0" * 300,
)
PIECES += ("true", "null", '"type"', '"ack"', "é", "\udcff", " ", "9" * 30, ".", "[" * 200)


def damaged(text: str, chance: random.Random) -> str:
    for _ in range(chance.randint(1, 4)):
        at = chance.randint(0, len(text))
        to = min(len(text), at + chance.choice((0, 0, 1, 1, 2, 9)))
        text = text[:at] + chance.choice((*PIECES, "")) * chance.choice((1, 1, 1, 8)) + text[to:]
    return text


def outcome(text: str) -> tuple[str, dict[str, int | float | str]] | FormatError:
    try:
        return read_message(text, TYPES)
    except FormatError as error:
        return error


@pytest.mark.parametrize("seed", SEEDS)
def test_undamaged_examples_are_read(seed: str) -> None:
    assert read_message(seed, TYPES)[0] in TYPES


def test_damaged_messages_end_in_errors_of_ours() -> None:
    chance = random.Random(0)
    num_read = 0
    for _ in range(CASES):
        text = damaged(chance.choice(SEEDS), chance)
        found = outcome(text)
        if isinstance(found, FormatError):
            assert str(found).isprintable()
            continue
        num_read += 1
        name, fields = found
        needed = {field for field, kind in TYPES[name].items() if not kind.optional}
        assert needed <= fields.keys() <= TYPES[name].keys()
        for field, value in fields.items():
            kind = TYPES[name][field]
            assert isinstance(value, kind.type)
            if kind.choices:
                assert value in kind.choices
            elif kind.type is str:
                assert len(str(value)) <= kind.length
            else:
                assert kind.low <= float(value) <= kind.high
    assert 0 < num_read < CASES
