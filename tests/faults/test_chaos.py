"""Random faults: all checks hold, nothing remains, failures are replayable."""

import json
import shlex
from pathlib import Path
from typing import Any

import pytest
from fuzzing import Fuzzing
from typer.testing import CliRunner

from mast_zenoh import scenario
from mast_zenoh.cli import app
from mast_zenoh.launch import checks, run
from mast_zenoh.launch.checks import convergence
from mast_zenoh.run_folder.recording.difference import compare


def played(out: Path, seed: int) -> Path:
    """Run a random schedule; on a problem fail with the command to replay it."""
    path, loaded = scenario.load("chaos", [f"chaos_seed={seed}"])
    resolved = scenario.resolve(path, loaded, record=True)
    outcome = run.run(resolved, out, runtime="inproc")
    wrong = [f"{type(outcome.error).__name__}: {outcome.error}"] if outcome.error else []
    wrong += [f"{check['name']}: {check['detail']}" for check in check_results(outcome.folder) if not check["ok"]]
    broken = {name: node["failures"] for name, node in outcome.record["nodes"].items() if node.get("failures")}
    wrong += [f"handlers failed: {broken}"] if broken else []
    if wrong:
        command = shlex.join(["mast", "run", "chaos", "--set", f"chaos_seed={seed}", "--runtime", "inproc"])
        pytest.fail("\n".join([*wrong, *map(str, loaded["faults"]), f"replay: {command}"]))
    return outcome.folder


def check_results(folder: Path) -> list[dict[str, Any]]:
    """The results of a run's checks."""
    return list(json.loads((folder / checks.FILE).read_text())["checks"])


def check_schedules(seeds: range, tmp_path: Path) -> None:
    """Play random schedules in one process; all checks are asked for, and pass."""
    asked: set[str] = set()
    for seed in seeds:
        folder = played(tmp_path / str(seed), seed)
        asked |= {check["name"] for check in check_results(folder) if check["values"]["checked"]}
    assert asked == {"collation", "convergence", "sequences"}


def test_random_schedules_in_one_process_pass_all_checks(tmp_path: Path) -> None:
    check_schedules(range(4), tmp_path)


@pytest.mark.heavy
@pytest.mark.timeout(600)
def test_more_random_schedules_in_one_process_pass_all_checks(tmp_path: Path, fuzzing: Fuzzing) -> None:
    check_schedules(range(4, fuzzing.draws(40, 200)), tmp_path)


def test_a_failing_schedule_prints_a_command_that_replays_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(convergence, "THRESHOLD_M", 0.0)
    with pytest.raises(pytest.fail.Exception) as failed:
        played(tmp_path / "failed", 17)
    assert "convergence: the picture" in str(failed.value)
    *_, replay = str(failed.value).splitlines()
    assert replay == "replay: mast run chaos --set chaos_seed=17 --runtime inproc"
    _, *words = shlex.split(replay.removeprefix("replay: "))
    CliRunner().invoke(app.app, [*words, "--no-report", "--out", str(tmp_path / "replayed")])
    assert [check["ok"] for check in check_results(tmp_path / "replayed")] == [
        check["ok"] for check in check_results(tmp_path / "failed")
    ]
    assert compare(tmp_path / "failed", tmp_path / "replayed", taps=True).first is None
