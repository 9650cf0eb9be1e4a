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
        (lambda s: s.update(channel={}), r"channel.*wire.*channel\.toml"),
        (with_map("channel.toml"), r"rewrites.*channel\.toml.*channel=dict\(\)"),
        (with_option(awareness=dict(type="CamGeneration")), r"peers\.ego\.awareness.*map.*awareness\.toml"),
        (with_map("awareness.toml"), r"rewrites.*awareness\.toml.*`awareness`"),
        (with_map("cpm_broadcasts.toml"), r"tracks_from: found 'world' .*broadcast'"),
        (with_map("cpm.toml"), r"tracks_from: found 'world' .*'agent/ego/tracks'"),
        (with_option(rules=RULES), r"peers\.ego\.memory_s.*CpmGeneration.*most_s"),
        (with_option(rules=RULES, memory_s=1.2, max_age_s=0.5), r"peers\.ego\.max_age_s.*0\.5.*rules"),
        (with_option(rules=RULES | dict(most_s=1000.0)), r"most_s.*1000\.0.*most"),
        (with_option(memory_s=1050.0), r"memory_s.*1050\.0.*s"),
        (with_option(max_age_s=0.05), r"peers\.ego\.max_age_s.*0\.05.*least"),
    ],
)
def test_half_of_a_configuration_is_refused(edit: Edit, problem: str) -> None:
    with pytest.raises(ConfigurationError, match=problem):
        resolved(edit)


def test_a_cam_is_refused_on_a_wire_with_many_objects() -> None:
    with pytest.raises(WiringError, match=r"'agent/ego/tracks'.*`itself.*true`"):
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
    (gap,) = resolved(move_border, "two_centres").idle
    assert (gap.who, gap.what, gap.unit) == (("centers",), "uncovered", "%")
    assert gap.where.startswith("x -")


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        (("gossip=true", "n_slanderers=9"), r"n_slanderers.*mobile_1, infra_1"),
        (("awareness=true", "on=awareness", "n_adversaries=2"), r"n_adversaries.*1: mobile_1"),
        (("on=awareness", "n_adversaries=1"), r"on.*'awareness'.*awareness=true"),
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
    with pytest.raises(ConfigurationError, match=r"peers\.infra_7\.max_age_s.*agent 'infra_7'"):
        scenario.load("peers", [*SMALL, "peers.infra_7.max_age_s=0.5"])
