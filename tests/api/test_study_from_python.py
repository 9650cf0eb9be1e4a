"""`mast.study` runs a study and gives the same tables as `mast study`."""

from pathlib import Path

import pytest
from pyarrow import csv

import mast_zenoh as mast
from mast_zenoh.errors import ConfigurationError, RunFolderError, TrialsFailed

STUDY = """
def study(n_adversaries=1):
    small = dict(n_infrastructure=1)
    attack = small | dict(n_adversaries=n_adversaries, attack_start_s=1.0)
    return dict(
        runs=dict(
            baseline=dict(scenario="baseline", parameters=small),
            attacked=dict(scenario="uncoordinated", parameters=attack),
        ),
        frames=30,
    )
"""


@pytest.fixture
def study_file(tmp_path: Path) -> Path:
    file = tmp_path / "mine.py"
    file.write_text(STUDY)
    return file


@pytest.mark.heavy
def test_a_study_writes_the_same_tables_as_the_command_line(study_file: Path, tmp_path: Path) -> None:
    study = mast.study(study_file, trials=2, jobs=1, out=tmp_path / "out")
    assert study.table().equals(csv.read_csv(tmp_path / "out" / "table.csv"))
    assert {"baseline", "attacked"} == set(study.table()["configuration"].to_pylist())
    assert set(study.results["seed"].to_pylist()) == {0, 1}
    assert study.frames.num_rows
    assert study.report.is_file()
    assert "attacked" in str(study)
    assert "attacked" in study._repr_html_()
    assert study.runs == {}
    with pytest.raises(ConfigurationError, match="without `trials`"):
        _ = study.comparison


@pytest.mark.usefixtures("unpainted")
def test_a_study_without_trials_keeps_a_run_of_each_configuration(study_file: Path, tmp_path: Path) -> None:
    study = mast.study(study_file, out=tmp_path / "out")
    assert list(study.runs) == ["baseline", "attacked"]
    assert all(run.record["runtime"] == "inproc" for run in study.runs.values())
    assert study.table().equals(mast.compare(*study.runs.values()).table)
    assert study.report == (tmp_path / "out" / "report.html").resolve()
    assert "attacked" in str(study)
    with pytest.raises(RunFolderError, match=r"study.*`trials` writes"):
        _ = study.results


def test_invalid_arguments_are_refused(study_file: Path, tmp_path: Path) -> None:
    for options, words in (
        (dict(n_adversary=2), "did you mean 'n_adversaries'"),
        (dict(trial=2), "did you mean 'trials'"),
        (dict(runtime="cloud"), "expected inproc or mesh"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            mast.study(study_file, out=tmp_path / "out", **options)
    with pytest.raises(ConfigurationError, match="mast study rogue"):
        mast.study("rogue")


def test_failed_trials_raise_an_error_that_names_the_folder(
    study_file: Path, failing_scenario: Path, tmp_path: Path
) -> None:
    study_file.write_text(STUDY.replace("dict(n_infrastructure=1)", 'dict(n_infrastructure=1, scene="mine:1")'))
    with pytest.raises(ConfigurationError):
        mast.study(study_file, trials=1, jobs=1, out=tmp_path / "out")
    study_file.write_text(STUDY.replace('scenario="baseline"', f'scenario="{failing_scenario.name}"'))
    with pytest.raises(TrialsFailed, match="baseline") as failed:
        mast.study(study_file, trials=1, jobs=1, out=tmp_path / "failed")
    assert str(tmp_path / "failed") in failed.value.__notes__[0]
