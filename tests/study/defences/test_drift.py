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
from mast_zenoh.metrics.study_results import DriftRow
from mast_zenoh.report.tables.limits import drift_tables
from mast_zenoh.study import definition, trials
from mast_zenoh.study.defences import DriftCell
from mast_zenoh.study.defences.drift import (
    EVIDENCE,
    INDEPENDENT_PER_S,
    TRACK_SD_M,
    Collection,
    Episode,
    ViewerRange,
    drift_floor_s,
    episodes,
    offset_floor_s,
    speed_up,
)


@pytest.mark.parametrize(("offset_m", "delay_s"), [(0.3, 14.07), (0.5, 5.07), (1.0, 1.27)])
def test_a_constant_offset_takes_as_long_as_its_evidence(offset_m: float, delay_s: float) -> None:
    assert offset_floor_s(offset_m) == pytest.approx(delay_s, abs=0.01)


@pytest.mark.parametrize(("rate_mps", "offset_m"), [(0.05, 0.57), (0.1, 0.72), (0.2, 0.91)])
def test_a_drift_reaches_an_offset_before_anybody_can_know(rate_mps: float, offset_m: float) -> None:
    assert rate_mps * drift_floor_s(rate_mps) == pytest.approx(offset_m, abs=0.01)


@given(st.floats(0.01, 1.0))
def test_the_evidence_of_a_drift_is_the_sum_of_that_of_its_offsets(rate_mps: float) -> None:
    steps = 2000
    step_s = drift_floor_s(rate_mps) / steps
    offsets = (rate_mps * (index + 0.5) * step_s for index in range(steps))
    evidence = sum(INDEPENDENT_PER_S * step_s * offset**2 / (2.0 * TRACK_SD_M**2) for offset in offsets)
    assert evidence == pytest.approx(EVIDENCE, rel=1e-4)


def test_eight_witnesses_need_half_the_time_and_none_never_know() -> None:
    assert speed_up([0, 1, 8]).tolist() == pytest.approx([0.0, 1.0, 2.0])


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("inf"), float("nan")])
def test_what_does_not_move_has_no_floor(wrong: float) -> None:
    with pytest.raises(ValueError, match="offset_m"):
        offset_floor_s(wrong)
    with pytest.raises(ValueError, match="rate_mps"):
        drift_floor_s(wrong)


PERIOD_S = 0.1
TWO, TWO_OR_MORE, ANY = ViewerRange(2, 2), ViewerRange(2, None), ViewerRange(1, None)


def of(
    viewers: str, suspended_s: float | None = None, viewer_range: ViewerRange = TWO, start_s: float = 4.0
) -> list[Episode]:
    """Episodes of one track; viewers: the number in each frame, "-" where it is not displaced."""
    frames = [(index, int(each)) for index, each in enumerate(viewers) if each != "-"]
    times = [start_s + index * PERIOD_S for index, _ in frames]
    offset = [0.1 * (index + 1) for index, _ in frames]
    return episodes(times, [7] * len(frames), [count for _, count in frames], offset, suspended_s, viewer_range)


def test_an_episode_ends_with_the_suspension() -> None:
    (episode,) = of("2" * 21, suspended_s=5.5)
    assert (episode.length_s, episode.watched_s, episode.detected) == (2.0, 1.5, True)
    assert episode.offset_m == pytest.approx(1.6)
    assert episode.speed_up == pytest.approx(2.0 ** (1.0 / 3.0))


def test_without_a_suspension_it_is_censored_at_its_end() -> None:
    (episode,) = of("2" * 21)
    assert (episode.length_s, episode.watched_s, episode.detected) == (2.0, 2.0, False)


def test_a_suspension_after_its_end_is_no_detection() -> None:
    (episode,) = of("2" * 21, suspended_s=9.0)
    assert (episode.watched_s, episode.detected) == (2.0, False)


def test_what_is_displaced_after_the_suspension_is_left_out() -> None:
    assert of("2" * 21, suspended_s=4.0) == []
    assert of("----------" + "2" * 11, suspended_s=4.5) == []


def test_another_number_of_viewers_ends_it_after_half_a_second() -> None:
    assert of("2" * 11 + "1111" + "2" * 6)[0].length_s == 2.0
    assert of("2" * 11 + "11111" + "2" * 6)[0].length_s == 1.0
    assert of("2" * 11 + "-----" + "2" * 6)[0].length_s == 1.0


def test_a_clock_starts_only_where_nothing_was_known_before() -> None:
    assert of("3333" + "2" * 11) == [], "three agents saw it before"
    assert of("1111" + "2" * 11)[0].length_s == 1.0, "one witness decides nothing"
    assert of("0000" + "1" * 11, viewer_range=ViewerRange(1, 1))[0].length_s == 1.0
    assert of("2222" + "1" * 11, viewer_range=ViewerRange(1, 1)) == []


def test_an_open_range_goes_on_while_viewers_change() -> None:
    (episode,) = of("22223334441112222", viewer_range=TWO_OR_MORE)
    assert episode.length_s == 1.6
    (episode,) = of("1" * 10 + "8" * 10, viewer_range=ANY)
    assert episode.speed_up == pytest.approx(1.5), "one witness, then eight: mean of 1 and 2"


def test_each_track_has_its_own_clock() -> None:
    times = [4.0, 4.1, 4.2, 5.0, 5.1, 5.2]
    result = episodes(times, [1, 1, 1, 2, 2, 2], [2] * 6, [0.5] * 6, 5.1, TWO)
    assert [(each.watched_s, each.detected) for each in result] == [(0.2, False), (0.1, True)]


def test_only_what_lasts_long_enough_is_judged() -> None:
    (short,) = of("2" * 100)
    (long,) = of("2" * 101, suspended_s=14.0)
    assert not short.judged_within(10.0)
    assert long.judged_within(10.0)
    assert long.detected_within(10.0)
    assert not long.detected_within(9.9)


def test_nothing_displaced_has_no_episodes() -> None:
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
