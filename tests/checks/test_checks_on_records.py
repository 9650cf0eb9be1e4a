"""Checks of finished runs: on recorded faults, and those in a scenario's files."""

from __future__ import annotations

import json
import subprocess
import sys
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
    in_real_time,
    lost,
    recorded,
    rewritten,
    scenario,
    without_agent,
    without_row,
)

import mast_zenoh as mast
from mast_zenoh import checks, scenes
from mast_zenoh.checks import RunCheck, convergence
from mast_zenoh.checks.runs import apply
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.messagelog.reader import read
from mast_zenoh.scenario import resolve

Run = tuple[Path, Resolved]
NAMES = ["collation", "convergence", "sequences", "processes"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run with many faults, and its record."""
    assert "TinyScene" in {cls.__name__ for cls in scenes.Scene.__subclasses__()}
    return recorded(tmp_path_factory.mktemp("run") / "faulted", faults=FAULTS)


# -- a sound run -----------------------------------------------------------------------------------------------------


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
    assert "a run that was not recorded" in results["sequences"].detail


@pytest.mark.parametrize(
    ("completeness", "reason"),
    [
        (dict(recorded=dict(messages=9, malformed=0, lost=3)), "the recording lacks 3 messages"),
        (dict(status="interrupted"), "the run did not finish: interrupted"),
    ],
)
def test_an_incomplete_record_is_not_checked(
    run: Run, tmp_path: Path, completeness: dict[str, Any], reason: str
) -> None:
    folder, resolved = run
    copy = rewritten(folder, resolved, tmp_path / "copy", lost())
    record = json.loads((copy / "run.json").read_text())
    (copy / "run.json").write_text(json.dumps(record | completeness))
    results = checked(copy, resolved)
    assert {name: results[name].detail for name in NAMES[:3]} == dict.fromkeys(NAMES[:3], f"not checked: {reason}")


# -- faults that must be found ---------------------------------------------------------------------------------------


def problems(run: Run, out: Path, change: Any) -> dict[str, str]:
    """The details of failed checks of a changed record."""
    folder, resolved = run
    return {
        name: check.detail
        for name, check in checked(rewritten(folder, resolved, out / "copy", change), resolved).items()
        if not check.ok
    }


def test_a_copy_of_a_record_passes_all_checks(run: Run, tmp_path: Path) -> None:
    assert problems(run, tmp_path, lost()) == {}


def test_an_agent_missing_from_a_collation_is_detected(run: Run, tmp_path: Path) -> None:
    def change(frame: int, body: dict[str, Any]) -> dict[str, Any] | None:
        return without_agent(body, "infra_2") if frame == 30 else None

    details = problems(run, tmp_path, changed("cc/collated", change))
    assert details.keys() == {"collation"}
    assert details["collation"].startswith("frame 30: infra_2 delivered")


def test_a_track_missing_from_a_collation_is_detected(run: Run, tmp_path: Path) -> None:
    details = problems(run, tmp_path, changed("cc/collated", lambda f, body: without_row(body) if f == 30 else None))
    assert details.keys() == {"collation"}


def test_old_tracks_of_an_agent_in_a_collation_are_detected(run: Run, tmp_path: Path) -> None:
    def change(frame: int, body: dict[str, Any]) -> dict[str, Any] | None:
        return body | {"age_ns": body["age_ns"] + 100_000_000} if frame == 30 else None

    assert problems(run, tmp_path, changed("cc/collated", change)).keys() == {"collation"}


def test_a_missing_batch_is_detected(run: Run, tmp_path: Path) -> None:
    details = problems(run, tmp_path, lost(("cc/collated", 30)))
    assert details.keys() == {"collation", "sequences"}
    assert "no batch" in details["collation"]


@pytest.mark.parametrize(
    "key",
    [
        *("agent/ego/pose", "agent/infra_2/detections", "agent/ego/mission", "clock", "scene/truth"),
        *("agent/infra_1/tracks", "agent/infra_2/tracks"),
    ],
)
def test_a_gap_in_a_publishers_messages_is_detected(run: Run, tmp_path: Path, key: str) -> None:
    details = problems(run, tmp_path, lost((key, 30)))
    assert f"{key}: 1 missing before sequence" in details["sequences"]


@pytest.mark.parametrize("key", ["agent/infra_1/tracks/@tap/broker/0", "cc/picture/@tap/ego/0"])
def test_a_message_lost_in_a_link_is_detected(run: Run, tmp_path: Path, key: str) -> None:
    details = problems(run, tmp_path, lost((key, 30)))
    assert details.keys() == {"sequences"}
    assert "did not forward sequence" in details["sequences"]
    assert "of frame 30" in details["sequences"]


@pytest.mark.parametrize("key", ["agent/infra_1/tracks/@tap/broker/0", "agent/ego/pose", "cc/picture"])
def test_a_duplicate_message_is_detected(run: Run, tmp_path: Path, key: str) -> None:
    assert "sequences" in problems(run, tmp_path, doubled((key, 30)))


def test_a_loss_without_a_link_report_is_detected(run: Run, tmp_path: Path) -> None:
    """Without link reports, nothing explains the partition."""
    details = problems(run, tmp_path, lambda message: [] if message.message == "link_report" else [None])
    assert "link_infra_1 did not forward sequence 5 of frame 5" in details["sequences"]


def test_the_collation_check_does_not_rely_on_link_reports(run: Run, tmp_path: Path) -> None:
    folder, resolved = run
    silent = rewritten(
        folder, resolved, tmp_path / "copy", lambda message: [] if message.message == "link_report" else [None]
    )
    assert checked(silent, resolved)["collation"] == checked(folder, resolved)["collation"]


def test_a_sequence_that_restarts_without_a_restart_of_the_node_is_detected(run: Run, tmp_path: Path) -> None:
    folder, resolved = run
    copy = rewritten(folder, resolved, tmp_path / "copy", lost())
    record = json.loads((copy / "run.json").read_text())
    record["nodes"]["infra_2"]["restarts"] = 0
    (copy / "run.json").write_text(json.dumps(record))
    from dataclasses import replace

    results = checked(copy, replace(resolved, steps=()))
    assert "agent/infra_2/tracks: sequence 0 of frame 15 is repeated" in results["sequences"].detail


def astray(frame: int, body: dict[str, Any]) -> dict[str, Any] | None:
    return body | {"position": body["position"] + 3.0} if frame >= 25 else None


def test_a_picture_that_stays_wrong_is_detected(run: Run, tmp_path: Path) -> None:
    details = problems(run, tmp_path, changed("cc/picture", astray))
    assert "the picture has not converged: the distance is" in details["convergence"]
    assert "2.9 s after the last heal, expected less than 0.5 m" in details["convergence"]


def test_a_missing_picture_is_detected(run: Run, tmp_path: Path) -> None:
    details = problems(run, tmp_path, lambda m: [] if m.key == "cc/picture" and m.frame >= 40 else [None])
    assert "the distance is 5.00 m" in details["convergence"]


def test_a_process_left_running_is_detected(run: Run, tmp_path: Path) -> None:
    folder, resolved = run
    copy = rewritten(folder, resolved, tmp_path / "copy", lost())
    record = json.loads((copy / "run.json").read_text()) | {"runtime": "mesh"}
    (copy / "run.json").write_text(json.dumps(record))
    assert checked(copy, resolved)["processes"].ok
    words = ["--run-folder", str(copy), "--name", "infra_1", "--run", record["id"]]
    command = [sys.executable, "-c", "print(flush=True); input()", *words]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as left:
        assert left.stdout is not None
        left.stdout.readline()
        results = checked(copy, resolved)["processes"]
        assert not results.ok
        assert results.detail == f"still running: infra_1 ({left.pid})"
        left.communicate(b"\n")
    assert checked(copy, resolved)["processes"].ok


# -- real time -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("late", "ok"), [({"infra_2": 1}, True), ({"ego": 1}, False), ({}, False)])
def test_in_real_time_messages_that_the_broker_counted_as_late_may_be_missing(
    run: Run, tmp_path: Path, late: dict[str, int], ok: bool
) -> None:
    def change(frame: int, body: dict[str, Any]) -> dict[str, Any] | None:
        return without_agent(body, "infra_2") if frame == 32 else None

    folder, resolved = run
    copy = rewritten(folder, resolved, tmp_path / "copy", changed("cc/collated", change))
    metrics = json.loads((copy / "metrics.json").read_text())
    (copy / "metrics.json").write_text(json.dumps(metrics | {"late": late}))
    assert checked(copy, in_real_time(resolved))["collation"].ok is ok


# -- cases that are not checked --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        (dict(faults=[dict(type="Kill", at=1.0, node="infra_1")]), "Kill infra_1 lasts to the end"),
        (dict(faults=FAULTS[:1], links={"ego": "wired"}), "link_ego has rules that last to the end"),
        (dict(links={"ego": "perfect"}), "no fault was healed"),
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
    assert results.detail.startswith(
        "no time to converge: the distance is 5.00 m at the end, 0.0 s after the last heal"
    )


# -- the reference ---------------------------------------------------------------------------------------------------


def test_the_reference_is_the_picture_of_the_run_without_links_and_faults(run: Run, tmp_path: Path) -> None:
    folder, _ = recorded(tmp_path / "plain", frames=FRAMES)
    plain = {m.frame: m.payload for m in read(folder) if m.key == "cc/picture"}
    pictures = convergence.pictures(run[1], run[0])
    assert pictures.keys() == plain.keys()
    from mast_zenoh.messages import codec

    for frame, payload in plain.items():
        assert np.array_equal(pictures[frame], codec.decode(payload, "picture").body["position"])


def test_the_reference_has_no_links_and_links_of_user_maps_have_no_rules() -> None:
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
    assert own.nodes["bad"].config["rules_down"] == []


# -- convergence -----------------------------------------------------------------------------------------------------


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
def test_convergence_is_reached_when_the_distance_stays_below_the_threshold(
    distance: list[float], after_s: float | None
) -> None:
    times_s = np.array([0.0, 1.0, 2.0, 3.0])
    assert convergence.converged_after(np.array(distance), times_s, 1.5) == after_s


def test_the_distance_counts_missing_and_displaced_objects() -> None:
    grid = np.array([[10.0 * i, 0.0, 0.0] for i in range(10)])
    pictures = {0: grid, 1: grid[1:], 2: grid + np.array([1.0, 0.0, 0.0]), 3: np.zeros((0, 3))}
    expected = dict.fromkeys(range(5), grid)
    distances = convergence.distance_between(expected, pictures, np.arange(5))
    assert distances == pytest.approx([0.0, 0.5, 1.0, 5.0, 5.0])


SCENARIO = """
from mast_zenoh.checks import RunCheck
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
    assert "the check itself failed: KeyError" in checks_by_name["Broken"]["detail"]
    assert "mine.py:13" in checks_by_name["Broken"]["detail"]
    assert "Unfinished" not in checks_by_name


def test_a_run_without_faults_or_user_checks_is_not_checked(tmp_path: Path) -> None:
    run = mast.run("baseline", n_infrastructure=1, frames=3, out=str(tmp_path / "run"))
    assert not (run.path / "checks.json").exists()


@pytest.mark.parametrize(
    "returned", ["ok", (np.array([True, False]), "x"), (float("nan"), "x"), (1, "x"), (True, 5), None]
)
def test_a_check_fails_unless_it_returns_a_bool_and_a_sentence(tmp_path: Path, returned: object) -> None:
    class Odd(RunCheck):
        def check(self, folder: Path) -> tuple[bool, str]:
            return returned  # type: ignore[return-value]

    outcome = apply(Odd, tmp_path)
    assert not outcome.ok
    assert outcome.detail.startswith("the check itself failed: ")


def test_a_check_that_exits_fails(tmp_path: Path) -> None:
    class Leaver(RunCheck):
        def check(self, folder: Path) -> tuple[bool, str]:
            raise SystemExit(0)

    assert not apply(Leaver, tmp_path).ok
