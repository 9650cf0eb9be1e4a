"""How long displaced objects stay unnoticed, from the trials of all offsets and drifts."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mast_zenoh.metrics.study_results import NAN, DriftRow, DriftTable, Measured, size_of
from mast_zenoh.report.tables.limits import drift_tables
from mast_zenoh.study.defences.drift.cell import DriftCell
from mast_zenoh.study.defences.drift.episodes import Episode, ViewerRange, episodes
from mast_zenoh.study.defences.drift.floor import drift_floor_s, offset_floor_s
from mast_zenoh.study.defences.intervals import pooled, share_of_trials
from mast_zenoh.study.defences.study_files import StudyFiles, write_files
from mast_zenoh.study.defences.survival import kaplan_meier
from mast_zenoh.study.trial import Outcome

#: s within which an offset should be detected.
LIMIT_S = 10.0
#: Two or more: a majority against the liar. One or more: everything that could be noticed at all.
_OPEN_RANGES = (ViewerRange(2, None), ViewerRange(1, None))


@dataclass(frozen=True, slots=True)
class DriftRecord:
    """What the tables need of one trial: the content of `trial.evaluate`."""

    first_lie_s: float | None
    suspended_s: float | None
    end_s: float
    displaced: Mapping[str, Sequence[Any]]

    def episodes(self, viewer_range: ViewerRange) -> list[Episode]:
        """The displaced objects in view of a number of honest agents."""
        time_s, track, viewers, offset_m = (self.displaced[name] for name in ("time_s", "track", "viewers", "offset_m"))
        return episodes(time_s, track, viewers, offset_m, self.suspended_s, viewer_range)

    def delay(self) -> tuple[float, bool] | None:
        """s from the first lie to the suspension, or to the end of the run, and whether there was one; None: no lie."""
        if self.first_lie_s is None:
            return None
        detected = self.suspended_s is not None
        until_s = self.suspended_s if self.suspended_s is not None else self.end_s
        return max(until_s - self.first_lie_s, 0.0), detected


class DriftCollection:
    """The records of all trials by cell."""

    def __init__(self, cells: Mapping[str, DriftCell], scenes: Sequence[str], seeds: Sequence[int]) -> None:
        """cells: by label of configuration;  scenes, seeds: planned for every cell."""
        self._cells, self._size = dict(cells), size_of(len(seeds), len(scenes))
        self._records: dict[str, list[DriftRecord]] = {label: [] for label in cells}

    def add(self, outcome: Outcome) -> None:
        """Add a finished trial."""
        self._records[outcome.trial.configuration].append(DriftRecord(**outcome.metrics["defence"]))

    def write(self, folder: Path) -> StudyFiles:
        """Write the tables into the study's folder."""
        table = self.table()
        tables = drift_tables(table)
        return write_files(folder, tables.texts("drift"), {}, tables.as_rich)

    def table(self) -> DriftTable:
        """The rows of all cells: whole runs, exact numbers of viewers, and open ranges."""
        rows = []
        for label, records in self._records.items():
            cell = self._cells[label]
            rows.append(_whole_runs(cell, records))
            most = max((max(record.displaced["viewers"], default=0) for record in records), default=0)
            for viewers in (*(ViewerRange(count, count) for count in range(1, most + 1)), *_OPEN_RANGES):
                rows.append(_row(cell, viewers, [record.episodes(viewers) for record in records]))
        return DriftTable(rows, LIMIT_S, self._size)


def one_witness_floor_s(cell: DriftCell) -> float:
    """s until one witness can know."""
    return offset_floor_s(cell.offset_m) if cell.rate_mps is None else drift_floor_s(cell.rate_mps)


def _whole_runs(cell: DriftCell, records: Sequence[DriftRecord]) -> DriftRow:
    delays = [delay for record in records if (delay := record.delay()) is not None]
    return DriftRow(
        label=cell.label,
        offset_m=cell.offset_m,
        rate_mps=cell.rate_mps,
        viewers="",
        episodes=len(delays),
        detected=sum(detected for _, detected in delays),
        trials=len(delays),
        delay_s=_bootstrap(delays, _median),
        floor_s=NAN,
        ratio=Measured(),
        offset_reached_m=Measured(),
        floor_m=NAN,
        judged=len(delays),
        within=share_of_trials(sum(detected and delay <= LIMIT_S + 1e-6 for delay, detected in delays), len(delays)),
        noticed=_bootstrap(delays, _noticed),
    )


def _row(cell: DriftCell, viewers: ViewerRange, by_trial: Sequence[Sequence[Episode]]) -> DriftRow:
    """A row of one range of viewers; by_trial: the episodes of each trial, which may have none."""
    trials = [each for each in by_trial if each]
    every = [episode for each in trials for episode in each]
    single_s = one_witness_floor_s(cell)
    weight = sum(episode.watched_s for episode in every)
    speed_up = sum(episode.speed_up * episode.watched_s for episode in every) / weight if weight else NAN
    floor_s = single_s / speed_up if speed_up else NAN

    def times(units: Sequence[Sequence[Episode]]) -> list[tuple[float, bool]]:
        return [(episode.watched_s, episode.detected) for unit in units for episode in unit]

    def median(value: Callable[[Episode], float]) -> Callable[[Sequence[Sequence[Episode]]], float]:
        return lambda units: _median([(value(e), e.detected) for unit in units for e in unit])

    # The first object of each trial that lasted long enough: trials are independent, objects of one trial are not.
    judged = [each for trial in trials if (each := next((e for e in trial if e.judged_within(LIMIT_S)), None))]
    drifting = cell.rate_mps is not None
    return DriftRow(
        label=cell.label,
        offset_m=cell.offset_m,
        rate_mps=cell.rate_mps,
        viewers=viewers.title,
        episodes=len(every),
        detected=sum(episode.detected for episode in every),
        trials=len(trials),
        delay_s=_bootstrap(trials, median(lambda e: e.watched_s)),
        floor_s=floor_s,
        ratio=_bootstrap(trials, median(lambda e: e.watched_s * e.speed_up / single_s)),
        offset_reached_m=_bootstrap(trials, median(lambda e: e.offset_m)) if drifting else Measured(),
        floor_m=floor_s * cell.rate_mps if cell.rate_mps is not None else NAN,
        judged=len(judged),
        within=share_of_trials(sum(each.detected_within(LIMIT_S) for each in judged), len(judged)),
        noticed=_bootstrap(trials, lambda units: _noticed(times(units))),
    )


def _bootstrap(trials: Sequence[Any], statistic: Callable[[Any], float]) -> Measured:
    return pooled(lambda rows: statistic([trials[row] for row in rows.tolist()]), len(trials))


def _median(times: Sequence[tuple[float, bool]]) -> float:
    """Median of times, some of them censored: infinite if fewer than half were detected, NaN without any."""
    if not times:
        return NAN
    median = kaplan_meier(*zip(*times, strict=True)).median_s
    return math.inf if math.isnan(median) else median


def _noticed(times: Sequence[tuple[float, bool]]) -> float:
    """Share detected within LIMIT_S, of times of which some are censored; NaN if none was watched for that long."""
    if not times:
        return NAN
    curve = kaplan_meier(*zip(*times, strict=True))
    if curve.time_s[-1] < LIMIT_S - 1e-6 and curve.undetected[-1] > 0.0:
        return NAN
    return 1.0 - float(curve.undetected[curve.time_s <= LIMIT_S + 1e-6][-1])
