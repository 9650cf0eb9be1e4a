"""XML and compressed text from outside cannot use up memory, and numbers in text are strict."""

import gzip
from pathlib import Path

import pytest
from mast_datasets import files
from mast_datasets.files import MAX_LINE, Coordinate, Element, read_lines, read_pieces, read_xml

from mast_zenoh.errors import SceneError


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "file"


def test_elements_are_read_one_after_the_other_with_their_lines(file: Path) -> None:
    file.write_text('<r a="1">\n<b><c>x</c></b>\n<other><b><b/></b></other></r>')
    root, *elements = read_xml(file, "r", ("b",))
    assert (root.tag, root.value) == ("r", {"a": "1"})
    assert [(each.place, each.value) for each in elements] == [("line 2: <b>", {"c": "x"}), ("line 3: <b>", {"b": ""})]


def test_children_are_found_whether_there_are_none_one_or_several(file: Path) -> None:
    file.write_text("<r><b> <c>1</c> </b><b k='v'><c> 1 </c><c d='2'/></b></r>")
    _, one, several = read_xml(file, "r", ("b",))
    assert [each.value for each in one.several("c")] == ["1"]
    assert [(each.place, each.value) for each in several.several("c")] == [
        ("line 1: <b>.c[0]", "1"),
        ("line 1: <b>.c[1]", {"d": "2"}),
    ]
    assert several["k"].text() == "v"
    assert one.several("d") == []


@pytest.mark.parametrize("compress", [bytes, gzip.compress])
def test_reading_stops_at_the_limit_of_the_unpacked_size(file: Path, compress) -> None:
    file.write_bytes(compress(b"<r>" + b"  \n" * 700_000 + b"</r>"))
    assert len(list(read_xml(file, "r", ()))) == 1
    with pytest.raises(SceneError, match="file: found more than 1000000 bytes unpacked"):
        list(read_xml(file, "r", (), max_bytes=1_000_000))
    with pytest.raises(SceneError, match="found more than 1000000 bytes"):
        list(read_lines(file, max_bytes=1_000_000))


def test_entities_are_refused_before_any_is_expanded(file: Path) -> None:
    entities = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 12))
    file.write_text(f'<!DOCTYPE r [<!ENTITY e0 "lol">{entities}]><r>&e11;</r>')
    with pytest.raises(SceneError, match="file: line 1: found a document type declaration"):
        list(read_xml(file, "r", ("r",)))
    file.write_text("<r>\n&e11;</r>")
    with pytest.raises(SceneError, match="file: line 2: not XML: undefined entity"):
        list(read_xml(file, "r", ()))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: not XML: no element found"),
        ("<r><b></r>", "line 1: not XML: mismatched tag"),
        ('<?xml version="1.0" encoding="nothing"?><r/>', "line 1: not XML: "),
        ("<s/>", "line 1: <s>: found this root, expected <r>"),
        ("<r>" * 100_000, "line 1: not XML: no element found"),
        ("<r>\n<b>" + "<c/>" * 101 + "</b></r>", "line 2: <b>: found more than 100 elements in it"),
        ("<r>\n<b><c/><c/></b></r>", r"line 2: <b>.c: found \['', ''\], expected an object"),
        ("<r>\n<b><d/><e/></b></r>", "line 2: <b>: c is missing"),
        ("<r>\n<b><c x='1' y='2'/></b></r>", "line 2: <b>.c: a is missing"),
    ],
)
def test_damaged_files_are_refused_with_their_line(
    file: Path, text: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mast_datasets.files._MAX_PARTS", 100)
    file.write_text(text)
    with pytest.raises(SceneError, match=f"file: {message}"):
        [element["c"]["a"] for element in read_xml(file, "r", ("b",)) if element.tag == "b"]


def test_lines_are_read_across_pieces(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "_PIECE", 4)
    file.write_bytes("\ufeffa,b\r\nüü\n\nlast".encode())
    assert list(read_lines(file)) == ["a,b", "üü", "", "last"]


def test_bytes_that_are_not_text_and_lines_without_end_are_refused(file: Path) -> None:
    file.write_bytes(b"a\n\xff\n")
    with pytest.raises(SceneError, match="file: line 2: 'utf-8' codec"):
        list(read_lines(file))
    file.write_bytes(b"a\n" + b"x" * (MAX_LINE + 1) * 3)
    with pytest.raises(SceneError, match=f"file: line 2: found more than {MAX_LINE} bytes"):
        list(read_lines(file))


def test_a_missing_or_truncated_file_is_refused(file: Path) -> None:
    with pytest.raises(SceneError, match=r"file: cannot be read: .*No such file"):
        list(read_pieces(file))
    file.write_bytes(gzip.compress(b"<r/>" * 1000)[:-20])
    with pytest.raises(SceneError, match="file: cannot be read: "):
        list(read_pieces(file))


def test_text_of_numbers_is_read_and_anything_else_is_refused() -> None:
    for text, value in (("1", 1.0), ("-1.5e3", -1500.0), ("0.50", 0.5)):
        assert Element(text, Path("file"), "x").read(Coordinate) == value
    for text in ("", "nan", "inf", "0x1", "1e999", "1,5", "--1", "1 2", "7.", "+1", "9" * 5000):
        with pytest.raises(SceneError, match=r"file: x: found .*(expected `float`|number out of range)"):
            Element(text, Path("file"), "x").read(Coordinate)
