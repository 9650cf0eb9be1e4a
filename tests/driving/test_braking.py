"""The cause of a brake is found in what the driver believed, and its need in the truth."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mast_zenoh.driving.braking import Belief, Commands, brakes_of, missed_brakes, spans
from mast_zenoh.driving.consequences import consequences
from mast_zenoh.driving.corridor import crossing, in_corridor
from mast_zenoh.metrics.driving import Driving, RoadUsers
from tests.driving.test_what_happened_to_cars import car, driven, objects, straight

FRAMES = 30


def braking(at: int, braking: float = 6.0, until: int = FRAMES) -> tuple[list[float], list[float]]:
    """Places and speeds of a car that drives at 10 m/s and brakes from one frame to another."""
    speed = [10.0]
    for row in range(FRAMES - 1):
        speed.append(max(speed[-1] - 0.1 * braking * (at <= row < until), 0.0))
    return np.cumsum([0.0, *(0.1 * value for value in speed[1:])]).tolist(), speed


def ahead(x: float, frames: range = range(FRAMES)) -> RoadUsers:
    return objects([(row, x, 0.0, 0.0) for row in frames])


def brakes(
    believed: RoadUsers, real: int, adversary: str = "", there: RoadUsers | None = None, **known: object
) -> list:
    """The brakes of a car that brakes from frame 10 on, and whose driver believes in an object of track 5."""
    there = objects([]) if there is None else there
    x, speed = braking(10)
    n = len(believed.frame)
    belief = Belief(np.full(n, 5), np.full(n, real), np.full(n, adversary, object))
    facts = dict(believed=believed, belief=belief, **known)
    return consequences(driven(car(x, speed), there, [7] * len(there.frame), **facts))["brakes"]


def obeyed(of: int | None = None, informed: bool = True, tampered: str = "") -> Commands:
    """The commands of all frames: of the same frame, or `of`."""
    rows = np.arange(FRAMES) if of is None else np.full(FRAMES, of)
    return Commands(rows, np.full(FRAMES, informed), [tampered] * FRAMES)


def test_of_two_objects_the_one_that_asks_for_the_hardest_braking_is_the_cause() -> None:
    near, far = ahead(25.0), ahead(45.0)
    both = RoadUsers(*(np.concatenate(pair) for pair in zip(near, far, strict=True)))
    order = np.argsort(both.frame, kind="stable")
    both = RoadUsers(*(column[order] for column in both))
    is_near = both.position[:, 0] == 25.0
    belief = Belief(np.where(is_near, 1, 2), np.where(is_near, -1, 9), np.full(len(order), "", object))
    x, speed = braking(10)
    (brake,) = consequences(driven(car(x, speed), objects([]), [], believed=both, belief=belief))["brakes"]
    assert brake["cause"] == {"object": 1, "kind": "false", "adversary": None}


@pytest.mark.parametrize("real", [7, -1])
def test_a_slow_car_brakes_for_what_it_would_hit_within_a_second_and_a_half(real: int) -> None:
    """At 2 m/s, 14 m before something oncoming at 8 m/s, the intelligent driver model asks for 0.76 m/s^2."""
    speed = [2.0] * 11 + [1.4, 0.8, 0.2] + [0.0] * 16
    x = np.cumsum([0.0, *(0.1 * value for value in speed[1:])]).tolist()
    oncoming = crossers(2.0 + 2.25 + 14.0 + 2.0, 0.0, (-8.0, 0.0))
    n, there = len(oncoming.frame), oncoming if real == 7 else objects([])
    belief = Belief(np.full(n, 5), np.full(n, real), np.full(n, "", object))
    facts = dict(believed=oncoming, belief=belief)
    (brake,) = consequences(driven(car(x, speed), there, [7] * len(there.frame), **facts))["brakes"]
    kind, needless = ("real", False) if real == 7 else ("false", True)
    assert (brake["cause"]["kind"], brake["needless"]) == (kind, needless)


@pytest.mark.parametrize(
    ("route", "kind", "needless"),
    [
        (lambda x: straight(x, stop_m=max(30.0 - x, 0.0)), "line", False),
        (lambda x: straight(x, limit=4.0), "none", False),
        # From 10 to 8 m/s within 70 m needs 0.26 m/s^2.
        (lambda x: replace(straight(x), speed=np.where(np.arange(80) < 70, 50.0, 8.0)), "none", True),
    ],
    ids=["a line", "a bend", "a bend far ahead, for which rolling is enough"],
)
def test_a_brake_for_what_the_route_asks_is_needful_and_has_no_object(route, kind, needless):
    (brake,) = brakes(objects([]), real=-1, routes={row: route(x) for row, x in enumerate(braking(10)[0])})
    assert (brake["cause"], brake["needless"]) == ({"object": None, "kind": kind, "adversary": None}, needless)


def test_slowing_down_without_the_brake_light_is_no_brake() -> None:
    assert brakes_of(np.array([0.0, -1.2, -1.3, 0.0]), 0.1) == []


def test_a_short_interruption_does_not_end_a_brake() -> None:
    acceleration = np.array([0.0, -2.0, 0.0, 0.0, -3.0, 0.0])
    assert [tuple(brake) for brake in brakes_of(acceleration, 0.1)] == [(1, 4, 5)]
    assert len(brakes_of(np.array([-2.0, *[0.0] * 6, -2.0]), 0.1)) == 2


def test_spans_are_those_of_a_plain_loop() -> None:
    random = np.random.default_rng(3)
    for _ in range(50):
        during = random.random(20) < 0.5
        expected, first = [], None
        for row, holds in enumerate([*during.tolist(), False]):
            if holds and first is None:
                first = row
            if not holds and first is not None:
                expected.append((first, row))
                first = None
        assert spans(during) == expected


def test_a_brake_is_missed_if_an_emergency_lasts_and_the_car_does_not_brake() -> None:
    """RSS gives the car 0.5 s to respond."""
    long, short = np.arange(20) < 8, np.arange(20) < 5
    assert missed_brakes(long, [], np.zeros(19), 0.1) == 1
    assert missed_brakes(short, [], np.zeros(19), 0.1) == 0
    assert missed_brakes(long, [], np.full(19, -9.0), 0.1) == 0


@pytest.mark.parametrize("speed", [1.0, 2.0, 3.0, 3.5, 4.0, 8.0])
def test_a_car_that_drives_into_a_standing_one_without_braking_misses_one_brake_at_any_speed(speed: float) -> None:
    x = (0.1 * speed * np.arange(60)).tolist()
    there = ahead(x[40] + 2.25 + 2.0, range(60))
    found = consequences(driven(car(x, [speed] * 60), there, [7] * 60))
    assert (found["missed_brakes"], len(found["collisions"])) == (1, 1)


def test_a_car_that_is_hit_from_behind_or_that_brakes_before_it_hits_what_is_ahead_misses_none() -> None:
    behind = objects([(row, -8.0 + 0.2 * row, 0.0, 0.0) for row in range(FRAMES)])
    found = consequences(driven(car([0.0] * FRAMES, [0.0] * FRAMES), behind, [7] * FRAMES))
    assert (found["missed_brakes"], len(found["collisions"])) == (0, 1)
    x, speed = braking(10)
    found = consequences(driven(car(x, speed), ahead(20.0), [7] * FRAMES))
    assert (found["missed_brakes"], len(found["collisions"])) == (0, 1)


def test_an_emergency_is_contact_within_a_second_and_a_half() -> None:
    """At 10 m/s the gap falls from 15 m; the car hits what stands there after 1.5 s, so it had 1.4 s to brake."""
    x = [0.0 + row for row in range(FRAMES)]
    there = ahead(15.0 + 2.25 + 2.0)
    found = consequences(driven(car(x, [10.0] * FRAMES), there, [7] * FRAMES))
    assert (found["missed_brakes"], len(found["collisions"])) == (1, 1)
    assert math.isclose(found["min_ttc_s"], 0.0, abs_tol=0.05)


def crossers(x: float, y: float, velocity: tuple[float, float], frames: range = range(FRAMES)) -> RoadUsers:
    """An object that is at (x, y) in frame 10, and moves at constant velocity."""
    there = objects(
        [(row, x + (row - 10) * 0.1 * velocity[0], y + (row - 10) * 0.1 * velocity[1], 0) for row in frames]
    )
    there.velocity[:, :2] = velocity
    return there


#: In frame 10 the car is at 10 m; both would be at 30 m two seconds later.
CROSSING = crossers(30.0, 16.0, (0.0, -8.0))


@pytest.mark.parametrize("reason", [ahead(30.0), CROSSING], ids=["ahead", "crossing"])
def test_a_brake_is_needful_for_a_real_object_and_needless_for_a_false_one_whose_adversary_it_names(reason):
    (brake,) = brakes(reason, real=7, there=reason)
    assert (brake["cause"], brake["needless"]) == ({"object": 7, "kind": "real", "adversary": None}, False)
    (brake,) = brakes(reason, real=-1, adversary="adversary_1")
    assert (brake["cause"], brake["needless"]) == ({"object": 5, "kind": "false", "adversary": "adversary_1"}, True)
    assert (brake["from_s"], brake["hardest_mps2"]) == (pytest.approx(2.0), pytest.approx(6.0))


def test_a_brake_for_a_ghost_ahead_is_needless_although_real_traffic_crosses() -> None:
    (brake,) = brakes(ahead(30.0), real=-1, there=CROSSING)
    assert (brake["cause"]["kind"], brake["needless"]) == ("false", True)


@pytest.mark.parametrize("ghost", [ahead(24.0), crossers(21.0, 6.0, (0.0, -8.0))], ids=["ahead", "crossing"])
@pytest.mark.parametrize(("gap", "needless"), [(45.0, True), (22.0, False)], ids=["slight reason", "good reason"])
def test_a_slight_reason_does_not_excuse_a_hard_brake_for_a_ghost(ghost: RoadUsers, gap: float, needless: bool) -> None:
    """Behind something that stands 45 m ahead, a car that follows the model brakes with more than 1 m/s^2 already."""
    there = ahead(gap + 10.0)
    (brake,) = brakes(ghost, real=-1, there=there)
    assert (brake["cause"]["kind"], brake["needless"]) == ("false", needless)
    (brake,) = brakes(there, real=7, there=there)
    assert (brake["cause"]["kind"], brake["needless"]) == ("real", False)


@pytest.mark.parametrize(
    ("on_truth", "needless"),
    [(0.0, True), (2.9, True), (3.1, False), (6.0, False)],
    ids=["none", "slight", "half", "all"],
)
def test_a_brake_is_needless_if_its_driver_on_the_truth_brakes_not_half_as_hard(on_truth, needless):
    """Also for what is there, and whatever a model of driving says."""
    for there in (ahead(30.0), objects([])):
        commanded = np.where(np.arange(FRAMES) < 12, on_truth, 9.0)
        (brake,) = brakes(ahead(30.0), real=7, there=there, on_truth=commanded)
        assert (brake["needless"], brake["on_truth_mps2"]) == (needless, on_truth)


def test_where_it_is_not_known_what_its_driver_does_on_the_truth_a_model_tells() -> None:
    commanded = np.where(np.arange(FRAMES) == 8, np.nan, 0.0)
    (brake,) = brakes(ahead(30.0), real=7, there=ahead(30.0), on_truth=commanded)
    assert (brake["needless"], brake["on_truth_mps2"]) == (False, None)


def test_what_a_replay_leaves_out_makes_the_cause_unknown_where_it_would_tell() -> None:
    def cause(left_out: str, **known: object) -> dict:
        commands = obeyed(**known)._replace(left_out=frozenset([left_out]))
        (brake,) = brakes(ahead(30.0), real=7, commands=commands)
        return brake["cause"]

    unknown = {"object": None, "kind": "unknown", "adversary": None}
    assert cause("mission") == cause("mission", informed=False) == cause("command", of=-1, tampered="seizer") == unknown
    assert cause("mission", of=-1)["kind"] == "no command"
    assert cause("mission", tampered="seizer") == {"object": None, "kind": "none", "adversary": "seizer"}


@pytest.mark.parametrize(
    ("place", "velocity"),
    [
        ((30.0, 16.0), (0.0, 8.0)),  # it drives away
        ((30.0, 60.0), (0.0, -8.0)),  # it comes when the car has passed
        ((30.0, 16.0), (0.0, 0.0)),  # it stands beside the road
        ((-2.0, 0.0), (10.0, 0.0)),  # it follows
        ((5.0, 3.5), (11.0, -0.5)),  # it comes into the lane behind the car
    ],
)
def test_what_the_car_does_not_meet_is_no_reason_for_a_brake(place, velocity):
    there = crossers(*place, velocity)
    (brake,) = brakes(there, real=7, there=there)
    assert (brake["cause"]["kind"], brake["needless"]) == ("none", True)


@example(x=21.0, y=-12.0, vx=1.0, vy=4.0)  # it crosses, and goes along a little
@given(x=st.floats(15.0, 45.0), y=st.floats(-30.0, 30.0), vx=st.floats(-8.0, 8.0), vy=st.floats(-8.0, 8.0))
def test_what_would_be_hit_ahead_of_the_car_at_constant_velocities_crosses_or_is_in_the_corridor(x, y, vx, vy):
    """By outlines that move, looked at every 50 ms: what touches the front half of the car first."""
    there = crossers(x, y, (vx, vy), range(10, 11))._replace(frame=np.zeros(1, np.int64))
    own = car([0.0], [8.0])
    found = {*in_corridor(own, {0: straight(0.0)}, there, Driving()).row.tolist()}
    found |= {*crossing(own, {0: straight(0.0)}, there, Driving()).row.tolist()}
    for t in np.arange(0.0, 3.9, 0.05):
        at, across = x + (vx - 8.0) * t, y + vy * t
        if abs(at) <= 4.25 and abs(across) <= 1.95:
            assert (0 in found) or at < 2.25 or math.hypot(vx, vy) < 0.31
            return
