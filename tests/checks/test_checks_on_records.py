"""Checks of finished runs: on recorded faults, and those in a scenario's files."""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from planted import (
    FAULTS,
    FRAMES,
    changed,
    checked,
    doubled,
    lost,
    recorded,
    rewritten,
    scenario,
    without_agent,
    without_row,
)

import mast_zenoh as mast
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch import checks
from mast_zenoh.launch.checks import RunCheck, apply, convergence
from mast_zenoh.messages import codec
from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.run_folder.recording.reader import Recorded, read
from mast_zenoh.scenario import resolve
from mast_zenoh.wiring.model import Wiring

Run = tuple[Path, Resolved]
NAMES = ["collation", "convergence", "sequences", "processes"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run with many faults, and its record."""
    return recorded(tmp_path_factory.mktemp("run") / "faulted", faults=FAULTS)


def test_all_checks_pass_on_a_run_with_faults_but_no_attack(run: Run) -> None:
    results = checked(*run)
    assert list(results) == NAMES
    assert all(check.ok for check in results.values()), results
    explained = results["sequences"].values["explained"]
    assert explained["dropped by a link"] == 5, "tracks of five frames"
    assert explained["duplicated by a link"] == (4 + 1 + 5) * 2, "tracks, a status, pictures"
    assert explained["corrupted by a link"] > 0
    excepted = results["collation"].values["excepted"]
    assert excepted["late"] > 0
    assert results["collation"].values["messages"] > 100
    assert results["convergence"].values["converged_after_s"] < 2.0
    assert results["convergence"].values["greatest_m"] > 0.0


def test_results_of_checks_are_in_the_run_folder(run: Run) -> None:
    folder, resolved = run
    (folder / checks.FILE).unlink()
    results = checks.run(folder, resolved)
    stored = json.loads((folder / checks.FILE).read_text())
    assert [check["name"] for check in stored["checks"]] == NAMES
    assert stored["checks"] == [json.loads(json.dumps(check._asdict())) for check in results]
    assert stored["heals_s"] == [1.0, 1.4, 1.5, 2.0]
    assert stored["converged_after_s"] == results[1].values["converged_after_s"]


def test_a_scenario_read_from_a_run_folder_gives_the_same_checks(run: Run) -> None:
    folder, resolved = run
    assert checks.run(folder, Resolved.read(folder)) == checks.run(folder, resolved)


def test_a_run_without_recording_is_not_checked(tmp_path: Path) -> None:
    results = checked(*recorded(tmp_path / "run", frames=5, record=False, faults=FAULTS[:1]))
    assert all(check.ok for check in results.values())
    assert [check.values["checked"] for check in results.values()] == [False] * 4
    assert "not recorded" in results["sequences"].detail


@pytest.mark.parametrize(
    ("completeness", "reason"),
    [
        (dict(recorded=dict(messages=9, malformed=0, lost=3)), "the recording lacks 3 messages"),
        (dict(status="interrupted"), "the run did not finish: interrupted"),
    ],
)
def test_an_incomplete_record_is_not_checked(run, tmp_path, completeness, reason):
    results = checked(edited(run, tmp_path, **completeness), run[1])
    assert {name: results[name].detail for name in NAMES[:3]} == dict.fromkeys(NAMES[:3], f"not checked: {reason}")


def problems(run: Run, out: Path, change: Any) -> dict[str, str]:
    """The details of failed checks of a changed record."""
    folder, resolved = run
    results = checked(rewritten(folder, resolved, out / "copy", change), resolved)
    return {name: check.detail for name, check in results.items() if not check.ok}


def collated(change: Callable[[dict[str, Any]], dict[str, Any]]) -> Any:
    """Changes the collation of frame 30."""
    return changed("cc/collated", lambda frame, body: change(body) if frame == 30 else None)


def astray(frame: int, body: dict[str, Any]) -> dict[str, Any] | None:
    return body | {"position": body["position"] + 3.0} if frame >= 25 else None


def without_reports(message: Recorded) -> list[None]:
    return [] if message.message == "link_report" else [None]


#: Changes of the record, the checks that fail, and what one of them says.
PLANTED: dict[str, tuple[Any, set[str], str]] = {
    "nothing": (lost(), set(), ""),
    "no agent": (collated(lambda body: without_agent(body, "infra_2")), {"collation"}, "frame 30: infra_2 delivered"),
    "no track": (collated(without_row), {"collation"}, ""),
    "old tracks": (collated(lambda body: body | {"age_ns": body["age_ns"] + 100_000_000}), {"collation"}, ""),
    "no batch": (lost(("cc/collated", 30)), {"collation", "sequences"}, "no batch"),
    **{
        f"gap in {key}": (lost((key, 30)), {"sequences"}, f"{key}: 1 missing before sequence")
        for key in (
            *("agent/ego/pose", "agent/infra_2/detections", "agent/ego/mission", "clock", "scene/truth"),
            *("agent/infra_1/tracks", "agent/infra_2/tracks"),
        )
    },
    **{
        f"loss in a link on {key}": (lost((key, 30)), {"sequences"}, r"did not forward sequence \d+ of frame 30")
        for key in ("agent/infra_1/tracks/@tap/broker/0", "cc/picture/@tap/ego/0")
    },
    **{
        f"duplicate on {key}": (doubled((key, 30)), {"sequences"}, "")
        for key in ("agent/infra_1/tracks/@tap/broker/0", "agent/ego/pose", "cc/picture")
    },
    "nothing explains the partition": (
        without_reports,
        {"sequences"},
        "link_infra_1 did not forward sequence 5 of frame 5",
    ),
    "a wrong picture": (
        changed("cc/picture", astray),
        {"convergence"},
        r"the picture has not converged: the distance is .* 2.9 s after the last heal, expected less than 0.5 m",
    ),
    "no picture": (
        lambda message: [] if message.key == "cc/picture" and message.frame >= 40 else [None],
        {"convergence", "sequences"},
        "the distance is 5.00 m",
    ),
}


@pytest.mark.parametrize("planted", PLANTED)
def test_a_planted_error_is_detected_by_its_check(run: Run, tmp_path: Path, planted: str) -> None:
    change, failed, text = PLANTED[planted]
    details = problems(run, tmp_path, change)
    assert details.keys() == failed
    assert re.search(text, " ".join(details.values()))


def test_the_collation_check_does_not_rely_on_link_reports(run: Run, tmp_path: Path) -> None:
    folder, resolved = run
    silent = rewritten(folder, resolved, tmp_path / "copy", without_reports)
    assert checked(silent, resolved)["collation"] == checked(folder, resolved)["collation"]


def edited(run: Run, out: Path, **changes: Any) -> Path:
    """A copy of a run folder with changes of its run.json."""
    copy = shutil.copytree(run[0], out / "edited")
    record = json.loads((copy / "run.json").read_text())
    (copy / "run.json").write_text(json.dumps(record | changes))
    return Path(copy)


def test_a_sequence_that_restarts_without_a_restart_of_the_node_is_detected(run: Run, tmp_path: Path) -> None:
    nodes = json.loads((run[0] / "run.json").read_text())["nodes"]
    nodes["infra_2"]["restarts"] = 0
    results = checked(edited(run, tmp_path, nodes=nodes), replace(run[1], steps=()))
    assert "agent/infra_2/tracks: sequence 0" in results["sequences"].detail


def test_a_process_left_running_is_detected(run: Run, tmp_path: Path) -> None:
    copy, resolved = edited(run, tmp_path, runtime="mesh"), run[1]
    assert checked(copy, resolved)["processes"].ok
    run_id = json.loads((copy / "run.json").read_text())["id"]
    words = ["--run-folder", str(copy), "--name", "infra_1", "--run", run_id]
    command = [sys.executable, "-c", "print(flush=True); input()", *words]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as left:
        assert left.stdout is not None
        left.stdout.readline()
        results = checked(copy, resolved)["processes"]
        assert not results.ok
        assert results.detail == f"still running: infra_1 ({left.pid})"
        left.communicate(b"\n")
    assert checked(copy, resolved)["processes"].ok


@pytest.mark.parametrize(("late", "ok"), [({"infra_2": 1}, True), ({"ego": 1}, False), ({}, False)])
def test_in_real_time_messages_that_the_broker_counted_as_late_may_be_missing(run, tmp_path, late, ok):
    folder, resolved = run
    change = changed("cc/collated", lambda frame, body: without_agent(body, "infra_2") if frame == 32 else None)
    copy = rewritten(folder, resolved, tmp_path / "copy", change)
    metrics = json.loads((copy / "metrics.json").read_text())
    (copy / "metrics.json").write_text(json.dumps(metrics | {"late": late}))
    assert checked(copy, replace(resolved, mode="realtime"))["collation"].ok is ok


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        (dict(faults=[dict(type="Kill", at=1.0, node="infra_1")]), "Kill infra_1 lasts"),
        (dict(faults=FAULTS[:1], links={"ego": "wired"}), "link_ego has rules"),
        (dict(links={"ego": "perfect"}), "fault was healed"),
    ],
)
def test_convergence_is_not_required_where_it_is_undefined(tmp_path: Path, keys: dict[str, Any], reason: str) -> None:
    results = checked(*recorded(tmp_path / "run", frames=20, **keys))
    assert all(check.ok for check in results.values())
    assert reason in results["convergence"].detail
    assert results["convergence"].values["checked"] is False


def test_a_run_that_ends_soon_after_the_heal_is_too_short_to_judge(run: Run, tmp_path: Path) -> None:
    faults = [dict(type="Kill", at=0.5, node="command_center", restart_after=0.6)]
    results = checked(*recorded(tmp_path / "run", frames=12, faults=faults))["convergence"]
    assert results.ok
    assert results.detail.startswith("no time to")


def test_the_reference_is_the_picture_of_the_run_without_links_and_faults(run: Run, tmp_path: Path) -> None:
    folder, _ = recorded(tmp_path / "plain", frames=FRAMES)
    plain = {m.frame: m.payload for m in read(folder) if m.key == "cc/picture"}
    pictures = convergence.pictures(run[1], run[0])
    assert pictures.keys() == plain.keys()
    for frame, payload in plain.items():
        assert np.array_equal(pictures[frame], codec.decode(payload, "picture").body["position"])


def test_the_reference_has_no_links_neither_those_of_user_maps() -> None:
    resolved = resolve(*scenario(faults=FAULTS), frames=20, record=True)
    assert {spec.role for spec in resolved.nodes.values()} >= {"link", "recorder", "evaluator"}
    reference_scenario = convergence.without_faults(resolved)
    assert not {spec.role for spec in reference_scenario.nodes.values()} & {"link", "recorder", "evaluator"}
    assert (reference_scenario.steps, reference_scenario.timeline) == ((), ())
    rewrite = dict(insert=[dict(wire="cc/picture", role="link", input="picture", output="picture_out")])
    bad = dict(role="link", rules_down=[dict(type="Loss", probability=0.5)])
    own = convergence.without_faults(
        resolve(*scenario(nodes=dict(bad=bad), keyexpr=dict(rewrites=[rewrite])), frames=3, record=True)
    )
    assert "bad" not in own.nodes
    assert not Wiring.from_json(own.wiring).find(estimate=PICTURE).interposers


@pytest.mark.parametrize(
    ("distance", "after_s"),
    [
        ([0.0, 0.0, 0.0, 0.0], 0.0),
        ([0.0, 2.0, 0.1, 0.1], 0.5),
        ([2.0, 0.0, 2.0, 0.1], 1.5),
        ([2.0, 0.0, 0.0, 2.0], None),
        ([2.0, 0.1, 0.1, 0.1], 0.0),
    ],
)
def test_convergence_is_reached_when_the_distance_stays_below_the_threshold(distance, after_s):
    times_s = np.array([0.0, 1.0, 2.0, 3.0])
    assert convergence.converged_after(np.array(distance), times_s, 1.5) == after_s


def test_the_distance_counts_missing_and_displaced_objects() -> None:
    grid = np.array([[10.0 * i, 0.0, 0.0] for i in range(10)])
    pictures = {0: grid, 1: grid[1:], 2: grid + np.array([1.0, 0.0, 0.0]), 3: np.zeros((0, 3))}
    expected = dict.fromkeys(range(5), grid)
    distances = convergence.distance_between(expected, pictures, np.arange(5))
    assert distances == pytest.approx([0.0, 0.5, 1.0, 5.0, 5.0])


SCENARIO = """
from mast_zenoh.launch.checks import RunCheck
from mast_zenoh.scenario import load


class Recorded(RunCheck):
    def check(self, folder):
        return (folder / "messages.mcap").is_file(), "looked for messages.mcap"


class Broken(RunCheck):
    def check(self, folder):
        raise KeyError("nosuch")


class Unfinished(RunCheck):
    pass


def scenario():
    return load("baseline", ["n_infrastructure=1"])[1]
"""


def test_checks_of_a_scenario_are_applied_and_a_failing_check_is_named(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(SCENARIO)
    run = mast.run(str(tmp_path / "mine.py"), frames=3, out=str(tmp_path / "run"))
    assert run.status == "ok"
    checks_by_name = {check["name"]: check for check in json.loads((run.path / "checks.json").read_text())["checks"]}
    assert checks_by_name["Recorded"]["ok"]
    assert not checks_by_name["Broken"]["ok"]
    assert "itself failed: KeyError" in checks_by_name["Broken"]["detail"]
    assert "mine.py:13" in checks_by_name["Broken"]["detail"]
    assert "Unfinished" not in checks_by_name


def test_a_run_without_faults_or_user_checks_is_not_checked(tmp_path: Path) -> None:
    run = mast.run("baseline", n_infrastructure=1, frames=3, out=str(tmp_path / "run"))
    assert not (run.path / "checks.json").exists()


def test_a_check_fails_unless_it_returns_a_bool_and_a_sentence(tmp_path: Path) -> None:
    class Odd(RunCheck):
        def check(self, folder: Path) -> tuple[bool, str]:
            return invalid.pop()  # type: ignore[no-any-return]

    class Leaver(RunCheck):
        def check(self, folder: Path) -> tuple[bool, str]:
            raise SystemExit(0)

    invalid: list[Any] = ["ok", (np.array([True, False]), "x"), (float("nan"), "x"), (1, "x"), (True, 5), None]
    while invalid:
        outcome = apply(Odd, tmp_path)
        assert not outcome.ok
        assert outcome.detail.startswith("the check itself")
    assert not apply(Leaver, tmp_path).ok
