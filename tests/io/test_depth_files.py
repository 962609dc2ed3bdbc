"""Depth images: what is stored is what comes out, and hostile files end in one typed error."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manip3d import FormatError, InputError
from manip3d.io import read_depth, read_pixel_map
from manip3d.io._depth_files import read_levels, read_mask

Image = pytest.importorskip("PIL.Image")

DEPTH = np.array([[0, 1, 1000], [4095, 40_000, 65_535]], dtype=np.uint16)


def encoded(kind: str, depth: np.ndarray = DEPTH) -> bytes:
    stream = io.BytesIO()
    if kind == "npy":
        np.save(stream, depth)
    elif kind == "npz":
        np.savez(stream, depth)
    elif kind == "pgm":
        header = f"P5\n# a comment\n{depth.shape[1]} {depth.shape[0]}\n65535\n".encode()
        return header + depth.astype(">u2").tobytes()
    else:
        Image.fromarray(depth).save(stream, kind)
    return stream.getvalue()


@pytest.mark.parametrize("kind", ["PNG", "TIFF", "pgm", "npy", "npz"])
def test_every_format_gives_the_stored_numbers(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "depth.bin"  # the content decides
    path.write_bytes(encoded(kind))
    depth = read_depth(path)
    assert depth.dtype == np.uint16
    assert depth.flags.c_contiguous
    assert depth.flags.writeable
    np.testing.assert_array_equal(depth, DEPTH)


@pytest.mark.parametrize("shape", [(2, 3, 1), (1, 2, 3), (1, 1, 2, 3, 1)])
@pytest.mark.parametrize("dtype", ["<u2", ">u2", "<i4", ">i4", "<u4", "<i8", "<u8"])
def test_whole_arrays_of_any_width_and_with_axes_of_one(
    shape: tuple[int, ...], dtype: str, tmp_path: Path
) -> None:
    np.save(tmp_path / "depth.npy", DEPTH.astype(dtype).reshape(shape))
    depth = read_depth(tmp_path / "depth.npy")
    assert (depth.dtype, depth.flags.writeable) == (np.uint16, True)
    np.testing.assert_array_equal(depth, DEPTH)


def test_whole_numbers_below_zero_are_no_measurement(tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", np.int16([[-1, 5], [0, 32_767]]))
    np.testing.assert_array_equal(read_depth(tmp_path / "depth.npy"), [[0, 5], [0, 32_767]])
    np.save(tmp_path / "depth.npy", np.int32([[1, 65_536]]))
    with pytest.raises(FormatError, match="whole numbers of at most 65535, got 65536"):
        read_depth(tmp_path / "depth.npy")


@pytest.mark.parametrize("dtype", ["<f2", ">f2", ">f4", ">f8"])
def test_fractions_of_any_width_are_metres(dtype: str, tmp_path: Path) -> None:
    metres = np.array([[0.0, 0.5, 1.25], [2.0, np.nan, 4.0]], dtype)
    np.save(tmp_path / "depth.npy", metres[..., None])
    depth = read_depth(tmp_path / "depth.npy")
    assert (depth.dtype, depth.shape) == (np.float32, (2, 3))
    np.testing.assert_array_equal(depth, metres.astype(np.float32))


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_archives_of_one_array_or_of_depth(save: Any, tmp_path: Path) -> None:
    path = tmp_path / "frame.npz"
    for arrays in ({"arr_0": DEPTH}, {"depth": DEPTH[None], "mask": DEPTH > 0}):
        save(path, **arrays)
        np.testing.assert_array_equal(read_depth(path), DEPTH)
    save(path, image=DEPTH, mask=DEPTH > 0)
    with pytest.raises(FormatError, match="one array, or one named depth, got image, mask"):
        read_depth(path)
    save(path)
    with pytest.raises(FormatError, match="got none"):
        read_depth(path)
    np.savez_compressed(path, np.zeros((8192, 4096), np.float64))
    with pytest.raises(FormatError, match="claim to hold"):
        read_depth(path)


@pytest.mark.parametrize(("scale", "order"), [("-1.0", "<f4"), ("1", ">f4"), ("-0.003922", "<f4")])
def test_pfm_begins_with_its_lowest_row(scale: str, order: str, tmp_path: Path) -> None:
    metres = np.array([[0.5, 1.5, np.inf], [2.5, np.nan, 4.5]], order)
    path = tmp_path / "depth.pfm"
    path.write_bytes(f"Pf\n3 2\n{scale}\n".encode() + metres[::-1].tobytes())
    expected = np.float32([[0.5, 1.5, 0.0], [2.5, np.nan, 4.5]])
    depth = read_depth(path)
    assert depth.dtype == np.float32
    np.testing.assert_array_equal(depth, expected)
    path.write_bytes(f"Pf\r\n3 2\r\n{scale}\r\n".encode() + metres[::-1].tobytes())
    np.testing.assert_array_equal(read_depth(path), expected)


def test_what_is_too_far_for_a_number_of_32_bits_is_infinite(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", [[1e300, 2.0]])
    np.save(tmp_path / "b.npy", np.uint16([[1, 0]]))
    assert read_depth(tmp_path / "a.npy").tolist() == [[np.inf, 2.0]]
    assert read_depth(tmp_path / "b.npy", units_per_metre=1e-300).tolist() == [[np.inf, 0.0]]


def test_other_units_become_metres(tmp_path: Path) -> None:
    path = tmp_path / "tum.png"
    path.write_bytes(encoded("PNG"))
    depth = read_depth(path, units_per_metre=5000)
    assert depth.dtype == np.float32
    np.testing.assert_array_equal(depth, (DEPTH / 5000.0).astype(np.float32))


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_floating_point_arrays_are_metres(order: str, dtype: type, tmp_path: Path) -> None:
    metres = np.asarray([[0.0, np.nan, 1.5], [2.25, 0.5, 4.0]], dtype=dtype, order=order)
    np.save(tmp_path / "depth.npy", metres)
    depth = read_depth(tmp_path / "depth.npy", units_per_metre=5000)
    assert depth.dtype == np.float32
    np.testing.assert_array_equal(depth, metres.astype(np.float32))


def test_a_small_largest_value_does_not_stretch_the_numbers(tmp_path: Path) -> None:
    path = tmp_path / "depth.pgm"
    path.write_bytes(b"P5 2 1 2047\n" + struct.pack(">HH", 7, 2047))
    np.testing.assert_array_equal(read_depth(path), [[7, 2047]])


def png(width: int, height: int, bits: int = 16, color: int = 0, rows: bytes | None = b"") -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    header = struct.pack(">IIBBBBB", width, height, bits, color, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + (b"" if rows is None else chunk(b"IDAT", zlib.compress(rows)))
        + chunk(b"IEND", b"")
    )


def npy_header(text: str) -> bytes:
    body = text.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(body)) + body


HOSTILE = {
    "nothing": (b"", "got bytes that begin with"),
    "text": (b"hello, world", "expected a 16-bit PNG, PGM or TIFF"),
    "jpeg": (b"\xff\xd8\xff\xe0" + bytes(20), "got bytes that begin with"),
    "short png": (encoded("PNG")[:47], "damaged image"),
    "huge png": (png(2**31 - 1, 2**31 - 1), "."),
    "wide png": (png(1 << 13, (1 << 13) + 1), "expected at most"),
    "empty png": (png(0, 4), "."),
    "png without rows": (png(4, 4), "damaged image"),
    "png without pixels": (png(4, 4, rows=None), "damaged image: (?!list index)"),
    "8-bit png": (png(1, 1, 8, 0, b"\0\0"), "16 bits of grey, got mode L"),
    "colour png": (png(1, 1, 8, 2, b"\0\0\0\0"), "got mode RGB"),
    "flipped png": (encoded("PNG")[:45] + b"\xff" + encoded("PNG")[46:], "damaged image"),
    "tiff header": (b"II*\0\x08\0\0\0", "damaged image"),
    "tiff far": (b"II*\0\xff\xff\xff\x7f", "damaged image"),
    "pgm header": (b"P5 2 ", "expected a PGM header"),
    "pgm digits": (b"P5 " + b"9" * 5000 + b" 2 65535\n", "expected a PGM header"),
    "pgm short": (b"P5 2 2 65535\n\0\0\0", "expected 8 bytes of pixels, got 3"),
    "pgm huge": (b"P5 99999999 99999999 65535\n", "expected at most"),
    "pgm empty": (b"P5 0 5 65535\n", "at least one pixel"),
    "pgm 8 bits": (b"P5 1 1 255\n\0", "maximum 256 to 65535"),
    "pgm above": (b"P5 1 1 300\n\xff\xff", "expected values up to 300"),
    "npy version": (b"\x93NUMPY\x09\x09junk", "expected a header"),
    "npy code": (npy_header("__import__('os').abort()"), "expected a header"),
    "npy object": (
        npy_header("{'descr':'|O','fortran_order':False,'shape':(1,1)}"),
        "expected an array of numbers",
    ),
    "npy flat": (npy_header("{'descr':'<u2','fortran_order':False,'shape':(4,)}"), "2-D array"),
    "npy negative": (
        npy_header("{'descr':'<u2','fortran_order':False,'shape':(-1,-4)}"),
        "at least one pixel",
    ),
    "npy huge": (
        npy_header("{'descr':'<f8','fortran_order':False,'shape':(1099511627776,1)}"),
        "expected at most",
    ),
    "pfm header": (b"Pf 2 ", "expected a PFM header"),
    "pfm scale": (b"Pf\n1 1\n0.0\n\0\0\0\0", "expected a PFM header"),
    "pfm no scale": (b"Pf\n1 1\ne+-\n\0\0\0\0", "expected a PFM header"),
    "pfm colours": (b"PF\n1 1\n-1.0\n" + bytes(12), "got colours"),
    "pfm short": (b"Pf\n2 1\n-1.0\n" + bytes(7), "expected 8 bytes of pixels, got 7"),
    "pfm huge": (b"Pf\n99999999 99999999\n-1.0\n", "expected at most"),
    "npz no archive": (b"PK\x03\x04junk", "damaged .npz"),
    "npz damaged": (encoded("npz")[:70] + b"\xff" + encoded("npz")[71:], "damaged .npz"),
    "npz cut": (encoded("npz")[:-30], "damaged .npz"),
    "npy short": (
        npy_header("{'descr':'<f8','fortran_order':False,'shape':(2,2)}") + bytes(31),
        "expected 32 bytes of pixels, got 31",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_by_name(name: str, tmp_path: Path) -> None:
    data, message = HOSTILE[name]
    path = tmp_path / "depth.png"
    path.write_bytes(data)
    with pytest.raises(FormatError, match=message) as caught:
        read_depth(path)
    assert caught.value.file == str(path)


@pytest.mark.parametrize(
    ("shape", "advice"),
    [
        (
            (3, 5, 6),
            "the channels are first: array[k] is channel k, and np.moveaxis(array, 0, -1) an "
            "organised cloud of x, y, z",
        ),
        ((2, 5, 6), "the channels are first: array[k] is channel k"),
        ((5, 6, 3), "array[..., k] is channel k of an image"),
        ((7, 5, 6), "array[k] is image k of several"),
        ((30,), "array.reshape(height, width) has the rows of an image"),
    ],
)
def test_arrays_of_another_shape_come_with_advice(
    shape: tuple[int, ...], advice: str, tmp_path: Path
) -> None:
    array = np.ones(shape, np.float32)
    np.save(tmp_path / "a.npy", array)
    np.savez(tmp_path / "a.npz", depth=array)
    for name in ("a.npy", "a.npz"):
        with pytest.raises(FormatError) as caught:
            read_depth(tmp_path / name)
        assert str(caught.value).endswith(f"got float32 {shape}; {advice}")


def test_masks_with_a_palette_may_have_alpha(tmp_path: Path) -> None:
    """The second entry is a transparent red: it is not black, and its alpha says nothing."""
    image = Image.fromarray(np.uint8([[0, 1], [2, 0]]), mode="P")
    image.putpalette([0, 0, 0, 200, 0, 0, 7, 90, 8])
    for name, alpha in (("none.png", None), ("one.png", 1), ("each.png", b"\xff\x00\x80")):
        image.save(tmp_path / name, **({} if alpha is None else {"transparency": alpha}))
        np.testing.assert_array_equal(read_pixel_map(tmp_path / name), [[0, 200], [90, 0]])


MAP = np.array([[0, 1, 2], [2, 0, 1]])


@pytest.mark.parametrize("dtype", ["?", "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8"])
def test_maps_of_pixels_may_be_arrays_of_any_integers(dtype: str, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", MAP.astype(dtype))
    found = read_pixel_map(tmp_path / "a.npy")
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, MAP.astype(dtype))
    np.testing.assert_array_equal(read_mask(tmp_path / "a.npy"), MAP != 0)


@pytest.mark.parametrize("dtype", ["i1", "i2", "i4", "i8", "f2", "f4", "f8"])
def test_negative_numbers_mean_nothing_in_a_map(dtype: str, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", MAP.astype(dtype) - 1)
    for read in (read_pixel_map, read_mask, read_levels):
        with pytest.raises(FormatError, match="expected numbers of at least 0, got -1"):
            read(tmp_path / "a.npy")


@pytest.mark.parametrize(
    ("dtype", "found"), [("f2", "f4"), ("f4", "f4"), ("f8", "f8"), (">f4", "f4")]
)
def test_maps_of_pixels_may_be_arrays_of_floats(dtype: str, found: str, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", (MAP / 2).astype(dtype))
    levels = read_pixel_map(tmp_path / "a.npy")
    assert levels.dtype == found
    np.testing.assert_array_equal(levels, MAP / 2)


def test_maps_of_pixels_have_the_formats_of_depth_and_colour_images(tmp_path: Path) -> None:
    path = tmp_path / "map.bin"  # the content decides
    levels = MAP.astype(np.uint8)
    picture = Image.fromarray(levels)
    for kind in ("PNG", "TIFF", "BMP", "WEBP"):
        picture.save(path, kind, **({"lossless": True} if kind == "WEBP" else {}))
        np.testing.assert_array_equal(read_pixel_map(path), levels, kind)
        np.testing.assert_array_equal(read_mask(path), levels != 0, kind)
    path.write_bytes(b"P5 3 2 2\n" + levels.tobytes())
    assert read_pixel_map(path).dtype == np.uint8
    np.testing.assert_array_equal(read_pixel_map(path), levels)
    path.write_bytes(b"Pf\n3 2\n-1.0\n" + levels[::-1].astype("<f4").tobytes())
    np.testing.assert_array_equal(read_pixel_map(path), levels)
    for arrays in ({"a": levels}, {"depth": DEPTH, "mask": levels}, {"x": 1, "conf": levels}):
        np.savez_compressed(tmp_path / "a.npz", **arrays)
        np.testing.assert_array_equal(read_pixel_map(tmp_path / "a.npz"), levels)
    np.savez(tmp_path / "a.npz", x=levels, y=levels)
    with pytest.raises(FormatError, match="or one named mask or confidence or conf, got x, y"):
        read_pixel_map(tmp_path / "a.npz")


def test_a_bundle_gives_each_map_by_its_name(tmp_path: Path) -> None:
    shares = (MAP / 2).astype(np.float32)
    np.savez(tmp_path / "a.npz", depth=DEPTH, mask=MAP == 1, confidence=shares)
    np.testing.assert_array_equal(read_mask(tmp_path / "a.npz"), MAP == 1)
    np.testing.assert_array_equal(read_levels(tmp_path / "a.npz")[0], shares)
    np.savez(tmp_path / "a.npz", depth=DEPTH, mask=MAP == 1)
    with pytest.raises(FormatError, match="or one named confidence or conf, got depth, mask"):
        read_levels(tmp_path / "a.npz")


def test_ids_of_a_mask_may_have_32_bits(tmp_path: Path) -> None:
    (tmp_path / "a.tif").write_bytes(compressed_tiff((MAP * 70_000).astype("i4")))
    np.testing.assert_array_equal(read_pixel_map(tmp_path / "a.tif"), MAP * 70_000)
    np.testing.assert_array_equal(read_mask(tmp_path / "a.tif"), MAP != 0)


def test_levels_have_the_highest_one_that_their_file_can_hold(tmp_path: Path) -> None:
    (tmp_path / "a.pgm").write_bytes(b"P5 3 2 2\n" + MAP.astype(np.uint8).tobytes())
    assert read_levels(tmp_path / "a.pgm")[1] == 2  # its header says so
    for dtype, highest in (("?", 1), ("u1", 255), ("u2", 65535), ("u4", None), ("i1", None),
                           ("f4", None)):  # fmt: skip
        np.save(tmp_path / "a.npy", MAP.astype(dtype))
        assert read_levels(tmp_path / "a.npy")[1] == highest
    for dtype, highest in (("u1", 255), ("u2", 65535), ("i4", None)):
        Image.fromarray(MAP.astype(dtype)).save(tmp_path / "a.tif")
        assert read_levels(tmp_path / "a.tif")[1] == highest
    Image.fromarray(DEPTH).save(tmp_path / "a.png")
    assert read_levels(tmp_path / "a.png")[1] == 65535


def test_a_map_in_an_exr_file_is_its_only_channel(tmp_path: Path) -> None:
    OpenEXR = pytest.importorskip("OpenEXR")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    levels = (MAP / 2).astype(np.float32)
    OpenEXR.File(header, {"Y": levels}).write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_pixel_map(tmp_path / "a.exr"), levels)
    bundle = {"Z": levels + 1, "mask.Y": levels, "N.X": levels + 2}
    grey = {"Z": levels + 1, "R": levels, "G": levels, "B": levels}
    for channels in (bundle, grey, {"Z": levels + 1, "Y": levels}):
        OpenEXR.File(header, channels).write(str(tmp_path / "a.exr"))
        np.testing.assert_array_equal(read_mask(tmp_path / "a.exr"), levels != 0)
    for channels in (bundle, {"Z": levels, "A": levels}):
        OpenEXR.File(header, channels).write(str(tmp_path / "a.exr"))
        with pytest.raises(FormatError, match=r"or one named confidence or conf, got '.*'Z'"):
            read_levels(tmp_path / "a.exr")


def test_a_mask_may_be_a_lossy_webp(tmp_path: Path) -> None:
    """Its black is not exactly 0 after the compression, as that of a JPEG is not."""
    mask = np.zeros((64, 96), bool)
    mask[16:48, 24:72] = True
    levels = np.where(mask, 200, 0).astype(np.uint8) + np.random.default_rng(0).integers(
        0, 8, mask.shape, np.uint8
    )
    for exif in (None, b"Exif\0\0MM\0*\0\0\0\x08\0\0"):  # with it, the file has more chunks
        Image.fromarray(levels).save(tmp_path / "a.webp", **({"exif": exif} if exif else {}))
        found = read_mask(tmp_path / "a.webp")
        assert (found != mask).mean() < 0.01
        assert (read_pixel_map(tmp_path / "a.webp") != 0).mean() > 0.9


@pytest.mark.parametrize("mode", ["RGBA", "LA"])
def test_a_lossy_cut_out_keeps_its_dark_pixels(mode: str, tmp_path: Path) -> None:
    """Its transparency decides alone: half of the greatest brightness is no limit for a picture."""
    mask = np.zeros((64, 96), bool)
    mask[16:48, 24:72] = True
    colors = np.random.default_rng(0).integers(0, 256, (64, 96, 3), np.uint8)
    colors[20:44, 30:50] = 0
    cut_out = Image.fromarray(np.dstack([colors, np.where(mask, 255, 0).astype(np.uint8)]))
    cut_out.convert(mode).save(tmp_path / "a.webp")
    np.testing.assert_array_equal(read_mask(tmp_path / "a.webp"), mask)
    colors[mask], colors[~mask] = 200, 0
    Image.fromarray(colors).convert(mode).save(tmp_path / "a.webp")
    np.testing.assert_array_equal(read_mask(tmp_path / "a.webp"), mask)


def big_tiff(depth: np.ndarray) -> bytes:
    """A BigTIFF of one strip, as GDAL and tifffile write large images."""
    rows, columns = depth.shape
    bits, kind = 8 * depth.itemsize, {"u": 1, "f": 3}[depth.dtype.kind]
    entries = [(256, columns), (257, rows), (258, bits), (259, 1), (262, 1), (277, 1), (278, rows),
               (279, depth.nbytes), (339, kind)]  # fmt: skip
    start = 16 + 8 + 20 * (len(entries) + 1) + 8
    lines = sorted([(tag, 4, value) for tag, value in entries] + [(273, 4, start)])
    table = b"".join(struct.pack("<HHQQ", tag, form, 1, value) for tag, form, value in lines)
    head = b"II" + struct.pack("<HHHQ", 43, 8, 0, 16) + struct.pack("<Q", len(lines))
    return head + table + struct.pack("<Q", 0) + depth.tobytes()


@pytest.mark.parametrize("dtype", ["<u2", "<f4"])
def test_large_tiffs_are_read(dtype: str, tmp_path: Path) -> None:
    depth = DEPTH.astype(dtype)
    (tmp_path / "a.tif").write_bytes(big_tiff(depth))
    np.testing.assert_array_equal(read_depth(tmp_path / "a.tif"), depth)
    np.testing.assert_array_equal(read_pixel_map(tmp_path / "a.tif"), depth)


def compressed_tiff(values: np.ndarray, order: str = "<") -> bytes:
    """A TIFF of one deflated strip in a byte order."""
    rows, columns = values.shape
    kind = {"u": 1, "i": 2, "f": 3}[values.dtype.kind]
    pixels = zlib.compress(values.astype(values.dtype.newbyteorder(order)).tobytes())
    entries = [(256, columns), (257, rows), (258, 8 * values.itemsize), (259, 8), (262, 1),
               (273, 8 + 2 + 12 * 11 + 4), (277, 1), (278, rows), (279, len(pixels)), (284, 1),
               (339, kind)]  # fmt: skip
    table = b"".join(struct.pack(f"{order}HHII", tag, 4, 1, value) for tag, value in entries)
    head = {"<": b"II", ">": b"MM"}[order] + struct.pack(f"{order}HIH", 42, 8, len(entries))
    return head + table + bytes(4) + pixels


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("dtype", ["u2", "i2", "i4", "f4"])
def test_compressed_tiffs_of_either_byte_order_are_read(
    order: str, dtype: str, tmp_path: Path
) -> None:
    depth = (DEPTH // 2).astype(dtype)
    (tmp_path / "a.tif").write_bytes(compressed_tiff(depth, order))
    np.testing.assert_array_equal(read_depth(tmp_path / "a.tif"), depth)
    np.testing.assert_array_equal(read_pixel_map(tmp_path / "a.tif"), depth)


@pytest.mark.parametrize(("dtype", "nothing"), [("i2", -32768), ("i2", -1), ("i4", -(2**31))])
def test_negative_whole_numbers_are_not_measured(dtype: str, nothing: int, tmp_path: Path) -> None:
    depth = (DEPTH // 2).astype(dtype)
    depth[0, 1] = nothing
    (tmp_path / "a.tif").write_bytes(compressed_tiff(depth))
    found = read_depth(tmp_path / "a.tif")
    assert found.dtype == np.uint16
    np.testing.assert_array_equal(found, np.maximum(depth, 0))
    with pytest.raises(FormatError, match=f"expected numbers of at least 0, got {nothing}"):
        read_pixel_map(tmp_path / "a.tif")


def test_whole_numbers_of_more_than_16_bits_are_refused(tmp_path: Path) -> None:
    depth = DEPTH.astype("i4")
    depth[0] = -1, 65536, 7
    (tmp_path / "a.tif").write_bytes(compressed_tiff(depth))
    with pytest.raises(FormatError, match="whole numbers of at most 65535, got 65536"):
        read_depth(tmp_path / "a.tif")


def test_a_tiff_of_several_images_says_that_one_is_read(tmp_path: Path) -> None:
    first, second = Image.fromarray(DEPTH), Image.fromarray(DEPTH + np.uint16(1))
    first.save(tmp_path / "frames.tif", save_all=True, append_images=[second])
    with pytest.warns(UserWarning, match="several images, of which the first is read"):
        np.testing.assert_array_equal(read_depth(tmp_path / "frames.tif"), DEPTH)
    overview = second.resize((2, 2))
    first.save(tmp_path / "pyramid.tif", save_all=True, append_images=[overview])
    np.testing.assert_array_equal(read_depth(tmp_path / "pyramid.tif"), DEPTH)  # without a warning


def test_a_tiff_of_an_unknown_kind_is_told(tmp_path: Path) -> None:
    (tmp_path / "a.tif").write_bytes(big_tiff(DEPTH.astype("<f8")))
    with pytest.raises(FormatError, match="fractions of 32 bits") as caught:
        read_depth(tmp_path / "a.tif")
    assert "object at" not in str(caught.value)


def tiff_of_one_pixel(value: int) -> bytes:
    """A colour of 16 bits: 10 entries end at byte 134, where the bits of the channels follow."""
    short, long = 3, 4
    entries = (
        (256, short, 1, 1), (257, short, 1, 1), (258, short, 3, 134), (259, short, 1, 1),
        (262, short, 1, 2), (273, long, 1, 140), (277, short, 1, 3), (278, short, 1, 1),
        (279, long, 1, 6), (284, short, 1, 1),
    )  # fmt: skip
    fields = b"".join(struct.pack("<HHII", *entry) for entry in entries) + bytes(4)
    pixel = struct.pack("<6H", 16, 16, 16, value, value, value)
    return b"II*\0" + struct.pack("<IH", 8, len(entries)) + fields + pixel


@pytest.mark.parametrize("kind", ["png", "png with alpha", "tiff"])
def test_coloured_masks_of_16_bits_are_refused(kind: str, tmp_path: Path) -> None:
    """Pillow would read 200 of 65535, which is not black, as 0."""
    path, channel = tmp_path / "mask", struct.pack(">H", 200)
    if kind == "tiff":
        path.write_bytes(tiff_of_one_pixel(200))
    else:
        color, channels = (6, 4) if "alpha" in kind else (2, 3)
        path.write_bytes(png(1, 1, 16, color, b"\0" + channel * channels))
    with pytest.raises(FormatError, match="expected colours of 8 bits, got 16"):
        read_pixel_map(path)


@pytest.mark.parametrize("read", [read_depth, read_pixel_map])
def test_an_image_is_not_shrunk_without_its_camera(read: Any, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", DEPTH)
    cure = "shrink the depth image, its intrinsics and maps alike, or read it with a larger max_pix"
    with pytest.raises(FormatError, match=f"at most 5 pixels, got 3 x 2; .*: {cure}"):
        read(tmp_path / "a.npy", max_pixels=5)


def test_large_files_are_not_read_to_their_end(tmp_path: Path) -> None:
    path = tmp_path / "depth.npy"
    with path.open("wb") as file:
        file.truncate(1 << 34)
    with pytest.raises(FormatError, match="got a larger file"):
        read_depth(path, max_pixels=100)


def test_arguments_and_missing_files(tmp_path: Path) -> None:
    path = tmp_path / "depth.png"
    with pytest.raises(FileNotFoundError):
        read_depth(path)
    with pytest.raises(InputError, match="units_per_metre: expected > 0, got nan"):
        read_depth(path, units_per_metre=float("nan"))
    with pytest.raises(InputError, match="max_pixels"):
        read_depth(path, max_pixels=0)
    path.write_bytes(encoded("PNG"))
    with pytest.raises(FormatError, match=r"at most 5 pixels, got 3 x 2; .* bounds the memory: "):
        read_depth(path, max_pixels=5)


def test_images_of_large_cameras_are_not_refused_by_their_size(tmp_path: Path) -> None:
    """They have 45 and 61 megapixels. The header is read first, so that no pixels are needed."""
    for columns, rows, told in (
        (8192, 5464, "expected 89522176 bytes of pixels, got 0"),
        (9504, 6336, "expected 120434688 bytes of pixels, got 0"),
        (9504, 9504, "expected at most 67108864 pixels, got 9504 x 9504; the limit bounds the mem"),
    ):
        (tmp_path / "a.pgm").write_bytes(f"P5 {columns} {rows} 65535\n".encode())
        with pytest.raises(FormatError, match=told):
            read_depth(tmp_path / "a.pgm")


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz") / "depth.png"


@pytest.mark.parametrize("kind", ["PNG", "TIFF", "pgm", "npy"])
@settings(max_examples=300)
@given(data=st.data())
def test_damaged_files_never_end_otherwise(kind: str, scratch: Path, data: st.DataObject) -> None:
    content = bytearray(encoded(kind))
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    scratch.write_bytes(bytes(content[: data.draw(st.integers(1, len(content)))]))
    try:
        depth = read_depth(scratch, max_pixels=10_000)
    except FormatError as error:
        depth, named = None, error.file
    if depth is None:
        assert named == str(scratch)
    else:
        assert depth.dtype in (np.uint16, np.float32)
        assert 0 < depth.size <= 10_000
