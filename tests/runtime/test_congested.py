"""Real bytes, generation rules, a channel and congestion control in one run that can be repeated."""

from functools import cache

import pytest
from tiny_world import Run, tiny

from mast_zenoh import scenario
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.messages.packed import codec_of
from mast_zenoh.v2x import cpm


@cache
def played(*settings: str) -> Run:
    run = Run(tiny("congested", "n_mobile=0", "background=0", *settings, infrastructure=4, frames=25))
    assert not run.failures
    assert not run.rejected
    return run


def test_broadcasts_are_collective_perception_messages_relative_to_their_sender() -> None:
    run = played()
    for message in run.decoded("agent/ego/broadcast", "tracks"):
        assert codec_of(message.body) == "cpm"
        frame = message.header.frame
        assert message.body["origin"][0] == pytest.approx(-10.0 + 0.8 * frame, abs=0.02)
    assert not [m for m in run.decoded("agent/ego/tracks", "tracks") if codec_of(m.body)], "inside the car they are not"


def test_the_rules_send_less_than_everything_in_every_frame() -> None:
    by_rule, everything = played(), played("rules=EveryFrame", "congestion=NoCongestionControl")
    of_rule, of_all = (run.results["channel"]["channel"] for run in (by_rule, everything))
    assert of_all["frames"] == 5 * 25, "also those of the last frame"
    assert of_all["arrived"] + of_all["lost"] == 4 * (5 * 25 - 5), "of which nobody is told what arrived"
    assert of_rule["bytes"] < 0.7 * of_all["bytes"]
    assert of_rule["busy_ratio_mean"] < of_all["busy_ratio_mean"]
    rule, all_ = (run.results["evaluator"]["metrics"]["channel"] for run in (by_rule, everything))
    assert all_["stations"] == 5
    assert all_["sent"] == 1.0
    assert rule["airtime_share"] < all_["airtime_share"]
    assert 0.9 < all_["arrived"] <= 1.0
    assert all_["busy_ratio"]["mean"] == pytest.approx(5 * all_["airtime_share"], rel=0.01), "all hear each other"


def test_a_peer_uses_what_arrived_and_counts_what_was_lost() -> None:
    def far(content: dict) -> None:
        content["channel"]["radio"]["power_dbm"] = -30.0

    run = Run(tiny("congested", "n_mobile=0", "background=0", infrastructure=4, frames=25, edit=far))
    radio = run.results["peer_ego"]["radio"]
    lost = sum(count for name, count in radio.items() if name.startswith("lost/"))
    arrived = sum(count for name, count in radio.items() if name.startswith("heard/"))
    assert lost > arrived
    alone = run.results["evaluator"]["metrics"]["agents"]["ego"]
    near = played().results["evaluator"]["metrics"]["agents"]["ego"]
    assert alone["picture"]["fn"]["mean"] > near["picture"]["fn"]["mean"], "nobody else sees the ego itself"


def test_a_wire_with_a_codec_refuses_other_bodies() -> None:
    def plain_lies(content: dict) -> None:
        content["nodes"] = {"forger": dict(role="forger", file=__file__.replace("test_congested", "forging_node"))}
        content["keyexpr"]["rewrites"].append(
            {"insert": [dict(wire="agent/infra_1/broadcast", role="forger", input="tracks", output="tracks_out")]}
        )

    run = Run(tiny("congested", "n_mobile=0", infrastructure=2, edit=plain_lies))
    assert not run.failures
    assert {name for name in run.rejected if name.startswith("peer_")} == {"peer_ego", "peer_infra_2"}
    assert {kind for counts in run.rejected.values() for _, kind in counts} == {"codec"}


def test_a_station_that_sends_nothing_loses_nothing() -> None:
    """Views are sent in frames in which the rules leave the tracks out."""
    run = played("defence=FaultOrLie")
    radio = run.results["peer_ego"]["radio"]
    assert radio["broadcasts"] < 25
    assert not [name for name in radio if name.startswith("lost/")]


def test_congestion_control_without_a_channel_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"scenario.*no `channel`"):
        tiny("peers", "n_mobile=0", 'peers.*.congestion={"type": "AdaptiveDcc"}', infrastructure=4, frames=5)


def test_a_message_says_how_many_objects_its_sender_knows_sent_or_not() -> None:
    """TS 103 324 v2.1.1: numberOfPerceivedObjects is the total at the time of generating the message."""
    run, fewer = played(), 0
    for agent in ("ego", "infra_1"):
        known = {
            message.header.frame: len(message.body["id"]) for message in run.decoded(f"agent/{agent}/tracks", "tracks")
        }
        for message in run.decoded(f"agent/{agent}/broadcast", "tracks"):
            parts = list(map(cpm.decode, message.body.segments))
            assert {part.known_objects for part in parts} == {known[message.header.frame]}
            fewer += len(message.body["id"]) < known[message.header.frame]
    assert fewer > 5, "the rules leave objects out"


@pytest.mark.heavy
def test_congested_is_congested_the_channel_is_busy_and_gates_close() -> None:
    run = Run(scenario.resolve(*scenario.load("congested", ["n_infrastructure=1", "n_mobile=2"]), frames=100, seed=0))
    channel = run.results["channel"]["channel"]
    assert channel["background"] == 150
    assert run.results["evaluator"]["metrics"]["channel"]["busy_ratio"]["mean"] > 0.6
    for agent in ("ego", "infra_1", "mobile_1", "mobile_2"):
        radio = run.results[f"peer_{agent}"]["radio"]
        assert radio["gate_closed"] > 0, agent
        assert radio["broadcasts"] + radio["gate_closed"] <= 100, "a closed gate lets nothing through"


def test_without_the_background_no_gate_closes() -> None:
    run = played()
    assert run.results["channel"]["channel"]["background"] == 0
    assert "gate_closed" not in run.results["peer_ego"]["radio"]
