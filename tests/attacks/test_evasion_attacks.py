"""Small shifts, lies in blind areas, and lies only while trusted stay where a defence does not look."""

from typing import Any

import numpy as np
import pytest
from attack_worlds import at, world
from hypothesis import given, settings
from hypothesis import strategies as st
from plaza import Played, plaza, trust_in, within

from mast_zenoh.arrays.states import ObjectStates, concatenate
from mast_zenoh.attacks import Attack, Surroundings, Tampering, alter
from mast_zenoh.attacks.evasion import DIRECTIONS, BlindAreaConfusion, Direction, PosePert, PretendBenign
from mast_zenoh.attacks.regions import path_ahead
from mast_zenoh.attacks.surroundings import Coverage
from mast_zenoh.errors import ConfigurationError

#: The ego drives east along y = 0 at 2 m/s.
STREET = plaza(
    ("infra_1",),
    ego=[(0.0, -60.0, 0.0, 40.0), (60.0, 60.0, 0.0, 40.0)],
    infra_1=[(0.0, 0.0, 0.0, 70.0)],
    infra_2=[(0.0, 30.0, 0.0, 70.0)],
)


def shifts(attack: PosePert, objects: ObjectStates, frames: int = 40) -> list[np.ndarray]:
    played = Played(attack, STREET, "infra_1")
    reports = [played.step(objects).report for _ in range(frames)]
    return [report.after_position - report.before_position for report in reports]


@given(st.floats(0.01, 0.999), st.sampled_from(DIRECTIONS), st.floats(0.1, 3.0))
def test_a_shift_grows_to_its_size_and_stays_below_a_metre(offset_m, direction, rise_s):
    attack = PosePert(offset_m=offset_m, direction=direction, rise_s=rise_s, start_s=0.5)
    size = [np.linalg.norm(shift, axis=1).max(initial=0.0) for shift in shifts(attack, world(6))]
    assert max(size) < 1.0
    assert size[-1] == pytest.approx(offset_m)
    assert np.diff(size).max() <= offset_m / rise_s * 0.1 + 1e-9
    assert all(each == 0.0 for each in size[:5])


@pytest.mark.parametrize(("direction", "nearer"), [("toward", True), ("away", False)])
def test_objects_are_shifted_toward_the_egos_path_or_away_from_it(direction: Direction, nearer: bool) -> None:
    objects = at((-20.0, 12.0), (-10.0, -15.0), id=np.arange(2))
    (last,) = shifts(PosePert(direction=direction, start_s=0.5), objects)[-1:]
    path = path_ahead(Coverage(STREET, (), 0.0))
    assert path is not None
    before, after = path.offset(objects.position), path.offset(objects.position + last)
    assert len(last) == 2
    assert np.allclose(before - after, 0.8 if nearer else -0.8, atol=0.05)


def test_objects_are_shifted_to_the_left_of_their_heading() -> None:
    objects = at((-20.0, 12.0), (-10.0, -15.0), id=np.arange(2), yaw=np.array([0.0, np.pi / 2]))
    (last,) = shifts(PosePert(direction="sideways", start_s=0.5), objects)[-1:]
    assert np.allclose(last[:, :2], [[0.0, 0.8], [-0.8, 0.0]])


def test_shifts_shrink_while_the_trust_has_fallen() -> None:
    played, size = Played(PosePert(start_s=0.5, rise_s=1.0), STREET, "infra_1"), []
    for frame in range(60):
        played.attack.hear_trust(frame, 0, trust_in(mean=0.5 if 30 <= frame < 50 else 1.0))
        report = played.step(world(6)).report
        size.append(np.linalg.norm(report.after_position - report.before_position, axis=1).max(initial=0.0))
    assert size[29] == pytest.approx(0.8)
    assert np.allclose(np.diff(size)[29:36], -0.08)
    assert size[45:50] == [0.0] * 5
    assert size[-1] > 0.0


def test_false_vehicles_are_out_of_the_egos_sight_and_in_the_victims() -> None:
    played, told, seen = Played(BlindAreaConfusion(start_s=0.5, budget=6.0), STREET, "infra_1"), 0, 0
    for _ in range(300):
        added = played.step(world(8)).added
        told += len(added)
        seen += int(within(STREET, "ego", added.position, played.time_s, -2.0).sum())
        assert within(STREET, "infra_1", added.position, 0.0, 2.0).all()
    assert told > 500
    assert seen == 0


def test_real_objects_are_hidden_only_while_the_ego_cannot_see_them() -> None:
    objects = at((-30.0, 10.0), (20.0, 10.0), (40.0, -10.0), id=np.arange(3))
    played, hidden = Played(BlindAreaConfusion(action="hide", start_s=0.5, budget=3.0), STREET, "infra_1"), 0
    for _ in range(400):
        done = played.step(objects)
        assert len(done.added) == 0
        gone = objects.select(~done.keep)
        assert not within(STREET, "ego", gone.position, played.time_s).any()
        hidden += len(gone)
    assert hidden > 400


def test_an_object_behind_another_one_is_hidden_from_the_ego() -> None:
    low = plaza(
        ("infra_1",), ego=[(0.0, 0.0, 0.0, 90.0)], infra_1=[(0.0, 60.0, 40.0, 90.0)], infra_2=[(0.0, 0.0, 300.0, 9.0)]
    )
    truck, car = [30.0, 0.0, 4.5], [40.0, 0.0, 0.75]
    objects = ObjectStates.of(
        np.array([truck, car]), id=np.arange(2), size=np.array([[9.0, 3.0, 9.0], [4.5, 1.8, 1.5]])
    )
    played = Played(BlindAreaConfusion(action="hide", start_s=0.5), low, "infra_1")
    assert [played.step(objects).keep.tolist() for _ in range(20)][-1] == [True, False]


@pytest.mark.parametrize("fused", [False, True], ids=["of an honest agent", "of the deceived ego"])
def test_a_compromised_ego_lies_in_the_blind_area(fused):
    others = {} if fused else dict(infra_2=[(0.0, -60.0, 0.0, 40.0)])
    reach = 40.0 if fused else 70.0
    known = plaza(("ego",), ego=[(0.0, 0.0, 0.0, reach)], infra_1=[(0.0, 40.0 * (not fused), 0.0, 40.0)], **others)
    played = Played(BlindAreaConfusion(start_s=0.5, budget=6.0), known, "ego", fused=fused)
    cars = concatenate([played.step(world(8)).added for _ in range(60 if fused else 100)])
    assert len(cars) > 60
    assert not within(known, "ego" if fused else "infra_1", cars.position, 0.0, -2.0).any()
    assert fused or within(known, "infra_2", cars.position, 0.0).any(), "others may look"


def test_an_unknown_agent_and_action_are_named_with_the_nearest() -> None:
    with pytest.raises(ConfigurationError, match=r"deceived.*'infra_11'.*infra_1"):
        BlindAreaConfusion(deceived="infra_11").inform(STREET)
    with pytest.raises(ValueError, match=r"action: found 'inserts'.*insert"):
        BlindAreaConfusion(action="inserts")  # type: ignore[arg-type]


class HideAll(Attack):
    """Hides all objects."""

    def step(self, frame: int, time_ns: int, objects: ObjectStates, *_: Any, **__: Any) -> Tampering:
        return alter(objects, hide=range(len(objects)))


ALONE = plaza(("infra_1",), ego=[(0.0, 900.0, 0.0, 40.0)], infra_1=[(0.0, 0.0, 0.0, 70.0)])
WATCHED = plaza(
    ("infra_1",), ego=[(0.0, 0.0, 0.0, 300.0)], infra_1=[(0.0, 0.0, 0.0, 70.0)], infra_2=[(0.0, 0.0, 0.0, 300.0)]
)


def lying(attack: PretendBenign, frames: int, trust: Any = None, known: Surroundings = ALONE) -> list[bool]:
    """Whether it lies, by frame. trust: the trust that it hears, by frame"""
    played, result = Played(attack, known, "infra_1"), []
    for frame in range(frames):
        if trust is not None:
            attack.hear_trust(frame, 0, trust(frame))
        result.append(len(played.step(world(4)).report) > 0)
    return result


@settings(max_examples=12)
@given(st.floats(0.3, 8.0), st.floats(0.05, 0.8))
def test_bursts_are_as_short_and_pauses_as_long_as_the_memory_asks(memory_s: float, duty: float) -> None:
    lies = np.array(lying(PretendBenign(attack=HideAll(), memory_s=memory_s, duty=duty, start_s=1.0), 400))
    assert not lies[:10].any()
    edges = np.flatnonzero(np.diff(lies.astype(int)))
    bursts = [stop - start for start, stop in zip(edges[::2], edges[1::2], strict=False)]
    pauses = [start - stop for stop, start in zip(edges[1::2], edges[2::2], strict=False)]
    assert len(bursts) > 0
    assert max(bursts) <= np.ceil(10.0 * memory_s * duty / (1.0 - duty) - 1e-6)
    assert min(pauses, default=np.inf) >= np.ceil(10.0 * memory_s - 1e-6)


def test_it_is_honest_until_its_agent_is_trusted() -> None:
    lies = lying(
        PretendBenign(attack=HideAll(), memory_s=1.0, start_s=0.5),
        60,
        lambda frame: trust_in("trusted" if frame >= 30 else "unknown", 0.9 if frame >= 30 else 0.2),
    )
    assert not any(lies[:30])
    assert any(lies[30:])


@pytest.mark.parametrize(("state", "mean"), [("suspended", 1.0), ("faulty", 1.0), ("unknown", 0.4)])
def test_an_agent_that_is_not_trusted_does_not_lie(state: str, mean: float) -> None:
    assert not any(lying(PretendBenign(attack=HideAll(), start_s=0.5), 60, lambda frame: trust_in(state, mean)))


def test_a_burst_ends_as_soon_as_the_trust_falls_and_the_defence_has_to_forget() -> None:
    attack = PretendBenign(attack=HideAll(), memory_s=2.0, duty=0.5, start_s=1.0)
    lies = lying(attack, 80, lambda frame: trust_in("trusted", 0.5 if 15 <= frame < 20 else 1.0))
    assert all(lies[10:15])
    assert not any(lies[15:35])
    assert lies[35]


def test_no_burst_begins_while_the_victim_is_inspected() -> None:
    def attack(share: float) -> PretendBenign:
        return PretendBenign(attack=HideAll(), start_s=0.5, inspected_share=share)

    assert not any(lying(attack(1.0), 40, known=WATCHED))
    assert any(lying(attack(1.1), 40, known=WATCHED))
    assert any(lying(attack(1.0), 40, known=ALONE))


def test_its_attack_hears_and_sees_what_it_does() -> None:
    heard = []

    class Listener(HideAll):
        def hear_picture(self, frame: int, time_ns: int, objects: ObjectStates) -> None:
            heard.append("picture")

        def hear_trust(self, frame: int, time_ns: int, trust: Any) -> None:
            heard.append("trust")

    attack = PretendBenign(attack=Listener())
    attack.hear_picture(0, 0, world(2))
    attack.hear_trust(0, 0, trust_in())
    assert heard == ["picture", "trust"]
