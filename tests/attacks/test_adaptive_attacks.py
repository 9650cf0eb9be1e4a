"""What adaptive adversaries do on the wires of a run, measured from its messages."""

from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pytest
from tiny_world import Run

from mast_zenoh import scenario
from mast_zenoh.arrays.geometry import rotation_from_quaternion, states_to_world
from mast_zenoh.arrays.states import Bools, Ints, ObjectStates
from mast_zenoh.integrity import SweptView, sightings
from mast_zenoh.integrity.visibility import TOLERANCES, ray_evidence
from mast_zenoh.messages.schemas import Message
from mast_zenoh.tracking.view import SensorView

pytestmark = pytest.mark.heavy

FRAMES, PERIOD_S, START_S = 80, 0.1, 3.0
VICTIMS, AGENTS = ("infra_1", "infra_2"), ("ego", "infra_1", "infra_2", "infra_3", "infra_4")
#: Parameters of each attack of these runs.
ATTACKS: dict[str, dict[str, Any]] = {
    "BlindSpot": {},
    "Mimic": {},
    "SlowDrift": dict(rate_mps=0.3, limit_m=1.0),
    "Sleeper": dict(honest_s=1.0, lying_s=1.0),
    "Framing": dict(framed="infra_3"),
    "Replay": dict(delay_s=2.0),
    "GhostAhead": {},
    "StatePerturbation": dict(velocity_mps=4.0, covariance_factor=0.5),
    "Overconfidence": dict(offset_m=1.5, covariance_factor=1e-3),
    "Collusion": {},
    "OpenDispute": dict(budget=2.0),
    "PairedDenial": dict(witnesses=3),
    "PosePert": dict(offset_m=0.7),
    "BlindAreaConfusion": {},
    "PretendBenign": dict(memory_s=1.0, duty=0.5),
}


class Passage(NamedTuple):
    """Tracks and view of one agent in one frame, world frame: as it sent them, and as the broker receives them."""

    frame: int
    agent: str
    before: ObjectStates
    after: ObjectStates
    true_view: SweptView
    claimed: SweptView

    @property
    def inserted(self) -> ObjectStates:
        return self.after.select(~np.isin(self.after.id, self.before.id))

    @property
    def hidden(self) -> ObjectStates:
        return self.before.select(~np.isin(self.before.id, self.after.id))

    @property
    def kept(self) -> tuple[ObjectStates, ObjectStates]:
        """The objects that are in both, before and after, by id."""
        return tuple(self._kept(each) for each in (self.before, self.after))  # type: ignore[return-value]

    def _kept(self, states: ObjectStates) -> ObjectStates:
        both = states.select(np.isin(states.id, np.intersect1d(self.before.id, self.after.id)))
        return both.select(np.argsort(both.id))


@cache
def played(attack: str, knowledge: str = "own") -> Run:
    """A run of the scenario `defended` on the generated junction."""
    spec = {"type": attack, "start_s": START_S} | ATTACKS[attack]
    path, content = scenario.load_values("defended", dict(attack=spec, knowledge=knowledge))
    return Run(scenario.resolve(path, content, frames=FRAMES), encode=False)


def world_states(message: Message) -> ObjectStates:
    body = message.body
    return states_to_world(ObjectStates.from_columns(body), body["origin"], body["rotation"])


def frame_at(message: Message) -> SweptView:
    body = message.body
    limits = *body["azimuth"].tolist(), *body["elevation"].tolist(), float(body["max_range"][0])
    return SweptView(SensorView(body["position"], rotation_from_quaternion(body["rotation"]), *limits), body["free"])


@cache
def passages(attack: str) -> tuple[Passage, ...]:
    run, result = played(attack), []
    for agent in VICTIMS:
        tracks, views = (
            [run.decoded(f"agent/{agent}/{wire}{leg}", schema) for leg in ("/@tap/0", "")]
            for wire, schema in (("tracks", "tracks"), ("view", "view"))
        )
        for sent, received, true_view, claimed in zip(*tracks, *views, strict=True):
            assert sent.header == received.header
            assert true_view.header == claimed.header
            assert sent.header.frame == claimed.header.frame
            states = world_states(sent), world_states(received)
            result.append(Passage(sent.header.frame, agent, *states, frame_at(true_view), frame_at(claimed)))
    return tuple(result)


def rows_seen(objects: ObjectStates, view: SweptView) -> tuple[Bools, Bools]:
    """Which objects are in view, and which are seen through."""
    each = sightings(objects.position, objects.size, objects.yaw, [view])
    return each.in_view[:, 0], each.fully_clear[:, 0]


def rays_end_at(objects: ObjectStates, view: SweptView) -> Bools:
    """Objects at which the rays of a sensor end, towards their centres."""
    rays = ray_evidence(objects.position, objects.velocity, objects.size, objects.yaw, [view], None, TOLERANCES)
    return rays[1][:, 0]


def lies(passage: Passage) -> Ints:
    before, after = passage.kept
    changed = [np.abs(getattr(before, name) - getattr(after, name)) for name in ("position", "velocity", "covariance")]
    differs = np.any([(change > 1e-9).any(axis=tuple(range(1, change.ndim))) for change in changed], axis=0)
    return np.array([len(passage.inserted), len(passage.hidden), int(np.count_nonzero(differs))])


@pytest.mark.parametrize("attack", ATTACKS)
def test_reports_agree_with_what_is_measured_on_the_wires(attack: str) -> None:
    run = played(attack)
    assert not run.failures
    assert not run.rejected
    interposers = run.results["evaluator"]["metrics"]["interposers"]
    assert {each["agreement"] for each in interposers.values()} <= {"agrees", "nothing to report"}, interposers
    assert any(each["effects"] for each in interposers.values())


@pytest.mark.parametrize("attack", ATTACKS)
def test_an_attack_tells_what_its_name_says_and_no_more_than_its_budget(attack: str) -> None:
    inserted, hidden, changed = sum(lies(passage) for passage in passages(attack))
    kinds = {name for name, n in (("inserted", inserted), ("hidden", hidden), ("changed", changed)) if n}
    assert kinds <= {
        "SlowDrift": {"changed"},
        "StatePerturbation": {"changed"},
        "Overconfidence": {"changed"},
        "Framing": {"hidden"},
        "Replay": {"inserted", "hidden", "changed"},
        "Collusion": {"inserted", "hidden"},
        "PairedDenial": {"hidden"},
        "PosePert": {"changed"},
    }.get(attack, {"inserted"})
    duration_s = FRAMES * PERIOD_S - START_S
    for group in [VICTIMS] if attack in ("Collusion", "PairedDenial") else [(agent,) for agent in VICTIMS]:
        cost = sum(lies(passage).sum() for passage in passages(attack) if passage.agent in group) * PERIOD_S
        assert cost <= 2.0 * len(group) * duration_s + 1e-6
    assert all(not lies(passage).any() for passage in passages(attack) if passage.frame * PERIOD_S < START_S)
    assert inserted + hidden + changed > 0


@pytest.mark.parametrize("attack", ATTACKS)
def test_no_agent_contradicts_its_own_lies(attack: str) -> None:
    invented = hidden = contradicted = 0
    for passage in passages(attack):
        before, after = passage.kept
        far = np.hypot(*(after.position - before.position)[:, :2].T) > 3.0
        for objects in (passage.inserted, after.select(far)):
            assert not rows_seen(objects, passage.claimed)[1].any(), "the view denies a false object"
            invented += len(objects)
        for objects in (passage.hidden, before.select(far)):
            real = rays_end_at(objects, passage.true_view)
            contradicted += np.count_nonzero(real & rays_end_at(objects, passage.claimed))
            hidden += np.count_nonzero(real)
    assert contradicted == 0
    assert invented + hidden > 0 or attack in ("SlowDrift", "StatePerturbation", "Overconfidence", "PosePert")


def test_nobody_honest_looks_at_what_is_invented_in_a_blind_spot() -> None:
    run, seen, told = played("BlindSpot"), 0, 0
    views = {a: run.decoded(f"agent/{a}/view", "view") for a in AGENTS}
    for passage in passages("BlindSpot"):
        for agent in (each for each in AGENTS if each != passage.agent):
            # Adversaries do not know of each other.
            seen += np.count_nonzero(rows_seen(passage.inserted, frame_at(views[agent][passage.frame]))[1])
        told += len(passage.inserted)
    assert told > 60
    assert seen <= 0.02 * told, "noise and the coarse grid of the view"


def test_a_mimic_repeats_what_a_real_vehicle_did_before() -> None:
    told = 0
    for passage in passages("Mimic"):
        earlier = [p for p in passages("Mimic") if p.agent == passage.agent and p.frame <= passage.frame - 20]
        for place in passage.inserted.position:
            distance = [np.linalg.norm(p.before.position - place, axis=1).min(initial=np.inf) for p in earlier]
            assert min(distance) < 1e-6 + 0.6, "between two messages, it is moved on"
            told += 1
    assert told > 20


def test_a_drift_grows_at_its_rate_up_to_its_limit() -> None:
    offsets: dict[tuple[str, int], list[tuple[int, np.ndarray]]] = {}
    for passage in passages("SlowDrift"):
        before, after = passage.kept
        offset = after.position - before.position
        for id_, row in zip(before.id.tolist(), offset, strict=True):
            if np.abs(row).max() > 1e-9:
                offsets.setdefault((passage.agent, id_), []).append((passage.frame, row))
    assert offsets
    longest = max(offsets.values(), key=len)
    for each in offsets.values():
        for (frame, row), (later, other) in pairwise(each):
            assert np.linalg.norm(other - row) <= 0.3 * PERIOD_S * (later - frame) + 1e-9
    assert max(np.linalg.norm(row) for _, row in longest) == pytest.approx(1.0)


def test_a_sleeper_is_honest_between_its_bursts() -> None:
    for passage in passages("Sleeper"):
        since = round(passage.frame - START_S / PERIOD_S)
        if since < 0 or since % 20 >= 10:
            assert not lies(passage).any()
            assert np.array_equal(passage.true_view.free, passage.claimed.free)


def test_the_framed_agent_reports_what_is_hidden_and_others_see_through_it() -> None:
    run, hidden, contradicted, reported = played("Framing"), 0, 0, 0
    tracks = run.decoded("agent/infra_3/tracks", "tracks")
    for passage in passages("Framing"):
        framed = world_states(tracks[passage.frame]).position
        for row in range(len(passage.hidden)):
            place = passage.hidden.select(slice(row, row + 1))
            hidden += 1
            reported += np.linalg.norm(framed[:, :2] - place.position[0, :2], axis=1).min(initial=np.inf) < 2.0
            contradicted += rows_seen(place, passage.claimed)[1][0]
    assert hidden > 100
    assert reported > 0.8 * hidden
    assert contradicted > 0.8 * hidden


def test_a_replay_shows_objects_where_they_were() -> None:
    recorded = {(p.agent, p.frame): p.before for p in passages("Replay")}
    told = 0
    for passage in passages("Replay"):
        before, after = passage.kept
        for id_, place, now in zip(after.id.tolist(), after.position, before.position, strict=True):
            if np.abs(place - now).max() > 1e-9:
                old = recorded[passage.agent, passage.frame - 20]
                assert np.allclose(old.position[old.id == id_][0], place)
                told += 1
    assert told > 50


def test_an_overconfident_agent_moves_all_objects_alike_and_scales_their_covariances() -> None:
    offsets: dict[str, set[tuple[float, ...]]] = {}
    for passage in passages("Overconfidence"):
        before, after = passage.kept
        moved = np.abs(after.position - before.position).max(axis=1, initial=0.0) > 1e-6
        np.testing.assert_allclose(after.covariance[moved], 1e-3 * before.covariance[moved], rtol=1e-6, atol=1e-9)
        np.testing.assert_array_equal(after.velocity, before.velocity)
        offset = np.round((after.position - before.position)[moved], 5) + 0.0
        offsets.setdefault(passage.agent, set()).update(map(tuple, offset.tolist()))
    assert set(offsets) == set(VICTIMS)
    for offset in offsets.values():
        assert len(offset) == 1
        assert np.linalg.norm(next(iter(offset))) == pytest.approx(1.5, abs=1e-4)


def test_colluding_adversaries_insert_the_same_object_and_hide_the_same_ones() -> None:
    by_frame: dict[int, list[Passage]] = {}
    for passage in passages("Collusion"):
        by_frame.setdefault(passage.frame, []).append(passage)
    both = same = 0
    for one, other in by_frame.values():
        for name in ("inserted", "hidden"):
            places = getattr(one, name).position, getattr(other, name).position
            if len(places[0]) and len(places[1]):
                distance = np.linalg.norm(places[0][:, None, :2] - places[1][None, :, :2], axis=2)
                both += 1
                same += distance.min() < 3.0
    assert both > 20
    assert same > 0.9 * both


@pytest.mark.parametrize("attack", ["Mimic", "PairedDenial"])
def test_attackers_that_hear_picture_and_trust_play_the_whole_run(attack: str) -> None:
    run = played(attack, "trust")
    assert not run.failures
    adversary = run.nodes["adversary_1"]
    assert all(victim.heard.keys() == {"picture", "trust"} for victim in adversary.victims.values())
