"""From the outcome of a trial to its results: all its numbers, and what its attack adds to the baseline's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from mast_zenoh.metrics import Table, increments
from mast_zenoh.study.numbers import NAN, Number, numbers
from mast_zenoh.study.trial import Outcome, Trial

#: Stands in the place of an agent for all compromised agents together.
COMPROMISED = "compromised"
#: The columns of results.parquet, and their types.
_COLUMNS = {
    "configuration": str,
    "scene": str,
    "seed": np.int64,
    "who": str,
    "estimator": str,
    "metric": str,
    "value": np.float64,
    "std": np.float64,
    "frames": np.int64,
}


def values(outcome: Outcome, paired: Outcome | None) -> list[Number]:
    """All numbers of a trial that did not fail, and what its attack adds to them.

    paired: the trial of the baseline in the same scene with the same seed; None: there is none to compare with
    """
    result = list(numbers(outcome.metrics))
    if paired is not None and paired is not outcome:
        result += _over_baseline(paired, outcome, result)
        result += _of_the_paper(paired, outcome)
    return result


def ego(agents: Mapping[str, Any]) -> str:
    """The agent from which everything is seen: the one named `ego`, else the first."""
    return "ego" if "ego" in agents else next(iter(agents), "ego")


def _over_baseline(paired: Outcome, outcome: Outcome, numbers_attacked: Sequence[Number]) -> Iterator[Number]:
    """Every number of the ego less that of the baseline, `<metric>_iob`; frame by frame where it is a mean over frames.

    Frame by frame takes the scored frames in which both runs have a value.
    """
    who = ego(outcome.metrics.get("agents", {}))
    before = {(each.estimator, each.metric): each.value for each in numbers(paired.metrics) if each.who == who}
    tables = [_of_agent(_scored(each), who) for each in (paired, outcome)]
    for number in numbers_attacked:
        if number.who != who or (number.estimator, number.metric) not in before:
            continue
        name = f"{number.metric}_iob"
        series = [table.get(number.estimator, {}) for table in tables] if number.frames else [{}]
        if all(number.metric in each for each in series):
            added = _frame_by_frame(series[0], series[1], number.metric)
            mean, std = (added.mean(), added.std()) if len(added) else (NAN, NAN)
            yield Number(who, number.estimator, name, float(mean), float(std), len(added))
        else:
            yield Number(who, number.estimator, name, number.value - before[number.estimator, number.metric])


def _of_the_paper(paired: Outcome, outcome: Outcome) -> Iterator[Number]:
    """The paper's increments that have another reference: over the ego (IoE), and of the compromised agents."""
    who = ego(outcome.metrics["agents"])
    added = increments(_scored(paired), _scored(outcome), agent=who, compromised=outcome.compromised)
    n = added["frames"]
    parts = [(who, "picture", f"{name}_ioe", added[name]["ioe"], n) for name in ("fn", "fp", "tp")]
    pooled_frames = n * len(outcome.compromised)
    parts += [(COMPROMISED, "local", f"{name}_iob", added[name], pooled_frames) for name in ("cafn", "cafp")]
    for agent, estimator, metric, content, frames in parts:
        mean, std = (NAN if content[each] is None else content[each] for each in ("mean", "std"))
        yield Number(agent, estimator, metric, mean, std, frames)


def _scored(outcome: Outcome) -> Table:
    """The rows of the frames that are scored."""
    first, last = outcome.metrics.get("scored_frames") or (0, -1)
    frame = outcome.per_frame["frame"]
    inside = (frame >= first) & (frame <= last)
    return {name: column[inside] for name, column in outcome.per_frame.items()}


def _of_agent(table: Table, agent: str) -> dict[str, Table]:
    """By estimator the rows of one agent."""
    mine = table["agent"] == agent
    rows = {name: column[mine] for name, column in table.items()}
    return {
        str(estimator): {name: column[rows["estimator"] == estimator] for name, column in rows.items()}
        for estimator in np.unique(rows["estimator"])
    }


def _frame_by_frame(before: Table, after: Table, metric: str) -> Any:
    """(n,) differences after less before, in the frames in which both are known."""
    _, a, b = np.intersect1d(after["frame"], before["frame"], return_indices=True)
    added = after[metric][a].astype(np.float64) - before[metric][b]
    return added[~np.isnan(added)]


def columns(trial: Trial, of_trial: Sequence[Number]) -> Table:
    """The rows of results.parquet of one trial."""
    about = (trial.configuration, trial.scene, trial.seed)
    rows = [about + number[:6] for number in of_trial]
    by_column = list(zip(*rows, strict=True)) if rows else [()] * len(_COLUMNS)
    return {
        name: np.array(column, dtype=kind) for (name, kind), column in zip(_COLUMNS.items(), by_column, strict=True)
    }


def frames(outcome: Outcome) -> Table:
    """The rows of frames.parquet of one trial."""
    trial, n = outcome.trial, len(outcome.per_frame["frame"])
    about = {"configuration": trial.configuration, "scene": trial.scene, "seed": trial.seed}
    return {name: np.full(n, value) for name, value in about.items()} | outcome.per_frame
