"""Docstrings of public functions and classes name what goes in, what comes back, and examples."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import inspect
import io
import itertools
import re
import tokenize
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from numpydoc.validate import validate

import manip3d

ROOMS = (
    "authenticate",
    "batch",
    "capture",
    "datasets",
    "diary",
    "experiments",
    "forge",
    "io",
    "metrics",
    "modify",
    "phantom",
    "report",
    "serve",
    "simplify",
    "simulate",
    "study",
    "viewer",
)

WITHOUT_ERRORS = {
    "capture.sources",
    "datasets.cache_folder",
    "datasets.data_root",
    "io.guess_depth_unit",
    "io.is_url",
    "simulate.street",
    "study.px_per_degree",
    "study.reversal_mean",
    "study.state_of",
    "viewer.has_display",
}
"""Functions that raise nothing of their own."""

WITHOUT_EXAMPLE = {
    "simulate.drive",
    "simulate.stereo_pair",
    "simulate.terrestrial_scan",
    "simulate.write_drive",
    "study.make_jnd_stimuli",
    "study.make_rating_stimuli",
    "study.run_study",
}
"""Functions whose smallest input is too large for a docstring."""


IMPERATIVES = re.compile(
    "(Add|Analyse|Append|Bring|Call|Combine|Compare|Compute|Convert|Copy|Count|Delete|Describe|Detect"
    "|Displace|Draw|Embed|Enclose|Estimate|Find|Fit|Forge|Guess|Inject|Insert|Judge|Leave|Let|Lift"
    "|Look|Make|Match|Measure|Move|Open|Plant|Play|Read|Reduce|Refuse|Remove|Render|Resample|Return|Run|Say"
    "|Scale|Scan|Score|Segment|Serve|Show|Simplify|Simulate|Take|Tell|Triangulate|Turn|Verify|Write"
    "|Yield) "
)
"""Verbs that the summary of a public function may begin with; add one where it says more."""

QUESTION = re.compile(r"(How|What|When|Where|Which|Who|Why)\b")
"""Openings of a summary that name a question instead of the thing."""


def public_functions() -> Iterator[tuple[str, Callable[..., Any]]]:
    for room in ROOMS:
        module = importlib.import_module(f"manip3d.{room}")
        for name in module.__all__:
            thing = getattr(module, name)
            if inspect.isfunction(thing):
                yield f"{room}.{name}", thing


FUNCTIONS = dict(public_functions())


def sections(function: Callable[..., Any] | type) -> dict[str, str]:
    """Text of each section of a numpydoc docstring, by its title."""
    parts = re.split(r"^([A-Z][A-Za-z ]+)\n-+\n", inspect.getdoc(function) or "", flags=re.M)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def described(parameters: str) -> set[str]:
    """Names on the left of a `Parameters` section: ``a, b : int`` describes two."""
    heads = [line.partition(":")[0] for line in parameters.split("\n") if line[:1].strip()]
    return {name.strip(" *") for head in heads for name in head.split(",")}


def bare(parameters: str) -> list[str]:
    """Numbers, flags, texts and choices without a word about them; a `Mesh` explains itself."""
    lines = [*parameters.rstrip().split("\n"), ""]
    return [
        line
        for line, following in itertools.pairwise(lines)
        if re.match(r"\S.* : (int|float|str|bool|')", line) and not following.startswith(" ")
    ]


# One test for all names: a test of its own for each took longer to start than to run.
SECTIONS = {name: sections(function) for name, function in FUNCTIONS.items()}


def test_numbers_flags_and_texts_are_described() -> None:
    found = {name: bare(each.get("Parameters", "")) for name, each in SECTIONS.items()}
    assert {name: lines for name, lines in found.items() if lines} == {}


def test_what_comes_back_is_described() -> None:
    silent = [name for name, each in SECTIONS.items() if not {"Returns", "Yields"} & set(each)]
    results = {name: inspect.signature(FUNCTIONS[name]).return_annotation for name in silent}
    assert {name: it for name, it in results.items() if it not in ("None", None)} == {}


def test_errors_are_described() -> None:
    without = {name for name, each in SECTIONS.items() if "Raises" not in each}
    assert without <= WITHOUT_ERRORS


def test_there_is_an_example() -> None:
    without = {name for name, each in SECTIONS.items() if ">>>" not in each.get("Examples", "")}
    assert without <= WITHOUT_EXAMPLE


def test_the_summary_is_in_the_imperative() -> None:
    summaries = {name: inspect.getdoc(function) or "" for name, function in FUNCTIONS.items()}
    assert [name for name, text in summaries.items() if not IMPERATIVES.match(text)] == []


def public_classes() -> Iterator[tuple[str, type]]:
    for room in ROOMS:
        module = importlib.import_module(f"manip3d.{room}")
        for name in module.__all__:
            thing = getattr(module, name)
            if inspect.isclass(thing) and thing.__module__.startswith("manip3d."):
                yield f"{room}.{name}", thing


CLASSES = dict(public_classes())


def described_fields(of: type) -> set[str]:
    """Names that the docstrings of a class and of those that it is derived from describe."""
    found = [sections(each) for each in of.__mro__ if each.__module__.startswith("manip3d")]
    return {
        name
        for each in found
        for title in ("Attributes", "Parameters")
        for name in described(each.get(title, ""))
    }


def test_each_class_says_what_it_is() -> None:
    docstrings = {name: vars(thing).get("__doc__") or "" for name, thing in CLASSES.items()}
    nameless = [
        name
        for name, docstring in docstrings.items()
        # dataclass makes a signature of none
        if not docstring or docstring.startswith(f"{CLASSES[name].__name__}(")
    ]
    assert nameless == []


def public_fields(of: type) -> set[str]:
    fields = dataclasses.fields(of) if dataclasses.is_dataclass(of) else ()
    return {field.name for field in fields if not field.name.startswith("_")}


def test_each_field_is_described() -> None:
    lacking = {name: public_fields(it) - described_fields(it) for name, it in CLASSES.items()}
    assert {name: fields for name, fields in lacking.items() if fields} == {}


def test_each_method_says_what_it_does() -> None:
    members = [(name, *each) for name, it in CLASSES.items() for each in public_members(it)]
    assert [f"{name}.{member}" for name, member, it in members if not inspect.getdoc(it)] == []


def public_members(of: type) -> Iterator[tuple[str, Any]]:
    """Methods and properties that the class or a base class in this package defines."""
    bases = [base for base in reversed(of.__mro__) if base.__module__.startswith("manip3d.")]
    members = {name: member for base in bases for name, member in vars(base).items()}
    for name, member in members.items():
        if not name.startswith("_") and (
            isinstance(member, property | functools.cached_property)
            or inspect.isroutine(getattr(of, name))
        ):
            yield name, getattr(of, name)


NUMPYDOC = {
    *(
        "GL01",
        "GL02",
        "GL03",
        "GL05",
        "GL06",
        "GL07",
        "GL09",
        "GL10",
    ),  # quotes, sections
    *("SS01", "SS02", "SS03", "SS04", "SS06"),  # a summary: one line with a capital and a full stop
    *("PR01", "PR02", "PR05", "PR06", "PR09", "PR10"),  # each parameter and no other, its type
    *("RT05", "YD01"),  # what comes back
}
"""Checks of `numpydoc` that this package agrees with.

The others ask for sections that not everything needs (ES, EX, SA), for an order and a description
of each parameter of its own where several share one (PR03, PR04, PR07), for a capital where a
description begins with a symbol of the paper (PR08, RT04), for one returned value (RT01 to RT03),
and for a verb in the summary of a property (SS05). GL08 does not know inherited docstrings.
"""


def checks_of(name: str) -> dict[str, set[str]]:
    """The checks of a public name and of its members."""
    if name not in CLASSES:
        return {name: NUMPYDOC}
    found = {f"{name}.{member}": NUMPYDOC for member, _ in public_members(CLASSES[name])}
    return found | {name: NUMPYDOC - {"PR01"}}  # fields may be described as attributes


BY_ROOM: dict[str, list[str]] = {}
for _name in (*FUNCTIONS, *CLASSES):
    BY_ROOM.setdefault(_name.rpartition(".")[0], []).append(_name)


@pytest.mark.parametrize("room", BY_ROOM)
def test_numpydoc_finds_nothing(room: str) -> None:
    errors = [
        (each, *error)
        for name in BY_ROOM[room]
        for each, checks in checks_of(name).items()
        for error in validate(f"manip3d.{each}")["errors"]
        if error[0] in checks
    ]
    assert not errors


def test_summaries_of_a_class_name_the_thing_and_no_question() -> None:
    members = [(name, *each) for name, it in CLASSES.items() for each in public_members(it)]
    members += [(name, "", it) for name, it in CLASSES.items()]
    asking = [each[:2] for each in members if QUESTION.match(inspect.getdoc(each[2]) or "")]
    assert asking == []


def test_descriptions_name_what_they_describe() -> None:
    """``level : int`` is "Level of ...", not "Of ...", so that each description stands alone."""
    fragment = re.compile(r"^( +)\S.* : .+\n\1    (Of|That|(By|In|After|Up to) which) .*", re.M)
    root = Path(manip3d.__file__).parent
    found = [
        f"{path.relative_to(root)}: {match[0]}"
        for path in sorted(root.rglob("*.py"))
        for match in fragment.finditer(path.read_text())
    ]
    assert not found


FRAGMENT = re.compile(
    r"(@(param|return)( \w+)?\s+)?(Of|So|That|Else|Where|What|As|How|Who|Whom|Whose)\b"
)
"""Openings without a subject, which the reader has to guess: "Of the table; others are counted"."""
PERHAPS_FRAGMENT = re.compile(rf"[#:rR\"'/*<]\s*{FRAGMENT.pattern}")
"""A file without a match has no such opening, and need not be taken apart."""


def comments_of_python(text: str) -> Iterator[tuple[int, str]]:
    """Line and beginning of each comment and docstring; a block of comments is one."""
    last = 0
    begins = True  # a statement
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        line = token.start[0]
        if token.type == tokenize.COMMENT:
            if line != last + 1:
                yield line, token.string.lstrip("#: ")
            last = line
        elif token.type == tokenize.STRING and begins:
            yield line, token.string.lstrip("rR\"' ")
        if token.type not in (tokenize.COMMENT, tokenize.NL):
            begins = token.type in (tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)


def comments_of_cpp(text: str) -> Iterator[tuple[int, str]]:
    """Line and beginning of each comment; lines of nothing but a comment that follow are one."""
    goes_on = False
    for line, content in enumerate(text.splitlines(), 1):
        found = re.search(r"(?:^|\s)(?://+<?|/\*+)\s*(.*)", content)
        alone = found is not None and not content[: found.start()].strip()
        if found and (not (goes_on and alone) or found[1].startswith("@")):
            yield line, found[1]
        goes_on = found is not None


def test_comments_do_not_begin_with_fragments() -> None:
    """Each comment has its subject: "Share of clean scans ...", not "Of clean scans ..."."""
    root = Path(__file__).parents[1]
    readers = {".py": comments_of_python} | dict.fromkeys((".cpp", ".hpp", ".ts"), comments_of_cpp)
    found = [
        f"{path.relative_to(root)}:{line}: {comment[:60]}"
        for folder in ("python/manip3d", "tests", "benchmarks", "cpp")
        for suffix, reader in readers.items()
        for path in sorted((root / folder).rglob(f"*{suffix}"))
        if not {"node_modules", "dist"} & set(path.parts)
        if PERHAPS_FRAGMENT.search(text := path.read_text())
        for line, comment in reader(text)
        if FRAGMENT.match(comment)
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("reader", "text", "lines"),
    [
        (comments_of_python, '"""Of a table."""\nX = 1  # So far.\n# A\n# That is A.\n', [1, 2]),
        (comments_of_python, 'claim = Claim(\n    "Of all methods"\n)\n"""That one."""\n', [4]),
        (comments_of_python, 'def f():\n    r"""Else none."""\n    return "Of course"\n', [2]),
        (comments_of_python, '"""What is read."""\nX = 1  # How.\n# A\n# Where A is.\n', [1, 2]),
        (comments_of_cpp, "/// Of a\n/// So b\nint x;  ///< Else y.\n", [1, 3]),
        (comments_of_cpp, "/// A.\n/// @param x  That of y\nauto s = 1;\n", [2]),
        (comments_of_cpp, "/// As for y.\nint x;  ///< Who wrote it.\n", [1, 2]),
    ],
)
def test_fragments_are_noticed(reader: Any, text: str, lines: list[int]) -> None:
    assert PERHAPS_FRAGMENT.search(text)
    assert [line for line, comment in reader(text) if FRAGMENT.match(comment)] == lines


def test_exceptions_exist() -> None:
    assert set(FUNCTIONS) >= WITHOUT_ERRORS | WITHOUT_EXAMPLE


def test_the_guide_of_authenticate_names_each_function() -> None:
    """More than a hundred names: the package's docstring groups them by what they are for."""
    from manip3d import authenticate

    named = set(re.findall(r"`(\w+)`", authenticate.__doc__ or ""))
    functions = {name.removeprefix("authenticate.") for name in FUNCTIONS if "authenticate" in name}
    assert sorted(functions - named) == []
    assert sorted(named - set(authenticate.__all__)) == []
