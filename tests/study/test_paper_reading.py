"""The named reading of the paper in `monte_carlo`, and agents to compromise by name."""

from __future__ import annotations

import itertools
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from mast_zenoh import scenario
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.attacks.campaign import StaticPropagation
from mast_zenoh.attacks.coordination import Coordinator
from mast_zenoh.attacks.regions import REGIONS, Shape
from mast_zenoh.attacks.selection import CoordinatedSelection
from mast_zenoh.attacks.surroundings import Coverage, Surroundings, unlimited
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.study import definition

#: m, as in `CoordinatedAttack`.
MAX_RANGE_M = 70.0
#: Commands of the page that compares the study with the paper.
PAGE = Path(__file__).parents[2] / "docs" / "explanation-threat-model.md"
COMMANDS = re.findall(r"^\$ mast study monte_carlo (.*)$", PAGE.read_text(encoding="utf-8"), flags=re.M)


def loaded(configuration: str, *settings: str) -> dict:
    configurations = {each.label: each for each in definition.load("monte_carlo", settings).configurations}
    chosen = configurations[configuration]
    return scenario.load(chosen.scenario, chosen.settings)[1]


def test_false_objects_of_the_papers_reading_stand_still_and_are_near_any_agent() -> None:
    coordination = loaded("coordinated-3", "reading=paper")["coordinator"]["coordination"]
    assert coordination["propagation"] == {"type": "StaticPropagation"}
    assert coordination["selection"]["region"] == "paper"
    assert coordination["selection"]["fraction_false_negatives"] == 0.0, "commented out in the originals"
    attack = loaded("uncoordinated-1", "reading=paper")["adversaries"]["adversary_1"]["attack"]
    assert attack["propagation"] == {"type": "StaticPropagation"}
    assert attack["imitation"] == {"type": "Exact"}


def test_an_exact_number_of_false_objects_reaches_both_attacks() -> None:
    number = ("exact_number=true", "false_positives=9")
    coordination = loaded("coordinated-2", *number)["coordinator"]["coordination"]
    attack = loaded("uncoordinated-2", *number)["adversaries"]["adversary_2"]["attack"]
    for selection in (coordination["selection"], attack["selection"]):
        assert (selection["n_false_positives"], selection["exact_number"]) == (9, True)


def test_dotted_settings_reach_all_runs_of_the_study() -> None:
    for configuration in ("baseline", "uncoordinated-1", "coordinated-3"):
        content = loaded(configuration, 'settings={"evaluator.scorer.range_m": 70.0}')
        assert content["evaluator"]["scorer"]["range_m"] == 70.0


@pytest.mark.parametrize("command", COMMANDS)
def test_the_runs_of_each_command_of_the_page_can_be_started(command: str) -> None:
    words = shlex.split(command.replace("avstack:PATH", "intersection:1"), comments=True)
    settings = [value for option, value in itertools.pairwise(words) if option == "--set"]
    assert f"scenes=intersection:{1 if 'avstack:PATH' in command else 4}" in settings
    for configuration in definition.load("monte_carlo", settings).configurations:
        path, content = scenario.load(configuration.scenario, configuration.settings)
        assert scenario.resolve(path, content, frames=20).nodes


def test_without_a_reading_the_study_is_as_before() -> None:
    coordination = loaded("coordinated-3")["coordinator"]["coordination"]
    assert coordination["propagation"] == {"type": "TrajectoryPropagation"}
    assert coordination["selection"]["region"] == "in_view"


def test_an_unknown_reading_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ConfigurationError, match="reading: found 'book', expected one of testbed, paper"):
        definition.load("monte_carlo", ["reading=book"])


def test_agents_to_compromise_are_chosen_by_name_and_others_follow() -> None:
    adversaries = loaded("uncoordinated-3", 'compromised=["infra_4", "infra_1"]')["adversaries"]
    assert [each["agent"] for each in adversaries.values()] == ["infra_4", "infra_1", "infra_2"]


def test_in_the_papers_region_a_second_adversary_reports_more_of_the_shared_objects_and_a_third_few() -> None:
    """Two compromised agents 120 m apart; the third is near the first."""
    agents = np.array([[0.0, 0.0, 15.0], [120.0, 0.0, 15.0], [10.0, 10.0, 15.0]])
    coverage = Coverage(Surroundings(), (unlimited(agents[0]),), 0.0, agents=agents[:2])
    shape = Shape(30.0, 10.0, np.array([4.0, 2.0, 2.0]), MAX_RANGE_M)
    position, _ = REGIONS["paper"].place(2000, shape, ObjectStates.empty(), 0.0, coverage, np.random.default_rng(0))
    distance = np.linalg.norm(position[:, None, :2] - agents[None, :, :2], axis=2)
    reported = [(distance[:, :count].min(axis=1) <= MAX_RANGE_M).mean() for count in (1, 2, 3)]
    assert reported[0] == pytest.approx(0.5, abs=0.1)
    assert reported[1] == reported[2] == 1.0


def test_the_shared_list_is_the_same_whichever_agents_are_compromised() -> None:
    """Otherwise runs with one, two and three adversaries could not be compared seed by seed."""
    poles = {f"infra_{k}": [40.0 * k, 10.0 * k, 15.0] for k in range(1, 5)}
    sensor = dict(limits_deg=[-180, 180, -90, 90], max_range_m=70.0, mount_position=[0, 0, 0], mount_rotation=np.eye(3))
    agents = {name: sensor | {"route": [[0.0, *position, 1.0, 0, 0, 0]]} for name, position in poles.items()}

    def directive(*victims: str) -> np.ndarray:
        selection = CoordinatedSelection(region="paper", n_false_positives=20.0)
        coordinator = Coordinator(selection=selection, propagation=StaticPropagation(), start_s=0.0)
        coordinator.inform(Surroundings(scene="x", agents=agents, victims=victims))
        coordinator.bind(1, "coordinator")
        nothing = (ObjectStates.empty(), np.zeros(0, np.int64))
        return coordinator.step(0, 0, *nothing, np.array([poles[name] for name in victims]))[0].add.position

    assert len(directive("infra_3")) > 5
    for victims in (("infra_1", "infra_3"), ("infra_3", "infra_1"), ("infra_2", "infra_4", "infra_1")):
        np.testing.assert_array_equal(directive(*victims), directive("infra_3"))
