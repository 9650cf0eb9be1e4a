"""Trials are stored one by one: failed and repeated trials do not affect others."""

from __future__ import annotations

import contextlib
import csv
import json
import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pyarrow import parquet
from rich.console import Console
from small_study import TABLES, tables, write_small

from mast_zenoh.errors import ConfigurationError, DiskFull, Interrupted, RunFolderError, TrialsFailed
from mast_zenoh.launch import run as launcher
from mast_zenoh.metrics.estimates import ESTIMATORS, LOCAL, PICTURE, RECEIVED
from mast_zenoh.metrics.study_results import StudySeries
from mast_zenoh.study import definition, execution, trial, trials
from mast_zenoh.study.store import Store
from mast_zenoh.study.trial import Trial, TrialOutcome

pytestmark = [pytest.mark.heavy, pytest.mark.usefixtures("unpainted")]

OWN = """
from mast_zenoh.config import bundle, loading

def scenario():
    return loading.module(bundle.ROOT / "scenarios" / "baseline.py").scenario(n_infrastructure=1)
"""


@pytest.fixture
def trials_run(monkeypatch: pytest.MonkeyPatch) -> list[Trial]:
    """The trials that are run, and not reused, from here on."""
    executed: list[Trial] = []
    run = execution.run

    def record(each: Trial) -> TrialOutcome:
        executed.append(each)
        return run(each)

    monkeypatch.setattr(execution, "run", record)
    return executed


def test_an_attack_that_would_begin_after_the_last_frame_is_reported_and_has_no_success_rate(tmp_path: Path) -> None:
    late = definition.load(str(write_small(tmp_path)), ["start_s=0.8"])
    outcome = trials.run(late, tmp_path / "out", count=1)
    assert [(each.configuration, each.begins_s, each.ends_s) for each in outcome.facts.idle] == [
        ("attacked-1-5.0", 0.8, 0.8),
        ("attacked-1-20.0", 0.8, 0.8),
    ]
    text = (tmp_path / "out" / "table.md").read_text()
    never = "The attack of attacked n_adversaries=1 false_positives=5.0 never began"
    assert f"{never}: it begins at 0.8 s, and the trials end after 0.8 s." in text
    assert "What the attack achieved" not in text
    assert not any(series.estimator == "achieved" for row in outcome.rows for series in row.numbers)
    assert "never began" in outcome.report.read_text()


def test_every_configuration_is_run_with_every_seed_and_every_metric_has_a_row(whole: trials.StudyResult) -> None:
    table = parquet.read_table(whole.out / "results.parquet").to_pydict()
    cells = set(zip(table["configuration"], table["seed"], strict=True))
    assert cells == {(label, seed) for label in ("baseline", "attacked-1-5.0", "attacked-1-20.0") for seed in (0, 1)}
    rows = set(table["metric"])
    assert {"fn", "fp", "tp", "ospa_m", "gospa_m", "rmse_m", "id_switches", "completeness", "fp inserted"} <= rows
    assert {"fn_iob", "fp_ioe", "tp_iob", "cafn_iob", "cafp_iob", "rmse_m_iob", "id_switches_iob"} <= rows
    frames = parquet.read_table(whole.out / "frames.parquet")
    of_pole = (LOCAL, RECEIVED, PICTURE)
    assert whole.facts.idle == (), "its attacks begin before the end"
    assert len(frames) == 6 * 8 * len([*ESTIMATORS, *of_pole]), "trials, frames, estimators of the ego and a pole"


def test_every_parameter_of_the_grid_has_a_column_in_every_table(whole: trials.StudyResult) -> None:
    for name in ("results.parquet", "frames.parquet"):
        table = parquet.read_table(whole.out / name)
        assert table.column_names[:3] == ["configuration", "n_adversaries", "false_positives"]
        rows = set(zip(*(column.to_pylist() for column in table.columns[:3]), strict=True))
        assert rows == {("baseline", None, None), ("attacked-1-5.0", 1, 5.0), ("attacked-1-20.0", 1, 20.0)}
    lines = list(csv.DictReader((whole.out / "table.csv").open()))
    points = {(line["n_adversaries"], line["false_positives"]) for line in lines}
    assert points == {("", ""), ("1", "5.0"), ("1", "20.0")}


def test_interrupted_study_resumes_without_repeating_trials(
    small, whole, monkeypatch, tmp_path: Path, trials_run
) -> None:
    run = execution.run

    def interrupted(each: Trial) -> TrialOutcome:
        if len(trials_run) == 3:
            raise KeyboardInterrupt
        return run(each)

    with monkeypatch.context() as patch:
        patch.setattr(execution, "run", interrupted)
        with pytest.raises(Interrupted, match="--resume"):
            trials.run(small, tmp_path / "out", count=2)
    assert len(trials_run) == 3
    assert json.loads((tmp_path / "out" / "study.json").read_text())["status"] == "interrupted"
    trials_run.clear()
    trials.run(small, tmp_path / "out", count=2, resume=True)
    assert len(trials_run) == 3
    assert tables(tmp_path / "out") == tables(whole.out)
    assert (tmp_path / "out" / "report.html").read_bytes() == whole.report.read_bytes()


def test_a_signal_during_a_trial_with_a_run_folder_ends_the_study(small, tmp_path: Path, monkeypatch) -> None:
    """Such a run ends by itself with what it has, and raises nothing."""
    play = launcher.run

    def stopped(*arguments: Any, **options: Any) -> launcher.EndedRun:
        return replace(play(*arguments, **options), error=Interrupted("stopped by Ctrl-C"))

    monkeypatch.setattr(launcher, "run", stopped)
    with pytest.raises(Interrupted, match="--resume"):
        trials.run(small, tmp_path / "out", count=1, record=True, jobs=1)
    assert json.loads((tmp_path / "out" / "study.json").read_text())["status"] == "interrupted"
    assert not list((tmp_path / "out" / "trials").iterdir())


def test_more_seeds_can_be_added_later_and_a_trial_with_a_broken_file_is_run_again(
    small, whole, tmp_path: Path, trials_run
) -> None:
    trials.run(small, tmp_path / "out", count=1)
    files = sorted((tmp_path / "out" / "trials").iterdir())
    files[0].write_bytes(files[0].read_bytes()[:-20])
    files[1].unlink()
    (tmp_path / "out" / "trials" / ".half-written").write_bytes(b"PAR1")
    trials_run.clear()
    trials.run(small, tmp_path / "out", count=2, resume=True)
    assert sorted(each.seed for each in trials_run) == [0, 0, 1, 1, 1]
    assert tables(tmp_path / "out") == tables(whole.out)
    assert {path.name for path in (tmp_path / "out" / "trials").iterdir()} > {path.name for path in files}


@pytest.mark.parametrize("agents", [[], {"ego": 3}, {"ego": {"picture": {"fn": {"mean": "x", "std": 0.0}}}}])
def test_contents_of_a_trials_file_from_which_no_numbers_follow_are_named(small, tmp_path: Path, agents: Any) -> None:
    trials.run(small, tmp_path / "out", count=1)
    path = min((tmp_path / "out" / "trials").iterdir())
    table = parquet.read_table(path)
    metadata = json.loads(table.schema.metadata[b"mast-zenoh"])
    metadata["metrics"]["agents"] = agents
    parquet.write_table(table.replace_schema_metadata({b"mast-zenoh": json.dumps(metadata)}), path)
    with pytest.raises(RunFolderError, match=rf"{path.stem}\.parquet: its contents cannot be used: .*remove it"):
        trials.run(small, tmp_path / "out", count=1, resume=True)


def test_a_file_of_another_trial_is_not_taken_for_its_own_and_said(small, whole, tmp_path: Path, trials_run) -> None:
    trials.run(small, tmp_path / "out", count=2)
    first, second, *_ = sorted((tmp_path / "out" / "trials").iterdir())
    first.write_bytes(second.read_bytes())
    trials_run.clear()
    console = Console(record=True, width=200)
    trials.run(small, tmp_path / "out", count=2, resume=True, console=console)
    assert [each.digest for each in trials_run] == [first.stem]
    assert f"trials/{first.name}: of another trial than the name says: it is run again" in console.export_text()
    assert tables(tmp_path / "out") == tables(whole.out)


def test_a_study_that_fills_the_disk_ends_with_a_final_status(small, monkeypatch, tiny_disk: Path) -> None:
    """The first trial's results still fit; then the disk is full to the last byte."""
    save = Store.save

    def filling(store: Store, outcome: TrialOutcome) -> None:
        save(store, outcome)
        with (tiny_disk / "filler").open("wb", buffering=0) as file, contextlib.suppress(OSError):
            while True:
                file.write(bytes(512))

    monkeypatch.setattr(Store, "save", filling)
    with pytest.raises(DiskFull, match="No space left on device"):
        trials.run(small, tiny_disk / "out", count=2)
    assert json.loads((tiny_disk / "out" / "study.json").read_text())["status"] == "failed"
    assert not (tiny_disk / "out" / ".reserve").exists()


def test_failed_trial_is_reported_with_its_command_and_others_are_kept(small, monkeypatch, tmp_path: Path) -> None:
    run = execution.run

    def failing(each: Trial) -> TrialOutcome:
        if each.configuration == "attacked-1-5.0" and each.seed == 1:
            return TrialOutcome.failed(each, "RunError: on purpose")
        return run(each)

    with monkeypatch.context() as patch:
        patch.setattr(execution, "run", failing)
        outcome = trials.run(small, tmp_path / "out", count=2)
    with pytest.raises(TrialsFailed, match="failed trials: 1;") as caught:
        outcome.raise_failures()
    (failed,) = outcome.facts.failed
    assert (failed.configuration, failed.seed, failed.error) == ("attacked-1-5.0", 1, "RunError: on purpose")
    assert failed.command in str(caught.value)
    assert "--seed 1" in failed.command
    added = StudySeries("", "picture", "fp_iob")
    estimates = {row.configuration: (row.get(added).seeds, row.get(added).left_out) for row in outcome.rows}
    assert estimates == {"baseline": (0, 0), "attacked-1-5.0": (1, 1), "attacked-1-20.0": (2, 0)}
    for page in ((outcome.out / "table.md").read_text(), outcome.report.read_text()):
        results = page.index('">What the attack adds</h2>' if page.startswith("<!DOCTYPE") else "What the attack adds")
        assert page.index("1 of 6 trials failed") < results
        assert "RunError: on purpose" in page
        assert failed.command in page
    record = json.loads((tmp_path / "out" / "study.json").read_text())
    assert [each["error"] for each in record["trials"] if "error" in each] == ["RunError: on purpose"]
    trials.run(small, tmp_path / "out", count=2, resume=True).raise_failures()


def test_the_command_of_a_trial_reproduces_its_numbers(small, whole, tmp_path: Path) -> None:
    record = json.loads((whole.out / "study.json").read_text())["trials"][-1]
    arguments = shlex.split(record["command"])
    assert arguments[:2] == ["mast", "run"]
    command = [sys.executable, "-m", "mast_zenoh", *arguments[1:], "--no-report", "--out", str(tmp_path / "run")]
    subprocess.run(command, check=True, capture_output=True, cwd=tmp_path)
    alone = json.loads((tmp_path / "run" / "metrics.json").read_text())
    path = whole.out / "trials" / f"{record['digest']}.parquet"
    metadata = json.loads(parquet.read_schema(path).metadata[b"mast-zenoh"])
    assert metadata["metrics"] == alone


def test_worker_with_different_code_or_versions_runs_no_trial(small) -> None:
    planned = trials.plan(small.chosen(seed=0, frames=8, runtime="inproc"), count=1)
    outcome = execution.run(replace(planned[0], environment=(("numpy", "0.1"),)))
    assert "numpy: this worker has" in outcome.error
    assert "the study was started with 0.1" in outcome.error


def test_an_ineffective_attack_has_zero_increments_in_every_frame(small, tmp_path: Path) -> None:
    """Attack and baseline share scene and detections: differences are exactly 0."""
    waiting = definition.load(str(small.path), ["start_s=99.0"])
    outcome = trials.run(waiting, tmp_path / "out", count=2)
    table = parquet.read_table(outcome.out / "results.parquet").to_pydict()
    added = [
        (value, std)
        for metric, value, std in zip(table["metric"], table["value"], table["std"], strict=True)
        if metric.endswith("_iob") and value is not None  # such as a minimum of no values
    ]
    assert len(added) > 2 * 2 * 30
    over_frames = {pair for pair in added if pair[1] is not None}
    assert (over_frames, {value for value, _ in added}) == ({(0.0, 0.0)}, {0.0})


def test_digest_covers_configuration_seed_frames_and_user_files(small, tmp_path: Path) -> None:
    def digests(study: definition.Study, **more) -> set[str]:
        options = dict(seed=0, frames=8, runtime="inproc") | more
        return {each.digest for each in trials.plan(study.chosen(**options), count=2)}

    first = digests(small)
    assert len(first) == 6
    assert digests(small) == first
    assert not digests(small, seed=2) & first
    assert not digests(small, frames=9) & first
    assert not digests(small, runtime="mesh") & first
    assert len(digests(definition.load(str(small.path), ["start_s=0.3"])) & first) == 2, "of the baseline"

    (tmp_path / "mine.py").write_text("def study():\n    return dict(runs=dict(a=dict(scenario='own.py')))\n")
    variants = []
    for comment in ("one", "two"):
        (tmp_path / "own.py").write_text(f"# {comment}\n{OWN}")
        trial.files_key.cache_clear()
        variants.append(digests(definition.load(str(tmp_path / "mine.py"))))
    assert not variants[0] & variants[1]


def test_configurations_with_a_scene_other_than_the_baselines_are_reported(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "def study():\n    return dict(runs=dict(baseline=dict(scenario='baseline'), "
        "more=dict(scenario='baseline', grid=dict(n_infrastructure=[2, 4]))), trials=1, frames=2)\n"
    )
    outcome = trials.run(definition.load(str(tmp_path / "mine.py")), tmp_path / "out", count=1)
    assert outcome.facts.other_scenes == ("more-2",)
    assert "more n_infrastructure=2: a different scene from the baseline's" in (outcome.out / "table.md").read_text()
    assert "more n_infrastructure=2: a different scene from the baseline" in outcome.report.read_text()


def test_study_is_validated_before_the_first_trial(tmp_path: Path, trials_run) -> None:
    (tmp_path / "mine.py").write_text(
        "def study():\n    return dict(runs=dict(a=dict(scenario='baseline'), b=dict(scenario='uncoordinated', "
        "grid=dict(n_adversary=[1]))), trials=1, frames=2)\n"
    )
    with pytest.raises(ConfigurationError, match="n_adversary: no such launch-time parameter; did you mean 'n_adv"):
        trials.run(definition.load(str(tmp_path / "mine.py")), tmp_path / "out", count=1)
    assert trials_run == []
    assert not (tmp_path / "out").exists()


def test_used_folder_and_folder_of_another_study_are_rejected(small, whole, tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match="is not empty"):
        trials.run(small, whole.out, count=1)
    with pytest.raises(RunFolderError, match="--resume: expected --out too"):
        trials.run(small, None, count=1, resume=True)
    (tmp_path / "study.json").write_text('{"name": "other"}')
    with pytest.raises(RunFolderError, match="holds the study 'other', expected 'small'"):
        trials.run(small, tmp_path, count=1, resume=True)


@pytest.mark.parametrize(
    ("in_file", "in_stored", "message"),
    [
        ("start_s=0.2", "start_s=0.4", "holds another study, with the configuration 'attacked-1-5.0' .*start_s=0.4"),
        ("runs=dict(", "runs=dict(extra=dict(scenario='baseline'),", "'extra' .*: expected only those of this study"),
        ("intersection:0", "intersection:1", "the scene 'intersection:1': expected one of intersection:0"),
        ("frames=8", "frames=9", "trials of 9 frames: expected 8"),
    ],
)
def test_a_folder_with_trials_that_the_tables_would_lack_is_not_continued(
    small, tmp_path: Path, trials_run, in_file: str, in_stored: str, message: str
) -> None:
    (tmp_path / "small.py").write_text(Path(small.path).read_text().replace(in_file, in_stored))
    other = definition.load(str(tmp_path / "small.py"))
    folder = tmp_path / "out"
    planned = trials.plan(other.chosen(seed=0, frames=other.frames, runtime="inproc"), count=1)
    Store.create(folder, other, resume=False).write_status(other, planned, {}, "ok")
    before = (folder / "study.json").read_bytes()
    with pytest.raises(RunFolderError, match=message):
        trials.run(small, folder, count=1, resume=True)
    assert (folder / "study.json").read_bytes() == before
    assert trials_run == []


def test_the_command_line_prints_the_tables_and_names_the_files(mast, small, tmp_path: Path) -> None:
    words = ("study", str(small.path), "--trials", "1", "--jobs", "1", "--out", str(tmp_path / "out"))
    code, output, _ = mast(*words)
    assert code == 0
    for word in ("CAFP IoB", "attacked-1-20.0", "Causes of false objects", "OSPA", "(n < 5)", *TABLES):
        assert word in output
    assert f"report: {tmp_path / 'out' / 'report.html'}" in output


def test_study_with_failed_trials_has_its_own_exit_code(mast, small, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(execution, "_run_in_process", lambda *_: 1 / 0)
    code, output, err = mast("study", str(small.path), "--trials", "1", "--jobs", "1", "--out", str(tmp_path / "out"))
    assert code == TrialsFailed.exit_code == 24
    assert "mast run uncoordinated --set" in err
    assert "3 of 3 trials failed" in output


def test_without_dask_several_jobs_are_rejected_with_install_hint(small, tmp_path: Path, monkeypatch) -> None:
    for name in ("dask", "distributed"):
        monkeypatch.setitem(sys.modules, name, None)
    trials.run(small, tmp_path / "one", count=1, jobs=1)
    with pytest.raises(ConfigurationError, match=r"install mast-zenoh\[study\], or run with --jobs 1"):
        trials.run(small, tmp_path / "two", count=1, jobs=2)
    assert not (tmp_path / "two").exists()
