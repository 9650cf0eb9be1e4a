"""A search sees its own seeds alone, gives the same files however it is carried out, and fails loudly.

Trials are planned as always, but not played: their outcome is a known function of their parameters.
"""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from painting import leave_unpainted
from pyarrow import parquet
from synthetic_search import MOST, OPTIMUM, Synthetic, harm, write_study

from mast_zenoh.errors import ConfigurationError, Interrupted, TrialsFailed
from mast_zenoh.study import definition, execution, interface
from mast_zenoh.study.definition import Study
from mast_zenoh.study.search.plan import parse_objective
from mast_zenoh.study.tables import StudyResult

#: Files that depend on the study alone.
FILES = ("search.md", "search.csv", "candidates.csv", "search.json", "table.csv", "results.parquet")


def install(made: Synthetic, patch: pytest.MonkeyPatch) -> Synthetic:
    """Use synthetic trials. Figures are slow to draw, and tested elsewhere."""
    patch.setattr(execution, "workers", made.workers)
    patch.setattr("mast_zenoh.show.figures.study.figures_over_trials", lambda *_: {})
    leave_unpainted(patch)
    return made


@pytest.fixture
def synthetic(monkeypatch: pytest.MonkeyPatch) -> Synthetic:
    return install(Synthetic(), monkeypatch)


@dataclass(frozen=True)
class Whole:
    """A search that nothing disturbed: its folder, result and trials."""

    out: Path
    finished: StudyResult
    synthetic: Synthetic


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Whole:
    folder = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        made = install(Synthetic(), patch)
        finished = carry_out(definition.load(str(write_study(folder))), folder / "out")
    return Whole(finished.out, finished, made)


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return definition.load(str(write_study(tmp_path)))


def carry_out(study: Study, out: Path, *, jobs: int = 1, resume: bool = False, **options: Any) -> StudyResult:
    chosen: dict[str, Any] = {"trials": None, "jobs": jobs, "cluster": None, "resume": resume, **options}
    finished = interface.run(study, out, **chosen)
    assert isinstance(finished, StudyResult)
    return finished


def contents(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in FILES}


def results(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "search.json").read_text())


def lines(folder: Path, name: str) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / name).read_text().splitlines()))


@pytest.mark.heavy
def test_the_result_is_near_the_optimum_and_better_than_the_default(synthetic, tmp_path: Path) -> None:
    study = definition.load(str(write_study(tmp_path, candidates=32, batch=8)))
    finished = carry_out(study, tmp_path / "out")
    found = results(finished.out)
    for name, best in OPTIMUM.items():
        assert found["searched"]["values"][name] == pytest.approx(best, rel=0.25)
    by_label = {row["configuration"]: row for row in found["results"]}
    assert list(by_label) == ["baseline", "attacked", "searched"]
    means = {label: row["held_out"]["trial_mean"] for label, row in by_label.items()}
    assert means["baseline"] < means["attacked"] < means["searched"] <= MOST + 0.5
    pair = by_label["searched"]["over_default"]
    assert pair["trial_mean"] == pytest.approx(means["searched"] - means["attacked"])
    assert pair["low"] is None, "the offset of a seed is the same in a pair, so all differences are equal"
    assert by_label["searched"]["held_out"]["low"] < means["searched"] < by_label["searched"]["held_out"]["high"]


def test_the_search_never_sees_a_held_out_seed_and_the_reported_numbers_have_no_other(
    whole: Whole,
) -> None:
    out, synthetic = whole.out, whole.synthetic
    assert synthetic.seeds("candidate-") == {3, 4}
    assert synthetic.seeds("searched") == {5, 6, 7, 8, 9, 10}
    assert synthetic.seeds("baseline") == synthetic.seeds("attacked") == set(range(3, 11))
    assert set(parquet.read_table(out / "results.parquet")["seed"].to_pylist()) == set(range(5, 11))
    found = results(out)
    assert (found["search_seeds"], found["held_out_seeds"]) == ([3, 4], [5, 6, 7, 8, 9, 10])
    labels = set(parquet.read_table(out / "results.parquet")["configuration"].to_pylist())
    assert labels == {"baseline", "attacked", "searched"}


def test_values_are_means_over_the_seeds_that_they_belong_to(whole: Whole) -> None:
    out, synthetic = whole.out, whole.synthetic
    found = results(out)
    searched = [trial for trial in synthetic.played if trial.configuration == "searched"]
    row = found["results"][-1]
    assert row["held_out"]["trial_mean"] == pytest.approx(sum(map(harm, searched)) / 6)
    best = f"candidate-{found['searched']['candidate']}"
    tried = [trial for trial in synthetic.played if trial.configuration == best]
    assert row["search"] == pytest.approx(sum(map(harm, tried)) / 2)
    optimism = row["search"] - row["held_out"]["trial_mean"]
    assert found["searched"]["optimism"] == pytest.approx(optimism)
    baseline = found["results"][0]
    of_baseline = baseline["search"] - baseline["held_out"]["trial_mean"]
    assert found["searched"]["optimism_over_baseline"] == pytest.approx(optimism - of_baseline)
    assert found["searched"]["optimism_over_baseline"] == pytest.approx(0.0), "seeds shift all alike"
    values = [float(line["value"]) for line in lines(out, "candidates.csv")]
    assert max(values) == pytest.approx(row["search"])
    assert [float(line["best"]) for line in lines(out, "candidates.csv")] == [
        max(values[: index + 1]) for index in range(len(values))
    ]


def test_any_number_of_workers_gives_the_same_files(synthetic, study, whole: Whole, tmp_path: Path) -> None:
    out = carry_out(study, tmp_path / "out", jobs=3).out
    one, many = ([trial.digest for trial in made.played] for made in (whole.synthetic, synthetic))
    assert one != many, "outcomes came in another order"
    assert sorted(one) == sorted(many)
    assert contents(whole.out) == contents(out)


@pytest.mark.parametrize("after", [9, pytest.param(40, marks=pytest.mark.heavy)])
def test_an_interrupted_search_goes_on_to_the_same_files_and_repeats_no_trial(
    synthetic, study, whole: Whole, tmp_path: Path, after: int
) -> None:
    synthetic.interrupt_after = after
    with pytest.raises(Interrupted, match=r"--out .*cut --resume"):
        carry_out(study, tmp_path / "cut")
    assert json.loads((tmp_path / "cut" / "study.json").read_text())["status"] == "interrupted"
    assert not (tmp_path / "cut" / "search.json").exists(), "no result yet"
    synthetic.interrupt_after = None
    cut = carry_out(study, tmp_path / "cut", resume=True, jobs=2).out
    assert len(synthetic.played) == len(whole.synthetic.played)
    assert contents(whole.out) == contents(cut)


def test_a_longer_search_and_more_held_out_seeds_reuse_what_is_done(synthetic, study, tmp_path: Path) -> None:
    carry_out(study, tmp_path / "out", candidates=8)
    short = lines(tmp_path / "out", "candidates.csv")
    done, synthetic.played = {trial.digest for trial in synthetic.played}, []
    carry_out(study, tmp_path / "out", candidates=12, trials=8, resume=True)
    assert lines(tmp_path / "out", "candidates.csv")[:8] == short
    assert not done & {trial.digest for trial in synthetic.played}
    assert results(tmp_path / "out")["held_out_seeds"] == list(range(5, 13))


def test_a_failed_trial_stops_the_search_with_its_command_and_is_tried_again(
    synthetic, study, whole: Whole, tmp_path: Path
) -> None:
    synthetic.fails = (4, "candidate-6")
    with pytest.raises(TrialsFailed, match="ValueError: no plan") as raised:
        carry_out(study, tmp_path / "out")
    assert raised.value.exit_code == 24
    text = str(raised.value)
    assert "failed trials: 1" in text
    assert "candidate-6, intersection:0, seed 4" in text
    assert "mast run uncoordinated --set" in text
    assert "The search stops there" in text
    assert "--resume" in text
    stored = json.loads((tmp_path / "out" / "study.json").read_text())
    assert stored["status"] == "failed"
    assert [each["configuration"] for each in stored["trials"] if "error" in each] == ["candidate-6"]
    assert not (tmp_path / "out" / "search.json").exists()
    synthetic.fails = None
    assert contents(carry_out(study, tmp_path / "out", resume=True).out) == contents(whole.out)


def test_a_failed_held_out_trial_leaves_its_seed_out_and_is_reported(synthetic, study, tmp_path: Path) -> None:
    synthetic.fails = (7, "searched")
    finished = carry_out(study, tmp_path / "out")
    with pytest.raises(TrialsFailed, match="searched, intersection:0, seed 7"):
        finished.raise_failures()
    row = results(finished.out)["results"][-1]
    assert [row[name]["left_out"] for name in ("held_out", "over_baseline")] == [1, 1]
    assert "Left out: 1 held-out seed" in (finished.out / "search.md").read_text()
    assert json.loads((finished.out / "study.json").read_text())["status"] == "failed"


def test_all_files_are_named_and_the_page_shows_the_figure(whole: Whole) -> None:
    finished = whole.finished
    names = {path.name for path in finished.files}
    assert {"search.md", "search.csv", "candidates.csv", "search.json", "search.png", "search.pdf"} <= names
    assert all(path.is_file() for path in finished.files)
    page = finished.report.read_text()
    assert "Search over 16 candidates" in page
    assert 'href="search.csv"' in page
    stored = json.loads((finished.out / "study.json").read_text())
    assert stored["status"] == "ok"
    assert list(stored["configurations"]) == ["baseline", "attacked", "searched"]
    assert {each["configuration"] for each in stored["trials"]} >= {"candidate-1", "candidate-16", "searched"}


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (dict(ranges={"false_positive": "0..3"}), r"search\.parameters\.false_positive: 0 .*; did you mean 'false_pos"),
        (dict(ranges={"n_adversaries": "1..9"}), r"search\.parameters\.n_adversaries: 9 of '1\.\.9' is not possible"),
        (dict(ranges={"n_adversaries": "0.5..1.5"}), r"n_adversaries: 0\.5 .*expected int"),
        (dict(ranges={"region": ["in_view", "in_veiw"]}), r"region: 'in_veiw' .*did you mean 'in_view'"),
    ],
)
def test_ranges_that_the_scenario_refuses_are_named_before_anything_starts(
    synthetic, tmp_path: Path, keys: dict[str, Any], message: str
) -> None:
    study = definition.load_values(str(write_study(tmp_path)), keys)
    with pytest.raises(ConfigurationError, match=message):
        carry_out(study, tmp_path / "out")
    assert not synthetic.played
    assert not (tmp_path / "out").exists()


def test_an_unknown_objective_is_refused_after_the_first_pair_of_trials(synthetic, tmp_path: Path) -> None:
    study = definition.load_values(str(write_study(tmp_path)), dict(objective="fp + infra_7/picture/fp"))
    with pytest.raises(ConfigurationError, match=r"search\.objective: no numbers of 'infra_7' in the runs; "):
        carry_out(study, tmp_path / "out")
    assert [trial.configuration for trial in synthetic.played] == ["baseline", "attacked"]


@pytest.mark.parametrize(
    "objective", ["compromised/local/cafn_iob", "fn_ioe", "fp inserted", "mission/driving.critical", "defence/delay_s"]
)
def test_numbers_that_are_no_metrics_of_an_estimate_are_not_refused_by_name(objective: str) -> None:
    parse_objective(objective, "search.objective").check_names("search.objective")


def test_an_attack_that_begins_after_the_last_frame_is_refused(synthetic, study, tmp_path: Path) -> None:
    with pytest.raises(
        ConfigurationError, match=r"the attack of 'attacked' begins at 0\.2 s, and the trials end after"
    ):
        carry_out(study, tmp_path / "out", frames=2)


def test_an_objective_over_the_baseline_is_paired_on_the_search_seeds_too(
    synthetic, whole: Whole, tmp_path: Path
) -> None:
    study = definition.load_values(str(write_study(tmp_path)), dict(objective="fp_iob"))
    found = results(carry_out(study, tmp_path / "out").out)
    assert found["results"][0]["search"] == found["results"][0]["held_out"]["trial_mean"] == 0.0
    raw = results(whole.out)
    assert found["results"][-1]["over_baseline"]["trial_mean"] == pytest.approx(
        raw["results"][-1]["over_baseline"]["trial_mean"]
    )
