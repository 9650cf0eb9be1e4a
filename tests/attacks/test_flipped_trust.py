"""TrustFlip and others in whole runs: the defence does not turn on honest agents, and the ego can be attacked."""

from pathlib import Path
from typing import Any

import pytest

from mast_zenoh import scenario
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.scenario import victims_of

FRAMES = 90


def played(**values: Any) -> dict[str, Any]:
    """Metrics of the scenario `defended` on the generated junction."""
    values = dict(attack_start_s=3.0, n_adversaries=1) | values
    path, content = scenario.load_values("defended", values)
    results: dict[str, Any] = InProcess(scenario.resolve(path, content, frames=FRAMES)).run()["evaluator"]["metrics"]
    return results


def suspended(metrics: dict[str, Any]) -> set[str]:
    return {name for name, agent in metrics["integrity"]["agents"].items() if agent["suspensions"]}


def picture(metrics: dict[str, Any]) -> tuple[float, float]:
    estimate = metrics["agents"]["ego"]["picture"]
    return estimate["fn"]["mean"], estimate["fp"]["mean"]


LATE = """
from mast_zenoh.attacks import AdaptiveAttack, Lies
from mast_zenoh.attacks.coordination import Collusion


class Late(AdaptiveAttack):
    def __init__(self, *, start_s: float = 6.5):
        super().__init__(start_s=start_s)

    def lie(self, moment):
        return Lies()


class PassedOn(Late):
    def __init__(self, *, share: float = 0.5, **others):
        super().__init__(**others)


class LatePlan(Collusion):
    def __init__(self, *, start_s: float = 6.5):
        super().__init__(start_s=start_s)
"""
FLIP = dict(attack="TrustFlip", compromised=["infra_3"])


@pytest.mark.heavy
@pytest.mark.parametrize("defence", ["SequentialConsistency", "FaultOrLie"])
def test_the_defence_suspends_nobody_under_trust_flip_and_loses_no_object(defence: str) -> None:
    before, after = played(defence=defence, n_adversaries=0), played(defence=defence, **FLIP)
    assert suspended(before) == suspended(after) == set()
    assert picture(after)[0] == pytest.approx(picture(before)[0], abs=0.05)


@pytest.mark.heavy
def test_without_a_defence_trust_flip_does_next_to_nothing_to_the_picture() -> None:
    before, after = picture(played(n_adversaries=0)), picture(played(**FLIP))
    assert after == pytest.approx(before, abs=0.05)


@pytest.mark.heavy
@pytest.mark.parametrize(
    "attack",
    [
        dict(type="OpenDispute"),
        dict(type="PairedDenial"),
        dict(type="TrustFlip"),
        dict(type="PosePert"),
        dict(type="BlindAreaConfusion"),
        dict(type="PretendBenign", memory_s=1.0, duty=0.5),
        dict(type="Flood"),
    ],
    ids=lambda attack: attack["type"],
)
def test_the_ego_itself_can_be_the_attacked_agent(attack: dict[str, Any]) -> None:
    metrics = played(attack=attack, compromised=["ego"], n_adversaries=2 if attack["type"] == "PairedDenial" else 1)
    effects = metrics["interposers"]["adversary_1"]
    assert effects["agreement"] == "agrees"
    assert sum(effects["effects"].values()) > 20


def test_the_ego_is_compromised_only_if_it_is_named() -> None:
    _, content = scenario.load_values("defended", dict(compromised=["ego", "infra_3"], attack="PosePert"))
    assert [each["agent"] for each in content["adversaries"].values()] == ["ego", "infra_3"]
    _, content = scenario.load_values("defended", dict(attack="PosePert"))
    assert [each["agent"] for each in content["adversaries"].values()] == ["infra_1", "infra_2"]
    assert victims_of("intersection", 4) == ("infra_1", "infra_2", "infra_3", "infra_4")
    with pytest.raises(ConfigurationError, match=r"compromised.*agent 'egos'"):
        victims_of("intersection", 1, ["egos"])


@pytest.mark.parametrize("name", ["uncoordinated", "coordinated", "defended"])
def test_the_number_of_adversaries_counts_the_ego_if_it_is_compromised(name: str) -> None:
    _, content = scenario.load(name, n_adversaries=5, compromised="ego")
    agents = [adversary["agent"] for adversary in content["adversaries"].values()]
    assert agents == ["ego", "infra_1", "infra_2", "infra_3", "infra_4"]
    with pytest.raises(ConfigurationError, match=r"n_adversaries.*5.*infra_1"):
        scenario.load(name, n_adversaries=6, compromised="ego")


@pytest.mark.parametrize(
    ("name", "attack"), [("defended", "Late"), ("defended", "PassedOn"), ("defence_cell", "Late"), ("driving", "Late")]
)
def test_an_attack_begins_at_its_own_time_unless_the_user_sets_another(tmp_path: Path, name: str, attack: str) -> None:
    file = tmp_path / "late.py"
    file.write_text(LATE)
    for setting, expected in (({}, 6.5), ({"attack_start_s": 3.0}, 3.0)):
        path, content = scenario.load(name, attack=f"{file}:{attack}", **setting)
        bands = scenario.resolve(path, content, frames=80).timeline
        assert {band["at_s"] for band in bands if band["kind"] == "attack"} == {expected}


def test_directed_adversaries_begin_with_their_coordination(tmp_path: Path) -> None:
    file = tmp_path / "late.py"
    file.write_text(LATE)
    for attack, expected in ((f"{file}:LatePlan", 6.5), (dict(type="Collusion", start_s=2.0), 2.0)):
        _, content = scenario.load("defended", attack=attack)
        starts = [adversary["attack"]["start_s"] for adversary in content["adversaries"].values()]
        assert {*starts, content["coordinator"]["coordination"]["start_s"]} == {expected}


def test_trust_flip_is_between_sensors_and_agents_unless_other_wires_are_named() -> None:
    def rewrites(**values: Any) -> list[str]:
        return scenario.load_values("defended", FLIP | values)[1]["keyexpr"]["rewrites"]

    assert rewrites()[:2] == ["on_detections.toml", "on_view.toml"]
    assert rewrites(wires="tracks view")[:2] == ["on_tracks.toml", "on_view.toml"]
