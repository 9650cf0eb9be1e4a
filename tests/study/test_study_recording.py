"""Recorded studies: runs of single configurations, and of all trials."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from small_study import tables, write_small

from mast_zenoh.errors import ConfigurationError, RunFolderError
from mast_zenoh.messagelog.reader import file_of
from mast_zenoh.study import definition, interface, trials
from mast_zenoh.study.store import Store

pytestmark = pytest.mark.heavy

OPTIONS = {"count": 1, "runtime": "inproc"}


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> definition.Study:
    return definition.load(str(write_small(tmp_path_factory.mktemp("file"))))


@pytest.fixture(scope="module")
def recorded(small: definition.Study, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return trials.run(small, tmp_path_factory.mktemp("study") / "out", record=True, **OPTIONS).out


def runs(folder: Path) -> list[Path]:
    return [folder / trial["run"] for trial in json.loads((folder / "study.json").read_text())["trials"]]


def test_a_recorded_study_keeps_the_recorded_run_of_each_trial(recorded: Path) -> None:
    assert len(runs(recorded)) == 3
    for run in runs(recorded):
        assert file_of(run).stat().st_size > 1000


def test_recording_changes_no_table(small: definition.Study, recorded: Path, tmp_path: Path) -> None:
    plain = trials.run(small, tmp_path / "plain", **OPTIONS).out
    assert tables(plain) == tables(recorded)
    assert not (plain / "runs").exists()


def test_a_finished_study_can_be_recorded_later(small: definition.Study, recorded: Path) -> None:
    first, *others = runs(recorded)
    before = [(run / "messages.mcap").stat().st_mtime_ns for run in others]
    (first / "messages.mcap").unlink()
    trials.run(small, recorded, record=True, resume=True, **OPTIONS)
    assert file_of(first)
    assert [(run / "messages.mcap").stat().st_mtime_ns for run in others] == before


def test_recorded_trials_are_refused_on_a_cluster(small: definition.Study, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="expected no --cluster"):
        trials.run(small, tmp_path / "out", record=True, cluster="tcp://127.0.0.1:1", **OPTIONS)


def test_runs_of_single_configurations_are_recorded_or_say_how_to(small: definition.Study, tmp_path: Path) -> None:
    kept = interface.run_once(small, tmp_path / "kept", runtime="inproc", record=True)
    assert all(file_of(folder) for folder in kept.folders.values())
    plain = interface.run_once(small, tmp_path / "plain", runtime="inproc")
    with pytest.raises(RunFolderError) as caught:
        file_of(plain.folders["attacked-1-5.0"])
    command = str(caught.value).rpartition("with a recording: ")[2]
    assert command.startswith("mast run uncoordinated --set scene=intersection:0 ")
    assert "--set n_adversaries=1" in command
    assert command.endswith("--seed 0 --frames 8 --runtime inproc")


def test_a_study_whose_folder_of_runs_is_a_link_is_not_continued(
    small: definition.Study, recorded: Path, tmp_path: Path
) -> None:
    received, outside = tmp_path / "study", tmp_path / "outside"
    shutil.copytree(recorded, received)
    (received / "runs").rename(outside)
    (received / "runs").symlink_to(outside)
    before = sorted(outside.rglob("*"))
    with pytest.raises(RunFolderError, match="found a link"):
        Store.create(received, small, resume=True)
    assert sorted(outside.rglob("*")) == before
