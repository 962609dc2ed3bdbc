"""Units of depth images: what is guessed, what is known, what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from manip3d import FormatError, InputError
from manip3d.io import (
    DEPTH_UNITS,
    describe_unit,
    guess_depth_unit,
    is_color_png,
    read_depth_guessing,
)
from real_data import RealData


def ramp(near: float, far: float) -> np.ndarray:
    """Depth in metres from near to far, a tenth of it without a measurement."""
    depth = np.linspace(near, far, 4800).reshape(60, 80)
    depth[:6] = 0
    return depth


def stored(unit: str, metres: np.ndarray) -> np.ndarray:
    """The numbers that a sensor of that unit would store."""
    there = metres > 0
    if unit == "m":
        return metres.astype(np.float32)
    if unit in ("kinect-raw", "nyu"):
        disparity = 1092.5 - 351.3 / np.where(there, metres, 1.0)
        whole = np.where(there, np.rint(disparity), 2047).astype(np.uint16)
        return whole.byteswap() if unit == "nyu" else whole
    if unit == "sun":
        millimetres = np.rint(1000 * metres).astype(np.uint16)
        return (millimetres << 3) | (millimetres >> 13)
    return np.rint({"mm": 1000, "tum": 5000}[unit] * metres).astype(np.uint16)


@pytest.mark.parametrize(
    ("unit", "name"),
    [
        *((unit, "image.npy") for unit in DEPTH_UNITS),
        *((unit, "image.pgm") for unit in DEPTH_UNITS if unit != "m"),  # whole numbers only
    ],
)
def test_each_unit_is_guessed_and_undone(unit: str, name: str, tmp_path: Path) -> None:
    metres = ramp(0.9, 5.0)
    numbers = stored(unit, metres)
    path = tmp_path / name
    if name.endswith(".npy"):
        np.save(path, numbers)
    else:
        path.write_bytes(b"P5\n80 60\n65535\n" + numbers.astype(">u2").tobytes())
    found = read_depth_guessing(path)
    assert found.unit == unit
    assert found.guessed
    scale = 1e-3 if found.depth.dtype == np.uint16 else 1.0
    # half a step of the coarsest coding: disparity at 5 m
    np.testing.assert_allclose(found.depth * scale, metres, atol=0.5 * 5.0**2 / 351.3)
    assert found.range_m == pytest.approx((metres[metres > 0].min(), 5.0), abs=0.05)
    assert found.num_measured == (metres > 0).sum()
    assert unit in found.sentence
    assert "guessed" in found.sentence
    known = read_depth_guessing(path, unit=unit)
    assert not known.guessed
    assert "guessed" not in known.sentence
    np.testing.assert_array_equal(known.depth, found.depth)


def test_wrong_guesses_are_those_that_are_documented() -> None:
    assert guess_depth_unit(stored("mm", ramp(5.0, 9.0)))[0] == "tum"  # a hall, in millimetres
    assert guess_depth_unit(stored("tum", ramp(0.3, 0.7)))[0] == "mm"  # a hand, in 1/5000 m


def test_fractions_in_the_hundreds_are_millimetres() -> None:
    unit, reason = guess_depth_unit(1000 * ramp(0.9, 5.0).astype(np.float32))
    assert unit == "mm"
    assert "beyond" in reason
    assert "centimetres" not in reason
    reason = guess_depth_unit(100 * ramp(0.9, 3.0).astype(np.float32))[1]
    assert reason.endswith("in centimetres, unit 100, it would be beyond 2.1 m")


@pytest.mark.parametrize("dtype", ["int16", "int32", "uint32", "int64", "uint64"])
def test_whole_numbers_of_any_type_are_judged_alike(dtype: str) -> None:
    for unit, metres in (("mm", ramp(0.9, 5.0)), ("tum", ramp(0.9, 5.0)), ("mm", 0.0 * ramp(1, 2))):
        image = stored(unit, metres)
        wide = np.where(image == 0, -1, image).astype(dtype) if dtype[0] == "i" else image
        assert guess_depth_unit(wide.astype(dtype)) == guess_depth_unit(image)
    if "16" not in dtype:
        with pytest.raises(InputError, match="at most 65535, got 65536"):
            guess_depth_unit(np.full((2, 3), 65536, dtype))


def test_images_without_a_measurement_have_the_unit_of_their_type() -> None:
    assert guess_depth_unit(np.zeros((2, 3), np.uint16))[0] == "mm"
    assert guess_depth_unit(np.full((2, 3), np.nan, np.float32))[0] == "m"


def test_numbers_of_units_and_wrong_ones(tmp_path: Path) -> None:
    path = tmp_path / "image.npy"
    np.save(path, np.full((2, 2), 512, np.uint16))
    found = read_depth_guessing(path, unit="256")
    assert found.range_m == (2.0, 2.0)
    assert found.unit == "256"
    assert describe_unit("256") == "1/256 m"
    assert describe_unit("guess") == "guessed from the stored numbers"
    with pytest.raises(InputError, match="unit: expected guess, mm"):
        describe_unit("furlong")  # was "1/furlong m"
    assert read_depth_guessing(path, unit=1000.0).unit == "mm"
    for unit in ("yard", "0", "-5", "nan", "inf"):
        with pytest.raises(InputError, match="unit: expected guess, mm"):
            read_depth_guessing(path, unit=unit)
    np.save(path, np.full((2, 2), 1.5, np.float32))
    with pytest.raises(InputError, match="unit: sun is of whole numbers"):
        read_depth_guessing(path, unit="sun")


def test_infinite_and_negative_numbers_are_no_measurements(tmp_path: Path) -> None:
    path = tmp_path / "image.npy"
    np.save(path, np.float32([[np.inf, -1.0], [np.nan, 2.0]]))
    found = read_depth_guessing(path)
    assert found.depth.tolist() == [[0, 0], [0, 2]]


def test_the_largest_number_of_16_bits_is_no_measurement(tmp_path: Path) -> None:
    stored = np.full((48, 64), 2000, np.uint16)
    stored[:5] = 65_535
    np.save(tmp_path / "image.npy", stored)
    for unit, metres in {"guess": 2.0, "mm": 2.0, "tum": 0.4, "100": 20.0}.items():
        found = read_depth_guessing(tmp_path / "image.npy", unit=unit)
        assert found.range_m == pytest.approx((metres, metres))  # 65535 / 5000 is no wall at 13 m
        assert found.num_marked == 5 * 64 == stored.size - found.num_measured
        assert found.sentence.endswith("; 320 pixels of 65535 taken as not measured")
    disparities = read_depth_guessing(tmp_path / "image.npy", unit="disparity:2000")
    assert disparities.num_marked == 0


def test_the_largest_number_of_16_bits_is_no_measurement_in_floats_either(tmp_path: Path) -> None:
    stored = np.full((48, 64), 2000.25, np.float32)
    stored[:5] = 65_535
    stored[5] = np.nan, np.inf, -1.0, 0.0, *[65_534.5] * 60
    np.save(tmp_path / "image.npy", stored)
    for unit in ("guess", "mm"):
        found = read_depth_guessing(tmp_path / "image.npy", unit=unit)
        assert found.range_m == pytest.approx((2.00025, 65.5345))
        assert (found.unit, found.num_marked) == ("mm", 320)
    np.save(tmp_path / "image.npy", stored / 10)  # no number is 65535
    assert read_depth_guessing(tmp_path / "image.npy", unit="100").num_marked == 0


def truth(path: Path) -> str:
    """The unit that the publishers of the recordings state."""
    known = {
        "scene_icl_nuim_livingroom": "tum", "scene_tum_fr2_desk": "tum", "TUM_depth": "tum",
        "NYU_depth": "nyu", "SUN_depth": "sun",
    }  # fmt: skip
    return next((unit for name, unit in known.items() if name in str(path)), "mm")


def test_every_recorded_image_is_guessed_rightly(realdata: RealData) -> None:
    folder = realdata("rgbd")
    images = [*folder.rglob("*.png"), *folder.rglob("*.pgm")]
    depth = [path for path in images if path.suffix == ".pgm" or not is_color_png(path)]
    assert len(depth) > 500
    wrong = [path for path in depth if read_depth_guessing(path).unit != truth(path)]
    assert wrong == []


def test_millimetres_that_end_where_disparities_do_are_no_disparities(tmp_path: Path) -> None:
    """A desk at 0.5 to 1 m, a tenth of the image farther, and one pixel of 2047 mm."""
    millimetres = np.linspace(500, 1000, 4800).astype(np.uint16).reshape(60, 80)
    millimetres[:6] = np.linspace(1200, 2047, 480).reshape(6, 80)
    np.save(tmp_path / "desk.npy", millimetres)
    assert millimetres.max() == 2047
    assert read_depth_guessing(tmp_path / "desk.npy").unit == "mm"


def test_marks_of_nothing_measured_say_nothing_of_the_unit() -> None:
    image = np.full((48, 64), 2500, np.uint16)
    image[:5] = 65_535
    assert guess_depth_unit(image) == (
        "mm",
        "whole numbers, and a usual range: mostly 2.5 to 2.5 m",
    )
    image[:] = 65_535
    assert guess_depth_unit(image) == ("mm", "there is no measurement")


def test_disparities_of_a_stereo_pair_become_depth(tmp_path: Path) -> None:
    disparity = np.array([[40.0, 10.0, 0.0], [-1.0, np.nan, np.inf]], np.float32)
    path = tmp_path / "disparity.npy"
    np.save(path, disparity)
    found = read_depth_guessing(path, unit="disparity:20")
    np.testing.assert_allclose(found.depth, [[0.5, 2.0, 0.0], [0.0, 0.0, 0.0]])
    assert (found.unit, found.guessed) == ("disparity:20", False)
    assert "20 m / (d + 0)" in found.sentence
    moved = read_depth_guessing(path, unit="disparity:20,-15")
    np.testing.assert_allclose(moved.depth[0], [0.8, 0.0, 0.0])  # 10 - 15 is behind the camera
    whole = tmp_path / "whole.npy"  # as KITTI stores it, in 1/256 of a pixel
    np.save(whole, np.array([[0, 256 * 20]], np.uint16))
    np.testing.assert_allclose(read_depth_guessing(whole, unit="disparity:5120").depth, [[0, 1.0]])
    for unit in ("disparity:", "disparity:0", "disparity:nan", "disparity:5,inf", "disparity:a,b"):
        with pytest.raises(InputError, match="expected disparity:FB"):
            read_depth_guessing(path, unit=unit)


@pytest.mark.parametrize(
    ("stored", "unit", "doubt"),
    [
        (np.full((4, 4), 1700, np.uint16), "m", "half of the image is beyond 1700 m"),
        (np.full((4, 4), 1.7, np.float32), "mm", "half of the image is nearer than 1.7 mm"),
        (np.full((4, 4), 1700, np.uint16), "mm", ""),
        (np.full((4, 4), 1700, np.uint16), "tum", ""),
        (np.full((4, 4), 150.0, np.float32), "m", ""),
        (np.zeros((4, 4), np.uint16), "m", ""),
    ],
)
def test_a_given_unit_that_no_camera_has_is_doubted(
    stored: np.ndarray, unit: str, doubt: str, tmp_path: Path
) -> None:
    np.save(tmp_path / "depth.npy", stored)
    found = read_depth_guessing(tmp_path / "depth.npy", unit=unit)
    assert found.doubt.startswith(doubt)
    assert bool(found.doubt) == bool(doubt)
    if doubt:
        assert found.doubt.endswith(f"the numbers look like unit {'mm' if unit == 'm' else 'm'}")
        assert f"; warning: {found.doubt}" in found.sentence


@pytest.mark.parametrize("nothing", [1e10, 65504.0, np.inf])
@pytest.mark.parametrize("share", [0.2, 0.8])
def test_what_renderers_store_for_nothing_is_no_measurement(
    nothing: float, share: float, tmp_path: Path
) -> None:
    depth = np.full((10, 10), 2.5, np.float32)
    depth.ravel()[: int(100 * share)] = nothing
    np.save(tmp_path / "a.npy", depth)
    reading = read_depth_guessing(tmp_path / "a.npy")
    assert reading.unit == "m"
    assert reading.num_measured == round(100 * (1 - share))
    assert reading.range_m == (2.5, 2.5)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".pgm"])
def test_only_disparities_may_have_8_bits(suffix: str, tmp_path: Path) -> None:
    Image = pytest.importorskip("PIL.Image")
    stored = np.array([[40, 0], [10, 255]], np.uint8)
    path = tmp_path / f"disp1{suffix}"
    if suffix == ".pgm":
        path.write_bytes(b"P5 2 2 255\n" + stored.tobytes())
    else:
        Image.fromarray(stored).save(path)
    found = read_depth_guessing(path, unit="disparity:20")
    np.testing.assert_allclose(found.depth, [[0.5, 0.0], [2.0, 20 / 255]], rtol=1e-6)
    for unit in ("guess", "mm", 1000):
        with pytest.raises(FormatError, match="16 bits"):
            read_depth_guessing(path, unit=unit)


def test_colours_are_no_disparities(tmp_path: Path) -> None:
    Image = pytest.importorskip("PIL.Image")
    path = tmp_path / "view.png"
    Image.fromarray(np.zeros((2, 2, 3), np.uint8)).save(path)
    with pytest.raises(FormatError, match="expected 8 or 16 bits of grey, got mode RGB"):
        read_depth_guessing(path, unit="disparity:20")


@pytest.mark.parametrize(("unit", "metres"), [("85", 3.0), (100, 2.55), ("5000", 0.0), ("mm", 0.0)])
def test_depths_of_8_bits_are_read_in_coarse_units(
    unit: str | float, metres: float, tmp_path: Path
) -> None:
    Image = pytest.importorskip("PIL.Image")
    path = tmp_path / "a.png"
    Image.fromarray(np.array([[0, 255]], np.uint8)).save(path)
    if not metres:  # in fine units they would be nearer than a camera sees
        with pytest.raises(FormatError, match="expected 16 bits"):
            read_depth_guessing(path, unit=unit)
        return
    reading = read_depth_guessing(path, unit=unit)
    np.testing.assert_allclose(reading.depth, [[0.0, metres]])
    assert reading.num_marked == 0


@pytest.mark.parametrize("far", [0.6, 1.5, 3.0, 8.0])
def test_rotated_millimetres_are_known_at_any_distance(far: float) -> None:
    numbers = stored("sun", ramp(0.3, far))
    assert guess_depth_unit(numbers)[0] == "sun"
    numbers[10] += 3  # a few pixels of another program
    assert guess_depth_unit(numbers)[0] == "sun"


def test_millimetres_in_steps_of_eight_are_not_rotated() -> None:
    assert guess_depth_unit((ramp(0.5, 12.0) * 125).astype(np.uint16) * 8)[0] == "mm"


def test_other_multiples_of_eight_are_not_rotated() -> None:
    of_8_bits = np.round(ramp(1.0, 4.0) / 4.0 * 255).astype(np.uint16)
    assert guess_depth_unit(of_8_bits << 8)[0] != "sun"
    assert guess_depth_unit(of_8_bits << 4)[0] == "mm"
    flat = np.where(np.arange(4800).reshape(60, 80) % 2, 2000, 1208).astype(np.uint16)
    assert guess_depth_unit(flat)[0] == "mm"
    assert guess_depth_unit(np.rint(ramp(1.0, 4.0) * 1000).astype(np.uint16) * 4)[0] != "sun"
