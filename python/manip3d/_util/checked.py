"""Check of the arguments of public functions against their annotations."""

from __future__ import annotations

import ast
import builtins
import collections.abc
import functools
import inspect
import operator
import os
import sys
from collections.abc import Callable, Mapping
from typing import Any, Literal, TypeVar, cast, get_args, get_origin

import numpy as np

from manip3d._util.arrays import (
    CONVERSION_ERRORS,
    masked_elements,
    one_line,
    unreadable_words,
)
from manip3d.errors import InputError

_Checked = TypeVar("_Checked", bound=Callable[..., Any])


def _has_64_bits(value: Any) -> bool:
    # `value in range(...)` would iterate over the range if value is no plain int (NumPy's scalars).
    return -(2**63) <= operator.index(value) < 2**63


def checked(function: _Checked) -> _Checked:
    """Refuse arguments whose types do not match the annotations, before the function runs.

    The decorated function raises an `InputError` that names the argument, the expected type and the
    value. For a class, the constructor and its own public methods are decorated.

    Parameters
    ----------
    function : callable
        A function, method or class.

    Notes
    -----
    Checked are annotations of numbers, strings, choices (``Literal``), paths, containers, classes,
    unions of these, ``ArrayLike`` (an array of numbers), and aliases. An argument whose annotation
    has any other part is not checked. NumPy's scalars are passed on as Python's numbers.

    Every public function and class whose arguments may be wrong has this decorator. Exceptions are
    the types of `manip3d.mesh`, ``camera``, ``rgbd`` and `LidarFrame`: they convert their arrays,
    also lists and other dtypes, and check all arguments themselves.
    """
    if isinstance(function, type):
        for name, member in tuple(vars(function).items()):
            if inspect.isfunction(member) and (name == "__init__" or not name.startswith("_")):
                setattr(function, name, checked(member))
        return function
    names = tuple(inspect.signature(function).parameters)

    @functools.cache  # evaluated at the first call, when all names of the module are defined
    def kinds() -> Mapping[str, _Kind]:
        return _kinds_of(function)

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        expected = kinds()
        for name, value in (*zip(names, args, strict=False), *kwargs.items()):
            kind = expected.get(name)
            if kind is not None and not kind.accepts(value):
                raise InputError(f"{name}{kind.complaint(value)}")
        return function(*map(_plain, args), **{n: _plain(value) for n, value in kwargs.items()})

    return cast("_Checked", wrapper)


def _plain(value: Any) -> Any:
    """Return NumPy's scalars as Python's numbers, because JSON cannot write NumPy's."""
    return value.item() if isinstance(value, np.number | np.bool_) else value


class _Kind:
    """Types that one annotation accepts, and their description for error messages."""

    def __init__(
        self,
        text: str,
        accepts: Callable[[Any], bool],
        item: _Kind | None = None,
        *,
        is_array: bool = False,
    ) -> None:
        self.text = text
        self.accepts = accepts
        self.item = item  # type of the items of a sequence, else None
        self.is_array = is_array  # whether NumPy makes an array of the value

    def __str__(self) -> str:
        return self.text

    def complaint(self, value: Any) -> str:
        """Return the text after the argument's name in an error message.

        For a sequence it names the first item of a wrong type.
        """
        if self.item is not None and _is_sequence(value):
            for index, each in enumerate(value):
                if not self.item.accepts(each):
                    return f"[{index}]{self.item.complaint(each)}"
        found = _unreadable(value) if self.is_array else ""
        return f": expected {self}, got {found or _shown(value)}"


def _is_number(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in "iuf"
    if isinstance(value, int) and not isinstance(value, bool):
        return _has_64_bits(value)
    return isinstance(value, float | np.integer | np.floating)


def _is_whole(value: Any) -> bool:
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    return is_whole and _has_64_bits(value)


def _is_array(value: Any) -> bool:
    if masked_elements(value):
        return False
    try:
        return np.asarray(value).dtype.kind in "biuf"
    except CONVERSION_ERRORS:
        return False


_ARRAY = _Kind("an array of numbers", _is_array, is_array=True)
_NUMPY_ARRAY = _Kind(
    "a NumPy array of numbers", lambda value: isinstance(value, np.ndarray) and _is_array(value)
)
_SIMPLE: dict[Any, _Kind] = {
    None: _Kind("None", lambda value: value is None),
    bool: _Kind("True or False", lambda value: isinstance(value, bool | np.bool_)),
    int: _Kind("a whole number of 64 bits", _is_whole),
    float: _Kind("a number", _is_number),
    str: _Kind("a text", lambda value: isinstance(value, str)),
    bytes: _Kind("bytes", lambda value: isinstance(value, bytes)),
    os.PathLike: _Kind("a path", lambda value: isinstance(value, os.PathLike)),
}


def _kinds_of(function: Callable[..., Any]) -> dict[str, _Kind]:
    # Modules may import types only under TYPE_CHECKING, so that names of the package are added.
    shared = vars(builtins) | vars(collections.abc) | vars(sys.modules["manip3d"])
    names = shared | getattr(inspect.unwrap(function), "__globals__", {})
    found = {}
    for name, parameter in inspect.signature(function).parameters.items():
        note = parameter.annotation
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        if isinstance(note, str):
            kind = _kind_of(ast.parse(note, mode="eval").body, names)
            if kind is not None:
                found[name] = kind
    return found


def _kind_of(note: ast.expr, names: Mapping[str, Any]) -> _Kind | None:
    """Return the accepted types of an annotation; None if it cannot be checked here."""
    if isinstance(note, ast.Name) and note.id == "ArrayLike":
        return _ARRAY
    if isinstance(note, ast.BinOp):
        return _either(_kind_of(note.left, names), _kind_of(note.right, names))
    if isinstance(note, ast.Constant):
        if isinstance(note.value, str):  # a quoted annotation
            return _kind_of(ast.parse(note.value, mode="eval").body, names)
        return _SIMPLE[None] if note.value is None else None
    if isinstance(note, ast.Subscript):
        if isinstance(note.value, ast.Name) and note.value.id == "NDArray":
            return _NUMPY_ARRAY
        return _kind_of_generic(_resolved(note.value, names), note.slice, names)
    found = _resolved(note, names)
    if isinstance(found, TypeVar):
        found = getattr(found.__bound__, "__forward_arg__", found.__bound__)
    if isinstance(found, str):  # an alias
        return _kind_of(ast.parse(found, mode="eval").body, names)
    return _kind_of_class(found)


def _either(left: _Kind | None, right: _Kind | None) -> _Kind | None:
    if left is None or right is None:
        return None
    return _Kind(
        f"{left} or {right}",
        lambda value: left.accepts(value) or right.accepts(value),
        is_array=left.is_array or right.is_array,
    )


def _resolved(note: ast.expr, names: Mapping[str, Any]) -> Any:
    """Return the object that a dotted name refers to at run time, or None."""
    if isinstance(note, ast.Attribute):
        return getattr(_resolved(note.value, names), note.attr, None)
    return names.get(note.id) if isinstance(note, ast.Name) else None


def _kind_of_class(found: Any) -> _Kind | None:
    if found in _SIMPLE and found is not None:
        return _SIMPLE[found]
    if get_origin(found) is Literal:
        return _kind_of_choice(get_args(found))
    if isinstance(found, type) and found not in (object, Any):
        return _Kind(found.__name__, lambda value: isinstance(value, found))
    return None


def _kind_of_choice(words: str | tuple[str, ...]) -> _Kind:
    """Return the type that accepts the strings of a `Literal`."""
    choices = (words,) if isinstance(words, str) else words
    *others, last = map(repr, choices)
    return _Kind(
        f"{', '.join(others)} or {last}" if others else last,
        lambda value: isinstance(value, str) and value in choices,
    )


def _kind_of_generic(origin: Any, inner: ast.expr, names: Mapping[str, Any]) -> _Kind | None:
    if origin is Literal:
        return _kind_of_choice(ast.literal_eval(inner))
    if origin is os.PathLike:
        return _SIMPLE[os.PathLike]
    if origin is type or origin is None:
        return None
    if origin is tuple:
        return _kind_of_tuple(inner, names)
    if origin in (collections.abc.Sequence, list):
        item = _kind_of(inner, names)
        return _Kind(
            "a sequence" if item is None else f"a sequence, each {item}",
            lambda value: (
                _is_sequence(value) and (item is None or all(item.accepts(each) for each in value))
            ),
            item,
        )
    if isinstance(origin, type):
        return _Kind(
            f"a {origin.__name__.lower()}",
            lambda value: isinstance(value, origin) and not isinstance(value, str | bytes),
        )
    return None


def _is_sequence(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, collections.abc.Sequence) and not isinstance(value, str | bytes)


def _kind_of_tuple(inner: ast.expr, names: Mapping[str, Any]) -> _Kind | None:
    parts = inner.elts if isinstance(inner, ast.Tuple) else [inner]
    if isinstance(parts[-1], ast.Constant) and parts[-1].value is Ellipsis:
        return _kind_of_generic(collections.abc.Sequence, parts[0], names)
    items = [_kind_of(part, names) for part in parts]
    return _Kind(
        f"{len(items)} values: " + ", ".join(str(item or "any") for item in items),
        lambda value: (
            _is_sequence(value)
            and len(value) == len(items)
            and all(
                item is None or item.accepts(each) for item, each in zip(items, value, strict=True)
            )
        ),
    )


def _shown(value: Any) -> str:
    """Return a value for an error message, shortened and safe for a terminal."""
    if masked := masked_elements(value):
        return f"an array with {masked}"
    if isinstance(value, np.ndarray) and value.ndim:
        return f"an array of {value.dtype} of shape {value.shape}"
    return one_line(value)


def _unreadable(value: Any) -> str:
    """Return words on an array of another library that NumPy cannot read as numbers.

    '' for other values.
    """
    if not hasattr(value, "__array__") or isinstance(value, type | np.ndarray | np.generic):
        return ""
    try:
        array = np.asarray(value)
    except CONVERSION_ERRORS as error:
        return unreadable_words(value, error)
    if array.dtype.kind != "O":
        return ""
    # pandas has numbers that may be missing, and NumPy has none.
    name = type(value).__name__
    return f"a {name} that NumPy reads as objects; make it numbers first (.to_numpy(float))"
