"""Attacks on the road ahead follow the ego wherever it has been driven, and lie about what it would brake for."""

import numpy as np
import pytest
from attack_worlds import at
from plaza import PERIOD, Played, plaza

from mast_zenoh.arrays.states import CLASS_INDEX, ObjectStates, concatenate
from mast_zenoh.attacks import Attack, Surroundings, Tampering
from mast_zenoh.attacks.adaptive import Moment
from mast_zenoh.attacks.regions import LANE_M, path_ahead
from mast_zenoh.attacks.road_ahead import (
    LANE_WIDTH_M,
    NEAREST_M,
    CutIn,
    EgoOnRoute,
    GhostAhead,
    HideAhead,
    LaneIntrusion,
    PhantomQueue,
)
from mast_zenoh.attacks.surroundings import Coverage

#: The schedule of the ego: east along y = 0 at 8 m/s. It is driven at half of that.
SCHEDULED_MPS, DRIVEN_MPS = 8.0, 4.0


def street(victim: str, turn: float = 0.0) -> Surroundings:
    """turn: rad, counter-clockwise, of the whole street"""
    x, y = np.cos(turn), np.sin(turn)
    ego = [(0.0, -60.0 * x, -60.0 * y, 90.0), (30.0, 180.0 * x, 180.0 * y, 90.0)]
    return plaza((victim,), ego=ego, infra_1=[(0.0, -10.0 * y, 10.0 * x, 150.0)])


def turned(states: ObjectStates, turn: float) -> ObjectStates:
    rotation = np.array([[np.cos(turn), np.sin(turn), 0.0], [-np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    return states.with_(position=states.position @ rotation, velocity=states.velocity @ rotation, yaw=states.yaw + turn)


class DrivenEgo:
    """An attack on the picture for an ego that falls behind its schedule, or on the tracks of a pole that sees it."""

    def __init__(self, attack: Attack, victim: str = "ego", turn: float = 0.0) -> None:
        known, self.turn = street(victim, turn), turn
        self.played = Played(attack, known, victim, fused=victim == "ego")
        self.x, self.frame = -60.0, -1

    def step(self, *others: ObjectStates, speed_mps: float = DRIVEN_MPS) -> Tampering:
        """The next message, 0.1 s later: the ego, and other objects where they are now."""
        self.frame += 1
        self.x += 0.1 * speed_mps if self.frame else 0.0
        ego = at((self.x, 0.0), id=np.array([7]), velocity=np.array([[speed_mps, 0.0, 0.0]]))
        self.objects = turned(concatenate([ego, *others]), self.turn)
        attack, sensor = self.played.attack, self.played.known.sensors[self.played.victim]
        position = self.objects.position[0] if self.played.victim == "ego" else sensor.route.at(0.0)[0]
        attack.look(sensor.view(position, np.eye(3)), fused=self.played.fused)
        return attack.step(self.frame, self.frame * PERIOD, self.objects, position)


def moving(x: float, y: float, vx: float, vy: float, number: int, length_m: float = 4.5) -> ObjectStates:
    return at(
        (x, y),
        id=np.array([number]),
        velocity=np.array([[vx, vy, 0.0]]),
        yaw=np.array([np.arctan2(vy, vx)]),
        class_id=np.array([CLASS_INDEX["car" if length_m > 2.0 else "pedestrian"]], np.uint8),
    ).with_(size=np.array([[length_m, 0.5 if length_m < 2.0 else 1.8, 1.6]]))


def test_places_on_a_path_are_how_far_along_and_how_far_to_the_left() -> None:
    path = path_ahead(Coverage(street("ego"), (), 0.0))
    assert path is not None
    along, left = path.coordinates(np.array([[-49.7, 2.0], [10.25, -3.5]]))
    assert np.allclose(along, [10.3, 70.25])
    assert np.allclose(left, [2.0, -3.5])


@pytest.mark.parametrize("victim", ["ego", "infra_1"])
def test_the_leader_of_an_ego_that_is_off_schedule_is_hidden_and_nothing_else(victim: str) -> None:
    driven = DrivenEgo(HideAhead(start_s=1.0, budget=1.0), victim)
    for frame in range(80):
        leader = moving(driven.x + 20.0, 0.5, DRIVEN_MPS, 0.0, 1)
        further = moving(driven.x + 40.0, 0.0, DRIVEN_MPS, 0.0, 2)
        beside = moving(driven.x + 12.0, LANE_WIDTH_M, DRIVEN_MPS, 0.0, 3)
        behind = moving(driven.x - 9.0, 0.0, DRIVEN_MPS, 0.0, 4)
        kept = driven.step(leader, further, beside, behind).keep
        assert driven.objects.id[~kept].tolist() == ([] if frame < 10 else [1])


@pytest.mark.parametrize(("with_velocity", "turn"), [(True, 0.0), (True, 2.0), (False, 0.0)])
def test_who_comes_from_the_side_is_hidden_before_and_in_the_lane_and_who_stands_there_is_not(with_velocity, turn):
    """Without velocities and ids, as in detections, the attack estimates them itself."""
    driven, hidden = DrivenEgo(HideAhead(start_s=1.0, what="crossing"), turn=turn), []
    for frame in range(100):
        y = 9.0 - 0.15 * frame
        walker = moving(-10.0, y, 0.0, -1.5, 1, length_m=0.5)
        waiting = moving(-5.0, 4.0, 0.0, 0.0, 2, length_m=0.5)
        leader = moving(driven.x + 25.0, 0.0, DRIVEN_MPS, 0.0, 3)
        others = [walker, waiting, leader]
        if not with_velocity:
            others = [each.with_(velocity=np.zeros((1, 3)), id=np.array([-1])) for each in others]
        kept = driven.step(*others).keep
        assert kept[[0, 2, 3]].all()
        hidden.append(not kept[1])
    assert not any(hidden[:10])
    assert all(hidden[20:60])  # from 6 m to the left to the middle of the lane


@pytest.mark.parametrize("into", ["ego", "neighbour"])
def test_a_vehicle_moves_slowly_to_the_middle_of_the_other_lane(into: str) -> None:
    driven = DrivenEgo(LaneIntrusion(start_s=1.0, into=into, rate_mps=1.0))  # type: ignore[arg-type]
    real = LANE_WIDTH_M if into == "ego" else 0.0
    claimed = []
    for _ in range(80):
        tampering = driven.step(moving(driven.x + 20.0, real, DRIVEN_MPS, 0.0, 1))
        moved = tampering.applied_to(driven.objects)
        claimed.append(float(moved.position[moved.id == 1][0, 1]))
    assert claimed[:10] == [real] * 10
    assert np.abs(np.diff(claimed)).max() <= 0.1 + 1e-9
    assert claimed[-1] == pytest.approx(0.0 if into == "ego" else -LANE_WIDTH_M, abs=1e-6)


def test_an_intruder_seems_to_move_as_it_is_displaced() -> None:
    driven = DrivenEgo(LaneIntrusion(start_s=1.0, rate_mps=1.0))
    for _ in range(20):
        tampering = driven.step(moving(driven.x + 20.0, LANE_WIDTH_M, DRIVEN_MPS, 0.0, 1))
    assert np.allclose(tampering.moved.velocity, [[DRIVEN_MPS, -1.0, 0.0]])


def added(driven: DrivenEgo, frames: int, *others: ObjectStates) -> list[ObjectStates]:
    return [driven.step(*others).added for _ in range(frames)]


@pytest.mark.parametrize("victim", ["ego", "infra_1"])
def test_a_queue_stands_in_the_lane_ahead_of_where_the_ego_is_driven(victim: str) -> None:
    driven = DrivenEgo(PhantomQueue(start_s=2.0, ahead_m=30.0, spacing_m=8.0, budget=3.0), victim)
    rows = added(driven, 80)
    assert not any(len(each) for each in rows[:20])
    shown = [each for each in rows[20:] if len(each) == 3]
    assert len(shown) > 50
    begin = -60.0 + 20 * 0.1 * DRIVEN_MPS  # where the ego is when it begins, 8 m behind its schedule
    for each in shown:
        assert np.allclose(np.sort(each.position[:, 0]), begin + np.array([30.0, 38.0, 46.0]), atol=3.0)
        assert (np.abs(each.position[:, 1]) <= LANE_M).all()
        assert (np.hypot(*each.velocity[:, :2].T) < 1.5).all(), "as slow as a track of a standing car"


@pytest.mark.parametrize("victim", ["ego", "infra_1"])
def test_ghosts_stand_in_the_lane_ahead_of_where_the_ego_is_driven_and_none_is_left_to_be_hit(victim: str) -> None:
    """In the end the ego is 60 m behind its schedule."""
    driven, shown = DrivenEgo(GhostAhead(start_s=2.0), victim), 0
    for frame in range(150):
        ghosts = driven.step().added
        gap = ghosts.position[:, 0] - driven.x
        assert (np.abs(ghosts.position[:, 1]) <= LANE_M + 1.0).all()
        assert ((gap > NEAREST_M - 2.0) & (gap < 70.0)).all(), "with noise, and with an ego that is off by a metre"
        shown += len(ghosts) if frame >= 100 else 0
    assert shown > 50


def test_an_ego_that_nobody_sees_is_where_its_schedule_has_it() -> None:
    """It stands for 5 s, then drives 8 m/s; the pole does not see it."""
    rows = [(0.0, -60.0, 0.0, 90.0), (5.0, -60.0, 0.0, 90.0), (20.0, 60.0, 0.0, 90.0)]
    known = plaza(("infra_1",), ego=rows, infra_1=[(0.0, 0.0, 10.0, 150.0)])
    ego = EgoOnRoute(known)
    for frame in range(100):
        pole, coverage = known.sensors["infra_1"].route.at(0.0)[0], Coverage(known, (), frame * 0.1)
        ego.observe(Moment(frame, frame * PERIOD, 0.1, ObjectStates.empty(), np.zeros(0, bool), coverage, pole))
        assert ego.along == pytest.approx(max(frame * 0.1 - 5.0, 0.0) * 8.0, abs=1e-6)


def test_a_queue_that_the_ego_has_reached_is_withdrawn_and_another_one_comes_ahead() -> None:
    driven = DrivenEgo(PhantomQueue(start_s=1.0, ahead_m=20.0, budget=2.0))
    nearest = [float(each.position[:, 0].min() - driven.x) for each in added(driven, 150) if len(each)]
    gaps = np.array(nearest) - np.array(nearest)[0]
    assert np.count_nonzero(np.diff(gaps) > 10.0) >= 1
    assert driven.played.attack.counts()["placed"] >= 4


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_false_vehicle_comes_from_the_neighbouring_lane_and_brakes_before_the_ego(side: str) -> None:
    driven = DrivenEgo(CutIn(start_s=2.0, side=side, ahead_m=15.0, change_s=2.0, braking_mps2=2.0))  # type: ignore[arg-type]
    rows, y, speed = added(driven, 55)[20:], [], []
    for each in rows:
        if len(each):
            y.append(float(each.position[0, 1]) * (1.0 if side == "left" else -1.0))
            speed.append(float(each.velocity[0, 0]))
    assert y[0] == pytest.approx(LANE_WIDTH_M, abs=1.0)
    assert np.mean(y[21:]) == pytest.approx(0.0, abs=0.7)
    assert np.mean(speed[:15]) == pytest.approx(DRIVEN_MPS, abs=1.0)
    assert speed[-1] < DRIVEN_MPS / 2


def test_without_a_route_there_is_no_road_to_lie_about() -> None:
    for attack_class in (GhostAhead, PhantomQueue, CutIn, HideAhead, LaneIntrusion):
        attack = attack_class(start_s=0.0)
        attack.inform(Surroundings())
        attack.bind(0, "adversary_1")
        for frame in range(10):
            objects = concatenate([moving(20.0, 0.0, 1.0, 0.0, 1), moving(20.0, 3.0, 1.0, 0.0, 2)])
            assert len(attack.step(frame, frame * PERIOD, objects, np.zeros(3)).report) == 0
