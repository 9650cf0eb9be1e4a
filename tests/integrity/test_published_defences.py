"""What the stages after published defences have in common: forged tracks, seeds, results and parameters."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import plain_boxes as plain
import pytest
from tiny_world import tiny

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.integrity import (
    Cad,
    FaultOrLie,
    Integrity,
    Made,
    NoIntegrity,
    Pasac,
    PoseGuard,
    Prbi,
    Robosac,
)
from mast_zenoh.integrity.base import SUSPENDED, Batch, problem_of
from mast_zenoh.runtime.inproc import InProcess

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


@pytest.mark.parametrize("defence", ["Robosac", "Prbi"])
def test_a_run_draws_from_its_own_seed_and_reports_the_checks(defence: str) -> None:
    def facts_and_states(seed: int) -> tuple[dict, list[list[int]]]:
        sent = []
        run = InProcess(
            tiny("defended", f"defence={defence}", "n_adversaries=0", seed=seed),
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


@pytest.mark.parametrize(
    ("stage", "arguments", "problem"),
    [
        (Robosac, {"ego": ""}, "ego: found '', expected the name of an agent"),
        (Robosac, {"attackers": -1}, "attackers: found -1, expected 0 or more"),
        (Robosac, {"budget": 0}, "budget: found 0, expected 1 or more"),
        (Robosac, {"sample_size": 0}, "sample_size: found 0, expected 1 or more"),
        (Robosac, {"budget": 2.5}, "budget: found 2.5, expected a whole number"),
        (Robosac, {"sample_size": True}, "sample_size: found True, expected a whole number"),
        (Robosac, {"attackers": float("inf")}, "attackers: found inf, expected 0 or more, finite"),
        (Robosac, {"budget": None}, "budget, sample_size: found None for both, expected a number for one at least"),
        (Robosac, {"confidence": 1.0}, "confidence: found 1.0, expected more than 0 and less than 1"),
        (Robosac, {"agree": 1.1}, "agree: found 1.1, expected 0 to 1"),
        (Robosac, {"match_iou": 0.0}, "match_iou: found 0.0, expected more than 0 and at most 1"),
        (Robosac, {"area_m": 0.0}, "area_m: found 0.0, expected more than 0"),
        (Pasac, {"agree": -0.1}, "agree: found -0.1, expected 0 to 1"),
        (Pasac, {"smoothing": 2.0}, "smoothing: found 2.0, expected 0 to 1"),
        (Pasac, {"deeper": -1.0}, "deeper: found -1.0, expected 0 to 1"),
        (Pasac, {"window": 0}, "window: found 0, expected 1 or more"),
        (Pasac, {"least_scores": 0}, "least_scores: found 0, expected 1 or more"),
        (Pasac, {"window": 2.5}, "window: found 2.5, expected a whole number"),
        (Pasac, {"least_scores": 2.5}, "least_scores: found 2.5, expected a whole number"),
        (Pasac, {"adaptive": "no"}, "adaptive: found no, expected True or False"),
        (Pasac, {"ego": None}, "ego: found None, expected the name of an agent"),
        (Made, {"alpha": 0.0}, "alpha: found 0.0, expected more than 0 and less than 1"),
        (Made, {"calibration": ()}, "calibration: found none"),
        (Made, {"calibration": (1.0, float("nan"))}, "calibration: found none, or one that is not finite"),
        (Made, {"calibration": (-1.0,)}, "or below 0"),
        (Made, {"calibration": "many"}, "calibration: found 'many', expected losses of honest agents"),
        (Made, {"area_m": 0.0}, "area_m: found 0.0, expected more than 0"),
        (Made, {"dependent": "no"}, "dependent: found no, expected True or False"),
        (Made, {"ego": 3}, "ego: found 3, expected the name of an agent"),
        (PoseGuard, {"ego": ""}, "ego: found '', expected the name of an agent"),
        (PoseGuard, {"region_m": 0.0}, "region_m: found 0.0, expected more than 0"),
        (PoseGuard, {"agree_m": -1.0}, "agree_m: found -1.0, expected more than 0"),
        (PoseGuard, {"record_s": 0.0}, "record_s: found 0.0, expected more than 0"),
        (Prbi, {"agree": 2.0}, "agree: found 2.0, expected 0 to 1"),
        (Prbi, {"short_term": -0.1}, "short_term: found -0.1, expected 0 to 1"),
        (Prbi, {"memory": 0}, "memory: found 0, expected 1 to 500, or None"),
        (Prbi, {"memory": 501}, "memory: found 501, expected 1 to 500, or None"),
        (Prbi, {"settled": 1}, "settled: found 1, expected 2 or more"),
        (Prbi, {"settled": 2.5}, "settled: found 2.5, expected a whole number"),
        (Prbi, {"memory": 2.5}, "memory: found 2.5, expected a whole number"),
        (Prbi, {"memory": True}, "memory: found True, expected a whole number"),
        (Prbi, {"level": 0.0}, "level: found 0.0, expected more than 0 and less than 1"),
        (Prbi, {"match_iou": 1.5}, "match_iou: found 1.5, expected more than 0 and at most 1"),
        (Cad, {"threshold_m2": 0.0}, "threshold_m2: found 0.0, expected more than 0"),
        (Cad, {"range_m": -1.0}, "range_m: found -1.0, expected more than 0"),
        (Cad, {"link_m": 0.0}, "link_m: found 0.0, expected more than 0"),
        (Cad, {"record_s": 0.0}, "record_s: found 0.0, expected more than 0"),
    ],
)
def test_invalid_parameters_are_refused(stage: type[Integrity], arguments: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValueError, match=re.escape(problem)):
        stage(**arguments)
