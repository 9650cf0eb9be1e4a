"""The scenario `driving`: who is attacked, on which wires, and what defends."""

from pathlib import Path

import pytest

from mast_zenoh import scenario
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenario import driving


def content_of(*settings: str) -> dict:
    """The scenario with these settings."""
    return scenario.load("driving", settings)[1]


@pytest.mark.parametrize(
    ("wire", "victims"),
    [
        ("picture", ["ego"]),
        ("detections", ["ego"]),
        ("detections picture", ["ego", "ego"]),
        ("tracks", ["infra_1", "infra_2"]),
    ],
)
def test_the_ego_is_the_victim_unless_others_lie_to_the_command_centre(wire: str, victims: list[str]) -> None:
    content = content_of("attack=GhostAhead", f"wire={wire}")
    assert [adversary["agent"] for adversary in content["adversaries"].values()] == victims
    assert content["keyexpr"]["rewrites"][0] == "driving.toml"
    resolved = scenario.resolve(scenario.load("driving")[0], content, seed=0, frames=20)
    interposers = [name for each in resolved.wiring["wires"] for name in each["interposers"]]
    assert sorted(interposers) == sorted(content["adversaries"]), "each is on one wire"


def test_a_defence_judges_what_agents_send_to_the_command_centre_and_hears_their_views() -> None:
    for attack in ([], ["attack=stale_picture"]):
        content = content_of("defence=FaultOrLie", *attack)
        assert content["command_center"]["pipeline"]["integrity"] == {"type": "FaultOrLie"}
        assert content["keyexpr"]["rewrites"][-1] == "views.toml"
    assert "integrity" not in content_of()["command_center"]["pipeline"]


def test_an_attack_has_a_name_and_begins_when_the_scenario_says() -> None:
    (adversary,) = content_of("attack=stale_picture", "attack_start_s=3.0")["adversaries"].values()
    assert adversary["attack"] == {"start_s": 3.0, "type": "Replay", "delay_s": 2.0, "budget": 1000.0}


def test_an_unknown_wire_names_the_nearest() -> None:
    with pytest.raises(ConfigurationError, match=r"wire: found 'pictur'.*picture"):
        content_of("attack=cut_in", "wire=pictur")


@pytest.mark.parametrize(
    ("settings", "wrong"),
    [
        (["cars=0"], r"cars.*0.*1"),
        (["wire=command"], r"wire.*'command'.*nothing"),
        (["n_adversaries=5"], r"n_adversaries.*5.*nothing"),
        (["attack=cut_in", "n_adversaries=5"], r"n_adversaries.*5.*wire=tracks"),
        (["attack=cut_in", 'compromised=["infra_1"]'], r"compromised.*\['infra_1'\].*wire=tracks"),
        (["attack=cut_in", "compromised=infra_1"], r"compromised.*\['infra_1'\].*wire=tracks"),
        (
            ["attack=cut_in", "wire=tracks picture"],
            r"wire.*'tracks'.*tracks",
        ),
        (
            ["attack=cut_in", "wire=tracks", "n_adversaries=1", 'compromised=["infra_1", "infra_2"]'],
            r"n_adversaries.*1.*2",
        ),
    ],
)
def test_a_parameter_without_effect_is_refused(settings: list[str], wrong: str) -> None:
    with pytest.raises(ConfigurationError, match=wrong):
        content_of(*settings)


@pytest.mark.parametrize("named", [["infra_3"], ["infra_3", "infra_4", "infra_1"]], ids=len)
def test_exactly_the_agents_that_are_named_are_compromised(named: list[str]) -> None:
    content = content_of("attack=cut_in", "wire=tracks", f"compromised={named}")
    assert [adversary["agent"] for adversary in content["adversaries"].values()] == named


def test_the_driver_is_told_of_its_veto_only_if_it_has_one() -> None:
    assert content_of("veto=True")["drivers"]["ego"]["veto"] is True
    assert "veto" not in content_of()["drivers"]["ego"]


def test_a_driver_is_judged_by_the_age_of_estimates_that_it_uses() -> None:
    content = content_of()
    content["drivers"]["ego"]["estimate_age_s"] = 1.2
    resolved = scenario.resolve(scenario.load("driving")[0], content, seed=0, frames=20)
    assert resolved.nodes["evaluator"].config["estimate_ages_s"] == {"ego": 1.2}


@pytest.mark.parametrize(
    ("setting", "wrong"),
    [
        ("scene.rate_hz=4.9", r"drivers.*scene.*Hz"),
        ("drivers.ego.estimate_age_s=0.05", r"drivers\.ego\.estimate_age_s.*0\.05.*0\.1"),
    ],
)
def test_a_scene_too_slow_for_drivers_and_a_driver_that_is_always_blind_are_refused(setting: str, wrong: str) -> None:
    with pytest.raises(ConfigurationError, match=wrong):
        scenario.resolve(*scenario.load("driving", [setting]), seed=0, frames=20)


@pytest.mark.parametrize("settings", [["scene.rate_hz=5"], ["drivers.ego.estimate_age_s=0.1"]])
def test_a_frame_of_5_hz_is_short_enough_and_an_estimate_of_the_last_frame_new_enough(settings: list[str]) -> None:
    assert "driver_ego" in scenario.resolve(*scenario.load("driving", settings), seed=0, frames=20).nodes


def limits_of_driver(world: dict, driver: dict) -> object:
    """The limits that a driver's node gets."""
    content = dict(world=world, drivers=dict(ego=driver))
    ((_, config),) = driving.drivers(Path("scenario.py"), content)
    return config.get("limits")


def test_a_driver_knows_what_its_car_can_do_unless_it_believes_less() -> None:
    weak, weaker = dict(braking=5.0), dict(braking=4.0)
    assert limits_of_driver(dict(limits=weak), {}) == weak
    assert limits_of_driver(dict(limits=weak), dict(limits=weaker)) == weaker
    assert limits_of_driver({}, {}) is None


@pytest.mark.parametrize(("world", "driver"), [(dict(limits=dict(braking=5.0)), dict()), ({}, dict(braking=9.5))])
def test_a_driver_that_believes_its_car_can_do_more_than_it_can_is_refused(world: dict, driver: dict) -> None:
    limits = dict(type="CarLimits") | driver
    with pytest.raises(ConfigurationError, match=r"drivers\.ego\.limits\.braking.*9(\.5)?.*[59]"):
        limits_of_driver(world, dict(limits=limits))


def test_commands_are_judged_by_how_long_the_world_holds_them() -> None:
    content = content_of() | {"world": {"hold_s": 0.7, "limits": {"braking": 6.0}}}
    resolved = scenario.resolve(scenario.load("driving")[0], content, seed=0, frames=20)
    config = resolved.nodes["evaluator"].config
    assert (config["hold_s"], config["car_limits"]) == (0.7, {"braking": 6.0})
    assert "take_over_s" not in config
