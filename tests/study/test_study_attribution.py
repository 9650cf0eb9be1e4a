"""Attribution in whole runs, checked against runs without each adversary."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from mast_zenoh import scenario
from mast_zenoh.runtime.inproc import InProcess

ADVERSARIES = ("adversary_1", "adversary_2")
NEAR_M = 3.0


@cache
def run(name: str, seed: int, adversaries: tuple[str, ...] = ()) -> dict[str, Any]:
    """Metrics of 70 frames on the junction with adversaries that start after 1 s."""
    settings = ["n_adversaries=2", "attack_start_s=1.0"] if adversaries else []
    path, content = scenario.load(name, settings)
    if adversaries:
        content["adversaries"] = {each: content["adversaries"][each] for each in adversaries}
    return InProcess(scenario.resolve(path, content, frames=70, seed=seed)).run()["evaluator"]


def false_tracks(results: dict[str, Any]) -> dict[str, np.ndarray]:
    """The false tracks of the ego's picture."""
    table = results["tables"]["objects"]
    rows = (table["agent"] == "ego") & (table["estimator"] == "picture") & (table["outcome"] == "false")
    return {name: column[rows] for name, column in table.items()}


def also_in(tracks: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> np.ndarray:
    """(n,) bool: whether another run also has a false track at the position."""
    distance = np.hypot(tracks["x"][:, None] - other["x"], tracks["y"][:, None] - other["y"])
    same_frame = tracks["frame"][:, None] == other["frame"]
    return ((distance <= NEAR_M) & same_frame).any(axis=1)


def test_false_tracks_are_attributed_to_the_adversary_that_causes_them() -> None:
    new = correct = 0
    for seed in (0, 1):
        attacked = false_tracks(run("uncoordinated", seed, ADVERSARIES))
        alone = [also_in(attacked, false_tracks(run("uncoordinated", seed, (each,)))) for each in ADVERSARIES]
        added = ~also_in(attacked, false_tracks(run("baseline", seed)))
        new += added.sum()
        for name, with_adversary, with_other in zip(ADVERSARIES, alone, alone[::-1], strict=True):
            correct += (added & with_adversary & ~with_other & (attacked["by"] == name)).sum()
        correct += (added & alone[0] & alone[1] & (attacked["by"] != "")).sum()
    assert new > 200
    assert correct >= 0.95 * new


def test_without_an_attack_no_adversary_is_blamed() -> None:
    for seed in (0, 1):
        results = run("baseline", seed)
        assert set(results["tables"]["objects"]["by"]) == {""}
        assert results["metrics"]["achieved"] == {}
        causes = results["metrics"]["agents"]["ego"]["picture"]["causes"]
        assert not {"inserted", "removed", "moved"} & {cause for counts in causes.values() for cause in counts}


def test_exactly_the_errors_of_an_estimate_have_a_cause() -> None:
    for results in (run("baseline", 0), run("uncoordinated", 0, ADVERSARIES)):
        table = results["tables"]["objects"]
        wrong = np.isin(table["outcome"], ["false", "missed"])
        assert ((table["cause"] != "") == wrong).all()


def test_first_inserted_object_is_accepted_within_a_second() -> None:
    achieved = run("uncoordinated", 0, ADVERSARIES)["metrics"]["achieved"]
    assert achieved.keys() == {*ADVERSARIES, "all"}
    assert all(0.0 <= each["first_success_s_centre"] <= 1.0 for each in achieved.values())
