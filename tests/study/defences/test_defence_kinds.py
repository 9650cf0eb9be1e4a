"""The kinds of studies of defences."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from mast_zenoh.study.defences import BreakdownCell, Cell, DriftCell
from mast_zenoh.study.defences.kinds import DefenceCell, collection_of

CELLS = (Cell("NoIntegrity"), DriftCell(0.5), BreakdownCell("", 5, 0, 4.0))


@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: cell.kind)
def test_every_kind_writes_its_tables_even_of_no_trial(cell: DefenceCell, tmp_path: Path) -> None:
    collection = collection_of(cell.kind)
    files = collection({}, ["junction"], [0]).write(tmp_path)
    assert {*files.names} == {path.name for path in tmp_path.iterdir()}
    assert {Path(name).suffix for name in files.names} >= {".md", ".csv", ".tex"}
    assert collection.without_lies is None or collection.without_lies["lies"]["all"] == 0


def test_cells_load_no_statistics_tables_or_drawing_libraries() -> None:
    code = (
        "import sys, mast_zenoh.study.defences\n"
        "print([n for n in ('matplotlib', 'pyarrow', 'zenoh', 'rich', 'scipy.stats') if n in sys.modules])"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=os.environ)
    assert process.stdout.strip() == "[]"
