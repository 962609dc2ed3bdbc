"""``python -m manip3d.viewer._probe NAME`` draws a triangle with that renderer, or crashes."""

from __future__ import annotations

import sys

import numpy as np

from manip3d.mesh import Mesh
from manip3d.viewer.pictures import DRAW
from manip3d.viewer.scene import Style, frame


def main(name: str) -> None:
    """Draw a triangle; the exit code is 0 if the picture shows it."""
    triangle = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    style = Style((8, 8), "flat", False, False, False, True, (255, 255, 255))
    image = DRAW[name](triangle, frame(triangle, style.size, 0.0, 0.0, 1.0, "y"), style)
    if np.ptp(image) == 0:
        sys.exit("the picture is empty")


if __name__ == "__main__":
    main(sys.argv[1])
