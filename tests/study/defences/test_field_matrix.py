"""`mast study matrix`: kinds of scene, processor time, breakdown, and published figures next to ours."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from defence_outcomes import outcome

import mast_zenoh as mast
from mast_zenoh.attacks import Attack, Coordination
from mast_zenoh.config.registry import known_types
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.integrity import Integrity
from mast_zenoh.metrics.study_results import Row
from mast_zenoh.study import definition, execution, trials
from mast_zenoh.study.choices import COORDINATED, UNCOORDINATED
from mast_zenoh.study.defences.field_matrix import FieldMatrix, ratio, scene_title
from mast_zenoh.study.defences.kinds import Factors
from mast_zenoh.study.defences.matrix import NO_LIES, undefended
from mast_zenoh.study.defences.matrix_table import MatrixTable
from mast_zenoh.study.defences.matrix_tables import counts_of, matrix_tables
from mast_zenoh.study.defences.scoreboard import PUBLISHED, QUANTITIES, published_tables

POLES, MANY = "intersection:8, 4, 0", "intersection:8, 8, 4"
AGENTS = ("ego", "infra_1", "infra_2", "infra_3", "infra_4")
SEEDS = range(6)


def cell(defence: str, attack: str = "", n_adversaries: int = 0, placement: str = "") -> Factors:
    place = dict(n_adversaries=n_adversaries, placement=placement, budget=None, attack_start_s=0.5)
    return Factors(defence=defence, attack=attack, **place)


@pytest.mark.parametrize(
    ("kinds", "message"),
    [
        ("truck", "kinds: unknown kind 'truck': expected one of poles, cars, many"),
        ("poles,car", "kinds: unknown kind 'car': expected one of poles, cars, many; did you mean 'cars'?"),
        ("", "kinds: found none, expected one or more of poles, cars, many"),
    ],
)
def test_an_unknown_kind_of_scene_is_refused_with_the_known_ones(kinds: str, message: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        definition.load("matrix", [f"kinds={kinds}"])
    assert str(caught.value).endswith(message)


def test_several_numbers_of_adversaries_can_be_chosen_on_the_command_line() -> None:
    for setting, counts in (("counts=[1, 3]", {0, 1, 3}), ("counts=3", {0, 3}), ("trials=1", {0, 2})):
        study = definition.load("matrix", [setting])
        assert {each["n_adversaries"] for each in study.factors.values()} == counts
    with pytest.raises(ConfigurationError, match=r"counts: found 'many', expected whole numbers, .*\[1, 2\]"):
        definition.load("matrix", ["counts=many"])


def test_an_attack_that_begins_after_the_end_is_refused_before_anything_runs() -> None:
    study = definition.load("matrix", ["kinds=poles", "attack_start_s=3000"])
    with pytest.raises(ConfigurationError, match=r"begins at 3000 s, and the trials end after 5 s: expected more"):
        trials.plan(study.chosen(seed=0, frames=50, runtime="inproc"), count=1)


@pytest.mark.parametrize("preset", ["quick", "scoreboard", "full"])
def test_a_preset_plays_every_defence_against_every_attack_in_every_kind(preset: str) -> None:
    study = definition.load("matrix", [f"preset={preset}"])
    defences, attacks = ({each[name] for each in study.factors.values()} for name in ("defence", "attack"))
    assert len(study.factors) == len(defences) * len(attacks)
    assert study.kind is FieldMatrix
    assert {scene_title(scene.label) for scene in study.scenes} <= {"4 poles", "4 cars", "8 poles, 4 cars"}


def test_a_scoreboard_has_ten_seeds_of_every_defence_and_its_folder_can_be_continued_by_the_full_matrix() -> None:
    board, full = (definition.load("matrix", [f"preset={preset}"]) for preset in ("scoreboard", "full"))
    assert board.trials == 10
    played, every = ({(each.label, *each.settings) for each in study.configurations} for study in (board, full))
    assert played < every
    assert {scene.label for scene in board.scenes} < {scene.label for scene in full.scenes}
    defences = ({each["defence"] for each in study.factors.values()} for study in (board, full))
    assert next(defences) == next(defences)


# -- synthetic trials --------------------------------------------------------------------------------------------------


def trial(
    fp: float,
    *,
    liars: int = 0,
    local: float = 3.0,
    suspended: dict[str, float] | None = None,
    detected: int = 0,
    silent: bool = False,
    cpu_s: float = 0.1,
) -> dict[str, Any]:
    """Of ten frames of 0.1 s, in which the picture has `fp` false objects and the ego alone `local`.

    suspended: s of a suspension by agent;  liars: agents from infra_1 on, which lie from 0.5 s on;  detected: of 4 lies
    silent: whether they never do
    """
    times, compromised = suspended or {}, AGENTS[1 : 1 + liars]
    judged = {
        name: {
            "lied": name in compromised,
            "suspicion": {"max": 0.0},
            "fault_alarms": 0,
            "suspensions": [
                {"from_s": times[name], "conduct": "lying" if name in compromised else "honest"}
                for _ in range(name in times)
            ],
        }
        for name in AGENTS
    }
    lying = {
        name: {
            "first_lie_s": 0.5,
            "first_observable_s": 0.5,
            "observed_s": times.get(name, 1.0) - 0.5,
            "suspended_after_s": times[name] - 0.5 if name in times else None,
        }
        for name in compromised
    }
    scores = {"fn": {"mean": 0.0}, "fp": {"mean": fp}, "ospa_m": {"mean": fp}}
    metrics = {
        "frames": 10,
        "scored_frames": [0, 9],
        "agents": {name: {"picture": scores} for name in AGENTS},
        "integrity": {
            "agents": judged,
            "seconds": {"honest": {"trusted": 3.0, "suspended": float(bool(times))}},
            "hours": 0.01,
            "false_alarms": len(times.keys() - {*compromised}),
        },
        "defence": {
            **(NO_LIES | {"frames_s": [0.1 * frame for frame in range(10)] if liars else []}),
            "first_attack_s": 0.5 if liars and not silent else None,
            "lies": {"all": 4 * liars, "observable": 4 * liars, "detected": detected},
            "agents": lying,
            "compromised": list(compromised),
            "outnumbered": 0.0 if liars else None,
        },
    }
    per_frame = {
        "frame": np.tile(np.arange(10), 2),
        "agent": np.full(20, "ego", object),
        "estimator": np.repeat(np.array(["picture", "local"], object), 10),
        "fn": np.zeros(20),
        "fp": np.repeat([fp, local], 10),
    }
    return dict(metrics=metrics, per_frame=per_frame, cpu_s=cpu_s)


def collected(played: dict[Factors, Any], scenes: tuple[str, ...] = (POLES,), seeds: range = SEEDS) -> MatrixTable:
    """The matrix of trials; played: of each cell, a function of the scene and the seed that returns a `trial`."""
    collection = FieldMatrix({str(each): each for each in played}, scenes, list(seeds))
    for each, content in played.items():
        for scene in scenes:
            for seed in seeds:
                parts = content(scene, seed)
                single = outcome(str(each), scene, seed, parts["metrics"], parts["per_frame"])
                collection.add(replace(single, cpu_s=parts["cpu_s"]))
    result: MatrixTable = collection.table()
    return result


def always(**how: Any) -> Any:
    return lambda scene, seed: trial(**how)


def ghosts(defence: str, liars: int = 2, attack: str = "Ghost") -> Factors:
    return cell(defence, attack, liars, "random")


def broken_of(breakdown: Row) -> list[float]:
    return [breakdown[f"broken {count}"].value for count in counts_of(breakdown)]


def by_cell(table: MatrixTable, defence: str, attack: str = "Ghost", liars: int = 2, scene: str = "") -> Row:
    cell = (scene, defence, attack, liars if attack else 0, "random" if attack else "")
    return next(row for row in table.by_scene if tuple(row.of.values()) == cell)


NOTHING = {cell("NoIntegrity"): always(fp=0.0), cell("Cad"): always(fp=0.5)}


def test_harm_is_relative_to_no_defence_in_each_kind_of_scene_and_in_all() -> None:
    def defended(scene: str, seed: int) -> dict[str, Any]:
        return trial(fp=1.0 if scene == POLES else 5.0, liars=2)

    played = NOTHING | {ghosts("NoIntegrity"): always(fp=4.0, liars=2), ghosts("Cad"): defended}
    table = collected(played, (POLES, MANY))
    harms = [by_cell(table, "Cad", scene=scene)["harm"].value for scene in ("4 poles", "8 poles, 4 cars", "")]
    assert harms == pytest.approx([-3.0, 1.0, -1.0])
    assert by_cell(table, "Cad", "")["harm"].value == pytest.approx(0.5), "the cost without an attack"
    added = (1.0 - 0.5) + (5.0 - 0.5)
    assert table.summaries[0]["harm_removed"].value == pytest.approx(1.0 - added / (4.0 + 4.0)), "without that cost"


def test_what_a_defence_removes_of_the_sensors_own_errors_is_not_removed_of_an_attack() -> None:
    played = {cell("NoIntegrity"): always(fp=3.0), cell("Cad"): always(fp=1.0)}
    played |= {ghosts("NoIntegrity"): always(fp=5.0, liars=2), ghosts("Cad"): always(fp=3.0, liars=2)}
    table = collected(played)
    assert by_cell(table, "Cad")["by_attack"].value == pytest.approx(2.0), "as many as without the defence"
    assert table.summaries[0]["harm_removed"].value == pytest.approx(0.0)


def test_processor_time_is_paired_with_the_undefended_run_of_the_same_scene_and_seed() -> None:
    def undefended(scene: str, seed: int) -> dict[str, Any]:
        return trial(fp=1.0, liars=2, cpu_s=0.1 * 2.0**seed)

    def defended(scene: str, seed: int) -> dict[str, Any]:
        return trial(fp=1.0, liars=2, cpu_s=0.1 * 2.0**seed * (2.0 if seed % 2 else 8.0))

    table = collected(NOTHING | {ghosts("NoIntegrity"): undefended, ghosts("Cad"): defended})
    measured = by_cell(table, "Cad")["cpu_ratio"]
    assert measured.value == pytest.approx(4.0), "the geometric mean of 2 and 8"
    half = 2.5706 * np.std(np.log([2.0, 8.0] * 3), ddof=1) / np.sqrt(6.0)  # Student's t of five degrees of freedom
    assert (measured.low, measured.high) == pytest.approx((4.0 * np.exp(-half), 4.0 * np.exp(half)), rel=1e-3)
    assert by_cell(table, "NoIntegrity")["cpu_ms"].value == pytest.approx(1e3 * 0.1 * 63 / 6 / 10)
    assert table.summaries[0]["cpu_ratio_attacked"][:6] == measured[:6]
    assert table.summaries[0]["cpu_ratio_alone"].value == pytest.approx(1.0)


def test_a_trial_without_processor_time_is_left_out_of_it() -> None:
    measured = ratio(np.array([2.0, np.nan, 2.0]), np.array([1.0, 1.0, 1.0]))
    assert (measured.value, measured.trials, measured.left_out) == (pytest.approx(2.0), 2, 1)
    assert math.isnan(ratio(np.array([np.nan]), np.array([1.0])).value)


def test_a_defence_breaks_where_half_of_the_runs_are_worse_than_the_ego_alone_or_frame_somebody() -> None:
    honest_first = {"infra_4": 0.6, "infra_1": 0.7}
    played = NOTHING | {
        **{ghosts("NoIntegrity", liars): always(fp=liars + 1.5, liars=liars) for liars in (1, 2, 3)},
        ghosts("Cad", 1): always(fp=1.0, liars=1, suspended={"infra_1": 0.6, "infra_4": 0.7}),
        ghosts("Cad", 2): lambda scene, seed: trial(fp=1.0, liars=2, suspended=honest_first if seed < 3 else None),
        ghosts("Cad", 3): always(fp=9.0, liars=3),
    }
    table = collected(played)
    open_, defended = (each for each in table.breakdowns if not each.of["scene"])
    assert broken_of(open_) == [0.0, 0.0, 1.0, 1.0], "3.5 false objects, against 3"
    assert open_["breaks_at"].value == pytest.approx(1.5)
    assert broken_of(defended) == [0.0, 0.0, 0.5, 1.0]
    point = defended["breaks_at"]
    assert (point.value, defended.of["weakest"], max(counts_of(defended))) == (2.0, "Ghost", 3)
    assert 1.5 <= point.low < 2.0 <= point.high < 3.0
    line = next(each for each in matrix_tables(table).tables if each.title == "Breakdown").lines[1]
    assert line[:3] == ["NoIntegrity", "4 poles", "5"]
    assert line[-2].startswith("30"), "1.5 of five agents"


def test_a_suspension_that_happens_without_an_attack_too_does_not_break_a_defence() -> None:
    alarm = {"infra_4": 0.6}
    attacked = {ghosts("NoIntegrity"): always(fp=1.0, liars=2), ghosts("Cad"): always(fp=1.0, liars=2, suspended=alarm)}
    quiet = collected(NOTHING | attacked)
    noisy = collected(NOTHING | {cell("Cad"): always(fp=0.5, suspended=alarm)} | attacked)
    assert quiet.breakdowns[2]["broken 2"].value == 1.0
    assert noisy.breakdowns[2]["broken 2"].value == 0.0
    assert noisy.breakdowns[2]["breaks_at"].value == math.inf
    assert "> 2" in matrix_tables(noisy).as_markdown().splitlines()[-1]


def test_a_defence_is_weakest_against_the_attack_that_breaks_it_with_the_fewest() -> None:
    strong, weak = (ghosts("Cad", liars, "Strong") for liars in (1, 2)), ghosts("Cad", 2, "Weak")
    played = NOTHING | dict.fromkeys(strong, always(fp=9.0, liars=2)) | {weak: always(fp=1.0, liars=2)}
    played |= {undefended(each): always(fp=1.0, liars=2) for each in list(played) if each["attack"]}
    (of_cad,) = (each for each in collected(played).breakdowns if (each.of["scene"], each.of["defence"]) == ("", "Cad"))
    assert (of_cad.of["weakest"], of_cad["weakest_at"].value) == ("Strong", pytest.approx(0.5))


def test_an_honest_agent_that_is_suspended_counts_even_if_nobody_ever_lies() -> None:
    alarm = {"infra_4": 0.2}
    attacked = {
        ghosts("NoIntegrity"): always(fp=4.0, liars=2),
        ghosts("Cad"): always(fp=0.0, liars=2, silent=True, suspended=alarm),
    }
    table = collected(NOTHING | attacked)
    row = by_cell(table, "Cad")
    assert (row["honest_suspended"].value, row["honest_suspended"].trials, row.idle) == (1.0, 6, True)
    assert by_cell(table, "Cad", "")["honest_suspended"].value == 0.0
    assert math.isnan(table.summaries[0]["harm_removed"].value), "no attack took place, so nothing was removed"


def test_a_single_number_of_adversaries_is_a_bound_without_interpolation() -> None:
    weak, strong = (ghosts("Cad", attack=attack) for attack in ("Weak", "Strong"))
    played = NOTHING | {
        weak: lambda scene, seed: trial(fp=9.0 if seed < 4 else 1.0, liars=2),
        strong: always(fp=9.0, liars=2),
        ghosts("NoIntegrity", attack="Weak"): always(fp=1.0, liars=2),
        ghosts("NoIntegrity", attack="Strong"): always(fp=1.0, liars=2),
    }
    table = collected(played)
    (of_cad,) = (each for each in table.breakdowns if (each.of["scene"], each.of["defence"]) == ("", "Cad"))
    assert (of_cad["breaks_at"].value, of_cad["breaks_at"].interval, counts_of(of_cad)) == (2.0, "", [0, 2])
    assert (of_cad.of["weakest"], of_cad["weakest_at"].value) == ("Strong", 2.0), "it breaks more of the runs"
    summary = matrix_tables(table).tables[-1]
    line = dict(zip(summary.headings, summary.lines[0], strict=True))
    assert line["breaks at (adversaries)"] == "\u2264 2"
    assert line["weakest against"] == "Strong (\u2264 2)"
    holding = played | {weak: always(fp=1.0, liars=2), undefended(weak): always(fp=1.0, liars=2)}
    holding[ghosts("Cad", attack="Other")] = holding[ghosts("NoIntegrity", attack="Other")] = always(fp=1.0, liars=2)
    summary = matrix_tables(collected(holding)).tables[-1]  # type: ignore[arg-type]
    line = dict(zip(summary.headings, summary.lines[0], strict=True))
    assert (line["breaks at (adversaries)"], line["weakest against"]) == ("> 2", "Strong (\u2264 2)")
    assert "false alarms that happen anyway break nothing" in summary.about


# -- published figures -------------------------------------------------------------------------------------------------


def test_every_published_method_is_a_shipped_stage_or_attack() -> None:
    shipped = {*known_types(Integrity), *known_types(Attack), *known_types(Coordination), COORDINATED, UNCOORDINATED}
    for entry in PUBLISHED:
        assert {entry.method, *entry.defences, *entry.attacks} <= shipped, entry.method
        assert set(entry.quantities) <= set(QUANTITIES)
        assert entry.quantities
        assert entry.why.endswith(".")
    stages_after_papers = {"Mate", "FreeSpace", "Robosac", "Pasac", "Made", "Prbi", "PoseGuard", "Cad"}
    attacks_after_papers = {"TrustFlip", "PosePert", "BlindAreaConfusion", "PretendBenign", "Flood"}
    assert {entry.method for entry in PUBLISHED} >= stages_after_papers | attacks_after_papers


def test_a_figure_from_an_abstract_or_notes_says_that_it_was_not_checked() -> None:
    unchecked = ("abstract only, not checked", "abstract and others' notes, not checked", "title and mentions only")
    assert {entry.basis for entry in PUBLISHED} == {*unchecked, "the authors' code", "the paper's table"}
    assert {entry.method for entry in PUBLISHED if entry.figure and entry.basis == "the paper's table"} == {
        COORDINATED,
        UNCOORDINATED,
    }


def published(detected: int) -> MatrixTable:
    attacks = {
        ghosts("NoIntegrity"): always(fp=4.0, liars=2),
        ghosts("Cad"): always(fp=1.0, liars=2, detected=detected),
    }
    flood = {
        ghosts("NoIntegrity", attack="Flood"): always(fp=1.0, liars=2, cpu_s=0.3),
        ghosts("Cad", attack="Flood"): always(fp=1.0, liars=2, cpu_s=0.3, detected=detected),
    }
    return collected(NOTHING | attacks | flood)


@pytest.mark.parametrize(("detected", "share"), [(8, "1.000"), (2, "0.250")])
def test_our_numbers_next_to_published_figures_come_from_the_trials(detected: int, share: str) -> None:
    tables = published_tables(published(detected))
    (page,) = tables.tables
    lines = {line[0]: line for line in page.lines}
    assert list(lines) == ["Cad", "Flood"], "what was not played is left out"
    assert lines["Cad"][2] == "91.5 % true positives at 3 % false positives, per box"
    assert lines["Cad"][3] == "abstract only, not checked"
    assert f"observable lies detected (share): Cad {share}" in lines["Cad"][4]
    assert "missed objects added per frame without an attack: Cad 0.000" in lines["Cad"][4]
    assert lines["Flood"][4].startswith("processor time, relative to the other attacks: NoIntegrity 3.000")


@pytest.mark.parametrize(("suspended", "known"), [({}, False), ({"infra_1": 0.9}, True)])
def test_a_stage_that_suspends_nobody_has_no_share_of_moved_objects_detected(
    suspended: dict[str, float], known: bool
) -> None:
    played = NOTHING | {
        ghosts("NoIntegrity", attack="PosePert"): always(fp=0.0, liars=2),
        ghosts("Cad", attack="PosePert"): always(fp=0.0, liars=2, suspended=suspended),
    }
    (found,) = (ours for each, ours in collected(played).published if each.method == "PosePert")
    assert [value.known for ours in found for value in ours.numbers.values()] == [known]


def test_published_figures_are_written_as_csv_and_ascii_latex_with_wrapped_columns() -> None:
    tables = published_tables(published(2))
    rows = list(csv.DictReader(io.StringIO(tables.as_csv())))
    assert {row["method"] for row in rows} == {"Cad", "Flood"}
    assert [float(row["value"]) for row in rows if row["measure"] == "lies_detected"] == [0.25]
    latex = [line for line in tables.as_latex().splitlines() if not line.startswith("%")]
    assert all(line.isascii() for line in latex)
    assert latex[0].count(r"\linewidth") == len(tables.tables[0].headings)


def test_every_published_quantity_is_computed_from_trials_of_its_method() -> None:
    defences = ("NoIntegrity", *sorted({name for entry in PUBLISHED for name in entry.defences} - {"NoIntegrity"}))
    attacks = sorted({name for entry in PUBLISHED for name in entry.attacks})
    played = {cell(name): always(fp=0.0) for name in defences}
    suspended = {"infra_1": 0.9}
    for attack in attacks:
        for name in defences:
            played[ghosts(name, attack=attack)] = always(fp=2.0, liars=2, suspended=suspended, detected=4)
    table = collected(played, seeds=range(2))
    assert len(table.published) == len(PUBLISHED)
    for each, numbers in table.published:
        assert numbers, each.method
        for ours in numbers:
            assert all(value.known for value in ours.numbers.values()), (each.method, ours.numbers)
    (flip,) = (ours for each, ours in table.published if each.method == "TrustFlip")
    assert {ours.of["defence"] for ours in flip} == set(defences) - {"NoIntegrity"}
    assert {value.value for ours in flip for value in ours.numbers.values()} == {0.5}, "one of two"


# -- whole studies -----------------------------------------------------------------------------------------------------


def test_processor_time_is_that_of_the_run_without_scene_and_evaluation(monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = ["defences=NoIntegrity", "adversaries=coordinated", "kinds=poles", "attack_start_s=0.3"]
    study = definition.load("matrix", chosen)
    planned = trials.plan(study.chosen(seed=0, frames=8, runtime="inproc"), count=1)
    now_s = [0.0]

    def costly(function: Any) -> Any:
        def called(*arguments: Any) -> Any:
            now_s[0] += 100.0
            return function(*arguments)

        return called

    monkeypatch.setattr(execution.time, "process_time", lambda: now_s[0])
    monkeypatch.setattr(execution, "_resolve", costly(execution._resolve))
    monkeypatch.setattr(FieldMatrix, "evaluate", staticmethod(costly(FieldMatrix.evaluate)))
    for each in planned:
        finished = execution.run(each)
        assert finished.error == ""
        assert finished.cpu_s == 0.0
    assert now_s[0] == 300.0, "two scenes prepared, one evaluation"


@pytest.mark.heavy
@pytest.mark.usefixtures("unpainted")
def test_a_small_matrix_is_carried_out_and_resumed(tmp_path: Path) -> None:
    options = dict(trials=1, jobs=1, frames=10, runtime="inproc", out=tmp_path / "study")
    chosen = dict(defences="Cad", adversaries="coordinated", kinds="poles", counts=[2], attack_start_s=0.3)
    finished = mast.study("matrix", **options, **chosen)  # type: ignore[arg-type]
    names = {path.name for path in finished.path.iterdir()}
    expected = {f"{name}.{suffix}" for name in ("matrix", "scoreboard", "published") for suffix in ("md", "csv", "tex")}
    assert expected | {"harm_by_scene.png", "harm_by_scene.pdf", "defence_matrix.png", "report.html"} <= names
    rows = list(csv.DictReader((finished.path / "matrix.csv").open()))
    times = [float(row["value"]) for row in rows if row["measure"] == "cpu_ms" and row["scene"] == "all"]
    assert len(times) == 4
    assert min(times) > 0.0
    assert {row["n_adversaries"] for row in rows if row["measure"] == "broken"} == {"0", "2"}
    before = {name: (finished.path / name).read_bytes() for name in expected}
    kept = sorted((finished.path / "trials").iterdir())
    modified = {path: path.stat().st_mtime_ns for path in kept[1:]}
    kept[0].unlink()  # as if the study had been interrupted before this trial
    mast.study("matrix", **options, **chosen, resume=True)  # type: ignore[arg-type]
    assert {path: path.stat().st_mtime_ns for path in kept[1:]} == modified, "finished trials are not repeated"
    assert kept[0].is_file()
    for name in ("published.md", "scoreboard.md", "scoreboard.csv"):
        assert (finished.path / name).read_bytes() == before[name], "the same numbers"
