"""The folder of a finished study is opened as the object that carrying it out returns."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from small_study import SMALL

import mast_zenoh as mast
from mast_zenoh.errors import RunFolderError
from mast_zenoh.study import trials


def test_a_study_of_trials_is_opened_with_its_tables(whole: trials.StudyResult) -> None:
    opened = mast.open(whole.out)
    assert isinstance(opened, mast.FinishedStudy)
    assert (opened.runs, opened.report) == ({}, whole.report)
    assert set(opened.table()["configuration"].to_pylist()) == set(whole.facts.configurations)
    assert len(opened.results) > len(opened.frames) > 0
    assert str(opened) == (whole.out / "table.md").read_text()


@pytest.mark.usefixtures("unpainted")
def test_a_study_of_single_runs_is_opened_with_its_runs(tmp_path: Path) -> None:
    (file := tmp_path / "single.py").write_text(SMALL.replace("trials=trials,", ""))
    made = mast.study(str(file), out=tmp_path / "out", frames=4)
    opened = mast.open(tmp_path / "out")
    assert list(opened.runs) == list(made.runs)
    assert opened.table() == made.table()
    assert str(opened) == str(made)


@pytest.mark.parametrize("runs", [None, 3, {"a": 1}, ["..", "../x", "/etc", 7, [], "nosuch"]])
def test_nothing_outside_a_folder_is_opened_whatever_its_study_json_says(tmp_path: Path, runs: object) -> None:
    (tmp_path / "study.json").write_text(json.dumps({"runs": runs}))
    opened = mast.open(tmp_path)
    assert opened.runs == {}
    with pytest.raises(RunFolderError, match=r"table\.csv: missing"):
        opened.table()
    (tmp_path / "table.csv").write_text("a,b" * 1000 + "\n1\n")
    with pytest.raises(RunFolderError, match=r"table\.csv: no table: CSV"):
        opened.table()
