"""`Plausibility`: what no road user does is withheld."""

from dataclasses import replace

import numpy as np
import pytest
from integrity_batches import Track, batch, view

from mast_zenoh.integrity import Assessment, Batch, Plausibility
from mast_zenoh.integrity.base import ClusterBoxes
from mast_zenoh.integrity.plausibility import overlapping

AGENTS = ("a", "b", "c")
#: Objects that make the scene ordinary.
OTHERS: list[Track] = [("a", 0, (60.0, 0.0)), ("b", 0, (60.0, 0.0)), ("a", 1, (60.0, 30.0)), ("b", 1, (60.0, 30.0))]


def drive(stage: Plausibility, path: list[tuple[float, float]], speed: list[float]) -> list[bool]:
    """Whether an object on this path in x and y, with these speeds along x, is withheld in each frame."""
    result = []
    for frame, (place, along) in enumerate(zip(path, speed, strict=True)):
        tracks = [*OTHERS, ("a", 2, place), ("b", 2, place)]
        result.append(withheld(stage, batch(tracks, AGENTS, frame=frame, velocity={2: (along, 0.0)}))[2])
    return result


def withheld(stage: Plausibility, each: Batch) -> list[bool]:
    found: list[bool] = stage.assess(each).objects.withheld.tolist()
    return found


def moved(speeds: list[float]) -> list[tuple[float, float]]:
    return [(x, -30.0) for x in np.cumsum([0.0, *speeds[:-1]]) * 0.1]


def test_ordinary_driving_is_accepted() -> None:
    steady = [10.0] * 50
    braking = [max(0.0, 15.0 - 0.45 * frame) for frame in range(50)]
    starting = [0.3 * frame for frame in range(50)]
    for speeds in (steady, braking, starting):
        assert not any(drive(Plausibility(), moved(speeds), speeds))


def test_speed_changes_beyond_the_limits_are_withheld_after_the_second_alarm() -> None:
    speeds = [min(40.0, 1.2 * frame) for frame in range(30)]
    found = drive(Plausibility(), moved(speeds), speeds)
    assert found.index(True) == 20, "one check a second"
    speeds = [max(0.0, 40.0 - 1.6 * frame) for frame in range(24)]
    assert any(drive(Plausibility(), moved(speeds), speeds))


def test_a_position_that_does_not_follow_from_the_speed_is_withheld() -> None:
    speeds = [0.0] * 30
    path = [(0.6 * frame, -30.0) for frame in range(30)]
    assert any(drive(Plausibility(), path, speeds))


@pytest.mark.parametrize(
    ("size", "velocity"),
    [((30.0, 2.5, 3.0), 0.0), ((4.5, 1.8, 9.0), 0.0), ((0.05, 0.5, 1.5), 0.0), ((4.5, 1.8, 1.5), 45.0)],
)
def test_impossible_sizes_and_speeds_are_withheld_at_once(size: tuple[float, float, float], velocity: float) -> None:
    tracks: list[Track] = [*OTHERS, ("a", 2, (0.0, 0.0))]
    found = withheld(Plausibility(), batch(tracks, AGENTS, size={2: size}, velocity={2: (velocity, 0.0)}))
    assert found == [False, False, True]


def test_an_impossible_track_of_a_real_object_is_left_out_alone() -> None:
    each = batch([*OTHERS, ("c", 0, (60.1, 0.0))], AGENTS)
    size = each.states.size.copy()
    size[-1] = (40.0, 2.0, 2.0)
    states = each.states.with_(size=size)
    assessment = Plausibility().assess(replace(each, states=states))
    assert assessment.weights is not None
    assert assessment.weights.tolist() == [1.0, 1.0, 1.0, 1.0, 0.0]
    assert not assessment.objects.withheld.any()


def test_a_box_in_the_air_is_withheld() -> None:
    each = batch([*OTHERS, ("a", 2, (60.0, 10.0))], AGENTS)
    position = each.states.position.copy()
    position[-1, 2] += 8.0
    states = each.states.with_(position=position)
    assert withheld(Plausibility(), replace(each, states=states))[2]


def test_of_two_boxes_in_one_place_the_one_with_fewer_witnesses_is_odd_then_the_younger() -> None:
    position = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [40.0, 0.0, 0.0], [41.0, 0.0, 0.0], [3.2, 2.0, 0.0]])
    boxes = ClusterBoxes(position, np.zeros((5, 3)), np.tile([4.5, 1.8, 1.5], (5, 1)), np.zeros(5))
    odd = overlapping(boxes, np.array([2, 1, 1, 1, 1]), np.array([1.0, 9.0, 1.0, 2.0, 0.0]))
    assert odd.tolist() == [False, True, True, False, False], "the last one only touches"


def appearing(viewers: dict[str, tuple[float, float]], *reporters: str, frames: int = 50) -> list[bool]:
    """Whether an object that `reporters` report from the twentieth frame on is withheld in the frames after."""
    stage = Plausibility()
    views = {name: view(place) for name, place in viewers.items()}
    result = []
    for frame in range(frames):
        tracks: list[Track] = [*OTHERS, *((name, 2, (0.0, 0.0)) for name in reporters if frame >= 20)]
        found: Assessment = stage.assess(batch(tracks, AGENTS, views, frame=frame))
        result.append(bool(found.objects.withheld[2:].any()))
    return result[20:]


def test_an_object_that_appears_in_full_view_of_others_is_withheld_for_a_while() -> None:
    found = appearing({"a": (-20.0, 0.0), "b": (20.0, 0.0)}, "a", frames=60)
    assert found == [True] * 31 + [False] * 9
    assert not any(appearing({"a": (-20.0, 0.0), "b": (20.0, 0.0)}, "a", "b")), "two agents report it"


def test_an_object_that_nobody_could_have_seen_before_is_accepted() -> None:
    assert not any(appearing({"a": (-20.0, 0.0)}, "a")), "nobody else is there"
    assert not any(appearing({"a": (-20.0, 0.0), "b": (60.0, 0.0)}, "a")), "too far to tell"


def test_nothing_appears_suddenly_at_the_start() -> None:
    views = {"a": view((-20.0, 0.0)), "b": view((20.0, 0.0))}
    assert not any(withheld(Plausibility(), batch([*OTHERS, ("a", 2, (0.0, 0.0))], AGENTS, views)))
