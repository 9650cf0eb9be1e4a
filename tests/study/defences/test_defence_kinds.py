"""The kinds of studies of defences."""

from __future__ import annotations

import os
import subprocess
import sys
from inspect import signature
from pathlib import Path

import pytest

from mast_zenoh.study.defences import BreakdownCell, Cell, DriftCell
from mast_zenoh.study.defences.kinds import KINDS, Kind, kind_named, kind_of

NAMES = [kind.name for kind in KINDS]


def test_a_cell_tells_its_kind_of_study() -> None:
    cells = (Cell("NoIntegrity"), DriftCell(0.5), BreakdownCell("", 5, 0, 4.0))
    assert [kind.name for kind in map(kind_of, cells) if kind] == NAMES == ["matrix", "drift", "breakdown"]
    assert kind_of("cell") is None


@pytest.mark.parametrize("kind", KINDS, ids=NAMES)
def test_every_kind_has_a_folder_with_an_evaluation_and_a_collection(kind: Kind, tmp_path: Path) -> None:
    assert kind_named(kind.name) is kind
    assert list(signature(kind._module("trial").evaluate).parameters) == ["folder", "metrics", "compromised"]
    files = kind.collect({}, ["junction"], [0]).write(tmp_path)
    assert {*files.names} == {path.name for path in tmp_path.iterdir()}
    assert {Path(name).suffix for name in files.names} >= {".md", ".csv", ".tex"}


def test_the_part_of_an_undisturbed_trial_exists() -> None:
    assert all(kind.without_lies()["lies"]["all"] == 0 for kind in KINDS if kind.undisturbed)


def test_kinds_load_no_statistics_tables_or_drawing_libraries() -> None:
    code = (
        "import sys, mast_zenoh.study.defences.kinds\n"
        "print([n for n in ('matplotlib', 'pyarrow', 'zenoh', 'rich', 'scipy.stats') if n in sys.modules])"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=os.environ)
    assert process.stdout.strip() == "[]"
