"""The legend in the corner of a picture of points."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.viewer.points import Classes, DrawnPoints, Scale, ramp
from manip3d.viewer.scene import pillow

if TYPE_CHECKING:
    from manip3d.viewer.scene import Image, Rgb

# Sizes in pixels.
LINE = 18  # height of a line of text
BAR = (130, 9)  # width and height of the colour bar
SWATCH = 9
EDGE = 10  # distance from the picture's border
INSET = 8  # distance from the panel's border
MIN_SIZE = (240, 180)  # smaller pictures get no legend


def with_legend(image: Image, points: DrawnPoints, background: Rgb) -> Image:
    """Draw the legend into the lower left corner of a picture, unless the picture is too small."""
    rows = _rows(points)
    if not rows or image.shape[1] < MIN_SIZE[0] or image.shape[0] < MIN_SIZE[1]:
        return image
    panel = _panel(rows, background)
    height = min(panel.shape[0], image.shape[0] - 2 * EDGE)
    width = min(panel.shape[1], image.shape[1] - 2 * EDGE)
    top = image.shape[0] - EDGE - height
    whole = image.copy()
    whole[top : top + height, EDGE : EDGE + width] = panel[:height, :width]
    return whole


def number(value: float) -> str:
    """Format a number with three significant digits."""
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def end_texts(scale: Scale) -> list[str]:
    """Return the texts at both ends of the colour bar."""
    return [f"{number(end)} {scale.unit}".strip() for end in scale.ends]


def _rows(points: DrawnPoints) -> list[tuple[str, Any]]:
    """Return kind and content of each line."""
    rows: list[tuple[str, Any]] = []
    first = points.columns[0] if points.columns else None
    if isinstance(first, Scale):
        rows += [("text", first.name), ("bar", None), ("ends", end_texts(first))]
    if isinstance(first, Classes):
        counted = zip(first.labels, first.palette, first.counts(), strict=True)
        rows += [("dot", (f"{label} ({n:,})", color)) for label, color, n in counted]
    rows += [("line", (lines.name, lines.color)) for lines in points.lines]
    return rows


def _panel(rows: list[tuple[str, Any]], background: Rgb) -> Image:
    module = pillow()
    from PIL import ImageDraw, ImageFont

    font = ImageFont.load_default(size=13)
    texts = [content if kind == "text" else content[0] for kind, content in rows if kind != "bar"]
    widest = max(font.getlength(str(text)) for text in texts)
    width = int(max(BAR[0], widest + 2 * SWATCH) + 2 * INSET)
    panel = module.new("RGB", (width, LINE * len(rows) + INSET), background)
    draw = ImageDraw.Draw(panel)
    ink = (30, 34, 40) if sum(background) > 384 else (230, 233, 238)
    for i, (kind, content) in enumerate(rows):
        middle = INSET // 2 + LINE * i + LINE // 2
        left = INSET
        if kind == "bar":
            panel.paste(module.fromarray(_bar()), (left, middle - BAR[1] // 2))
            continue
        if kind == "ends":
            draw.text((left, middle), content[0], fill=ink, font=font, anchor="lm")
            draw.text((left + BAR[0], middle), content[1], fill=ink, font=font, anchor="rm")
            continue
        if kind == "dot":
            draw.ellipse(_around(left, middle, SWATCH), fill=content[1])
        if kind == "line":
            draw.rectangle((left, middle - 1, left + SWATCH, middle + 1), fill=content[1])
        text = content if kind == "text" else content[0]
        at = left if kind == "text" else left + 2 * SWATCH
        draw.text((at, middle), text, fill=ink, font=font, anchor="lm")
    return np.asarray(panel)


def _around(left: int, middle: int, size: int) -> tuple[int, int, int, int]:
    return left, middle - size // 2, left + size, middle + size // 2 + 1


def _bar() -> Image:
    levels = np.rint(np.linspace(0.0, 255.0, BAR[0])).astype(np.uint8)
    return np.repeat(ramp()[levels][None], BAR[1], axis=0)
