"""Nodes that die, leave, join and return during a run in one process."""

from dataclasses import replace
from functools import cache

import pytest
from tiny_world import Run, tiny

from mast_zenoh.config.resolved import ProcessStep, Resolved
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.mesh.protocol.pacer import Timetable

FRAMES = 16


@cache
def world(name: str = "coordinated") -> Resolved:
    settings = () if name == "baseline" else ("n_adversaries=2", "attack_start_s=0.2")
    return tiny(name, *settings, frames=FRAMES)


def with_steps(*steps: tuple[int, str, str], name: str = "coordinated") -> Resolved:
    return replace(world(name), steps=tuple(ProcessStep(*step) for step in steps))


def frames_of(run: Run, key: str, schema: str) -> list[int]:
    return [message.header.frame for message in run.decoded(key, schema)]


def played(*steps: tuple[int, str, str], name: str = "coordinated", **options: object) -> Run:
    run = Run(with_steps(*steps, name=name), **options)
    assert not run.failures
    assert not run.rejected
    return run


def test_nodes_are_away_between_their_steps_and_begin_anew() -> None:
    steps = [(5, "start", "infra_2"), (4, "kill", "infra_1"), (9, "start", "infra_1"), (11, "kill", "broker")]
    steps += [(12, "kill", "evaluator"), (13, "start", "broker"), (14, "kill", "ego"), (14, "start", "ego")]
    run, plain = played(*steps, name="baseline"), played((5, "start", "infra_2"), name="baseline")
    messages = run.decoded("agent/infra_1/tracks", "tracks")
    assert [message.header.frame for message in messages] == [*range(4), *range(9, FRAMES)]
    assert [message.header.seq for message in messages] == [*range(4), *range(FRAMES - 9)]
    assert messages[4].body["id"].size == 0, "a fresh tracker has not confirmed any track yet"
    assert frames_of(run, "agent/infra_2/tracks", "tracks") == list(range(5, FRAMES))
    assert [m.header.seq for m in run.decoded("agent/ego/tracks", "tracks")] == [*range(14), 0, 1]
    assert frames_of(run, "cc/collated", "collated") == [*range(11), *range(13, FRAMES)]
    batches = {message.header.frame: message.body for message in run.decoded("cc/collated", "collated")}
    assert [batches[frame]["agents"].tolist() for frame in (3, 5, 13)] == [
        *(["ego", "infra_1"], ["ego", "infra_1", "infra_2"], ["ego", "infra_1", "infra_2"])
    ]
    assert batches[5]["age_ns"].tolist() == [0, 2 * 10**8, 0], "the last tracks of the dead node are kept"
    assert run.results["broker"]["collation"]["complete"] == FRAMES - 13, "it waits for all agents at once"
    for key in ("agent/infra_1/tracks", "cc/collated", "cc/picture", "agent/ego/mission"):
        assert run.messages[key][:4] == plain.messages[key][:4], "before a kill the run equals one without it"


def test_at_one_boundary_nodes_leave_before_others_start() -> None:
    run = played((5, "start", "infra_1"), (5, "kill", "infra_2"), name="baseline")
    assert run.decoded("cc/collated", "collated")[5].body["age_ns"].tolist() == [0, 0, 10**8]


def test_a_killed_node_returns_no_results_and_one_that_leaves_does() -> None:
    killed, left = (InProcess(with_steps((5, action, "broker"))) for action in ("kill", "leave"))
    assert "broker" not in killed.run()
    assert left.run()["broker"]["collation"]["complete"] == 5
    assert killed.steps == [ProcessStep(5, "kill", "broker")]
    assert killed.ended_hosts.keys() == {"broker"}


def test_steps_without_effect_are_skipped() -> None:
    process = InProcess(with_steps((3, "kill", "ego"), (5, "kill", "ego"), (6, "start", "ego"), (7, "start", "ego")))
    process.run()
    assert [step.frame for step in process.steps] == [3, 6]


@pytest.mark.parametrize(
    ("step", "problem"),
    [
        ((3, "kill", "infra_9"), r"kill infra_9.*'infra_2'"),
        ((3, "kil", "infra_1"), r"infra_1.*leave.*resume"),
        ((3, "kill", "simulator"), r"without.*drives.*scene"),
        ((3, "start", "simulator"), r"without.*drives.*scene"),
        ((3, "pause", "infra_1"), r"pause.*real time"),
    ],
)
def test_impossible_steps_are_refused_before_the_run(step: tuple[int, str, str], problem: str) -> None:
    with pytest.raises(ConfigurationError, match=problem):
        InProcess(with_steps(step))


def test_in_real_time_a_node_can_be_paused() -> None:
    timetable = Timetable(with_steps((3, "pause", "infra_1"), (5, "resume", "infra_1")), lockstep=False)
    assert [step.action for group in timetable.before(3) for step in group] == ["pause"]
    assert not list(timetable.before(4))


def test_the_picture_keeps_a_dead_agents_objects_for_a_while() -> None:
    """The ego is alone: no other agent sees its objects."""
    alone = replace(tiny(infrastructure=0, frames=40), steps=(ProcessStep(10, "kill", "ego"),))
    run = Run(alone)
    assert not run.failures
    ages = {m.header.frame: m.body["age_ns"].tolist() for m in run.decoded("cc/collated", "collated")}
    assert [ages[frame] for frame in (9, 10, 11, 19, 20)] == [[0], [10**8], [2 * 10**8], [10**9], []], "max_age_s is 1"
    objects = {m.header.frame: len(m.body["id"]) for m in run.decoded("cc/picture", "picture")}
    assert objects[9] == objects[10] == objects[11] == 3, "not at once"
    lost = [frame for frame, n in objects.items() if frame > 19 and n < 3]
    assert objects[39] == 0 < len(lost), "but eventually"
