"""`mast.run` accepts the command line's scenarios and plain Python values."""

import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest

import mast_zenoh as mast
from mast_zenoh.errors import ConfigurationError, HandlerFailed, Interrupted, RunFolderError
from mast_zenoh.launch.display import Display
from mast_zenoh.run_folder.recording.difference import compare
from mast_zenoh.scenario import load

SMALL: dict[str, Any] = dict(n_infrastructure=1)


def test_the_results_go_to_a_new_folder_below_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    first, second = (mast.run("baseline", frames=2, **SMALL) for _ in range(2))
    assert first.path.parent == second.path.parent == tmp_path / "runs"
    assert first.path != second.path
    assert first.path.name.startswith("baseline-")


def test_a_name_a_file_a_function_and_a_dict_are_the_same_scenario(tmp_path: Path) -> None:
    path, content = load("uncoordinated", ["n_infrastructure=2", "n_adversaries=1"])

    def scenario(n_adversaries: int = 1) -> dict[str, Any]:
        return load("uncoordinated", ["n_infrastructure=2", f"n_adversaries={n_adversaries}"])[1]

    parameters = dict(n_infrastructure=2, n_adversaries=1)
    runs = [
        mast.run("uncoordinated", frames=5, out=tmp_path / "name", **parameters),
        mast.run(path, frames=5, out=tmp_path / "file", **parameters),
        mast.run(scenario, frames=5, out=tmp_path / "function", n_adversaries=1),
        mast.run(content, frames=5, out=tmp_path / "dict"),
    ]
    for run in runs[1:]:
        difference = compare(runs[0].path, run.path)
        assert difference.first is None


def test_a_dotted_keyword_sets_a_value_of_the_run_and_not_of_the_dict(tmp_path: Path) -> None:
    _, content = load("baseline", ["n_infrastructure=1"])
    before = json.dumps(content, sort_keys=True)
    clustering = dict(type="DBSCANClusterer", eps=3.0)
    run = mast.run(content, frames=2, out=tmp_path / "run", **{"command_center.pipeline.clustering": clustering})
    center = json.loads((run.path / "scenario.json").read_text())["nodes"]["command_center"]
    assert center["config"]["pipeline"]["clustering"] == clustering
    assert json.dumps(content, sort_keys=True) == before


@pytest.mark.parametrize(
    ("scenario", "options", "words"),
    [
        ("uncoordinated", dict(n_adversary=1), "mean 'n_adversaries'?"),
        ("uncoordinated", dict(frame=1), "mean 'frames'?"),
        ("uncoordinated", dict(n_adversaries="two"), "expected int"),
        ("uncordinated", {}, "mean 'uncoordinated.py'?"),
        (dict(scene="intersection"), dict(n_adversaries=1), "scenario: n_adversaries: no"),
        (dict(scen="intersection"), {}, "mean 'scene'?"),
        (3, {}, "file, a dict"),
        (lambda: 3, {}, "expected a dict"),
        ("baseline", dict(mode="realtime"), "realtime needs"),
        ("baseline", dict(secure="tls"), "runtime='mesh'"),
        ("baseline", dict(runtime="cloud"), "inproc or mesh"),
        ("baseline", dict(runtime="mesh", secure="tls", endpoint="tcp/127.0.0.1:1"), "own router"),
    ],
)
def test_invalid_arguments_are_refused_before_anything_starts(
    scenario: Any, options: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigurationError) as refused:
        mast.run(scenario, frames=2, out=tmp_path / "run", **options)
    assert words in str(refused.value)
    assert not (tmp_path / "run").exists()


def test_a_failed_run_raises_an_error_that_names_the_folder(failing_scenario: Path, tmp_path: Path) -> None:
    with pytest.raises(HandlerFailed) as failed:
        mast.run(failing_scenario, frames=2, out=tmp_path / "run")
    assert str(tmp_path / "run") in failed.value.__notes__[0]
    assert "allow_failures=True" in failed.value.__notes__[0]
    assert mast.open(tmp_path / "run").status == "handler_failures"
    with pytest.raises(RunFolderError, match=r"no run\.json there"):
        mast.open(tmp_path)
    allowed = mast.run(failing_scenario, frames=2, out=tmp_path / "allowed", allow_failures=True)
    assert allowed.status == "ok"


def test_an_interrupted_run_names_its_folder_and_no_option(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Display, "update", lambda self, frame, status: os.kill(os.getpid(), signal.SIGINT))
    with pytest.raises(Interrupted) as stopped:
        mast.run("baseline", frames=4, out=tmp_path / "run", **SMALL)
    (note,) = stopped.value.__notes__
    assert f"{tmp_path / 'run'}: read" in note
