"""The study `defences`: its configurations, the check of its data, and a small one carried out."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import pytest

import mast_zenoh as mast
from mast_zenoh import scenario, scenes
from mast_zenoh.config.registry import known_types
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.integrity import Integrity
from mast_zenoh.integrity.calibration import refuse_calibration_data
from mast_zenoh.study import definition, execution, trial, trials
from mast_zenoh.study.defences import PLACEMENTS, matrix, place
from mast_zenoh.study.defences.choices import FAULTS

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


def planned(*settings: str, seed: int = 0, count: int = 1) -> list[trials.Trial]:
    study = definition.load("defences", [*SMALL, *settings])
    return trials.plan(study, count=count, seed=seed, frames=8, runtime="inproc")


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


@pytest.mark.parametrize("preset", ["quick", "full", "today", "alarms", "faults", "framing", "adaptive"])
def test_every_preset_is_short_to_name_and_uses_no_calibration_data(preset: str) -> None:
    study = definition.load("defences", [f"preset={preset}"])
    assert len(study.configurations) == len(study.cells) > 1
    assert study.baseline == "NoIntegrity alone"
    first = study.scenes[0].settings[0].removeprefix("scene=")
    scene = {"type": "Intersection", "scene_index": int(first.removeprefix("intersection:"))}
    refuse_calibration_data(range(study.seed, study.seed + (study.trials or 1)), scene, preset)


def test_the_preset_alarms_plays_108000_unattacked_frames_and_what_they_are_compared_with() -> None:
    study = definition.load("defences", ["preset=alarms"])
    assert [each.label for each in study.configurations] == ["NoIntegrity alone", "FaultOrLie alone"]
    assert len(study.scenes) * (study.trials or 0) * (study.frames or 0) == 108_000


def test_no_adversaries_means_runs_without_an_attack() -> None:
    study = definition.load("defences", ["defences=KOfN", "adversaries="])
    assert [each.label for each in study.configurations] == ["NoIntegrity alone", "KOfN alone"]


def test_todays_attacks_are_on_tracks_alone_and_have_no_budget() -> None:
    study = definition.load("defences", ["preset=today"])
    assert {cell.attack for cell in study.cells.values()} == {"", "coordinated", "uncoordinated"}
    assert {cell.budget for cell in study.cells.values()} == {None}
    for name in ("coordinated", "uncoordinated"):
        settings = [f"attack={name}", "scene=intersection:4", "placement=poles", "n_adversaries=1"]
        _, content = scenario.load("defence_cell", settings)
        rewrites = set(content["keyexpr"]["rewrites"])
        assert {"on_tracks.toml", "views.toml"} <= rewrites
        assert not rewrites & {"on_view.toml", "on_detections.toml", "knowledge_trust.toml"}
    (adversary,) = content["adversaries"].values()
    assert adversary["attack"]["type"] == "UncoordinatedAttack"
    assert not content.get("coordinator")


def test_an_unattacked_run_has_no_coordinator() -> None:
    _, content = scenario.load("defence_cell", ["scene=intersection:4", "n_adversaries=0"])
    assert not content.get("coordinator")


def test_without_adversaries_or_faults_no_scene_is_recorded_for_their_placement(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    frames: list[int | None] = []
    prepare = scenes.prepare
    monkeypatch.setattr(scenes, "prepare", lambda *arguments: (frames.append(arguments[2]), prepare(*arguments))[1])
    settings = ["scene=intersection:4", "placement=worst", "placement_frames=9"]
    scenario.load("defence_cell", [*settings, "n_adversaries=0"])
    assert set(frames) == {1}, "for the agents' names"
    scenario.load("defence_cell", [*settings, "n_adversaries=1"])
    assert 9 in frames


def test_an_unattacked_trial_writes_no_run_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execution, "_run_in_folder", lambda *_: pytest.fail("recorded"))
    (alone,) = planned("adversaries=", "defences=NoIntegrity")
    outcome = execution.run(alone)
    assert outcome.error == ""
    assert outcome.metrics["defence"] == matrix.NO_LIES
    assert outcome.metrics["integrity"]["hours"] == pytest.approx(8 * 0.1 / 3600.0)


def test_an_unattacked_trial_has_the_metrics_of_a_recorded_one(monkeypatch: pytest.MonkeyPatch) -> None:
    (alone,) = planned("adversaries=", "defences=NoIntegrity")
    outcome = execution.run(alone)
    monkeypatch.setattr(execution, "_is_disturbed", lambda _: True)
    recorded = execution.run(alone)
    same = {name: part for name, part in outcome.metrics.items() if name != "defence"}
    assert json.loads(json.dumps(same)) == {name: recorded.metrics[name] for name in same}
    assert recorded.metrics["defence"].items() >= matrix.NO_LIES.items()


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
        planned(seed=99, count=3)
    assert planned(seed=99, count=2)


def test_calibration_scenes_are_refused_before_anything_runs() -> None:
    with pytest.raises(ConfigurationError, match="scene intersection:3: thresholds were calibrated on the junctions"):
        planned("scenes=intersection:4,intersection:3")


def test_each_trial_has_the_placement_of_its_own_seed() -> None:
    settings = [trial.settings for trial in planned(count=2)]
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
    first = {trial.configuration: trial.digest for trial in planned(*files)}
    assert list(first) == ["NoIntegrity alone", "NoIntegrity polite 1 worst", "Mine alone", "Mine polite 1 worst"]
    (tmp_path / "mine.py").write_text(DEFENCE + "\n# changed\n")
    trial.files_key.cache_clear()  # as in a new process
    second = {trial.configuration: trial.digest for trial in planned(*files)}
    assert second["Mine alone"] != first["Mine alone"], "a changed file is another trial"
    assert second["NoIntegrity alone"] == first["NoIntegrity alone"]


def test_a_file_without_a_defence_is_refused(tmp_path: Path) -> None:
    (tmp_path / "polite.py").write_text(ATTACK)
    with pytest.raises(ConfigurationError, match="defines 0 classes of type Integrity"):
        planned(f"defences={tmp_path / 'polite.py'}")


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
