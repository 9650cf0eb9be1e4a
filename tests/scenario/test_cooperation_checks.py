"""Options of peers and centres without what they need are refused, with their place and the valid choice."""

from collections.abc import Callable
from typing import Any

import pytest

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError, WiringError

SMALL = ("n_infrastructure=1", "n_mobile=1")
Edit = Callable[[dict[str, Any]], Any]


def resolved(edit: Edit, name: str = "peers", *settings: str) -> Resolved:
    """A shipped scenario with a change."""
    path, content = scenario.load(name, [*SMALL, *settings])
    edit(content)
    return scenario.resolve(path, content, frames=2)


def with_map(content: Any) -> Edit:
    """Adds a rewrite."""
    return lambda scenario_: scenario_["keyexpr"]["rewrites"].append(content)


def with_option(**options: Any) -> Edit:
    """Sets options of all peers."""
    return lambda scenario_: scenario_["peers"]["*"].update(options)


CAM = {"codec": [dict(wire="agent/{agent}/tracks", codec="cam")]}
RULES = dict(type="CpmGeneration")


@pytest.mark.parametrize(
    ("edit", "problem"),
    [
        (lambda s: s.update(channel={}), r"channel: no map has a wire from it.*: add channel\.toml"),
        (with_map("channel.toml"), r"rewrites: found channel\.toml, but .* no `channel`: add channel=dict\(\)"),
        (with_option(awareness=dict(type="CamGeneration")), r"peers\.ego\.awareness: no map .*: add awareness\.toml"),
        (with_map("awareness.toml"), r"rewrites: found awareness\.toml, but no peer has `awareness`: add awareness="),
        (with_map("cpm_broadcasts.toml"), r"agents\.ego\.tracks_from: found 'world' .*broadcast', expected 'agent'"),
        (with_map("cpm.toml"), r"agents\.ego\.tracks_from: found 'world' .*'agent/ego/tracks', expected 'agent'"),
        (with_option(rules=RULES), r"peers\.ego\.memory_s: found 0\.0 with the rules CpmGeneration.* most_s = 1 s"),
        (with_option(rules=RULES, memory_s=1.2, max_age_s=0.5), r"peers\.ego\.max_age_s: found 0\.5 with the rules"),
        (with_option(rules=RULES | dict(most_s=1000.0)), r"most_s: found 1000\.0, expected more than 0 and at most 60"),
        (with_option(memory_s=1050.0), r"memory_s: found 1050\.0, expected 0 to 60 s"),
        (with_option(max_age_s=0.05), r"peers\.ego\.max_age_s: found 0\.05, expected at least 0\.1 s"),
    ],
)
def test_half_of_a_configuration_is_refused(edit: Edit, problem: str) -> None:
    with pytest.raises(ConfigurationError, match=problem):
        resolved(edit)


def test_a_cam_is_refused_on_a_wire_with_many_objects() -> None:
    with pytest.raises(WiringError, match=r"found cam on 'agent/ego/tracks', expected `itself = true`.* or cpm"):
        resolved(with_map(CAM))


@pytest.mark.parametrize("settings", [("codec=cpm",), ("rules=CpmGeneration", "awareness=true")])
def test_whole_configurations_are_accepted(settings: tuple[str, ...]) -> None:
    assert not resolved(lambda _: None, "peers", *settings).idle
    assert not resolved(lambda _: None, "congested", *settings).idle


def test_messages_with_all_objects_need_no_memory() -> None:
    assert resolved(with_option(rules=RULES | dict(send_all=True))).nodes["peer_ego"].config["rules"]["send_all"]


def test_a_gap_between_regions_is_named_and_a_border_is_none() -> None:
    def move_border(content: dict[str, Any]) -> None:
        content["centers"]["west"]["region"]["x_max_m"] = -40.0

    assert not resolved(lambda _: None, "two_centres").idle
    (sentence,) = resolved(move_border, "two_centres").idle
    assert sentence.startswith("centers: ")
    assert "of the true objects are in no region, the first at x -" in sentence


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        (("gossip=true", "n_slanderers=9"), "n_slanderers: found 9, expected 0 to 2: mobile_1, infra_1"),
        (("awareness=true", "on=awareness", "n_adversaries=2"), "n_adversaries: found 2, expected 0 to 1: mobile_1"),
        (("on=awareness", "n_adversaries=1"), "on: found 'awareness', expected awareness=true with it"),
    ],
)
def test_more_liars_than_there_are_and_lies_on_no_wire_are_refused(settings: tuple[str, ...], problem: str) -> None:
    with pytest.raises(ConfigurationError, match=problem):
        scenario.load("peers", [*SMALL, *settings])


@pytest.mark.parametrize("pattern", ["*", "[em]*"])
def test_a_setting_of_a_pattern_reaches_peers_that_a_scenario_names(pattern: str) -> None:
    _, content = scenario.load("peers", [*SMALL, "defence=FaultOrLie", f"peers.{pattern}.max_age_s=0.5"])
    ages = {name: peer.get("max_age_s") for name, peer in content["peers"].items()}
    assert ages == {"ego": 0.5, "mobile_1": 0.5, "infra_1": 0.5 if pattern == "*" else None}


def test_a_setting_of_one_peer_leaves_the_others_as_they_are() -> None:
    _, content = scenario.load("peers", [*SMALL, "peers.mobile_1.max_age_s=0.5"])
    assert content["peers"] == {"*": content["peers"]["*"], "mobile_1": content["peers"]["*"] | dict(max_age_s=0.5)}
    with pytest.raises(ConfigurationError, match=r"peers\.infra_7\.max_age_s: no agent 'infra_7' in this scene"):
        scenario.load("peers", [*SMALL, "peers.infra_7.max_age_s=0.5"])
