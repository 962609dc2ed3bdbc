"""The fragile watermark as printed in the dissertation, to reproduce its tables; not secure."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from manip3d import _core
from manip3d._util.arrays import index_rows, rows
from manip3d._util.checked import checked
from manip3d._util.options import generator_of
from manip3d._util.reprs import short_repr
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame, ScanLike, as_frame, to_scan

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d._util.options import Rng

PaperEmbedding: TypeAlias = Literal["lbm", "qim", "qim-printed"]

PAPER_EMBEDDINGS: tuple[PaperEmbedding, ...] = ("lbm", "qim", "qim-printed")


@dataclass(frozen=True, eq=False)
class PaperMetadata:
    """Metadata that the receiver gets over a secured channel (section 7.3.1).

    Attributes
    ----------
    embedding : 'lbm', 'qim' or 'qim-printed'
        Embedding, see `embed_paper`.
    key_2 : int
        Secret key, 0 to 2**63 - 1, for the assignment of blocks to slices and of bits to points.
    frame : int
        Number of the frame.
    block_bits : int
        M, the number of bits of a block.
    tile_of_slice : (S,) uint16
        Tile of each slice; merged slices have the same tile.
    counts : (T,) uint32
        Number of points of each tile.

    Raises
    ------
    InputError
        ``tile_of_slice`` or ``counts`` is no list of such whole numbers.
    """

    embedding: PaperEmbedding
    key_2: int
    frame: int
    block_bits: int
    tile_of_slice: NDArray[np.uint16] = field(repr=False)
    counts: NDArray[np.uint32] = field(repr=False)

    def __post_init__(self) -> None:
        for name, dtype in (("tile_of_slice", np.uint16), ("counts", np.uint32)):
            object.__setattr__(self, name, rows(getattr(self, name), None, dtype, name))


@dataclass(frozen=True, eq=False)
class PaperMarked:
    """A scan with the printed watermark.

    Attributes
    ----------
    frame : LidarFrame
        The scan with points that carry the watermark.
    metadata : PaperMetadata
        Metadata for the receiver.
    """

    frame: LidarFrame
    metadata: PaperMetadata


@dataclass(frozen=True, eq=False)
class PaperComparison:
    """Comparison of the bits in a scan with the expected bits.

    Attributes
    ----------
    verdict : 'consistent' or 'inconsistent'
        Never authentic, because the bits do not depend on the points.
    mismatches : (T,) int64
        Number of points of each tile whose bits differ; for ``paper_and`` number of bits of its
        block.
    changed_tiles : tuple of int
        Tiles with mismatches or with another number of points.
    suspected : (K,) int32
        Rows of points whose bits differ.
    """

    verdict: Literal["consistent", "inconsistent"]
    mismatches: NDArray[np.int64]
    changed_tiles: tuple[int, ...]
    suspected: NDArray[np.int32] = field(repr=False)

    __repr__ = short_repr


@checked
def noise_blocks(rng: Rng = None, *, slices: int = 36, block_bits: int = 1000) -> NDArray[np.uint8]:
    """Draw a pseudo-random watermark image, the simplest kind of section 7.6.

    Parameters
    ----------
    rng : int, numpy.random.Generator or None
        Seed; the receiver makes the same image from the same seed.
    slices : int
        Number of slices of the full turn.
    block_bits : int
        Number of bits of each slice.

    Returns
    -------
    (slices, block_bits) uint8
        Zeros and ones.

    Raises
    ------
    InputError
        ``slices`` or ``block_bits`` is less than 1.

    Examples
    --------
    >>> from manip3d.authenticate import noise_blocks
    >>> noise_blocks(1, slices=2, block_bits=6).tolist()
    [[1, 1, 0, 0, 1, 1], [0, 1, 0, 1, 0, 1]]
    """
    if slices < 1 or block_bits < 1:
        raise InputError(f"slices, block_bits: expected 1 or more, got {slices}, {block_bits}")
    return generator_of(rng).integers(0, 2, (slices, block_bits), np.uint8)


@checked
def embed_paper(
    scan: ScanLike,
    blocks: ArrayLike,
    *,
    embedding: str = "lbm",
    key_2: int = 0,
    frame: int = 0,
    merge: Literal["adjacent", "paper"] = "adjacent",
) -> PaperMarked:
    """Embed the printed watermark (dissertation section 7.3.1) into a scan.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Scan in metres, on a grid of 1 mm.
    blocks : (S, M) of 0 and 1
        Watermark image: a block of M bits for each of the S slices of the full turn, 4 to 360.
    embedding : 'lbm', 'qim' or 'qim-printed'
        ``lbm``: lowest bits of x, y and z. ``qim``: QIM of z in cells of 2.5 mm, after which the
        receiver finds the same order of points. ``qim-printed``: QIM by equations 7.1 to 7.3.
    key_2 : int
        Secret number, 0 to 2**63 - 1, that determines the permutations of the blocks, with
        ``frame``.
    frame : int
        Number of the frame.
    merge : 'adjacent' or 'paper'
        Rule that merges slices with fewer than M points: each with its smaller neighbour, or the
        two smallest with each other.

    Returns
    -------
    PaperMarked
        The scan with the watermark, and metadata for the receiver.

    Raises
    ------
    InputError
        Points are off the grid, or there are none; ``blocks`` has another shape or values;
        ``key_2`` or ``frame`` is out of range.

    Notes
    -----
    The order of points is derived from data that embedding does not change. The printed order is
    not: read literally, a third of the bits are read wrongly. The largest moves of points are
    sqrt(3) mm (``lbm``), 1.875 mm (``qim``) and 1.25 mm (``qim-printed``). Use `Watermarker` to
    protect data.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import embed_paper, noise_blocks
    >>> grid = np.mgrid[0:20, 0:20, 0:10].reshape(3, -1).T * np.float32(0.25) + np.float32(1.0)
    >>> marked = embed_paper(grid, noise_blocks(1, slices=36, block_bits=100))
    >>> moves = np.linalg.norm(marked.frame.points - grid, axis=1)
    >>> bool(0 < moves.max() < 0.00174)
    True
    """
    given = to_scan(scan)
    image, options = _arguments(blocks, embedding, key_2, frame, merge)
    points, tile_of, counts = _core.embed_paper_watermark(
        given.points, given.intensity, image.ravel(), options
    )
    metadata = PaperMetadata(_named(embedding), key_2, frame, image.shape[1], tile_of, counts)
    return PaperMarked(as_frame(scan).replace(points=points, exact=None), metadata)


@checked
def compare_paper(
    scan: ScanLike,
    blocks: ArrayLike,
    metadata: PaperMetadata,
    *,
    extraction: Literal["compare_all", "paper_and"] = "compare_all",
) -> PaperComparison:
    """Compare the bits of a scan with the watermark that it should carry.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Scan with points in any order.
    blocks : (S, M) of 0 and 1
        The expected watermark image.
    metadata : PaperMetadata
        Metadata of `embed_paper`.
    extraction : 'compare_all' or 'paper_and'
        Compare every copy of a bit separately, or the logical AND over its copies, as printed,
        which hides changes from 0 to 1.

    Returns
    -------
    PaperComparison
        ``consistent`` or ``inconsistent``, with the tiles that differ and the suspected rows.

    Raises
    ------
    InputError
        ``blocks`` and ``metadata`` do not fit each other.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import compare_paper, embed_paper, noise_blocks
    >>> grid = np.mgrid[0:20, 0:20, 0:10].reshape(3, -1).T * np.float32(0.25) + np.float32(1.0)
    >>> blocks = noise_blocks(1, slices=36, block_bits=100)
    >>> marked = embed_paper(grid, blocks, key_2=7)
    >>> compare_paper(marked.frame, blocks, marked.metadata).verdict
    'consistent'
    >>> forged = marked.frame.points.copy()
    >>> forged[:50, 2] += 0.001
    >>> found = compare_paper(forged, blocks, marked.metadata)
    >>> found.verdict, len(found.suspected) > 0
    ('inconsistent', True)
    """
    given = to_scan(scan)
    image, options = _arguments(
        blocks, metadata.embedding, metadata.key_2, metadata.frame, "adjacent"
    )
    if image.shape[1] != metadata.block_bits:
        raise InputError(
            f"blocks: expected {metadata.block_bits} bits for each slice, got {image.shape[1]}"
        )
    by_point, by_bit, counts, rows = _core.compare_paper_watermark(
        given.points, given.intensity, image.ravel(),
        metadata.tile_of_slice.tolist(), metadata.counts.tolist(), options,
    )  # fmt: skip
    mismatches = by_point if extraction == "compare_all" else by_bit
    changed = np.flatnonzero((mismatches > 0) | (counts != metadata.counts))
    suspected = rows if extraction == "compare_all" else rows[:0]
    verdict: Literal["consistent", "inconsistent"] = (
        "inconsistent" if changed.size else "consistent"
    )
    return PaperComparison(verdict, mismatches, tuple(changed.tolist()), suspected)


def _named(embedding: str) -> PaperEmbedding:
    for name in PAPER_EMBEDDINGS:
        if name == embedding:
            return name
    raise InputError(f"embedding: expected one of {', '.join(PAPER_EMBEDDINGS)}, got {embedding!r}")


def _arguments(
    blocks: ArrayLike, embedding: str, key_2: int, frame: int, merge: str
) -> tuple[NDArray[np.uint8], _core.PaperSettings]:
    number = PAPER_EMBEDDINGS.index(_named(embedding))
    if not 0 <= key_2 < 2**63:
        raise InputError(f"key_2: expected 0 to 2**63 - 1, got {key_2}")
    if not 0 <= frame < 2**32:
        raise InputError(f"frame: expected 0 to 2**32 - 1, got {frame}")
    values = np.asarray(blocks)
    if values.ndim != 2 or not values.size:
        raise InputError(f"blocks: expected shape (S, M), got {values.shape}")
    if not 4 <= len(values) <= 360:
        raise InputError(f"blocks: expected 4 to 360 slices, got {len(values)}")
    bits = index_rows(values.astype(np.int32) if values.dtype == np.bool_ else values,
                      values.shape[1], "blocks")  # fmt: skip
    if bits.min() < 0 or bits.max() > 1:
        raise InputError("blocks: expected zeros and ones")
    image = np.ascontiguousarray(bits, np.uint8)
    options = _core.PaperSettings(
        number, image.shape[0], image.shape[1], merge == "paper", key_2, frame
    )
    return image, options
