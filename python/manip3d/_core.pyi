"""
C++ core of manip3d. Private: use the typed functions of the package.
"""

from __future__ import annotations

import typing

import numpy
import numpy.typing

__all__: list[str] = [
    "Duplicates",
    "bounding_box",
    "check_mesh",
    "clean",
    "closest_points",
    "metro",
    "summarize",
]

class Duplicates:
    """
    Members:

      keep

      same

      any
    """

    __members__: typing.ClassVar[dict[str, Duplicates]]
    any: typing.ClassVar[Duplicates]
    keep: typing.ClassVar[Duplicates]
    same: typing.ClassVar[Duplicates]
    @typing.overload
    def __eq__(self, other: Duplicates) -> bool: ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool: ...
    def __getstate__(self) -> int: ...
    def __hash__(self) -> int: ...
    def __index__(self) -> int: ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __int__(self) -> int: ...
    @typing.overload
    def __ne__(self, other: Duplicates) -> bool: ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __str__(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def value(self) -> int: ...

def bounding_box(mesh: typing.Any) -> numpy.ndarray: ...
def check_mesh(mesh: typing.Any) -> None: ...
def clean(mesh: typing.Any, weld: bool, duplicates: Duplicates) -> dict[str, typing.Any]: ...
def closest_points(
    mesh: typing.Any,
    points: numpy.typing.NDArray[numpy.float64],
    threads: typing.SupportsInt | typing.SupportsIndex,
    progress: typing.Any,
) -> tuple[numpy.ndarray, numpy.ndarray, numpy.ndarray]: ...
def metro(
    original: typing.Any,
    simplified: typing.Any,
    area: bool,
    samples: typing.SupportsInt | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex,
    progress: typing.Any,
) -> tuple[tuple[typing.Any, ...], tuple[typing.Any, ...], float]: ...
def summarize(mesh: typing.Any) -> dict[str, typing.Any]: ...

__version__: str = "0.1.0"

def __getattr__(name: str) -> typing.Any: ...
