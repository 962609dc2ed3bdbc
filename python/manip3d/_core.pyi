"""
C++ core of manip3d. Private: use the typed functions of the package.
"""

from __future__ import annotations

import typing

import numpy

__all__: list[str] = ["bounding_box", "check_mesh"]

def bounding_box(mesh: typing.Any) -> numpy.ndarray: ...
def check_mesh(mesh: typing.Any) -> None: ...

__version__: str = "0.1.0"

def __getattr__(name: str) -> typing.Any: ...
