"""Studies with failed handlers are reported as failed."""

from __future__ import annotations

import json
from pathlib import Path

import failing
import pytest

from mast_zenoh.errors import HandlerFailed
from mast_zenoh.study import definition, interface, trials

pytestmark = [pytest.mark.heavy, pytest.mark.usefixtures("unpainted")]

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


@pytest.mark.mesh
def test_failed_handler_of_a_trial_is_reported_with_location_and_command_on_a_mesh_too(study, tmp_path: Path) -> None:
    failed, on_mesh = (
        trials.run(study.chosen(runtime=runtime), tmp_path / runtime, count=1).facts.failed
        for runtime in ("inproc", "mesh")
    )
    assert [each.configuration for each in failed] == ["first"]
    assert failed[0].error.startswith("HandlerFailed: handlers failed, so the numbers may be wrong:")
    assert MESSAGE in failed[0].error
    assert f"{tmp_path / 'attack.py'}:" in failed[0].error
    assert "--allow-failures" not in failed[0].command
    assert [each.error for each in on_mesh] == [failed[0].error]


def test_trials_with_allowed_failures_are_repeated_once_failures_are_not_allowed(study, tmp_path: Path) -> None:
    for allowed in (True, False, True):
        outcome = trials.run(study, tmp_path / "out", count=1, resume=True, allow_failures=allowed)
        assert [failed.configuration for failed in outcome.facts.failed] == ([] if allowed else ["first"])
        noted = json.loads((outcome.out / "study.json").read_text())["trials"]
        (command,) = (each["command"] for each in noted if each["configuration"] == "first")
        assert ("--allow-failures" in command) == allowed


def test_comparison_finishes_all_runs_before_raising(study, tmp_path: Path) -> None:
    ended = interface.run_once(study.chosen(runtime="inproc"), tmp_path / "out")
    assert set(ended.folders) == {"first", "baseline"}
    assert all((folder / "metrics.json").is_file() for folder in ended.folders.values())
    with pytest.raises(HandlerFailed, match="in run first, handlers failed"):
        ended.raise_failures()
    interface.run_once(study.chosen(runtime="inproc"), tmp_path / "allowed", allow_failures=True).raise_failures()


@pytest.mark.parametrize(("words", "code", "result"), [((), 30, "report.html"), (("--trials", "1"), 24, "table.md")])
def test_command_line_writes_all_results_and_exits_with_the_failure_code(
    mast, study, tmp_path: Path, words: tuple[str, ...], code: int, result: str
) -> None:
    for allowed in ((), ("--allow-failures",)):
        out = tmp_path / f"out{len(allowed)}"
        jobs = ("--jobs", "1") if words else ()
        ended = mast("study", str(study.path), "--runtime", "inproc", "--out", str(out), *words, *jobs, *allowed)
        assert ended[0] == (0 if allowed else code)
        assert MESSAGE in ended[1] + ended[2], "at least a warning"
        assert "Traceback" not in ended[2]
        assert (out / result).is_file()
