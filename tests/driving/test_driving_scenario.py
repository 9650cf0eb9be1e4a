"""The scenario `driving`: who is attacked, on which wires, and what defends."""

import pytest

from mast_zenoh import scenario
from mast_zenoh.errors import ConfigurationError


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


def test_agents_to_compromise_are_named_in_order() -> None:
    content = content_of("attack=GhostAhead", "wire=tracks", 'compromised=["infra_4"]')
    assert [adversary["agent"] for adversary in content["adversaries"].values()] == ["infra_4", "infra_1"]


def test_a_defence_judges_what_agents_send_to_the_command_centre_and_hears_their_views() -> None:
    for attack in ([], ["attack=stale_picture"]):
        content = content_of("defence=FaultOrLie", *attack)
        assert content["command_center"]["pipeline"]["integrity"] == {"type": "FaultOrLie"}
        assert content["keyexpr"]["rewrites"][-1] == "views.toml"
    assert "integrity" not in content_of()["command_center"]["pipeline"]


def test_an_attack_has_a_name_and_begins_when_the_scenario_says() -> None:
    (adversary,) = content_of("attack=stale_picture", "attack_start_s=3.0")["adversaries"].values()
    assert adversary["attack"] == {"start_s": 3.0, "type": "Replay", "delay_s": 2.0, "budget": 1000.0}


def test_the_crowd_of_the_junction_can_be_chosen() -> None:
    assert content_of("n_vehicles=30", "n_pedestrians=9")["scene"]["n_pedestrians"] == 9


def test_an_unknown_wire_names_the_nearest() -> None:
    with pytest.raises(ConfigurationError, match=r"wire: found 'pictur'.*picture"):
        content_of("attack=cut_in", "wire=pictur")


def test_an_unknown_attack_names_the_nearest() -> None:
    with pytest.raises(ConfigurationError, match="GhostAhead"):
        scenario.resolve(*scenario.load("driving", ["attack=GhostAhed"]), seed=0)


def test_the_driver_is_told_of_its_veto_only_if_it_has_one() -> None:
    assert content_of("veto=True")["drivers"]["ego"]["veto"] is True
    assert "veto" not in content_of()["drivers"]["ego"]


def test_a_driver_is_judged_by_the_age_of_estimates_that_it_uses() -> None:
    content = content_of()
    content["drivers"]["ego"]["estimate_age_s"] = 1.2
    resolved = scenario.resolve(scenario.load("driving")[0], content, seed=0, frames=20)
    assert resolved.nodes["evaluator"].config["estimate_ages_s"] == {"ego": 1.2}


def test_commands_are_judged_by_how_long_the_world_holds_them() -> None:
    content = content_of() | {"world": {"hold_s": 0.7}}
    resolved = scenario.resolve(scenario.load("driving")[0], content, seed=0, frames=20)
    assert resolved.nodes["evaluator"].config["hold_s"] == 0.7
    assert "take_over_s" not in resolved.nodes["evaluator"].config
