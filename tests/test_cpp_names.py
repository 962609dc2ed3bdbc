"""A C++ type or function of the core has one definition and one name in the whole namespace.

The linker does not object to two types of one name: it keeps the inline functions of one of them,
which then read memory laid out as the other.
"""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

import pytest

CPP = Path(__file__).parents[1] / "cpp"

NOT_CODE = re.compile(
    r'//[^\n]*|/\*.*?\*/|^[ \t]*#(?:\\\n|[^\n])*|R"\((?:.|\n)*?\)"|"(?:\\.|[^"\\\n])*"'
    r"|(?<![\w])'(?:\\.|[^'\\\n])+'",
    re.MULTILINE | re.DOTALL,
)
NAMESPACE = re.compile(r"\bnamespace\b\s*([\w:]*)\s*$")
TYPE = re.compile(
    r"\b(?:class|struct|union|enum)\s+(?:class\s+|struct\s+)?([\w:]+)\s*(?:final\s*)?(?::.*)?$"
)
FUNCTION = re.compile(r"([\w:~]+|operator\W+)\s*\((.*)\)[^()]*$")
ALIAS = re.compile(r"\busing\s+(\w+)\s*=")


class Definition(NamedTuple):
    scope: str  # its namespace; "{}" stands for one without a name
    name: str  # of a function with the types of its parameters
    file: str


def without_templates(text: str) -> str:
    """Drop template heads, whose parameters look like types."""
    while (start := re.search(r"\btemplate\s*<", text)) is not None:
        depth, end = 1, start.end()
        while depth and end < len(text):
            depth += {"<": 1, ">": -1}.get(text[end], 0)
            end += 1
        text = text[: start.start()] + text[end:]
    return " ".join(text.split())


def parameter_types(text: str) -> str:
    """The types of parameters, without names and default values."""
    parameters, depth, last = [], 0, 0
    for at, letter in enumerate(text + ","):
        depth += {"(": 1, "<": 1, "{": 1, ")": -1, ">": -1, "}": -1}.get(letter, 0)
        if letter == "," and depth <= 0:
            parameters.append(text[last:at].split("=")[0].strip())
            last = at + 1
    return ", ".join(re.sub(r"(?<=[\s&*>])\w+$", "", p).strip() for p in parameters)


def definitions(text: str, file: str) -> tuple[list[Definition], list[Definition]]:
    """Types and functions that a file defines in namespaces: those in classes are left out."""
    types, functions = [], []
    scopes: list[str | None] = []  # None: not a namespace
    statement = ""
    for piece in re.split(r"([{};])", NOT_CODE.sub(" ", text)):
        if statement.count("(") > statement.count(")"):  # braces among arguments
            statement += piece
            continue
        here = "::".join(s for s in scopes if s) if None not in scopes else None
        if piece == "{":
            head = without_templates(statement)
            namespace, kind = NAMESPACE.search(head), TYPE.search(head)
            function = FUNCTION.search(head)
            scopes.append((namespace[1] or "{}") if namespace else None)
            if here is not None and kind and "(" not in head and "::" not in kind[1]:
                types.append(Definition(here, kind[1], file))
            elif here is not None and function and not namespace and function[1] != "catch":
                name = f"{function[1].strip()}({parameter_types(function[2])})"
                functions.append(Definition(here, name, file))
        elif piece == "}":
            if scopes:
                scopes.pop()
        elif piece == ";" and here is not None and (alias := ALIAS.search(statement)):
            types.append(Definition(here, alias[1], file))
        statement = "" if piece in ("{", "}", ";") else piece
    return types, functions


def clashes(files: dict[str, str]) -> list[str]:
    """List names that are defined twice, and names of source files that are public types."""
    known: dict[tuple[str, str], list[Definition]] = defaultdict(list)
    public: dict[str, Definition] = {}
    hidden: list[Definition] = []
    for file, text in files.items():
        types, functions = definitions(text, file)
        for found in [*types, *functions]:
            if "{}" in found.scope:
                continue
            known[found.scope, found.name].append(found)
        for found in types:
            if file.startswith("include/") and "{}" not in found.scope:
                public[found.name] = found
            else:
                hidden.append(found)
    twice = [
        f"{scope}::{name}: {', '.join(d.file for d in places)}"
        for (scope, name), places in known.items()
        if len(places) > 1
    ]
    return twice + [
        f"{d.name}: {d.file} hides the one of {public[d.name].file}"
        for d in hidden
        if d.name in public
    ]


def test_nothing_in_the_core_is_defined_twice() -> None:
    paths = [p for folder in ("include", "src") for p in sorted((CPP / folder).rglob("*.?pp"))]
    files = {p.relative_to(CPP).as_posix(): p.read_text() for p in paths}
    assert sum(len(definitions(text, name)[0]) for name, text in files.items()) > 200
    assert clashes(files) == []


A = "include/manip3d/forge/a.hpp"
B = "include/manip3d/modify/b.hpp"
C = "src/modify/c.cpp"


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({A: "namespace m { struct Place { double x; }; }",
          B: "namespace m {\nstruct Place final : Base { int y; };\n}"}, f"m::Place: {A}, {B}"),
        ({A: "namespace m { enum class Kind : std::uint8_t { kA }; }",
          B: "namespace m { using Kind = int; }"}, f"m::Kind: {A}, {B}"),
        ({A: "namespace m { template <typename T> class Image { T t; }; }",
          C: "namespace m { namespace { struct Image {}; } }"}, f"Image: {C} hides the one of {A}"),
        ({A: "namespace m { inline int twice(int x, const A& a = {}) { return 2 * x; } }",
          B: "namespace m { inline int twice(int value, const A& b) { return value + value; } }"},
         f"m::twice(int, const A&): {A}, {B}"),
    ],
)  # fmt: skip
def test_a_second_definition_is_found(files: dict[str, str], said: str) -> None:
    assert clashes(files) == [said]


@pytest.mark.parametrize(
    "files",
    [
        {A: "namespace m { struct Place { struct Cell { int i; }; }; class Later; }",
         B: "namespace m { struct Other { struct Cell { int j; }; }; struct Place; }"},
        {A: "namespace m { inline int twice(int x) { return 2 * x; } }",
         B: "namespace m { inline double twice(double x) { return 2 * x; } } // struct Place {"},
        {B: "namespace m { namespace { struct Ring { int i; }; } }",
         C: "namespace m { namespace { struct Ring { double d; }; int f() { return 1; } } }"},
        {A: "namespace m { class Stream { struct Memory; }; }",
         C: 'namespace m { struct Stream::Memory { const char* s = "struct Place {"; }; }'},
    ],
)  # fmt: skip
def test_what_is_no_second_definition(files: dict[str, str]) -> None:
    assert clashes(files) == []
