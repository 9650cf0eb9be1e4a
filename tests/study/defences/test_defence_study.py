"""The study `defences`: its configurations, the check of its data, and a small one carried out."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

import mast_zenoh as mast
from mast_zenoh import scenario
from mast_zenoh.config.registry import known_types
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.integrity import Integrity
from mast_zenoh.study import definition, identity, plan
from mast_zenoh.study.defences import PLACEMENTS, place
from mast_zenoh.study.defences.natural import FAULTS

DEFENCE = """
from mast_zenoh.integrity import NoIntegrity

class Mine(NoIntegrity):
    '''Judges nobody.'''
"""
ATTACK = """
from mast_zenoh.attacks import PassThrough

class Polite(PassThrough):
    '''Relays every message unchanged.'''
"""
#: Settings of a study with the baseline, a second defence, and one run of each under attack.
SMALL = ["defences=NoIntegrity,KOfN", "adversaries=coordinated", "counts=1", "n_infrastructure=2"]


def trials(*settings: str, seed: int = 0, count: int = 1) -> list[plan.Trial]:
    study = definition.load("defences", [*SMALL, *settings])
    return plan.trials(study, count=count, seed=seed, frames=8, runtime="inproc")


def test_every_defence_meets_every_adversary_and_runs_alone() -> None:
    study = definition.load("defences", ["defences=KOfN", "adversaries=coordinated,BlindSpot", "counts=(0, 2)"])
    assert [each.label for each in study.configurations] == [
        "NoIntegrity alone",
        "NoIntegrity coordinated 2 worst",
        "NoIntegrity BlindSpot 2 worst budget 2",
        "KOfN alone",
        "KOfN coordinated 2 worst",
        "KOfN BlindSpot 2 worst budget 2",
    ]
    assert study.baseline == "NoIntegrity alone"


def test_budgets_are_for_adversaries_that_have_one() -> None:
    study = definition.load("defences", ["adversaries=PoseDrift,Framing", "counts=1", "budgets=(1.0, 4.0)"])
    cells = [cell for cell in study.cells.values() if cell.defence == "KOfN" and cell.attack]
    assert [(cell.attack, cell.budget) for cell in cells] == [("PoseDrift", None), ("Framing", 1.0), ("Framing", 4.0)]


def test_a_fault_takes_the_places_of_adversaries() -> None:
    study = definition.load("defences", [*SMALL[:1], "adversaries=fault:ghosts", "counts=2"])
    assert [each.label for each in study.configurations][1] == "NoIntegrity fault ghosts 2 worst"
    settings = [*study.configurations[1].settings, "scene=intersection:4", "placement_frames=8"]
    _, content = scenario.load("defence_cell", settings)
    assert content["adversaries"] == {}
    (fault,) = content["faults"]
    assert (fault["type"], fault["nodes"]) == ("GhostDetections", list(place("intersection:4", 2, "worst", 0, 8)))


def test_a_fault_beside_an_attack_is_that_of_an_honest_agent() -> None:
    _, content = scenario.load("defence_cell", ["scene=intersection:4", "placement_frames=8", "fault=pose"])
    liars = {config["agent"] for config in content["adversaries"].values()}
    assert len(liars) == 2
    assert not liars & set(content["faults"][0]["nodes"])


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_is_accepted_by_the_scenario(fault: str) -> None:
    path, content = scenario.load(
        "defence_cell", [f"fault={fault}", "n_infrastructure=2", "n_adversaries=0", "attack_start_s=0.1"]
    )
    assert scenario.resolve(path, content, frames=4).timeline


def test_an_unknown_fault_names_the_known_ones() -> None:
    with pytest.raises(ConfigurationError, match="fault: found 'fog'"):
        definition.load("defences", ["adversaries=fault:fog"])


def test_a_full_preset_has_every_shipped_defence() -> None:
    study = definition.load("defences", ["preset=full"])
    shipped = {name for name, cls in known_types(Integrity).items() if cls.__module__.startswith("mast_zenoh.")}
    assert {cell.defence for cell in study.cells.values()} == shipped


def test_calibration_seeds_are_refused_before_anything_runs() -> None:
    with pytest.raises(ConfigurationError, match="seed 101: thresholds were calibrated on seeds 101 to 202"):
        trials(seed=99, count=3)
    assert trials(seed=99, count=2)


def test_calibration_scenes_are_refused_before_anything_runs() -> None:
    with pytest.raises(ConfigurationError, match="scene intersection:3: thresholds were calibrated on the junctions"):
        trials("scenes=intersection:4,intersection:3")


def test_each_trial_has_the_placement_of_its_own_seed() -> None:
    settings = [trial.settings for trial in trials(count=2)]
    assert {"placement_seed=0" in each for each in settings} == {True, False}
    assert all("placement_frames=8" in each for each in settings)


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_the_ego_is_never_compromised_and_fewer_are_among_more(placement: str) -> None:
    chosen = [place("intersection:4", count, placement, 3, 8) for count in range(5)]
    assert all(set(few) < set(more) for few, more in pairwise(chosen))
    assert set(chosen[4]) == {"infra_1", "infra_2", "infra_3", "infra_4"}


def test_random_placements_depend_on_the_seed() -> None:
    assert len({place("intersection:4", 1, "random", seed) for seed in range(20)}) == 4


def test_an_unknown_placement_names_the_known_ones() -> None:
    with pytest.raises(ConfigurationError, match=r"placements: found 'best'.*random"):
        definition.load("defences", ["placements=best"])


def test_a_file_joins_the_matrix(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(DEFENCE)
    (tmp_path / "polite.py").write_text(ATTACK)
    files = [f"defences={tmp_path / 'mine.py'}:Mine", f"adversaries={tmp_path / 'polite.py'}"]
    first = {trial.configuration: trial.digest for trial in trials(*files)}
    assert list(first) == ["NoIntegrity alone", "NoIntegrity polite 1 worst", "Mine alone", "Mine polite 1 worst"]
    (tmp_path / "mine.py").write_text(DEFENCE + "\n# changed\n")
    identity.files_key.cache_clear()  # as in a new process
    second = {trial.configuration: trial.digest for trial in trials(*files)}
    assert second["Mine alone"] != first["Mine alone"], "a changed file is another trial"
    assert second["NoIntegrity alone"] == first["NoIntegrity alone"]


def test_a_file_without_a_defence_is_refused(tmp_path: Path) -> None:
    (tmp_path / "polite.py").write_text(ATTACK)
    with pytest.raises(ConfigurationError, match="defines 0 classes of type Integrity"):
        trials(f"defences={tmp_path / 'polite.py'}")


def test_a_defence_with_parameters_has_them_in_its_name() -> None:
    study = definition.load("defences", ["defences=['KOfN', {'type': 'KOfN', 'k': 3}]", "counts=()"])
    assert [each.label for each in study.configurations] == ["NoIntegrity alone", "KOfN alone", "KOfN k=3 alone"]
    assert "defence={'type': 'KOfN', 'k': 3}" in study.configurations[2].settings


def test_a_small_study_is_carried_out_and_resumed(tmp_path: Path) -> None:
    options = dict(trials=1, jobs=1, frames=14, runtime="inproc", out=tmp_path / "study")
    chosen = dict(defences="NoIntegrity", adversaries="BlindSpot", counts=1, n_infrastructure=1, attack_start_s=0.3)
    finished = mast.study("defences", **options, **chosen)  # type: ignore[arg-type]
    names = {path.name for path in finished.path.iterdir()}
    assert {"defences.md", "defences.csv", "defences.tex", "defence_matrix.png", "report.html"} <= names
    assert "detection_delay.png" not in names, "nobody is watched without a defence"
    before = (finished.path / "defences.csv").read_bytes()
    stored = {path: path.stat().st_mtime_ns for path in (finished.path / "trials").iterdir()}
    assert len(stored) == 2
    mast.study("defences", **options, **chosen, resume=True)  # type: ignore[arg-type]
    assert (finished.path / "defences.csv").read_bytes() == before
    assert {path: path.stat().st_mtime_ns for path in (finished.path / "trials").iterdir()} == stored
