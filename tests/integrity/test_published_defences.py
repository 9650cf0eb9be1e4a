"""What the stages after published defences have in common: forged tracks, seeds, results and parameters."""

from dataclasses import replace

import numpy as np
import plain_boxes as plain
import pytest
from tiny_world import tiny

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.integrity import Cad, FaultOrLie, Integrity, Made, NoIntegrity, Pasac, PoseGuard, Prbi, Robosac
from mast_zenoh.integrity.base import SUSPENDED, Batch, problem_of
from mast_zenoh.mesh.inproc import InProcess

WITH_EGO: list[type[Integrity]] = [Robosac, Pasac, Made, PoseGuard]
STAGES = [*WITH_EGO, Prbi, Cad]


def forged(seed: int, frame: int, scale: float) -> Batch:
    """A batch of five agents, in which the last one sends numbers that no object can have."""
    each = plain.random_batch(seed, 5, 8, frame=frame)
    rows, random = np.flatnonzero(each.agent == 4), np.random.default_rng([seed, frame])
    columns = {name: getattr(each.states, name).copy() for name in ("position", "velocity", "size", "yaw", "score")}
    for column in columns.values():
        column[rows] = random.normal(size=column[rows].shape) * scale
    return replace(each, states=each.states.with_(**columns))


@pytest.mark.parametrize("scale", [1.0, 1e3, 1e8])
@pytest.mark.parametrize("stage", STAGES)
def test_numbers_that_no_object_can_have_never_break_a_stage(stage: type[Integrity], scale: float) -> None:
    judge = stage(**({"ego": "agent_0"} if stage in WITH_EGO else {}))
    for frame in range(8):
        each = forged(3, frame, scale)
        assert problem_of(judge.assess(each), len(each.states), 5, each.clusters) == ""


@pytest.mark.parametrize("stage", STAGES)
def test_a_thousand_objects_of_one_agent_are_judged(stage: type[Integrity]) -> None:
    judge = stage(**({"ego": "a"} if stage in WITH_EGO else {}))
    places = np.random.default_rng(0).uniform(-30.0, 30.0, (1000, 3))
    labels = np.arange(1000)
    states = ObjectStates.of(places, size=np.tile([4.5, 1.8, 1.5], (1000, 1)))
    views = (plain.random_view(0, np.zeros(2)), None)
    for frame in range(2):
        each = Batch(frame * 10**8, states, (labels > 0).astype(np.int64), labels, ("a", "b"), views)
        assert problem_of(judge.assess(each), 1000, 2, 1000) == ""


@pytest.mark.parametrize("stage", WITH_EGO)
def test_the_ego_is_trusted_whatever_the_others_say(stage: type[Integrity]) -> None:
    judge = stage(ego="agent_2")
    for frame in range(20):
        each = forged(7, frame, 10.0)
        assert judge.assess(each).agents.state[2] != SUSPENDED


def test_a_run_draws_from_its_own_seed_and_reports_the_checks() -> None:
    def facts_and_states(seed: int) -> tuple[dict, list[list[int]]]:
        sent = []
        run = InProcess(
            tiny("defended", "defence=Robosac", "n_adversaries=0", seed=seed),
            tap=lambda message: sent.append(message.payload),
        )
        results = run.run()
        states = [message.body["state"].tolist() for message in sent if message.header.schema == "trust"]
        return results["command_center"]["integrity"], states

    facts, states = facts_and_states(1)
    assert (facts, states) == facts_and_states(1)
    assert facts["batches"] + facts["batches_without_reference"] == len(states)
    assert facts["checks"] >= facts["batches"] > 0


def test_a_stage_that_counts_nothing_adds_nothing_to_the_results() -> None:
    assert NoIntegrity().facts() == {}
    assert FaultOrLie().facts() == {}
    assert FaultOrLie(stage=Cad()).facts().keys() == Cad().facts().keys()


def test_fault_or_lie_passes_the_seed_on_to_the_stage_in_it() -> None:
    def admitted(seed: int) -> list[list[int]]:
        stage = FaultOrLie(stage=Robosac(ego="agent_0"))
        stage.bind(seed, "command_center")
        batches = [plain.random_batch(1, 5, 8, frame=frame) for frame in range(12)]
        return [stage.assess(each).agents.state.tolist() for each in batches]

    assert admitted(1) == admitted(1)
    assert admitted(1) != admitted(2)
