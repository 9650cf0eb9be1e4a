"""The numbers of a trial, their increments over the baseline, and the tables of all trials."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet
from synthetic_outcomes import FRAMES, outcome, study

from mast_zenoh.metrics.study_results import Row, Statistic, StudyFacts, StudySeries
from mast_zenoh.run_folder.tables import to_arrow
from mast_zenoh.show.findings.of_study import compare
from mast_zenoh.show.tables.study import sections
from mast_zenoh.study.numbers import Number, numbers, values
from mast_zenoh.study.store import TableWriter, table_writer
from mast_zenoh.study.tables import ParameterColumns, Samples


def by_name(numbers) -> dict[tuple[str, str, str], Number]:
    return {(each.owner, each.estimator, each.metric): each for each in numbers}


def test_all_numbers_of_all_estimators_are_listed() -> None:
    metrics = {
        "scored_frames": [10, 19],
        "agents": {
            "ego": {
                "picture_on_arrival": {"fn": {"mean": 2.0, "std": 0.5}, "rmse_m": None, "note": "text", "list": [1, 2]},
                "picture": {"causes": {"fp": {"inserted": 30}, "fn": {}}, "fp_split": {"attack": 3.0}},
                "mission": {"my_metric": {"mean": None, "std": None}, "braked": True},
            }
        },
        "driving": {"ego": {"truth": {"braking_s": 1.5}, "mission": {"braking_s": 2.0}}},
        "achieved": {"all": {"hidden": False, "share": 0.25}, "adversary_1": {"time_to_first_false_s": None}},
        "driven": {
            "ego": {"collisions": [{"object": 3}], "progress_m": 40.0, "min_gap_m": None, "behind": {"cars": 2}},
            "mobile_1": {"collisions": [], "progress_m": 90.0},
        },
        "latency_ms": {"sim_to_picture": {"p50": 3.0}},
        "frames_per_second": 200.0,
    }
    listed = by_name(numbers(metrics))
    assert listed["ego", "picture_on_arrival", "fn"] == ("ego", "picture_on_arrival", "fn", 2.0, 0.5, 10, False)
    assert np.isnan(listed["ego", "picture_on_arrival", "rmse_m"].value)
    assert listed["ego", "picture", "fp inserted"][3:6:2] == (3.0, 10), "30 in 10 frames"
    assert listed["ego", "picture", "fn clutter"].value == 0.0, "a cause that did not occur"
    assert listed["ego", "picture", "fp_split.attack"].value == 3.0
    assert np.isnan(listed["ego", "mission", "my_metric"].value)
    assert listed["ego", "mission", "braked"][3::3] == (1.0, True)
    assert listed["ego", "truth", "driving.braking_s"].value == 1.5
    assert listed["ego", "mission", "driving.braking_s"].value == 2.0
    assert listed["ego", "driven", "collisions"].value == 1.0, "of a list its length"
    assert listed["mobile_1", "driven", "collisions"].value == 0.0
    assert listed["mobile_1", "driven", "progress_m"].value == 90.0
    assert listed["ego", "driven", "behind.cars"].value == 2.0
    assert np.isnan(listed["ego", "driven", "min_gap_m"].value)
    assert listed["all", "achieved", "hidden"][3::3] == (0.0, True)
    assert np.isnan(listed["adversary_1", "achieved", "time_to_first_false_s"].value)
    assert not {"note", "list", "latency_ms", "frames_per_second"} & {metric for _, _, metric in listed}


def test_every_number_of_the_ego_has_an_increment_over_the_baseline_of_its_trial() -> None:
    attacked = {"my_metric": 5.0, "seen": True}
    before = outcome("baseline", 0, 0, fp=1.0, agents={"mission": {"my_metric": 2.0, "seen": False}})
    after = outcome("attacked", 0, 0, fp=4.0, agents={"mission": attacked, "picture": {"only_here": 1.0}})
    by_series = {(v.estimator, v.metric): v for v in values(after, before) if v.owner == "ego"}
    assert by_series["picture", "fp_iob"][3:6] == (3.0, 0.0, FRAMES), "frame by frame, in the scored frames"
    assert by_series["mission", "fp_iob"].value == 3.0
    assert by_series["local", "fp_iob"].value == 0.0
    assert by_series["mission", "rmse_m_iob"].value == pytest.approx(0.03)
    assert by_series["mission", "my_metric_iob"].value == 3.0
    assert by_series["mission", "seen_iob"].value == 1.0
    assert by_series["picture", "fp_ioe"].value == 4.0
    assert ("picture", "only_here_iob") not in by_series, "the baseline has no such number"
    assert not any(v.metric.endswith("_iob") for v in values(before, before)), "the baseline itself"
    assert not any(v.metric.endswith("_iob") for v in values(after, None)), "its baseline failed"


def test_each_parameter_of_the_grid_is_a_column_of_its_type() -> None:
    points = {
        "a": {"n": 1, "x": 0.5, "kind": "static", "on": True, "mixed": 3},
        "b": {"n": 2, "x": 2, "kind": "moving", "on": False, "mixed": "all"},
    }
    grid_study = study(points)
    own = pyarrow.schema([("configuration", pyarrow.string()), ("value", pyarrow.float64())])
    columns = ParameterColumns(grid_study, own.names)
    rows = [
        columns.add(pyarrow.table({"configuration": [label], "value": [1.0]}), label)
        for label in ("baseline", "b", "a")
    ]
    with_columns = pyarrow.concat_tables(rows)
    assert with_columns.schema == columns.add(own.empty_table(), "").schema
    assert with_columns.column_names == ["configuration", "n", "x", "kind", "on", "mixed", "value"]
    values = with_columns.to_pydict()
    assert values["n"] == [None, 2, 1]
    assert values["x"] == [None, 2.0, 0.5]
    assert values["kind"] == [None, "moving", "static"]
    assert values["on"] == [None, "False", "True"], "text: booleans are not numbers"
    assert values["mixed"] == [None, "all", "3"]
    assert pyarrow.types.is_integer(with_columns.schema.field("n").type)
    assert pyarrow.types.is_floating(with_columns.schema.field("x").type)


def test_a_parameter_and_a_user_metric_of_the_same_name_both_have_columns() -> None:
    table = pyarrow.table({"configuration": ["a"], "clearance": [1.5]})
    columns = ParameterColumns(study({"a": {"clearance": 7}}), table.column_names)
    assert columns.add(table, "a").to_pydict() == {"configuration": ["a"], "grid.clearance": [7], "clearance": [1.5]}


def test_tables_of_trials_are_joined_with_nulls_for_missing_columns(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(TableWriter, "ROW_GROUP", 3)
    text = pyarrow.dictionary(pyarrow.int32(), pyarrow.string())
    schema = pyarrow.schema([("name", text), ("mine", pyarrow.float64())])
    pieces = [{"name": [name] * 2, **({"mine": [float(i)] * 2} if i else {})} for i, name in enumerate("abc")]
    with table_writer(tmp_path / "t.parquet", schema) as file:
        for piece in pieces:
            file.append(to_arrow(piece))
        assert not (tmp_path / "t.parquet").exists()
    table = parquet.read_table(tmp_path / "t.parquet")
    assert table.to_pydict() == {"name": list("aabbcc"), "mine": [None, None, 1.0, 1.0, 2.0, 2.0]}
    assert parquet.read_metadata(tmp_path / "t.parquet").num_row_groups == 2
    with pytest.raises(ZeroDivisionError), table_writer(tmp_path / "failed.parquet", schema):
        raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["t.parquet"]


def number(row: Row, metric: str, estimator: str = "picture", owner: str = "") -> Statistic:
    """A number of a row, by default of the ego."""
    return row.get(StudySeries(owner, estimator, metric))


def summary(outcomes, seeds: int, scenes: int = 2):
    samples = Samples(study({"attacked": {}}, scenes), range(seeds))
    of = {(each.trial.configuration, each.trial.scene, each.trial.seed): each for each in outcomes}
    for (_, scene, seed), each in of.items():
        samples.add(each, values(each, of.get(("baseline", scene, seed))))
    return {row.configuration: row for row in samples.rows()}


def test_intervals_are_clipped_to_possible_values_except_differences() -> None:
    """Six seeds, one differs: Student's t interval extends beyond 0, or 1."""
    rare = [0.0, 0.0, 0.0, 0.0, 0.0, 0.6]
    done = []
    for seed, value in enumerate(rare):
        achieved = {"all": {"moved_share_centre": 1.0 - value, "inserted_s_ego": value, "hidden": value}}
        own = {"mission": {"completeness": 1.0 - value, "my_metric": value, "fp_split": {"attack": value}}}
        driving = {"ego": {"mission": {"brake_share": 1.0 - value, "corridor_false": value}}}
        own["mission"]["causes"] = {"fp": {"inserted": int(10 * value)}, "fn": {}}
        done.append(outcome("baseline", 0, seed, fp=1.0))
        done.append(outcome("attacked", 0, seed, fp=value, agents=own, achieved=achieved, driving=driving))
    row = summary(done, seeds=6, scenes=1)["attacked"]
    for metric, estimator, adversary in (
        *((name, "achieved", "all") for name in ("moved_share_centre", "inserted_s_ego", "hidden")),
        *((name, "mission", "") for name in ("completeness", "fp_split.attack", "fp inserted")),
        *((f"driving.{name}", "mission", "") for name in ("brake_share", "corridor_false")),
        ("fp", "picture", ""),
    ):
        each = number(row, metric, estimator, adversary)
        share = each.value > 0.5
        assert (each.high if share else each.low) == (1.0 if share else 0.0), metric
        assert each.low < each.value < each.high
    assert number(row, "my_metric", "mission").low < 0.0, "a user's metric may have any range"
    assert number(row, "fp_iob").low < -1.0 < number(row, "fp_iob").high
    assert number(row, "fp_ioe").low < 0.0


def test_intervals_of_a_users_metric_are_clipped_to_the_range_of_its_class() -> None:
    described = {"my_metric": {"unit": "objects", "range": [0.0, None]}}
    trials = [
        outcome(label, 0, seed, fp=1.0, agents={"mission": {"my_metric": value}}, own_metrics=described)
        for label in ("baseline", "attacked")
        for seed, value in enumerate([0.0, 0.0, 0.0, 0.0, 0.0, 0.6])
    ]
    row = summary(trials, seeds=6, scenes=1)["attacked"]
    assert number(row, "my_metric", "mission").low == 0.0


def test_critical_share_counts_trials_without_a_collision_course() -> None:
    """Five of six trials become critical, yet the mean of the times would rise."""
    done = []
    for seed in range(6):
        for label, least in (("baseline", 0.5 if seed == 0 else None), ("attacked", (0.4, 1.4)[seed > 0])):
            done.append(outcome(label, 0, seed, driving={"ego": {"mission": {"min_ttc_s": least}}}))
    done[-1] = outcome("attacked", 0, 5, driving={"ego": {"mission": {"min_ttc_s": 1.5}}})
    rows = summary(done, seeds=6, scenes=1)
    before, after = (number(rows[label], "driving.critical", "mission") for label in ("baseline", "attacked"))
    assert (before.value, after.value) == (pytest.approx(1 / 6), pytest.approx(5 / 6))
    assert before.rate
    assert 0.0 <= before.low < before.high < 1.0
    assert after.seeds == 6, "no seed is omitted"
    assert number(rows["attacked"], "driving.critical_iob", "mission").value == pytest.approx(4 / 6)
    assert not any("min_ttc_s" in series.metric for row in rows.values() for series in row.numbers)
    assert any(each.metric == "driving.min_ttc_s" for each in numbers(done[0].metrics)), "results.parquet contains it"


def test_driven_cars_have_means_increments_and_rows_but_no_mean_of_what_some_trials_lack() -> None:
    done = []
    for seed in range(6):
        for label, way_m in (("baseline", 100.0 + seed), ("attacked", 60.0 + 2 * seed)):
            ego = {"progress_m": way_m, "collisions": [{}] * (seed % 2), "min_gap_m": None if seed else 4.0}
            done.append(outcome(label, 0, seed, driven={"ego": ego, "mobile_1": {"progress_m": 5.0}}))
    row = summary(done, seeds=6, scenes=1)["attacked"]
    assert number(row, "progress_m", "driven").value == 65.0
    assert number(row, "collisions", "driven").value == 0.5
    assert number(row, "collisions", "driven").low >= 0.0
    added = number(row, "progress_m_iob", "driven")
    assert added.low < added.value == -37.5 < added.high < 0.0
    assert number(row, "progress_m", "driven", "mobile_1").value == 5.0
    assert not any("min_gap_m" in series.metric for series in row.numbers)
    assert any(each.metric == "min_gap_m" for each in numbers(done[0].metrics)), "results.parquet contains it"


def test_seeds_that_lack_a_trial_are_left_out_and_counted() -> None:
    rng = np.random.default_rng(0)
    extra = rng.normal(3.0, 1.0, (2, 8))
    done = [
        outcome(label, scene, seed, fp=1.0 + (extra[scene, seed] if label == "attacked" else 0.0))
        for label in ("baseline", "attacked")
        for scene in range(2)
        for seed in range(8)
        if (label, scene, seed) not in {("attacked", 1, 3), ("baseline", 0, 5)}
    ]
    rows = summary(done, 8)
    added = number(rows["attacked"], "fp_iob")
    outcomes = [seed for seed in range(8) if seed not in (3, 5)]
    assert (added.seeds, added.seeds_left_out(8), added.left_out, added.scenes) == (6, 2, 4, 2)
    assert added.value == pytest.approx(extra[:, outcomes].mean())
    assert added.low < added.value < added.high
    assert (number(rows["attacked"], "fp").seeds, number(rows["baseline"], "fp").seeds) == (7, 7)


def test_four_seeds_have_a_mean_but_no_interval_and_no_test() -> None:
    done = [outcome(label, 0, seed, fp=float(seed)) for label in ("baseline", "attacked") for seed in range(4)]
    row = summary(done, 4, scenes=1)["attacked"]
    assert number(row, "fp").value == 1.5
    assert np.isnan([number(row, "fp").low, number(row, "fp").high, number(row, "fp_iob").p]).all()


def test_booleans_become_success_rates_with_an_interval() -> None:
    done = [
        outcome("attacked", scene, seed, achieved={"all": {"accepted": True, "hidden": seed < 3 and scene == 0}})
        for scene in range(2)
        for seed in range(10)
    ]
    row = summary(done, 10)["attacked"]
    accepted, hidden = number(row, "accepted", "achieved", "all"), number(row, "hidden", "achieved", "all")
    assert accepted.rate
    assert (accepted.value, accepted.high) == (1.0, 1.0)
    assert 0.6 < accepted.low < 0.8
    assert hidden.value == pytest.approx(3 / 20)
    assert 0.0 < hidden.low < 0.15 < hidden.high < 1.0
    assert np.isnan(hidden.scenes_low)


def integrity(delays_s: list[float | None], false_alarms: int = 0) -> dict[str, Any]:
    """A lying agent for each delay, None: never suspended; and an honest one."""
    agents: dict[str, Any] = {
        f"infra_{index}": {"lied": True, "suspended_after_s": delay_s} for index, delay_s in enumerate(delays_s)
    }
    agents["ego"] = {"lied": False, "suspended_after_s": None}
    honest = ["ego"] if false_alarms else []
    withheld = {"false": 1.5, "true": 0.25}
    return {"agents": agents, "honest_suspended": honest, "false_alarms": false_alarms, "withheld": withheld}


def test_suspensions_delays_false_alarms_and_withheld_objects_are_numbers_of_the_defence() -> None:
    listed = {each.metric: each.value for each in numbers({"integrity": integrity([2.0, 4.0, None], 3)})}
    assert listed == {
        "lying_agents": 3.0,
        "lying_suspended": 2.0,
        "delay_s": 3.0,
        "honest_suspended": 1.0,
        "false_alarms": 3.0,
        "withheld_false": 1.5,
        "withheld_true": 0.25,
    }
    none = {each.metric: each.value for each in numbers({"integrity": integrity([None])})}
    assert np.isnan(none["delay_s"]), "nobody is suspended"


def rows(defended: bool) -> list[Row]:
    samples = Samples(study({"attacked": {}}, scenes=1), range(5))
    for seed in range(5):
        for label, delays_s in (("baseline", []), ("attacked", [1.0 + seed])):
            trial = outcome(label, 0, seed)
            if defended:
                trial.metrics["integrity"] = integrity(delays_s)  # type: ignore[index]
            samples.add(trial, values(trial, None))
    return samples.rows()


def test_the_table_of_a_study_has_the_defences_numbers_with_intervals() -> None:
    about = StudyFacts("made", "baseline", {}, (), (), None, "inproc", {}, (), {})
    tables = {each.title: each for each in sections(rows(True), about, compare(rows(True), "baseline")).every}
    table = tables["What the defence did"]
    assert table.terminal
    lines = {line[0]: dict(zip(table.headings, line, strict=True)) for line in table.lines}
    attacked = {name: text.split("\n") for name, text in lines["attacked"].items()}
    assert attacked["of these suspended"][0] == "1.00"
    assert attacked["delay s"] == ["3.00", "[1.04, 4.96]"]
    assert "baseline" in lines, "false alarms without an attack"
