"""Agents that fuse on board what they see and what they hear, without a centre."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from tiny_world import Run, tiny

from mast_zenoh import scenario
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.study import definition

ALONE = ("n_mobile=0",)
LIES = (*ALONE, "n_adversaries=1", "attack_start_s=0.2")
AGENTS = ("ego", "infra_1", "infra_2")


@cache
def played(*settings: str) -> Run:
    run = Run(tiny("peers", *settings, infrastructure=2))
    assert not run.failures
    assert not run.rejected
    return run


def pictures(run: Run, agent: str) -> list[ObjectStates]:
    return [ObjectStates.from_columns(message.body) for message in run.decoded(f"agent/{agent}/picture", "picture")]


def test_every_agent_has_a_picture_of_its_own_in_every_frame_and_there_is_no_centre() -> None:
    run = played(*ALONE)
    for agent in AGENTS:
        assert [message.header.frame for message in run.decoded(f"agent/{agent}/picture", "picture")] == list(range(12))
    assert not [key for key in run.messages if key.startswith("cc/")]


def test_a_picture_has_more_than_what_its_agent_sees_alone() -> None:
    run = played(*ALONE)
    own = run.decoded("agent/ego/tracks", "tracks")[-1].body["id"]
    last = pictures(run, "ego")[-1]
    assert len(last) == 4, "the ego too, which the poles report"
    assert len(own) == 3


def test_what_is_heard_in_a_frame_is_used_from_the_next_one_on() -> None:
    run = played(*ALONE)
    first = next(
        k for k, message in enumerate(run.decoded("agent/infra_1/broadcast", "tracks")) if len(message.body["id"])
    )
    support = [message.body["support"] for message in run.decoded("agent/ego/picture", "picture")]
    assert max((values.max(initial=0) for values in support[: first + 1]), default=0) <= 1
    assert support[first + 1].max() > 1


def test_an_agent_broadcasts_its_own_tracks_alone() -> None:
    run = played(*ALONE)
    for sent, heard in zip(
        run.decoded("agent/ego/tracks", "tracks"), run.decoded("agent/ego/broadcast", "tracks"), strict=True
    ):
        assert sent.header.frame == heard.header.frame
        assert all(np.array_equal(sent.body[name], heard.body[name]) for name in sent.body)


@pytest.mark.parametrize(("on", "deceived"), [("sent", {"ego", "infra_2"}), ("pair", {"ego"}), ("heard", {"ego"})])
def test_a_lie_reaches_those_on_whose_wire_it_is_and_nobody_else(on: str, deceived: set[str]) -> None:
    honest, attacked = played(*ALONE), played(*LIES, f"on={on}")
    changed = {
        agent
        for agent in AGENTS
        if attacked.messages[f"agent/{agent}/picture"] != honest.messages[f"agent/{agent}/picture"]
    }
    assert changed == deceived
    assert attacked.messages["agent/infra_1/tracks"] == honest.messages["agent/infra_1/tracks"]
    metrics = attacked.results["evaluator"]["metrics"]["agents"]
    lied = {agent for agent in AGENTS if metrics[agent]["picture"]["fp_split"]["attack"] > 0}
    assert lied == deceived, "the cause is attributed to those that it reached"
    spread = attacked.results["evaluator"]["metrics"]["pictures"]["deceived"]
    assert {agent for agent, share in spread["agents"].items() if share > 0} == deceived
    assert spread["most"] == pytest.approx(len(deceived) / len(AGENTS))
    assert spread["first_s"] > 0.25, "a message of 0.2 s is used one frame later"
    assert (spread["half_after_s"] is not None) == (len(deceived) > 1)
    since_s = {agent: since for agent, since in spread["since_s"].items() if since is not None}
    assert since_s.keys() == deceived
    assert min(since_s.values()) == spread["first_s"]


def test_a_lie_to_one_peer_reaches_others_later_through_what_that_one_relays() -> None:
    path, content = scenario.load("peers", [*LIES[1:], "on=pair", "relays=true", "scene=intersection:8"])
    run = Run(scenario.resolve(path, content, frames=20, seed=0))
    assert not run.failures
    since_s = run.results["evaluator"]["metrics"]["pictures"]["deceived"]["since_s"]
    assert since_s.pop("infra_1") is None, "it leaves out what has its own tracks in it"
    first_s = since_s.pop("ego")
    assert {round(since - first_s, 6) for since in since_s.values()} == {0.2}, "a frame to relay it, and one to begin"


@pytest.mark.parametrize(("on", "view"), [("pair", "broadcast_view"), ("sent", "view")])
def test_an_adversary_on_tracks_and_views_that_does_not_attack_yet_changes_no_message(on: str, view: str) -> None:
    def edit(content: dict[str, Any]) -> None:
        content["keyexpr"]["rewrites"].append(f"on_{view}.toml")

    settings = (*ALONE, "defence=FaultOrLie")
    waiting = ("n_adversaries=1", "attack_start_s=100.0", f"on={on}")
    honest, silent = played(*settings), Run(tiny("peers", *settings, *waiting, infrastructure=2, edit=edit))
    assert not silent.failures
    for key, messages in honest.messages.items():
        assert silent.messages[key] == messages, key


def test_the_peers_of_all_others_hear_the_view_of_an_agent_as_its_own_peer_forwards_it() -> None:
    run = played(*ALONE, "defence=FaultOrLie")
    views, forwarded = (run.decoded(f"agent/infra_1/{wire}", "view") for wire in ("view", "broadcast_view"))
    for view, other in zip(views, forwarded, strict=True):
        assert view.header._replace(source="") == other.header._replace(source="")
        assert view.body.keys() == other.body.keys()
        assert all(np.array_equal(view.body[name], other.body[name]) for name in view.body)


def test_without_a_lie_pictures_differ_little_and_nobody_is_deceived() -> None:
    part = played(*ALONE).results["evaluator"]["metrics"]["pictures"]
    assert part["count"] == 3
    assert part["deceived"]["most"] == 0.0
    assert part["deceived"]["first_s"] is None
    assert 0.0 < part["difference_gospa_m"]["mean"] < 5.0
    assert "pictures" not in Run(tiny("baseline", infrastructure=2)).results["evaluator"]["metrics"]


def test_an_agent_whose_peer_a_pattern_leaves_out_has_no_picture_and_is_not_heard() -> None:
    def edit(content: dict) -> None:
        content["peers"] = {"ego": content["peers"]["*"], "infra_1": content["peers"]["*"]}

    run = Run(tiny("peers", *ALONE, infrastructure=2, edit=edit))
    assert "agent/infra_2/picture" not in run.messages
    assert run.results["peer_ego"]["radio"] == {"absurd": 0, "broadcasts": 12, "heard/infra_1": 11}


def test_a_peer_that_relays_says_from_whom_each_object_comes_and_leaves_out_what_returns() -> None:
    run = played(*ALONE, "relays=true")
    origins: dict[str, set[tuple[str, ...]]] = {}
    for agent in AGENTS:
        *_, last = run.decoded(f"agent/{agent}/relay", "relayed")
        rows = last.body["origin"] > 0
        origins[agent] = {tuple(last.body["agents"][row]) for row in rows}
    assert ("infra_1", "infra_2") in origins["ego"], "the ego does not detect itself"
    plain = played(*ALONE, "peers.*.pipeline.group_tracking.fusion.independent_share=0.0")
    assert run.messages["agent/ego/broadcast"] == plain.messages["agent/ego/broadcast"]
    for agent in AGENTS[1:]:
        assert run.messages[f"agent/{agent}/picture"] == plain.messages[f"agent/{agent}/picture"], "they see all"


def confidence(place: str, fusion: str) -> dict[str, Any]:
    """How confident the pictures of the agents are in their positions, with a fusion of studies/fusion.py.

    On a generated junction, as in the tiny world every agent sees everything and takes no object from others' pictures.
    """
    (configuration,) = definition.load("fusion", [f"place={place}", f"fusions={fusion}"]).configurations
    run = Run(scenario.resolve(*scenario.load(configuration.scenario, configuration.settings), frames=34, seed=3000))
    assert not run.failures
    return run.results["evaluator"]["metrics"]["pictures"]["consistency"]["position"]


@pytest.mark.heavy
@pytest.mark.parametrize(("place", "fusion"), [("rumours", "ci"), ("rumours", "ci_optimised"), ("peers", "naive")])
def test_no_picture_is_too_certain_with_covariance_intersection_or_without_rumours(place: str, fusion: str) -> None:
    """A fusion that allows for any correlation may be below the lower bound, but not above the upper one."""
    found = confidence(place, fusion)
    assert len(found["agents"]) == 7
    assert found["above"] == []


@pytest.mark.heavy
def test_rumours_make_every_picture_of_the_naive_fusion_too_certain() -> None:
    found = confidence("rumours", "naive")
    assert found["above"] == list(found["agents"])
    assert len(found["above"]) == 7
    assert found["nees"] > 5.0 * max(each["high"] for each in found["agents"].values())


def test_a_pattern_for_no_agent_is_refused() -> None:
    def edit(content: dict) -> None:
        content["peers"]["infra_9"] = content["peers"]["*"]

    with pytest.raises(ConfigurationError, match=r"peers.*agent 'infra_9'"):
        tiny("peers", *ALONE, infrastructure=2, edit=edit)
