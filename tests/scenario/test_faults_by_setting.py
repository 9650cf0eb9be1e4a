"""Faults are added to any scenario by a setting, and refused with the nearest valid choice."""

import pytest

from mast_zenoh import scenario
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenario import load, load_values

CUT_OFF = {"type": "Partition", "at": 0.2, "until": None, "nodes": ["infra_1"]}


@pytest.mark.parametrize(
    "text",
    [
        '[{"type": "Partition", "at": 0.2, "until": null, "nodes": ["infra_1"]}]',
        str([CUT_OFF]),
    ],
    ids=["JSON", "Python"],
)
def test_a_setting_gives_a_scenario_without_faults_a_list_of_them(text: str) -> None:
    path, content = load("baseline", [f"faults={text}"])
    assert content["faults"] == [CUT_OFF]
    assert [band["label"] for band in scenario.resolve(path, content, frames=5).timeline] == ["Partition infra_1"]


def test_a_list_of_faults_is_a_parameter_in_python_too() -> None:
    assert load_values("baseline", {"faults": [CUT_OFF]})[1]["faults"] == [CUT_OFF]
    assert load_values({"name": "mine"}, {"faults": [CUT_OFF]})[1]["faults"] == [CUT_OFF]


def test_the_number_after_the_last_fault_adds_one() -> None:
    for name, count in (("baseline", 0), ("attack_during_partition", 2)):
        _, content = load(name, [f"faults.{count}={CUT_OFF}"])
        assert len(content["faults"]) == count + 1
        assert content["faults"][-1] == CUT_OFF


def test_a_list_is_set_before_its_items_whatever_the_order_of_settings() -> None:
    _, content = load("baseline", ["faults.0.at=0.4", f"faults=[{CUT_OFF}]"])
    assert content["faults"] == [CUT_OFF | {"at": 0.4}]


def test_a_parameter_of_the_scenario_that_is_called_faults_stays_one() -> None:
    def mine(faults: int = 2) -> dict[str, object]:
        return {"faults": [CUT_OFF] * faults}

    assert load_values(mine, {"faults": 1})[1]["faults"] == [CUT_OFF]


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ('faults=[{"type": "Partitio", "at": 0.2}]', r"faults\[0\]\.type: unknown fault 'Partitio'.*'Partition'"),
        ('faults=[{"type": "Loss", "att": 0.2}]', r"faults\[0\]\.att: Loss has no such parameter.*'at'"),
        (
            'faults=[{"type": "Kill", "at": "soon", "node": "ego"}]',
            r"faults\[0\]\.at: found 'soon', expected a number",
        ),
        ('faults=[{"type": "Kill", "at": 0.2, "node": "infr_1"}]', r"faults\[0\]\.node: no node, .*'infra_1'"),
        ("faults={'type': 'Kill'}", r"faults: found .*, expected a list of dict"),
        ('faults=[{"type"', r"faults: found .*, expected a list of dict"),
        ("fault=[]", "--set fault: no such launch-time parameter; did you mean 'faults'"),
        ("faults.1={}", r"--set faults\.1: no '1' there: it is a list, expected a whole item as 0 first"),
        ("faults.0.at=1.0", r"--set faults\.0\.at: no '0' there: it is a list, expected a whole item as 0 first"),
    ],
)
def test_an_invalid_fault_is_refused_with_its_place_and_the_nearest_choice(setting: str, reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        scenario.resolve(*load("baseline", [setting]), frames=5)
