"""Tables that a spreadsheet has saved are read like those that were written by hand."""

from __future__ import annotations

import codecs
from pathlib import Path

import pytest

from manip3d import FormatError
from manip3d._util.csv_tables import csv_records, csv_rows
from manip3d.io._joint_files import read_joint_file
from manip3d.study._replacing import refuse_other_stimuli

ROWS = [["file", "share", "name"], ["a.png", "-0.5", "x, y"], ["b.png", "1.5e-3", ""]]


def written(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize(
    "content",
    [
        'file,share,name\na.png,-0.5,"x, y"\nb.png,1.5e-3,\n',
        'file,share,name\r\na.png,-0.5,"x, y"\r\nb.png,1.5e-3,\r\n,,\r\n ,,\r\n',
        "file;share;name\r\na.png;-0,5;x, y\r\nb.png;1,5e-3;\r\n;;\r\n",
        '"file";"share";"name"\n"a.png";"-0.5";"x, y"\n"b.png";"1,5e-3";""\n',
        "file\tshare\tname\na.png\t-0,5\tx, y\nb.png\t1,5e-3\t\n",
        "\ufefffile;share;name\na.png;-0,5;x, y\n\nb.png;1,5e-3;\n",
        "\n ;;\nfile;share;name\na.png;-0,5;x, y\nb.png;1,5e-3;\n",
        "file;share;name\ra.png;-0,5;x, y\rb.png;1,5e-3;\r",
        "sep=;\r\nfile;share;name\r\na.png;-0,5;x, y\r\nb.png;1,5e-3;\r\n",
        "\ufeffSEP=|\nfile|share|name\na.png|-0,5|x, y\nb.png|1,5e-3|\n",
        "sep=\t\nfile\tshare\tname\na.png\t-0,5\tx, y\nb.png\t1,5e-3\t\n",
    ],
)
def test_spreadsheets_of_all_countries_save_the_same_table(tmp_path: Path, content: str) -> None:
    table = written(tmp_path / "t.csv", content)
    assert [row for _, row in csv_rows(table)] == ROWS
    assert [row["share"] for row in csv_records(table)] == ["-0.5", "1.5e-3"]


@pytest.mark.parametrize(
    ("content", "rows"),
    [
        (
            "file;state;remark, if any\na;1,5;\n",
            [["file", "state", "remark, if any"], ["a", "1.5", ""]],
        ),
        ("file;remark, if any\na;1,5\n", [["file", "remark, if any"], ["a", "1.5"]]),
        ("file,remark; if any\na,1.5\n", [["file", "remark; if any"], ["a", "1.5"]]),
        ("file\tremark, if any\na\t1,5\n", [["file", "remark, if any"], ["a", "1.5"]]),
        ('"file, type, name";x\na;1,5\n', [["file, type, name", "x"], ["a", "1.5"]]),
        ('"file,\nname";x\na;1,5\n', [["file,\nname", "x"], ["a", "1.5"]]),
        ("file, x\na, 1.5\n", [["file", " x"], ["a", " 1.5"]]),
        ("file\na\n", [["file"], ["a"]]),
        ("", []),
    ],
)
def test_names_of_columns_may_hold_other_separators(
    tmp_path: Path, content: str, rows: list[list[str]]
) -> None:
    assert [row for _, row in csv_rows(written(tmp_path / "t.csv", content))] == rows


def test_rows_have_their_lines(tmp_path: Path) -> None:
    table = written(tmp_path / "t.csv", 'a,b\n\n1,"two\nlines"\n,\n3,4\n')
    assert [line for line, _ in csv_rows(table)] == [1, 4, 6]
    named = written(tmp_path / "named.csv", "sep=;\r\na;b\r\n1;2\r\n")
    assert [line for line, _ in csv_rows(named)] == [2, 3]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (codecs.BOM_UTF16_LE + "a,b".encode("utf-16-le"), "got UTF-16: save it as CSV UTF-8"),
        (codecs.BOM_UTF16_BE + "a,b".encode("utf-16-be"), "got UTF-16: save it as CSV UTF-8"),
        ("a,é".encode("latin-1"), "expected CSV in UTF-8"),
        (b'a,b\n1,"2\n', r"line 2: expected CSV: unexpected end of data"),
        (b'a,b\n1,"0,5"\n', 'line 2: expected a decimal point, got a decimal comma in "0,5"'),
        (b"a" * 100, "expected at most 50 bytes"),
    ],
)
def test_what_is_wrong_with_a_table_is_said(tmp_path: Path, content: bytes, message: str) -> None:
    table = written(tmp_path / "t.csv", content)
    with pytest.raises(FormatError, match=message):
        list(csv_rows(table, most_bytes=50))


def test_joints_and_stimuli_may_come_from_a_spreadsheet_with_decimal_commas(tmp_path: Path) -> None:
    plain = "frame,id,joint,x,y,z,state\n0,1,0,0.5,-0.25,2.5,2\n0,1,1,0.5,0.25,2.5,1\n"
    table = written(tmp_path / "joints.csv", plain)
    spreadsheet = plain.replace(",", ";").replace(".", ",") + ";;;;;;\n"
    other = written(tmp_path / "other.csv", spreadsheet)
    expected, found = read_joint_file(table).frames[0][0], read_joint_file(other).frames[0][0]
    assert (found.joints == expected.joints).all()
    assert (found.trust == expected.trust).all()
    folder = tmp_path / "stimuli"
    folder.mkdir()
    written(folder / "stimuli.csv", "file;truth\na.png;real\n;\n")
    (folder / "a.png").touch()
    refuse_other_stimuli(folder, "stimuli.csv")
