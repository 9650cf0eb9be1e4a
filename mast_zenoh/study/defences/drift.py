"""How long displaced objects stay unnoticed, from the trials of all offsets and drifts. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mast_zenoh.report.defence_rows import NAN, Measured
from mast_zenoh.report.limit_rows import DriftRow, DriftTable
from mast_zenoh.report.study_facts import plural
from mast_zenoh.study.defences.episodes import Episode, Group, episodes
from mast_zenoh.study.defences.floor import drift_floor_s, offset_floor_s
from mast_zenoh.study.defences.intervals import pooled, share_of_trials
from mast_zenoh.study.defences.limits import DriftCell
from mast_zenoh.study.defences.survival import kaplan_meier

#: s within which an offset should be detected.
LIMIT_S = 10.0
#: Two or more: a majority against the liar. One or more: everything that could be noticed at all.
_OPEN_GROUPS = (Group(2, None), Group(1, None))


@dataclass(frozen=True, slots=True)
class DriftRecord:
    """What the tables need of one trial: the content of `drift_trial.evaluate`."""

    first_lie_s: float | None
    suspended_s: float | None
    end_s: float
    displaced: Mapping[str, Sequence[Any]]

    def episodes(self, group: Group) -> list[Episode]:
        """The displaced objects in view of a number of honest agents."""
        time_s, track, viewers, offset_m = (self.displaced[name] for name in ("time_s", "track", "viewers", "offset_m"))
        return episodes(time_s, track, viewers, offset_m, self.suspended_s, group)

    def delay(self) -> tuple[float, bool] | None:
        """s from the first lie to the suspension, or to the end of the run, and whether there was one; None: no lie."""
        if self.first_lie_s is None:
            return None
        detected = self.suspended_s is not None
        until_s = self.suspended_s if self.suspended_s is not None else self.end_s
        return max(until_s - self.first_lie_s, 0.0), detected


class DriftCollection:
    """The records of all trials by cell."""

    def __init__(self, cells: Mapping[str, DriftCell], size: str) -> None:
        """cells: by label of configuration;  size: seeds and scenes, for tables."""
        self._cells, self._size = dict(cells), size
        self._records: dict[str, list[DriftRecord]] = {label: [] for label in cells}

    def add(self, label: str, part: Mapping[str, Any]) -> None:
        """Add a trial of the configuration `label`; part: what its evaluation returned."""
        self._records[label].append(DriftRecord(**part))

    def table(self) -> DriftTable:
        """The rows of all cells: whole runs, exact numbers of viewers, and open groups."""
        rows = []
        for label, records in self._records.items():
            cell = self._cells[label]
            rows.append(_whole_runs(cell, records))
            most = max((max(record.displaced["viewers"], default=0) for record in records), default=0)
            for group in (*(Group(count, count) for count in range(1, most + 1)), *_OPEN_GROUPS):
                rows.append(_row(cell, group, [record.episodes(group) for record in records]))
        return DriftTable(rows, LIMIT_S, self._size)


def one_witness_floor_s(cell: DriftCell) -> float:
    """s until one witness can know."""
    return offset_floor_s(cell.offset_m) if cell.rate_mps is None else drift_floor_s(cell.rate_mps)


def _whole_runs(cell: DriftCell, records: Sequence[DriftRecord]) -> DriftRow:
    delays = [delay for record in records if (delay := record.delay()) is not None]
    return DriftRow(
        cell.label,
        cell.offset_m,
        cell.rate_mps,
        "",
        len(delays),
        sum(detected for _, detected in delays),
        len(delays),
        _bootstrap(delays, _median),
        NAN,
        Measured(),
        Measured(),
        NAN,
        len(delays),
        share_of_trials(sum(detected and delay <= LIMIT_S + 1e-6 for delay, detected in delays), len(delays)),
        _bootstrap(delays, _noticed),
    )


def _row(cell: DriftCell, group: Group, by_trial: Sequence[Sequence[Episode]]) -> DriftRow:
    """A row of one group; by_trial: the episodes of each trial, which may have none."""
    trials = [each for each in by_trial if each]
    pooled = [episode for each in trials for episode in each]
    single_s = one_witness_floor_s(cell)
    weight = sum(episode.watched_s for episode in pooled)
    speed_up = sum(episode.speed_up * episode.watched_s for episode in pooled) / weight if weight else NAN
    floor_s = single_s / speed_up if speed_up else NAN

    def times(units: Sequence[Sequence[Episode]]) -> list[tuple[float, bool]]:
        return [(episode.watched_s, episode.detected) for unit in units for episode in unit]

    def median(value: Callable[[Episode], float]) -> Callable[[Sequence[Sequence[Episode]]], float]:
        return lambda units: _median([(value(e), e.detected) for unit in units for e in unit])

    # The first object of each trial that lasted long enough: trials are independent, objects of one trial are not.
    judged = [each for trial in trials if (each := next((e for e in trial if e.judged_within(LIMIT_S)), None))]
    drifting = cell.rate_mps is not None
    return DriftRow(
        cell.label,
        cell.offset_m,
        cell.rate_mps,
        group.title,
        len(pooled),
        sum(episode.detected for episode in pooled),
        len(trials),
        _bootstrap(trials, median(lambda e: e.watched_s)),
        floor_s,
        _bootstrap(trials, median(lambda e: e.watched_s * e.speed_up / single_s)),
        _bootstrap(trials, median(lambda e: e.offset_m)) if drifting else Measured(),
        floor_s * cell.rate_mps if cell.rate_mps is not None else NAN,
        len(judged),
        share_of_trials(sum(each.detected_within(LIMIT_S) for each in judged), len(judged)),
        _bootstrap(trials, lambda units: _noticed(times(units))),
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


def size_of(scenes: int, seeds: int) -> str:
    """Seeds and scenes, for tables."""
    return f"{plural(seeds, 'seed')} \u00d7 {plural(scenes, 'scene')}"
