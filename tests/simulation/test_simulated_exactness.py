"""Scenarios give the same messages, results and failures on a simulated mesh as in one process."""

import os
from pathlib import Path
from typing import Any

import failing
import pytest
import random_scenarios
from driven import driven, over_a_rough_link
from fuzzing import Fuzzing
from simulated_runs import assert_equals_one_process, harmless_schedules, on_simulated_mesh, resolve, schedule
from tiny_world import tiny

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.mesh.inproc import InProcess

DATA = Path(os.environ.get("MAST_DATA") or Path(__file__).parents[3] / "shared" / "data")
SUPPORT = Path(__file__).parents[1] / "support"
#: Numbers of fault schedules.
SEEDS = [*range(4), *(pytest.param(seed, marks=pytest.mark.heavy) for seed in range(4, 8))]


def test_a_long_run_for_whose_listeners_the_driver_waits_gives_the_same_messages_as_in_one_process() -> None:
    assert_equals_one_process(resolve("baseline", "n_infrastructure=1", frames=52, seed=3))


def listening(scenario: dict[str, Any]) -> None:
    """An adversary that hears all poses, another one, and two defences on different legs."""
    guard = dict(role="defence", file=str(SUPPORT / "guard.py"))
    shadow = dict(file=str(SUPPORT / "shadow.py"), agent="infra_1", heard=["ego", "infra_1", "infra_2"])
    scenario["nodes"] = {"guard": guard, "source_guard": guard}
    scenario["adversaries"] = {
        "shadow": shadow,
        "eve": dict(agent="infra_2", attack=dict(type="UncoordinatedAttack", start_s=0.2)),
    }
    every = dict(wire="agent/*/tracks", role="defence", input="tracks")
    listen = [every | dict(node="guard"), every | dict(node="source_guard", leg="source")]
    listen.append(dict(wire="agent/*/pose", role="adversary", input="poses", node="shadow"))
    scenario["keyexpr"] = dict(rewrites=["on_detections.toml", {"listen": listen}])


def test_listeners_receive_the_same_messages_as_in_one_process() -> None:
    expected = assert_equals_one_process(tiny(edit=listening, record=True))
    before, after = (
        {message.payload for message in expected.messages if message.key == f"agent/infra_1/detections{leg}"}
        for leg in ("/@tap/0", "")
    )
    assert len(before) == len(after) == 12
    assert not before & after, "every pose was received, so every message was changed"


def test_a_real_log_gives_the_same_messages_as_in_one_process() -> None:
    logs = sorted((DATA / "av2_logs").glob("*/city_SE3_egovehicle.feather"))
    if not logs:
        pytest.skip(f"no reference data: no log in {DATA / 'av2_logs'} (set MAST_DATA)")
    settings = (f"scene=av2:{logs[0].parent}", "n_infrastructure=1", "n_adversaries=1")
    resolved = resolve("uncoordinated", *settings, frames=8)
    assert_equals_one_process(resolved)


def test_a_world_that_waits_for_commands_gives_the_same_messages_as_in_one_process() -> None:
    resolved = driven("attack=SeizedCommands", "attack_start_s=0.6", edit=over_a_rough_link, frames=12, record=True)
    assert_equals_one_process(resolved, *harmless_schedules(resolved, 2))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_random_schedule_of_faults_gives_the_same_messages_as_in_one_process(seed: int) -> None:
    resolved = resolve("chaos", f"chaos_seed={seed}", "n_infrastructure=1")
    assert_equals_one_process(resolved, *list(harmless_schedules(resolved, 5 if seed >= 4 else 2))[1:])


@pytest.mark.heavy
@pytest.mark.timeout(1800)  # with --fuzz
def test_random_scenarios_of_every_kind_give_the_same_messages_as_in_one_process(fuzzing: Fuzzing) -> None:
    for number in range(fuzzing.draws(len(random_scenarios.KINDS), 60)):
        name, settings, seed = random_scenarios.drawn(number)
        assert_equals_one_process(resolve(name, *settings, frames=random_scenarios.FRAMES, seed=seed))


def test_an_evaluator_that_gets_the_keys_of_many_frames_one_after_the_other_gives_the_same_results() -> None:
    resolved = resolve("chaos", "chaos_seed=8", "n_infrastructure=1")
    assert_equals_one_process(resolved, schedule(22, (0.055, "cut", "evaluator", 3.181)))


def failures_in_one_process(resolved: Resolved) -> dict[str, Any]:
    """The failures of handlers, by node."""
    run = InProcess(resolved)
    run.run()
    return run.failures()


@pytest.mark.parametrize(
    ("name", "node", "handler", "counts"),
    [("center", "command_center", "on_collated", (4, 4, 2, 11)), ("evaluator", "evaluator", "finish", (1, 1, 11, 11))],
)
def test_failures_of_handlers_equal_those_in_one_process(name, node, handler, counts, tmp_path) -> None:
    path = str(failing.write(name, tmp_path))
    expected = failures_in_one_process(resolve(path, frames=12, recorded=False))
    (entry,) = expected[node]
    assert entry["handler"] == handler
    assert tuple(entry[name] for name in ("count", "frames", "first_frame", "last_frame")) == counts
    resolved = resolve(path, frames=12)
    for each in harmless_schedules(resolved, 3):
        _, outcome = on_simulated_mesh(resolved, each)
        assert (outcome.error, outcome.frames, outcome.lost) == ("", 12, {}), "a run continues despite failures"
        assert outcome.failures == expected, each
        matching = [note for note in outcome.notes if f"{node}.{handler} failed once" in note]
        assert len(matching) == 1, "the first failure of a handler is shown"


def test_failures_in_a_handler_that_completes_a_frame_are_all_counted(tmp_path: Path) -> None:
    """An attack begins when the last of a frame's messages arrives: detections or a pose, as the mesh delivers them."""
    resolved = resolve(str(failing.write("attack", tmp_path)), frames=12)
    for each in harmless_schedules(resolved, 4):
        _, outcome = on_simulated_mesh(resolved, each)
        assert (outcome.error, outcome.frames, outcome.lost) == ("", 12, {}), each
        entries = outcome.failures.pop("eve")
        assert outcome.failures == {}, each
        assert {entry["handler"] for entry in entries} <= {"on_detections", "on_pose"}, each
        assert all(entry["exception"].startswith("ValueError: no [plan]") for entry in entries), each
        assert sum(entry["count"] for entry in entries) == sum(entry["frames"] for entry in entries) == 7, each
        assert min(entry["first_frame"] for entry in entries) == 5, each
        assert max(entry["last_frame"] for entry in entries) == 11, each
        matching = [
            note for note in outcome.notes if " failed once in frame " in note and "no \\[plan] for frame" in note
        ]
        assert len(matching) == len(entries), "the first failure of each handler is shown"
