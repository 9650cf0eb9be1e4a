"""Rows of a long table: those of wanted frames and of an agent, whatever the footer says; others are not read."""

import shutil
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyarrow import parquet

from mast_zenoh.errors import RunFolderError
from mast_zenoh.run_folder import parquet_footers, tables, unpacking
from mast_zenoh.run_folder.tables import TableFile, read_table, to_arrow

COLUMNS = ("text", "agent", "x")
FRAMES = st.builds(range, st.integers(0, 12), st.integers(0, 12) | st.just(2**63 - 1), st.integers(1, 4))


def content(frames: Sequence[int]) -> dict[str, Any]:
    """Columns with a row for each of some frames."""
    rows = range(len(frames))
    return {
        "frame": np.array(frames, np.int64),
        "agent": np.array([("ego", "infra_1", "mobile")[row % 3] for row in rows], object),
        "text": np.array([f"row {row}" if row % 2 else "" for row in rows], object),
        "x": np.array([np.nan if row % 5 == 4 else float(row) for row in rows]),
    }


def write(path: Path, frames: Sequence[int], rows_in_group: int = 4, **options: Any) -> Path:
    parquet.write_table(to_arrow(content(frames)), path, row_group_size=rows_in_group, **options)
    return path


def numbers(file: TableFile, frames: range | None = None, agent: str = "") -> list[float]:
    return file.rows(["x"], frames, agent)["x"].tolist()


@pytest.fixture
def groups_read(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The row groups that were read, in order."""
    groups: list[int] = []

    def noted(path: Path, group: int, *arguments: Any) -> Any:
        groups.append(group)
        return unpacking.read_row_group(path, group, *arguments)

    monkeypatch.setattr(tables, "read_row_group", noted)
    return groups


@given(
    frames=st.lists(st.integers(-1, 12), max_size=30),
    rows_in_group=st.integers(1, 9),
    statistics=st.booleans(),
    wanted=st.lists(st.tuples(st.none() | FRAMES, st.sampled_from(["", "ego", "mobile", "nobody"])), max_size=6),
)
def test_rows_are_those_of_the_whole_table_that_are_wanted(
    frames: list[int],
    rows_in_group: int,
    statistics: bool,
    wanted: list[tuple[range | None, str]],
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    path = tmp_path_factory.mktemp("table") / "t.parquet"
    file = TableFile(write(path, frames, rows_in_group, write_statistics=statistics))
    whole = read_table(path)
    for span, agent in wanted:
        inside = [span is None or frame in span for frame in whole["frame"].tolist()]
        mask = np.array(inside, bool) & ((whole["agent"] == agent) | (agent == ""))
        rows = file.rows(COLUMNS, span, agent)
        assert list(rows) == list(COLUMNS)
        for name, column in rows.items():
            np.testing.assert_array_equal(column, whole[name][mask])
            assert column.dtype.kind == whole[name].dtype.kind
        parts = list(file.parts(COLUMNS, span, agent))
        assert [x for part in parts for x in part["text"].tolist()] == rows["text"].tolist()


def test_only_row_groups_that_may_have_a_frame_are_read_and_no_one_twice_for_the_next(
    tmp_path: Path, groups_read: list[int]
) -> None:
    path = write(tmp_path / "t.parquet", np.repeat(np.arange(20), 3).tolist(), 10)
    file = TableFile(path)
    for frame in range(9, 15):
        assert len(numbers(file, range(frame, frame + 1))) == 3
    assert groups_read == [2, 3, 4]
    assert len(numbers(file, range(0, 2**62, 19))) == 6
    assert groups_read[3:] == [0, 1, 2, 3, 4, 5]
    groups_read.clear()
    assert numbers(file, range(0)) == []
    assert numbers(file, range(100, 200)) == []
    assert groups_read == []
    for _ in range(2):
        assert numbers(file, range(3, 4))[1:] == [10.0, 11.0], "in two groups"
    assert groups_read == [0, 1]
    groups_read.clear()
    without = TableFile(write(tmp_path / "u.parquet", list(range(8)), write_statistics=False))
    assert numbers(without, range(5, 6)) == [5.0]
    assert groups_read == [0, 1]


def test_large_row_groups_do_not_stay_in_memory(
    tmp_path: Path, groups_read: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "_RECENT_BYTES", 1)
    file = TableFile(write(tmp_path / "t.parquet", list(range(8))))
    assert [numbers(file, range(frame, frame + 1)) for frame in (1, 2)] == [[1.0], [2.0]]
    assert groups_read == [0, 0]


def with_statistics(path: Path, frames: int, least: int, most: int) -> Path:
    """A file of one row group with rows of one frame, whose footer says another least and largest frame."""
    write(path, [frames] * 4)
    data = path.read_bytes()
    end = len(data) - 8
    begin = end - int.from_bytes(data[end : end + 4], "little")
    footer, true = data[begin:end], frames.to_bytes(8, "little")
    places = [at for at in range(len(footer)) if footer.startswith(true, at)]
    assert len(places) >= 2
    for index, at in enumerate(places):  # the largest comes first, in the old form and in the new one
        footer = footer[:at] + (least if index % 2 else most).to_bytes(8, "little") + footer[at + 8 :]
    path.write_bytes(data[:begin] + footer + data[end:])
    found = parquet.read_metadata(path).row_group(0).column(0).statistics
    assert (found.min, found.max) == (least, most)
    return path


def test_a_footer_that_lies_adds_no_row(tmp_path: Path) -> None:
    wide = TableFile(with_statistics(tmp_path / "wide.parquet", 123_456_789, 0, 10**12))
    assert numbers(wide, range(10)) == []
    assert len(numbers(wide, range(123_456_789, 123_456_790))) == 4
    other = TableFile(with_statistics(tmp_path / "other.parquet", 123_456_789, 3, 5))
    assert numbers(other, range(3, 6)) == []
    reversed_ = TableFile(with_statistics(tmp_path / "reversed.parquet", 123_456_789, 9, 0))
    assert numbers(reversed_, range(10)) == []
    assert len(numbers(reversed_)) == 4


def test_a_file_that_is_replaced_is_read_anew_but_never_both(tmp_path: Path) -> None:
    path = write(tmp_path / "t.parquet", list(range(12)))
    file = TableFile(path)
    assert numbers(file, range(1, 3)) == [1.0, 2.0]
    parts = file.parts(["x"])
    assert next(parts)["x"].tolist() == [0.0, 1.0, 2.0, 3.0]
    write(tmp_path / "new.parquet", [5, 5, 1]).replace(path)
    with pytest.raises(RunFolderError, match=r"t\.parquet.*before.*replaced"):
        next(parts)
    assert numbers(file, range(1, 3)) == [2.0]
    path.unlink()
    with pytest.raises(FileNotFoundError):
        numbers(file)
    path.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RunFolderError, match=r"link.*file"):
        numbers(file)


def test_a_link_in_the_place_of_a_table_is_not_followed_for_a_later_frame(tmp_path: Path) -> None:
    path = write(tmp_path / "t.parquet", list(range(12)))
    file = TableFile(path)
    parts = file.parts(["x"])
    next(parts)
    shutil.copy(path, tmp_path / "elsewhere")
    path.unlink()
    path.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RunFolderError, match=r"link.*file"):
        next(parts)


def test_what_cannot_be_used_is_named(tmp_path: Path) -> None:
    file = TableFile(tmp_path / "t.parquet")
    with pytest.raises(FileNotFoundError):
        _ = file.columns
    write(file.path, [1, 2])
    assert file.columns == ["frame", "agent", "text", "x"]
    with pytest.raises(RunFolderError, match=r"t\.parquet.*column q"):
        file.rows(["x", "r", "q"])
    parquet.write_table(pyarrow.table({"frame": ["one"], "x": [1.0]}), file.path)
    with pytest.raises(RunFolderError, match=r"t\.parquet.*frame.*numbers"):
        numbers(file, range(3))
    with pytest.raises(RunFolderError, match=r"t\.parquet.*column agent"):
        numbers(file, agent="ego")
    assert numbers(file) == [1.0]
    for damage in (b"hello", b""):
        file.path.write_bytes(damage)
        with pytest.raises(RunFolderError, match=r"t\.parquet: "):
            numbers(file)


@pytest.mark.parametrize("kind", [pyarrow.int8(), pyarrow.uint64(), pyarrow.float32()])
def test_frames_of_any_kind_of_number_are_compared(tmp_path: Path, kind: Any) -> None:
    table = pyarrow.table({"frame": pyarrow.array([1, 2, None, 4], kind), "x": [0.0, 1.0, 2.0, 3.0]})
    parquet.write_table(table, tmp_path / "t.parquet")
    assert numbers(TableFile(tmp_path / "t.parquet"), range(2, 2**63 - 1)) == [1.0, 3.0]
    whole = pyarrow.table({"frame": pyarrow.array([1, 2, 3, 4], kind), "x": [0.0, 1.0, 2.0, 3.0]})
    parquet.write_table(whole, tmp_path / "t.parquet", write_statistics=False)
    assert numbers(TableFile(tmp_path / "t.parquet"), range(2000, 2001)) == []


def test_too_much_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = TableFile(write(tmp_path / "t.parquet", list(range(4000)), 1000))
    monkeypatch.setattr(tables, "MAX_TABLE_BYTES", 9000)
    assert len(numbers(file, range(1100))) == 1100
    with pytest.raises(RunFolderError, match=r"t\.parquet.*16000.*wanted"):
        numbers(file)
    assert sum(len(part["x"]) for part in file.parts(["x"])) == 4000
    monkeypatch.setattr(unpacking, "MAX_TABLE_BYTES", 7999)
    with pytest.raises(RunFolderError, match=r"t\.parquet.*bytes unpacked"):
        numbers(TableFile(file.path), range(1))


@pytest.mark.parametrize(
    ("table", "problem"),
    [
        (pyarrow.table([pyarrow.array([1, 2]), pyarrow.array([3, 4])], names=["frame", "frame"]), "one name"),
        (pyarrow.table({"frame": [1, 2, 3]}), "share"),
    ],
)
def test_columns_of_one_name_and_row_groups_that_are_named_again_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, table: Any, problem: str
) -> None:
    parquet.write_table(table, tmp_path / "t.parquet")
    whole = parquet_footers.read_struct

    def doubled(content: bytes, at: int) -> Any:
        fields, end = whole(content, at)
        for group in fields[4]:
            for chunk in group[1]:
                chunk[3][7] += 10_000  # bytes of the chunk
        return fields, end

    if problem == "share":
        monkeypatch.setattr(parquet_footers, "read_struct", doubled)
    with pytest.raises(RunFolderError, match=problem):
        read_table(tmp_path / "t.parquet")


def flipped(path: Path, at: int, bits: int) -> None:
    damaged = bytearray(path.read_bytes())
    damaged[at] ^= bits
    path.write_bytes(damaged)


def test_no_byte_of_a_footer_ends_the_process(tmp_path: Path) -> None:
    """Arrow itself does: where a footer says that a column is of another type than in the schema, for example."""
    parquet.write_table(to_arrow({"frame": np.arange(4), "agent": ["ego"] * 4}), tmp_path / "t.parquet")
    whole = (tmp_path / "t.parquet").read_bytes()
    start = len(whole) - 8 - int.from_bytes(whole[-8:-4], "little")
    for at in range(start, len(whole)):
        (tmp_path / "t.parquet").write_bytes(whole)
        flipped(tmp_path / "t.parquet", at, 255 if at % 2 else 1)
        with suppress(RunFolderError):
            read_table(tmp_path / "t.parquet")


@given(data=st.data())
def test_of_a_damaged_file_wanted_rows_are_read_or_it_is_refused(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = write(tmp_path_factory.mktemp("table") / "t.parquet", list(range(20)))
    for _ in range(data.draw(st.integers(1, 3))):
        flipped(path, data.draw(st.integers(0, path.stat().st_size - 1)), data.draw(st.integers(1, 255)))
    file = TableFile(path)
    with suppress(RunFolderError):
        assert set(file.rows(["frame", "agent"], range(3, 9), "ego")["frame"].tolist()) <= set(range(3, 9))
