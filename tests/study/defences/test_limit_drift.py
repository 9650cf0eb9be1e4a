"""The study of displaced objects."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from defence_outcomes import outcome

import mast_zenoh as mast
from mast_zenoh import scenario
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.metrics.study_results import DriftRow
from mast_zenoh.report.tables.limits import drift_tables
from mast_zenoh.study import definition, trials
from mast_zenoh.study.defences import DriftCell
from mast_zenoh.study.defences.drift import Collection

OFFSET, DRIFT = DriftCell(0.5), DriftCell(2.0, 0.1)


def trial(suspended_s: float | None, viewers: int = 2, frames: int = 201) -> dict[str, Any]:
    """One object, displaced from 4 s on; it drifts by 0.1 m/s, or is off by as much."""
    times = [4.0 + 0.1 * index for index in range(frames)]
    return {
        "first_lie_s": 4.0,
        "suspended_s": suspended_s,
        "end_s": times[-1],
        "displaced": {
            "time_s": times,
            "track": [1] * frames,
            "viewers": [viewers] * frames,
            "offset_m": [0.01 * index for index in range(frames)],
        },
    }


def rows(cell: DriftCell, *trials: dict[str, Any]) -> dict[str, DriftRow]:
    """The rows by number of viewers."""
    collection = Collection({cell.label: cell}, ["junction"], range(len(trials)))
    for seed, each in enumerate(trials):
        collection.add(outcome(cell.label, "junction", seed, {"defence": each}))
    return {row.viewers: row for row in collection.table().rows}


def test_delays_are_compared_with_the_floor_of_as_many_witnesses() -> None:
    row = rows(OFFSET, trial(8.0), trial(10.0), trial(None))["2"]
    floor_s = 5.067 / 2.0 ** (1.0 / 3.0)
    assert (row.episodes, row.detected, row.trials) == (3, 2, 3)
    assert row.delay_s.value == pytest.approx(6.0)
    assert row.floor_s == pytest.approx(floor_s, rel=1e-3)
    assert row.ratio.value == pytest.approx(6.0 / floor_s, rel=1e-3)


def test_the_share_within_ten_seconds_counts_runs_that_last_as_long() -> None:
    row = rows(OFFSET, trial(8.0), trial(15.0), trial(None), trial(None, frames=50))["2"]
    assert (row.judged, row.within.value) == (3, pytest.approx(1.0 / 3.0))
    # One of four is noticed after 4 s; the one that ends after 4.9 s is censored.
    assert row.noticed.value == pytest.approx(0.25)


def test_a_share_is_unknown_if_nobody_was_watched_for_as_long() -> None:
    row = rows(OFFSET, trial(8.0, frames=50), trial(None, frames=50))["2"]
    assert not row.noticed.known
    assert rows(OFFSET, trial(8.0, frames=50))["2"].noticed.value == 1.0


def test_the_offset_of_a_drift_is_that_at_the_suspension() -> None:
    row = rows(DRIFT, trial(12.0), trial(14.0), trial(16.0))["2"]
    assert row.offset_reached_m.value == pytest.approx(1.0)
    assert row.floor_m == pytest.approx(0.1 * row.floor_s)


def test_whole_runs_count_from_the_first_lie_regardless_of_viewers() -> None:
    row = rows(OFFSET, trial(5.0, viewers=0), trial(None, viewers=0))[""]
    assert (row.episodes, row.detected, row.delay_s.value) == (2, 1, pytest.approx(1.0))


def test_a_run_without_a_lie_counts_nowhere() -> None:
    nothing = {"first_lie_s": None, "suspended_s": None, "end_s": 24.0}
    empty: dict[str, list[float]] = {name: [] for name in ("time_s", "track", "viewers", "offset_m")}
    by_viewers = rows(OFFSET, nothing | {"displaced": empty})
    assert all(row.episodes == row.trials == 0 for row in by_viewers.values())
    assert not by_viewers["2 or more"].delay_s.known


def test_what_fewer_than_half_notice_is_not_reached() -> None:
    collection = Collection({OFFSET.label: OFFSET}, ["junction"], range(3))
    for seed, suspended_s in enumerate((8.0, None, None)):
        collection.add(outcome(OFFSET.label, "junction", seed, {"defence": trial(suspended_s)}))
    table = collection.table()
    assert math.isinf(next(row for row in table.rows if row.viewers == "2").delay_s.value)
    assert "not reached" in drift_tables(table).as_markdown()
    assert ",inf," in drift_tables(table).as_csv()
    latex = drift_tables(table).as_latex()
    assert latex.count(r"\begin{tabular}") == latex.count(r"\end{tabular}") == 2
    assert "not reached & " in latex


def test_the_liar_moves_one_object_and_hears_nothing_of_its_suspension() -> None:
    study = definition.load("drift", ["agents=(3,)"])
    assert study.configurations[0].label == "3 agents offset 0.3 m"
    assert study.evaluation == "drift"
    settings = [*study.configurations[0].settings, "scene=intersection:60", "placement_frames=8"]
    _, content = scenario.load("defence_cell", settings)
    (adversary,) = content["adversaries"].values()
    assert (adversary["attack"]["limit_m"], adversary["attack"]["budget"]) == (0.3, 1.0)
    assert not any("knowledge" in rewrite for rewrite in content["keyexpr"]["rewrites"])


@pytest.mark.parametrize("name", ["drift", "breakdown"])
def test_calibration_data_are_refused(name: str) -> None:
    study = definition.load(name, ["scenes=intersection:3"])
    with pytest.raises(ConfigurationError, match="intersection:3: thresholds were calibrated"):
        trials.plan(study, count=1, seed=0, frames=8, runtime="inproc")


def test_a_small_study_is_carried_out(tmp_path: Path) -> None:
    finished = mast.study(
        "drift",
        trials=1,
        jobs=1,
        frames=20,
        out=tmp_path / "study",
        scenes="intersection:60",
        agents=(3,),
        offsets_m=(1.0,),
        rates_mps=(),
        attack_start_s=0.5,
    )
    assert {"drift.md", "drift.csv", "report.html"} <= {path.name for path in finished.path.iterdir()}
    lines = (finished.path / "drift.csv").read_text().splitlines()
    assert lines[1].startswith("3 agents offset 1 m,1.0,,,1,0,1,1,"), "a run of two seconds with a lie, and no alarm"
