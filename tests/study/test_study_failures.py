"""Studies with failed handlers are reported as failed."""

from __future__ import annotations

import json
from pathlib import Path

import failing
import pytest

from mast_zenoh.cli import app
from mast_zenoh.errors import HandlerFailed
from mast_zenoh.study import definition, interface, trials

pytestmark = pytest.mark.heavy

STUDY = """
def study():
    small = dict(n_infrastructure=1)
    return dict(
        name="fragile",
        runs=dict(first=dict(scenario="attack.py"), baseline=dict(scenario="baseline", parameters=small)),
        frames=8,
        seed=3,
    )
"""
MESSAGE = "eve.on_detections failed 3 times in 3 frames (5 to 7): ValueError: no [plan] for frame 5 ("


@pytest.fixture
def study(tmp_path: Path) -> definition.Study:
    failing.write("attack", tmp_path)
    (tmp_path / "study.py").write_text(STUDY)
    return definition.load(str(tmp_path / "study.py"))


def test_failed_handler_of_a_trial_is_reported_with_location_and_command(study, tmp_path: Path) -> None:
    outcome = trials.run(study, tmp_path / "out", count=1)
    (failed,) = outcome.facts.failed
    assert failed.configuration == "first"
    assert failed.error.startswith("HandlerFailed: handlers failed, so the numbers may be wrong:")
    assert MESSAGE in failed.error
    assert f"{tmp_path / 'attack.py'}:" in failed.error
    assert "--allow-failures" not in failed.command


@pytest.mark.mesh
def test_failed_handler_of_a_mesh_trial_is_reported(study, tmp_path: Path) -> None:
    reasons = [
        trials.run(study, tmp_path / runtime, count=1, runtime=runtime).facts.failed[0].error
        for runtime in ("inproc", "mesh")
    ]
    assert reasons[0] == reasons[1]


def test_trials_with_allowed_failures_are_repeated_once_failures_are_not_allowed(study, tmp_path: Path) -> None:
    outcome = trials.run(study, tmp_path / "out", count=1, allow_failures=True)
    assert outcome.facts.failed == ()
    again = trials.run(study, tmp_path / "out", count=1, resume=True)
    assert [failed.configuration for failed in again.facts.failed] == ["first"]
    allowed = trials.run(study, tmp_path / "out", count=1, resume=True, allow_failures=True)
    assert allowed.facts.failed == ()
    commands = {each["configuration"]: each["command"] for each in noted(allowed)}
    assert "--allow-failures" in commands["first"]


def noted(ended: trials.StudyResult) -> list[dict]:
    return json.loads((ended.out / "study.json").read_text())["trials"]


def test_comparison_finishes_all_runs_before_raising(study, tmp_path: Path) -> None:
    ended = interface.run_once(study, tmp_path / "out", runtime="inproc")
    assert set(ended.folders) == {"first", "baseline"}
    assert all((folder / "metrics.json").is_file() for folder in ended.folders.values())
    with pytest.raises(HandlerFailed, match="in run first, handlers failed"):
        ended.raise_failures()
    interface.run_once(study, tmp_path / "allowed", runtime="inproc", allow_failures=True).raise_failures()


@pytest.mark.parametrize("words", [(), ("--trials", "1", "--jobs", "1")], ids=["single runs", "trials"])
@pytest.mark.parametrize("allowed", [False, True])
def test_command_line_writes_all_results_and_exits_with_the_failure_code(
    study, tmp_path: Path, monkeypatch, capsys, words: tuple[str, ...], allowed: bool
) -> None:
    more = (*words, *(["--allow-failures"] if allowed else []))
    command = ["mast", "study", str(study.path), "--runtime", "inproc", "--out", str(tmp_path / "out"), *more]
    monkeypatch.setattr("sys.argv", command)
    with pytest.raises(SystemExit) as raised:
        app.main()
    captured = capsys.readouterr()
    assert int(raised.value.code or 0) == (0 if allowed else 24 if words else 30)
    assert MESSAGE in captured.err + captured.out, "at least a warning"
    assert "Traceback" not in captured.err
    written = tmp_path / "out" / ("table.md" if words else "report.html")
    assert written.is_file()


def test_rogue_study_rejects_allow_failures(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("sys.argv", ["mast", "study", "rogue", "--allow-failures"])
    with pytest.raises(SystemExit) as raised:
        app.main()
    assert raised.value.code == 2
    assert "Traceback" not in capsys.readouterr().err
