"""How soon a displaced object is noticed: episodes, the least delay that is possible, and the table."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from defence_outcomes import outcome
from hypothesis import given
from hypothesis import strategies as st

import mast_zenoh as mast
from mast_zenoh import scenario
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.metrics.study_results import Row
from mast_zenoh.study import definition, trials
from mast_zenoh.study.defences.drift import (
    EVIDENCE,
    INDEPENDENT_PER_S,
    TRACK_SD_M,
    Drift,
    Episode,
    ViewerRange,
    drift_floor_s,
    episodes,
    offset_floor_s,
    speed_up,
)
from mast_zenoh.study.defences.kinds import Factors


def test_the_least_delay_is_that_of_enough_evidence_and_a_drift_goes_further_meanwhile() -> None:
    for offset_m, delay_s in ((0.3, 14.07), (0.5, 5.07), (1.0, 1.27)):
        assert offset_floor_s(offset_m) == pytest.approx(delay_s, abs=0.01)
    for rate_mps, offset_m in ((0.05, 0.57), (0.1, 0.72), (0.2, 0.91)):
        assert rate_mps * drift_floor_s(rate_mps) == pytest.approx(offset_m, abs=0.01)
    assert speed_up([0, 1, 8]).tolist() == pytest.approx([0.0, 1.0, 2.0]), "eight witnesses need half the time"
    for wrong in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(ValueError, match="offset_m"):
            offset_floor_s(wrong)
        with pytest.raises(ValueError, match="rate_mps"):
            drift_floor_s(wrong)


@given(st.floats(0.01, 1.0))
def test_the_evidence_of_a_drift_is_the_sum_of_that_of_its_offsets(rate_mps: float) -> None:
    steps = 2000
    step_s = drift_floor_s(rate_mps) / steps
    offsets = (rate_mps * (index + 0.5) * step_s for index in range(steps))
    evidence = sum(INDEPENDENT_PER_S * step_s * offset**2 / (2.0 * TRACK_SD_M**2) for offset in offsets)
    assert evidence == pytest.approx(EVIDENCE, rel=1e-4)


PERIOD_S = 0.1
ONE, TWO, TWO_OR_MORE, ANY = ViewerRange(1, 1), ViewerRange(2, 2), ViewerRange(2, None), ViewerRange(1, None)


def of(
    viewers: str, suspended_s: float | None = None, viewer_range: ViewerRange = TWO, start_s: float = 4.0
) -> list[Episode]:
    """Episodes of one track; viewers: the number in each frame, "-" where it is not displaced."""
    frames = [(index, int(each)) for index, each in enumerate(viewers) if each != "-"]
    times = [start_s + index * PERIOD_S for index, _ in frames]
    offset = [0.1 * (index + 1) for index, _ in frames]
    return episodes(times, [7] * len(frames), [count for _, count in frames], offset, suspended_s, viewer_range)


@pytest.mark.parametrize(
    ("viewers", "suspended_s", "viewer_range", "expected"),
    [
        ("2" * 21, 5.5, TWO, (2.0, 1.5, True)),
        ("2" * 21, None, TWO, (2.0, 2.0, False)),
        ("2" * 21, 9.0, TWO, (2.0, 2.0, False)),  # a suspension after its end is no detection
        ("2" * 21, 4.0, TWO, None),  # what is displaced after the suspension is left out
        ("-" * 10 + "2" * 11, 4.5, TWO, None),
        ("2" * 11 + "1111" + "2" * 6, None, TWO, (2.0, 2.0, False)),  # others end it after half a second
        ("2" * 11 + "11111" + "2" * 6, None, TWO, (1.0, 1.0, False)),
        ("2" * 11 + "-----" + "2" * 6, None, TWO, (1.0, 1.0, False)),
        ("3333" + "2" * 11, None, TWO, None),  # three agents saw it before
        ("1111" + "2" * 11, None, TWO, (1.0, 1.0, False)),  # one witness decides nothing
        ("0000" + "1" * 11, None, ONE, (1.0, 1.0, False)),
        ("2222" + "1" * 11, None, ONE, None),
        ("2222" + "3" * 11, None, ViewerRange(3, 3), None),
        ("22223334441112222", None, TWO_OR_MORE, (1.6, 1.6, False)),
    ],
)
def test_an_episode_ends_with_the_suspension_or_with_other_viewers(
    viewers: str, suspended_s: float | None, viewer_range: ViewerRange, expected: tuple[float, float, bool] | None
) -> None:
    result = of(viewers, suspended_s, viewer_range)
    assert [(e.length_s, e.watched_s, e.detected) for e in result][:1] == ([expected] if expected else [])


def test_an_episode_has_the_offset_at_its_end_and_the_mean_speed_up_of_its_viewers() -> None:
    (episode,) = of("2" * 21, suspended_s=5.5)
    assert episode.offset_m == pytest.approx(1.6)
    assert episode.speed_up == pytest.approx(2.0 ** (1.0 / 3.0))
    (episode,) = of("1" * 10 + "8" * 10, viewer_range=ANY)
    assert episode.speed_up == pytest.approx(1.5), "one witness, then eight: mean of 1 and 2"


def test_each_track_has_its_own_clock() -> None:
    times = [4.0, 4.1, 4.2, 5.0, 5.1, 5.2]
    result = episodes(times, [1, 1, 1, 2, 2, 2], [2] * 6, [0.5] * 6, 5.1, TWO)
    assert [(each.watched_s, each.detected) for each in result] == [(0.2, False), (0.1, True)]
    assert episodes([], [], [], [], None, ANY) == []


@given(st.text("01234-", min_size=1, max_size=60), st.integers(0, 70))
def test_a_suspension_changes_what_is_watched_and_never_how_long_it_lasts(viewers: str, after: int) -> None:
    suspended_s = 4.0 + after * PERIOD_S
    whole = of(viewers, None, ANY)
    watched = of(viewers, suspended_s, ANY)
    assert [each.length_s for each in watched] in ([], [each.length_s for each in whole])
    for each in watched:
        assert 0.0 <= each.watched_s <= each.length_s + 1e-9
        assert each.detected or each.watched_s == each.length_s
        assert np.isfinite(each.speed_up)


@given(st.permutations(list(range(12))))
def test_the_order_of_rows_does_not_matter(order: list[int]) -> None:
    times = np.tile(4.0 + PERIOD_S * np.arange(6), 2)
    track, viewers = np.repeat([3, 5], 6), np.array([2, 2, 3, 2, 2, 1, 1, 2, 2, 2, 2, 2])
    offset = np.linspace(0.1, 1.2, 12)
    rows = np.array(order)
    shuffled = episodes(times[rows], track[rows], viewers[rows], offset[rows], 4.4, TWO_OR_MORE)
    expected = episodes(times, track, viewers, offset, 4.4, TWO_OR_MORE)
    assert sorted(shuffled, key=lambda each: each.length_s) == sorted(expected, key=lambda each: each.length_s)


OFFSET, DRIFT = Factors(offset_m=0.5, rate_mps=None, agents=5), Factors(offset_m=2.0, rate_mps=0.1, agents=5)


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


def collected(factors: Factors, *trials: dict[str, Any]) -> Drift:
    collection = Drift({"a": factors}, ["junction"], range(len(trials)))
    for seed, each in enumerate(trials):
        collection.add(outcome("a", "junction", seed, {"defence": each}))
    return collection


def rows(factors: Factors, *trials: dict[str, Any]) -> dict[str, Row]:
    """The rows by number of viewers."""
    return {row.of["viewers"]: row for row in collected(factors, *trials).table()}


def values(row: Row, *names: str) -> list[float]:
    return [row.numbers[name].value for name in names]


def test_delays_are_compared_with_the_floor_of_as_many_witnesses() -> None:
    row = rows(OFFSET, trial(8.0), trial(10.0), trial(None))["2"]
    floor_s = 5.067 / 2.0 ** (1.0 / 3.0)
    assert [*values(row, "episodes", "detected"), row.trials] == [3, 2, 3]
    assert values(row, "delay_s", "floor_s", "ratio") == pytest.approx([6.0, floor_s, 6.0 / floor_s], rel=1e-3)


def test_the_share_within_ten_seconds_counts_runs_that_last_as_long() -> None:
    row = rows(OFFSET, trial(8.0), trial(15.0), trial(None), trial(None, frames=50))["2"]
    assert values(row, "judged", "within") == [3, pytest.approx(1.0 / 3.0)]
    # One of four is noticed after 4 s; the one that ends after 4.9 s is censored.
    assert values(row, "noticed") == [pytest.approx(0.25)]
    unknown = rows(OFFSET, trial(8.0, frames=50), trial(None, frames=50))["2"]
    assert not unknown.numbers["noticed"].known, "nobody was watched for as long"
    assert rows(OFFSET, trial(8.0, frames=50))["2"].numbers["noticed"].value == 1.0


def test_the_offset_of_a_drift_is_that_at_the_suspension() -> None:
    row = rows(DRIFT, trial(12.0), trial(14.0), trial(16.0))["2"]
    reached_m, floor_m, floor_s = values(row, "offset_reached_m", "floor_m", "floor_s")
    assert (reached_m, floor_m) == (pytest.approx(1.0), pytest.approx(0.1 * floor_s))


def test_whole_runs_count_from_the_first_lie_regardless_of_viewers() -> None:
    row = rows(OFFSET, trial(5.0, viewers=0), trial(None, viewers=0))[""]
    assert values(row, "episodes", "detected", "delay_s") == [2, 1, pytest.approx(1.0)]


def test_a_run_without_a_lie_counts_nowhere() -> None:
    nothing = {"first_lie_s": None, "suspended_s": None, "end_s": 24.0}
    empty: dict[str, list[float]] = {name: [] for name in ("time_s", "track", "viewers", "offset_m")}
    by_viewers = rows(OFFSET, nothing | {"displaced": empty})
    assert all([*values(row, "episodes"), row.trials] == [0, 0] for row in by_viewers.values())
    assert not by_viewers["2 or more"].numbers["delay_s"].known


def test_what_fewer_than_half_notice_is_not_reached() -> None:
    collection = collected(OFFSET, trial(8.0), trial(None), trial(None))
    table = collection.table()
    assert math.isinf(next(row for row in table if row.of["viewers"] == "2").numbers["delay_s"].value)
    written = collection.tables(table)
    assert "not reached" in written.as_markdown()
    assert ",inf," in written.as_csv()
    latex = written.as_latex()
    assert latex.count(r"\begin{tabular}") == latex.count(r"\end{tabular}") == 2
    assert "not reached & " in latex


def test_the_liar_moves_one_object_and_hears_nothing_of_its_suspension() -> None:
    study = definition.load("drift", ["agents=(3,)"])
    assert study.configurations[0].label == "3 agents offset 0.3 m"
    assert study.kind is Drift
    settings = [*study.configurations[0].settings, "scene=intersection:60", "placement_frames=8"]
    _, content = scenario.load("defence_cell", settings)
    (adversary,) = content["adversaries"].values()
    assert (adversary["attack"]["limit_m"], adversary["attack"]["budget"]) == (0.3, 1.0)
    assert not any("knowledge" in rewrite for rewrite in content["keyexpr"]["rewrites"])


@pytest.mark.parametrize("name", ["drift", "breakdown"])
def test_calibration_data_are_refused(name: str) -> None:
    study = definition.load(name, ["scenes=intersection:3"])
    with pytest.raises(ConfigurationError, match="intersection:3: thresholds were calibrated"):
        trials.plan(study.chosen(seed=0, frames=8, runtime="inproc"), count=1)


@pytest.mark.usefixtures("unpainted")
def test_a_small_study_is_carried_out(tmp_path: Path) -> None:
    settings = dict(scenes="intersection:60", agents=(3,), offsets_m=(1.0,), rates_mps=(), attack_start_s=0.5)
    finished = mast.study("drift", trials=1, jobs=1, frames=20, out=tmp_path / "study", **settings)  # type: ignore[arg-type]
    assert {"drift.md", "drift.csv", "report.html"} <= {path.name for path in finished.path.iterdir()}
    lines = (finished.path / "drift.csv").read_text().splitlines()
    assert lines[1].startswith("3 agents offset 1 m,1.0,,,episodes,1.0,"), "one of one trial is a row"
