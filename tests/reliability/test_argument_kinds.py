"""Arguments of wrong kinds: an `InputError` that names the argument, from every public function."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

import kernels
import manip3d

WRONG: dict[str, object] = {
    "object": object(),
    "word": "seven",
    "text with NUL": "a\0b",
    "bytes": b"seven",
    "number": 10.5,
    "negative": -1,
    "huge": 2**70,
    "hugest float": 1e308,
    "nan": float("nan"),
    "infinity": float("inf"),
    "complex": 1j,
    "nothing": None,
    "truth": True,
    "list": [],
    "ragged": [[1, 2], [3]],
    "mapping": {"a": 1},
    "set": {1},
    "function": len,
    "class": int,
    "words": np.array(["a", "b"]),
    "objects": np.array([object(), None]),
    "complex array": np.array([1 + 2j]),
    "nan array": np.full((2, 3), np.nan),
    "empty array": np.empty((0, 3)),
    "dates": np.array(["2020-01-01"], dtype="datetime64[D]"),
    "many axes": np.zeros((1,) * 7),
}


OF_NO_USE = ("object", "class", "set", "complex", "ragged", "objects", "complex array", "dates")
"""What no argument accepts."""


@contextmanager
def recorded(package: Any, name: str) -> Iterator[list[dict[str, Any]]]:
    """Arguments of the calls of a function of a package, by name."""
    function, calls = getattr(package, name), []
    signature = inspect.signature(function)

    def recording(*args: Any, **kwargs: Any) -> Any:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        calls.append(dict(bound.arguments))
        return function(*args, **kwargs)

    setattr(package, name, recording)
    try:
        yield calls
    finally:
        setattr(package, name, function)


def call_with(function: Callable[..., Any], arguments: dict[str, Any]) -> Any:
    positional, named = [], {}
    for name, parameter in inspect.signature(function).parameters.items():
        if parameter.kind is parameter.POSITIONAL_ONLY:
            positional.append(arguments[name])
        elif parameter.kind is parameter.VAR_KEYWORD:
            named |= arguments[name]
        else:
            named[name] = arguments[name]
    return function(*positional, **named)


@pytest.mark.parametrize("name", kernels.KERNELS)
def test_kernels(name: str) -> None:
    package_name, _, function_name = name.partition(".")
    package = importlib.import_module(f"manip3d.{package_name}")
    with recorded(package, function_name) as calls:
        kernels.KERNELS[name](1)
    drive(getattr(package, function_name), calls[0])


def drive(function: Callable[..., Any], arguments: dict[str, Any]) -> None:
    """Call with each argument replaced by each wrong thing."""
    problems = []
    for name in arguments:
        for kind, wrong in WRONG.items():
            if name == "progress" and callable(wrong):
                continue  # right, until it is called
            try:
                call_with(function, arguments | {name: wrong})
            except manip3d.Error as error:
                if kind in OF_NO_USE and name not in str(error):
                    problems.append(f"{name}={kind}: does not name it: {error}")
            except Exception as error:
                problems.append(f"{name}={kind}: {type(error).__name__}: {str(error)[:80]!r}")
            else:
                if kind in OF_NO_USE:
                    problems.append(f"{name}={kind}: accepted")
    assert not problems, "\n".join(problems)
