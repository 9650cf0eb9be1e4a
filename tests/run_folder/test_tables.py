"""Tables survive a round trip to a file, without loading pandas."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from table_writing import write_table

from mast_zenoh.errors import RunFolderError
from mast_zenoh.run_folder.tables import from_arrow, read_table, to_arrow

texts = st.lists(st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=8), max_size=20)


@given(texts=texts, data=st.data())
def test_columns_are_read_back_unchanged(texts: list[str], data: st.DataObject) -> None:
    n = len(texts)
    table = {
        "object": np.array(texts, object),
        "text": np.array(texts, str) if n else np.zeros(0, "U1"),
        "number": np.array(data.draw(st.lists(st.floats(), min_size=n, max_size=n)), float),
        "whole": np.arange(n),
        "yes": np.arange(n) % 2 == 0,
    }
    again = from_arrow(to_arrow(table))
    assert again.keys() == table.keys()
    for name in ("object", "text"):
        assert again[name].tolist() == texts
    for name in ("number", "whole", "yes"):
        np.testing.assert_array_equal(again[name], table[name])


def test_an_unreadable_table_is_named(tmp_path: Path) -> None:
    (tmp_path / "bad.parquet").write_text("hello")
    for name in ("bad.parquet", "absent.parquet"):
        with pytest.raises(RunFolderError, match=name):
            read_table(tmp_path / name)


def test_other_values_in_a_column_of_text_are_written_as_text(tmp_path: Path) -> None:
    write_table(tmp_path / "t.parquet", {"mixed": np.array(["a", 3, 0.5], object)})
    assert read_table(tmp_path / "t.parquet")["mixed"].tolist() == ["a", "3", "0.5"]


def test_tables_do_not_load_pandas_but_it_can_still_be_imported(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    program = (
        "import sys, numpy as np\n"
        "from pathlib import Path\n"
        "from mast_zenoh.run_folder.tables import read_arrow, read_table, to_arrow\n"
        "from pyarrow import parquet\n"
        "path = Path('t.parquet')\n"
        "parquet.write_table(to_arrow({'name': np.array(['a', 'b']), 'x': np.array([1.0, np.nan])}), path)\n"
        "read_table(path)\n"
        "assert 'pandas' not in sys.modules\n"
        "assert read_arrow(path).to_pandas()['name'].tolist() == ['a', 'b']\n"
    )
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True)
