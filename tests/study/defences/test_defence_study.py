"""The study `defences`: its configurations, the check of its data, and a small one carried out."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from pyarrow import parquet

import mast_zenoh as mast
from mast_zenoh import scenario, scenes
from mast_zenoh.config.registry import known_types
from mast_zenoh.errors import ConfigurationError, TrialsFailed
from mast_zenoh.integrity import Integrity
from mast_zenoh.integrity.calibration import refuse_calibration_data
from mast_zenoh.study import definition, execution, trial, trials
from mast_zenoh.study.choices import FAULTS, PLACEMENTS, place, resolve_choice
from mast_zenoh.study.defences.breakdown import Breakdown
from mast_zenoh.study.defences.cooperation import Cooperation
from mast_zenoh.study.defences.drift import Drift
from mast_zenoh.study.defences.driving_matrix import DrivingMatrix
from mast_zenoh.study.defences.field_matrix import FieldMatrix
from mast_zenoh.study.defences.kinds import Kind, kind_of, name_of_kind
from mast_zenoh.study.defences.matrix import NO_LIES, DefenceMatrix

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
KIND = """
from mast_zenoh.metrics.study_results import Row
from mast_zenoh.show.tables.text_table import ResultTables, numbers_of_rows, shown, table_of_rows
from mast_zenoh.study.defences.kinds import Kind

class Misses(Kind):
    '''Missed objects by number of poles.'''

    name = "misses"

    def measures(self, factors, outcome):
        return {"fn": outcome.metrics["agents"]["ego"]["picture"]["fn"]["mean"]}

    def table(self):
        return [Row(dict(each), 1, {"fn": self.mean(self.values(each, "fn"))}) for each in self.trials]

    def tables(self, table):
        page = table_of_rows("Misses", "", table, {"missed": shown("fn")})
        return ResultTables("Misses", "", self.size, [page], numbers_of_rows(table), [page])

def study():
    runs = {
        f"{n} poles": dict(scenario="baseline", parameters=dict(n_infrastructure=n), factors=dict(poles=n))
        for n in (1, 2)
    }
    return dict(kind=Misses, runs=runs, scenes=["intersection:4"], trials=1, frames=5, runtime="inproc")
"""
#: Settings of a study with the baseline, a second defence, and one run of each under attack.
FAULTY_LABELS = ["NoIntegrity alone", "NoIntegrity fault ghosts 2 worst", "KOfN alone", "KOfN fault ghosts 2 worst"]
SMALL = ["defences=NoIntegrity,KOfN", "adversaries=coordinated", "counts=1", "n_infrastructure=2", "attack_start_s=0.3"]


def planned(*settings: str, seed: int = 0, count: int = 1) -> list[trials.Trial]:
    study = definition.load("defences", [*SMALL, *settings])
    return trials.plan(study.chosen(seed=seed, frames=8, runtime="inproc"), count=count)


@pytest.mark.parametrize(
    ("settings", "labels"),
    [
        (
            ["defences=KOfN", "adversaries=coordinated,BlindSpot", "counts=(0, 2)"],
            [
                *("NoIntegrity alone", "NoIntegrity coordinated 2 worst", "NoIntegrity BlindSpot 2 worst budget 2"),
                *("KOfN alone", "KOfN coordinated 2 worst", "KOfN BlindSpot 2 worst budget 2"),
            ],
        ),
        (["defences=KOfN", "adversaries="], ["NoIntegrity alone", "KOfN alone"]),
        (["preset=alarms"], ["NoIntegrity alone", "FaultOrLie alone"]),
        (
            ["defences=['KOfN', {'type': 'KOfN', 'k': 3}]", "counts=()"],
            ["NoIntegrity alone", "KOfN alone", "KOfN k=3 alone"],
        ),
        ([*SMALL[:1], "adversaries=fault:ghosts", "counts=2"], FAULTY_LABELS),
    ],
)
def test_every_defence_meets_every_adversary_and_runs_alone(settings: list[str], labels: list[str]) -> None:
    study = definition.load("defences", settings)
    assert [each.label for each in study.configurations] == labels
    assert study.baseline == "NoIntegrity alone"


@pytest.mark.parametrize("preset", ["quick", "full", "today", "alarms", "faults", "framing", "adaptive"])
def test_every_preset_is_short_to_name_and_uses_no_calibration_data(preset: str) -> None:
    study = definition.load("defences", [f"preset={preset}"])
    assert len(study.configurations) == len({*study.factors.values()}) > 1
    assert study.baseline == "NoIntegrity alone"
    first = study.scenes[0].settings[0].removeprefix("scene=")
    scene = {"type": "Intersection", "scene_index": int(first.removeprefix("intersection:"))}
    refuse_calibration_data(range(study.seed, study.seed + (study.trials or 1)), scene, preset)


def test_todays_attacks_are_on_tracks_alone_and_have_no_budget() -> None:
    study = definition.load("defences", ["preset=today"])
    assert {cell["attack"] for cell in study.factors.values()} == {"", "coordinated", "uncoordinated"}
    assert {cell["budget"] for cell in study.factors.values()} == {None}
    for name in ("coordinated", "uncoordinated"):
        settings = [f"attack={name}", "scene=intersection:4", "placement=poles", "n_adversaries=1"]
        _, content = scenario.load("defence_cell", settings)
        rewrites = set(content["keyexpr"]["rewrites"])
        assert {"on_tracks.toml", "views.toml"} <= rewrites
        assert not rewrites & {"on_view.toml", "on_detections.toml", "knowledge_trust.toml"}
    (adversary,) = content["adversaries"].values()
    assert adversary["attack"]["type"] == "UncoordinatedAttack"
    assert not content.get("coordinator")


def test_an_unattacked_run_has_no_coordinator_and_records_no_scene_for_placement(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    frames: list[int | None] = []
    prepare = scenes.prepare
    monkeypatch.setattr(scenes, "prepare", lambda *arguments: (frames.append(arguments[2]), prepare(*arguments))[1])
    settings = ["scene=intersection:4", "placement=worst", "placement_frames=9"]
    _, content = scenario.load("defence_cell", [*settings, "n_adversaries=0"])
    assert not content.get("coordinator")
    assert set(frames) == {1}, "for the agents' names"
    scenario.load("defence_cell", [*settings, "n_adversaries=1"])
    assert 9 in frames


def test_an_unattacked_trial_writes_no_run_folder_and_has_the_metrics_of_a_recorded_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (alone,) = planned("adversaries=", "defences=NoIntegrity")
    with monkeypatch.context() as patch:
        patch.setattr(execution, "_run_in_folder", lambda *_: pytest.fail("recorded"))
        outcome = execution.run(alone)
    assert outcome.error == ""
    assert outcome.metrics["defence"] == NO_LIES
    assert outcome.metrics["integrity"]["hours"] == pytest.approx(8 * 0.1 / 3600.0)
    monkeypatch.setattr(execution, "_is_disturbed", lambda _: True)
    recorded = execution.run(alone)
    same = {name: part for name, part in outcome.metrics.items() if name != "defence"}
    assert json.loads(json.dumps(same)) == {name: recorded.metrics[name] for name in same}
    assert recorded.metrics["defence"].items() >= NO_LIES.items()


def test_budgets_are_for_adversaries_that_have_one() -> None:
    study = definition.load("defences", ["adversaries=PoseDrift,Framing", "counts=1", "budgets=(1.0, 4.0)"])
    cells = [cell for cell in study.factors.values() if cell["defence"] == "KOfN" and cell["attack"]]
    assert [(cell["attack"], cell["budget"]) for cell in cells] == [
        ("PoseDrift", None),
        ("Framing", 1.0),
        ("Framing", 4.0),
    ]


def test_a_fault_takes_the_places_of_adversaries() -> None:
    study = definition.load("defences", [*SMALL[:1], "adversaries=fault:ghosts", "counts=2"])
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


def test_every_fault_is_accepted_by_the_scenario() -> None:
    for fault in FAULTS:
        settings = [f"fault={fault}", "n_infrastructure=2", "n_adversaries=0", "attack_start_s=0.1"]
        path, content = scenario.load("defence_cell", settings)
        assert scenario.resolve(path, content, frames=4).timeline


def test_a_full_preset_has_every_shipped_defence() -> None:
    study = definition.load("defences", ["preset=full"])
    shipped = {name for name, cls in known_types(Integrity).items() if cls.__module__.startswith("mast_zenoh.")}
    # A centre hears no gossip: Hearsay is for peers.
    assert {cell["defence"] for cell in study.factors.values()} == shipped - {"Hearsay"}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ("adversaries=fault:fog", "fault: found 'fog'"),
        ("placements=best", r"placements: found 'best'.*random"),
        ("scenes=intersection:4,intersection:3", "scene intersection:3: thresholds were calibrated on the junctions"),
        (f"defences={__file__}", "defines no Integrity, expected a class derived from Integrity"),
    ],
)
def test_an_invalid_choice_is_refused_before_anything_runs(settings: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        planned(settings)


@pytest.mark.parametrize("choice", ['{"tpye": "KOfN"}', '{"type": 3}', "{KOfN", {"k": 3}, 3])
def test_a_choice_without_the_name_of_a_class_is_refused(choice: Any) -> None:
    with pytest.raises(ConfigurationError, match="expected a name, a file or a dict with `type`"):
        resolve_choice(choice, Integrity)


def test_calibration_seeds_are_refused_before_anything_runs() -> None:
    with pytest.raises(ConfigurationError, match="seed 101: thresholds were calibrated on seeds 101 to 202"):
        planned(seed=99, count=3)
    assert planned(seed=99, count=2)


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


@pytest.mark.parametrize("kind", [DefenceMatrix, Drift, Breakdown, FieldMatrix, Cooperation, DrivingMatrix])
def test_every_kind_writes_its_tables_even_of_no_trial(kind: type[Kind], tmp_path: Path) -> None:
    files = kind({}, ["junction"], [0]).write(tmp_path)
    assert not files.left_out
    assert {*files.names} == {path.name for path in tmp_path.iterdir()}
    assert {Path(name).suffix for name in files.names} >= {".md", ".csv", ".tex"}
    assert kind.without_lies is None or kind.without_lies["lies"]["all"] == 0
    assert kind_of(name_of_kind(kind)) is kind


def test_a_users_own_kind_is_one_file_that_workers_find_by_its_name(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(KIND)
    study = definition.load(str(tmp_path / "mine.py"))
    assert kind_of(name_of_kind(study.kind)).__name__ == "Misses"  # type: ignore[arg-type]
    finished = mast.study(tmp_path / "mine.py", jobs=1, out=tmp_path / "study")
    assert (finished.path / "misses.md").read_text().splitlines()[-1].startswith("| 2 | ")
    assert "1,fn," in (finished.path / "misses.csv").read_text()
    assert "Misses" in (finished.path / "report.html").read_text()
    rows = [row for row in finished.results.to_pylist() if row["estimator"] == "misses"]
    assert [(row["poles"], row["who"], row["metric"]) for row in rows] == [(1, "all", "fn"), (2, "all", "fn")]


def digests_of(content: str, folder: Path) -> list[str]:
    """Those of the trials of a study file, as in a new process."""
    (folder / "mine.py").write_text(content)
    trial.files_key.cache_clear()
    study = definition.load(str(folder / "mine.py"))
    return [each.digest for each in trials.plan(study.chosen(seed=0, frames=5, runtime="inproc"), count=1)]


def test_only_what_changes_the_outcomes_of_trials_repeats_them(tmp_path: Path) -> None:
    evaluates = KIND.replace(
        "    def measures", "    def evaluate(run, compromised):\n        return {}\n\n    def measures"
    )
    changed = ('Misses"', 'Missed"')  # of a table
    of_own = "from mast_zenoh.scenario import load\n\ndef scenario(scene='intersection:4', n_infrastructure=1):\n"
    of_own += "    return load('baseline', [f'scene={scene}', f'n_infrastructure={n_infrastructure}'])[1]\n"
    (tmp_path / "own.py").write_text(of_own)
    in_folder = KIND.replace('scenario="baseline"', 'scenario="own.py"')
    for content in (KIND, in_folder):
        assert digests_of(content, tmp_path) == digests_of(content.replace(*changed), tmp_path)
    assert digests_of(evaluates, tmp_path) != digests_of(evaluates.replace(*changed), tmp_path), "it may use all of it"
    (tmp_path / "own.py").write_text(f"import mine\n{of_own}")
    assert digests_of(in_folder, tmp_path) != digests_of(in_folder.replace(*changed), tmp_path), "a scenario imports it"


def test_configurations_of_a_kind_have_factors_that_differ(tmp_path: Path) -> None:
    (tmp_path / "same.py").write_text(KIND.replace("poles=n))", "poles=1))"))
    with pytest.raises(ConfigurationError, match=r"runs\.1 poles\.factors: the same as of '2 poles', expected others"):
        definition.load(str(tmp_path / "same.py"))
    (tmp_path / "none.py").write_text(KIND.replace("kind=Misses", "kind='Misses'"))
    with pytest.raises(ConfigurationError, match="kind: found 'Misses', expected a subclass of Kind"):
        definition.load(str(tmp_path / "none.py"))


def test_figures_that_a_study_has_no_more_are_removed_and_those_of_others_are_kept(tmp_path: Path) -> None:
    for name in ("roc.png", "roc.pdf", "mine.png"):
        (tmp_path / name).write_bytes(b"old")
    DefenceMatrix({}, ["junction"], [0]).write(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} & {"roc.png", "roc.pdf", "mine.png"} == {"mine.png"}


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


#: A figure of the kind above.
FIGURE = """
    def figures(self, table):
        from mast_zenoh.show.figures.drawing import render
        from mast_zenoh.show.figures.facets import Axis, facet

        figure = facet(table, "poles", [Axis("fn", "missed objects per frame")], "poles")
        return {self.name: render(self.name, figure, "Missed objects.", "By number of poles.")}

def study():"""


def own_kind(folder: Path, old: str = "", new: str = "") -> Path:
    """A study file with a kind of its own and a figure, with a change."""
    assert not old or old in KIND.replace("\ndef study():", FIGURE)
    (folder / "mine.py").write_text(KIND.replace("\ndef study():", FIGURE).replace(old, new))
    return folder / "mine.py"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('[Axis("fn", "missed objects per frame")]', '"fn"', r"mine\.py:25: figures: facet: y: found 'fn', expected a"),
        ('Axis("fn",', 'Axis("fm",', "figures: facet: y: found 'fm'; did you mean 'fn'"),
        ('facet(table, "poles"', 'facet(table, "pole"', "figures: facet: x: found 'pole'; did you mean 'poles'"),
        (
            "{self.name: render",
            "{self.name: figure, 'other': render",
            r"mine\.py:21: figures: found .*expected what rend",
        ),
        ('name = "misses"', "", "mine.py: kind: Misses has no name"),
        ('name = "misses"', 'name = "../misses"', r"mine\.py:17: tables: found the name '\.\./misses', expected"),
        ('name = "misses"', 'name = "table"', r"tables: found the name 'table', expected one that can name a file"),
        ("def table(", "def tabel(", "mine.py: kind: Misses has no table"),
    ],
)
def test_a_wrong_argument_of_a_figure_is_refused_before_the_first_trial(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str, message: str
) -> None:
    monkeypatch.setattr(execution, "run", lambda _: pytest.fail("a trial was run"))
    with pytest.raises(ConfigurationError, match=message):
        mast.study(own_kind(tmp_path, old, new), jobs=1, out=tmp_path / "study")
    assert not (tmp_path / "study").exists()


@pytest.mark.parametrize(
    ("new", "message"),
    [
        ('{"fn": outcome.metrics["missing"]}', r"mine\.py:12: measures: KeyError: 'missing'"),
        ("None", r"mine\.py:11: measures: found None, expected a dict of values by name"),
        ("{1: 2.0}", r"measures: found \{1: 2\.0\}, expected a dict of values by name"),
        ('{"fn": 10**400}', "measures: OverflowError"),
        ('{"fn": [1.0, 2.0]}', r"mine\.py:15: table: measure 'fn': found \[1\.0, 2\.0\] in a trial, expected a number"),
        ('{"fn": "12"}', "table: measure 'fn': found '12' in a trial, expected a number"),
        ("exit(0)", r"mine\.py:12: measures: SystemExit: 0"),
    ],
)
def test_measures_that_fail_end_a_study_after_its_first_trial(tmp_path: Path, new: str, message: str) -> None:
    file = own_kind(tmp_path, '{"fn": outcome.metrics["agents"]["ego"]["picture"]["fn"]["mean"]}', new)
    with pytest.raises(ConfigurationError, match=message):
        mast.study(file, jobs=1, out=tmp_path / "study")
    assert len(list((tmp_path / "study" / "trials").iterdir())) == 1


def test_numbers_of_numpy_are_numbers_and_what_fails_in_a_run_folder_fails_its_trial(tmp_path: Path) -> None:
    measured = '{"fn": np.float32(2.0), "three": np.int64(3), "yes": np.bool_(True)}'
    file = own_kind(tmp_path, '{"fn": outcome.metrics["agents"]["ego"]["picture"]["fn"]["mean"]}', measured)
    file.write_text(f"import numpy as np\n{file.read_text()}")
    mast.study(file, jobs=1, out=tmp_path / "study")
    table = parquet.read_table(tmp_path / "study" / "results.parquet").to_pydict()
    rows = {*zip(table["estimator"], table["metric"], table["value"], strict=True)}
    assert {("misses", "fn", 2.0), ("misses", "three", 3.0), ("misses", "yes", 1.0)} <= rows
    failing = "    @staticmethod\n    def evaluate(run, compromised):\n        return object()\n\n    def table"
    file.write_text(file.read_text().replace("    def table", failing))
    with pytest.raises(TrialsFailed, match=r"evaluate: TypeError: Object of type object is not JSON"):
        mast.study(file, jobs=1, out=tmp_path / "failing")


@pytest.mark.parametrize("part", ["figures", "tables"])
def test_a_figure_or_table_that_fails_is_left_out_with_the_reason_and_the_study_is_kept(
    tmp_path: Path, part: str
) -> None:
    begins, kept = f"    def {part}(self, table):\n", part == "figures"
    own_kind(tmp_path, begins, f"{begins}        if any(row['fn'].known for row in table): [][0]\n")
    reason = f"{tmp_path / 'mine.py'}:{{}}: {part}: IndexError: list index out of range".format(22 if kept else 18)
    with pytest.raises(ConfigurationError, match=r"left out of the results.*--resume") as caught:
        mast.study(tmp_path / "mine.py", jobs=1, out=tmp_path / "study")
    assert reason in str(caught.value)
    folder = tmp_path / "study"
    stored = json.loads((folder / "study.json").read_text())
    assert (stored["status"], stored["left_out"]) == ("failed", [reason])
    for name in ("report.html", "table.md"):
        assert "Left out of the results" in (folder / name).read_text()
        assert "IndexError" in (folder / name).read_text()
    assert ((folder / "misses.md").exists(), (folder / "misses.png").exists()) == (kept, not kept)
