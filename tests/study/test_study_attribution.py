"""In whole runs: who is blamed for a false track is who made it, by the test of what happens without him."""

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
    """The evaluator's results of 70 frames on the junction, with these of two adversaries, who begin after a second."""
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
    """(n,) whether there is a false track at this place in this frame of another run as well."""
    apart = np.hypot(tracks["x"][:, None] - other["x"], tracks["y"][:, None] - other["y"])
    same_frame = tracks["frame"][:, None] == other["frame"]
    return ((apart <= NEAR_M) & same_frame).any(axis=1)


def test_false_tracks_that_the_baseline_has_not_are_blamed_on_the_adversary_without_whom_they_are_not_there() -> None:
    new = right = 0
    for seed in (0, 1):
        attacked = false_tracks(run("uncoordinated", seed, ADVERSARIES))
        alone = [also_in(attacked, false_tracks(run("uncoordinated", seed, (each,)))) for each in ADVERSARIES]
        fresh = ~also_in(attacked, false_tracks(run("baseline", seed)))
        new += fresh.sum()
        for name, with_him, with_the_other in zip(ADVERSARIES, alone, alone[::-1], strict=True):
            right += (fresh & with_him & ~with_the_other & (attacked["by"] == name)).sum()
        right += (fresh & alone[0] & alone[1] & (attacked["by"] != "")).sum()
    assert new > 200
    assert right >= 0.95 * new


def test_without_an_attack_nobody_is_blamed() -> None:
    for seed in (0, 1):
        results = run("baseline", seed)
        assert set(results["tables"]["objects"]["by"]) == {""}
        assert results["metrics"]["achieved"] == {}
        causes = results["metrics"]["agents"]["ego"]["picture"]["causes"]
        assert not {"inserted", "removed", "moved"} & {cause for counts in causes.values() for cause in counts}


def test_everything_that_is_wrong_with_an_estimate_and_nothing_else_has_a_cause() -> None:
    for results in (run("baseline", 0), run("uncoordinated", 0, ADVERSARIES)):
        table = results["tables"]["objects"]
        wrong = np.isin(table["outcome"], ["false", "missed"])
        assert ((table["cause"] != "") == wrong).all()


def test_the_first_inserted_object_is_believed_within_a_second() -> None:
    achieved = run("uncoordinated", 0, ADVERSARIES)["metrics"]["achieved"]
    assert achieved.keys() == {*ADVERSARIES, "all"}
    assert all(0.0 <= each["first_success_s_centre"] <= 1.0 for each in achieved.values())
