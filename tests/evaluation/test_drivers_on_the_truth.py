"""A brake is needless if the same driver, given the truth, would not have braked so hard."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from driven import driven

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.driving import Command, Driver, RouteAhead, Situation
from mast_zenoh.evaluation.driver_on_truth import DriverOnTruth, TrueFrame
from mast_zenoh.launch import run as launcher

OWN = 3


class Timid(Driver):
    """Brakes for whatever there is, far from the road too, which no model of car following does."""

    def drive(self, situation: Situation) -> Command:
        offset = situation.objects.position[:, :2] - situation.position[:2]
        near = np.hypot(offset[:, 0], offset[:, 1])
        return Command(-2.0 if (near > 2.0).any() and situation.speed > 2.0 else 0.0, 0.0)


class Impatient(Driver):
    """Brakes harder in each frame; writes into what it gets, and fails in its fourth frame."""

    def __init__(self, *, step: float = 1.0) -> None:
        self.step, self.times = step, 0

    def drive(self, situation: Situation) -> Command:
        self.times += 1
        situation.route.position[:] = np.nan
        if self.times == 4:
            raise ValueError("enough")
        return Command(-self.step * self.times - len(situation.objects), 0.0)


class Refused(Driver):
    """Cannot be made where the run is measured."""

    def __init__(self) -> None:
        raise OSError("no such device")

    def drive(self, situation: Situation) -> Command:
        return Command(0.0, 0.0)


class Wordless(Driver):
    def drive(self, situation: Situation) -> Any:
        return None


def truth(frame: int, others: int = 0, own: int = OWN) -> TrueFrame:
    position = np.column_stack([10.0 * np.arange(others + 1), np.zeros(others + 1), np.zeros(others + 1)])
    return TrueFrame(frame * 100_000_000, ObjectStates.of(position, id=OWN + np.arange(others + 1)), own)


def road() -> RouteAhead:
    return RouteAhead(np.column_stack([np.arange(40.0), np.zeros(40)]), np.full(40, 10.0), np.inf)


def fed(twin: DriverOnTruth, *frames: int, **known: int) -> DriverOnTruth:
    for frame in frames:
        twin.add(frame, "route", road())
        twin.add(frame, "truth", truth(frame, **known))
    return twin


def test_it_is_asked_once_a_frame_with_all_that_is_there_but_itself() -> None:
    twin = fed(DriverOnTruth({"type": "Impatient", "step": 0.5}), 0, 1, 2, others=2)
    fed(twin, 1)  # a second message about a frame is not a second frame
    assert twin.braking == {0: 2.5, 1: 3.0, 2: 3.5}
    assert twin.problem == ""


def test_the_lane_that_it_is_given_is_its_own_to_change() -> None:
    lane = road()
    twin = DriverOnTruth({"type": "Impatient"})
    twin.add(0, "truth", truth(0))
    twin.add(0, "route", lane)
    assert twin.braking
    assert np.isfinite(lane.position).all()


def test_the_parts_of_a_frame_may_come_long_after_those_of_others() -> None:
    """As the evaluator may receive fifty messages of a key before those of another."""
    twin = DriverOnTruth({"type": "Timid"})
    for frame in range(100):
        twin.add(frame, "truth", truth(frame))
    for frame in range(100):
        twin.add(frame, "route", road())
    assert [*twin.braking] == [*range(100)]


def test_a_driver_that_fails_has_no_answer_about_that_frame_alone_and_the_reason_is_kept() -> None:
    twin = fed(DriverOnTruth({"type": "Impatient"}), *range(6))
    assert [*twin.braking] == [0, 1, 2, 4, 5]
    assert twin.problem == "ValueError: enough"
    assert np.isnan(twin.in_frames(np.array([2, 3]))).tolist() == [False, True]


@pytest.mark.parametrize(("name", "problem"), [("Refused", "OSError: no such"), ("Wordless", "expected a Command")])
def test_a_driver_that_cannot_be_made_or_says_nothing_has_no_answer(name: str, problem: str) -> None:
    twin = fed(DriverOnTruth({"type": name}), 0, 1)
    assert not twin.braking
    assert problem in twin.problem


def test_a_frame_without_the_car_has_no_answer() -> None:
    assert not fed(DriverOnTruth({"type": "Timid"}), 0, own=-1).braking


@pytest.mark.parametrize("of_another_file", [False, True])
def test_what_a_driver_brakes_for_on_the_truth_too_is_needful_whatever_a_model_of_driving_says(
    of_another_file: bool, tmp_path: Path
) -> None:
    """The model sees no reason: by its yardstick, where the driver is not known, the same brakes are needless."""
    resolved = driven("driver=Timid", "estimate=truth", frames=40)
    if of_another_file:
        del resolved.nodes["evaluator"].config["drivers"]
    ended = launcher.run(resolved, tmp_path / "run", runtime="inproc")
    assert ended.error is None
    happened = json.loads((ended.folder / "metrics.json").read_text())["driven"]["ego"]
    assert happened["brakes"]
    assert happened["needless_brakes"] == (len(happened["brakes"]) if of_another_file else 0)
    kinds = [notice["kind"] for notice in ended.record["notices"]]
    assert ("brakes" in kinds) is of_another_file
    assert {brake["on_truth_mps2"] for brake in happened["brakes"]} == ({None} if of_another_file else {2.0})


def test_a_brake_for_a_ghost_is_needless_as_its_driver_does_not_brake_on_the_truth(tmp_path: Path) -> None:
    resolved = driven("attack=GhostAhead", "attack_start_s=1.0", frames=40)
    ended = launcher.run(resolved, tmp_path / "run", runtime="inproc")
    brakes = json.loads((ended.folder / "metrics.json").read_text())["driven"]["ego"]["brakes"]
    judged = {(brake["needless"], brake["cause"]["adversary"], brake["on_truth_mps2"]) for brake in brakes}
    assert judged == {(True, "adversary_1", 0.0)}
