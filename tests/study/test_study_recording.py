"""Recorded studies: runs of single configurations, and of all trials."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from small_study import tables

from mast_zenoh.errors import ConfigurationError, RunFolderError
from mast_zenoh.run_folder.recording.reader import file_of
from mast_zenoh.study import definition, interface, trials
from mast_zenoh.study.store import Store

pytestmark = [pytest.mark.heavy, pytest.mark.usefixtures("unpainted")]


@pytest.fixture
def recorded(whole: trials.StudyResult, tmp_path: Path) -> Path:
    """A copy of the recorded study."""
    return Path(shutil.copytree(whole.out, tmp_path / "copy"))


def recordings(folder: Path) -> list[Path]:
    """The recording of each trial."""
    return [file_of(folder / trial["run"]) for trial in json.loads((folder / "study.json").read_text())["trials"]]


def test_recording_keeps_the_run_of_each_trial_and_changes_no_table(small, whole, tmp_path: Path) -> None:
    assert len(recordings(whole.out)) == 6
    assert all(path.stat().st_size > 1000 for path in recordings(whole.out))
    plain = trials.run(small, tmp_path / "plain", count=2).out
    assert tables(plain) == tables(whole.out)
    assert not (plain / "runs").exists()


def test_a_finished_study_can_be_recorded_later(small: definition.Study, recorded: Path) -> None:
    first, *others = recordings(recorded)
    before = [path.stat().st_mtime_ns for path in others]
    first.unlink()
    trials.run(small, recorded, record=True, resume=True, count=2)
    assert [first, *others] == recordings(recorded)
    assert [path.stat().st_mtime_ns for path in others] == before


def test_recorded_trials_are_refused_on_a_cluster(small: definition.Study, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="expected no --cluster"):
        trials.run(small, tmp_path / "out", count=1, record=True, cluster="tcp://127.0.0.1:1")


def test_runs_of_single_configurations_are_recorded_or_say_how_to(small: definition.Study, tmp_path: Path) -> None:
    kept = interface.run_once(small.chosen(runtime="inproc"), tmp_path / "kept", record=True)
    assert all(file_of(folder) for folder in kept.folders.values())
    plain = interface.run_once(small.chosen(runtime="inproc"), tmp_path / "plain")
    with pytest.raises(RunFolderError) as caught:
        file_of(plain.folders["attacked-1-5.0"])
    command = str(caught.value).rpartition("with a recording: ")[2]
    assert command.startswith("mast run uncoordinated --set scene=intersection:0 ")
    assert "--set n_adversaries=1" in command
    assert command.endswith("--seed 0 --frames 8 --runtime inproc")


def test_a_study_whose_folder_of_runs_is_a_link_is_not_continued(small, recorded: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    (recorded / "runs").rename(outside)
    (recorded / "runs").symlink_to(outside)
    before = sorted(outside.rglob("*"))
    with pytest.raises(RunFolderError, match="found a link"):
        Store.create(recorded, small, resume=True)
    assert sorted(outside.rglob("*")) == before
