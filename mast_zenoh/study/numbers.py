"""The numbers of one trial: those of its metrics, and its increments over the baseline."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.metrics import CAUSES, Table, increments
from mast_zenoh.metrics.measures import SUMMARY_NAMES
from mast_zenoh.study.trial import Trial, TrialOutcome

NAN = float("nan")
#: The estimator of an adversary's achievements.
ACHIEVED = "achieved"
#: The estimator of what the command centre's defence did.
DEFENCE = "defence"
#: Numbers of all agents together that tables show, by block: how pictures differ and are deceived, and the channel.
COOPERATION = {
    "pictures": ("difference_gospa_m", "deceived.share", "deceived.most"),
    "channel": ("busy_ratio", "sent", "arrived"),
}
#: Prefix of metrics of an estimate's consequences for driving.
DRIVING = "driving"
#: s; a trial with a smaller minimum time to collision is critical: van der Horst (1990), see `metrics.driving`.
CRITICAL_S = 1.5
_MIN_TTC, _CRITICAL = "min_ttc_s", "critical"
#: The estimator of what happened to a driven car.
DRIVEN = "driven"
#: Metrics without a mean, of estimates and of driven cars: a trial without a collision course, or without anything
#: ahead or crossing, or without a shock wave, has none, so a mean would skip it.
_SELECTIVE = frozenset({f"{DRIVING}.{_MIN_TTC}"})
_SELECTIVE_DRIVEN = frozenset({_MIN_TTC, "min_gap_m", "min_pet_s", "behind.shock_wave_mps"})

#: The agent name of numbers of all compromised agents together.
COMPROMISED = "compromised"
#: The columns of results.parquet, and their types.
COLUMNS = {
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


class Number(NamedTuple):
    """One number of one run.

    owner:     the agent; of an achievement, the adversary, or "all" for all of them; of a defence, "all"; of messages,
               their wire; the column `who`
    estimator: "local", "picture", "mission", …; ACHIEVED for achievements, DEFENCE for the defence, DRIVEN for what
               happened to a driven car
    metric:    its name; names of nested blocks are joined by dots: "fn_split.attack", "driving.braking_s"
    std:       over frames, NaN for a metric of the whole run; frames: how many, 0 for such a metric
    binary:    whether it is a boolean, as 1 or 0
    """

    owner: str
    estimator: str
    metric: str
    value: float
    std: float = NAN
    frames: int = 0
    binary: bool = False


def has_mean(estimator: str, metric: str) -> bool:
    """Whether every trial has a number, so that its mean over trials is one of all of them."""
    return metric.removesuffix("_iob") not in (_SELECTIVE_DRIVEN if estimator == DRIVEN else _SELECTIVE)


def ego(metrics: Mapping[str, Any]) -> str:
    """The agent whose estimates are scored: the one named `ego`, else the first of metrics.json."""
    agents = metrics.get("agents", {})
    return "ego" if "ego" in agents else next(iter(agents), "ego")


def scored_frames(metrics: Mapping[str, Any]) -> tuple[int, int]:
    """The first and the last scored frame of metrics.json; (0, -1): none."""
    first, last = metrics.get("scored_frames") or (0, -1)
    return first, last


def own_metrics(summary: Mapping[str, Any]) -> dict[str, float]:
    """The user's metrics of an estimate in metrics.json, by `own NAME`."""
    own = {f"own {name}": value for name, value in summary.items() if name not in SUMMARY_NAMES}
    means = {name: value["mean"] if isinstance(value, Mapping) else value for name, value in own.items()}
    return {name: NAN if value is None else float(value) for name, value in means.items()}


def numbers(metrics: Mapping[str, Any]) -> Iterator[Number]:
    """The numbers of metrics.json, in file order.

    Those below `agents`, `driving`, `driven`, `achieved`, `messages`, `pictures`, `channel` and `integrity`. `null`
    becomes NaN, true and false become 1 and 0. Of lists of a driven car, such as its collisions, their length counts.
    Other values are skipped. Every cause in `causes` gets a number of objects per frame, "fp inserted", even if it does
    not occur. These blocks hold no wall-clock times, so all numbers depend on scenario and seed alone.

    Keys:
    fp CAUSE, fn CAUSE: false and missed objects per frame of each cause
    driving.critical: whether the least time to collision is below 1.5 s (van der Horst 1990)
    lying_agents, lying_suspended: of the defence: agents that lied, and those suspended with or after their first lie
    delay_s: of the defence: from an agent's first lie to its suspension, mean over these agents; missing: none
    honest_suspended, false_alarms: of the defence: number of honest agents that it suspended, and how often
    withheld_false, withheld_true: of the defence: objects per frame that it withheld from the picture
    """
    first, last = scored_frames(metrics)
    frames = last - first + 1
    for agent, estimators in metrics.get("agents", {}).items():
        for estimator, content in estimators.items():
            yield from _flatten(agent, estimator, (), content, frames)
    for agent, estimators in metrics.get("driving", {}).items():
        for estimator, content in estimators.items():
            yield from _flatten(agent, estimator, (DRIVING,), content, frames)
            if _MIN_TTC in content:
                min_ttc = content[_MIN_TTC]
                critical = min_ttc is not None and min_ttc < CRITICAL_S
                yield Number(agent, estimator, f"{DRIVING}.{_CRITICAL}", float(critical), binary=True)
    for car, content in metrics.get(DRIVEN, {}).items():
        counted = {name: len(value) if isinstance(value, list) else value for name, value in content.items()}
        yield from _flatten(car, DRIVEN, (), counted, frames)
    for adversary, content in metrics.get(ACHIEVED, {}).items():
        yield from _flatten(adversary, ACHIEVED, (), content, frames)
    for wire, content in metrics.get("messages", {}).items():
        yield from _flatten(wire, "messages", (), content, frames)
    for block in COOPERATION:
        yield from _flatten("all", block, (), metrics.get(block, {}), frames)
    if metrics.get("integrity"):
        yield from _of_defence(metrics["integrity"])


def of_kind(kind: str, measures: Mapping[str, Any]) -> Iterator[Number]:
    """The measures of a kind of study that are single numbers, of all agents together."""
    for name, value in measures.items():
        if isinstance(value, (Real, np.bool_)):
            yield Number("all", kind, name, float(value), binary=isinstance(value, (bool, np.bool_)))


def _of_defence(integrity: Mapping[str, Any]) -> Iterator[Number]:
    """What a defence did, for all agents together; the delay is NaN if no liar was suspended."""
    liars = [agent for agent in integrity["agents"].values() if agent["lied"]]
    delays = [agent["suspended_after_s"] for agent in liars if agent["suspended_after_s"] is not None]
    withheld = integrity.get("withheld", {})
    for name, value in {
        "lying_agents": len(liars),
        "lying_suspended": len(delays),
        "delay_s": sum(delays) / len(delays) if delays else NAN,
        "honest_suspended": len(integrity["honest_suspended"]),
        "false_alarms": integrity["false_alarms"],
        "withheld_false": withheld.get("false", NAN),
        "withheld_true": withheld.get("true", NAN),
    }.items():
        yield Number("all", DEFENCE, name, float(value))


def _flatten(owner: str, estimator: str, path: tuple[str, ...], content: Any, frames: int) -> Iterator[Number]:
    if isinstance(content, Mapping) and content.keys() == {"mean", "std"}:
        mean, std = (NAN if content[name] is None else float(content[name]) for name in ("mean", "std"))
        yield Number(owner, estimator, ".".join(path), mean, std, frames)
    elif isinstance(content, Mapping) and path[-1:] == ("causes",):
        for outcome, counts in content.items():
            for cause in (*CAUSES, *(each for each in counts if each not in CAUSES)):
                yield Number(owner, estimator, f"{outcome} {cause}", counts.get(cause, 0) / max(frames, 1), NAN, frames)
    elif isinstance(content, Mapping):
        for name, part in content.items():
            yield from _flatten(owner, estimator, (*path, str(name)), part, frames)
    elif isinstance(content, bool):
        yield Number(owner, estimator, ".".join(path), float(content), binary=True)
    elif content is None or isinstance(content, (int, float)):
        yield Number(owner, estimator, ".".join(path), NAN if content is None else float(content))


def values(outcome: TrialOutcome, baseline: TrialOutcome | None) -> list[Number]:
    """All numbers of a successful trial, and its increments over the baseline.

    baseline: the outcome of the baseline in the same scene with the same seed; None: no increments

    Keys:
    NAME_iob: the ego's number minus the baseline's for the same scene and seed; means over frames, frame by frame
    fn_ioe, fp_ioe, tp_ioe: the ego's picture minus its own tracks in the same run
    cafn_iob, cafp_iob: of the compromised agents together, their own tracks (or the picture) minus those of the
        baseline
    """
    result = list(numbers(outcome.metrics))
    if baseline is not None and baseline is not outcome:
        result += _increments_over_baseline(baseline, outcome, result)
        result += _paper_increments(baseline, outcome)
    return result


def _increments_over_baseline(
    baseline: TrialOutcome, outcome: TrialOutcome, attacked_numbers: Sequence[Number]
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


def _paper_increments(baseline: TrialOutcome, outcome: TrialOutcome) -> Iterator[Number]:
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


def _scored_rows(outcome: TrialOutcome) -> Table:
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
    """The rows of results.parquet of one trial.

    Columns:
    configuration: label; a column for each parameter of a grid, and for each factor, follows it
    scene, seed: of the trial
    who: agent, car or adversary; `all`, or `compromised` for all compromised agents together
    estimator: an estimate, or `achieved`, `driven`, `messages`, `defence`, `pictures`, `channel`, or the name of a
               kind of study
    metric: name of a number of metrics.json; nested names are joined with dots, as in fp_split.attack
    value: mean over frames, or of the run
    std: over frames; missing for numbers of a whole run
    frames: number of frames
    """
    key = (trial.configuration, trial.scene, trial.seed)
    rows = [key + number[:6] for number in trial_numbers]
    by_column = list(zip(*rows, strict=True)) if rows else [()] * len(COLUMNS)
    return {name: np.array(column, dtype=kind) for (name, kind), column in zip(COLUMNS.items(), by_column, strict=True)}


def frames(outcome: TrialOutcome) -> Table:
    """The rows of frames.parquet of one trial.

    Columns:
    configuration: label; a column for each parameter of a grid, and for each factor, follows it
    scene, seed: of the trial
    """
    trial, count = outcome.trial, len(outcome.per_frame["frame"])
    key = {"configuration": trial.configuration, "scene": trial.scene, "seed": trial.seed}
    return {name: np.full(count, value) for name, value in key.items()} | outcome.per_frame
