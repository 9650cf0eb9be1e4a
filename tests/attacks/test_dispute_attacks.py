"""Attacks that turn on disputes lie only where few look, or make honest agents disagree."""

from typing import Any

import numpy as np
import pytest
from attack_worlds import at, world
from hypothesis import given
from hypothesis import strategies as st
from plaza import PERIOD, Played, honest_in_range, plaza, trust_in, within

from mast_zenoh.arrays.states import ObjectStates, concatenate
from mast_zenoh.attacks import Attack, Surroundings
from mast_zenoh.attacks.disputes import DeniedSelection, OpenDispute, PairedDenial, TrustFlip
from mast_zenoh.attacks.evasion import BlindAreaConfusion
from mast_zenoh.attacks.phantoms import Sleeper
from mast_zenoh.attacks.real_objects import SlowDrift
from mast_zenoh.attacks.surroundings import Coverage
from mast_zenoh.streams import stream

#: The liar in the west, two honest poles in the east that both see its eastern half, and one in the north.
DISPUTED = plaza(
    ("infra_1",),
    ego=[(0.0, 500.0, 0.0, 60.0)],
    infra_1=[(0.0, 0.0, 0.0, 60.0)],
    infra_2=[(0.0, 70.0, 0.0, 60.0)],
    infra_3=[(0.0, 75.0, 5.0, 60.0)],
    infra_4=[(0.0, 0.0, 60.0, 60.0)],
)


@pytest.mark.parametrize("witnesses", [0, 1])
def test_cars_are_where_at_most_so_many_honest_agents_look_and_nothing_else_is_claimed(witnesses: int) -> None:
    played = Played(OpenDispute(witnesses=witnesses, budget=10.0, start_s=0.5), DISPUTED, "infra_1")
    objects, false = world(8), []
    for _ in range(60):
        done = played.step(objects)
        assert done.keep.all(), "its own objects are reported"
        assert len(done.moved) == 0
        false.append(done.added)
    cars = concatenate(false)
    viewers = honest_in_range(DISPUTED, cars.position, 0.0, margin_m=-2.0)  # noise is below 2 m
    assert viewers.max() <= witnesses
    assert np.any(honest_in_range(DISPUTED, cars.position, 0.0) == witnesses)
    assert max(map(len, false)) >= 8, "many cars"
    assert np.all(within(DISPUTED, "infra_1", cars.position, 0.0, 2.0)), "it must be able to see them"


def test_cars_stand() -> None:
    played = Played(OpenDispute(start_s=0.5), DISPUTED, "infra_1")
    places: dict[int, list[np.ndarray]] = {}
    for _ in range(60):
        added = played.step(world(8)).added
        for number, place in zip(added.id.tolist(), added.position, strict=True):
            places.setdefault(number, []).append(place)
    longest = np.array(max(places.values(), key=len))
    assert len(longest) > 40
    assert np.hypot(*(longest[-10:].mean(axis=0) - longest[:10].mean(axis=0))[:2]) < 1.5, "noise alone"


def test_a_car_is_withdrawn_a_second_before_another_honest_agent_looks_at_it() -> None:
    passing = plaza(
        ("infra_1",),
        ego=[(0.0, -200.0, 0.0, 60.0), (20.0, 200.0, 0.0, 60.0)],
        infra_1=[(0.0, 0.0, 0.0, 60.0)],
        infra_2=[(0.0, 10.0, 0.0, 200.0)],
    )
    played, seen, told = Played(OpenDispute(budget=6.0, start_s=0.5), passing, "infra_1"), 0, 0
    for _ in range(150):
        cars = played.step(world(8)).added.position
        seen += int(within(passing, "ego", cars, played.time_s, -2.0).sum()) if len(cars) else 0
        told += len(cars)
    assert told > 100
    assert seen == 0


def test_the_numbers_of_cars_and_of_hidden_objects_are_counted() -> None:
    attack = OpenDispute(start_s=0.5)
    assert attack.counts() == dict(selected=0, placed=0, wanted=0)
    played = Played(attack, DISPUTED, "infra_1")
    for _ in range(10):
        played.step(world(8))
    assert attack.counts()["placed"] == attack.counts()["wanted"] > 0


#: Two liars, and honest agents around them of which each sees a part.
PAIRED = plaza(
    ("infra_1", "infra_2"),
    ego=[(0.0, -70.0, 0.0, 60.0), (60.0, 110.0, 0.0, 60.0)],
    infra_1=[(0.0, 0.0, 0.0, 60.0)],
    infra_2=[(0.0, 10.0, 5.0, 60.0)],
    infra_3=[(0.0, 40.0, 0.0, 30.0)],
    infra_4=[(0.0, 40.0, 10.0, 40.0)],
)


def views(known: Surroundings, names: tuple[str, ...], time_s: float = 0.0) -> tuple[Any, ...]:
    return tuple(known.sensors[name].view(*known.sensors[name].route.at(time_s)) for name in names)


@given(st.integers(0, 10_000), st.integers(0, 3), st.integers(1, 40), st.floats(0.0, 50.0))
def test_only_what_two_liars_and_few_honest_agents_see_is_hidden(seed, witnesses, n, time_s):
    objects = world(n, seed, spread=40.0)
    coverage = Coverage(PAIRED, views(PAIRED, PAIRED.victims), time_s)
    hidden = DeniedSelection(witnesses=witnesses, budget=8.0).select(objects, coverage, stream(0)).remove
    assert len(hidden) <= 4
    for name in PAIRED.victims:
        assert within(PAIRED, name, hidden.position, time_s, 1e-6).all(), "both deny it"
    assert np.all(honest_in_range(PAIRED, hidden.position, time_s, -1e-6) <= witnesses)


def test_what_the_fewest_honest_agents_see_is_hidden_first() -> None:
    objects = at((38.0, 0.0), (-20.0, 30.0), (30.0, -20.0), id=np.arange(3))
    coverage = Coverage(PAIRED, views(PAIRED, PAIRED.victims), 0.0)
    hidden = DeniedSelection(budget=2.0).select(objects, coverage, stream(0)).remove
    viewers = honest_in_range(PAIRED, objects.position, 0.0)
    assert hidden.position[:, :2].tolist() == [objects.position[int(np.argmin(viewers)), :2].tolist()]


def directed(coordination: PairedDenial, known: Surroundings, objects: ObjectStates, frames: int) -> list[list[int]]:
    """The numbers of objects that each adversary has to hide, by frame; both liars see all objects."""
    coordination.inform(known)
    coordination.bind(0, "coordinator")
    both = concatenate([objects, objects])
    source = np.repeat(np.arange(2), len(objects))
    result = []
    for frame in range(frames):
        positions = np.array([known.sensors[name].route.position_at(0.0) for name in known.victims])
        coordination.look(views(known, known.victims))
        plans = coordination.step(frame, frame * PERIOD, both, source, positions)
        result.append([len(plan.remove) for plan in plans])
    return result


def test_both_liars_hide_the_same_objects_as_many_as_their_budget_allows() -> None:
    objects = at((-20.0, 10.0), (-20.0, -20.0), (5.0, 25.0), id=np.arange(3))
    counts = directed(PairedDenial(start_s=1.5, budget=4.0), PAIRED, objects, 40)
    assert counts[:15] == [[0, 0]] * 15
    assert counts[20:] == [[2, 2]] * 20


def test_an_object_is_reported_again_before_a_third_honest_agent_looks_at_it() -> None:
    arriving = plaza(
        ("infra_1", "infra_2"),
        ego=[(0.0, -200.0, 0.0, 60.0), (10.0, 0.0, 0.0, 60.0)],
        infra_1=[(0.0, 0.0, 0.0, 60.0)],
        infra_2=[(0.0, 10.0, 5.0, 60.0)],
        infra_3=[(0.0, -10.0, 0.0, 60.0)],
        infra_4=[(0.0, -10.0, 10.0, 60.0)],
    )
    objects = at((-20.0, 0.0), id=np.zeros(1, np.int64))
    counts = directed(PairedDenial(start_s=1.5), arriving, objects, 90)
    arrives = next(k for k in range(90) if within(arriving, "ego", objects.position, 0.1 * k)[0])
    assert counts[20 : arrives - 12] == [[1, 1]] * (arrives - 32)
    assert counts[arrives - 9 :] == [[0, 0]] * (99 - arrives)


def test_both_are_honest_while_the_trust_in_one_has_fallen() -> None:
    coordination = PairedDenial(start_s=0.5)
    coordination.hear_trust(0, 0, trust_in(infra_1=1.0, infra_2=1.0))
    objects = at((-20.0, 10.0), id=np.zeros(1, np.int64))
    assert directed(coordination, PAIRED, objects, 30)[-1] == [1, 1]
    coordination.hear_trust(30, 0, trust_in(infra_1=1.0, infra_2=0.8))
    assert directed(coordination, PAIRED, objects, 3)[-1] == [0, 0]


NEAR = at((12.0, 3.0), (-12.0, -4.0), (0.0, 15.0), id=np.arange(3))


def flipped(attack: TrustFlip, known: Surroundings, agent: str, frames: int = 20) -> int:
    """Rows that are hidden from an agent's sensors in the last message."""
    played = Played(attack, known, agent)
    for _ in range(frames):
        done = played.step(NEAR)
        assert len(done.added) == len(done.moved) == 0, "nothing is invented"
    return int((~done.keep).sum())


def square(victims: tuple[str, ...], **far: float) -> Surroundings:
    """Five agents around the objects; far: x, m, of those that stand elsewhere."""
    places = dict(ego=-20.0, infra_1=0.0, infra_2=5.0, infra_3=10.0, infra_4=15.0) | far
    return plaza(victims, **{name: [(0.0, x, 30.0, 60.0)] for name, x in places.items()})


def test_the_target_is_blind_to_what_two_others_see() -> None:
    assert flipped(TrustFlip(start_s=0.5), square(("infra_3",)), "infra_3") == 2
    assert flipped(TrustFlip(target="infra_3", start_s=0.5), square(("infra_3",)), "infra_3") == 2
    one_other = square(("infra_3",), ego=900.0, infra_1=900.0, infra_2=900.0)
    assert flipped(TrustFlip(start_s=0.5), one_other, "infra_3") == 0
    assert flipped(TrustFlip(start_s=0.5, witnesses=1), one_other, "infra_3") == 2


def test_others_are_blind_to_what_the_target_sees_where_they_outnumber_all_other_viewers() -> None:
    blinded = ("infra_1", "infra_2")
    alone = square(blinded, ego=900.0, infra_4=900.0)
    for agent in blinded:
        assert flipped(TrustFlip(target="infra_3", start_s=0.5), alone, agent) == 2
    tie = square(blinded, ego=900.0)
    assert flipped(TrustFlip(target="infra_3", start_s=0.5), tie, "infra_1") == 0
    assert flipped(TrustFlip(target="infra_3", start_s=0.5), square(blinded, infra_3=900.0), "infra_1") == 0


def test_one_other_sensor_contradicts_nobody() -> None:
    alone = square(("infra_1",), ego=900.0, infra_2=900.0, infra_4=900.0)
    attack = TrustFlip(target="infra_3", start_s=0.5)
    assert flipped(attack, alone, "infra_1") == 0
    assert not any(attack.counts().values()), "the node warns that there was no target"


@pytest.mark.parametrize(
    ("attack", "known", "victim", "fallen"),
    [
        (OpenDispute(start_s=0.5), DISPUTED, "infra_1", trust_in(mean=0.5)),
        (BlindAreaConfusion(start_s=0.5), DISPUTED, "infra_1", trust_in(mean=0.5)),
        (BlindAreaConfusion(action="hide", start_s=0.5), DISPUTED, "infra_1", trust_in(mean=0.5)),
        (
            Sleeper(attack=SlowDrift(start_s=0.5), honest_s=0.5, lying_s=0.5, start_s=0.5),
            DISPUTED,
            "infra_1",
            trust_in(mean=0.5),
        ),
        (
            TrustFlip(target="infra_3", start_s=0.5),
            square(("infra_3",)),
            "infra_3",
            trust_in("suspended", infra_3=1.0, ego=0.0),
        ),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Attack) else "",
)
def test_no_lie_is_told_while_the_trust_has_fallen(attack, known, victim, fallen):
    trusted = trust_in("trusted", infra_3=1.0, ego=0.0) if victim == "infra_3" else trust_in(mean=1.0)
    played, lies = Played(attack, known, victim), []
    objects = concatenate([NEAR, world(8, spread=20.0).with_(id=np.arange(10, 18))])
    for frame in range(80):
        attack.hear_trust(frame, 0, fallen if 30 <= frame < 50 else trusted)
        lies.append(len(played.step(objects).report))
    assert sum(lies[:30]) > 0
    assert sum(lies[31:50]) == 0
    assert sum(lies[50:]) > 0
