"""From what came of the trials to tables: a row per trial and metric, and an estimate per configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.metrics import CAUSES, Table, increments
from mast_zenoh.report.study_rows import NAN, Estimate, StudyRow
from mast_zenoh.study.definition import Study
from mast_zenoh.study.statistics import Moments, interval, pooled
from mast_zenoh.study.trial import Outcome

_COUNTS = ("fn", "fp", "tp", "ospa_m", "gospa_m")
_OF_RUN = ("rmse_m", "id_switches", "completeness")


class Value(NamedTuple):
    """One metric of one trial: docs/studies.md says which there are.

    who: the agent; the adversary for time_to_first_false_s; "compromised" for all compromised agents together
    std: over frames, NaN for metrics of the whole run; frames: how many, 0 for those
    """

    configuration: str
    scene: str
    seed: int
    who: str
    estimator: str
    metric: str
    value: float
    std: float = NAN
    frames: int = 0


def values(outcomes: Sequence[Outcome], baseline: str) -> list[Value]:
    """All metrics of all trials, in the order of the trials; increments where the trial's baseline is there too.

    outcomes: of trials that did not fail
    baseline: label of the configuration that the others are paired with, by scene and seed
    """
    reference = {(o.trial.scene, o.trial.seed): o for o in outcomes if o.trial.configuration == baseline}
    result: list[Value] = []
    for outcome in outcomes:
        trial = outcome.trial

        def add(who: str, estimator: str, metric: str, *numbers: Any, trial: Any = trial) -> None:
            numbers = tuple(NAN if each is None else each for each in numbers)
            result.append(
                Value(
                    trial.configuration,
                    trial.scene,
                    trial.seed,
                    who,
                    estimator,
                    metric,
                    float(numbers[0]),
                    *numbers[1:],
                )
            )

        first, last = outcome.metrics.get("scored_frames") or (0, -1)
        frames = last - first + 1
        for agent, estimators in outcome.metrics["agents"].items():
            for estimator, found in estimators.items():
                for name in _COUNTS:
                    add(agent, estimator, name, found[name]["mean"], found[name]["std"], frames)
                for name in _OF_RUN:
                    add(agent, estimator, name, found[name])
                for what, counted in found.get("causes", {}).items():
                    for cause in CAUSES:
                        add(agent, estimator, f"{what} {cause}", counted.get(cause, 0) / max(frames, 1), NAN, frames)
        for adversary, achieved in outcome.metrics["achieved"].items():
            add(adversary, "picture", "first_success_s", achieved["first_success_s_centre"])
        paired = reference.get((trial.scene, trial.seed))
        if paired is not None and trial.configuration != baseline:
            ego = _ego(outcome.metrics["agents"])
            for who, estimator, metric, mean, std, n in _increments(paired, outcome, ego):
                add(who, estimator, metric, mean, std, n)
    return result


def _ego(agents: Mapping[str, Any]) -> str:
    return "ego" if "ego" in agents else next(iter(agents))


def _increments(paired: Outcome, outcome: Outcome, ego: str) -> list[tuple[str, str, str, Any, Any, int]]:
    """What the attack adds in one trial, in the paper's columns."""
    found = increments(_scored(paired), _scored(outcome), agent=ego, compromised=outcome.compromised)
    n = found["frames"]
    result = [
        (ego, "picture", f"{name}_{which}", found[name][which]["mean"], found[name][which]["std"], n)
        for name in ("fn", "fp", "tp")
        for which in ("iob", "ioe")
    ]
    for name in ("cafn", "cafp"):
        pooled_frames = n * len(outcome.compromised)
        result.append(("compromised", "local", f"{name}_iob", found[name]["mean"], found[name]["std"], pooled_frames))
    return result


def _scored(outcome: Outcome) -> Table:
    """The rows of the frames that are scored."""
    first, last = outcome.metrics.get("scored_frames") or (0, -1)
    frame = outcome.per_frame["frame"]
    inside = (frame >= first) & (frame <= last)
    return {name: column[inside] for name, column in outcome.per_frame.items()}


def summarise(study: Study, found: Sequence[Value], seed: int) -> list[StudyRow]:
    """A row per configuration: its metrics of the ego's picture and what its attack adds. `seed`: of the bootstrap."""
    agents = list(dict.fromkeys(value.who for value in found if value.estimator == "local"))
    ego = _ego(dict.fromkeys(agents)) if agents else "ego"
    by_cell: dict[tuple[str, str], list[Value]] = {}
    for value in found:
        ours = value.who in (ego, "compromised") or value.metric == "time_to_first_false_s"
        if ours and (value.estimator == "picture" or value.who == "compromised"):
            by_cell.setdefault((value.configuration, value.metric), []).append(value)
    rows = []
    for each in study.configurations:
        estimates = {
            metric: _estimate(mine, seed, label, metric)
            for (label, metric), mine in by_cell.items()
            if label == each.label
        }
        rows.append(StudyRow(each.label, each.run, dict(each.point), estimates))
    return rows


def _estimate(mine: Sequence[Value], seed: int, label: str, metric: str) -> Estimate:
    known = [value for value in mine if not np.isnan(value.value)]
    if not known:
        return Estimate()
    # An adversary each has its own value; a trial counts once.
    trials: dict[tuple[str, int], list[float]] = {}
    for value in known:
        trials.setdefault((value.scene, value.seed), []).append(value.value)
    means = np.array([np.mean(each) for each in trials.values()])
    over_frames = [Moments(value.frames, value.value, value.std) for value in known if value.frames]
    mean, std = pooled(over_frames) if over_frames else (float(np.mean(means)), NAN)
    low, high = interval(means, seed, label, metric)
    return Estimate(mean, std, float(np.mean(means)), low, high, len(means))


def columns(found: Sequence[Value]) -> Table:
    """The values as columns."""
    return {
        name: np.array([value[index] for value in found], dtype=kind)
        for index, (name, kind) in enumerate(
            zip(Value._fields, (str, str, np.int64, str, str, str, np.float64, np.float64, np.int64), strict=True)
        )
    }


def frames(outcomes: Sequence[Outcome]) -> Table:
    """The tables per frame of all trials, one below the other, with configuration, scene and seed."""
    if not outcomes:
        return {}
    names = list(outcomes[0].per_frame)
    length = [len(outcome.per_frame["frame"]) for outcome in outcomes]
    about = {name: [getattr(o.trial, name) for o in outcomes] for name in ("configuration", "scene", "seed")}
    result: Table = {name: np.repeat(np.array(column), length) for name, column in about.items()}
    return result | {name: np.concatenate([outcome.per_frame[name] for outcome in outcomes]) for name in names}
