"""Vehicles that say where they are, by Cooperative Awareness Messages."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tiny_world import PERIOD_NS, Run, TinyScene, tiny

from mast_zenoh.arrays.states import Detections
from mast_zenoh.messages.packed import codec_of
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.v2x import cam

KEY = "agent/ego/awareness"
DEFENCE = "defence=FaultOrLie"
AWARE = ("n_mobile=0", "awareness=true")


class BlindPoles(TinyScene):
    """The tiny world, in which poles detect nothing."""

    def record(self, seed: int, frames: int | None) -> Recording:
        whole = super().record(seed, frames)
        counts = np.diff(whole.detection_start)
        of_ego = np.arange(len(counts)) % len(whole.agents) == 0
        kept = np.repeat(of_ego, counts)
        return replace(
            whole,
            detections=Detections(*(column[kept] for column in whole.detections.columns().values())),
            detection_start=np.cumsum([0, *(counts * of_ego)]),
            detection_truth_id=whole.detection_truth_id[kept],
        )


def blind_poles(content: dict) -> None:
    content["scene"]["type"] = "BlindPoles"


@cache
def played(name: str, *settings: str, blind: bool = False) -> Run:
    run = Run(tiny(name, *settings, infrastructure=2, frames=25, edit=blind_poles if blind else None))
    assert not run.failures
    assert not run.rejected
    return run


def places(run: Run, agent: str) -> np.ndarray:
    """(n, 2) m, positions in an agent's last picture."""
    return run.decoded(f"agent/{agent}/picture", "picture")[-1].body["position"][:, :2]


def test_a_vehicle_says_where_it_is_after_four_metres_or_a_second_and_a_pole_does_not() -> None:
    run = played("peers", *AWARE)
    sent = run.decoded(KEY, "tracks")
    frames = [message.header.frame for message in sent]
    assert frames[0] == 0
    assert set(np.diff(frames)) <= {5, 6}, "0.8 m in each frame"
    for message in sent:
        assert codec_of(message.body) == "cam"
        (data,) = message.body.segments
        said = cam.decode(data)
        assert said.station_type == 5
        assert said.generation_delta_time == message.header.frame * PERIOD_NS // 1_000_000
        assert (said.vehicle.heading, said.vehicle.speed) == (900, 800), "east, 8 m/s"
        assert (said.vehicle.length, said.vehicle.width) == (45, 18), "those of the scene"
        assert not message.body["origin"].any(), "world frame"
        place = [[-10.0 + 0.8 * message.header.frame, 0.0]]
        np.testing.assert_allclose(message.body["position"][:, :2], place, atol=0.05)
    assert not [key for key in run.messages if key.startswith("agent/infra") and key.endswith("awareness")]


def test_what_a_vehicle_says_of_itself_is_an_object_for_all_others_from_the_next_frame_on() -> None:
    aware, plain = (played("peers", *settings, blind=True) for settings in (AWARE, AWARE[:1]))
    expected = np.array([-10.0 + 0.8 * 24, 0.0])
    errors = [np.linalg.norm(places(run, "infra_1") - expected, axis=1).min() for run in (aware, plain)]
    assert errors[0] < 0.5
    assert errors[1] > 3.0, "nobody else sees it"
    assert len(places(aware, "infra_1")) == len(places(plain, "infra_1")) + 1
    assert aware.messages["agent/ego/picture"] == plain.messages["agent/ego/picture"], "it does not hear itself"
    supported = [message.body["support"] for message in aware.decoded("agent/infra_1/picture", "picture")]
    assert not len(supported[0])
    assert aware.results["peer_infra_1"]["radio"]["aware/ego"] == 5


def test_a_lie_about_itself_reaches_all_others_and_is_attributed() -> None:
    lies = ("n_adversaries=1", "on=awareness", "listener=infra_1", "attack_start_s=0.2")
    honest, attacked = played("peers", *AWARE, blind=True), played("peers", *AWARE, *lies, blind=True)
    assert attacked.messages[f"{KEY}/@tap/0"] == honest.messages[KEY]
    changed = [
        np.linalg.norm(after.body["position"] - before.body["position"])
        for before, after in zip(honest.decoded(KEY, "tracks"), attacked.decoded(KEY, "tracks"), strict=True)
    ]
    assert changed[0] == 0.0
    assert max(changed) > 1.0
    for agent, differs in (("ego", False), ("infra_1", True), ("infra_2", True)):
        picture = f"agent/{agent}/picture"
        assert (attacked.messages[picture] != honest.messages[picture]) == differs
    deceived = attacked.results["evaluator"]["metrics"]["pictures"]["deceived"]
    assert {agent for agent, share in deceived["agents"].items() if share > 0} == {"infra_1", "infra_2"}


@pytest.mark.heavy
@pytest.mark.parametrize("name", ["peers", "congested"])
def test_a_lie_about_itself_is_a_moved_object_that_its_agent_lies_about(name: str) -> None:
    run = played(name, *AWARE, "n_adversaries=1", "on=awareness", "listener=infra_1", "attack_start_s=0.2", DEFENCE)
    metrics = run.results["evaluator"]["metrics"]
    measured = metrics["interposers"]["adversary_1"]
    assert measured["effects"] == {"moved": 4}
    assert measured["agreement"] == "agrees"
    assert {agent for agent, each in metrics["integrity"]["agents"].items() if each["lied"]} == {"ego"}


def test_a_message_that_the_adversary_empties_is_not_sent() -> None:
    def silence(content: dict) -> None:
        for adversary in content["adversaries"].values():
            adversary["attack"]["selection"] |= dict(fraction_translations=0.0, fraction_false_negatives=1.0)

    lies = ("n_adversaries=1", "on=awareness", "listener=infra_1", "attack_start_s=1.5")
    run = Run(tiny("congested", *AWARE, *lies, infrastructure=2, frames=25, edit=silence))
    assert not run.failures
    assert not run.rejected
    sent = [len(message.body.segments) for message in run.decoded(KEY, "tracks")]
    assert sent[0] == 1
    assert 0 in sent
    assert run.results["peer_infra_1"]["radio"]["aware/ego"] < len(sent) - 1


def test_they_count_on_the_channel_and_are_lost_by_themselves() -> None:
    aware, plain = (played("congested", *settings) for settings in (AWARE, AWARE[:1]))
    with_, without = (run.results["channel"]["channel"] for run in (aware, plain))
    sent = len(aware.decoded(KEY, "tracks"))
    assert sent > 2
    assert with_["frames"] > without["frames"]
    assert with_["bytes"] > without["bytes"]
    both = 0
    for message in aware.decoded("agent/ego/reception", "reception"):
        both += int(message.body["sent"][0] == 2)
        assert (message.body["airtime_ns"][0] > 0) == (message.body["sent"][0] > 0)
    assert both, "in some frames it sends both"

    def far(content: dict) -> None:
        content["channel"]["radio"]["power_dbm"] = 1.0

    run = Run(tiny("congested", *AWARE, infrastructure=4, frames=25, edit=far))
    lost = run.results["channel"]["channel"]["lost"]
    assert lost > 0
    lost_by_kind = [
        (set(message.body["lost"].tolist()), set(message.body["lost_awareness"].tolist()))
        for name in ("infra_1", "infra_2", "infra_3", "infra_4")
        for message in run.decoded(f"agent/{name}/reception", "reception")
    ]
    assert any("ego" in awareness - tracks for tracks, awareness in lost_by_kind)
    assert any("ego" in tracks - awareness for tracks, awareness in lost_by_kind)


def test_objects_that_say_themselves_where_they_are_are_left_out_if_the_rules_say_so() -> None:
    rule = 'peers.*.rules.redundancy=[{"type": "SelfAnnouncementRedundancy"}]'
    plain, sparing = (played("congested", *AWARE, *settings) for settings in ((), (rule,)))
    of_ego = [
        sum(
            int((np.linalg.norm(message.body["position"] + message.body["origin"] - [x, 0.0, 0.8], axis=1) < 2.0).any())
            for message in run.decoded("agent/infra_1/broadcast", "tracks")
            if (x := -10.0 + 0.8 * message.header.frame) is not None
        )
        for run in (plain, sparing)
    ]
    assert of_ego[1] < of_ego[0] / 2
