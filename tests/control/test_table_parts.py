"""Tables that a node appends rows to leave it in parts, which depend on the rows alone."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyarrow import parquet

from mast_zenoh.errors import MessageError
from mast_zenoh.launch import conclusion
from mast_zenoh.launch.table_files import TableFiles
from mast_zenoh.mesh.control import results
from mast_zenoh.mesh.control.results import PART_BYTES, PART_ROWS, PartedTables, TablePart, encode_part
from mast_zenoh.run_folder.tables import TableFile, read_table

ROWS = 2 * PART_ROWS + 17


def columns(start: int, stop: int) -> dict[str, Any]:
    """Rows of a table with a number, a missing value and a text."""
    rows = np.arange(start, stop)
    text = np.array([f"agent {row % 3}" for row in rows], object)
    return {"row": rows, "value": np.where(rows % 7, rows * 0.5, np.nan), "agent": text}


def parts_of(step: int, *, last: int = 0) -> list[TablePart]:
    """The parts of a table whose rows are appended `step` at a time, the last ones as a result."""
    tables, parts = PartedTables(), list[TablePart]()
    tables.hand_in = parts.append
    for start in range(0, ROWS - last, step):
        tables.append("t", columns(start, min(start + step, ROWS - last)))
    assert tables.close({"n": 1, "tables": {"t": columns(ROWS - last, ROWS)}}) == {"n": 1}
    return parts


def written(folder: Path, parts: list[TablePart]) -> bytes:
    """The file of these parts, which travelled as bytes."""
    folder.mkdir()
    files = TableFiles(folder)
    for part in parts:
        files.add("node", *results.decode_part(results.encode_part("p", part)))
    files.close()
    assert files.problem is None
    assert not files.refused
    return (folder / "results/node/t.parquet").read_bytes()


def test_the_file_does_not_depend_on_how_rows_were_appended(tmp_path: Path) -> None:
    first = written(tmp_path / "many", parts_of(1000))
    assert first == written(tmp_path / "few", parts_of(100_000, last=7))
    assert first == written(tmp_path / "result", parts_of(ROWS, last=ROWS))
    path = tmp_path / "many/results/node/t.parquet"
    metadata = parquet.ParquetFile(path).metadata
    assert [metadata.row_group(i).num_rows for i in range(metadata.num_row_groups)] == [PART_ROWS, PART_ROWS, 17]
    table = read_table(path)
    for name, column in columns(0, ROWS).items():
        np.testing.assert_array_equal(table[name], column)
    assert [len(rows["agent"]) for rows in TableFile(path).parts(["agent"])] == [PART_ROWS, PART_ROWS, 17]


def test_few_rows_of_long_text_are_a_part() -> None:
    tables, parts = PartedTables(), list[TablePart]()
    tables.hand_in = parts.append
    for _ in range(40):
        tables.append("t", {"text": ["x" * 1_000_000]})
    tables.close({})
    assert sum(len(part.columns["text"]) for part in parts) == 40
    assert max(len(results.encode_part("p", part)) for part in parts) <= results.MAX_RESULT


def test_a_table_without_rows_is_written_once(tmp_path: Path) -> None:
    tables, parts = PartedTables(), list[TablePart]()
    tables.hand_in = parts.append
    tables.append("t", columns(0, 0))
    assert tables.close({"tables": {"t": {"row": [], "value": [], "agent": []}}}) == {}
    assert len(parts) == 1
    written(tmp_path / "run", parts)
    assert read_table(tmp_path / "run/results/node/t.parquet").keys() == columns(0, 0).keys()


def test_without_a_launcher_the_rows_are_in_the_results() -> None:
    tables = PartedTables()
    tables.append("t", columns(0, 5))
    table = tables.close({"tables": {"t": columns(5, 9), "other": {"a": [1]}}})["tables"]
    assert table["t"]["row"].tolist() == [*range(9)]
    assert table["other"] == {"a": [1]}


@pytest.mark.parametrize(
    ("name", "rows", "message"),
    [
        ("../t", {"a": [1]}, "expected a name"),
        ("t", {"a": [1], "b": [1, 2]}, "different lengths"),
        ("t", {"a": np.zeros((2, 2))}, r"numbers.*text"),
        ("t", {}, "expected 1 to 1000"),
        ("t", {"b": [1]}, "rows before"),
        ("t", {"a": [1.5]}, "rows before"),
    ],
)
def test_rows_that_do_not_fit_are_refused(name: str, rows: dict[str, Any], message: str) -> None:
    tables = PartedTables()
    tables.append("t", {"a": [1]})
    with pytest.raises(MessageError, match=message):
        tables.append(name, rows)
    assert tables.close({})["tables"]["t"]["a"].tolist() == [1]


@pytest.mark.parametrize("is_launched", [True, False])
def test_of_an_invalid_table_of_the_results_stays_the_reason(is_launched: bool) -> None:
    tables = PartedTables()
    tables.append("kept", {"a": [1]})
    if is_launched:
        tables.hand_in = list[TablePart]().append
    left = tables.close({"tables": {"t": {"a": [1]}, "../t": {"a": [1]}, "kept": {"a": [0.5]}}})["tables"]
    assert left["../t"].startswith("table '../t': expected")
    assert "before: {'a': '<i8'}" in left["kept"]
    assert ("t" in left) != is_launched


def test_parts_that_come_twice_or_out_of_order_or_of_a_replaced_process_change_nothing(tmp_path: Path) -> None:
    files = TableFiles(tmp_path)
    part = TablePart("t", 0, {"a": np.arange(3)})
    files.add("node", "first", part)
    files.add("node", "first", part)
    with pytest.raises(MessageError, match=r"part 2.*part"):
        files.add("node", "first", part._replace(number=2))
    files.add("node", "second", part)
    files.add("node", "second", part._replace(number=1, columns={"a": np.arange(3, 6)}))
    with pytest.raises(MessageError, match="replaced"):
        files.add("node", "first", part._replace(number=1))
    files.close()
    assert read_table(tmp_path / "results/node/t.parquet")["a"].tolist() == [*range(6)]
    assert [path.name for path in (tmp_path / "results/node").iterdir()] == ["t.parquet"]


def test_a_table_whose_columns_change_is_refused_from_then_on(tmp_path: Path) -> None:
    files = TableFiles(tmp_path)
    files.add("node", "p", TablePart("t", 0, {"a": np.arange(3)}))
    files.add("node", "p", TablePart("t", 1, {"a": np.arange(3.0)}))
    files.add("node", "p", TablePart("u", 2, {"a": np.arange(3)}))
    files.close()
    assert list(files.refused) == [("node", "t")]
    assert read_table(tmp_path / "results/node/t.parquet")["a"].tolist() == [0, 1, 2]
    assert read_table(tmp_path / "results/node/u.parquet")["a"].tolist() == [0, 1, 2]


@pytest.mark.parametrize("appended", [1, 7, 1000])
def test_a_part_is_never_larger_than_it_may_be_however_unevenly_long_texts_are(appended: int) -> None:
    tables, parts = PartedTables(), list[TablePart]()
    tables.hand_in = parts.append
    texts = [*[""] * 2000, *["x" * 1_500_000] * 30, *["ü" * 3] * 500]
    for start in range(0, len(texts), appended):
        tables.append("t", {"text": texts[start : start + appended]})
    tables.close({})
    assert [text for part in parts for text in part.columns["text"]] == texts
    assert [len(part.columns["text"]) for part in parts] == [2002, *[2] * 13, 502]
    assert max(len(encode_part("a" * 32, part)) for part in parts) <= PART_BYTES


def test_a_row_that_fits_into_no_part_is_refused_and_the_others_are_kept() -> None:
    tables = PartedTables()
    tables.append("t", {"text": ["a"]})
    with pytest.raises(MessageError, match="t: found 20000005"):
        tables.append("t", {"text": ["b", "x" * 5_000_000]})
    assert tables.close({})["tables"]["t"]["text"].tolist() == ["a"]


def test_a_node_whose_parts_were_not_all_taken_is_named_with_the_reason(tmp_path: Path) -> None:
    files = TableFiles(tmp_path)
    files.add("node", "first", TablePart("t", 0, {"a": np.arange(3)}))
    files.add("lost", "first", TablePart("t", 0, {"a": np.arange(3)}))
    with pytest.raises(MessageError):
        files.add("node", "first", TablePart("t", 2, {"a": np.arange(3)}))
    files.close()
    lost, node = conclusion.write_results(tmp_path, {"node": {}}, {}, files)
    assert (lost.startswith("lost: its tables"), "table t: found part 2" in node) == (True, True)
