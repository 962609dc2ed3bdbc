"""The evidence of one inspected RGB-D stream as a self-contained HTML page, or as JSON."""

from __future__ import annotations

import base64
import html
import os
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from manip3d import __version__
from manip3d._util.checked import checked
from manip3d._util.html import html_page, html_table
from manip3d._util.texts import counted
from manip3d.authenticate import depth_noise
from manip3d.authenticate._stream_marks import without_marks
from manip3d.authenticate._stream_verdict import NO_POWER_HERE
from manip3d.errors import InputError
from manip3d.report._evidence import PAGE_STYLE
from manip3d.report._evidence_files import sha256_of_source, write_page_or_record
from manip3d.rgbd import RgbdFrame, check_frames, numbered
from manip3d.viewer.people import depth_picture
from manip3d.viewer.pictures import png_bytes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate import StreamInspection

_MAX_FRAMES = 6  # largest number of frames that are shown
_MARK = np.array([230.0, 94.0, 0.0])  # red, green and blue of inserted pixels
_WIDTH, _HEIGHT = 720, 180  # size of a curve in SVG user units
_FIGURE_STYLE = (
    "figure{display:inline-block;margin:0 .6rem .6rem 0}figcaption{font-size:.85rem}"
    "svg{width:100%;height:auto}"
)


@checked
def write_stream_evidence(
    inspection: StreamInspection,
    frames: Iterable[RgbdFrame],
    output: str | os.PathLike[str],
    *,
    source: str = "stream",
) -> None:
    """Write the results of the detectors on an RGB-D stream as one file.

    Parameters
    ----------
    inspection : StreamInspection
        The result of `manip3d.authenticate.inspect_stream`.
    frames : iterable of RgbdFrame
        Frames of the stream. Those that were judged are found by their numbers; others are ignored.
    output : path
        Output file. ``.html``: a self-contained page with frames, their inserted pixels, and curves
        of the noise; ``.json``: the numbers. An existing file is replaced.
    source : str
        Name of the stream, for the title.

    Raises
    ------
    InputError
        The suffix is neither of the two, or ``frames`` has no frame that was judged, or images of
        another size (``.html``).
    MissingExtraError
        Pillow, which draws the frames, is not installed.

    Examples
    --------
    >>> from manip3d import authenticate, capture, report
    >>> frames = list(capture.open_rgbd("folder:walk"))  # doctest: +SKIP
    >>> found = authenticate.inspect_stream(frames)  # doctest: +SKIP
    >>> report.write_stream_evidence(found, frames, "walk.html")  # doctest: +SKIP
    """
    write_page_or_record(
        output,
        page=lambda: _page(inspection, _judged(inspection, frames), source),
        record=lambda: {"source": source} | inspection.record(),
    )


def _judged(inspection: StreamInspection, frames: Iterable[RgbdFrame]) -> list[RgbdFrame]:
    """The frames that were judged, with depth 0 where a constant marks missing pixels."""
    some = list(frames)
    check_frames("frames", some)
    by_number = {frame.number: frame for frame in numbered(some, range(len(some)))}
    judged = [by_number[n] for n in inspection.numbers.tolist() if n in by_number]
    if not judged:
        raise InputError("frames: expected the frames that were judged, got none of them")
    sizes = {frame.depth.shape for frame in judged} | {mask.shape for mask in inspection.masks}
    if len(sizes) > 1:
        raise InputError("frames: expected the frames that were judged, got images of another size")
    return without_marks(judged)[0]


def _page(inspection: StreamInspection, frames: Sequence[RgbdFrame], source: str) -> str:
    verdict = inspection.verdict
    camera = frames[0].calibration.depth
    content = (
        f"<h1 class={verdict}>{verdict}</h1><p>{html.escape(inspection.reason)}</p>"
        f"<p>{html.escape(source)}: judged {_count(inspection)} of {camera.width} x "
        f"{camera.height} pixels. No verdict says that a stream is authentic.</p>"
        + _facts(inspection, source)
        + html_table(
            ("detector", "verdict", "score", "why"),
            [
                (r.name, r.verdict, "" if r.score is None else f"{r.score:.3f}", r.reason)
                for r in inspection.detectors
            ],
        )
        + "<h2>Frames; what was inserted is orange</h2>"
        + _frames(inspection, frames)
        + _curves(inspection, frames)
        + "<h2>How many streams of manip3d forge stream are found</h2>"
        + _power(inspection)
        + f"<p>The threshold was fixed on {inspection.calibration.num_scans} clean frames: "
        f"{html.escape(inspection.calibration.scenes)}. Note: "
        f"{html.escape(inspection.calibration.note)}.</p>"
    )
    return html_page(f"{source}: {verdict}", PAGE_STYLE + _FIGURE_STYLE, content)


def _power(inspection: StreamInspection) -> str:
    if not inspection.power:
        return f"<p>{NO_POWER_HERE}</p>"
    return html_table(
        ("kind of forgery", "found", "of which"),
        [
            (name, f"{power.share:.0%}", f"{power.found} of {power.planted}")
            for name, power in inspection.power.items()
        ],
    )


def _count(inspection: StreamInspection) -> str:
    return counted(len(inspection.numbers), "frame")


def _facts(inspection: StreamInspection, source: str) -> str:
    facts = [f"manip3d {__version__}"]
    digest, of_what = sha256_of_source(source)
    if digest:
        facts.append(f"SHA-256 of {of_what}: {digest}")
    facts += [f"{step.kind}: {step.detail}" for step in inspection.processing]
    return "<ul>" + "".join(f"<li>{html.escape(fact)}</li>" for fact in facts) + "</ul>"


def _frames(inspection: StreamInspection, frames: Sequence[RgbdFrame]) -> str:
    """Return pictures of up to six frames, evenly spread over the stream."""
    masks = dict(zip(inspection.numbers.tolist(), inspection.masks, strict=False))
    places = np.linspace(0, len(frames) - 1, min(_MAX_FRAMES, len(frames))).round().astype(int)
    shown = []
    for place in places.tolist():
        frame = frames[place]
        mask = masks.get(frame.number)
        pixels = 0 if mask is None else int(mask.sum())
        caption = f"frame {frame.number}, {frame.time_ns / 1e9:.2f} s" + (
            f", {counted(pixels, 'pixel')} inserted" if pixels else ""
        )
        data = base64.b64encode(png_bytes(_marked(frame, mask))).decode()
        shown.append(
            f'<figure><img width=300 alt="{caption}" src="data:image/png;base64,{data}">'
            f"<figcaption>{caption}</figcaption></figure>"
        )
    return "<div>" + "".join(shown) + "</div>"


def _marked(frame: RgbdFrame, mask: NDArray[np.bool_] | None) -> NDArray[np.uint8]:
    """Return a picture of the depth in grey and the mask in orange, of at most 640 columns."""
    picture = depth_picture(frame.depth)
    if mask is not None:
        picture[mask] = (0.5 * picture[mask] + 0.5 * _MARK).astype(np.uint8)
    step = -(-picture.shape[1] // 640)
    return np.ascontiguousarray(picture[::step, ::step])


def _curves(inspection: StreamInspection, frames: Sequence[RgbdFrame]) -> str:
    noise = np.array([depth_noise(frame.depth).mean() for frame in frames])
    pairs = inspection.noise
    text = "<h2>Noise of the depth</h2>" + _curve(
        noise, f"Mean noise of each frame, mm; median {np.median(noise):.3g}"
    )
    if len(pairs):
        text += _curve(
            pairs,
            f"Relative change of the noise from frame to frame, as published; "
            f"median {np.median(pairs):.4f}",
        )
    return text


def _curve(values: NDArray[np.float64], caption: str) -> str:
    """Return a curve of values over the frames, with an axis from 0 to the largest value."""
    top = float(values.max()) or 1.0
    across = np.linspace(40.0, _WIDTH - 10.0, max(2, len(values)))
    up = _HEIGHT - 20.0 - (_HEIGHT - 40.0) * values / top
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(across, up, strict=False))
    base = _HEIGHT - 20
    return (
        f"<p>{html.escape(caption)}</p><svg viewBox='0 0 {_WIDTH} {_HEIGHT}' role=img "
        f"aria-label='{html.escape(caption)}'>"
        f"<path d='M40 20V{base}H{_WIDTH - 10}' fill=none stroke=#999></path>"
        f"<text x=36 y=24 font-size=11 text-anchor=end>{top:.3g}</text>"
        f"<text x=36 y={base} font-size=11 text-anchor=end>0</text>"
        f"<polyline points='{points}' fill=none stroke=#0072B2 stroke-width=1.5></polyline></svg>"
    )
