"""Results of a trial: all its numbers, and its increments over the baseline."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from mast_zenoh.metrics import Table, increments
from mast_zenoh.study.numbers import NAN, Number, ego, numbers, scored_frames
from mast_zenoh.study.trial import Outcome, Trial

#: The agent name of numbers of all compromised agents together.
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


def values(outcome: Outcome, baseline: Outcome | None) -> list[Number]:
    """All numbers of a successful trial, and its increments over the baseline.

    baseline: the outcome of the baseline in the same scene with the same seed; None: no increments
    """
    result = list(numbers(outcome.metrics))
    if baseline is not None and baseline is not outcome:
        result += _increments_over_baseline(baseline, outcome, result)
        result += _paper_increments(baseline, outcome)
    return result


def _increments_over_baseline(
    baseline: Outcome, outcome: Outcome, attacked_numbers: Sequence[Number]
) -> Iterator[Number]:
    """The ego's numbers minus the baseline's, named `<metric>_iob`.

    Means over frames are subtracted frame by frame, over the scored frames in which both runs have a value.
    """
    agent = ego(outcome.metrics)
    baseline_values = {
        (each.estimator, each.metric): each.value for each in numbers(baseline.metrics) if each.owner == agent
    }
    tables = [_rows_by_estimator(_scored_rows(each), agent) for each in (baseline, outcome)]
    for number in attacked_numbers:
        if number.owner != agent or (number.estimator, number.metric) not in baseline_values:
            continue
        name = f"{number.metric}_iob"
        series = [table.get(number.estimator, {}) for table in tables] if number.frames else [{}]
        if all(number.metric in each for each in series):
            differences = _frame_by_frame(series[0], series[1], number.metric)
            mean, std = (differences.mean(), differences.std()) if len(differences) else (NAN, NAN)
            yield Number(agent, number.estimator, name, float(mean), float(std), len(differences))
        else:
            yield Number(agent, number.estimator, name, number.value - baseline_values[number.estimator, number.metric])


def _paper_increments(baseline: Outcome, outcome: Outcome) -> Iterator[Number]:
    """Increments over the ego alone (IoE), and increments of the compromised agents."""
    agent = ego(outcome.metrics)
    # Without the same agents in the baseline, as in a sweep over their number, there is nothing to compare them with.
    known = set(np.unique(baseline.per_frame["agent"]).tolist())
    compromised = outcome.compromised if known.issuperset(outcome.compromised) else ()
    summary = increments(_scored_rows(baseline), _scored_rows(outcome), agent=agent, compromised=compromised)
    n = summary["frames"]
    rows = [(agent, "picture", f"{name}_ioe", summary[name]["ioe"], n) for name in ("fn", "fp", "tp")]
    pooled_frames = n * len(compromised)
    for estimator, suffix in (("local", ""), ("picture", "_centre")):
        rows += [
            (COMPROMISED, estimator, f"{name}_iob", summary[name + suffix], pooled_frames) for name in ("cafn", "cafp")
        ]
    for agent, estimator, metric, content, frames in rows:
        mean, std = (NAN if content[each] is None else content[each] for each in ("mean", "std"))
        yield Number(agent, estimator, metric, mean, std, frames)


def _scored_rows(outcome: Outcome) -> Table:
    """The rows of the frames that are scored."""
    first, last = scored_frames(outcome.metrics)
    frame = outcome.per_frame["frame"]
    scored = (frame >= first) & (frame <= last)
    return {name: column[scored] for name, column in outcome.per_frame.items()}


def _rows_by_estimator(table: Table, agent: str) -> dict[str, Table]:
    """The rows of one agent by estimator."""
    agent_rows = table["agent"] == agent
    rows = {name: column[agent_rows] for name, column in table.items()}
    return {
        str(estimator): {name: column[rows["estimator"] == estimator] for name, column in rows.items()}
        for estimator in np.unique(rows["estimator"])
    }


def _frame_by_frame(before: Table, after: Table, metric: str) -> Any:
    """(n,) differences `after` minus `before` in the frames where both have a value."""
    _, after_rows, before_rows = np.intersect1d(after["frame"], before["frame"], return_indices=True)
    differences = after[metric][after_rows].astype(np.float64) - before[metric][before_rows]
    return differences[~np.isnan(differences)]


def columns(trial: Trial, trial_numbers: Sequence[Number]) -> Table:
    """The rows of results.parquet of one trial."""
    key = (trial.configuration, trial.scene, trial.seed)
    rows = [key + number[:6] for number in trial_numbers]
    by_column = list(zip(*rows, strict=True)) if rows else [()] * len(_COLUMNS)
    return {
        name: np.array(column, dtype=kind) for (name, kind), column in zip(_COLUMNS.items(), by_column, strict=True)
    }


def frames(outcome: Outcome) -> Table:
    """The rows of frames.parquet of one trial."""
    trial, count = outcome.trial, len(outcome.per_frame["frame"])
    key = {"configuration": trial.configuration, "scene": trial.scene, "seed": trial.seed}
    return {name: np.full(count, value) for name, value in key.items()} | outcome.per_frame
