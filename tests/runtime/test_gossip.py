"""Peers that tell each other whom they trust, and slander among them."""

from functools import cache

import numpy as np
import pytest
from tiny_world import Bench, Run, tiny

from mast_zenoh import scenario
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.messages.schemas import text

ALONE = ("n_mobile=0", "attack_start_s=0.2")
AGENTS = ("ego", "infra_1", "infra_2", "infra_3")
SETTINGS = {"plain": ("defence=FaultOrLie",), "gossip": ("gossip=true",), "slander": ("gossip=true", "n_slanderers=1")}


@cache
def played(name: str) -> Run:
    run = Run(tiny("peers", *ALONE, *SETTINGS[name], infrastructure=3))
    assert not run.failures
    assert not run.rejected
    return run


def test_a_peer_tells_its_own_judgement_in_every_frame() -> None:
    for agent in AGENTS:
        told = played("gossip").decoded(f"agent/{agent}/gossip", "gossip")
        own = played("gossip").decoded(f"agent/{agent}/trust", "trust")
        assert len(told) == 12
        for one, other in zip(told, own, strict=True):
            assert one.body["agents"].tolist() == other.body["agents"].tolist()
            assert np.array_equal(one.body["trust"], other.body["mean"])


@pytest.mark.parametrize("name", ["gossip", "slander"])
def test_of_honest_agents_neither_gossip_nor_slander_changes_anything(name: str) -> None:
    run, plain = played(name), played("plain")
    assert {key for key in run.messages if "gossip" not in key and not key.startswith("attack")} == set(plain.messages)
    for key, messages in plain.messages.items():
        assert run.messages[key] == messages, key


def test_gossip_that_a_link_holds_up_does_not_replace_newer_gossip() -> None:
    bench = Bench(tiny("peers", *ALONE, *SETTINGS["gossip"], infrastructure=3), "peer_ego")
    for step, about, trust in ((5, 5, 0.2), (6, 3, 0.9)):
        bench.clock(step)
        told = {"agents": text(["infra_2"]), "trust": np.array([trust])}
        bench.send("heard_gossip", told, about, subject="infra_1", step=step)
        bench.node.open_inbox(step + 1, None, 0)
        assert bench.node.trusts.at(0)["infra_1"][1] == {"infra_2": 0.2}


def test_slander_is_measured_on_the_wire_and_reported() -> None:
    run = played("slander")
    last = run.decoded("agent/infra_1/gossip", "gossip")[-1].body
    assert dict(zip(last["agents"], last["trust"] == 0.0, strict=True))["ego"]
    found = run.results["evaluator"]["metrics"]["interposers"]["slanderer_1"]
    assert found["effects"] == {"slandered": 10}, "from 0.2 s on"
    assert found["agreement"] == "agrees"


def test_an_agent_whose_broadcasts_are_changed_lies() -> None:
    run = Run(tiny("peers", *ALONE, "defence=FaultOrLie", "n_adversaries=1", infrastructure=3))
    agents = run.results["evaluator"]["metrics"]["integrity"]["agents"]
    assert {name for name, each in agents.items() if each["lied"]} == {"infra_1"}


def test_slanderers_without_gossip_are_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"n_slanderers.*0.*gossip=true"):
        tiny("peers", "n_slanderers=1")


LIAR = ("scene=intersection:4", "defence=FaultOrLie", "anchored=false", "n_adversaries=1", "attack_start_s=2.0")


@cache
def lied(*settings: str) -> Run:
    """A run in which infra_1 lies to all others on a generated junction."""
    run = Run(scenario.resolve(*scenario.load("peers", [*LIAR, *settings]), frames=80, seed=0))
    assert not run.failures
    return run


def false_objects(run: Run) -> dict[str, float]:
    """By receiver, objects per frame that the liar inserted."""
    agents = run.results["evaluator"]["metrics"]["agents"]
    return {agent: each["picture"]["fp_split"]["attack"] for agent, each in agents.items() if agent != "infra_1"}


def suspended_frames(run: Run) -> dict[str, dict[str, int]]:
    """By receiver and agent, the frames in which only hearsay suspended the agent."""
    return {
        name.removeprefix("peer_"): result["integrity"]["suspended_by_hearsay"]
        for name, result in run.results.items()
        if name.startswith("peer_")
    }


@pytest.mark.heavy
def test_a_liar_whom_nobody_convicts_alone_deceives_all_without_gossip_and_is_suspended_with_it() -> None:
    """Each receiver sees through the lies, but others' views are too old to count, and its own word is no majority."""
    alone, gossip = lied(), lied("gossip=true")
    without, judged = (run.results["evaluator"]["metrics"]["integrity"]["agents"]["infra_1"] for run in (alone, gossip))
    assert without["suspended_after_s"] is None
    doubted_s = without["undecided"][0]["from_s"] - without["first_lie_s"]
    assert judged["suspended_after_s"] < doubted_s + 0.5, "others' doubt adds little to the time that one's own takes"
    frames = suspended_frames(gossip)
    assert frames.pop("infra_1") == {}, "the liar's own peer hears no lies"
    assert all(each.keys() == {"infra_1"} for each in frames.values()), "nobody else is suspended"
    after = false_objects(gossip)
    assert all(after[agent] < 0.5 * before for agent, before in false_objects(alone).items())


@pytest.mark.heavy
@pytest.mark.parametrize("slanderers", [1, 2])
def test_slanderers_at_most_restore_what_is_without_gossip(slanderers: int) -> None:
    """Of five tellers, one does not matter, and two bring the open dispute back."""
    alone, slander = lied(), lied("gossip=true", f"n_slanderers={slanderers}")
    honest = [agent for agent in false_objects(alone) if agent not in ("mobile_1", "mobile_2")]
    assert {"slanderer_1", "slanderer_2"} & slander.results.keys() == {f"slanderer_{i + 1}" for i in range(slanderers)}
    for agent in honest:
        suspended = suspended_frames(slander)[agent]
        if slanderers == 1:
            assert suspended.keys() == {"infra_1"}
        else:
            assert suspended == {}
            assert slander.messages[f"agent/{agent}/picture"] == alone.messages[f"agent/{agent}/picture"]
